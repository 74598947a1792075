//! Who answers rays: ours with all pages in memory, ours through the pool under a limit; peers implement the same.
//!
//! Invariant: a contender spreads a set over its workers in chunks of `CHUNK_RAYS`, all of them alike.

use super::sets::{BenchRay, Query, RaySet, Space};
use rustix::time::{ClockId, clock_gettime};
use std::hint::black_box;
use std::sync::Mutex;
use std::time::Duration;
use trex_render::{AllResident, Answer, Hit, PagedMesh, PagedTracer, PooledPages, Ray, Tracer, VoxelHit};

/// Longest sleep for pages; arrivals wake it earlier.
const WAIT: Duration = Duration::from_millis(50);

pub(super) const ALL_THERE: &str = "all pages are there";
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

    pub(super) fn from_voxel(hit: Option<VoxelHit>) -> RayAnswer {
        hit.map_or(RayAnswer::NONE, |hit| RayAnswer { t: hit.t as f32, triangle: hit.leaf })
    }

    pub(super) fn from_occlusion(occluded: bool) -> RayAnswer {
        RayAnswer { t: 0.0, triangle: if occluded { 0 } else { MISS } }
    }
}

/// Answers sets of rays.
pub(crate) trait Contender {
    /// Name for reports: a key of JSON.
    fn label(&self) -> &str;

    /// From now on, whether hits are shaded, too: for meshes that have colours or normals.
    fn shade(&mut self, _shades: bool) {}

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
    pub(super) shades: bool,
    pub(super) workers: Vec<PagedMesh<&'a AllResident>>,
}

/// The same, with rays handed over together, which it makes packets of.
pub(super) struct Packets<'a> {
    space: Space,
    shades: bool,
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
        Packets { space, shades: false, workers: tracers.map(worker).collect() }
    }
}

impl Contender for Packets<'_> {
    fn label(&self) -> &str {
        "trex"
    }

    fn shade(&mut self, shades: bool) {
        self.shades = shades;
    }

    fn trace(&mut self, set: &RaySet, answers: &mut [RayAnswer]) -> Duration {
        let (space, query, shades) = (self.space, set.query, self.shades);
        spread(&mut self.workers, set, answers, |worker, rays, answers| {
            let PacketWorker { tracer, rays: models, hits, occluded } = worker;
            models.clear();
            models.extend(rays.iter().map(|ray| space.to_model(ray)));
            match query {
                Query::Closest => {
                    hits.clear();
                    tracer.intersect_coherent(models, hits);
                    if shades {
                        for hit in &*hits {
                            black_box(tracer.shade_answer(*hit));
                        }
                    }
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

    fn shade(&mut self, shades: bool) {
        self.shades = shades;
    }

    fn trace(&mut self, set: &RaySet, answers: &mut [RayAnswer]) -> Duration {
        let how = (self.space, set.query, self.shades);
        spread(&mut self.workers, set, answers, |tracer, rays, answers| {
            for (ray, answer) in rays.iter().zip(answers) {
                *answer = ask(tracer, how, ray).expect(ALL_THERE);
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
    pub(super) shades: bool,
    pub(super) workers: Vec<PagedMesh<PooledPages>>,
}

impl Contender for PooledContender {
    fn label(&self) -> &str {
        "trex"
    }

    fn shade(&mut self, shades: bool) {
        self.shades = shades;
    }

    fn trace(&mut self, set: &RaySet, answers: &mut [RayAnswer]) -> Duration {
        let how = (self.space, set.query, self.shades);
        spread(&mut self.workers, set, answers, |tracer, rays, answers| {
            let mut pending: Vec<usize> = (0..rays.len()).collect();
            while !pending.is_empty() {
                let before = pending.len();
                tracer.begin_tile();
                pending.retain(|&at| match ask(tracer, how, &rays[at]) {
                    Some(answer) => {
                        answers[at] = answer;
                        false
                    }
                    None => true,
                });
                if pending.len() == before {
                    // Rays take each other's pages: the first one gets room for itself.
                    let at = pending.remove(0);
                    answers[at] = alone(tracer, |tracer| ask(tracer, how, &rays[at]));
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

/// The answer, or `None` when a page is missing.
fn ask(
    tracer: &mut impl Tracer,
    (space, query, shades): (Space, Query, bool),
    ray: &BenchRay,
) -> Option<RayAnswer> {
    let ray = space.to_model(ray);
    match query {
        Query::Closest if shades => {
            let shaded = black_box(exact(tracer.intersect_shaded(&ray))?);
            Some(RayAnswer::from_hit(shaded.map(|shaded| shaded.hit)))
        }
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

pub(super) fn exact<T>(answer: Answer<T>) -> Option<T> {
    match answer {
        Answer::Exact(value) => Some(value),
        Answer::Blocked => None,
    }
}
