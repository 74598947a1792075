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
//! A pass may be run in pieces (`Until`): by a deadline, or until some tiles are done. Then tiles that find no room
//! among the parked ones are deferred to the end of the pass, so that what can be drawn is drawn first, and what is
//! blocked shows a stand-in.
//!
//! Why it ends, however few frames there are: a blocked sample keeps what it has (see [`crate::integrator`]), so only
//! rays count. In the narrow mode a worker wants the pages of ONE ray; it calls `begin_tile` only when that ray was
//! answered, so the tracer may keep each page that came for it; every retry finds at least one page more, and a
//! ray crosses finitely many. What it takes is room for the pages of one ray per worker: that is the pool's
//! smallest limit. A deadline interrupts it, and the next piece goes on with it. A page that cannot be had must be
//! answered for (a stand-in, an error), never Blocked for ever.
//!
//! Invariants: 1. the film's bytes depend on the world and the sample count alone, not on threads, tile order, deadlines or
//! blocked rays; 2. at most [`PARKED_MAX`] tiles wait per worker; 3. a tile's samples reach the film all together
//! or not at all, so a stopped pass leaves a film that can go on; 4. a stand-in never reaches the film.

use crate::film::{Film, LayerPixel};
use crate::footprint::Together;
use crate::g_batch::GBatches;
use crate::integrator::{Integrator, Path, RayCounts, Sample, Step};
use crate::live::Shown;
use crate::tile::{TILE_SIDE_PIXELS, Tile, Tiles};
use crate::trace::{Answer, Tracer};
use std::collections::VecDeque;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Most samples of a pixel in one pass: enough work per tile to pay for its pages, little enough to hold.
pub const PASS_SAMPLES_MAX: u32 = 4;
/// Most tiles of a worker that wait for pages: about what a disk queue takes, at some requests a tile.
pub const PARKED_MAX: usize = 8;
/// Rounds over the parked tiles without one answer, after each of which pages were waited for, before the narrow
/// mode: late pages are more likely than lack of room.
const STALLED_ROUNDS: u32 = 4;

/// Longest sleep for pages: arrivals wake it earlier.
const WAIT: Duration = Duration::from_millis(50);

/// Who guesses which pages will be wanted. Each has its own counters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Predictor {
    /// What lies beside the pages in use.
    Neighbours,
    /// What the camera will see, should it go on as it went.
    Camera,
    /// What the next tiles need.
    Tiles,
}

/// What the frame loop needs besides answers: pages come and go.
pub trait PagedTracer: Tracer {
    /// Called when a tile starts or resumes: pins of the previous tile may be dropped. Until the next call, pages
    /// that were resident when a ray asked for them should stay, as far as there is room.
    fn begin_tile(&mut self, tile: u32);

    /// Hands the pages recorded since the last call to the loader. Returns how many are awaited.
    fn request_missing(&mut self) -> usize;

    /// Sleeps until something has arrived, or for `longest`.
    fn wait(&mut self, longest: Duration);

    /// Hands the pages recorded since the last call to the loader as guesses, in place of this predictor's earlier ones;
    /// for [`Predictor::Neighbours`], those beside the pages in use.
    fn prefetch(&mut self, _predictor: Predictor) {}

    /// Adds the pages asked for since [`PagedTracer::forget_demand`] to `pages`, a bit each; gives the count of frames,
    /// 0 where all pages have one.
    fn demand(&self, _pages: &mut Vec<u64>) -> usize {
        0
    }

    /// Begins to count anew.
    fn forget_demand(&mut self) {}
}

/// What a pass did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PassStats {
    /// Rays of finished samples.
    pub rays: RayCounts,
    /// Look-ups of photons of finished samples.
    pub look_ups: u64,
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
    /// Tiles whose samples reached the film.
    pub tiles_finished: u64,
    /// Tiles that have not had their samples yet.
    pub tiles_left: u64,
}

impl PassStats {
    /// Adds another pass or worker.
    pub fn add(&mut self, other: &PassStats) {
        self.rays.add(&other.rays);
        self.look_ups += other.look_ups;
        self.samples += other.samples;
        self.parked += other.parked;
        self.waits += other.waits;
        self.narrow_samples += other.narrow_samples;
        self.not_finite += other.not_finite;
        self.tiles_finished += other.tiles_finished;
        self.tiles_left = other.tiles_left;
    }
}

