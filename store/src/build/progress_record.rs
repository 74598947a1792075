//! How far a build has come, as records of its journal, and the way back from them.
//!
//! ```text
//! chunks   what partition found | materials
//! done     chunks in the output, counts | page table, roots of pages, emitters, places of voxel records
//! ```
//!
//! The page that the ends of the last chunks share is not written yet: of these chunks the ends are made again.
//!
//! Invariants: 1. what is restored is what was there when the record was written, so the bytes that follow are those of
//! a build that was never killed; 2. a record whose files are gone or too short, or whose numbers cannot be true
//! together, counts as absent: its hash says that nothing turned on the way, not who wrote it.

use super::cells::{Chunk, is_on_lattice};
use super::input_sizes::InputSizes;
use super::journal::Journal;
use super::lattice::Grid;
use super::model_materials::ModelMaterials;
use super::partition::Partition;
use super::publish::DraftFile;
use super::record::{self, is_as_long};
use super::scratch::Scratch;
use super::voxels::VoxelWork;
use super::writer::{Writer, superblock_of};
use crate::budget::Budget;
use crate::cluster::{LatticeBox, TopRef};
use crate::error::Result;
use crate::geom::Lattice;
use crate::layout::{EMITTER_BYTES, PAGE_ENTRY_BYTES, PageEntry, PageKind, SUPERBLOCK_BYTES, Superblock};
use crate::octree::{Refinement, Written, is_upper};
use crate::source::SourceStats;
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::path::PathBuf;
use std::time::Instant;

/// Most bytes of a piece of a chunk in a record.
const PIECE_BYTES: u64 = 128;
/// Words of a root: its box and its reference.
const ROOT_WORDS: usize = 7;

/// What stands in `chunks`. Numbers that are not whole stand by their bits.
#[derive(Serialize, Deserialize)]
struct ChunksHead<'a> {
    scratch_bytes: u64,
    chunks: Cow<'a, [Chunk]>,
    origin: [u64; 3],
    exponent: i32,
    bits: u32,
    input_triangle_count: u64,
    triangle_count: u64,
    rejected_degenerate: u64,
    rejected_collapsed: u64,
    rejected_non_finite: u64,
    error_bound: u64,
    median_edge: u64,
    lattice_bounds: [[i64; 3]; 2],
    /// Leaves of the resident octree, and how much finer the finest are.
    octree: Option<(u32, u32)>,
    /// Triangles whose material emits.
    #[serde(default)]
    emissive_count: u64,
    content_hash: u64,
    source: SourceStats,
}

/// What stands in `done`.
#[derive(Serialize, Deserialize)]
struct DoneHead {
    chunk_count: usize,
    open_chunks: Vec<usize>,
    draft_bytes: u64,
    emitter_count: u64,
    /// Triangles, vertices, clusters, wide clusters, resident bytes, bytes of page trees.
    counts: [u64; 6],
}

/// What came of reading an input.
pub(super) struct Read {
    pub(super) parted: Partition,
    pub(super) materials: ModelMaterials,
    pub(super) sizes: InputSizes,
    pub(super) source: SourceStats,
}

/// Chunks that stand in the output.
pub(super) struct Done {
    head: DoneHead,
    pages: Vec<PageEntry>,
    roots: Vec<(LatticeBox, TopRef)>,
    emitters: Vec<u8>,
    /// Voxel records, for a model that gets an octree.
    voxels: Option<Written>,
}

