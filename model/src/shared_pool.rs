//! `SharedPool`: the pool of pages of a model, started by the first that asks for pages, and its frames, which make
//! room for what comes and take what is left.
//!
//! ```text
//! limit = reserve + tables + octree + sessions, rays, all else that is leased + staging + frames
//! ```
//!
//! Invariants: 1. a pool is started once; 2. frames are set under one lock. Who makes room for a session or for rays
//! holds `Model::lock_room` until they are leased, so that two at a time do not both count on it.

use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use trex_render::{MemoryPlan, MeshTracer, seated_tracers};
use trex_store::io::IoOptions;
use trex_store::layout::FRAME_BYTES;
use trex_store::pool::{PagePool, Seats};
use trex_store::{Budget, Lease, PageFile, Result};

/// The pool, once it is there.
#[derive(Default)]
pub(crate) struct SharedPool(Mutex<Option<RunningPool>>);

struct RunningPool {
    pool: Arc<PagePool>,
    seats: Arc<Seats>,
    /// Staging and pins of the plan that it was started by: they stay.
    staging_bytes: u64,
    /// Bytes of frames under the last plan: as many as there are where rays take nothing.
    planned_bytes: u64,
}

/// A file, and how its pool is started.
pub(crate) struct PoolSource<'a> {
    pub(crate) file: &'a Arc<PageFile>,
    pub(crate) path: &'a Path,
    pub(crate) budget: &'a Budget,
    pub(crate) io: &'a IoOptions,
}

impl RunningPool {
    /// Bytes of frames under `plan`: the buffers between disk and frames stay as they were opened.
    fn frames_bytes(&self, plan: &MemoryPlan) -> u64 {
        (plan.frames_bytes + plan.staging_bytes).saturating_sub(self.staging_bytes)
    }

    /// Bytes of the frames that there are.
    fn held_bytes(&self) -> u64 {
        (self.pool.frames().frames * FRAME_BYTES) as u64
    }

    /// Sets the frames to those of `most` bytes that fit beside `bytes` more. What cannot be had is refused to who
    /// leases these, with its figures.
    fn set_frames_beside(&self, bytes: u64, most: u64, budget: &Budget) {
        let held = self.held_bytes();
        let fitting = (budget.free_bytes() + held).saturating_sub(bytes).min(most);
        if fitting / FRAME_BYTES as u64 != held / FRAME_BYTES as u64 {
            let _ = self.pool.set_limit(fitting);
        }
    }
}

impl SharedPool {
    fn lock(&self) -> MutexGuard<'_, Option<RunningPool>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The pool, if it was started.
    pub(crate) fn get(&self) -> Option<Arc<PagePool>> {
        self.lock().as_ref().map(|started| started.pool.clone())
    }

    /// Bytes that it has leased.
    pub(crate) fn leased_bytes(&self) -> u64 {
        self.lock().as_ref().map_or(0, |started| started.pool.leased_bytes())
    }

    /// Starts the pool with the frames of `plan`, or sets those that it has to it. Frames that find no room, since
    /// somebody else holds some, come with what is planned next.
    ///
    /// # Errors
    /// Those of [`PagePool::open`]; those of [`PagePool::set_limit`] where frames are to go.
    pub(crate) fn fit(&self, plan: &MemoryPlan, source: &PoolSource<'_>) -> Result<()> {
        let mut started = self.lock();
        if let Some(started) = &mut *started {
            started.planned_bytes = started.frames_bytes(plan);
            let (planned, held) = (started.planned_bytes, started.held_bytes());
            let fitted = started.pool.set_limit(planned).map(drop);
            return fitted.or_else(|error| if planned > held { Ok(()) } else { Err(error) });
        }
        let PoolSource { file, path, budget, io } = *source;
        let options = plan.pool_options(io);
        let pool = PagePool::open(file.clone(), path, budget, &options)?;
        *started = Some(RunningPool {
            pool: Arc::new(pool),
            seats: Arc::default(),
            staging_bytes: plan.staging_bytes,
            planned_bytes: plan.frames_bytes,
        });
        Ok(())
    }

    /// Sets the frames to those of `plan` where these are fewer. Gives their count before.
    ///
    /// # Errors
    /// Those of [`PagePool::set_limit`].
    pub(crate) fn shrink_to(&self, plan: &MemoryPlan) -> Result<usize> {
        let started = self.lock();
        let Some(started) = &*started else { return Ok(0) };
        let before = started.pool.frames().frames;
        let fewer = started.frames_bytes(plan).min((before * FRAME_BYTES) as u64);
        started.pool.set_limit(fewer)?;
        Ok(before)
    }

    /// Sets the count of frames.
    ///
    /// # Errors
    /// Those of [`PagePool::set_limit`].
    pub(crate) fn set_frames(&self, count: usize) -> Result<()> {
        let bytes = (count * FRAME_BYTES) as u64;
        self.lock().as_ref().map_or(Ok(()), |started| started.pool.set_limit(bytes).map(drop))
    }

    /// Takes `bytes` for `what` from what is free, else from the frames; frames of the plan that rays before took come
    /// back, as far as there is room.
    ///
    /// # Errors
    /// Those of [`Budget::lease`]: the frames are as few as they can be, or pinned.
    pub(crate) fn lease(&self, what: &str, bytes: u64, budget: &Budget) -> Result<Lease> {
        if let Some(started) = &*self.lock() {
            started.set_frames_beside(bytes, started.planned_bytes, budget);
        }
        budget.lease(what, bytes)
    }

    /// As [`SharedPool::lease`] while rays are under way: no frames come back.
    ///
    /// # Errors
    /// As there.
    pub(crate) fn lease_more(&self, what: &str, bytes: u64, budget: &Budget) -> Result<Lease> {
        if let Some(started) = &*self.lock() {
            started.set_frames_beside(bytes, started.held_bytes(), budget);
        }
        budget.lease(what, bytes)
    }

    /// Tracers of `file` for so many workers.
    ///
    /// # Errors
    /// Those of [`Seats::assign`].
    ///
    /// # Panics
    /// When the pool was not started.
    pub(crate) fn tracers(&self, file: &Arc<PageFile>, workers: usize) -> Result<Vec<MeshTracer>> {
        let started = self.lock();
        let RunningPool { pool, seats, .. } = started.as_ref().expect("the pool was started");
        seated_tracers(file, pool, seats, workers)
    }
}
