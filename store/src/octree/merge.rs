//! Runs of records in a scratch file, and their merge into leaves.
//!
//! ```text
//! run   = blocks of up to 128 records: seal (`crate::scratch`), LZ4
//! merge = a heap over the runs' next records, equal ones summed
//! ```
//!
//! Invariants: 1. a block is named by its run and its number in it; 2. records of one leaf and material are summed in
//! the order of runs (file, chunk, number), whoever wrote them first; 3. memory is one block per run.

use super::record::Record;
use super::{VoxelGrid, leaf_key};
use crate::error::Result;
use crate::scratch::{Place, SEAL_BYTES, ScratchFile, seal};
use std::cmp::Reverse;
use std::collections::{BTreeSet, BinaryHeap};
use std::path::PathBuf;
use std::sync::Mutex;

/// Records of a block.
const BLOCK: usize = 128;
/// Most bytes of one.
const BLOCK_BYTES_MOST: usize =
    SEAL_BYTES + lz4_flex::block::get_maximum_output_size(BLOCK * size_of::<Record>());
/// Bytes that are copied at a time.
const COPY_BYTES: u64 = 1 << 20;
/// Bytes of memory per run while runs are merged.
pub(crate) const RUN_BYTES: u64 = (BLOCK * size_of::<Record>() * 2) as u64;

/// The runs of all chunks.
pub(crate) struct VoxelRuns {
    file: ScratchFile,
    written: Mutex<VoxelRunTable>,
}

/// How much there is to be merged.
pub(crate) struct RunsSize {
    pub(crate) bytes: u64,
    pub(crate) run_count: u64,
}

/// Where runs stand.
#[derive(Default)]
pub(crate) struct VoxelRunTable {
    end: u64,
    runs: Vec<VoxelRun>,
}

impl VoxelRunTable {
    /// What the words of [`VoxelRuns::synced`] tell; `None` where they tell nonsense.
    pub(crate) fn parse(words: &[u64]) -> Option<VoxelRunTable> {
        let (&end, mut words) = words.split_first()?;
        let mut runs = Vec::new();
        while let Some((&[order, offset, record_count], rest)) = words.split_first_chunk() {
            let record_count = usize::try_from(record_count).ok().filter(|&count| count > 0)?;
            let (blocks, rest) = rest.split_at_checked(record_count.div_ceil(BLOCK))?;
            let is_block = |bytes: &u64| (SEAL_BYTES as u64..=BLOCK_BYTES_MOST as u64).contains(bytes);
            let blocks = blocks.iter().map(|bytes| is_block(bytes).then_some(*bytes as u32));
            let blocks = blocks.collect::<Option<Vec<u32>>>()?;
            let bytes = blocks.iter().map(|&bytes| u64::from(bytes)).sum();
            offset.checked_add(bytes).filter(|&run_end| run_end <= end)?;
            let order = RunOrder { chunk: (order >> 32) as u32, number: order as u32 };
            runs.push(VoxelRun { order, offset, blocks, record_count });
            words = rest;
        }
        words.is_empty().then_some(VoxelRunTable { end, runs })
    }

    /// Whether they are runs of the first `chunk_count` chunks, of each at least one.
    pub(crate) fn is_of(&self, chunk_count: usize) -> bool {
        let chunks: BTreeSet<u32> = self.runs.iter().map(|run| run.order.chunk).collect();
        let orders: BTreeSet<RunOrder> = self.runs.iter().map(|run| run.order).collect();
        let is_below = chunks.last().is_none_or(|&last| (last as usize) < chunk_count);
        is_below && chunks.len() == chunk_count && orders.len() == self.runs.len()
    }

    /// Bytes of the scratch file.
    pub(crate) fn bytes(&self) -> u64 {
        self.end
    }

    /// Count of runs.
    pub(crate) fn run_count(&self) -> u64 {
        self.runs.len() as u64
    }

    /// The runs of a file in which they stand `offset` bytes further on; there is room for that.
    pub(crate) fn behind(mut self, offset: u64) -> VoxelRunTable {
        self.end += offset;
        self.runs.iter_mut().for_each(|run| run.offset += offset);
        self
    }
}

/// The place of a run in the order: by chunk, then by when it was full.
#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct RunOrder {
    pub(super) chunk: u32,
    /// Runs of the chunk before it.
    pub(super) number: u32,
}

/// A run: its place in the order, and where its blocks stand.
struct VoxelRun {
    order: RunOrder,
    offset: u64,
    /// Bytes of each block.
    blocks: Vec<u32>,
    record_count: usize,
}

impl VoxelRun {
    fn bytes(&self) -> u64 {
        self.blocks.iter().map(|&bytes| u64::from(bytes)).sum()
    }

    /// Appends what a table tells of a run that stands at `offset`.
    fn tell(&self, offset: u64, words: &mut Vec<u64>) {
        let order = u64::from(self.order.chunk) << 32 | u64::from(self.order.number);
        words.extend([order, offset, self.record_count as u64]);
        words.extend(self.blocks.iter().map(|&bytes| u64::from(bytes)));
    }
}

impl VoxelRuns {
    /// No runs yet, in the scratch file of a place.
    pub(crate) fn at(place: Place) -> Result<VoxelRuns> {
        Ok(VoxelRuns { file: ScratchFile::at(place)?, written: Mutex::default() })
    }

