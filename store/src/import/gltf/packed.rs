//! `PackedView`: a view that `EXT_meshopt_compression` or `KHR_meshopt_compression` holds compressed, and how it is
//! decoded: from its beginning to its end into the spool, so that memory is a block, however large the view is.
//!
//! Invariant: as many bytes are written as the view says, or the view is refused.

use super::bytes::{BufferPlace, ByteSource, Spool};
use super::meshopt::{Feed, IndexDecoder, RowDecoder, SequenceDecoder};
use crate::error::{Code, Error, Result};
use std::path::Path;
use std::sync::Arc;

/// What a view holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PackedMode {
    /// Vertices, or other rows of numbers.
    Attributes,
    /// Indices of triangles.
    Triangles,
    /// Indices of anything.
    Indices,
}

/// What is done to rows once they are decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum PackedFilter {
    /// Nothing.
    None,
    /// Unit quaternions from three parts of four.
    Quaternion,
    /// Floats from a mantissa and an exponent.
    Exponential,
}

/// A compressed view.
#[derive(Clone, Debug)]
pub(super) struct PackedView {
    /// Its index in the file.
    pub(super) view: u32,
    pub(super) path: Arc<Path>,
    pub(super) place: BufferPlace,
    /// Bytes of a row, decoded.
    pub(super) stride: usize,
    pub(super) count: u64,
    pub(super) mode: PackedMode,
    pub(super) filter: PackedFilter,
}

impl PackedView {
    /// Bytes of the view, decoded.
    pub(super) fn bytes(&self) -> u64 {
        self.stride as u64 * self.count
    }

    /// Decodes the view into the spool.
    ///
    /// # Errors
    /// [`Code::InputFormat`] where the bytes are no such view.
    pub(super) fn decode(&self, spool: &mut Spool) -> Result<BufferPlace> {
        let open = |spool: &Spool, at: u64, end: u64| -> Result<Feed> {
            Feed::new(ByteSource::open(&self.place, spool)?, at, end, spool.budget())
        };
        let bytes = self.place.bytes();
        let damaged = |why: &'static str| self.damaged(why);
        match self.mode {
            PackedMode::Attributes => {
                let feed = open(spool, 0, bytes)?;
                let mut decoder = RowDecoder::begin(feed, self.stride).map_err(|e| e.named(damaged))?;
                let mut writer = spool.writer()?;
                let mut left = self.count;
                while left > 0 {
                    let rows = decoder.block(left).map_err(|e| e.named(damaged))?;
                    left -= (rows.len() / self.stride) as u64;
                    match self.filter {
                        PackedFilter::None => {}
                        PackedFilter::Quaternion => super::meshopt::quaternions(rows),
                        PackedFilter::Exponential => super::meshopt::exponentials(rows),
                    }
                    writer.write(rows)?;
                }
                decoder.finish().map_err(|e| e.named(damaged))?;
                writer.finish()
            }
            PackedMode::Triangles => {
                let split = 1 + self.count / 3;
                if !self.count.is_multiple_of(3) || bytes < split {
                    return Err(self.damaged("it is shorter than its count says"));
                }
                let feeds = [open(spool, 0, split)?, open(spool, split, bytes)?];
                let mut decoder = IndexDecoder::begin(feeds).map_err(|e| e.named(damaged))?;
                let mut writer = spool.writer()?;
                for _ in 0..self.count / 3 {
                    let triangle = decoder.triangle().map_err(|e| e.named(damaged))?;
                    triangle.into_iter().try_for_each(|index| self.write_index(&mut writer, index))?;
                }
                decoder.finish().map_err(|e| e.named(damaged))?;
                writer.finish()
            }
            PackedMode::Indices => {
                let feed = open(spool, 0, bytes)?;
                let mut decoder = SequenceDecoder::begin(feed).map_err(|e| e.named(damaged))?;
                let mut writer = spool.writer()?;
                for _ in 0..self.count {
                    let index = decoder.index().map_err(|e| e.named(damaged))?;
                    self.write_index(&mut writer, index)?;
                }
                decoder.finish().map_err(|e| e.named(damaged))?;
                writer.finish()
            }
        }
    }

    fn write_index(&self, writer: &mut super::bytes::SpoolWriter<'_>, index: u32) -> Result<()> {
        match (self.stride, u16::try_from(index)) {
            (2, Ok(narrow)) => writer.write(&narrow.to_le_bytes()),
            (2, Err(_)) => Err(self.damaged("an index has more than 16 bits")),
            _ => writer.write(&index.to_le_bytes()),
        }
    }

    fn damaged(&self, why: &str) -> Error {
        Error::new(Code::InputFormat, "a compressed view of the glTF file cannot be decoded")
            .at_place(format!("{}: bufferViews[{}]", self.path.display(), self.view))
            .numbers(format!("{why}; {} rows of {} bytes in {}", self.count, self.stride, self.place.bytes()))
            .next("export the file again, or unpack it: gltf-transform copy IN OUT")
    }
}
