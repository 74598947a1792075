//! The workers of a pass: each takes tiles through their C-rays, or many tiles through the G-stage; parks those that
//! wait for pages, and tries these again.
//!
//! ```text
//! a call is answered            -> its tiles on
//! a batch waits for the G-stage -> hand it over
//! else                          -> C-rays of the next tile
//! no tile to begin              -> what waits for the G-stage, however little; then wait for calls under way; then a
//!                                  round over what is parked
//! ```
//!
//! Invariants: 1. a worker parks at most [`parked_bytes`] of tiles and, once, those of the calls that others began;
//! 2. a tile with finished samples is never begun anew; 3. a tile's samples reach the film all together or not at all;
//! 4. a worker has at most as many calls under way as the stage asks for, and none when its piece is over.

use super::g_queue::{GQueue, batch_samples};
use super::job::{Job, PASS_SAMPLES_MAX};
use super::samples::{OpenSample, SampleWork};
use crate::g_stage::{GCall, GTurn};
use crate::integrate::Together;
use crate::stats::PassStats;
use crate::trace::{Advance, Answer, PagedTracer, Retry, WAIT};
use std::collections::VecDeque;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use trex_film::{Display, Film, Tiles};

/// Most tiles of a worker that wait for pages: about what a disk queue takes, at some requests a tile. More gain
/// nothing on a disk, where 32 read 6 to 7 % more pages.
const PARKED_MAX: usize = 8;
/// Most tiles of one sample a pixel that wait where pages come from afar, which is most of their time. Of more samples
/// as many as have room where these have.
const PARKED_FAR_MAX: usize = 64;
/// Tiles that wait take this part of a worker's frames at most, or pages go before their tiles come to them.
const PARKED_PART: usize = 4;

/// Bytes that a worker's tiles take while they wait for pages.
pub(super) fn parked_bytes(is_far: bool) -> u64 {
    let near = PARKED_MAX as u64 * Job::bytes();
    let far = PARKED_FAR_MAX as u64 * Job::bytes_of(1);
    if is_far { near.max(far) } else { near }
}

/// Most tiles of so many samples a pixel that wait for pages which come from afar, to so many frames.
fn parked_far_max(frames: usize, samples: u32) -> usize {
    let in_room = (parked_bytes(true) / Job::bytes_of(samples)) as usize;
    in_room.min(frames / PARKED_PART).max(PARKED_MAX)
}

/// Work on tiles: what takes their samples, and their order.
pub(crate) struct TileWork<'a> {
    pub(crate) samples: SampleWork<'a>,
    pub(crate) tiles: &'a Tiles,
}

/// What samples of tiles go to.
pub(crate) struct Canvas<'a> {
    pub(crate) film: &'a mut Film,
    /// The picture on show beside it, which learns what they saw.
    pub(crate) display: Option<&'a mut Display>,
}

/// The end of a piece of a pass, if it is not that of the pass.
pub(crate) struct Until<'a> {
    /// Asked between tiles; once it says true no further tile is begun.
    pub(crate) stop: &'a (dyn Fn() -> bool + Sync),
    pub(crate) deadline: Option<Instant>,
    /// Finished tiles that are enough.
    pub(crate) tiles: u32,
}

/// What becomes of a blocked tile that finds no room among those parked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum WhenFull {
    /// No tile is begun before there is room; what comes back blocked from the G-stage stays all the same.
    Wait,
    /// It is begun again at the end of the pass: what can be drawn is drawn first.
    Defer,
}

/// The state of a worker between pieces of a pass.
#[derive(Default)]
pub(super) struct Lane {
    /// The oldest first.
    pub(super) parked: VecDeque<Job>,
    /// The narrow mode was interrupted.
    pub(super) is_narrow: bool,
}

