//! Photons through the exact mesh, for `full-gi`; and what they share with those through voxels. H. W. Jensen,
//! "Realistic image synthesis using photon mapping" (2001).
//!
//! ```text
//! batch of 4096 photons: each asks its ray -> hit: deposit the flux that arrives -> roulette -> bounce -> next ray
//!                                          -> blocked: it stays as it is, the next photon
//!     request pages, wait, ask again those that are left; STALLED_ROUNDS without one answer: one photon alone
//! ```
//!
//! Why it ends, however few frames there are: as in [`crate::frame`], a photon keeps what it has, and alone it wants the
//! pages of one ray.
//!
//! Invariants: 1. a photon is a function of (seed, index); 2. its flux times its chance is what the lights send; 3. it has
//! at most [`BOUNCES_MAX`] bounces; 4. a batch is handed over whole, in the order of photons and bounces, whatever was
//! blocked, or not at all.

use crate::frame::PagedTracer;
use crate::light::PhotonSources;
use crate::material::scatter;
use crate::math::{along, max_rgb, mul_rgb, scale_rgb};
use crate::sampler::{Decision, Sampler};
use crate::surface::Surface;
use crate::trace::{Answer, Ray};
use crate::world::World;
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Duration;
use trex_store::Material;

/// Photons that a worker takes at a time: their pages are asked for together.
pub(crate) const BATCH: u64 = 4096;
/// Most bounces of a photon: one in 10^11 gets so far.
pub(crate) const BOUNCES_MAX: u32 = 64;
/// Chance to go on after a hit, at most: three hits of a photon on average, as the paper has it.
const ROULETTE_MAX: f32 = 2.0 / 3.0;
/// Keeps photons apart from the pixels that use the same seed.
const SEED_OF_PHOTONS: u64 = 0x7068_6f74_6f6e_7331;
/// Rounds over a batch without one answer before one photon goes alone: late pages are more likely than lack of room.
const STALLED_ROUNDS: u32 = 4;
/// Longest sleep for pages: arrivals wake it earlier.
const WAIT: Duration = Duration::from_millis(50);
/// A photon starts off the emitter that it leaves by this share of its longest edge: eight times the tracer's plane error.
const EMITTER_OFF_SHARE: f64 = 1.0 / (1 << 15) as f64;
/// The same for the rounding of model coordinates, as a share of the largest one.
const MODEL_OFF_SHARE: f64 = 1.0 / (1u64 << 46) as f64;
/// Bits of a deposit's key that number the bounce.
const VERTEX_BITS: u32 = 7;

const _: () = assert!(BOUNCES_MAX < 1 << VERTEX_BITS && BATCH << VERTEX_BITS <= 1 << 32);

/// What photon tracing did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PhotonStats {
    /// Photons sent.
    pub photons: u64,
    /// Rays that they took.
    pub rays: u64,
    /// Hits whose flux was kept: added to a facet, or stored as a photon of `full-gi`.
    pub deposits: u64,
    /// Hits whose flux found no place.
    pub lost: u64,
    /// Times that a worker waited for pages.
    pub waits: u64,
}

impl PhotonStats {
    /// Adds another worker or pass.
    pub fn add(&mut self, other: &PhotonStats) {
        self.photons += other.photons;
        self.rays += other.rays;
        self.deposits += other.deposits;
        self.lost += other.lost;
        self.waits += other.waits;
    }
}

/// Flux that arrived at the mesh.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Deposit {
    /// Photon in its batch and bounce.
    key: u32,
    /// Model units.
    pub(crate) point: [f64; 3],
    /// Unit, on the side that the photon came from.
    pub(crate) normal: [f64; 3],
    /// Unit, where it came from.
    pub(crate) from: [f32; 3],
    /// Flux over the photon's chance, W in linear RGB.
    pub(crate) flux: [f32; 3],
}