/// Bytes that the frame loop takes for `worker_count` workers and the tile order, films not counted.
pub fn frame_bytes(resolution: [u32; 2], worker_count: usize) -> u64 {
    let samples = (TILE_SIDE_PIXELS * TILE_SIDE_PIXELS * PASS_SAMPLES_MAX) as usize;
    let job = samples * (size_of::<Pending>() + 2 * size_of::<[f32; 3]>())
        + (TILE_SIDE_PIXELS * TILE_SIDE_PIXELS) as usize * size_of::<([u32; 2], LayerPixel)>();
    // The order, and the deferred tiles.
    2 * Tiles::bytes(resolution)
        + (worker_count * (PARKED_MAX + 1) * job) as u64
        + worker_count as u64 * (GBatches::bytes(samples) + Together::bytes(samples))
}

/// When a piece of a pass ends, if not with the pass.
pub(crate) struct Until<'a> {
    /// Asked between tiles; once it says true no further tile is begun.
    pub(crate) stop: &'a (dyn Fn() -> bool + Sync),
    pub(crate) deadline: Option<Instant>,
    /// Finished tiles that are enough.
    pub(crate) tiles: u32,
}

/// A pass in work: takes every tile to so many samples a pixel, by at most [`PASS_SAMPLES_MAX`].
pub(crate) struct Pass {
    target: u32,
    /// The next tile's turn.
    turn: AtomicU32,
    /// Tiles that were blocked and found no room, to be begun again.
    deferred: Mutex<VecDeque<u32>>,
    lanes: Vec<Lane>,
}

/// What a worker keeps between pieces of a pass.
#[derive(Default)]
struct Lane {
    /// The oldest first.
    parked: VecDeque<Job>,
    /// The narrow mode was interrupted.
    is_narrow: bool,
}

impl Pass {
    /// A pass to `target` samples a pixel, for so many workers.
    pub(crate) fn new(target: u32, worker_count: usize) -> Pass {
        let lanes = (0..worker_count).map(|_| Lane::default()).collect();
        Pass { target, turn: AtomicU32::new(0), deferred: Mutex::default(), lanes }
    }

    /// Whether every tile has had its turn, and none waits.
    pub(crate) fn is_done(&self, tiles: &Tiles) -> bool {
        self.left(tiles) == 0
    }

    /// Whether a worker was interrupted while it narrowed down to one ray, whose pages it holds.
    pub(crate) fn is_narrow(&self) -> bool {
        self.lanes.iter().any(|lane| lane.is_narrow)
    }

    /// The turn of the next tile.
    pub(crate) fn turn(&self) -> u32 {
        self.turn.load(Ordering::Relaxed)
    }

    fn left(&self, tiles: &Tiles) -> u64 {
        let begun = self.turn().min(tiles.count());
        let waiting: usize = self.lanes.iter().map(|lane| lane.parked.len()).sum();
        let deferred = self.deferred.lock().expect("a worker panicked").len();
        u64::from(tiles.count() - begun) + (waiting + deferred) as u64
    }

    /// Goes on until the pass or the piece is over. A worker thread per tracer. With `shown` blocked tiles without samples
    /// get stand-ins there, and a blocked tile without room is deferred.
    ///
    /// # Panics
    /// When there are not as many tracers as workers, or a worker panics.
    pub(crate) fn run<T: PagedTracer + Send>(
        &mut self,
        (integrator, tiles): (&Integrator<'_>, &Tiles),
        (film, shown): (&mut Film, Option<&mut Shown>),
        tracers: &mut [T],
        until: &Until<'_>,
    ) -> PassStats {
        assert_eq!(tracers.len(), self.lanes.len(), "a pass needs a tracer per worker");
        let Pass { target, turn, deferred, lanes } = self;
        let piece = Piece {
            integrator,
            film: Mutex::new(film),
            shown: shown.map(Mutex::new),
            tiles,
            target: *target,
            until,
            turn,
            deferred,
            finished: AtomicU32::new(0),
        };
        let done = Mutex::new(PassStats::default());
        std::thread::scope(|scope| {
            for (tracer, lane) in tracers.iter_mut().zip(lanes) {
                scope.spawn(|| {
                    let (together, batches, stats) = Default::default();
                    let mut worker = Worker { piece: &piece, tracer, lane, together, batches, stats };
                    worker.work();
                    done.lock().expect("a worker panicked").add(&worker.stats);
                });
            }
        });
        let mut stats = done.into_inner().expect("a worker panicked");
        stats.tiles_left = self.left(tiles);
        stats
    }
}

/// What the workers of a piece share.
struct Piece<'a> {
    integrator: &'a Integrator<'a>,
    film: Mutex<&'a mut Film>,
    shown: Option<Mutex<&'a mut Shown>>,
    tiles: &'a Tiles,
    target: u32,
    until: &'a Until<'a>,
    turn: &'a AtomicU32,
    deferred: &'a Mutex<VecDeque<u32>>,
    finished: AtomicU32,
}

