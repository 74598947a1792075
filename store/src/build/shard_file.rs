//! What plans and fragments begin with, and what both hold: the model as its scan found it.
//!
//! ```text
//! head = magic (8 bytes) | version of this form (4) | version of the page file that is built (4)
//! ```
//!
//! Invariant: a model that was read has numbers that can be true together; who made it is not known.

use super::input_sizes::InputSizes;
use super::journal::record::JournalRecord;
use super::model_materials::ModelMaterials;
use super::partition::summary::{PartitionSummary, StoredSummary};
use crate::budget::Budget;
use crate::error::{Code, Error, Result};
use crate::layout::VERSION;
use crate::next_step::NextStep;
use crate::source::SourceStats;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Version of both forms.
const SHARDS_VERSION: u32 = 1;
/// Bytes of the head.
pub(crate) const HEAD_BYTES: usize = 16;

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
    ///
    /// # Errors
    /// [`Code::InputFormat`], [`Code::Version`].
    pub(crate) fn check(self, first_bytes: &[u8], path: &Path) -> Result<()> {
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
            && sizes.emissive_count <= sizes.triangle_count
            && sizes.material_count == materials.count() as u64;
        Ok(is_sound.then_some(PlannedModel { summary, sizes, source, materials }))
    }
}

/// The blobs of a record, of which there must be so many.
pub(crate) fn blobs<T, const N: usize>(record: JournalRecord<T>) -> Option<(T, [Vec<u8>; N])> {
    let JournalRecord { head, blobs } = record;
    Some((head, <[Vec<u8>; N]>::try_from(blobs).ok()?))
}