/// Most deposits that a batch of `photons` hands over: three a photon are the most on average, with a variance of 6; eight
/// standard deviations more come once in 10^15 batches. What is beyond is left out and counted as lost.
pub(crate) const fn deposits_max(photons: u64) -> u64 {
    3 * photons + 20 * (photons.isqrt() + 1) + 64
}

/// Bytes that the tracing takes for `worker_count` workers.
pub(crate) fn flight_bytes(worker_count: usize) -> u64 {
    let batch = BATCH * size_of::<Flight>() as u64 + deposits_max(BATCH) * size_of::<Deposit>() as u64;
    worker_count as u64 * batch
}

/// The numbers of photon `index`.
pub(crate) fn photon_sampler(seed: u64, index: u64) -> Sampler {
    let block = [(index >> 16) as u32, (index >> 48) as u32];
    Sampler::new(seed ^ SEED_OF_PHOTONS, block, index as u32 & 0xffff)
}

/// A surface that a photon meets: material, unit normal and where it came from, unit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Met<'a> {
    pub(crate) material: &'a Material,
    pub(crate) normal: [f64; 3],
    pub(crate) to_viewer: [f64; 3],
}

impl Met<'_> {
    /// Whether light stays here: on a pure mirror none does.
    pub(crate) fn keeps_light(&self) -> bool {
        !self.material.mirror || self.material.kd != [0.0; 3]
    }

    /// Where a photon of `flux` goes on from its hit `vertex`, and with which flux; `None` at its end.
    pub(crate) fn bounce(
        &self,
        sampler: &Sampler,
        vertex: u32,
        flux: [f32; 3],
    ) -> Option<([f64; 3], [f32; 3])> {
        let u = sampler.draw(Decision::Gather { vertex, index: 0, count: 1 });
        let bounce = scatter(self.material, self.normal, self.to_viewer, u)?;
        let chance = max_rgb(bounce.weight).min(ROULETTE_MAX);
        if sampler.draw(Decision::Roulette(vertex))[0] >= chance {
            return None;
        }
        Some((bounce.direction, scale_rgb(1.0 / chance, mul_rgb(flux, bounce.weight))))
    }
}

/// Photons, the world that they fly through, and who takes what they bring.
pub(crate) struct MeshPhotons<'a> {
    pub(crate) world: &'a World,
    pub(crate) sources: &'a PhotonSources<'a>,
    /// Takes the deposits of the batch with this number, counted from photon 0; gives how many it kept.
    pub(crate) land: &'a (dyn Fn(u64, &[Deposit]) -> u64 + Sync),
    pub(crate) stop: &'a (dyn Fn() -> bool + Sync),
}

/// A photon under way.
#[derive(Clone, Copy, Debug)]
struct Flight {
    /// In its batch.
    index: u32,
    vertex: u32,
    flux: [f32; 3],
    ray: Ray,
}

struct Worker<'a, T> {
    photons: &'a MeshPhotons<'a>,
    tracer: &'a mut T,
    /// First photon of the batch.
    first: u64,
    flights: Vec<Flight>,
    deposits: Vec<Deposit>,
    stats: PhotonStats,
}