impl Journal {
    /// Records what came of reading the input; false where there is no memory for that.
    pub(super) fn write_chunks(&mut self, read: &Read, budget: &Budget) -> Result<bool> {
        let (begin, parted) = (Instant::now(), &read.parted);
        let piece_count = parted.chunks.iter().map(|chunk| chunk.pieces.len() as u64 + 1).sum::<u64>();
        let Ok(_lease) = budget.lease("the journal", piece_count * PIECE_BYTES) else { return Ok(false) };
        let head = ChunksHead {
            scratch_bytes: parted.scratch.bytes(),
            chunks: Cow::Borrowed(&parted.chunks),
            origin: parted.grid.lattice.origin.map(f64::to_bits),
            exponent: parted.grid.lattice.exponent,
            bits: parted.grid.bits,
            input_triangle_count: parted.input_triangle_count,
            triangle_count: parted.triangle_count,
            rejected_degenerate: parted.rejected_degenerate,
            rejected_collapsed: parted.rejected_collapsed,
            rejected_non_finite: parted.rejected_non_finite,
            error_bound: parted.error_bound.to_bits(),
            median_edge: parted.median_edge.to_bits(),
            lattice_bounds: parted.lattice_bounds,
            octree: parted.octree.map(|(resolution, refinement)| (resolution, refinement.factor())),
            emissive_count: read.sizes.emissive_count,
            content_hash: parted.content_hash,
            source: read.source.clone(),
        };
        let Some((materials, _lease)) = read.materials.to_bytes(budget) else { return Ok(false) };
        record::write(&self.path("chunks"), self.folder(), &head, &[&materials])?;
        self.written(begin);
        Ok(true)
    }

    /// What a build before this has read, and the chunks that it brought to the output; `None` for what is not there.
    pub(super) fn left(&self, budget: &Budget) -> Result<(Option<Read>, Option<Done>)> {
        let cells = self.path("cells");
        let record = record::read::<ChunksHead<'_>>(&self.path("chunks"), budget)?;
        let record = record.filter(|record| is_as_long(&cells, record.head.scratch_bytes));
        let read = record.map_or(Ok(None), |record| Read::parse(record, cells, budget))?;
        let Some(mut read) = read else { return Ok((None, None)) };
        let done = self.read_done(&read.parted, budget)?;
        let Partition { scratch, chunks, .. } = &mut read.parted;
        let unread = chunks[done.as_ref().map_or(0, Done::consumed)..].iter().flat_map(|chunk| &chunk.pieces);
        scratch.set_unread(unread.map(|piece| (piece.run, piece.take)));
        Ok((Some(read), done))
    }

    /// Records that the first `chunk_count` chunks are done, once they are on the disk; false where there is no memory
    /// for that.
    pub(super) fn write_done(
        &mut self,
        chunk_count: usize,
        writer: &Writer<'_>,
        file: &mut DraftFile<'_>,
        (voxels, budget): (Option<&VoxelWork>, &Budget),
    ) -> Result<bool> {
        let begin = Instant::now();
        let run_bytes = voxels.map_or(0, |work| work.runs.word_bytes());
        let table_bytes =
            writer.pages.len() * PAGE_ENTRY_BYTES + writer.closed_roots().len() * ROOT_WORDS * 8;
        let Ok(_lease) = budget.lease("the journal", run_bytes + table_bytes as u64) else {
            return Ok(false);
        };
        file.sync()?;
        let voxel_words = voxels.map_or(Ok(Vec::new()), |work| work.runs.synced(chunk_count as u32))?;
        let head = DoneHead {
            chunk_count,
            open_chunks: writer.open_chunks.clone(),
            draft_bytes: file.bytes(),
            emitter_count: writer.emitter_count,
            counts: counts(&mut writer.block.clone()).map(|count| *count),
        };
        let mut table = Vec::with_capacity(writer.pages.len() * PAGE_ENTRY_BYTES);
        writer.pages.iter().for_each(|entry| entry.write(&mut table));
        let mut roots = Vec::with_capacity(writer.closed_roots().len() * ROOT_WORDS);
        for (bounds, root) in writer.closed_roots() {
            roots.extend(bounds.lo.iter().chain(&bounds.hi).map(|&q| q as u64));
            roots.push(u64::from(root.to_word()));
        }
        let [roots, words] = [&roots, &voxel_words].map(|words| bytemuck::cast_slice(words));
        let blobs = [table.as_slice(), roots, &writer.emitters, words];
        record::write(&self.path("done"), self.folder(), &head, &blobs)?;
        self.written(begin);
        Ok(true)
    }

