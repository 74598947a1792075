//! What tests of the importers reach of the inside: rows of a compressed view, decoded out of a file.

use super::bytes::{BufferPlace, ByteSource, Spool, SpoolUse};
use super::packed::{PackedFilter, PackedMode, PackedView};
use crate::import::ImportOptions;
use std::path::Path;
use std::sync::Arc;

/// Rows of `stride` bytes; `None` where they are refused.
pub(in crate::import) fn unpack_rows(packed: &[u8], stride: usize, count: usize) -> Option<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let path: Arc<Path> = folder.path().join("packed").into();
    std::fs::write(&path, packed).unwrap();
    let mut spool = Spool::new(SpoolUse::Kept, &ImportOptions::unlimited(folder.path()));
    let view = PackedView {
        view: 0,
        place: BufferPlace::File { path: path.clone(), offset: 0, bytes: packed.len() as u64 },
        path,
        stride,
        count: count as u64,
        mode: PackedMode::Attributes,
        filter: PackedFilter::None,
    };
    let place = view.decode(&mut spool).ok()?;
    let mut rows = vec![0; place.bytes() as usize];
    ByteSource::open(&place, &spool).unwrap().read(0, &mut rows).unwrap();
    Some(rows)
}
