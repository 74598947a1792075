//! Photons through the exact mesh: for `full-gi`, and for light that is baked. H. W. Jensen, "Realistic image synthesis
//! using photon mapping" (2001).
//!
//! ```text
//! batch of 4096 photons: each asks its ray -> hit: deposit the flux that arrives -> roulette -> bounce -> next ray
//!                                          -> blocked: it stays as it is, the next photon
//!     request pages, wait, ask again those that are left ([`Retry`])
//! ```
//!
//! Invariants: 1. a photon is a function of (seed, index); 2. its flux times its chance is what the lights send; 3.
//! it ends by roulette alone; 4. a batch is handed over whole, in the order of photons and bounces,
//! whatever was blocked, or not at all.

use super::trace::{CHANCE_MAX, Cargo, bounce, keeps_light, photon_sampler};
use crate::scene::world::World;
use crate::shading::light::PhotonSources;
use crate::shading::surface::{HitPoint, SurfaceInteraction};
use crate::stats::PhotonStats;
use crate::trace::{Advance, Answer, PagedTracer, Ray, Retry, WAIT};
use glam::{DVec3, Vec3};
use rayon::ThreadPool;
use std::ops::Range;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Photons that a worker takes at a time: their pages are asked for together.
pub(crate) const BATCH: u64 = 4096;
/// A photon starts off the emitter that it leaves by this share of its longest edge: eight times the tracer's plane
/// error.
const EMITTER_OFF_SHARE: f64 = 1.0 / (1 << 15) as f64;
/// A photon starts off its emitter by this share of the largest coordinate, too: for the rounding of model
/// coordinates.
const MODEL_OFF_SHARE: f64 = 1.0 / (1u64 << 46) as f64;
/// Bits of a deposit's key that number the bounce: of those beyond, one photon in 10^22 has any, all are the last.
const VERTEX_BITS: u32 = 7;

const _: () = assert!(BATCH << VERTEX_BITS <= 1 << 32);

/// Flux that arrived at the mesh.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Deposit {
    /// Photon in its batch and bounce.
    key: u32,
    /// Model units.
    pub(crate) point: DVec3,
    /// Unit, on the side that the photon came from.
    pub(crate) normal: DVec3,
    /// Unit, where it came from.
    pub(crate) from: Vec3,
    pub(crate) cargo: Cargo,
}

/// Most deposits that a batch of `photons` hands over: three a photon are the most on average, with a variance of 6;
/// eight standard deviations more come once in 10^15 batches. What is beyond is left out and counted as lost.
pub(crate) const fn deposits_max(photons: u64) -> u64 {
    3 * photons + 20 * (photons.isqrt() + 1) + 64
}

/// Bytes that tracing photons on the mesh takes for `worker_count` workers.
pub(crate) fn flight_bytes(worker_count: usize) -> u64 {
    let batch = BATCH * size_of::<Flight>() as u64 + deposits_max(BATCH) * size_of::<Deposit>() as u64;
    worker_count as u64 * batch
}

/// Photons, the world that they fly through, and who takes what they bring.
pub(crate) struct MeshPhotons<'a> {
    pub(crate) world: &'a World,
    pub(crate) sources: &'a PhotonSources<'a>,
    /// Takes the deposits of the batch with this number, counted from photon 0; gives how many it kept.
    pub(crate) land: &'a (dyn Fn(u64, &[Deposit]) -> u64 + Sync),
    pub(crate) stop: &'a (dyn Fn() -> bool + Sync),
    /// One thread a tracer.
    pub(crate) pool: &'a ThreadPool,
}

/// A photon under way.
#[derive(Clone, Copy, Debug)]
struct Flight {
    /// Index in its batch.
    index: u32,
    vertex: u32,
    cargo: Cargo,
    ray: Ray,
}

/// A batch of photons, and what it has brought.
struct Batch<'a> {
    photons: &'a MeshPhotons<'a>,
    /// Index of its first photon.
    first: u64,
    deposits: Vec<Deposit>,
    stats: PhotonStats,
}

struct MeshWorker<'a, T> {
    tracer: &'a mut T,
    retry: Retry,
    flights: Vec<Flight>,
    batch: Batch<'a>,
}