    /// The chunks of `parted` that a build before this has brought to the output; `None` for none.
    fn read_done(&self, parted: &Partition, budget: &Budget) -> Result<Option<Done>> {
        let record = record::read::<DoneHead>(&self.path("done"), budget)?;
        let Some(done) = record.and_then(|record| Done::parse(record, parted)) else { return Ok(None) };
        let voxel_bytes = done.voxels.as_ref().map_or(0, Written::bytes);
        let is_there = is_as_long(&self.path("part"), done.head.draft_bytes)
            && (done.voxels.is_none() || is_as_long(&self.path("voxels"), voxel_bytes));
        Ok(Some(done).filter(|_| is_there))
    }
}

/// The counts of what is in the output.
fn counts(block: &mut Superblock) -> [&mut u64; 6] {
    [
        &mut block.triangle_count,
        &mut block.vertex_count,
        &mut block.cluster_count,
        &mut block.wide_cluster_count,
        &mut block.resident_bytes,
        &mut block.page_tree_bytes,
    ]
}

impl Read {
    /// Of a record, with the scratch file that it speaks of; `None` where it cannot be one of ours.
    fn parse(
        record: record::Record<ChunksHead<'_>>,
        cells: PathBuf,
        budget: &Budget,
    ) -> Result<Option<Read>> {
        let head = record.head;
        let octree = head.octree.map(|(resolution, factor)| {
            Some((resolution, Refinement::from_factor(factor)?)).filter(|_| is_upper(resolution))
        });
        let (Ok([section]), false) = (<[Vec<u8>; 1]>::try_from(record.blobs), octree == Some(None)) else {
            return Ok(None);
        };
        let Some(materials) = ModelMaterials::parse(&section, budget)? else { return Ok(None) };
        let lattice = Lattice { origin: head.origin.map(f64::from_bits), exponent: head.exponent };
        let parted = Partition {
            scratch: Scratch::left(cells, head.scratch_bytes)?,
            chunks: head.chunks.into_owned(),
            grid: Grid { lattice, bits: head.bits },
            input_triangle_count: head.input_triangle_count,
            triangle_count: head.triangle_count,
            rejected_degenerate: head.rejected_degenerate,
            rejected_collapsed: head.rejected_collapsed,
            rejected_non_finite: head.rejected_non_finite,
            error_bound: f64::from_bits(head.error_bound),
            lattice_bounds: head.lattice_bounds,
            median_edge: f64::from_bits(head.median_edge),
            octree: octree.flatten(),
            content_hash: head.content_hash,
            wait_ms: 0,
        };
        let sizes = InputSizes {
            triangle_count: head.input_triangle_count,
            emissive_count: head.emissive_count.min(head.input_triangle_count),
            vertex_count: head.source.vertex_count,
            material_count: materials.count() as u64,
            name_bytes: head.source.material_name_bytes,
        };
        let read = Read { parted, materials, sizes, source: head.source };
        Ok(read.is_sound().then_some(read))
    }

    fn is_sound(&self) -> bool {
        let parted = &self.parted;
        let Partition { scratch, chunks, triangle_count, lattice_bounds, grid, .. } = parted;
        let block = Superblock {
            triangle_count: *triangle_count,
            lattice_bounds: *lattice_bounds,
            ..superblock_of(parted)
        };
        block.has_sound_numbers()
            && is_on_lattice(lattice_bounds, grid.bits)
            && (0..3).all(|axis| lattice_bounds[0][axis] <= lattice_bounds[1][axis])
            && chunks.iter().all(|chunk| chunk.is_sound(scratch.bytes()))
            && chunks.iter().map(|chunk| chunk.triangle_count).sum::<u64>() == *triangle_count
    }
}

