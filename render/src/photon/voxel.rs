//! Photons through the voxels: from a light, from leaf to leaf, until roulette ends them. Paper, section 5.1.
//!
//! ```text
//! emit -> leaf: deposit the flux that arrives on the side that it meets (also from the first)
//!           -> roulette -> diffuse, glossy or mirror bounce -> leaf ...
//! ```
//!
//! A leaf has two sides (see `trex_store::octree`), and a photon goes on from the one that it meets.
//!
//! Where a section cuts a solid, photons fly into it: there are no caps in voxels. They leave their light there on the
//! inner sides of its walls, which no ray sees.
//!
//! Invariants: those of `trace.rs`; and batches that were begun are ended, so that a stopped pass goes on where it was.

use super::irradiance::{MapForm, PhotonMap, PhotonPass};
use super::trace::{Cargo, PASS_PHOTONS, VOXEL_CHANCE, bounce, keeps_light, photon_sampler, send_in_passes};
use crate::g_stage::{CpuStage, GCall, GNeeds, GRays, GStage, GUnits, GView};
use crate::sampler::Sampler;
use crate::scene::world::World;
use crate::shading::bsdf::Bsdf;
use crate::shading::light::PhotonSources;
use crate::stats::PhotonStats;
use crate::trace::{NoPages, Ray};
use crate::voxel::{GKind, VoxelScene, VoxelSurface};
use glam::{DVec3, Vec3};
use rayon::ThreadPool;
use std::ops::{ControlFlow, Range};
use std::sync::atomic::{AtomicU64, Ordering};
use trex_store::{Aabb, Budget, Lease, Result};

/// The voxels that photons go through, and the world that sends them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct VoxelPhotons<'a> {
    pub(crate) world: &'a World,
    pub(crate) bounds: &'a Aabb,
    pub(crate) voxels: VoxelScene<'a>,
    /// What answers their rays.
    pub(crate) g_stage: &'a dyn GStage,
    pub(crate) pool: &'a ThreadPool,
    pub(crate) budget: &'a Budget,
}

/// A photon on its way.
#[derive(Clone, Copy, Debug)]
struct Photon {
    sampler: Sampler,
    cargo: Cargo,
}

/// Photons side by side, each with its ray and how far that starts from the cube; a worker's.
#[derive(Debug)]
struct Flock {
    photons: Vec<(Photon, Ray, f64)>,
    rays: GRays,
}

/// A pass in work.
#[derive(Debug)]
pub(crate) struct PassInWork {
    pass: PhotonPass,
    /// Photons of the pass that are done.
    done: u64,
}

/// Photons that a worker takes at a time, for a stage with these needs.
fn batch_photons(needs: &GNeeds) -> u64 {
    (needs.photons as u64).min(PASS_PHOTONS)
}

/// Bytes that photons side by side take for so many workers and a stage with these needs, beyond those for the
/// processor's, which are too small for the ledger.
pub(crate) fn flock_bytes(workers: usize, needs: &GNeeds) -> u64 {
    let flock = |needs: &GNeeds| {
        let photon = size_of::<(Photon, Ray, f64)>() + GRays::RAY_BYTES + needs.ray_bytes;
        batch_photons(needs) * photon as u64
    };
    workers as u64 * flock(needs).saturating_sub(flock(&CpuStage::NEEDS))
}

impl Flock {
    /// No photons, with room for so many.
    fn with_room(photons: u64) -> Flock {
        let mut rays = GRays::default();
        rays.reserve_exact(photons as usize);
        Flock { photons: Vec::with_capacity(photons as usize), rays }
    }
}

impl PassInWork {
    /// A pass over what a map keeps that is to be restarted before it is sent, in a lease of [`MapForm::pass_bytes`].
    pub(crate) fn in_lease(form: MapForm, lease: Lease) -> PassInWork {
        PassInWork { pass: PhotonPass::in_lease(form, Vec3::ZERO, lease), done: 0 }
    }

    /// The lease of its memory.
    pub(crate) fn lease_mut(&mut self) -> &mut Lease {
        self.pass.lease_mut()
    }
}

