//! `VertexCache`: the vertex array of an indexed input, larger than memory, looked up by index.
//!
//! Vertices lie in blocks of [`BLOCK_VERTICES`]. A directory names the frame that holds a block, if any; a clock
//! finds the frame to give up. Where the blocks come from:
//!
//! ```text
//! binary PLY, fixed stride   the input itself, at first_byte + index * stride; blocks are read, never written
//! text, lists among them     appended by the reader; a block goes to an unlinked file when its frame is given up
//! ```
//!
//! So an array that fits is held whole, is read once and touches no scratch file: there is no second path for it.
//!
//! Invariants: 1. frames never exceed the cap, and each is leased; where the budget has no more, the cache lives
//! with what it has; 2. a position read back is the one that was given, bit for bit; 3. a block is in at most one
//! frame, and `frame_of_block` and `CachedBlock::block` agree.
//!
//! The page cache of blocks is left to the kernel, unlike that of the stream: dropping it made a shuffled mesh wait
//! for the disk at every miss.

use super::ImportOptions;
use super::scalar::{ByteOrder, Scalar};
use crate::budget::Lease;
use crate::error::{Code, Error, Result};
use crate::scratch::{SEAL_BYTES, ScratchFile, seal};
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;

/// Vertices of a block: 6 KiB of f32. Blocks of 2048 were 4 times dearer where triangles jump about, since a miss
/// moves a whole block for one vertex, and no cheaper where they do not.
pub(in crate::import) const BLOCK_VERTICES: usize = 512;

/// Most bytes of a vertex in the input that is read in place; a block is then at most 128 KiB of input. Wider
/// ones (some hundred properties) are appended like text.
pub(in crate::import) const MAX_STRIDE_BYTES: u64 = 256;

/// Frames that are kept whatever the cap says.
const MIN_FRAMES: usize = 2;

/// Bytes of a block in the scratch file.
const SPOOL_BLOCK_BYTES: usize = SEAL_BYTES + BLOCK_VERTICES * 24;

/// Directory entry of a block that no frame holds.
const NO_FRAME: u32 = u32::MAX;

/// Block of a frame that holds none.
const NO_BLOCK: usize = usize::MAX;

/// Bytes charged per frame beside its positions, and per block for the directory; both as grown vectors take.
const FRAME_OVERHEAD_BYTES: u64 = 128;
const DIRECTORY_BYTES_PER_BLOCK: u64 = 8;

/// Where the position lies in a vertex of fixed size.
#[derive(Clone, Copy, Debug)]
pub(in crate::import) struct VertexLayout {
    /// Bytes from a vertex to the next.
    pub(in crate::import) stride: usize,
    /// Offset and type of x, y and z.
    pub(in crate::import) axes: [(usize, Scalar); 3],
    /// Order of the bytes.
    pub(in crate::import) order: ByteOrder,
}

impl VertexLayout {
    /// Bytes of a vertex that are read. The last one of an array may end with them.
    fn row_bytes(&self) -> usize {
        self.axes.iter().map(|(offset, scalar)| offset + scalar.size()).max().unwrap_or(0)
    }
}

/// Vertex positions by index.
pub(in crate::import) struct VertexCache {
    backing: Backing,
    count: u64,
    frame_of_block: Vec<u32>,
    frames: Vec<CachedBlock>,
    frame_cap: usize,
    hand: usize,
    staging: Vec<u8>,
    lookups: u64,
    misses: u64,
    lease: Lease,
}

enum Backing {
    Input { file: File, path: PathBuf, first_byte: u64, layout: VertexLayout },
    Spool { scratch: Option<ScratchFile>, folder: PathBuf },
}

struct CachedBlock {
    block: usize,
    cells: Positions,
    /// Looked up since the hand last came by.
    referenced: bool,
    /// Holds what the scratch file does not.
    dirty: bool,
}

/// Positions of a block; single where that loses nothing.
enum Positions {
    Single(Box<[[f32; 3]]>),
    Double(Box<[[f64; 3]]>),
}

impl VertexCache {
    /// The `count` vertices that lie in `file` from `first_byte` on. The caller has checked that they fit in it, up
    /// to the end of the last one's position.
    pub(in crate::import) fn in_input(
        file: (File, PathBuf),
        first_byte: u64,
        count: u64,
        layout: VertexLayout,
        options: &ImportOptions,
    ) -> Result<VertexCache> {
        assert!(layout.stride as u64 <= MAX_STRIDE_BYTES, "a vertex too wide to be read in place");
        let (file, path) = file;
        let backing = Backing::Input { file, path, first_byte, layout };
        let mut cache = VertexCache::new(backing, BLOCK_VERTICES * layout.stride, options)?;
        let blocks = count.div_ceil(BLOCK_VERTICES as u64);
        cache.lease.grow("the vertex directory", blocks * DIRECTORY_BYTES_PER_BLOCK)?;
        cache.frame_of_block = vec![NO_FRAME; blocks as usize];
        cache.count = count;
        Ok(cache)
    }

