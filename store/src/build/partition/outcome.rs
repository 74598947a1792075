//! `PartitionOutcome`: an input in chunks, as a record of its journal, and the way back from it.
//!
//! ```text
//! chunks   what partition found | materials
//! ```
//!
//! Invariant: a record whose file is gone or too short, or whose numbers cannot be true together, counts as absent: its
//! hash says that nothing turned on the way, not who wrote it.

use super::cells::is_on_lattice;
use super::chunk::Chunk;
use super::collapsed::CollapsedSizes;
use super::{Partition, superblock_of};
use crate::budget::Budget;
use crate::build::input_sizes::InputSizes;
use crate::build::journal::record::JournalRecord;
use crate::build::journal::{FileKind, Journal};
use crate::build::model_materials::ModelMaterials;
use crate::build::scan::Grid;
use crate::build::scratch::Scratch;
use crate::error::Result;
use crate::geom::Lattice;
use crate::layout::Superblock;
use crate::octree::{Refinement, is_upper};
use crate::source::SourceStats;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::path::PathBuf;
use std::time::Instant;

/// Most bytes of a piece of a chunk in a record.
const PIECE_BYTES: u64 = 128;

/// What stands in `chunks`. Numbers that are not whole stand by their bits.
#[derive(Serialize, Deserialize)]
struct ChunksHead<'a> {
    pub(crate) scratch_bytes: u64,
    chunks: Cow<'a, [Chunk]>,
    origin: [u64; 3],
    exponent: i32,
    bits: u32,
    input_triangle_count: u64,
    triangle_count: u64,
    rejected_degenerate: u64,
    collapsed: CollapsedSizes,
    rejected_non_finite: u64,
    error_bound: u64,
    median_edge: u64,
    lattice_bounds: [[i64; 3]; 2],
    /// Leaves of the resident octree, and how much finer the finest are.
    octree: Option<(u32, u32)>,
    /// Triangles whose material emits.
    #[serde(default)]
    emissive_count: u64,
    #[serde(default)]
    has_colours: bool,
    content_hash: u64,
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
            origin: parted.grid.lattice.origin.map(f64::to_bits),
            exponent: parted.grid.lattice.exponent,
            bits: parted.grid.bits,
            input_triangle_count: parted.input_triangle_count,
            triangle_count: parted.triangle_count,
            rejected_degenerate: parted.rejected_degenerate,
            collapsed: parted.collapsed,
            rejected_non_finite: parted.rejected_non_finite,
            error_bound: parted.error_bound.to_bits(),
            median_edge: parted.median_edge.to_bits(),
            lattice_bounds: parted.lattice_bounds,
            octree: parted.octree.map(|(resolution, refinement)| (resolution, refinement.factor())),
            emissive_count: self.sizes.emissive_count,
            has_colours: self.sizes.has_colours,
            content_hash: parted.content_hash,
            source: self.source.clone(),
        };
        let Some((materials, _lease)) = self.materials.to_bytes(budget) else { return Ok(()) };
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
        let octree = head.octree.map(|(resolution, factor)| {
            Some((resolution, Refinement::from_factor(factor)?)).filter(|_| is_upper(resolution))
        });
        let (Ok([section]), false) = (<[Vec<u8>; 1]>::try_from(record.blobs), octree == Some(None)) else {
            return Ok(None);
        };
        let Some(materials) = ModelMaterials::parse(&section, budget)? else { return Ok(None) };
        let lattice = Lattice { origin: head.origin.map(f64::from_bits), exponent: head.exponent };
        let partition = Partition {
            scratch: Scratch::reopen(cells, head.scratch_bytes)?,
            chunks: head.chunks.into_owned(),
            grid: Grid { lattice, bits: head.bits },
            input_triangle_count: head.input_triangle_count,
            triangle_count: head.triangle_count,
            rejected_degenerate: head.rejected_degenerate,
            collapsed: head.collapsed,
            rejected_non_finite: head.rejected_non_finite,
            error_bound: f64::from_bits(head.error_bound),
            lattice_bounds: head.lattice_bounds,
            median_edge: f64::from_bits(head.median_edge),
            octree: octree.flatten(),
            content_hash: head.content_hash,
            // The materials of the record have them.
            mean_colours: Vec::new(),
            wait_ms: 0,
        };
        let sizes = InputSizes {
            triangle_count: head.input_triangle_count,
            emissive_count: head.emissive_count.min(head.input_triangle_count),
            vertex_count: head.source.vertex_count,
            material_count: materials.count() as u64,
            name_bytes: head.source.material_name_bytes,
            has_colours: head.has_colours,
        };
        let outcome = PartitionOutcome { partition, materials, sizes, source: head.source };
        Ok(outcome.is_sound().then_some(outcome))
    }

    fn is_sound(&self) -> bool {
        let partition = &self.partition;
        let Partition { scratch, chunks, triangle_count, lattice_bounds, grid, .. } = partition;
        let block = Superblock {
            triangle_count: *triangle_count,
            lattice_bounds: *lattice_bounds,
            ..superblock_of(partition)
        };
        block.has_sound_numbers()
            && is_on_lattice(lattice_bounds, grid.bits)
            && (0..3).all(|axis| lattice_bounds[0][axis] <= lattice_bounds[1][axis])
            && chunks.iter().all(|chunk| chunk.is_sound(scratch.bytes()))
            && chunks.iter().map(|chunk| chunk.triangle_count).sum::<u64>() == *triangle_count
    }
}