/// The state that the workers of a piece share.
pub(super) struct Piece<'a> {
    pub(super) work: &'a TileWork<'a>,
    pub(super) canvas: Mutex<Canvas<'a>>,
    pub(super) target: u32,
    /// What becomes of a blocked tile that finds no room among those parked.
    pub(super) full: WhenFull,
    pub(super) until: &'a Until<'a>,
    pub(super) turn: &'a AtomicU32,
    pub(super) deferred: &'a Mutex<VecDeque<u32>>,
    pub(super) queue: &'a GQueue,
    pub(super) workers: usize,
    pub(super) finished: AtomicU32,
}

/// Tiles whose G-rays the stage has.
struct UnderWay {
    began: Instant,
    turn: GTurn,
    jobs: Vec<Job>,
}

/// A worker of a piece, at work.
pub(super) struct Worker<'a, T> {
    piece: &'a Piece<'a>,
    /// The worker's number.
    number: usize,
    tracer: &'a mut T,
    lane: &'a mut Lane,
    /// Most tiles that wait for pages.
    parked_max: usize,
    /// The oldest first.
    under_way: VecDeque<UnderWay>,
    together: Together,
    retry: Retry,
    /// True when any ray was answered since the round began.
    has_advanced: bool,
    stats: PassStats,
}

impl Piece<'_> {
    fn is_over(&self) -> bool {
        self.finished.load(Ordering::Relaxed) >= self.until.tiles
            || self.until.deadline.is_some_and(|deadline| Instant::now() >= deadline)
            || (self.until.stop)()
    }

    /// The longest that a worker may wait.
    fn longest_wait(&self) -> Duration {
        let left = self.until.deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
        left.map_or(WAIT, |left| left.min(WAIT))
    }

    /// Most samples of a pixel that a tile takes.
    fn samples_lacking(&self) -> u32 {
        let samples = self.canvas.lock().expect("a worker panicked").film.samples();
        self.target.saturating_sub(samples).clamp(1, PASS_SAMPLES_MAX)
    }

    /// Samples of a batch of the G-stage.
    fn batch_samples(&self) -> usize {
        batch_samples(&self.work.samples.g_stage.needs())
    }

    /// True when the G-stage should have what waits for it: a batch, or all that is wanted of this piece.
    fn has_batch(&self) -> bool {
        let wanted = self.until.tiles.saturating_sub(self.finished.load(Ordering::Relaxed));
        self.queue.holds(self.batch_samples(), wanted.max(1) as usize)
    }

    /// The next tile that lacks samples: a fresh one, else a deferred one.
    fn next_job(&self, home: usize, takes_deferred: bool) -> Option<Job> {
        loop {
            let turn = self.turn.fetch_add(1, Ordering::Relaxed);
            if turn >= self.work.tiles.count() {
                // Keeps the counter from running round in long waits.
                self.turn.store(self.work.tiles.count(), Ordering::Relaxed);
                break;
            }
            let tile = self.work.tiles.nth(turn);
            let from = self.canvas.lock().expect("a worker panicked").film.tile_samples(tile.index);
            if from < self.target {
                return Some(Job::new(&self.work.samples.integrator, home, tile, [from, self.target]));
            }
        }
        let takes = || self.deferred.lock().expect("a worker panicked").pop_front();
        let tile = self.work.tiles.tile(if takes_deferred { takes() } else { None }?);
        let from = self.canvas.lock().expect("a worker panicked").film.tile_samples(tile.index);
        Some(Job::new(&self.work.samples.integrator, home, tile, [from, self.target]))
    }
}