impl MeshPhotons<'_> {
    /// Sends the photons with these indices, from a whole batch on; a worker a tracer. `None` when it was stopped: some
    /// batches have landed then, others have not.
    pub(crate) fn trace<T: PagedTracer + Send>(
        &self,
        tracers: &mut [T],
        indices: Range<u64>,
    ) -> Option<PhotonStats> {
        assert_eq!(indices.start % BATCH, 0, "photons begin with a batch");
        let (next, is_stopped) = (AtomicU64::new(indices.start), AtomicBool::new(false));
        let photons = indices.end - indices.start;
        let stats = Mutex::new(PhotonStats { photons, ..PhotonStats::default() });
        self.pool.scope(|scope| {
            for tracer in tracers {
                scope.spawn(|_| {
                    let mut worker = MeshWorker::new(self, tracer);
                    let is_whole = worker.work(&next, indices.end);
                    is_stopped.fetch_or(!is_whole, Ordering::Relaxed);
                    let mine = PhotonStats { waits: worker.retry.waits, ..worker.batch.stats };
                    stats.lock().expect("a worker panicked").add(&mine);
                });
            }
        });
        (!is_stopped.into_inner()).then_some(stats.into_inner().expect("a worker panicked"))
    }
}

impl<'a, T: PagedTracer> MeshWorker<'a, T> {
    fn new(photons: &'a MeshPhotons<'a>, tracer: &'a mut T) -> MeshWorker<'a, T> {
        let deposits = Vec::with_capacity(deposits_max(BATCH) as usize);
        let batch = Batch { photons, first: 0, deposits, stats: PhotonStats::default() };
        let flights = Vec::with_capacity(BATCH as usize);
        MeshWorker { tracer, retry: Retry::default(), flights, batch }
    }

    /// Batches from `next` to `end`; false when it was stopped before.
    fn work(&mut self, next: &AtomicU64, end: u64) -> bool {
        loop {
            let from = next.fetch_add(BATCH, Ordering::Relaxed);
            if from >= end {
                return true;
            }
            if !self.send(from..end.min(from + BATCH)) {
                return false;
            }
        }
    }

    /// One batch, to its end; false when it was stopped before, which is asked for each photon.
    fn send(&mut self, indices: Range<u64>) -> bool {
        let MeshWorker { tracer, retry, flights, batch } = self;
        let stop = batch.photons.stop;
        batch.first = indices.start;
        batch.deposits.clear();
        flights.clear();
        flights.extend(indices.filter_map(|index| batch.start(index)));
        loop {
            tracer.begin_tile();
            let (mut has_advanced, mut is_stopped) = (false, false);
            flights.retain_mut(|flight| {
                is_stopped |= stop();
                let advance = if is_stopped { Advance::Blocked } else { batch.fly(*tracer, flight) };
                has_advanced |= advance != Advance::Blocked;
                advance != Advance::Done
            });
            if is_stopped {
                return false;
            }
            if flights.is_empty() {
                break;
            }
            tracer.request_missing();
            retry.wait(*tracer, WAIT);
            if retry.is_stuck(has_advanced) {
                let mut flight = flights.remove(0);
                let longest = || (!stop()).then_some(WAIT);
                if !retry.alone(*tracer, longest, |tracer| batch.fly(tracer, &mut flight)) {
                    return false;
                }
            }
        }
        batch.land();
        true
    }
}

impl Batch<'_> {
    /// Photon `index` as it leaves its light.
    fn start(&self, index: u64) -> Option<Flight> {
        let start = self.photons.sources.emit(&photon_sampler(self.photons.world.settings.seed, index))?;
        let largest = start.origin.abs().max_element();
        let off = EMITTER_OFF_SHARE * start.size + MODEL_OFF_SHARE * largest;
        let origin = start.front.map_or(start.origin, |front| start.origin + off * front);
        let ray = Ray::new(origin, start.direction, f64::INFINITY);
        Some(Flight { index: (index - self.first) as u32, vertex: 0, cargo: Cargo::new(&start), ray })
    }

