//! Photons through the voxels: from a light, from leaf to leaf, until roulette ends them. Paper, section 5.1. What a photon
//! is, and how it bounces, stands in `photon_flight.rs`.
//!
//! ```text
//! emit -> leaf: deposit the flux that arrives in its facet (also from the first) -> roulette -> diffuse, glossy or mirror bounce -> leaf ...
//! ```
//!
//! The surface in a leaf is its mean normal and its material of most area; where the normals cancel each other, light goes
//! back to where it came from, by the cosine about the photon's own direction.
//!
//! Invariants: 1. a photon is a function of (seed, index); 2. its flux times its chance is what the lights send; 3. it has
//! at most [`BOUNCES_MAX`] bounces.

use super::map::{PASS_PHOTONS, PhotonMap, PhotonPass};
use super::traverse::{GRay, VoxelHit, VoxelScene};
use crate::light::PhotonSources;
use crate::math::{along, dot, scale, to_f64};
use crate::photon_flight::{BOUNCES_MAX, Met, PhotonStats, photon_sampler};
use crate::sampler::Sampler;
use crate::world::World;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use trex_store::octree::LeafVoxel;
use trex_store::{Aabb, Budget, Material, Result};

/// Photons that a worker takes at a time: some milliseconds, the most that a deadline is passed by.
const BATCH: u64 = 512;

/// Where a photon or a gather ray met the voxels.
#[derive(Clone, Copy, Debug)]
pub(super) struct LeafHit<'a> {
    pub(super) facet: u32,
    pub(super) point: [f64; 3],
    /// Unit, on the side that the ray came from.
    pub(super) normal: [f64; 3],
    pub(super) material: &'a Material,
}

/// What photons go through, and who sends them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PhotonWorld<'a> {
    pub(crate) world: &'a World,
    pub(crate) bounds: &'a Aabb,
    pub(crate) voxels: VoxelScene<'a>,
    pub(crate) threads: usize,
    pub(crate) budget: &'a Budget,
}

impl<'a> VoxelScene<'a> {
    /// The surface in the leaf that `ray` has met.
    pub(super) fn leaf_hit(&self, ray: &GRay, hit: &VoxelHit, materials: &'a [Material]) -> LeafHit<'a> {
        self.surface_of(&self.octree().leaf(hit.leaf as usize), ray, hit, materials)
    }

    /// The surface in `voxel`, which `ray` has met, and which is `hit.leaf` or in it.
    pub(super) fn surface_of(
        &self,
        voxel: &LeafVoxel,
        ray: &GRay,
        hit: &VoxelHit,
        materials: &'a [Material],
    ) -> LeafHit<'a> {
        let normal = to_f64(voxel.normal);
        let facing = dot(normal, ray.direction);
        let normal = if facing == 0.0 { scale(-1.0, ray.direction) } else { scale(-facing.signum(), normal) };
        let point = along(ray.origin, hit.t, ray.direction);
        let facet = self.octree().facet(hit.node, hit.leaf);
        LeafHit { facet, point, normal, material: &materials[usize::from(voxel.material)] }
    }

    /// A ray that leaves a leaf: it starts where no voxel of the plane through any point of the subvoxel can be.
    pub(super) fn ray_from_leaf(&self, hit: &LeafHit<'_>, direction: [f64; 3]) -> GRay {
        let origin = along(hit.point, 2.0 * self.clearance(hit.normal), hit.normal);
        GRay { origin, direction, t_max: f64::INFINITY }
    }
}

/// A photon on its way.
#[derive(Clone, Copy, Debug)]
struct Photon {
    sampler: Sampler,
    flux: [f32; 3],
}

/// Photons side by side; a worker's, at most [`BATCH`], too small for the ledger.
#[derive(Debug, Default)]
struct Flock {
    photons: Vec<Photon>,
    rays: Vec<GRay>,
    hits: Vec<Option<VoxelHit>>,
}

/// A pass in work.
#[derive(Debug)]
pub(crate) struct PhotonWork {
    pass: PhotonPass,
    /// Photons of the pass that are done.
    done: u64,
}