impl<'a, T: PagedTracer> Worker<'a, T> {
    /// Worker `number` of `piece`, which goes on with what `lane` holds.
    pub(super) fn new(
        piece: &'a Piece<'a>,
        number: usize,
        tracer: &'a mut T,
        lane: &'a mut Lane,
    ) -> Worker<'a, T> {
        let (under_way, together, retry, has_advanced, stats) = Default::default();
        let far_max = |frames| parked_far_max(frames, piece.samples_lacking());
        let parked_max = tracer.frames_from_afar().map_or(PARKED_MAX, far_max);
        Worker { piece, number, tracer, lane, parked_max, under_way, together, retry, has_advanced, stats }
    }

    /// True when more tiles may come to wait for pages.
    fn has_room(&self) -> bool {
        self.lane.parked.len() + self.piece.queue.tiles_of(self.number) < self.parked_max
    }

    /// Counts of what the worker did.
    pub(super) fn stats(&self) -> PassStats {
        PassStats { waits: self.retry.waits, ..self.stats }
    }

    /// Works until the pass or the piece is over, and no call is under way.
    pub(super) fn work(&mut self) {
        self.work_on();
        while self.collect() {}
    }

    fn work_on(&mut self) {
        // Pages have come since the last piece.
        if self.lane.is_narrow {
            self.narrow();
        } else {
            self.round();
        }
        while !self.piece.is_over() {
            if self.collect_answered() || self.piece.has_batch() && self.submit_batch() {
                continue;
            }
            let has_room = self.has_room();
            let may_take = has_room || self.piece.full == WhenFull::Defer;
            if let Some(job) = if may_take { self.piece.next_job(self.number, has_room) } else { None } {
                self.begin(job);
                continue;
            }
            if self.submit_batch() || self.collect() {
                continue;
            }
            if self.lane.parked.is_empty() {
                return;
            }
            self.round();
            if !self.has_advanced {
                self.retry.wait(self.tracer, self.piece.longest_wait());
            }
            if self.retry.is_stuck(self.has_advanced) {
                self.narrow();
            }
        }
    }

    /// Asks each parked tile once, the oldest first. Leaves whether anything was answered.
    fn round(&mut self) {
        self.has_advanced = false;
        for _ in 0..self.lane.parked.len() {
            if self.piece.is_over() {
                return;
            }
            // Tiles come back from the G-stage behind those that have not had their turn.
            let Some(job) = self.lane.parked.pop_front() else { return };
            self.begin(job);
            if self.piece.has_batch() {
                self.submit_batch();
            }
        }
        let waits = |worker: &Self| worker.piece.queue.tiles() > 0 || !worker.under_way.is_empty();
        while waits(self) && !self.piece.is_over() && (self.submit_batch() || self.collect()) {}
    }

    /// Takes the samples of a tile through their C-rays.
    fn begin(&mut self, mut job: Job) {
        self.tracer.begin_tile();
        job.samples.begin(&self.piece.work.samples.integrator, self.tracer, &mut self.together);
        self.go_on(job);
    }

    /// Takes the samples of a tile as far as the answers go. What asks for G-rays then goes to the queue, what is done
    /// to the film; what waits for pages is parked or deferred.
    fn go_on(&mut self, mut job: Job) {
        self.has_advanced |= job.go_on(&self.piece.work.samples.integrator, self.tracer);
        if job.samples.asks {
            self.piece.queue.push(job);
            return;
        }
        job.samples.batches.clear();
        if job.samples.pending.is_empty() {
            self.commit(&job);
            return;
        }
        self.tracer.request_missing();
        self.stats.parked += 1;
        if self.lane.parked.len() >= self.parked_max && self.piece.full == WhenFull::Defer && job.is_fresh() {
            self.piece.deferred.lock().expect("a worker panicked").push_back(job.tile.index);
        } else {
            self.lane.parked.push_back(Job { home: self.number, ..job });
        }
    }

    /// Hands a batch of tiles to the G-stage, or what there is of one; false when there is nothing. Where the stage
    /// has as many calls as it wants, one of them is waited for first.
    fn submit_batch(&mut self) -> bool {
        let Piece { queue, workers, work, .. } = self.piece;
        let (g_stage, Some(view)) = (work.samples.g_stage, work.samples.integrator.g_view()) else {
            return false;
        };
        if self.under_way.len() >= g_stage.needs().calls {
            self.collect();
        }
        let own_alone = (self.lane.parked.len() >= self.parked_max).then_some(self.number);
        let mut jobs = queue.take(self.piece.batch_samples(), *workers, own_alone);
        if jobs.is_empty() {
            return false;
        }
        self.tracer.begin_tile();
        let parts = jobs.iter_mut().map(|job| job.samples.batches.take_rays()).collect();
        let call = GCall { view, parts };
        self.stats.g_stage.add(&call.counted());
        let began = Instant::now();
        let turn = g_stage.submit(call, self.tracer.lend_pages());
        self.tracer.request_missing();
        self.under_way.push_back(UnderWay { began, turn, jobs });
        self.collect_answered();
        true
    }

    /// Goes on with the tiles of a call that is answered; false when there is none.
    fn collect_answered(&mut self) -> bool {
        let at = self.under_way.iter_mut().position(|call| call.turn.is_answered());
        at.is_some_and(|at| self.take_answers(at))
    }

    /// Goes on with the tiles of a call, and waits for the oldest where none is answered; false when none is under way.
    fn collect(&mut self) -> bool {
        self.collect_answered() || !self.under_way.is_empty() && self.take_answers(0)
    }

    /// Goes on with the tiles of call `at`; true.
    fn take_answers(&mut self, at: usize) -> bool {
        let UnderWay { began, turn, jobs } = self.under_way.remove(at).expect("it is under way");
        let answered = turn.wait();
        self.stats.g_stage.time_ns += began.elapsed().as_nanos() as u64;
        assert_eq!(answered.parts.len(), jobs.len(), "a call comes back whole");
        for (mut job, rays) in jobs.into_iter().zip(answered.parts) {
            job.samples.batches.put_back(rays);
            self.tracer.begin_tile();
            self.go_on(job);
        }
        true
    }

    /// Finishes one sample of the oldest tile with the pages of one ray at a time.
    fn narrow(&mut self) {
        let Worker { piece, tracer, lane, retry, stats, .. } = self;
        lane.is_narrow = false;
        let Some(job) = lane.parked.front_mut() else { return };
        let OpenSample { slot, mut path, .. } = job.samples.pending.remove(0);
        let SampleWork { integrator, g_stage } = &piece.work.samples;
        let advance = |tracer: &mut T| {
            let before = path.answered();
            match integrator.advance(&mut path, tracer, *g_stage) {
                Answer::Exact(sample) => {
                    job.finish(slot, &sample);
                    Advance::Done
                }
                Answer::Blocked if path.answered() > before => Advance::Answered,
                Answer::Blocked => Advance::Blocked,
            }
        };
        let longest = || (!piece.is_over()).then(|| piece.longest_wait());
        if !retry.alone(*tracer, longest, advance) {
            job.samples.pending.insert(0, OpenSample::new(slot, path));
            lane.is_narrow = true;
            return;
        }
        stats.narrow_samples += 1;
        if job.samples.pending.is_empty() {
            let job = lane.parked.pop_front().expect("the oldest tile stays");
            self.commit(&job);
        }
    }

    fn commit(&mut self, job: &Job) {
        let mut canvas = self.piece.canvas.lock().expect("a worker panicked");
        let Canvas { film, display } = &mut *canvas;
        film.add(&job.tile, &job.radiances);
        if film.layers().filter {
            film.add_indirect(&job.tile, &job.indirect);
        }
        for (pixel, seen) in &job.layers {
            film.set_layers(*pixel, seen);
        }
        if let Some(display) = display {
            display.learn(&job.tile, &job.layers);
        }
        drop(canvas);
        self.piece.finished.fetch_add(1, Ordering::Relaxed);
        self.stats.tiles_finished += 1;
        self.stats.samples += job.radiances.len() as u64;
        self.stats.covered_samples += job.covered;
        self.stats.not_finite += job.not_finite;
        self.stats.rays.add(&job.rays);
        self.stats.look_ups += job.look_ups;
    }
}