    /// An array that grows by [`VertexCache::push`].
    pub(in crate::import) fn growing(options: &ImportOptions) -> Result<VertexCache> {
        VertexCache::new(
            Backing::Spool { scratch: None, folder: options.temp_dir.clone() },
            SPOOL_BLOCK_BYTES,
            options,
        )
    }

    fn new(backing: Backing, staging_bytes: usize, options: &ImportOptions) -> Result<VertexCache> {
        let lease = options.budget.lease("the vertex cache", staging_bytes as u64)?;
        let mut cache = VertexCache {
            backing,
            count: 0,
            frame_of_block: Vec::new(),
            frames: Vec::new(),
            frame_cap: 0,
            hand: 0,
            staging: vec![0; staging_bytes],
            lookups: 0,
            misses: 0,
            lease,
        };
        // u32::MAX names no frame, so there are never as many.
        let fit = options.vertex_cache_bytes / cache.frame_bytes();
        cache.frame_cap = fit.clamp(MIN_FRAMES as u64, u64::from(u32::MAX) - 1) as usize;
        Ok(cache)
    }

    /// Vertices in the array.
    pub(in crate::import) fn count(&self) -> u64 {
        self.count
    }

    /// Look-ups so far, and those that read the disk.
    pub(in crate::import) fn lookups_and_misses(&self) -> (u64, u64) {
        (self.lookups, self.misses)
    }

    /// Counts from zero again.
    pub(in crate::import) fn reset_counters(&mut self) {
        (self.lookups, self.misses) = (0, 0);
    }

    /// The position of vertex `index`, which is below `count()`.
    #[inline]
    pub(in crate::import) fn get(&mut self, index: u64) -> Result<[f64; 3]> {
        debug_assert!(index < self.count);
        self.lookups += 1;
        let frame = self.frame_of((index / BLOCK_VERTICES as u64) as usize)?;
        let frame = &mut self.frames[frame];
        frame.referenced = true;
        Ok(frame.cells.get(index as usize % BLOCK_VERTICES))
    }

    /// Appends a vertex.
    pub(in crate::import) fn push(&mut self, position: [f64; 3]) -> Result<()> {
        let (block, cell) =
            ((self.count / BLOCK_VERTICES as u64) as usize, self.count as usize % BLOCK_VERTICES);
        let frame = if cell == 0 { self.begin_block(block)? } else { self.frame_of(block)? };
        let frame = &mut self.frames[frame];
        frame.dirty = true;
        match &mut frame.cells {
            Positions::Double(cells) => cells[cell] = position,
            Positions::Single(_) => unreachable!("only arrays that grow are pushed to, and these hold f64"),
        }
        self.count += 1;
        Ok(())
    }

    #[inline]
    fn frame_of(&mut self, block: usize) -> Result<usize> {
        match self.frame_of_block[block] {
            NO_FRAME => self.load(block),
            frame => Ok(frame as usize),
        }
    }

    fn begin_block(&mut self, block: usize) -> Result<usize> {
        debug_assert_eq!(block, self.frame_of_block.len());
        self.lease.grow("the vertex directory", DIRECTORY_BYTES_PER_BLOCK)?;
        self.frame_of_block.push(NO_FRAME);
        let frame = self.free_frame()?;
        self.bind(frame, block);
        Ok(frame)
    }

    #[cold]
    fn load(&mut self, block: usize) -> Result<usize> {
        self.misses += 1;
        let frame = self.free_frame()?;
        let cells = &mut self.frames[frame].cells;
        match &self.backing {
            Backing::Input { file, path, first_byte, layout } => {
                let first = (block * BLOCK_VERTICES) as u64;
                let vertices = (self.count - first).min(BLOCK_VERTICES as u64) as usize;
                let bytes = (vertices - 1) * layout.stride + layout.row_bytes();
                let raw = &mut self.staging[..bytes];
                let at = first_byte + first * layout.stride as u64;
                file.read_exact_at(raw, at).map_err(|error| match error.kind() {
                    std::io::ErrorKind::UnexpectedEof => {
                        Error::new(Code::InputTruncated, "the file became shorter while it was read")
                            .at_byte(path, at)
                            .numbers(format!("{bytes} bytes of vertices were here when it was opened"))
                            .next("wait until the program that writes it is done")
                    }
                    _ => Error::io("read vertices of the input", path, &error),
                })?;
                cells.decode(&self.staging[..vertices * layout.stride], layout);
            }
            Backing::Spool { scratch, .. } => {
                let scratch = scratch.as_ref().expect("a block without a frame has been written");
                let at = (block * SPOOL_BLOCK_BYTES) as u64;
                let content = scratch.read(at, SPOOL_BLOCK_BYTES, at, &mut self.staging)?;
                cells.decode(content, &SPOOL_LAYOUT);
            }
        }
        self.bind(frame, block);
        Ok(frame)
    }

