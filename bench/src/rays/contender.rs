//! Who answers rays: ours with all pages in memory, ours through the pool under a limit; peers implement the same.
//!
//! Invariant: a contender spreads a set over its workers in chunks of `CHUNK_RAYS`, all of them alike.

use super::sets::{BenchRay, Query, RaySet, Space};
use rustix::time::{ClockId, clock_gettime};
use std::sync::Mutex;
use std::time::Duration;
use trex_render::{
    AllResident, Answer, Hit, LowerHit, LowerScene, PagedMesh, PagedTracer, PooledPages, Ray, Tracer,
    VoxelHit, VoxelScene,
};

/// Longest sleep for pages; arrivals wake it earlier.
const WAIT: Duration = Duration::from_millis(50);

const ALL_THERE: &str = "all pages are there";
/// Rays that a worker takes at a time.
const CHUNK_RAYS: usize = 4096;
/// `triangle` of a miss.
pub(crate) const MISS: u32 = u32::MAX;

/// What a ray met: for [`Query::Any`] only whether `triangle` is [`MISS`] counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct RayAnswer {
    /// Where, in lengths of the ray's direction.
    pub(crate) t: f32,
    /// Store id of the triangle.
    pub(crate) triangle: u32,
}

impl RayAnswer {
    /// Nothing was hit.
    pub(crate) const NONE: RayAnswer = RayAnswer { t: f32::INFINITY, triangle: MISS };

    /// True for a hit.
    pub(crate) fn is_hit(self) -> bool {
        self.triangle != MISS
    }

    fn from_hit(hit: Option<Hit>) -> RayAnswer {
        hit.map_or(RayAnswer::NONE, |hit| RayAnswer { t: hit.t as f32, triangle: hit.triangle })
    }

    fn from_voxel(hit: Option<VoxelHit>) -> RayAnswer {
        hit.map_or(RayAnswer::NONE, |hit| RayAnswer { t: hit.t as f32, triangle: hit.leaf })
    }

    fn from_occlusion(occluded: bool) -> RayAnswer {
        RayAnswer { t: 0.0, triangle: if occluded { 0 } else { MISS } }
    }
}

/// Answers sets of rays.
pub(crate) trait Contender {
    /// Name for reports: a key of JSON.
    fn label(&self) -> &str;

    /// Answers all rays of a set; `answers` is as long. Gives the processor time of all workers.
    fn trace(&mut self, set: &RaySet, answers: &mut [RayAnswer]) -> Duration;
}

/// Hands chunks of rays to one thread per worker; gives the processor time of all threads, which other processes
/// on the machine change less than they change the wall time.
pub(crate) fn spread<W: Send>(
    workers: &mut [W],
    set: &RaySet,
    answers: &mut [RayAnswer],
    work: impl Fn(&mut W, &[BenchRay], &mut [RayAnswer]) + Sync,
) -> Duration {
    let chunks = Mutex::new(set.rays.chunks(CHUNK_RAYS).zip(answers.chunks_mut(CHUNK_RAYS)));
    let next = || chunks.lock().expect("no worker panics in here").next();
    std::thread::scope(|scope| {
        let mut threads = Vec::with_capacity(workers.len());
        for worker in workers {
            let (next, work) = (&next, &work);
            threads.push(scope.spawn(move || {
                while let Some((rays, answers)) = next() {
                    work(worker, rays, answers);
                }
                processor_time()
            }));
        }
        threads.into_iter().map(|thread| thread.join().expect("no worker panics")).sum()
    })
}

/// What the calling thread has used so far.
fn processor_time() -> Duration {
    let now = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(now.tv_sec as u64, now.tv_nsec as u32)
}

/// Ours, all pages in memory.
pub(super) struct Resident<'a> {
    pub(super) space: Space,
    pub(super) workers: Vec<PagedMesh<&'a AllResident>>,
}

/// The same, with rays handed over together, which it makes packets of.
pub(super) struct Packets<'a> {
    space: Space,
    workers: Vec<PacketWorker<'a>>,
}

/// A chunk of rays, and answers.
struct PacketWorker<'a> {
    tracer: PagedMesh<&'a AllResident>,
    rays: Vec<Ray>,
    hits: Vec<Answer<Option<Hit>>>,
    occluded: Vec<Answer<bool>>,
}

impl<'a> Packets<'a> {
    pub(super) fn new(
        space: Space,
        tracers: impl Iterator<Item = PagedMesh<&'a AllResident>>,
    ) -> Packets<'a> {
        let worker = |tracer| PacketWorker { tracer, rays: vec![], hits: vec![], occluded: vec![] };
        Packets { space, workers: tracers.map(worker).collect() }
    }
}

