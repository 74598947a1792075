//! The workers of a pass: each takes tiles, asks their samples, parks those that wait for pages, and tries these again.
//!
//! Invariants: 1. at most [`PARKED_MAX`] tiles wait per worker; 2. a tile's samples reach the film all together or
//! not at all.

use super::job::Job;
use super::samples::{Pending, Samples};
use crate::image::film::Film;
use crate::image::tile::Tiles;
use crate::integrate::SampleIntegrator;
use crate::stats::PassStats;
use crate::trace::{Advance, Answer, PagedTracer, Retry, WAIT};
use std::collections::VecDeque;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Most tiles of a worker that wait for pages: about what a disk queue takes, at some requests a tile.
pub(super) const PARKED_MAX: usize = 8;

/// Work on tiles: the integrator, and their order.
pub(crate) struct TileWork<'a> {
    pub(crate) integrator: SampleIntegrator<'a>,
    pub(crate) tiles: &'a Tiles,
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
    /// There is none: no tile is begun before there is room.
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
    pub(super) film: Mutex<&'a mut Film>,
    pub(super) target: u32,
    /// What becomes of a blocked tile that finds no room among those parked.
    pub(super) full: WhenFull,
    pub(super) until: &'a Until<'a>,
    pub(super) turn: &'a AtomicU32,
    pub(super) deferred: &'a Mutex<VecDeque<u32>>,
    pub(super) finished: AtomicU32,
}

/// A worker of a piece, at work.
pub(super) struct Worker<'a, T> {
    piece: &'a Piece<'a>,
    tracer: &'a mut T,
    lane: &'a mut Lane,
    samples: Samples,
    retry: Retry,
    stats: PassStats,
}

/// The result of an attempt at a job.
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

    /// The longest that a worker may wait.
    fn longest_wait(&self) -> Duration {
        let left = self.until.deadline.map(|deadline| deadline.saturating_duration_since(Instant::now()));
        left.map_or(WAIT, |left| left.min(WAIT))
    }

    /// The next tile that lacks samples: a fresh one, else a deferred one.
    fn next_job(&self, takes_deferred: bool) -> Option<Job> {
        loop {
            let turn = self.turn.fetch_add(1, Ordering::Relaxed);
            if turn >= self.work.tiles.count() {
                // Keeps the counter from running round in long waits.
                self.turn.store(self.work.tiles.count(), Ordering::Relaxed);
                break;
            }
            let tile = self.work.tiles.nth(turn);
            let from = self.film.lock().expect("a worker panicked").tile_samples(tile.index);
            if from < self.target {
                return Some(Job::new(&self.work.integrator, tile, from, self.target));
            }
        }
        let takes = || self.deferred.lock().expect("a worker panicked").pop_front();
        let tile = self.work.tiles.tile(if takes_deferred { takes() } else { None }?);
        let from = self.film.lock().expect("a worker panicked").tile_samples(tile.index);
        Some(Job::new(&self.work.integrator, tile, from, self.target))
    }
}

impl<'a, T: PagedTracer> Worker<'a, T> {
    /// A worker of `piece` that goes on with what `lane` holds.
    pub(super) fn new(piece: &'a Piece<'a>, tracer: &'a mut T, lane: &'a mut Lane) -> Worker<'a, T> {
        let (samples, retry, stats) = Default::default();
        Worker { piece, tracer, lane, samples, retry, stats }
    }

    /// Counts of what the worker did.
    pub(super) fn stats(&self) -> PassStats {
        PassStats { waits: self.retry.waits, ..self.stats }
    }

    /// Works until the pass or the piece is over.
    pub(super) fn work(&mut self) {
        // Pages have come since the last piece.
        if self.lane.is_narrow {
            self.narrow();
        } else {
            self.round();
        }
        while !self.piece.is_over() {
            let has_room = self.lane.parked.len() < PARKED_MAX;
            let may_take = has_room || self.piece.full == WhenFull::Defer;
            if let Some(job) = if may_take { self.piece.next_job(has_room) } else { None } {
                self.attempt(job);
                continue;
            }
            if self.lane.parked.is_empty() {
                return;
            }
            let has_advanced = self.round();
            if !has_advanced {
                self.retry.wait(self.tracer, self.piece.longest_wait());
            }
            if self.retry.is_stuck(has_advanced) {
                self.narrow();
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
        self.tracer.begin_tile();
        let has_advanced = self.ask(&mut job);
        if job.pending.is_empty() {
            self.commit(&job);
            return Attempt::Finished;
        }
        self.tracer.request_missing();
        self.stats.parked += 1;
        if self.lane.parked.len() < PARKED_MAX {
            self.lane.parked.push_back(job);
        } else {
            self.piece.deferred.lock().expect("a worker panicked").push_back(job.tile.index);
        }
        if has_advanced { Attempt::Advanced } else { Attempt::Stuck }
    }

    /// Takes all samples of a tile as far as the answers go. True when any ray was answered.
    fn ask(&mut self, job: &mut Job) -> bool {
        let mut pending = std::mem::take(&mut job.pending);
        let integrator = &self.piece.work.integrator;
        let has_advanced =
            self.samples.ask(integrator, &mut pending, self.tracer, |slot, sample| job.finish(slot, sample));
        job.pending = pending;
        has_advanced
    }

    /// Finishes one sample of the oldest tile with the pages of one ray at a time.
    fn narrow(&mut self) {
        let Worker { piece, tracer, lane, retry, stats, .. } = self;
        lane.is_narrow = false;
        let Some(job) = lane.parked.front_mut() else { return };
        let Pending { slot, mut path, .. } = job.pending.remove(0);
        let integrator = &piece.work.integrator;
        let advance = |tracer: &mut T| {
            let before = path.answered();
            match integrator.advance(&mut path, tracer) {
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
            job.pending.insert(0, Pending::new(slot, path));
            lane.is_narrow = true;
            return;
        }
        stats.narrow_samples += 1;
        if job.pending.is_empty() {
            let job = lane.parked.pop_front().expect("the oldest tile stays");
            self.commit(&job);
        }
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
