//! The frame loop: worker threads, tiles, and samples that wait for pages.
//!
//! ```text
//! per worker:  next tile in order -> ask all its samples -> done: add to the film
//!                                                        -> blocked: request pages, park it, next tile
//!              no more tiles, or PARKED_MAX parked: the parked ones again, the oldest first
//!              a round without one answer: wait; STALLED_ROUNDS of them: narrow
//! narrow:      one sample of the oldest tile, alone: ask one ray, request, wait, ask again, until it is done
//! ```
//!
//! Why it ends, however few frames there are: a blocked sample keeps what it has (see [`crate::integrator`]), so only
//! rays count. In the narrow mode a worker wants the pages of ONE ray; it calls `begin_tile` only when that ray was
//! answered, so the tracer may keep each page that came for it; every retry finds at least one page more, and a
//! ray crosses finitely many. What it takes is room for the pages of one ray per worker: that is the pool's
//! smallest limit. A page that cannot be had must be answered for (a stand-in, an error), never Blocked for ever.
//!
//! Invariants: 1. the film's bytes depend on the world and the sample count alone, not on threads, tile order or
//! blocked rays; 2. at most [`PARKED_MAX`] tiles wait per worker; 3. a tile's samples reach the film all together
//! or not at all, so a stopped pass leaves a film that can go on.

use crate::film::{Film, LayerPixel};
use crate::integrator::{Integrator, Path, RayCounts, Sample};
use crate::tile::{TILE_SIDE_PIXELS, Tile, Tiles};
use crate::trace::{Answer, Tracer};
use std::collections::VecDeque;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};

/// Most samples of a pixel in one pass: enough work per tile to pay for its pages, little enough to hold.
pub const PASS_SAMPLES_MAX: u32 = 4;
/// Most tiles of a worker that wait for pages: about what a disk queue takes, at some requests a tile.
pub const PARKED_MAX: usize = 8;
/// Rounds over the parked tiles without one answer, after each of which pages were waited for, before the narrow
/// mode: late pages are more likely than lack of room.
const STALLED_ROUNDS: u32 = 4;

/// What the frame loop needs besides answers: pages come and go.
pub trait PagedTracer: Tracer {
    /// Called when a tile starts or resumes: pins of the previous tile may be dropped. Until the next call, pages
    /// that were resident when a ray asked for them should stay, as far as there is room.
    fn begin_tile(&mut self, tile: u32);

    /// Hands the pages recorded since the last call to the loader. Returns how many are awaited.
    fn request_missing(&mut self) -> usize;

    /// Sleeps until something has arrived, for a bounded time.
    fn wait(&mut self);
}

/// What a pass did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PassStats {
    /// Rays of finished samples.
    pub rays: RayCounts,
    /// Samples that reached the film.
    pub samples: u64,
    /// Times that a tile had to be parked.
    pub parked: u64,
    /// Times that a worker waited for pages.
    pub waits: u64,
    /// Samples that had to be taken alone since their pages did not fit together.
    pub narrow_samples: u64,
    /// Samples whose radiance was not finite (light values near the end of f32); they count as black.
    pub not_finite: u64,
    /// Tiles that were left out since the pass was stopped.
    pub tiles_left: u64,
}

impl PassStats {
    /// Adds another pass or worker.
    pub fn add(&mut self, other: &PassStats) {
        self.rays.add(&other.rays);
        self.samples += other.samples;
        self.parked += other.parked;
        self.waits += other.waits;
        self.narrow_samples += other.narrow_samples;
        self.not_finite += other.not_finite;
        self.tiles_left += other.tiles_left;
    }
}

/// Bytes that the frame loop takes for `worker_count` workers and the tile order, films not counted.
pub fn frame_bytes(resolution: [u32; 2], worker_count: usize) -> u64 {
    let samples = (TILE_SIDE_PIXELS * TILE_SIDE_PIXELS * PASS_SAMPLES_MAX) as usize;
    let job = samples * (size_of::<(u32, Path)>() + size_of::<[f32; 3]>())
        + (TILE_SIDE_PIXELS * TILE_SIDE_PIXELS) as usize * size_of::<([u32; 2], LayerPixel)>();
    Tiles::bytes(resolution) + (worker_count * (PARKED_MAX + 1) * job) as u64
}