impl Contender for Packets<'_> {
    fn label(&self) -> &str {
        "trex"
    }

    fn trace(&mut self, set: &RaySet, answers: &mut [RayAnswer]) -> Duration {
        let (space, query) = (self.space, set.query);
        spread(&mut self.workers, set, answers, |worker, rays, answers| {
            let PacketWorker { tracer, rays: models, hits, occluded } = worker;
            models.clear();
            models.extend(rays.iter().map(|ray| space.to_model(ray)));
            match query {
                Query::Closest => {
                    hits.clear();
                    tracer.intersect_coherent(models, hits);
                    let pairs = answers.iter_mut().zip(hits);
                    pairs.for_each(|(answer, hit)| {
                        *answer = RayAnswer::from_hit(exact(*hit).expect(ALL_THERE))
                    });
                }
                Query::Any => {
                    occluded.clear();
                    tracer.occluded_coherent(models, occluded);
                    let pairs = answers.iter_mut().zip(occluded);
                    pairs.for_each(|(answer, any)| {
                        *answer = RayAnswer::from_occlusion(exact(*any).expect(ALL_THERE));
                    });
                }
            }
        })
    }
}

impl Contender for Resident<'_> {
    fn label(&self) -> &str {
        "trex"
    }

    fn trace(&mut self, set: &RaySet, answers: &mut [RayAnswer]) -> Duration {
        let (space, query) = (self.space, set.query);
        spread(&mut self.workers, set, answers, |tracer, rays, answers| {
            for (ray, answer) in rays.iter().zip(answers) {
                *answer = ask(tracer, space, query, ray).expect(ALL_THERE);
            }
        })
    }
}

impl Resident<'_> {
    /// The closest hit.
    pub(super) fn hit(&mut self, ray: &BenchRay) -> Option<Hit> {
        exact(self.workers[0].intersect(&self.space.to_model(ray))).expect(ALL_THERE)
    }
}

/// Ours, through the pool.
pub(super) struct PooledContender {
    pub(super) space: Space,
    pub(super) workers: Vec<PagedMesh<PooledPages>>,
}

impl Contender for PooledContender {
    fn label(&self) -> &str {
        "trex"
    }

    fn trace(&mut self, set: &RaySet, answers: &mut [RayAnswer]) -> Duration {
        let (space, query) = (self.space, set.query);
        spread(&mut self.workers, set, answers, |tracer, rays, answers| {
            let mut pending: Vec<usize> = (0..rays.len()).collect();
            while !pending.is_empty() {
                let before = pending.len();
                tracer.begin_tile();
                pending.retain(|&at| match ask(tracer, space, query, &rays[at]) {
                    Some(answer) => {
                        answers[at] = answer;
                        false
                    }
                    None => true,
                });
                if pending.len() == before {
                    // Rays take each other's pages: the first one gets room for itself.
                    let at = pending.remove(0);
                    answers[at] = alone(tracer, |tracer| ask(tracer, space, query, &rays[at]));
                } else if !pending.is_empty() {
                    tracer.request_missing();
                    tracer.wait(WAIT);
                }
            }
        })
    }
}

impl PooledContender {
    /// The closest hit.
    pub(super) fn hit(&mut self, ray: &BenchRay) -> Option<Hit> {
        let (tracer, ray) = (&mut self.workers[0], self.space.to_model(ray));
        match exact(tracer.intersect(&ray)) {
            Some(hit) => hit,
            None => alone(tracer, |tracer| exact(tracer.intersect(&ray))),
        }
    }
}

/// Ours, through the voxels: rays learn of a leaf, not of a triangle.
pub(super) struct Gray<'a> {
    pub(super) space: Space,
    pub(super) scene: GrayScene<'a>,
    pub(super) calls: GrayCalls,
    pub(super) workers: Vec<GrayWorker>,
}

/// The voxels.
#[derive(Clone, Copy)]
pub(super) enum GrayScene<'a> {
    /// Those of the upper octree.
    Upper(VoxelScene<'a>),
    /// The finest ones, in units that are all there.
    Finest(LowerScene<'a>, &'a AllResident),
}

impl GrayScene<'_> {
    /// Side of a leaf, model units.
    pub(super) fn leaf_side(&self) -> f64 {
        match self {
            GrayScene::Upper(scene) => scene.leaf_side(),
            GrayScene::Finest(scene, _) => scene.leaf_side(),
        }
    }

    /// Distance off any surface at which a ray is free of that surface's own voxels, model units.
    pub(super) fn clearance(&self) -> f64 {
        match self {
            GrayScene::Upper(scene) => scene.clearance([1.0, 0.0, 0.0]),
            GrayScene::Finest(scene, _) => scene.clearance([1.0, 0.0, 0.0]),
        }
    }
}

/// How rays are handed to the voxels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum GrayCalls {
    /// A chunk in one call.
    Batch,
    /// One by one.
    Single,
}

/// A chunk of rays, and answers.
#[derive(Clone, Default)]
pub(super) struct GrayWorker {
    rays: Vec<Ray>,
    hits: Vec<Option<VoxelHit>>,
    occluded: Vec<bool>,
    finest: Vec<Answer<Option<LowerHit>>>,
}

