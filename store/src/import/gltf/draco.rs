//! `DracoStream`: the vertices and triangles of a primitive that `KHR_draco_mesh_compression` holds in one stream. It
//! is decoded as a whole, in memory, by the crate `draco-core`; rows go to the spool, as those of other accessors lie.
//!
//! Invariants: 1. memory is leased by what the accessors say before the stream is looked at, and a stream that has
//! more than they say is refused; 2. as many rows are written as the accessors say, of their type, or the stream is
//! refused; 3. all rows of a stream are written when the first are asked for.

use super::bytes::BufferPlace;
#[cfg(not(feature = "draco"))]
use super::bytes::Spool;
use super::row_layout::RowLayout;
use crate::error::{Code, Error};
use std::path::Path;
use std::sync::Arc;

#[cfg(feature = "draco")]
mod decode;

/// What glTF calls it.
pub(super) const EXTENSION: &str = "KHR_draco_mesh_compression";
/// Whether this build reads it.
pub(super) const IS_READ: bool = cfg!(feature = "draco");

/// A stream, and what the accessors of its primitive say of it.
#[derive(Debug)]
#[cfg_attr(not(feature = "draco"), expect(dead_code, reason = "it is refused, and not read"))]
pub(super) struct DracoStream {
    /// The view that it lies in.
    pub(super) view: u32,
    pub(super) path: Arc<Path>,
    pub(super) place: BufferPlace,
    pub(super) triangle_count: u64,
    pub(super) vertex_count: u64,
    /// Bytes of a vertex, all of its attributes together.
    pub(super) vertex_bytes: u64,
    pub(super) parts: Vec<StreamPart>,
}

/// Rows of a stream.
#[derive(Clone, Copy, Debug)]
#[cfg_attr(not(feature = "draco"), expect(dead_code, reason = "they are refused, and not read"))]
pub(super) struct StreamPart {
    pub(super) accessor: u32,
    /// One after the other.
    pub(super) layout: RowLayout,
    /// The number of the attribute; `None`: the indices.
    pub(super) attribute: Option<u32>,
}

impl DracoStream {
    /// How the rows of an accessor lie, where the stream has them.
    pub(super) fn layout_of(&self, accessor: u32) -> Option<RowLayout> {
        self.parts.iter().find(|part| part.accessor == accessor).map(|part| part.layout)
    }

    /// How many accessors have their rows here.
    pub(super) fn part_count(&self) -> u64 {
        self.parts.len() as u64
    }

    /// What this build has for decoding: an error.
    #[cfg(not(feature = "draco"))]
    pub(super) fn decode(&self, _: &mut Spool) -> crate::error::Result<Vec<(u32, BufferPlace)>> {
        Err(unread(&self.path))
    }
}

/// The error of a build that does not read such files.
pub(super) fn unread(path: &Path) -> Error {
    Error::new(Code::InputFormat, "the glTF file is compressed with Draco, which this build does not read")
        .at(path)
        .numbers(EXTENSION)
        .next("unpack it with `gltf-transform copy IN OUT`, or build trex with its feature `draco`")
}