/// A tile in work.
struct Job {
    tile: Tile,
    /// Samples that its pixels have.
    from: u32,
    /// Samples not yet finished.
    pending: Vec<Pending>,
    /// By sample, then by pixel.
    radiances: Vec<[f32; 3]>,
    /// Of these what is indirect.
    indirect: Vec<[f32; 3]>,
    layers: Vec<([u32; 2], LayerPixel)>,
    rays: RayCounts,
    look_ups: u64,
    not_finite: u64,
}

/// A sample on its way.
struct Pending {
    /// Its place in the job's radiances.
    slot: u32,
    path: Path,
    /// It waits for pages, in the attempt at hand.
    is_blocked: bool,
}

struct Worker<'a, T> {
    piece: &'a Piece<'a>,
    tracer: &'a mut T,
    lane: &'a mut Lane,
    together: Together,
    batches: GBatches,
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

impl Piece<'_> {
    fn is_over(&self) -> bool {
        self.finished.load(Ordering::Relaxed) >= self.until.tiles
            || self.until.deadline.is_some_and(|deadline| Instant::now() >= deadline)
            || (self.until.stop)()
    }

    /// How long a worker may wait.
    fn longest_wait(&self) -> Duration {
        let left = self.until.deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
        left.map_or(WAIT, |left| left.min(WAIT))
    }

    /// The next tile that lacks samples: a fresh one, else a deferred one.
    fn next_job(&self, takes_deferred: bool) -> Option<Job> {
        loop {
            let turn = self.turn.fetch_add(1, Ordering::Relaxed);
            if turn >= self.tiles.count() {
                // Keeps the counter from running round in long waits.
                self.turn.store(self.tiles.count(), Ordering::Relaxed);
                break;
            }
            let tile = self.tiles.nth(turn);
            let from = self.film.lock().expect("a worker panicked").tile_samples(tile.index);
            if from < self.target {
                return Some(self.job(tile, from));
            }
        }
        let takes = || self.deferred.lock().expect("a worker panicked").pop_front();
        let tile = self.tiles.tile(if takes_deferred { takes() } else { None }?);
        let from = self.film.lock().expect("a worker panicked").tile_samples(tile.index);
        Some(self.job(tile, from))
    }

    fn job(&self, tile: Tile, from: u32) -> Job {
        let (count, pixels) = ((self.target - from).min(PASS_SAMPLES_MAX), tile.pixel_count());
        let pending = |slot: u32| {
            let path = self.integrator.start(tile.pixel(slot % pixels), from + slot / pixels);
            Pending { slot, path, is_blocked: false }
        };
        Job {
            tile,
            from,
            // The samples of a pixel together: rays that are alike are neighbours.
            pending: (0..count * pixels).map(|i| pending(i % count * pixels + i / count)).collect(),
            radiances: vec![[0.0; 3]; (count * pixels) as usize],
            indirect: vec![[0.0; 3]; (count * pixels) as usize],
            layers: vec![],
            rays: RayCounts::default(),
            look_ups: 0,
            not_finite: 0,
        }
    }

    /// Shows stand-ins for the pixels of a tile that waits, unless it shows better.
    fn show_stand_in(&self, job: &Job) {
        let Some(shown) = self.shown.as_ref().filter(|_| job.from == 0) else { return };
        if shown.lock().expect("a worker panicked").has_stand_in(&job.tile) {
            return;
        }
        let paths = job.pending.iter().map(|waiting| &waiting.path);
        let Some(stand_ins) = self.integrator.previews(paths) else { return };
        let mut shown = shown.lock().expect("a worker panicked");
        let pixels = job.tile.pixel_count();
        for (pixel, radiance) in job.radiances[..pixels as usize].iter().enumerate() {
            shown.set(job.tile.pixel(pixel as u32), *radiance);
        }
        for (waiting, radiance) in job.pending.iter().zip(stand_ins) {
            shown.set(job.tile.pixel(waiting.slot % pixels), radiance);
        }
        shown.mark_stand_in(&job.tile);
    }
}

