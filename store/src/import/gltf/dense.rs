//! `DenseStore`: accessors as plain rows. Compressed views and streams are decoded, replaced rows are put in their
//! places, once each; all go to the spool.
//!
//! Invariants: 1. what an accessor gives does not depend on when it is asked for; 2. an entry is leased before it is
//! kept.

use super::bytes::{BufferPlace, Spool};
use super::draco::DracoStream;
use super::packed::PackedView;
use super::row_layout::RowLayout;
use super::rows::{ElementRows, PlainRows, RowWindow, SparseRows, ViewPlace};
use crate::budget::{Budget, Lease};
use crate::error::{Code, Error, Result};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Bytes of an entry, with its share of the map.
const ENTRY_BYTES: u64 = 256;
/// What entries are called in messages.
const ENTRIES: &str = "the places of decoded accessors";

/// Plain rows by accessor, and decoded places by view, and by stream and accessor.
pub(super) struct DenseStore {
    pub(super) spool: Spool,
    path: Arc<Path>,
    budget: Budget,
    views: BTreeMap<u32, BufferPlace>,
    streams: BTreeMap<(u32, u32), BufferPlace>,
    accessors: BTreeMap<u32, PlainRows>,
    lease: Lease,
}

impl DenseStore {
    /// Nothing is decoded so far; `spool` may hold buffers already.
    pub(super) fn new(spool: Spool, path: &Arc<Path>) -> Result<DenseStore> {
        let budget = spool.budget().clone();
        let lease = budget.lease(ENTRIES, 0)?;
        let (views, streams, accessors) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
        Ok(DenseStore { spool, path: path.clone(), budget, views, streams, accessors, lease })
    }

    /// The rows of an accessor as plain ones.
    pub(super) fn plain(&mut self, rows: &ElementRows) -> Result<PlainRows> {
        if let Some(known) = self.accessors.get(&rows.accessor) {
            return Ok(known.clone());
        }
        let base = rows.view.as_ref().map(|view| self.placed(view, rows.layout)).transpose()?;
        match (base, &rows.sparse) {
            (Some(base), None) => Ok(base),
            (base, sparse) => {
                self.lease.grow(ENTRIES, ENTRY_BYTES)?;
                let dense = self.merge(base, rows.layout, sparse.as_deref(), rows.accessor)?;
                self.accessors.insert(rows.accessor, dense.clone());
                Ok(dense)
            }
        }
    }

    /// Opens the rows of an accessor for reading.
    pub(super) fn window(&mut self, rows: &ElementRows) -> Result<RowWindow> {
        let plain = self.plain(rows)?;
        RowWindow::open(&plain, &self.spool, &self.budget)
    }

    fn placed(&mut self, view: &ViewPlace, layout: RowLayout) -> Result<PlainRows> {
        let place = match view {
            ViewPlace::Plain(place) => place.clone(),
            ViewPlace::Packed(packed) => self.unpacked(packed)?,
            ViewPlace::Draco(stream, accessor) => self.decoded(stream, *accessor)?,
        };
        Ok(PlainRows { place, layout })
    }

    fn unpacked(&mut self, packed: &PackedView) -> Result<BufferPlace> {
        if let Some(place) = self.views.get(&packed.view) {
            return Ok(place.clone());
        }
        self.lease.grow(ENTRIES, ENTRY_BYTES)?;
        let place = packed.decode(&mut self.spool)?;
        self.views.insert(packed.view, place.clone());
        Ok(place)
    }

    fn decoded(&mut self, stream: &DracoStream, accessor: u32) -> Result<BufferPlace> {
        let wanted = (stream.view, accessor);
        if let Some(place) = self.streams.get(&wanted) {
            return Ok(place.clone());
        }
        self.lease.grow(ENTRIES, stream.part_count() * ENTRY_BYTES)?;
        let places = stream.decode(&mut self.spool)?;
        self.streams.extend(places.into_iter().map(|(accessor, place)| ((stream.view, accessor), place)));
        Ok(self.streams[&wanted].clone())
    }

    /// Rows of `base`, or zeros, with some of them replaced.
    fn merge(
        &mut self,
        base: Option<PlainRows>,
        layout: RowLayout,
        sparse: Option<&SparseRows>,
        accessor: u32,
    ) -> Result<PlainRows> {
        let mut base = base.map(|base| RowWindow::open(&base, &self.spool, &self.budget)).transpose()?;
        let mut replaced = match sparse {
            Some(sparse) => {
                let indices = self.placed(&sparse.indices.0, sparse.indices.1)?;
                let values = self.placed(&sparse.values.0, sparse.values.1)?;
                Some(ReplacedRows::open(indices, values, &self.spool, &self.budget)?)
            }
            None => None,
        };
        let mut writer = self.spool.writer()?;
        for index in 0..layout.count {
            let row = match (&mut replaced, &mut base) {
                (Some(replaced), _) if replaced.next == Some(index) => replaced.take()?,
                (_, Some(base)) => base.row(index)?,
                (_, None) => &[0; ROW_BYTES_MAX][..layout.row_bytes()],
            };
            writer.write(row)?;
        }
        if let Some(left) = replaced.and_then(|replaced| replaced.next) {
            return Err(Error::new(
                Code::InputFormat,
                "the indices of a sparse accessor do not rise, or are not there",
            )
            .at_place(format!("{}: accessors[{accessor}]", self.path.display()))
            .numbers(format!("index {left} cannot be replaced, and there are {} rows", layout.count))
            .next("check the file with a glTF validator, or export it again"));
        }
        Ok(PlainRows { place: writer.finish()?, layout: layout.packed() })
    }
}

/// Most bytes of a row: four numbers of eight bytes.
const ROW_BYTES_MAX: usize = 32;

/// Rows that stand in the place of others, in order.
struct ReplacedRows {
    indices: RowWindow,
    values: RowWindow,
    at: u64,
    /// The row that the one at hand replaces; `None` behind the last.
    next: Option<u64>,
}

impl ReplacedRows {
    fn open(indices: PlainRows, values: PlainRows, spool: &Spool, budget: &Budget) -> Result<ReplacedRows> {
        let open = |rows| RowWindow::open(rows, spool, budget);
        let mut rows = ReplacedRows { indices: open(&indices)?, values: open(&values)?, at: 0, next: None };
        rows.next = rows.index_at(0)?;
        Ok(rows)
    }

    fn index_at(&mut self, at: u64) -> Result<Option<u64>> {
        if at < self.indices.count() { self.indices.integer(at).map(Some) } else { Ok(None) }
    }

    /// The row at hand; the one after it is at hand then.
    fn take(&mut self) -> Result<&[u8]> {
        let at = self.at;
        self.at += 1;
        self.next = self.index_at(self.at)?;
        self.values.row(at)
    }
}
