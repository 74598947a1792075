//! `PartitionOutcome`: an input in chunks, as a record of its journal, and the way back from it.
//!
//! ```text
//! chunks   what partition found | materials
//! ```
//!
//! Invariant: a record whose file is gone or too short, or whose numbers cannot be true together, counts as absent: its
//! hash says that nothing turned on the way, not who wrote it.

use super::Partition;
use super::chunk::Chunk;
use super::summary::StoredSummary;
use crate::attributes::AttributeSet;
use crate::budget::Budget;
use crate::build::input_sizes::InputSizes;
use crate::build::journal::record::JournalRecord;
use crate::build::journal::{FileKind, Journal};
use crate::build::model_materials::ModelMaterials;
use crate::build::scratch::Scratch;
use crate::error::Result;
use crate::source::SourceStats;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::path::PathBuf;
use std::time::Instant;

/// Most bytes of a piece of a chunk in a record.
const PIECE_BYTES: u64 = 128;

/// What stands in `chunks`.
#[derive(Serialize, Deserialize)]
struct ChunksHead<'a> {
    scratch_bytes: u64,
    chunks: Cow<'a, [Chunk]>,
    #[serde(flatten)]
    summary: StoredSummary,
    /// Triangles whose material emits.
    #[serde(default)]
    emissive_count: u64,
    #[serde(default)]
    attributes: AttributeSet,
    source: SourceStats,
}

/// An input that was read to its end: its triangles in chunks, its materials, the counters of its source.
pub(crate) struct PartitionOutcome {
    pub(crate) partition: Partition,
    pub(crate) materials: ModelMaterials,
    pub(crate) sizes: InputSizes,
    pub(crate) source: SourceStats,
}

impl PartitionOutcome {
    /// Records itself. Does nothing where there is no memory for that.
    pub(crate) fn record(&self, journal: &mut Journal, budget: &Budget) -> Result<()> {
        let (begin, parted) = (Instant::now(), &self.partition);
        let piece_count = parted.chunks.iter().map(|chunk| chunk.pieces.len() as u64 + 1).sum::<u64>();
        let Ok(_lease) = budget.lease("the journal", piece_count * PIECE_BYTES) else { return Ok(()) };
        let head = ChunksHead {
            scratch_bytes: parted.scratch.bytes(),
            chunks: Cow::Borrowed(&parted.chunks),
            summary: parted.summary.stored(),
            emissive_count: self.sizes.emissive_count,
            attributes: self.sizes.attributes,
            source: self.source.clone(),
        };
        let Ok((materials, _lease)) = self.materials.to_bytes(budget) else { return Ok(()) };
        journal.write_record((FileKind::Chunks, begin), &head, &[&materials])
    }

    /// What a build before this has read; `None` for nothing.
    pub(crate) fn read(journal: &Journal, budget: &Budget) -> Result<Option<PartitionOutcome>> {
        let record = journal.read_record::<ChunksHead<'_>>(FileKind::Chunks, budget)?;
        let record = record.filter(|record| journal.holds(FileKind::Cells, record.head.scratch_bytes));
        let cells = journal.path(FileKind::Cells);
        record.map_or(Ok(None), |record| PartitionOutcome::parse(record, cells, budget))
    }

    /// Of a record, with the scratch file that it speaks of; `None` where it cannot be one of ours.
    fn parse(
        record: JournalRecord<ChunksHead<'_>>,
        cells: PathBuf,
        budget: &Budget,
    ) -> Result<Option<PartitionOutcome>> {
        let head = record.head;
        let (Ok([section]), Some(summary)) = (<[Vec<u8>; 1]>::try_from(record.blobs), head.summary.summary())
        else {
            return Ok(None);
        };
        let Some(materials) = ModelMaterials::parse(&section, budget)? else { return Ok(None) };
        let input_triangle_count = summary.input_triangle_count;
        let lists = budget.lease("the lists of chunks", head.chunks.iter().map(Chunk::bytes).sum())?;
        let partition = Partition {
            scratch: Scratch::reopen(cells, head.scratch_bytes)?,
            chunks: head.chunks.into_owned(),
            summary,
            // The materials of the record have them.
            mean_colours: Vec::new(),
            wait_ms: 0,
            _lists: Some(lists),
        };
        let sizes = InputSizes {
            triangle_count: input_triangle_count,
            emissive_count: head.emissive_count.min(input_triangle_count),
            vertex_count: head.source.vertex_count,
            material_count: materials.count() as u64,
            name_bytes: head.source.material_name_bytes,
            attributes: head.attributes,
        };
        let outcome = PartitionOutcome { partition, materials, sizes, source: head.source };
        Ok(outcome.is_sound().then_some(outcome))
    }

    fn is_sound(&self) -> bool {
        let Partition { scratch, chunks, summary, .. } = &self.partition;
        chunks.iter().all(|chunk| chunk.is_sound(scratch.bytes()))
            && self.partition.chunk_triangle_count() <= summary.triangle_count
    }
}