impl PhotonWorld<'_> {
    /// Empty sums; `None` when nothing gives light.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when there is no room for the sums of a pass.
    pub(crate) fn begin(&self) -> Result<Option<PhotonWork>> {
        let Some(sources) = PhotonSources::new(&self.world.lights, self.bounds) else { return Ok(None) };
        let pass = PhotonPass::new(self.voxels.octree().facets().count(), sources.flux(), self.budget)?;
        Ok(Some(PhotonWork { pass, done: 0 }))
    }

    /// Empties the sums, for lights that have changed.
    pub(crate) fn restart(&self, work: &mut PhotonWork) {
        let flux =
            PhotonSources::new(&self.world.lights, self.bounds).map_or([0.0; 3], |sources| sources.flux());
        work.pass.reset(flux);
        work.done = 0;
    }

    /// Whether anything sends photons.
    pub(crate) fn is_lit(&self) -> bool {
        PhotonSources::new(&self.world.lights, self.bounds).is_some()
    }

    /// Sends photons until `map` has those of `target`, pass by pass, or `stop`, asked between batches, says true; what is
    /// done by then stays in `work`, and a later call goes on. `tell` hears how many photons are in the map.
    pub(crate) fn trace(
        &self,
        (work, map): (&mut PhotonWork, &mut PhotonMap),
        target: u64,
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u64),
    ) -> PhotonStats {
        let mut stats = PhotonStats::default();
        let Some(sources) = PhotonSources::new(&self.world.lights, self.bounds) else { return stats };
        while map.photons() < target {
            let first = map.photons();
            let count = PASS_PHOTONS.min(target - first);
            let (next, pass) = (AtomicU64::new(work.done), &work.pass);
            let run = || {
                let (mut mine, mut flock) = (PhotonStats::default(), Flock::default());
                while !stop() {
                    let from = next.fetch_add(BATCH, Ordering::Relaxed);
                    if from >= count {
                        break;
                    }
                    let indices = first + from..first + count.min(from + BATCH);
                    self.photons(indices, (&sources, pass), &mut flock, &mut mine);
                }
                mine
            };
            let done: Vec<PhotonStats> = std::thread::scope(|scope| {
                let workers: Vec<_> = (0..self.threads.max(1)).map(|_| scope.spawn(run)).collect();
                workers.into_iter().map(|worker| worker.join().expect("a worker panicked")).collect()
            });
            done.iter().for_each(|mine| stats.add(mine));
            // Batches that were taken are done.
            work.done = next.into_inner().min(count);
            if work.done < count {
                break;
            }
            work.done = 0;
            map.fold(&mut work.pass, count, self.voxels.octree().facets(), self.voxels.leaf_side());
            tell(map.photons());
        }
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
        let Flock { photons, rays, hits } = flock;
        photons.clear();
        rays.clear();
        for index in indices {
            if let Some((photon, ray)) = self.start(index, sources) {
                photons.push(photon);
                rays.push(ray);
            }
        }
        for vertex in 0..=BOUNCES_MAX {
            stats.rays += rays.len() as u64;
            hits.clear();
            hits.resize(rays.len(), None);
            self.voxels.intersect_batch(rays, hits);
            let mut kept = 0;
            for at in 0..rays.len() {
                let Some(hit) = &hits[at] else { continue };
                let mut photon = photons[at];
                if let Some(ray) = self.bounce((&mut photon, vertex), (&rays[at], hit), pass, stats) {
                    (photons[kept], rays[kept]) = (photon, ray);
                    kept += 1;
                }
            }
            photons.truncate(kept);
            rays.truncate(kept);
            if rays.is_empty() {
                return;
            }
        }
    }

    /// A photon as it leaves its light.
    fn start(&self, index: u64, sources: &PhotonSources<'_>) -> Option<(Photon, GRay)> {
        let sampler = photon_sampler(self.world.seed, index);
        let start = sources.emit(&sampler)?;
        let off = start.front.map_or([0.0; 3], |front| scale(self.voxels.clearance(front), front));
        let origin = along(start.origin, 1.0, off);
        let ray = GRay { origin, direction: start.direction, t_max: f64::INFINITY };
        Some((Photon { sampler, flux: start.flux }, ray))
    }

    /// Leaves the flux of a photon where it hit. The ray on, if it goes on.
    fn bounce(
        &self,
        (photon, vertex): (&mut Photon, u32),
        (ray, hit): (&GRay, &VoxelHit),
        pass: &PhotonPass,
        stats: &mut PhotonStats,
    ) -> Option<GRay> {
        let hit = self.voxels.leaf_hit(ray, hit, &self.world.materials);
        let met = Met { material: hit.material, normal: hit.normal, to_viewer: scale(-1.0, ray.direction) };
        if met.keeps_light() {
            pass.add(hit.facet, photon.flux);
            stats.deposits += 1;
        }
        let (direction, flux) = met.bounce(&photon.sampler, vertex, photon.flux)?;
        photon.flux = flux;
        Some(self.voxels.ray_from_leaf(&hit, direction))
    }
}
