//! `MergedStrips`: a picture out of its parts, made strip by strip while it is written.
//!
//! ```text
//! parts, in order of their samples     a strip of 16 rows is a film of two rows of tiles
//!   block of a row of tiles  --+
//!   block of other tiles     --+-> film of a strip -> filter, which sees the strip below, too -> PNG or EXR
//!   block of other samples   --+
//! ```
//!
//! Invariants: 1. two strips are there at a time, however high the picture: [`merge_bytes`] is all that is taken; 2.
//! sums are added in the order of samples, so the bytes depend on the cut alone; parts by tiles give the bytes of the
//! whole; 3. a block is believed once its hash is right, also where a file was replaced after its head was read.

use crate::encode::{STRIP_LINES, Strips, encoder_bytes};
use crate::film::{Film, Layers, add_radiance, block_bytes, block_bytes_most, portion_bytes};
use crate::filter::{STRIP_ROWS, Window, filter_bytes};
use crate::lens::Lens;
use crate::part::{BLOCK_HASH_BYTES, PartHead, damaged, head_bytes, read_block};
use crate::portion::Portion;
use crate::tile::{TILE_SIDE_PIXELS, tile_count};
use rayon::ThreadPool;
use std::collections::VecDeque;
use std::io::{self, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};
use trex_store::{Budget, Error, Interrupt, Lease, Result};

/// Rows of tiles in a strip.
const STRIP_TILES: u32 = STRIP_LINES / TILE_SIDE_PIXELS;
/// Strips that are there at a time: the one that is written, and the one below that the filter sees.
const STRIPS: u64 = 2;

const _: () =
    assert!(STRIP_LINES.is_multiple_of(TILE_SIDE_PIXELS) && TILE_SIDE_PIXELS as usize == STRIP_ROWS);

/// A part file whose head was read.
#[derive(Debug)]
pub struct PartFile<R> {
    path: PathBuf,
    portion: Portion,
    head_hash: u64,
    /// Open while its rows are read; with the byte where the next block begins.
    open: Option<(R, u64)>,
}

/// What a picture is merged from, and what with.
pub struct MergeSetup<'a, R> {
    /// The head of any of the parts.
    pub head: &'a PartHead,
    /// The parts, which make the picture: each sample of each tile is in one of them.
    pub parts: Vec<PartFile<R>>,
    /// Opens the file of a part; gives its length, too.
    pub open: fn(&Path) -> Result<(R, u64)>,
    /// Where the pixels look.
    pub lens: &'a dyn Lens,
    /// The threads of the filter.
    pub pool: &'a ThreadPool,
    /// Asked once a strip.
    pub interrupt: &'a Interrupt,
}

/// A picture that is merged while it is written.
pub struct MergedStrips<'a, R> {
    setup: MergeSetup<'a, R>,
    strips: VecDeque<Film>,
    /// Rows of strips that were merged, and that the filter has seen.
    merged_to: u32,
    seen_to: u32,
    window: Option<Window>,
    block: Vec<u8>,
    /// Leases of strips to come.
    spare: Vec<Lease>,
    _lease: Lease,
    radiance: [f64; 3],
    failure: Option<Error>,
}

/// Bytes that it takes to merge a picture from so many parts and to write it, all told.
pub fn merge_bytes(resolution: [u32; 2], layers: Layers, part_count: usize) -> u64 {
    let filter = if layers.filter { filter_bytes(resolution) } else { 0 };
    let parts = part_count * PART_BYTES;
    let working = filter + block_bytes_most(resolution, layers) + encoder_bytes(resolution, layers);
    STRIPS * strip_bytes(resolution, layers) + working + parts as u64
}

/// Bytes of a part: its entry, its name, and a buffer of a file that is open.
const PART_BYTES: usize = 16 << 10;

fn strip_bytes(resolution: [u32; 2], layers: Layers) -> u64 {
    portion_bytes(resolution, layers, &strip_portion(resolution, 0))
}

/// The tiles of the strip that begins with a row of tiles.
fn strip_portion(resolution: [u32; 2], tile_row: u32) -> Portion {
    let columns = resolution[0].div_ceil(TILE_SIDE_PIXELS);
    let tiles = [tile_row, tile_row + STRIP_TILES].map(|row| (row * columns).min(tile_count(resolution)));
    Portion { tiles, samples: [0, 0] }
}

impl<R: Read> PartFile<R> {
    /// The part at `path`, whose head says this portion, and has this hash.
    pub fn new(path: &Path, (portion, head_hash): (Portion, u64)) -> PartFile<R> {
        PartFile { path: path.to_path_buf(), portion, head_hash, open: None }
    }

    /// Adds what it has of a row of tiles to `film`.
    fn add_row(
        &mut self,
        (tile_row, head): (u32, &PartHead),
        open: fn(&Path) -> Result<(R, u64)>,
        (film, buffer): (&mut Film, &mut Vec<u8>),
    ) -> Result<()> {
        let rows = self.portion.tile_rows(head.resolution);
        if !rows.contains(&tile_row) {
            return Ok(());
        }
        if self.open.is_none() {
            let (mut file, file_bytes) = open(&self.path)?;
            let (found, hash) = PartHead::read(&self.path, &mut file, file_bytes)?;
            if hash != self.head_hash {
                let numbers = "it was replaced while the parts were merged".to_owned();
                return Err(damaged(&self.path, 0, numbers));
            }
            self.open = Some((file, head_bytes(&found)));
        }
        let (file, at) = self.open.as_mut().expect("it has just been opened");
        let bytes = block_bytes(head.resolution, head.layers, &self.portion, tile_row);
        buffer.resize(bytes as usize, 0);
        read_block(&self.path, file, (self.head_hash, tile_row, *at), buffer)?;
        if !film.add_block(tile_row, &self.portion, buffer) {
            return Err(damaged(&self.path, *at, format!("row {tile_row} of tiles: sums of no samples")));
        }
        *at += bytes + BLOCK_HASH_BYTES;
        if tile_row + 1 == rows.end {
            self.open = None;
        }
        Ok(())
    }
}

