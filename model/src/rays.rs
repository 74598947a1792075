//! Rays of the caller, answered exactly on the mesh by the model's threads, whatever pages they wait for.
//!
//! ```text
//! rays -> check -> pieces over tracers -> `intersect_all` (trex-render) -> answers in order | interrupted | damaged
//! ```
//!
//! Invariants: 1. answers come in the order of the rays and depend on nothing else; 2. tracers and answers are leased
//! for as long as the call lasts: what is returned is the caller's.

use crate::handle::Model;
use crate::options::DamagePolicy;
use std::sync::Mutex;
use trex_render::{Hit, MemoryPlan, MeshTracer, PooledPages, Ray, intersect_all, occluded_all};
use trex_store::{Code, Error, Interrupt, Result};

/// Rays that are worth a tracer of their own.
const RAYS_PER_TRACER: usize = 4096;

/// How a tracer answers some rays, in order; false when it was stopped before the end.
type AnswerRays<A> = fn(&mut MeshTracer, &[Ray], &dyn Fn() -> bool, &mut Vec<A>) -> bool;

impl Model {
    /// The closest hit of each ray, in order; `None` where it meets nothing. Exact: the whole mesh counts, and pages
    /// are waited for. Rays of one call that lie near each other share the pages they wait for, so calls with many rays
    /// are worth more than many calls. Can be called from several threads at a time, beside sessions.
    ///
    /// # Errors
    /// [`Code::Usage`] for a ray that is none (numbers that are not finite, no direction, a `t_max` that is not above
    /// 0); [`Code::Interrupted`]; [`Code::Damaged`] where damage may have changed an answer, unless that is to be left
    /// out; [`Code::MemoryLimit`].
    pub fn intersect(&self, rays: &[Ray], interrupt: &Interrupt) -> Result<Vec<Option<Hit>>> {
        self.answer(rays, interrupt, intersect_all::<MeshTracer>)
    }

    /// Whether each ray meets anything, in order. As [`Model::intersect`].
    ///
    /// # Errors
    /// Those of [`Model::intersect`].
    pub fn occluded(&self, rays: &[Ray], interrupt: &Interrupt) -> Result<Vec<bool>> {
        self.answer(rays, interrupt, occluded_all::<MeshTracer>)
    }

    fn answer<A: Clone + Send>(
        &self,
        rays: &[Ray],
        interrupt: &Interrupt,
        answer_rays: AnswerRays<A>,
    ) -> Result<Vec<A>> {
        check(rays)?;
        let room = self.lock_room();
        if self.pool().is_none() {
            let beside = self.foreign_bytes();
            let plan =
                MemoryPlan::of_rays(self.file(), self.worker_count(), self.budget().limit_bytes(), beside)?;
            self.shared_pool().fit(&plan, &self.pool_source())?;
        }
        let tracer_count = rays.len().div_ceil(RAYS_PER_TRACER).clamp(1, self.worker_count());
        let page_count = self.file().pages().len();
        let bytes = tracer_count as u64 * PooledPages::bytes(page_count, page_count)
            // In pieces, and together.
            + 2 * (rays.len() * size_of::<A>()) as u64;
        let _lease = self.shared_pool().lease("rays and their answers", bytes, self.budget())?;
        drop(room);
        let tracers = self.shared_pool().tracers(self.file(), tracer_count)?;

        let piece = rays.len().div_ceil(tracer_count).max(1);
        let answers = Mutex::new(vec![Vec::new(); tracer_count]);
        let stop = || interrupt.is_raised();
        self.threads().scope(|scope| {
            for (place, (mut tracer, rays)) in tracers.into_iter().zip(rays.chunks(piece)).enumerate() {
                let (answers, stop) = (&answers, &stop);
                scope.spawn(move |_| {
                    let mut found = Vec::with_capacity(rays.len());
                    answer_rays(&mut tracer, rays, stop, &mut found);
                    answers.lock().expect("a worker panicked")[place] = found;
                });
            }
        });
        interrupt.check()?;
        match (self.damage_policy(), self.damage().into_iter().next()) {
            (DamagePolicy::Refuse, Some((_, error))) => Err(error),
            _ => Ok(answers.into_inner().expect("a worker panicked").concat()),
        }
    }
}

/// Refuses what is no ray.
fn check(rays: &[Ray]) -> Result<()> {
    let is_ray = |ray: &Ray| {
        let are_finite = ray.origin.iter().chain(&ray.direction).all(|x| x.is_finite());
        are_finite && ray.direction != [0.0; 3] && ray.t_max > 0.0
    };
    match rays.iter().position(|ray| !is_ray(ray)) {
        None => Ok(()),
        Some(index) => Err(Error::new(Code::Usage, "this is no ray")
            .at_place(format!("ray {index} of {}", rays.len()))
            .numbers(format!("{:?}", rays[index]))
            .next("give a finite origin, a finite direction that is not zero, and a t_max above 0")),
    }
}