    /// The runs that a fragment of a build says to hold.
    pub(crate) fn of_fragment(path: PathBuf, written: VoxelRunTable) -> Result<VoxelRuns> {
        Ok(VoxelRuns { file: ScratchFile::of_fragment(path)?, written: Mutex::new(written) })
    }

    /// Bytes of the words of [`VoxelRuns::synced`], at most.
    pub(crate) fn word_bytes(&self) -> u64 {
        let written = self.written.lock().expect("no panic while held");
        let words: usize = written.runs.iter().map(|run| 3 + run.blocks.len()).sum();
        8 * (1 + words as u64)
    }

    /// Waits until all runs are on the disk, and tells in words where those of the first `chunk_count` chunks are. The
    /// words are for [`VoxelRunTable::parse`].
    pub(crate) fn synced(&self, chunk_count: u32) -> Result<Vec<u64>> {
        self.file.sync()?;
        let written = self.written.lock().expect("no panic while held");
        let mut words = vec![written.end];
        for run in written.runs.iter().filter(|run| run.order.chunk < chunk_count) {
            run.tell(run.offset, &mut words);
        }
        Ok(words)
    }

    /// Takes the runs that a build before this has written.
    pub(crate) fn restore(&mut self, left: VoxelRunTable) {
        *self.written.get_mut().expect("no panic while held") = left;
    }

    /// Hands the bytes of all runs to `put`, in their order, whoever wrote them first; gives words for
    /// [`VoxelRunTable::parse`] that tell where they are then.
    pub(crate) fn copy_in_order(&self, mut put: impl FnMut(&[u8]) -> Result<()>) -> Result<Vec<u64>> {
        let written = self.written.lock().expect("no panic while held");
        let mut runs: Vec<&VoxelRun> = written.runs.iter().collect();
        runs.sort_unstable_by_key(|run| run.order);
        let (mut words, mut copied, mut piece) = (vec![0], 0, vec![0; COPY_BYTES as usize]);
        for run in runs {
            run.tell(copied, &mut words);
            let bytes = run.bytes();
            for at in (0..bytes).step_by(COPY_BYTES as usize) {
                let piece = &mut piece[..COPY_BYTES.min(bytes - at) as usize];
                self.file.read_plain(run.offset + at, piece)?;
                put(piece)?;
            }
            copied += bytes;
        }
        words[0] = copied;
        Ok(words)
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
        written.runs.push(VoxelRun { order, offset, blocks, record_count: records.len() });
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
struct RunReader {
    /// Which file it is in.
    file: usize,
    run: VoxelRun,
    next_block: usize,
    block: Vec<Record>,
    at: usize,
    least: u64,
}

/// What records of a model can speak of: a left-over may have been sealed by somebody else.
pub(crate) struct RecordBounds {
    /// Bits that keys of leaves have.
    keys: u64,
    material_count: usize,
}

impl RecordBounds {
    /// The leaves of a grid, for a model with so many materials.
    pub(crate) fn new(grid: &VoxelGrid, material_count: usize) -> RecordBounds {
        RecordBounds { keys: leaf_key([grid.resolution - 1; 3], grid.depth()), material_count }
    }

    fn has(&self, record: &Record) -> bool {
        record.key() & !self.keys == 0
            && usize::from(record.material()) < self.material_count
            && record.bitmap != 0
            && record.is_finite()
    }
}

impl RunReader {
    /// The next record, if there is one, which stands behind the one before it.
    fn next(&mut self, files: &[VoxelRuns], known: &RecordBounds) -> Result<Option<Record>> {
        let runs = &files[self.file];
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
        let record = self.block[self.at];
        if record.order < self.least || !known.has(&record) {
            return Err(runs.file.damaged(self.run.offset));
        }
        (self.at, self.least) = (self.at + 1, record.order);
        Ok(Some(record))
    }
}

/// Calls `take` for each pair of leaf and material, in order, summed. The chunks of a file stand behind those of the
/// files before it.
pub(crate) fn merge(
    mut files: Vec<VoxelRuns>,
    known: &RecordBounds,
    mut take: impl FnMut(Record) -> Result<()>,
) -> Result<()> {
    let mut readers = Vec::new();
    for (file, runs) in files.iter_mut().enumerate() {
        let mut all = std::mem::take(&mut runs.written.get_mut().expect("no panic while held").runs);
        all.sort_unstable_by_key(|run| run.order);
        let reader = |run| RunReader { file, run, next_block: 0, block: Vec::new(), at: 0, least: 0 };
        readers.extend(all.into_iter().map(reader));
    }
    let mut heads = Vec::with_capacity(readers.len());
    let mut heap = BinaryHeap::with_capacity(readers.len());
    for (index, reader) in readers.iter_mut().enumerate() {
        let head = reader.next(&files, known)?.expect("runs are not empty");
        heap.push(Reverse((head.order, index)));
        heads.push(head);
    }
    let mut sum: Option<Record> = None;
    while let Some(Reverse((order, index))) = heap.pop() {
        let record = heads[index];
        if let Some(head) = readers[index].next(&files, known)? {
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
