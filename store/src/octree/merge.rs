//! Runs of records in a scratch file, and their merge into leaves.
//!
//! ```text
//! run   = blocks of up to 128 records: seal (`crate::scratch`), LZ4
//! merge = a heap over the runs' next records, equal ones summed
//! ```
//!
//! Invariants: 1. a block is named by its run and its number in it; 2. records of one leaf and material are summed in
//! the order of runs (chunk, number), whoever wrote them first; 3. memory is one block per run.

use super::record::Record;
use crate::error::Result;
use crate::scratch::{Place, SEAL_BYTES, ScratchFile, seal};
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::Mutex;

/// Records of a block.
const BLOCK: usize = 128;
/// Bytes of memory per run while runs are merged.
pub(crate) const RUN_BYTES: u64 = (BLOCK * size_of::<Record>() * 2) as u64;

/// The runs of all chunks.
pub(crate) struct VoxelRuns {
    file: ScratchFile,
    written: Mutex<Written>,
}

/// How much there is to be merged.
pub(crate) struct RunsSize {
    pub(crate) bytes: u64,
    pub(crate) run_count: u64,
}

#[derive(Default)]
struct Written {
    end: u64,
    runs: Vec<Run>,
}

/// The place of a run in the order: by chunk, then by when it was full.
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RunOrder {
    pub(super) chunk: u32,
    /// Runs of the chunk before it.
    pub(super) number: u32,
}

/// A run: its place in the order, and where its blocks stand.
struct Run {
    order: RunOrder,
    offset: u64,
    /// Bytes of each block.
    blocks: Vec<u32>,
    record_count: usize,
}

impl VoxelRuns {
    /// No runs yet, in the scratch file of a place.
    pub(crate) fn at(place: Place) -> Result<VoxelRuns> {
        Ok(VoxelRuns { file: ScratchFile::at(place)?, written: Mutex::default() })
    }

    /// Bytes of the words of [`VoxelRuns::synced`], at most.
    pub(crate) fn word_bytes(&self) -> u64 {
        let written = self.written.lock().expect("no panic while held");
        let words: usize = written.runs.iter().map(|run| 3 + run.blocks.len()).sum();
        8 * (1 + words as u64)
    }

    /// Waits until all runs are on the disk, and tells in words where those of the first `chunk_count` chunks are. The
    /// words are for [`VoxelRuns::restore`].
    pub(crate) fn synced(&self, chunk_count: u32) -> Result<Vec<u64>> {
        self.file.sync()?;
        let written = self.written.lock().expect("no panic while held");
        let mut words = vec![written.end];
        for run in written.runs.iter().filter(|run| run.order.chunk < chunk_count) {
            let order = u64::from(run.order.chunk) << 32 | u64::from(run.order.number);
            words.extend([order, run.offset, run.record_count as u64]);
            words.extend(run.blocks.iter().map(|&bytes| u64::from(bytes)));
        }
        Ok(words)
    }

    /// Takes the runs that `words` tell of; `None` where they tell nonsense.
    pub(crate) fn restore(&mut self, words: &[u64]) -> Option<()> {
        let (&end, mut words) = words.split_first()?;
        let mut runs = Vec::new();
        while let Some((&[order, offset, record_count], rest)) = words.split_first_chunk() {
            let record_count = usize::try_from(record_count).ok()?;
            let (blocks, rest) = rest.split_at_checked(record_count.div_ceil(BLOCK))?;
            let blocks = blocks.iter().map(|&bytes| u32::try_from(bytes).ok()).collect::<Option<_>>()?;
            let order = RunOrder { chunk: (order >> 32) as u32, number: order as u32 };
            runs.push(Run { order, offset, blocks, record_count });
            words = rest;
        }
        *self.written.get_mut().expect("no panic while held") = Written { end, runs };
        words.is_empty().then_some(())
    }

    /// What has been written.
    pub(crate) fn size(&self) -> RunsSize {
        let written = self.written.lock().expect("no panic while held");
        RunsSize { bytes: written.end, run_count: written.runs.len() as u64 }
    }

