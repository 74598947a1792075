//! `EmitCheckpoint`: the chunks that stand in the output, as a record of its journal, and the way back from it.
//!
//! ```text
//! done     chunks in the output, counts | page table, roots of pages, emitters, places of voxel records
//! ```
//!
//! The page that the ends of the last chunks share is not written yet: of these chunks the ends are made again.
//!
//! Invariants: 1. what is restored is what was there when the record was written, so the bytes that follow are those of
//! a build that was never killed; 2. a record whose files are gone or too short, or whose numbers cannot be true
//! together, counts as absent: its hash says that nothing turned on the way, not who wrote it.

use super::voxels::VoxelWork;
use super::writer::PageWriter;
use crate::budget::Budget;
use crate::build::draft::DraftFile;
use crate::build::journal::record::JournalRecord;
use crate::build::journal::{FileKind, Journal};
use crate::build::partition::Partition;
use crate::cluster::{LatticeBox, TopRef};
use crate::error::Result;
use crate::layout::{EMITTER_BYTES, PAGE_ENTRY_BYTES, PageEntry, PageKind, SUPERBLOCK_BYTES, Superblock};
use crate::octree::VoxelRunTable;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Words of a root: its box and its reference.
const ROOT_WORDS: usize = 7;

/// What stands in `done`.
#[derive(Serialize, Deserialize)]
struct EmitHead {
    chunk_count: usize,
    open_chunks: Vec<usize>,
    draft_bytes: u64,
    emitter_count: u64,
    /// Triangles, vertices, clusters, wide clusters, resident bytes, bytes of page trees, pages of colours and of
    /// normals.
    counts: [u64; 8],
}

/// Chunks that stand in the output.
pub(crate) struct EmitCheckpoint {
    head: EmitHead,
    pages: Vec<PageEntry>,
    roots: Vec<(LatticeBox, TopRef)>,
    emitters: Vec<u8>,
    /// Voxel records, for a model that gets an octree.
    voxels: Option<VoxelRunTable>,
}

/// The counts of what is in the output.
fn counts(block: &mut Superblock) -> [&mut u64; 8] {
    [
        &mut block.triangle_count,
        &mut block.vertex_count,
        &mut block.cluster_count,
        &mut block.wide_cluster_count,
        &mut block.resident_bytes,
        &mut block.page_tree_bytes,
        &mut block.colour_page_count,
        &mut block.normal_page_count,
    ]
}

