//! `OpenValues`: what vertices have, open for reading: colours, normals, or coordinates in a picture.
//!
//! Invariant: what is open is of one accessor and stream; its cache is in the file, where numbers lie there as they
//! are.

use super::affine::Affine;
use super::bytes::BufferPlace;
use super::dense::DenseStore;
use super::rows::{ElementRows, PlainRows, RowWindow, RowsId, number_of_share};
use crate::cluster::Normal;
use crate::error::{Error, Result};
use crate::import::ImportOptions;
use crate::import::scalar::{ByteOrder, Scalar};
use crate::import::vertices::{MAX_STRIDE_BYTES, VertexCache, VertexLayout};
use std::fs::File;

/// Colours, normals or coordinates.
pub(super) struct OpenValues {
    rows: RowsId,
    cache: VertexCache,
    scalar: Scalar,
    /// Integers are shares of their greatest value.
    is_share: bool,
}

impl OpenValues {
    /// Opens `rows` where they are not open; closes what is open where there are none.
    pub(super) fn open(
        open: &mut Option<OpenValues>,
        rows: Option<&ElementRows>,
        store: &mut DenseStore,
        options: &ImportOptions,
    ) -> Result<()> {
        if rows.map(ElementRows::identity) == open.as_ref().map(|open| open.rows) {
            return Ok(());
        }
        *open = None;
        if let Some(rows) = rows {
            let cache = open_vectors(rows, store, options)?;
            let layout = &rows.layout;
            let (scalar, is_share) = (layout.scalar, layout.is_normalized);
            *open = Some(OpenValues { rows: rows.identity(), cache, scalar, is_share });
        }
        Ok(())
    }

    /// The colour of a vertex, linear.
    pub(super) fn colour(&mut self, vertex: u64) -> Result<[f64; 3]> {
        Ok(self.cache.get(vertex)?.map(|part| number_of_share(self.scalar, part)))
    }

    /// The coordinates of a vertex.
    pub(super) fn place(&mut self, vertex: u64) -> Result<[f64; 2]> {
        let [u, v, _] = self.cache.get(vertex)?;
        Ok([u, v].map(|part| if self.is_share { number_of_share(self.scalar, part) } else { part }))
    }

    /// The normal of a vertex under a transform: the length does not matter, nor that of shares.
    pub(super) fn normal(&mut self, vertex: u64, transform: &Affine) -> Result<Normal> {
        Ok(Normal::from_vector(transform.normal(self.cache.get(vertex)?)))
    }
}

/// A cache of the first three numbers of rows, of two the second one twice: in the file, where they lie there as plain
/// numbers, else of its own.
pub(super) fn open_vectors(
    rows: &ElementRows,
    store: &mut DenseStore,
    options: &ImportOptions,
) -> Result<VertexCache> {
    let plain = store.plain(rows)?;
    let PlainRows { place, layout } = &plain;
    if let BufferPlace::File { path, offset, .. } = place
        && layout.stride <= MAX_STRIDE_BYTES
    {
        let file = File::open(path).map_err(|error| Error::io("open the input", path, &error))?;
        let size = layout.scalar.size();
        let axes = [0, 1, 2].map(|axis: usize| (axis.min(layout.components - 1) * size, layout.scalar));
        let in_file = VertexLayout { stride: layout.stride as usize, axes, order: ByteOrder::Little };
        let file = (file, path.to_path_buf());
        return VertexCache::in_input(file, offset + layout.offset, layout.count, in_file, options);
    }
    let mut window = RowWindow::open(&plain, &store.spool, &options.budget)?;
    let mut cache = VertexCache::growing(options)?;
    // Shares stay integers here, as they do in a cache of the file.
    let (scalar, size) = (layout.scalar, layout.scalar.size());
    for index in 0..layout.count {
        let row = window.row(index)?;
        let at = |axis: usize| axis.min(layout.components - 1) * size;
        cache.push([0, 1, 2].map(|axis| scalar.number(&row[at(axis)..], ByteOrder::Little)))?;
    }
    Ok(cache)
}