impl<'a, R: Read> MergedStrips<'a, R> {
    /// A picture to be merged.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when `budget` has no room for [`merge_bytes`].
    pub fn new(mut setup: MergeSetup<'a, R>, budget: &Budget) -> Result<MergedStrips<'a, R>> {
        let (resolution, layers) = (setup.head.resolution, setup.head.layers);
        let bytes = merge_bytes(resolution, layers, setup.parts.len());
        let mut lease = budget.lease("the strips of a picture that is merged", bytes)?;
        setup.parts.sort_by_key(|part| (part.portion.samples, part.portion.tiles));
        let size = resolution.map(|side| side as usize);
        Ok(MergedStrips {
            window: layers.filter.then(|| Window::new(size, setup.head.spp)),
            strips: VecDeque::new(),
            merged_to: 0,
            seen_to: 0,
            block: Vec::with_capacity(block_bytes_most(resolution, layers) as usize),
            spare: (0..STRIPS).map(|_| lease.split(strip_bytes(resolution, layers))).collect(),
            _lease: lease,
            radiance: [0.0; 3],
            failure: None,
            setup,
        })
    }

    /// Mean radiance over all pixels of the strips that were asked for, as [`Film::mean`].
    pub fn mean(&self) -> [f64; 3] {
        let [width, height] = self.setup.head.resolution.map(f64::from);
        self.radiance.map(|sum| sum / (width * height))
    }

    /// Why a strip could not be made, which the writer's error does not say in full.
    pub fn take_failure(&mut self) -> Option<Error> {
        self.failure.take()
    }

    /// Makes the strip from row `first` on the first of those that are there.
    fn advance(&mut self, first: u32) -> Result<()> {
        self.setup.interrupt.check()?;
        let height = self.setup.head.resolution[1];
        let rows = first..height.min(first + STRIP_LINES);
        let before = if first > 0 { self.strips.pop_front() } else { None };
        self.spare.extend(before.map(|mut strip| {
            let lease = strip.lease_mut();
            lease.split(lease.bytes())
        }));
        let view_end = self.end_of_view(rows.end);
        while self.merged_to < view_end {
            let strip = self.merge_strip(self.merged_to / TILE_SIDE_PIXELS)?;
            self.merged_to = strip.rows().end;
            self.strips.push_back(strip);
        }
        self.smooth(rows.clone());
        let strip = &self.strips[0];
        for y in rows {
            for x in 0..self.setup.head.resolution[0] {
                add_radiance(&mut self.radiance, strip.radiance([x, y]));
            }
        }
        Ok(())
    }

    /// The end of the rows that have to be there for those before `end`.
    fn end_of_view(&self, end: u32) -> u32 {
        self.window.as_ref().map_or(end, |window| window.end_of_view(end as usize) as u32)
    }

    /// The film of a strip, with all samples.
    fn merge_strip(&mut self, tile_row: u32) -> Result<Film> {
        let MergeSetup { head, parts, open, .. } = &mut self.setup;
        let portion = strip_portion(head.resolution, tile_row);
        let lease = self.spare.pop().expect("two strips at a time");
        let mut film = Film::of_portion(head.resolution, head.layers, portion, lease);
        for row in portion.tile_rows(head.resolution) {
            for part in parts.iter_mut() {
                part.add_row((row, head), *open, (&mut film, &mut self.block))?;
            }
        }
        film.count_samples(head.spp);
        Ok(film)
    }

    /// Smooths these rows of the first strip, where the picture is filtered.
    fn smooth(&mut self, rows: Range<u32>) {
        let MergeSetup { lens, pool, head, .. } = &self.setup;
        let Some(window) = &mut self.window else { return };
        let (strips, seen_to, height) = (&mut self.strips, &mut self.seen_to, head.resolution[1]);
        pool.install(|| {
            for first in rows.step_by(STRIP_ROWS) {
                let strip = first as usize..height.min(first + TILE_SIDE_PIXELS) as usize;
                let view_end = window.end_of_view(strip.end) as u32;
                for film in strips.iter() {
                    let rows = film.rows().start.max(*seen_to)..film.rows().end.min(view_end);
                    if !rows.is_empty() {
                        window.see(film, *lens, rows.start as usize..rows.end as usize);
                    }
                }
                *seen_to = view_end;
                window.smooth(strip.start, strips[0].smoothed_mut(strip), &|| false);
            }
        });
        strips[0].set_smooth();
    }
}

impl<R: Read> Strips for MergedStrips<'_, R> {
    type Image = Film;

    fn resolution(&self) -> [u32; 2] {
        self.setup.head.resolution
    }

    fn layers(&self) -> Layers {
        self.setup.head.layers
    }

    fn strip(&mut self, first: u32) -> io::Result<&Film> {
        if let Err(error) = self.advance(first) {
            let told = io::Error::other(error.to_string());
            self.failure = Some(error);
            return Err(told);
        }
        Ok(&self.strips[0])
    }
}

#[cfg(test)]
mod tests;