impl EmitCheckpoint {
    /// Records that the first `chunk_count` chunks are in the output, once they are on the disk; false where there is
    /// no memory for that.
    pub(crate) fn record(
        journal: &mut Journal,
        chunk_count: usize,
        writer: &PageWriter<'_>,
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
        let head = EmitHead {
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
        journal.write_record((FileKind::Emitted, begin), &head, &blobs)?;
        Ok(true)
    }

    /// The chunks of `parted` that a build before this has brought to the output; `None` for none.
    pub(crate) fn read(
        journal: &Journal,
        parted: &Partition,
        budget: &Budget,
    ) -> Result<Option<EmitCheckpoint>> {
        let record = journal.read_record::<EmitHead>(FileKind::Emitted, budget)?;
        let Some(checkpoint) = record.and_then(|record| EmitCheckpoint::parse(record, parted)) else {
            return Ok(None);
        };
        let is_there = journal.holds(FileKind::Draft, checkpoint.head.draft_bytes)
            && checkpoint
                .voxels
                .as_ref()
                .is_none_or(|voxels| journal.holds(FileKind::Voxels, voxels.bytes()));
        Ok(Some(checkpoint).filter(|_| is_there))
    }

    /// Of a record of a build that read `parted`; `None` where it cannot be one of ours.
    fn parse(record: JournalRecord<EmitHead>, parted: &Partition) -> Option<EmitCheckpoint> {
        let [table, roots, emitters, words] = <[Vec<u8>; 4]>::try_from(record.blobs).ok()?;
        let pages = table.as_chunks().0.iter().map(PageEntry::parse).collect::<Option<Vec<_>>>()?;
        let roots: Vec<u64> = bytemuck::allocation::pod_collect_to_vec(&roots);
        let root = |words: &[u64; ROOT_WORDS]| {
            let q = |at: usize| [words[at] as i64, words[at + 1] as i64, words[at + 2] as i64];
            (LatticeBox { lo: q(0), hi: q(3) }, TopRef::from_word(words[6] as u32))
        };
        let voxels = match parted.summary.octree {
            Some(_) => {
                Some(VoxelRunTable::parse(&bytemuck::allocation::pod_collect_to_vec::<u8, u64>(&words))?)
            }
            None => None,
        };
        let roots = roots.as_chunks().0.iter().map(root).collect();
        let checkpoint = EmitCheckpoint { head: record.head, pages, roots, emitters, voxels };
        checkpoint.is_sound(parted).then_some(checkpoint)
    }

    fn is_sound(&self, parted: &Partition) -> bool {
        let EmitCheckpoint { head, pages, roots, emitters, .. } = self;
        let [lo, hi] = parted.summary.lattice_bounds;
        let is_mesh = |page: usize| pages.get(page).is_some_and(|page| page.kind == PageKind::Mesh);
        let count = |kind| pages.iter().filter(|page| page.kind == kind).count() as u64;
        let is_root = |(bounds, root): &(LatticeBox, TopRef)| {
            let all = LatticeBox { lo, hi };
            let is_box = (0..3).all(|axis| bounds.lo[axis] <= bounds.hi[axis]) && all.join(bounds) == all;
            is_box && matches!(root, TopRef::Page { page, .. } if is_mesh(*page as usize))
        };
        let mut block = parted.summary.superblock();
        counts(&mut block).into_iter().zip(head.counts).for_each(|(count, there)| *count = there);
        // Pages follow each other, and so do their triangles.
        let next = |(offset, triangle_count): (u64, u64), page: &PageEntry| {
            let follows = match page.kind {
                PageKind::Mesh => u64::from(page.first_triangle) == triangle_count,
                PageKind::Colours | PageKind::Normals => u64::from(page.first_triangle) < triangle_count,
                PageKind::Units => false,
            };
            (page.offset == offset && follows).then(|| {
                (offset + u64::from(page.stored_bytes), triangle_count + u64::from(page.triangle_count))
            })
        };
        head.chunk_count <= parted.chunks.len()
            && head.open_chunks.is_sorted_by(|a, b| a < b)
            && head.open_chunks.last().is_none_or(|&open| open < head.chunk_count)
            && pages.iter().try_fold((SUPERBLOCK_BYTES as u64, 0), next)
                == Some((head.draft_bytes, head.counts[0]))
            && [count(PageKind::Colours), count(PageKind::Normals)] == head.counts[6..]
            && roots.iter().all(is_root)
            && emitters.len() as u64 == head.emitter_count.saturating_mul(EMITTER_BYTES as u64)
            && self.voxels.as_ref().is_none_or(|written| written.is_of(head.chunk_count))
            && block.has_counts_below(parted.summary.triangle_count)
    }

    /// Chunks that are in the output.
    pub(crate) fn chunk_count(&self) -> usize {
        self.head.chunk_count
    }

    /// Chunks of which nothing has to be read again.
    pub(crate) fn consumed(&self) -> usize {
        self.head.open_chunks.first().copied().unwrap_or(self.head.chunk_count)
    }

    /// Puts writer, output and voxel records where they were; gives the chunks whose ends are to be made again.
    pub(crate) fn restore(
        self,
        writer: &mut PageWriter<'_>,
        file: &mut DraftFile<'_>,
        voxels: Option<&mut VoxelWork>,
    ) -> Result<Vec<usize>> {
        if let Some((work, written)) = voxels.zip(self.voxels) {
            work.runs.restore(written);
        }
        counts(&mut writer.block).into_iter().zip(self.head.counts).for_each(|(count, there)| *count = there);
        writer.restore(self.pages, self.roots, self.emitters)?;
        writer.emitter_count = self.head.emitter_count;
        file.resume_at(self.head.draft_bytes)?;
        Ok(self.head.open_chunks)
    }
}