/// One pass: takes every tile to `target` samples a pixel, by at most [`PASS_SAMPLES_MAX`]. A worker thread per
/// tracer. `stop` is asked between tiles; once it says true no further tile is begun and waiting ones are left.
///
/// # Panics
/// When there is no tracer, or a worker panics.
pub fn render_pass<T: PagedTracer + Send>(
    integrator: &Integrator<'_>,
    film: &mut Film,
    tiles: &Tiles,
    tracers: &mut [T],
    target: u32,
    stop: &(dyn Fn() -> bool + Sync),
) -> PassStats {
    assert!(!tracers.is_empty(), "a pass needs a tracer");
    let pass = Pass { integrator, film: Mutex::new(film), tiles, target, stop, turn: AtomicU32::new(0) };
    let done = Mutex::new(PassStats::default());
    std::thread::scope(|scope| {
        for tracer in tracers {
            scope.spawn(|| {
                let mut worker =
                    Worker { pass: &pass, tracer, parked: VecDeque::new(), stats: PassStats::default() };
                worker.work();
                done.lock().expect("a worker panicked").add(&worker.stats);
            });
        }
    });
    let mut stats = done.into_inner().expect("a worker panicked");
    let begun = pass.turn.load(Ordering::Relaxed).min(tiles.count());
    stats.tiles_left += u64::from(tiles.count() - begun);
    stats
}

/// What the workers of a pass share.
struct Pass<'a> {
    integrator: &'a Integrator<'a>,
    film: Mutex<&'a mut Film>,
    tiles: &'a Tiles,
    target: u32,
    stop: &'a (dyn Fn() -> bool + Sync),
    /// The next tile's turn.
    turn: AtomicU32,
}

/// A tile in work.
struct Job {
    tile: Tile,
    /// Samples not yet finished: their place in `radiances`, and their state.
    pending: Vec<(u32, Path)>,
    /// By sample, then by pixel.
    radiances: Vec<[f32; 3]>,
    layers: Vec<([u32; 2], LayerPixel)>,
    rays: RayCounts,
    not_finite: u64,
}

struct Worker<'a, T> {
    pass: &'a Pass<'a>,
    tracer: &'a mut T,
    /// The oldest first.
    parked: VecDeque<Job>,
    stats: PassStats,
}

/// What an attempt at a job came to.
#[derive(PartialEq, Eq)]
enum Attempt {
    Finished,
    /// Some rays were answered.
    Advanced,
    /// None was.
    Stuck,
}

impl Pass<'_> {
    /// The next tile that lacks samples.
    fn next_job(&self) -> Option<Job> {
        loop {
            let turn = self.turn.fetch_add(1, Ordering::Relaxed);
            if turn >= self.tiles.count() {
                // Keeps the counter from running round in long waits.
                self.turn.store(self.tiles.count(), Ordering::Relaxed);
                return None;
            }
            let tile = self.tiles.nth(turn);
            let from = self.film.lock().expect("a worker panicked").tile_samples(tile.index);
            if from < self.target {
                return Some(self.job(tile, from));
            }
        }
    }

    fn job(&self, tile: Tile, from: u32) -> Job {
        let (count, pixels) = ((self.target - from).min(PASS_SAMPLES_MAX), tile.pixel_count());
        let path = |slot: u32| self.integrator.start(tile.pixel(slot % pixels), from + slot / pixels);
        Job {
            tile,
            pending: (0..count * pixels).map(|slot| (slot, path(slot))).collect(),
            radiances: vec![[0.0; 3]; (count * pixels) as usize],
            layers: vec![],
            rays: RayCounts::default(),
            not_finite: 0,
        }
    }
}