impl Done {
    /// Of a record of a build that read `parted`; `None` where it cannot be one of ours.
    fn parse(record: record::Record<DoneHead>, parted: &Partition) -> Option<Done> {
        let [table, roots, emitters, words] = <[Vec<u8>; 4]>::try_from(record.blobs).ok()?;
        let pages = table.as_chunks().0.iter().map(PageEntry::parse).collect::<Option<Vec<_>>>()?;
        let roots: Vec<u64> = bytemuck::allocation::pod_collect_to_vec(&roots);
        let root = |words: &[u64; ROOT_WORDS]| {
            let q = |at: usize| [words[at] as i64, words[at + 1] as i64, words[at + 2] as i64];
            (LatticeBox { lo: q(0), hi: q(3) }, TopRef::from_word(words[6] as u32))
        };
        let voxels = match parted.octree {
            Some(_) => Some(Written::parse(&bytemuck::allocation::pod_collect_to_vec::<u8, u64>(&words))?),
            None => None,
        };
        let roots = roots.as_chunks().0.iter().map(root).collect();
        let done = Done { head: record.head, pages, roots, emitters, voxels };
        done.is_sound(parted).then_some(done)
    }

    fn is_sound(&self, parted: &Partition) -> bool {
        let Done { head, pages, roots, emitters, .. } = self;
        let [lo, hi] = parted.lattice_bounds;
        let is_root = |(bounds, root): &(LatticeBox, TopRef)| {
            let all = LatticeBox { lo, hi };
            let is_box = (0..3).all(|axis| bounds.lo[axis] <= bounds.hi[axis]) && all.join(bounds) == all;
            is_box && matches!(root, TopRef::Page { page, .. } if (*page as usize) < pages.len())
        };
        let mut block = superblock_of(parted);
        counts(&mut block).into_iter().zip(head.counts).for_each(|(count, there)| *count = there);
        // Pages follow each other, and so do their triangles.
        let next = |(offset, triangle_count): (u64, u64), page: &PageEntry| {
            let follows = page.offset == offset && u64::from(page.first_triangle) == triangle_count;
            (page.kind == PageKind::Mesh && follows).then(|| {
                (offset + u64::from(page.stored_bytes), triangle_count + u64::from(page.triangle_count))
            })
        };
        head.chunk_count <= parted.chunks.len()
            && head.open_chunks.is_sorted_by(|a, b| a < b)
            && head.open_chunks.last().is_none_or(|&open| open < head.chunk_count)
            && pages.iter().try_fold((SUPERBLOCK_BYTES as u64, 0), next)
                == Some((head.draft_bytes, head.counts[0]))
            && roots.iter().all(is_root)
            && emitters.len() as u64 == head.emitter_count.saturating_mul(EMITTER_BYTES as u64)
            && self.voxels.as_ref().is_none_or(|written| written.is_of(head.chunk_count))
            && block.has_counts_below(parted.triangle_count)
    }

    /// Chunks that are in the output.
    pub(super) fn chunk_count(&self) -> usize {
        self.head.chunk_count
    }

    /// Chunks of which nothing has to be read again.
    fn consumed(&self) -> usize {
        self.head.open_chunks.first().copied().unwrap_or(self.head.chunk_count)
    }

    /// Puts writer, output and voxel records where they were; gives the chunks whose ends are to be made again.
    pub(super) fn restore(
        self,
        writer: &mut Writer<'_>,
        file: &mut DraftFile<'_>,
        voxels: Option<&mut VoxelWork>,
    ) -> Result<Vec<usize>> {
        if let Some((work, written)) = voxels.zip(self.voxels) {
            work.runs.restore(written);
        }
        counts(&mut writer.block).into_iter().zip(self.head.counts).for_each(|(count, there)| *count = there);
        writer.restore(self.pages, self.roots, self.emitters)?;
        writer.emitter_count = self.head.emitter_count;
        file.go_on_at(self.head.draft_bytes)?;
        Ok(self.head.open_chunks)
    }
}