impl MeshPhotons<'_> {
    /// Sends the photons with these indices, from a whole batch on; a worker thread per tracer. `None` when it was stopped:
    /// some batches have landed then, others have not.
    ///
    /// # Panics
    /// When a worker panics.
    pub(crate) fn trace<T: PagedTracer + Send>(
        &self,
        tracers: &mut [T],
        indices: Range<u64>,
    ) -> Option<PhotonStats> {
        assert_eq!(indices.start % BATCH, 0, "photons begin with a batch");
        let (next, stopped) = (AtomicU64::new(indices.start), AtomicBool::new(false));
        let work = |tracer: &mut T| {
            let mut worker = Worker {
                photons: self,
                tracer,
                first: 0,
                flights: Vec::with_capacity(BATCH as usize),
                deposits: Vec::with_capacity(deposits_max(BATCH) as usize),
                stats: PhotonStats::default(),
            };
            loop {
                let from = next.fetch_add(BATCH, Ordering::Relaxed);
                if from >= indices.end {
                    return worker.stats;
                }
                if !worker.batch(from..indices.end.min(from + BATCH)) {
                    stopped.store(true, Ordering::Relaxed);
                    return worker.stats;
                }
            }
        };
        let work = &work;
        let done: Vec<PhotonStats> = std::thread::scope(|scope| {
            let workers: Vec<_> =
                tracers.iter_mut().map(|tracer| scope.spawn(move || work(tracer))).collect();
            workers.into_iter().map(|worker| worker.join().expect("a worker panicked")).collect()
        });
        let mut stats = PhotonStats { photons: indices.end - indices.start, ..PhotonStats::default() };
        done.iter().for_each(|mine| stats.add(mine));
        (!stopped.into_inner()).then_some(stats)
    }
}

