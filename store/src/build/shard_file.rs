//! How plans and fragments begin and end, and what both hold: the model as its scan found it.
//!
//! ```text
//! file = head | blocks | record | where that is | ..
//! head = magic (8 bytes) | version of this form (4) | version of the page file that is built (4)
//! where a record is = its offset (8) | its bytes (8)
//! ```
//!
//! Invariants: 1. files are read from their end: what stands before a record ends where that begins; 2. a model that
//! was read has numbers that can be true together; who made it is not known.

use super::draft::DraftFile;
use super::input_sizes::InputSizes;
use super::journal::record::{self, JournalRecord};
use super::model_materials::ModelMaterials;
use super::partition::summary::{PartitionSummary, StoredSummary};
use crate::budget::Budget;
use crate::error::{Code, Error, Result};
use crate::file::open_regular;
use crate::layout::{MATERIAL_NAME_BYTES, TRIANGLES, VERSION};
use crate::next_step::NextStep;
use crate::source::SourceStats;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::fs::File;
use std::io::Read;
use std::ops::Range;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Version of both forms.
const SHARDS_VERSION: u32 = 2;
/// Bytes of the head.
pub(crate) const HEAD_BYTES: usize = 16;
/// Bytes behind a record: where it is.
const WHERE_BYTES: usize = 16;

/// Which of both a file is.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum ShardFileKind {
    Plan,
    Fragment,
}

impl ShardFileKind {
    fn magic(self) -> [u8; 8] {
        match self {
            ShardFileKind::Plan => *b"TREXPLAN",
            ShardFileKind::Fragment => *b"TREXFRAG",
        }
    }

    fn name(self) -> &'static str {
        match self {
            ShardFileKind::Plan => "plan of a build in shards",
            ShardFileKind::Fragment => "fragment of a build",
        }
    }

    fn reading(self) -> &'static str {
        match self {
            ShardFileKind::Plan => "read the plan",
            ShardFileKind::Fragment => "read the fragment",
        }
    }

    fn next_step(self) -> NextStep {
        match self {
            ShardFileKind::Plan => NextStep::ScanAgain,
            ShardFileKind::Fragment => NextStep::BuildShardAgain,
        }
    }

    /// The head of a file.
    pub(crate) fn head(self) -> [u8; HEAD_BYTES] {
        let mut head = [0; HEAD_BYTES];
        head[..8].copy_from_slice(&self.magic());
        head[8..12].copy_from_slice(&SHARDS_VERSION.to_le_bytes());
        head[12..].copy_from_slice(&VERSION.to_le_bytes());
        head
    }

    /// Checks the first bytes of a file, which may have fewer than a head.
    fn check(self, first_bytes: &[u8], path: &Path) -> Result<()> {
        let head = self.head();
        if first_bytes.get(..8) != Some(&head[..8]) || first_bytes.len() < HEAD_BYTES {
            return Err(Error::new(Code::InputFormat, format!("this is no {}", self.name()))
                .at(path)
                .numbers("it does not begin as one does")
                .next(self.next_step()));
        }
        if first_bytes[..HEAD_BYTES] != head {
            let version = |at: usize| u32::from_le_bytes(first_bytes[at..at + 4].try_into().expect("four"));
            return Err(Error::new(Code::Version, format!("this {} needs another version", self.name()))
                .at(path)
                .numbers(format!(
                    "version {} for page files of {}; this build knows {SHARDS_VERSION} and {VERSION}",
                    version(8),
                    version(12)
                ))
                .next(self.next_step()));
        }
        Ok(())
    }

    /// The error of a file that is not as it was published.
    pub(crate) fn damaged(self, path: &Path, numbers: impl Into<String>) -> Error {
        Error::new(Code::Damaged, format!("a {} is damaged", self.name()))
            .at(path)
            .numbers(numbers)
            .next(self.next_step())
    }
}

/// A file of either kind that is open, whose head was checked.
pub(crate) struct ShardFile<'a> {
    kind: ShardFileKind,
    path: &'a Path,
    file: File,
    pub(crate) bytes: u64,
}