impl VoxelPhotons<'_> {
    /// A pass for a map of this form, with empty sums.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when there is no room for the sums of a pass.
    pub(crate) fn begin(&self, form: MapForm) -> Result<PassInWork> {
        Ok(PassInWork { pass: PhotonPass::new(form, self.flux(), self.budget)?, done: 0 })
    }

    /// Empties the sums, for lights that have changed.
    pub(crate) fn restart(&self, work: &mut PassInWork) {
        work.pass.reset(self.flux());
        work.done = 0;
    }

    /// Flux of all lights; none where nothing gives light.
    fn flux(&self) -> Vec3 {
        PhotonSources::new(&self.world.lights, self.bounds).map_or(Vec3::ZERO, |sources| sources.flux())
    }

    /// True when anything sends photons.
    pub(crate) fn is_lit(&self) -> bool {
        PhotonSources::new(&self.world.lights, self.bounds).is_some()
    }

    /// Sends photons until `map` has those of `target`, pass by pass, or `stop`, asked between batches, says true;
    /// what is done by then stays in `work`, and a later call goes on. `tell` hears how many photons are in the map.
    pub(crate) fn trace(
        &self,
        (work, map): (&mut PassInWork, &mut PhotonMap),
        target: u64,
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u64),
    ) -> PhotonStats {
        let Some(sources) = PhotonSources::new(&self.world.lights, self.bounds) else {
            return PhotonStats::default();
        };
        let first = map.photons();
        let send = |indices: Range<u64>| {
            let stats = self.go_on(work, &indices, &sources, stop);
            if work.done < indices.end - indices.start {
                return ControlFlow::Break(stats);
            }
            self.fold(work, map);
            ControlFlow::Continue(stats)
        };
        send_in_passes(first..target, send, tell)
    }

    /// Takes the photons of a pass into `map`, also those of one that was stopped: the next pass begins after them.
    pub(crate) fn fold(&self, work: &mut PassInWork, map: &mut PhotonMap) {
        let (facets, photons) = (self.voxels.octree().facets(), std::mem::take(&mut work.done));
        if photons > 0 {
            map.fold(&mut work.pass, photons, facets, self.voxels.leaf_side());
        }
    }

    /// Goes on with the pass of `indices`.
    fn go_on(
        &self,
        work: &mut PassInWork,
        indices: &Range<u64>,
        sources: &PhotonSources<'_>,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> PhotonStats {
        let count = indices.end - indices.start;
        let (next, pass) = (AtomicU64::new(work.done), &work.pass);
        let photons = batch_photons(&self.g_stage.needs());
        let workers = self.pool.broadcast(|_| {
            let (mut mine, mut flock) = (PhotonStats::default(), Flock::with_room(photons.min(count)));
            while !stop() {
                let from = next.fetch_add(photons, Ordering::Relaxed);
                if from >= count {
                    break;
                }
                let batch = indices.start + from..indices.start + count.min(from + photons);
                self.photons(batch, (sources, pass), &mut flock, &mut mine);
            }
            mine
        });
        let mut stats = PhotonStats::default();
        workers.iter().for_each(|mine| stats.add(mine));
        // Batches that were taken are done.
        work.done = next.into_inner().min(count);
        stats
    }

    /// The photons of some indices, side by side: a ray of each, then another of those that go on.
    fn photons(
        &self,
        indices: Range<u64>,
        (sources, pass): (&PhotonSources<'_>, &PhotonPass),
        flock: &mut Flock,
        stats: &mut PhotonStats,
    ) {
        stats.photons += indices.end - indices.start;
        flock.photons.clear();
        for index in indices {
            if let Some((photon, ray)) = self.start(index, sources) {
                flock.photons.push((photon, ray, 0.0));
            }
        }
        for vertex in 0.. {
            stats.rays += flock.photons.len() as u64;
            self.ask(flock);
            let Flock { photons, rays } = &mut *flock;
            let mut answers = rays.answers().iter();
            photons.retain_mut(|(photon, ray, t_in)| {
                let answer = answers.next().expect("an answer for each ray");
                let found = answer.surface(*t_in, self.voxels.subvoxel_side());
                let next = found.and_then(|found| self.bounce((photon, vertex), (ray, &found), pass, stats));
                next.inspect(|next| *ray = *next).is_some()
            });
            if photons.is_empty() {
                return;
            }
        }
    }

    /// Has the G-stage answer the rays of all photons.
    fn ask(&self, flock: &mut Flock) {
        let Flock { photons, rays } = flock;
        rays.clear();
        for (_, ray, t_in) in photons {
            let asked;
            let (kept, from) = self.world.parts.piece(ray);
            (asked, *t_in) = self.voxels.g_ray(&kept, GKind::Photon);
            *t_in += from;
            rays.push(asked);
        }
        let view = GView { occluders: self.voxels.occluders(), units: GUnits::None };
        let call = GCall { view, parts: vec![std::mem::take(rays)] };
        let mut answered = self.g_stage.submit(call, &mut NoPages).wait();
        *rays = answered.parts.pop().expect("a call comes back whole");
    }

    /// A photon as it leaves its light.
    fn start(&self, index: u64, sources: &PhotonSources<'_>) -> Option<(Photon, Ray)> {
        let sampler = photon_sampler(self.world.settings.seed, index);
        let start = sources.emit(&sampler)?;
        let off = start.front.map_or(DVec3::ZERO, |front| self.voxels.clearance(front.into()) * front);
        let ray = Ray::new(start.origin + off, start.direction, f64::INFINITY);
        Some((Photon { sampler, cargo: Cargo::new(&start) }, ray))
    }

    /// Leaves the flux of a photon where it hit. The ray on, if it goes on.
    fn bounce(
        &self,
        (photon, vertex): (&mut Photon, u32),
        (ray, found): (&Ray, &VoxelSurface),
        pass: &PhotonPass,
        stats: &mut PhotonStats,
    ) -> Option<Ray> {
        let hit = found.face(ray, self.world.voxel_material(found.material));
        let bsdf = Bsdf {
            material: hit.material,
            colour: hit.colour,
            normal: hit.normal,
            shading_normal: hit.normal,
            wo: -DVec3::from(ray.direction),
        };
        if keeps_light(bsdf.material) {
            pass.add(hit.side, &photon.cargo);
            stats.deposits += 1;
        }
        let direction;
        (direction, photon.cargo) = bounce(&bsdf, &photon.sampler, (vertex, VOXEL_CHANCE), photon.cargo)?;
        Some(self.voxels.ray_from_leaf(&hit, direction))
    }
}