impl<T: PagedTracer> Worker<'_, T> {
    fn work(&mut self) {
        let mut stalled = 0;
        while !(self.pass.stop)() {
            let has_room = self.parked.len() < PARKED_MAX;
            if let Some(job) = if has_room { self.pass.next_job() } else { None } {
                self.attempt(job);
                continue;
            }
            if self.parked.is_empty() {
                return;
            }
            if self.round() {
                stalled = 0;
                continue;
            }
            self.wait();
            stalled += 1;
            if stalled >= STALLED_ROUNDS {
                self.narrow();
                stalled = 0;
            }
        }
        self.stats.tiles_left += self.parked.len() as u64;
    }

    /// Asks each parked tile once, the oldest first. True when anything was answered.
    fn round(&mut self) -> bool {
        let mut advanced = false;
        for _ in 0..self.parked.len() {
            let job = self.parked.pop_front().expect("parked tiles are counted");
            advanced |= self.attempt(job) != Attempt::Stuck;
        }
        advanced
    }

    /// Asks all samples of a tile, and parks it or adds it to the film.
    fn attempt(&mut self, mut job: Job) -> Attempt {
        self.tracer.begin_tile(job.tile.index);
        let integrator = self.pass.integrator;
        let mut advanced = false;
        let mut pending = std::mem::take(&mut job.pending);
        pending.retain_mut(|(slot, path)| {
            let before = path.answered();
            let answer = integrator.advance(path, self.tracer);
            advanced |= path.answered() > before;
            match answer {
                Answer::Blocked => true,
                Answer::Exact(sample) => {
                    job.finish(*slot, &sample);
                    false
                }
            }
        });
        job.pending = pending;
        if job.pending.is_empty() {
            self.commit(&job);
            return Attempt::Finished;
        }
        self.tracer.request_missing();
        self.stats.parked += 1;
        self.parked.push_back(job);
        if advanced { Attempt::Advanced } else { Attempt::Stuck }
    }

    /// Finishes one sample of the oldest tile with the pages of one ray at a time.
    fn narrow(&mut self) {
        let Some(job) = self.parked.front_mut() else { return };
        let (slot, mut path) = job.pending.remove(0);
        let tile = job.tile.index;
        self.tracer.begin_tile(tile);
        loop {
            let before = path.answered();
            if let Answer::Exact(sample) = self.pass.integrator.advance(&mut path, self.tracer) {
                let job = self.parked.front_mut().expect("the oldest tile stays");
                job.finish(slot, &sample);
                self.stats.narrow_samples += 1;
                break;
            }
            if path.answered() > before {
                self.tracer.begin_tile(tile);
                continue;
            }
            self.tracer.request_missing();
            self.wait();
            if (self.pass.stop)() {
                return;
            }
        }
        if self.parked.front().is_some_and(|job| job.pending.is_empty()) {
            let job = self.parked.pop_front().expect("the oldest tile stays");
            self.commit(&job);
        }
    }

    fn wait(&mut self) {
        self.stats.waits += 1;
        self.tracer.wait();
    }

    fn commit(&mut self, job: &Job) {
        let mut film = self.pass.film.lock().expect("a worker panicked");
        film.add(&job.tile, &job.radiances);
        for (pixel, seen) in &job.layers {
            film.set_layers(*pixel, seen);
        }
        drop(film);
        self.stats.samples += job.radiances.len() as u64;
        self.stats.not_finite += job.not_finite;
        self.stats.rays.add(&job.rays);
    }
}

impl Job {
    fn finish(&mut self, slot: u32, sample: &Sample) {
        let finite = sample.radiance.iter().all(|x| x.is_finite());
        self.not_finite += u64::from(!finite);
        self.radiances[slot as usize] = if finite { sample.radiance } else { [0.0; 3] };
        self.rays.add(&sample.rays);
        if let Some(seen) = sample.layers {
            self.layers.push((self.tile.pixel(slot % self.tile.pixel_count()), seen));
        }
    }
}

#[cfg(test)]
#[path = "frame_tests.rs"]
mod tests;
