//! Rays of the caller, answered exactly on the mesh by the model's threads, whatever pages they wait for.
//!
//! ```text
//! rays -> check -> pieces over tracers -> `intersect_all` (trex-render) -> answers in order | interrupted | damaged
//! ```
//!
//! Invariants: 1. answers come in the order of the rays and depend on nothing else; 2. tracers and answers are leased
//! for as long as the call lasts: what is returned is the caller's.

use crate::handle::Model;
use std::ops::Range;
use trex_render::{
    HITS_PER_RAY, Hit, MemoryPlan, MeshTracer, MeshTriangle, PooledPages, Ray, ShadedHit, crossings_all,
    intersect_all, intersect_shaded_all, occluded_all, read_triangles,
};
use trex_store::{Code, Error, Interrupt, Lease, Result};

/// Rays that are worth a tracer of their own.
const RAYS_PER_TRACER: usize = 4096;

/// Rays between two looks at how long a list of hits has become.
const RAYS_PER_LEASE: usize = 64;

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

    /// As [`Model::intersect`], with the colour of the mesh there and the normal that shades it; their pages are waited
    /// for, too.
    ///
    /// # Errors
    /// Those of [`Model::intersect`].
    pub fn intersect_shaded(&self, rays: &[Ray], interrupt: &Interrupt) -> Result<Vec<Option<ShadedHit>>> {
        self.answer(rays, interrupt, intersect_shaded_all::<MeshTracer>)
    }

    /// Whether each ray meets anything, in order. As [`Model::intersect`].
    ///
    /// # Errors
    /// Those of [`Model::intersect`].
    pub fn occluded(&self, rays: &[Ray], interrupt: &Interrupt) -> Result<Vec<bool>> {
        self.answer(rays, interrupt, occluded_all::<MeshTracer>)
    }

    /// All hits of each ray: where it crosses the surface, by rising `t`. A crossing through an edge or a corner counts
    /// once, so that a line crosses a closed surface an even number of times; of a hit there, `intersect` may tell
    /// another of the triangles. As [`Model::intersect`], at a fraction of its speed. The list is leased while
    /// it grows.
    ///
    /// # Errors
    /// Those of [`Model::intersect`]; [`Code::Usage`] for a ray with more than [`HITS_PER_RAY`] hits.
    pub fn intersect_all(&self, rays: &[Ray], interrupt: &Interrupt) -> Result<AllHits> {
        check_rays(rays, 0, rays.len())?;
        let counts_bytes = 2 * (rays.len() * size_of::<usize>()) as u64;
        let stop = || interrupt.is_raised();
        let pieces = self.on_tracers(rays.len(), counts_bytes, interrupt, |tracer, range| {
            let mut found = FoundHits::default();
            for rays in rays[range].chunks(RAYS_PER_LEASE) {
                if !crossings_all(tracer, rays, &stop, &mut found.counts, &mut found.hits) {
                    break;
                }
                self.lease_hits(&mut found)?;
            }
            Ok(found)
        })?;
        let mut all = AllHits { first: Vec::with_capacity(rays.len() + 1), hits: vec![] };
        all.first.push(0);
        for piece in pieces {
            let piece = piece?;
            for count in piece.counts {
                if count > HITS_PER_RAY {
                    return Err(too_many_hits(all.first.len() - 1, rays.len()));
                }
                all.first.push(all.first[all.first.len() - 1] + count);
            }
            all.hits.extend(piece.hits);
        }
        Ok(all)
    }

    /// The triangles with these ids, in their order: corners on the lattice, and materials.
    ///
    /// # Errors
    /// [`Code::Usage`] for an id that the model has not; those of [`Model::intersect`].
    pub fn read_triangles(&self, ids: &[u32], interrupt: &Interrupt) -> Result<Vec<MeshTriangle>> {
        let count = self.file().superblock().triangle_count;
        if let Some(place) = ids.iter().position(|&id| u64::from(id) >= count) {
            return Err(Error::new(Code::Usage, "the model has no such triangle")
                .at_place(format!("id {place} of {}", ids.len()))
                .numbers(format!("{}, of {count}", ids[place]))
                .next("give ids from 0 on, below the count of triangles"));
        }
        let mut order: Vec<u32> = (0..ids.len() as u32).collect();
        order.sort_unstable_by_key(|&place| ids[place as usize]);
        let sorted: Vec<u32> = order.iter().map(|&place| ids[place as usize]).collect();
        let bytes = (ids.len() * (2 * size_of::<u32>() + 2 * size_of::<MeshTriangle>())) as u64;
        let stop = || interrupt.is_raised();
        let pieces = self.on_tracers(ids.len(), bytes, interrupt, |tracer, range| {
            let mut triangles = Vec::with_capacity(range.len());
            read_triangles(tracer, self.file(), &sorted[range], &stop, &mut triangles);
            triangles
        })?;
        let mut triangles = vec![MeshTriangle::LOST; ids.len()];
        for (&place, triangle) in order.iter().zip(pieces.iter().flatten()) {
            triangles[place as usize] = *triangle;
        }
        Ok(triangles)
    }

    fn answer<A: Clone + Send>(
        &self,
        rays: &[Ray],
        interrupt: &Interrupt,
        answer_rays: AnswerRays<A>,
    ) -> Result<Vec<A>> {
        check_rays(rays, 0, rays.len())?;
        // In pieces, and together.
        let bytes = 2 * size_of_val(rays) as u64 / size_of::<Ray>() as u64 * size_of::<A>() as u64;
        let stop = || interrupt.is_raised();
        let pieces = self.on_tracers(rays.len(), bytes, interrupt, |tracer, range| {
            let mut found = Vec::with_capacity(range.len());
            answer_rays(tracer, &rays[range], &stop, &mut found);
            found
        })?;
        Ok(pieces.concat())
    }

    /// Has tracers do `work` on ranges of `count` things, the answers to which take `bytes`. Answers in order.
    fn on_tracers<R: Send>(
        &self,
        count: usize,
        bytes: u64,
        interrupt: &Interrupt,
        work: impl Fn(&mut MeshTracer, Range<usize>) -> R + Sync,
    ) -> Result<Vec<R>> {
        let room = self.lock_room();
        if self.pool().is_none() {
            let beside = self.foreign_bytes();
            let plan =
                MemoryPlan::of_rays(self.file(), self.worker_count(), self.budget().limit_bytes(), beside)?;
            self.shared_pool().fit(&plan, &self.pool_source())?;
        }
        let tracer_count = count.div_ceil(RAYS_PER_TRACER).clamp(1, self.worker_count());
        let page_count = self.file().pages().len();
        let bytes = tracer_count as u64 * PooledPages::bytes(page_count, page_count) + bytes;
        let _lease = self.shared_pool().lease("rays and their answers", bytes, self.budget())?;
        drop(room);
        let tracers = self.shared_pool().tracers(self.file(), tracer_count)?;

        let piece = count.div_ceil(tracer_count).max(1);
        let mut answers: Vec<Option<R>> = (0..tracer_count).map(|_| None).collect();
        self.threads().scope(|scope| {
            for (place, (mut tracer, answer)) in tracers.into_iter().zip(&mut answers).enumerate() {
                let (range, work) = ((place * piece).min(count)..((place + 1) * piece).min(count), &work);
                scope.spawn(move |_| *answer = Some(work(&mut tracer, range)));
            }
        });
        interrupt.check()?;
        self.check_damage()?;
        Ok(answers.into_iter().flatten().collect())
    }

    /// Leases what a list of hits has grown by.
    fn lease_hits(&self, found: &mut FoundHits) -> Result<()> {
        let leased: u64 = found.leases.iter().map(|lease| lease.bytes()).sum();
        // In pieces, and together.
        let bytes = 2 * (found.hits.capacity() * size_of::<Hit>()) as u64;
        if bytes > leased {
            found.leases.push(self.shared_pool().lease_more(
                "all hits of rays",
                bytes - leased,
                self.budget(),
            )?);
        }
        Ok(())
    }
}