    /// A photon as far as the answers go.
    fn fly<T: PagedTracer>(&mut self, tracer: &mut T, flight: &mut Flight) -> Advance {
        let world = self.photons.world;
        let sampler = photon_sampler(world.settings.seed, self.first + u64::from(flight.index));
        let mut advance = Advance::Blocked;
        loop {
            let Answer::Exact(hit) = tracer.intersect_shaded(&flight.ray) else { return advance };
            advance = Advance::Answered;
            self.stats.rays += 1;
            let Some(hit) = hit.map(|hit| HitPoint::from(&hit)) else { return Advance::Done };
            let surface = SurfaceInteraction::new(&flight.ray, &hit).unseen(&world.materials);
            let bsdf = surface.bsdf(&world.materials);
            if keeps_light(bsdf.material) {
                self.deposit(flight, &surface);
            }
            let next = bounce(&bsdf, &sampler, (flight.vertex, CHANCE_MAX), flight.cargo);
            let Some((direction, cargo)) = next else { return Advance::Done };
            flight.vertex += 1;
            (flight.cargo, flight.ray) = (cargo, surface.ray_to(direction, f64::INFINITY, None));
        }
    }

    fn deposit(&mut self, flight: &Flight, surface: &SurfaceInteraction) {
        if self.deposits.len() == self.deposits.capacity() {
            self.stats.lost += 1;
            return;
        }
        let SurfaceInteraction { point, normal, wo, .. } = *surface;
        let key = flight.index << VERTEX_BITS | flight.vertex.min((1 << VERTEX_BITS) - 1);
        self.deposits.push(Deposit { key, point, normal, from: wo.as_vec3(), cargo: flight.cargo });
    }

    /// Hands over what has arrived, in the order of photons and bounces.
    fn land(&mut self) {
        self.deposits.sort_unstable_by_key(|deposit| deposit.key);
        let kept = (self.photons.land)(self.first / BATCH, &self.deposits);
        self.stats.deposits += kept;
        self.stats.lost += self.deposits.len() as u64 - kept;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photon::trace::Way;
    use crate::scene::camera::Camera;
    use crate::scene::method::Method;
    use crate::scene::settings::RenderKeys;
    use crate::scene::world::{Model, View};
    use crate::shading::light::Light;
    use crate::testing::{pool, settings};
    use crate::trace::{Hit, NaiveMesh, NaiveTriangle, Tracer};
    use std::collections::HashMap;
    use std::time::Duration;
    use trex_film::mix;
    use trex_store::{Aabb, Material};

    impl Deposit {
        /// The first hit of the first photon.
        pub(crate) fn new(point: DVec3, normal: DVec3, from: Vec3, flux: Vec3) -> Deposit {
            Deposit { key: 0, point, normal, from, cargo: Cargo { flux, way: Way::Gathered } }
        }
    }

    /// An open box with a sun above: photons bounce in it, and some leave.
    fn model() -> (Model, NaiveMesh) {
        let mut triangles = vec![];
        for axis in 0..3 {
            for side in [0.0, 1.0] {
                if (axis, side) == (2, 1.0) {
                    continue;
                }
                let corner = |u: f64, v: f64| {
                    let mut at = [side; 3];
                    (at[(axis + 1) % 3], at[(axis + 2) % 3]) = (u, v);
                    at
                };
                let [a, b, c, d] = [corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)];
                let material = u32::from(axis == 1);
                triangles.extend([[a, b, c], [a, c, d]].map(|corners| NaiveTriangle { corners, material }));
            }
        }
        let mirror = Material { ks: [0.9; 3], kd: [0.0; 3], mirror: true, ..Material::default() };
        let bounds = Aabb { lo: [0.0; 3], hi: [1.0; 3] };
        let materials = vec![Material::default(), mirror];
        (
            Model {
                bounds,
                outline: Default::default(),
                materials,
                names: Default::default(),
                emitters: vec![],
                voxels: None,
            },
            NaiveMesh::new(triangles),
        )
    }

    /// Answers a ray only after some refusals; the stubborn kind only when it is asked for one ray twice in a row.
    struct Reluctant {
        mesh: NaiveMesh,
        is_stubborn: bool,
        refused: HashMap<u64, u64>,
        last: u64,
    }

    impl Reluctant {
        fn new(is_stubborn: bool) -> Reluctant {
            Reluctant { mesh: model().1, is_stubborn, refused: HashMap::new(), last: 0 }
        }
    }