impl Contender for Gray<'_> {
    fn label(&self) -> &str {
        "trex"
    }

    fn trace(&mut self, set: &RaySet, answers: &mut [RayAnswer]) -> Duration {
        let Gray { space, scene, calls, .. } = *self;
        spread(&mut self.workers, set, answers, |worker, rays, answers| {
            worker.rays.clear();
            worker.rays.extend(rays.iter().map(|ray| space.to_gray(ray)));
            worker.hits.resize(rays.len(), None);
            worker.occluded.resize(rays.len(), false);
            match scene {
                GrayScene::Upper(scene) => worker.answer(&scene, (set.query, calls)),
                GrayScene::Finest(scene, pages) => worker.answer_finest((&scene, pages), (set.query, calls)),
            }
            match set.query {
                Query::Any => {
                    let pairs = answers.iter_mut().zip(&worker.occluded);
                    pairs.for_each(|(answer, occluded)| *answer = RayAnswer::from_occlusion(*occluded));
                }
                Query::Closest => {
                    let pairs = answers.iter_mut().zip(&worker.hits);
                    pairs.for_each(|(answer, hit)| *answer = RayAnswer::from_voxel(*hit));
                }
            }
        })
    }
}

impl GrayWorker {
    fn answer(&mut self, scene: &VoxelScene<'_>, how: (Query, GrayCalls)) {
        let GrayWorker { rays, hits, occluded, .. } = self;
        match how {
            (Query::Any, GrayCalls::Batch) => {
                scene.intersect_batch(rays, hits);
                occluded.iter_mut().zip(hits).for_each(|(occluded, hit)| *occluded = hit.is_some());
            }
            (Query::Closest, GrayCalls::Batch) => scene.intersect_batch(rays, hits),
            (Query::Any, GrayCalls::Single) => {
                rays.iter()
                    .zip(occluded)
                    .for_each(|(ray, occluded)| *occluded = scene.intersect(ray).is_some());
            }
            (Query::Closest, GrayCalls::Single) => {
                rays.iter().zip(hits).for_each(|(ray, hit)| *hit = scene.intersect(ray));
            }
        }
    }
}

impl GrayWorker {
    /// As `answer`, through units.
    fn answer_finest(
        &mut self,
        (scene, mut pages): (&LowerScene<'_>, &AllResident),
        how: (Query, GrayCalls),
    ) {
        let GrayWorker { rays, hits, occluded, finest } = self;
        match how {
            (Query::Any, GrayCalls::Batch) => {
                finest.resize(rays.len(), Answer::Blocked);
                scene.intersect_batch(rays, &mut pages, finest);
                let pairs = finest.iter().zip(occluded);
                pairs.for_each(|(answer, occluded)| *occluded = exact(*answer).expect(ALL_THERE).is_some());
            }
            (Query::Closest, GrayCalls::Batch) => {
                finest.resize(rays.len(), Answer::Blocked);
                scene.intersect_batch(rays, &mut pages, finest);
                let pairs = finest.iter().zip(hits);
                pairs.for_each(|(answer, hit)| *hit = exact(*answer).expect(ALL_THERE).map(|hit| hit.upper));
            }
            (Query::Any, GrayCalls::Single) => {
                rays.iter().zip(occluded).for_each(|(ray, occluded)| {
                    *occluded = exact(scene.intersect(ray, &mut pages)).expect(ALL_THERE).is_some();
                });
            }
            (Query::Closest, GrayCalls::Single) => {
                rays.iter().zip(hits).for_each(|(ray, hit)| {
                    let found = exact(scene.intersect(ray, &mut pages)).expect(ALL_THERE);
                    *hit = found.map(|hit| hit.upper);
                });
            }
        }
    }
}

/// The answer, or `None` when a page is missing.
fn ask(tracer: &mut impl Tracer, space: Space, query: Query, ray: &BenchRay) -> Option<RayAnswer> {
    let ray = space.to_model(ray);
    match query {
        Query::Closest => exact(tracer.intersect(&ray)).map(RayAnswer::from_hit),
        Query::Any => exact(tracer.occluded(&ray)).map(RayAnswer::from_occlusion),
    }
}

/// Asks for the pages of one ray until it is answered.
fn alone<T: PagedTracer, A>(tracer: &mut T, mut ask: impl FnMut(&mut T) -> Option<A>) -> A {
    tracer.request_missing();
    tracer.begin_tile();
    loop {
        if let Some(answer) = ask(tracer) {
            return answer;
        }
        tracer.request_missing();
        tracer.wait(WAIT);
    }
}

fn exact<T>(answer: Answer<T>) -> Option<T> {
    match answer {
        Answer::Exact(value) => Some(value),
        Answer::Blocked => None,
    }
}