impl<'a> ShardFile<'a> {
    /// Opens one.
    ///
    /// # Errors
    /// [`Code::InputFormat`], [`Code::Version`]; those of reading.
    pub(crate) fn open(kind: ShardFileKind, path: &'a Path) -> Result<ShardFile<'a>> {
        let file = open_regular(path)?;
        let failed = |e: std::io::Error| Error::io(kind.reading(), path, &e);
        let bytes = file.metadata().map_err(failed)?.len();
        let mut first = Vec::new();
        Read::by_ref(&mut &file).take(HEAD_BYTES as u64).read_to_end(&mut first).map_err(failed)?;
        kind.check(&first, path)?;
        Ok(ShardFile { kind, path, file, bytes })
    }

    /// The error of a file that is not as it was published.
    pub(crate) fn not_whole(&self) -> Error {
        self.kind.damaged(self.path, format!("{} bytes that are no whole {}", self.bytes, self.kind.name()))
    }

    /// The file once more, for its blocks.
    pub(crate) fn blocks(&self) -> Result<File> {
        self.file.try_clone().map_err(|e| Error::io(self.kind.reading(), self.path, &e))
    }

    /// Where the record is behind which the file ends at `end`.
    ///
    /// # Errors
    /// [`Code::Damaged`] where there can be none; those of reading.
    pub(crate) fn record_before(&self, end: u64) -> Result<Range<u64>> {
        let mut words = [0; WHERE_BYTES];
        let record_end = end.checked_sub(WHERE_BYTES as u64).ok_or_else(|| self.not_whole())?;
        self.read(&mut words, record_end)?;
        let [at, bytes] = [0, 8].map(|at| u64::from_le_bytes(words[at..at + 8].try_into().expect("eight")));
        let is_sound = at >= HEAD_BYTES as u64 && at.checked_add(bytes) == Some(record_end);
        is_sound.then_some(at..record_end).ok_or_else(|| self.not_whole())
    }

    /// Reads a record, and gives its hash; its length, [`record::READING`] times, was leased.
    ///
    /// # Errors
    /// [`Code::Damaged`] where it is not whole; those of reading.
    pub(crate) fn record<T: DeserializeOwned>(&self, place: Range<u64>) -> Result<(u64, JournalRecord<T>)> {
        let mut bytes = vec![0; (place.end - place.start) as usize];
        self.read(&mut bytes, place.start)?;
        let hash = bytes.first_chunk().copied().map(u64::from_le_bytes);
        hash.zip(record::parse(&bytes)).ok_or_else(|| self.not_whole())
    }

    fn read(&self, buffer: &mut [u8], at: u64) -> Result<()> {
        self.file.read_exact_at(buffer, at).map_err(|e| Error::io(self.kind.reading(), self.path, &e))
    }
}

/// Appends a record, and where it is; gives its hash. Its length is leased by who calls.
pub(crate) fn append_record(file: &mut DraftFile<'_>, head: &impl Serialize, blobs: &[&[u8]]) -> Result<u64> {
    let mut bytes = Vec::new();
    let hash = record::write_to(&mut bytes, head, blobs).expect("a vector takes all bytes");
    let record_bytes = bytes.len() as u64;
    bytes.extend(file.bytes().to_le_bytes());
    bytes.extend(record_bytes.to_le_bytes());
    file.append(&bytes)?;
    Ok(hash)
}

/// A model as its scan found it.
pub(crate) struct PlannedModel {
    pub(crate) summary: PartitionSummary,
    pub(crate) sizes: InputSizes,
    pub(crate) source: SourceStats,
    pub(super) materials: ModelMaterials,
}

/// The part of it that stands in the head of a record; materials are a blob of their own.
#[derive(Serialize, Deserialize)]
pub(crate) struct StoredModel {
    summary: StoredSummary,
    sizes: InputSizes,
    source: SourceStats,
}

impl PlannedModel {
    pub(crate) fn stored(&self) -> StoredModel {
        let PlannedModel { summary, sizes, source, .. } = self;
        StoredModel { summary: summary.stored(), sizes: *sizes, source: source.clone() }
    }

    /// The model of a head and the section of its materials; `None` for what cannot be one.
    pub(crate) fn parse(
        stored: StoredModel,
        section: &[u8],
        budget: &Budget,
    ) -> Result<Option<PlannedModel>> {
        let StoredModel { summary, sizes, source } = stored;
        let Some(summary) = summary.summary() else { return Ok(None) };
        let Some(materials) = ModelMaterials::parse(section, budget)? else { return Ok(None) };
        let kept = [summary.rejected_degenerate, summary.rejected_non_finite]
            .into_iter()
            .try_fold(summary.input_triangle_count, u64::checked_sub);
        let is_sound = kept == Some(summary.triangle_count)
            && summary.collapsed.count() <= summary.rejected_degenerate
            && summary.triangle_count > 0
            && sizes.triangle_count == summary.input_triangle_count
            && sizes.triangle_count <= TRIANGLES
            && sizes.emissive_count <= sizes.triangle_count
            && sizes.name_bytes <= sizes.material_count * MATERIAL_NAME_BYTES as u64
            && sizes.material_count == materials.count() as u64;
        Ok(is_sound.then_some(PlannedModel { summary, sizes, source, materials }))
    }
}

/// The blobs of a record, of which there must be so many.
pub(crate) fn blobs<T, const N: usize>(record: JournalRecord<T>) -> Option<(T, [Vec<u8>; N])> {
    let JournalRecord { head, blobs } = record;
    Some((head, <[Vec<u8>; N]>::try_from(blobs).ok()?))
}