    fn bind(&mut self, frame: usize, block: usize) {
        self.frames[frame].block = block;
        self.frames[frame].referenced = true;
        self.frame_of_block[block] = frame as u32;
    }

    /// A frame that holds no block: a new one while the cap and the budget allow, else the clock's choice.
    fn free_frame(&mut self) -> Result<usize> {
        if self.frames.len() < self.frame_cap {
            match self.lease.grow("the vertex cache", self.frame_bytes()) {
                Ok(()) => {
                    let cells = self.new_cells();
                    self.frames.push(CachedBlock { block: NO_BLOCK, cells, referenced: false, dirty: false });
                    return Ok(self.frames.len() - 1);
                }
                Err(error) if self.frames.len() < MIN_FRAMES => return Err(error),
                Err(_) => self.frame_cap = self.frames.len(),
            }
        }
        loop {
            let frame = self.hand;
            self.hand = (self.hand + 1) % self.frames.len();
            if !std::mem::take(&mut self.frames[frame].referenced) {
                self.write_back(frame)?;
                let block = std::mem::replace(&mut self.frames[frame].block, NO_BLOCK);
                if block != NO_BLOCK {
                    self.frame_of_block[block] = NO_FRAME;
                }
                return Ok(frame);
            }
        }
    }

    fn write_back(&mut self, frame: usize) -> Result<()> {
        let CachedBlock { block, cells: Positions::Double(cells), dirty: dirty @ true, .. } =
            &mut self.frames[frame]
        else {
            return Ok(());
        };
        let Backing::Spool { scratch, folder } = &mut self.backing else {
            unreachable!("blocks of the input are never written")
        };
        let values = self.staging[SEAL_BYTES..].chunks_exact_mut(8).zip(cells.as_flattened());
        values.for_each(|(raw, value)| raw.copy_from_slice(&value.to_le_bytes()));
        let at = (*block * SPOOL_BLOCK_BYTES) as u64;
        seal(&mut self.staging, at);
        let scratch = match scratch {
            Some(scratch) => scratch,
            none => none.insert(ScratchFile::create(folder)?),
        };
        scratch.write(&self.staging, at)?;
        *dirty = false;
        Ok(())
    }

    fn frame_bytes(&self) -> u64 {
        let cell_bytes = if self.holds_single() { 12 } else { 24 };
        (BLOCK_VERTICES * cell_bytes) as u64 + FRAME_OVERHEAD_BYTES
    }

    fn new_cells(&self) -> Positions {
        if self.holds_single() {
            Positions::Single(vec![[0.0; 3]; BLOCK_VERTICES].into())
        } else {
            Positions::Double(vec![[0.0; 3]; BLOCK_VERTICES].into())
        }
    }

    fn holds_single(&self) -> bool {
        match &self.backing {
            Backing::Input { layout, .. } => layout.axes.iter().all(|(_, scalar)| scalar.fits_f32()),
            Backing::Spool { .. } => false,
        }
    }
}

/// How a vertex lies in the scratch file.
const SPOOL_LAYOUT: VertexLayout = VertexLayout {
    stride: 24,
    axes: [(0, Scalar::F64), (8, Scalar::F64), (16, Scalar::F64)],
    order: ByteOrder::Little,
};

impl Positions {
    #[inline]
    fn get(&self, cell: usize) -> [f64; 3] {
        match self {
            Positions::Single(cells) => cells[cell].map(f64::from),
            Positions::Double(cells) => cells[cell],
        }
    }

    fn decode(&mut self, raw: &[u8], layout: &VertexLayout) {
        let vertices = raw.chunks_exact(layout.stride);
        match self {
            Positions::Single(cells) => {
                for (cell, vertex) in cells.iter_mut().zip(vertices) {
                    *cell = layout
                        .axes
                        .map(|(offset, scalar)| scalar.number(&vertex[offset..], layout.order) as f32);
                }
            }
            Positions::Double(cells) => {
                for (cell, vertex) in cells.iter_mut().zip(vertices) {
                    *cell =
                        layout.axes.map(|(offset, scalar)| scalar.number(&vertex[offset..], layout.order));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests;