/// All hits of some rays.
#[derive(Clone, Debug, PartialEq)]
pub struct AllHits {
    /// Where the hits of each ray begin; one more than there are rays, the last is the count of all hits.
    pub first: Vec<usize>,
    /// Hits, ray by ray, by rising `t`.
    pub hits: Vec<Hit>,
}

/// What one tracer has found.
#[derive(Default)]
struct FoundHits {
    counts: Vec<usize>,
    hits: Vec<Hit>,
    leases: Vec<Lease>,
}

fn too_many_hits(ray: usize, count: usize) -> Error {
    Error::new(Code::Usage, "a ray has more hits than are listed")
        .at_place(format!("ray {ray} of {count}"))
        .numbers(format!("{HITS_PER_RAY} at most"))
        .next("end the ray earlier, and begin another there")
}

/// Refuses what is no ray: numbers that are not finite, no direction, a `t_max` that is not above 0. `rays` are those
/// from `first` on of `count`, which the message is about.
///
/// # Errors
/// [`Code::Usage`] with the first of them.
pub fn check_rays(rays: &[Ray], first: usize, count: usize) -> Result<()> {
    let is_ray = |ray: &Ray| {
        let are_finite = ray.origin.iter().chain(&ray.direction).all(|x| x.is_finite());
        are_finite && ray.direction != [0.0; 3] && ray.t_max > 0.0
    };
    match rays.iter().position(|ray| !is_ray(ray)) {
        None => Ok(()),
        Some(index) => Err(Error::new(Code::Usage, "this is no ray")
            .at_place(format!("ray {} of {count}", first + index))
            .numbers(format!("{:?}", rays[index]))
            .next("give a finite origin, a finite direction that is not zero, and a t_max above 0")),
    }
}