    impl Tracer for Reluctant {
        fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
            let key = ray.origin.iter().chain(&ray.direction).fold(1, |key, x| mix(key ^ x.to_bits()));
            let refused = self.refused.entry(key).or_insert(0);
            *refused += 1;
            let answers = if self.is_stubborn { self.last == key } else { *refused > key % 4 };
            self.last = key;
            if answers { self.mesh.intersect(ray) } else { Answer::Blocked }
        }

        fn occluded(&mut self, _: &Ray) -> Answer<bool> {
            unreachable!("photons ask for closest hits")
        }
    }

    impl PagedTracer for Reluctant {
        fn begin_tile(&mut self) {}
        fn request_missing(&mut self) -> usize {
            1
        }
        fn wait(&mut self, _: Duration) {}
    }

    /// The deposits of photons 0 to `count`, batch by batch, and what was done for them.
    fn trace<T: PagedTracer + Send>(mut tracers: Vec<T>, count: u64) -> (Vec<Vec<Deposit>>, PhotonStats) {
        let (model, _) = model();
        let camera = Camera::framing(&model.bounds, [8, 8], None, None);
        let sun = Light::Directional { direction: [0.3, 0.2, -1.0], irradiance: [2.0; 3] };
        let keys = RenderKeys {
            integrator: Method::FullGi,
            resolution: [8, 8],
            n_shadow: 1,
            seed: 4,
            ..RenderKeys::default()
        };
        let view = View { camera, lights: vec![sun], settings: settings(keys), parts: Default::default() };
        let world = World::new(&model, &view).unwrap();
        let sources = PhotonSources::new(&world.lights, &model.bounds).unwrap();
        let landed = Mutex::new(vec![vec![]; count.div_ceil(BATCH) as usize]);
        let land = |batch: u64, deposits: &[Deposit]| {
            landed.lock().unwrap()[batch as usize] = deposits.to_vec();
            deposits.len() as u64
        };
        let pool = pool(tracers.len());
        let photons =
            MeshPhotons { world: &world, sources: &sources, land: &land, stop: &|| false, pool: &pool };
        let stats = photons.trace(&mut tracers, 0..count).unwrap();
        (landed.into_inner().unwrap(), stats)
    }

    fn is_same(a: &[Vec<Deposit>], b: &[Vec<Deposit>]) -> bool {
        let bits = |d: &Deposit| {
            (d.key, d.point.to_array().map(f64::to_bits), d.cargo.flux.to_array().map(f32::to_bits))
        };
        a.iter().flatten().map(bits).eq(b.iter().flatten().map(bits))
    }

    #[test]
    fn deposits_do_not_depend_on_threads_or_blocked_rays() {
        let (expected, one) = trace(vec![model().1], 9000);
        assert_eq!((one.photons, one.waits, one.lost, expected.len()), (9000, 0, 0, 3));
        let mean = one.deposits as f64 / 9000.0;
        assert!(mean > 1.0 && mean < 3.0 && one.rays > one.deposits, "{one:?}");
        for threads in 1..=3 {
            let (found, stats) = trace(vec![model().1; threads], 9000);
            assert!(is_same(&found, &expected) && stats == one, "{threads} threads");
            let (found, stats) = trace((0..threads).map(|_| Reluctant::new(false)).collect(), 9000);
            assert!(is_same(&found, &expected) && stats.waits > 0, "{threads} threads that hesitate");
        }
        let (few, _) = trace(vec![model().1], 30);
        let (found, _) = trace(vec![Reluctant::new(true)], 30);
        assert!(is_same(&found, &few), "room for one ray");
    }

    #[test]
    fn the_flux_that_first_arrives_is_what_the_sun_sends() {
        let (found, _) = trace(vec![model().1], 3 * BATCH);
        let direction = DVec3::new(0.3, 0.2, -1.0).normalize();
        let first = |d: &&Deposit| d.key.trailing_zeros() >= VERTEX_BITS && d.normal[2] > 0.9;
        let on_floor: f64 = found.iter().flatten().filter(first).map(|d| f64::from(d.cargo.flux[0])).sum();
        // The open top passes it all; the walls throw their shadows on the floor, but for mirrors, which take none.
        let lit = (1.0 - 0.3) * (1.0 - 0.2) * -direction[2] * 2.0;
        let found = on_floor / (3 * BATCH) as f64;
        assert!((found / lit - 1.0).abs() < 0.03, "{found} for {lit}");
    }
}