impl<T: PagedTracer> Worker<'_, T> {
    fn work(&mut self) {
        let mut stalled = 0;
        // Pages have come since the last piece.
        if self.lane.is_narrow {
            self.narrow();
        } else {
            self.round();
        }
        while !self.piece.is_over() {
            let has_room = self.lane.parked.len() < PARKED_MAX;
            let may_take = has_room || self.piece.shown.is_some();
            if let Some(job) = if may_take { self.piece.next_job(has_room) } else { None } {
                self.attempt(job);
                continue;
            }
            if self.lane.parked.is_empty() {
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
    }

    /// Asks each parked tile once, the oldest first. True when anything was answered.
    fn round(&mut self) -> bool {
        let mut advanced = false;
        for _ in 0..self.lane.parked.len() {
            if self.piece.is_over() {
                break;
            }
            let job = self.lane.parked.pop_front().expect("parked tiles are counted");
            advanced |= self.attempt(job) != Attempt::Stuck;
        }
        advanced
    }

    /// Asks all samples of a tile, and adds it to the film, or parks or defers it.
    fn attempt(&mut self, mut job: Job) -> Attempt {
        self.tracer.begin_tile(job.tile.index);
        let integrator = self.piece.integrator;
        let batches = &mut self.batches;
        let mut advanced = false;
        let mut pending = std::mem::take(&mut job.pending);
        if !integrator.world.method.shows_voxels() {
            let paths = pending.iter_mut().map(|waiting| (&mut waiting.path, &mut waiting.is_blocked));
            integrator.meet_together(paths, self.tracer, &mut self.together);
        }
        loop {
            let mut asks = false;
            pending.retain_mut(|Pending { slot, path, is_blocked }| {
                if *is_blocked {
                    return true;
                }
                let before = path.answered();
                let step =
                    integrator.step(path, self.tracer, integrator.has_batches().then_some(&mut *batches));
                advanced |= path.answered() > before;
                match step {
                    Step::Blocked => *is_blocked = true,
                    Step::Asks => asks = true,
                    Step::Done(sample) => {
                        job.finish(*slot, &sample);
                        return false;
                    }
                }
                true
            });
            if !asks {
                break;
            }
            integrator.answer(batches);
        }
        batches.clear();
        for waiting in &mut pending {
            waiting.is_blocked = false;
        }
        job.pending = pending;
        if job.pending.is_empty() {
            self.commit(&job);
            return Attempt::Finished;
        }
        self.tracer.request_missing();
        self.piece.show_stand_in(&job);
        self.stats.parked += 1;
        if self.lane.parked.len() < PARKED_MAX {
            self.lane.parked.push_back(job);
        } else {
            self.piece.deferred.lock().expect("a worker panicked").push_back(job.tile.index);
        }
        if advanced { Attempt::Advanced } else { Attempt::Stuck }
    }

    /// Finishes one sample of the oldest tile with the pages of one ray at a time.
    fn narrow(&mut self) {
        self.lane.is_narrow = false;
        let Some(job) = self.lane.parked.front_mut() else { return };
        let Pending { slot, mut path, .. } = job.pending.remove(0);
        let tile = job.tile.index;
        self.tracer.begin_tile(tile);
        loop {
            let before = path.answered();
            let answer = self.piece.integrator.advance(&mut path, self.tracer);
            let job = self.lane.parked.front_mut().expect("the oldest tile stays");
            if let Answer::Exact(sample) = answer {
                job.finish(slot, &sample);
                self.stats.narrow_samples += 1;
                break;
            }
            if path.answered() > before {
                self.tracer.begin_tile(tile);
                continue;
            }
            if self.piece.is_over() {
                job.pending.insert(0, Pending { slot, path, is_blocked: false });
                self.lane.is_narrow = true;
                return;
            }
            self.tracer.request_missing();
            self.wait();
        }
        if self.lane.parked.front().is_some_and(|job| job.pending.is_empty()) {
            let job = self.lane.parked.pop_front().expect("the oldest tile stays");
            self.commit(&job);
        }
    }

    fn wait(&mut self) {
        self.stats.waits += 1;
        self.tracer.wait(self.piece.longest_wait());
    }

    fn commit(&mut self, job: &Job) {
        let mut film = self.piece.film.lock().expect("a worker panicked");
        film.add(&job.tile, &job.radiances);
        if film.layers().filter {
            film.add_indirect(&job.tile, &job.indirect);
        }
        for (pixel, seen) in &job.layers {
            film.set_layers(*pixel, seen);
        }
        drop(film);
        self.piece.finished.fetch_add(1, Ordering::Relaxed);
        self.stats.tiles_finished += 1;
        self.stats.samples += job.radiances.len() as u64;
        self.stats.not_finite += job.not_finite;
        self.stats.rays.add(&job.rays);
        self.stats.look_ups += job.look_ups;
    }
}

impl Job {
    fn finish(&mut self, slot: u32, sample: &Sample) {
        let finite = sample.radiance.iter().all(|x| x.is_finite());
        self.not_finite += u64::from(!finite);
        self.radiances[slot as usize] = if finite { sample.radiance } else { [0.0; 3] };
        self.indirect[slot as usize] = if finite { sample.indirect } else { [0.0; 3] };
        self.rays.add(&sample.rays);
        self.look_ups += sample.look_ups;
        if let Some(seen) = sample.layers {
            self.layers.push((self.tile.pixel(slot % self.tile.pixel_count()), seen));
        }
    }
}

#[cfg(test)]
#[path = "frame_tests.rs"]
mod tests;