impl<T: PagedTracer> Worker<'_, T> {
    /// One batch, to its end; false when it was stopped before.
    fn batch(&mut self, indices: Range<u64>) -> bool {
        self.first = indices.start;
        self.deposits.clear();
        let mut flights = std::mem::take(&mut self.flights);
        flights.clear();
        flights.extend(indices.clone().filter_map(|index| self.start(index)));
        let mut stalled = 0;
        loop {
            if (self.photons.stop)() {
                return false;
            }
            self.tracer.begin_tile(0);
            let mut advanced = false;
            flights.retain_mut(|flight| {
                let before = flight.vertex;
                let flies = self.fly(flight);
                advanced |= !flies || flight.vertex > before;
                flies
            });
            if flights.is_empty() {
                break;
            }
            self.wait();
            stalled = if advanced { 0 } else { stalled + 1 };
            if stalled == STALLED_ROUNDS {
                if !self.alone(flights.remove(0)) {
                    return false;
                }
                stalled = 0;
            }
        }
        self.flights = flights;
        self.deposits.sort_unstable_by_key(|deposit| deposit.key);
        let kept = (self.photons.land)(indices.start / BATCH, &self.deposits);
        self.stats.deposits += kept;
        self.stats.lost += self.deposits.len() as u64 - kept;
        true
    }

    /// One photon to its end, with the pages of one ray at a time; false when it was stopped before.
    fn alone(&mut self, mut flight: Flight) -> bool {
        self.tracer.begin_tile(0);
        loop {
            let before = flight.vertex;
            if !self.fly(&mut flight) {
                return true;
            }
            if flight.vertex > before {
                self.tracer.begin_tile(0);
                continue;
            }
            self.wait();
            if (self.photons.stop)() {
                return false;
            }
        }
    }

    fn wait(&mut self) {
        self.tracer.request_missing();
        self.stats.waits += 1;
        self.tracer.wait(WAIT);
    }

    /// Photon `index` as it leaves its light.
    fn start(&self, index: u64) -> Option<Flight> {
        let start = self.photons.sources.emit(&photon_sampler(self.photons.world.seed, index))?;
        let largest = start.origin.iter().fold(0.0f64, |most, x| most.max(x.abs()));
        let off = EMITTER_OFF_SHARE * start.size + MODEL_OFF_SHARE * largest;
        let origin = start.front.map_or(start.origin, |front| along(start.origin, off, front));
        let ray = Ray { origin, direction: start.direction, t_max: f64::INFINITY };
        Some(Flight { index: (index - self.first) as u32, vertex: 0, flux: start.flux, ray })
    }

    /// As far as the answers go; false at the photon's end.
    fn fly(&mut self, flight: &mut Flight) -> bool {
        let world = self.photons.world;
        let sampler = photon_sampler(world.seed, self.first + u64::from(flight.index));
        loop {
            let Answer::Exact(hit) = self.tracer.intersect(&flight.ray) else { return true };
            self.stats.rays += 1;
            let Some(hit) = hit else { return false };
            let surface = Surface::new(&flight.ray, &hit);
            let Surface { normal, to_viewer, .. } = surface;
            let met = Met { material: &world.materials[hit.material as usize], normal, to_viewer };
            if met.keeps_light() {
                self.deposit(flight, &surface);
            }
            let Some((direction, flux)) = met.bounce(&sampler, flight.vertex, flight.flux) else {
                return false;
            };
            flight.vertex += 1;
            if flight.vertex > BOUNCES_MAX {
                return false;
            }
            (flight.flux, flight.ray) = (flux, surface.ray_to(direction, f64::INFINITY, None));
        }
    }

    fn deposit(&mut self, flight: &Flight, surface: &Surface) {
        if self.deposits.len() == self.deposits.capacity() {
            self.stats.lost += 1;
            return;
        }
        let Surface { point, normal, to_viewer, .. } = *surface;
        let key = flight.index << VERTEX_BITS | flight.vertex;
        let from = to_viewer.map(|x| x as f32);
        self.deposits.push(Deposit { key, point, normal, from, flux: flight.flux });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use crate::integrator::Method;
    use crate::light::Light;
    use crate::sampler::mix;
    use crate::trace::naive::{NaiveMesh, NaiveTriangle};
    use crate::trace::{Hit, Tracer};
    use crate::world::{GRays, Model, View};
    use std::collections::HashMap;
    use std::sync::Mutex;
    use trex_store::Aabb;

    impl Deposit {
        /// The first hit of the first photon.
        pub(crate) fn new(point: [f64; 3], normal: [f64; 3], from: [f32; 3], flux: [f32; 3]) -> Deposit {
            Deposit { key: 0, point, normal, from, flux }
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
        (Model { bounds, materials, emitters: vec![], voxels: None }, NaiveMesh::new(triangles))
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
        fn begin_tile(&mut self, _: u32) {}
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
        let (lights, g_rays) = (vec![sun], GRays::default());
        let (resolution, n_shadow, seed, method) = ([8, 8], 1, 4, Method::FullGi);
        let lod_error_pixels = 0.0;
        let view = View { camera, resolution, lights, n_shadow, seed, method, g_rays, lod_error_pixels };
        let world = World::new(&model, &view).unwrap();
        let sources = PhotonSources::new(&world.lights, &model.bounds).unwrap();
        let landed = Mutex::new(vec![vec![]; count.div_ceil(BATCH) as usize]);
        let land = |batch: u64, deposits: &[Deposit]| {
            landed.lock().unwrap()[batch as usize] = deposits.to_vec();
            deposits.len() as u64
        };
        let photons = MeshPhotons { world: &world, sources: &sources, land: &land, stop: &|| false };
        let stats = photons.trace(&mut tracers, 0..count).unwrap();
        (landed.into_inner().unwrap(), stats)
    }

    fn is_same(a: &[Vec<Deposit>], b: &[Vec<Deposit>]) -> bool {
        let bits = |d: &Deposit| (d.key, d.point.map(f64::to_bits), d.flux.map(f32::to_bits));
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
        let direction = crate::math::unit([0.3, 0.2, -1.0]).unwrap();
        let first = |d: &&Deposit| d.key.trailing_zeros() >= VERTEX_BITS && d.normal[2] > 0.9;
        let on_floor: f64 = found.iter().flatten().filter(first).map(|d| f64::from(d.flux[0])).sum();
        // The open top passes it all; the walls throw their shadows on the floor, but for mirrors, which take none.
        let lit = (1.0 - 0.3) * (1.0 - 0.2) * -direction[2] * 2.0;
        let found = on_floor / (3 * BATCH) as f64;
        assert!((found / lit - 1.0).abs() < 0.03, "{found} for {lit}");
    }
}