    /// Appends records that are in order.
    pub(super) fn append(&self, order: RunOrder, records: &[Record]) -> Result<()> {
        let mut bytes = Vec::new();
        let mut blocks = Vec::new();
        for block in records.chunks(BLOCK) {
            let begin = bytes.len();
            bytes.extend([0; SEAL_BYTES]);
            bytes.extend(lz4_flex::block::compress(bytemuck::cast_slice(block)));
            seal(&mut bytes[begin..], block_name(order, blocks.len()));
            blocks.push((bytes.len() - begin) as u32);
        }
        let mut written = self.written.lock().expect("no panic while held");
        let offset = written.end;
        self.file.write(&bytes, offset)?;
        written.end += bytes.len() as u64;
        written.runs.push(Run { order, offset, blocks, record_count: records.len() });
        drop(written);
        // Started, not waited for: the pages leave the cache when they are clean and dropped after the merge.
        let _ = rustix::fs::fadvise(
            self.file.file(),
            offset,
            std::num::NonZeroU64::new(bytes.len() as u64),
            rustix::fs::Advice::DontNeed,
        );
        Ok(())
    }
}

/// The name of a block: numbers of chunks and runs are far from 32 and 16 bits, and a run has few blocks.
fn block_name(run: RunOrder, number: usize) -> u64 {
    u64::from(run.chunk) << 32 | u64::from(run.number) << 16 ^ number as u64
}

/// A run while it is merged.
struct Reader {
    run: Run,
    next_block: usize,
    block: Vec<Record>,
    at: usize,
}

impl Reader {
    /// The next record, if there is one.
    fn next(&mut self, runs: &VoxelRuns) -> Result<Option<Record>> {
        if self.at == self.block.len() {
            let Some(&bytes) = self.run.blocks.get(self.next_block) else { return Ok(None) };
            let count = (self.run.record_count - self.next_block * BLOCK).min(BLOCK);
            let name = block_name(self.run.order, self.next_block);
            let mut packed = Vec::new();
            let packed = runs.file.read(self.run.offset, bytes as usize, name, &mut packed)?;
            self.block.resize(count, Record::default());
            let unpacked =
                lz4_flex::block::decompress_into(packed, bytemuck::cast_slice_mut(&mut self.block));
            if unpacked.ok() != Some(count * size_of::<Record>()) {
                return Err(runs.file.damaged(self.run.offset));
            }
            self.run.offset += u64::from(bytes);
            (self.next_block, self.at) = (self.next_block + 1, 0);
        }
        self.at += 1;
        Ok(Some(self.block[self.at - 1]))
    }
}

/// Calls `take` for each pair of leaf and material, in order, summed.
pub(crate) fn merge(mut runs: VoxelRuns, mut take: impl FnMut(Record) -> Result<()>) -> Result<()> {
    let mut all = std::mem::take(&mut runs.written.get_mut().expect("no panic while held").runs);
    all.sort_unstable_by_key(|run| run.order);
    let mut readers: Vec<Reader> =
        all.into_iter().map(|run| Reader { run, next_block: 0, block: Vec::new(), at: 0 }).collect();
    let mut heads = Vec::with_capacity(readers.len());
    let mut heap = BinaryHeap::with_capacity(readers.len());
    for (index, reader) in readers.iter_mut().enumerate() {
        let head = reader.next(&runs)?.expect("runs are not empty");
        heap.push(Reverse((head.order, index)));
        heads.push(head);
    }
    let mut sum: Option<Record> = None;
    while let Some(Reverse((order, index))) = heap.pop() {
        let record = heads[index];
        if let Some(head) = readers[index].next(&runs)? {
            heads[index] = head;
            heap.push(Reverse((head.order, index)));
        }
        match &mut sum {
            Some(sum) if sum.order == order => sum.add(&record),
            _ => {
                if let Some(whole) = sum.replace(record) {
                    take(whole)?;
                }
            }
        }
    }
    sum.map_or(Ok(()), take)
}
