//! `FileSizes`: what the memory of a page file follows from, known before any of it is taken: from the superblock and
//! the heads of the octree's sections.
//!
//! Invariant: an opened file has the sizes that were told before it was opened.

use super::{PageFile, check_lengths, kept_bytes, lower_size, opening_bytes, read_superblock, upper_size};
use crate::error::Result;
use crate::io::Origin;
use crate::layout::{SectionKind, Superblock};
use crate::octree::{LowerSize, UpperSize};
use std::path::{Path, PathBuf};

/// Sizes of a page file.
#[derive(Clone, Debug)]
pub struct FileSizes {
    /// The file.
    pub path: PathBuf,
    /// True where its pages come from afar, and many are to be asked for at once.
    pub is_far: bool,
    /// Count of pages.
    pub page_count: u32,
    /// Count of materials.
    pub material_count: usize,
    /// Count of emissive triangles.
    pub emitter_count: usize,
    /// Bytes of memory that the tables keep.
    pub kept_bytes: u64,
    /// Bytes of memory while they are read, those that are kept among them.
    pub opening_bytes: u64,
    /// The resident octree, if there is one; or what is wrong with its head, which matters to those who read it alone.
    pub upper: Result<Option<UpperSize>>,
    /// What is below it, if there is anything.
    pub lower: Result<Option<LowerSize>>,
}

impl FileSizes {
    /// Sizes of the file `path`, of which no table is read.
    ///
    /// # Errors
    /// Those of [`PageFile::open`], but [`Code::MemoryLimit`](crate::Code::MemoryLimit).
    pub fn of(path: &Path) -> Result<FileSizes> {
        let file = Origin::open(path)?;
        let block = read_superblock(&file, path)?;
        check_lengths(&block, path)?;
        Ok(FileSizes::of_parts(&file, &block, path))
    }

    fn of_parts(file: &Origin, block: &Superblock, path: &Path) -> FileSizes {
        let count = |kind| block.section(kind).count;
        FileSizes {
            path: path.to_path_buf(),
            is_far: file.is_far(),
            page_count: count(SectionKind::PageTable),
            material_count: count(SectionKind::Materials) as usize,
            emitter_count: count(SectionKind::Emitters) as usize,
            kept_bytes: kept_bytes(block) + file.connection_bytes(),
            opening_bytes: opening_bytes(file, block),
            upper: upper_size(file, block, path),
            lower: lower_size(file, block, path),
        }
    }
}

impl PageFile {
    /// Sizes of this file.
    pub fn sizes(&self) -> FileSizes {
        FileSizes::of_parts(&self.file, &self.block, &self.path)
    }
}
