//! Photons through the voxels: from a light, from leaf to leaf, until roulette ends them. Paper, section 5.1; H. W. Jensen,
//! "Realistic image synthesis using photon mapping" (2001).
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
use super::traverse::{GRay, VoxelScene};
use crate::light::PhotonSources;
use crate::material::scatter;
use crate::math::{along, dot, max_rgb, mul_rgb, scale, scale_rgb, to_f64};
use crate::sampler::{Decision, Sampler};
use crate::world::World;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use trex_store::{Aabb, Budget, Material, Result};

/// Chance to go on after a hit, at most: three hits of a photon on average, as the paper has it.
const ROULETTE_MAX: f32 = 2.0 / 3.0;
/// Most bounces of a photon: one in 10^11 gets so far.
const BOUNCES_MAX: u32 = 64;
/// Photons that a worker takes at a time.
const BATCH: u64 = 4096;
/// Keeps photons apart from the pixels that use the same seed.
const SEED_OF_PHOTONS: u64 = 0x7068_6f74_6f6e_7331;

/// What photon tracing did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct PhotonStats {
    /// Photons sent.
    pub photons: u64,
    /// Rays that they took.
    pub rays: u64,
    /// Hits whose flux was added to a facet.
    pub deposits: u64,
}

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
    /// The surface in the leaf that `ray` meets.
    pub(super) fn leaf_hit(&self, ray: &GRay, materials: &'a [Material]) -> Option<LeafHit<'a>> {
        let hit = self.intersect(ray)?;
        let voxel = self.octree().leaf(hit.leaf as usize);
        let normal = to_f64(voxel.normal);
        let facing = dot(normal, ray.direction);
        let normal = if facing == 0.0 { scale(-1.0, ray.direction) } else { scale(-facing.signum(), normal) };
        let point = along(ray.origin, hit.t, ray.direction);
        let facet = self.octree().facet(hit.node, hit.leaf);
        Some(LeafHit { facet, point, normal, material: &materials[usize::from(voxel.material)] })
    }

    /// A ray that leaves a leaf: it starts where no voxel of the plane through any point of the subvoxel can be.
    pub(super) fn ray_from_leaf(&self, hit: &LeafHit<'_>, direction: [f64; 3]) -> GRay {
        let origin = along(hit.point, 2.0 * self.clearance(hit.normal), hit.normal);
        GRay { origin, direction, t_max: f64::INFINITY }
    }
}

impl PhotonWorld<'_> {
    /// Sends photons until `map` has those of `target`, pass by pass. `stop` is asked between batches; `tell` hears how many photons are done.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when there is no room for the sums of a pass.
    pub(crate) fn trace(
        &self,
        map: &mut PhotonMap,
        target: u64,
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u64),
    ) -> Result<PhotonStats> {
        let mut stats = PhotonStats::default();
        let Some(sources) = PhotonSources::new(&self.world.lights, self.bounds) else { return Ok(stats) };
        let octree = self.voxels.octree();
        let mut pass = PhotonPass::new(octree.facets().count(), sources.flux(), self.budget)?;
        while map.photons() < target {
            let first = map.photons();
            let count = PASS_PHOTONS.min(target - first);
            let (next, stopped) = (AtomicU64::new(0), AtomicBool::new(false));
            let work = || {
                let mut mine = PhotonStats::default();
                loop {
                    let from = next.fetch_add(BATCH, Ordering::Relaxed);
                    if from >= count {
                        return mine;
                    }
                    if stop() {
                        stopped.store(true, Ordering::Relaxed);
                        return mine;
                    }
                    for index in from..count.min(from + BATCH) {
                        self.photon(first + index, &sources, &pass, &mut mine);
                    }
                }
            };
            let done: Vec<PhotonStats> = std::thread::scope(|scope| {
                let workers: Vec<_> = (0..self.threads.max(1)).map(|_| scope.spawn(work)).collect();
                workers.into_iter().map(|worker| worker.join().expect("a worker panicked")).collect()
            });
            if stopped.into_inner() {
                break;
            }
            for mine in done {
                stats.rays += mine.rays;
                stats.deposits += mine.deposits;
            }
            stats.photons += count;
            map.fold(&mut pass, count, octree.facets(), self.voxels.leaf_side());
            tell(map.photons());
        }
        Ok(stats)
    }

    /// One photon.
    fn photon(&self, index: u64, sources: &PhotonSources<'_>, pass: &PhotonPass, stats: &mut PhotonStats) {
        let block = [(index >> 16) as u32, (index >> 48) as u32];
        let sampler = Sampler::new(self.world.seed ^ SEED_OF_PHOTONS, block, index as u32 & 0xffff);
        let Some(start) = sources.emit(&sampler) else { return };
        let off = start.front.map_or([0.0; 3], |front| scale(self.voxels.clearance(front), front));
        let origin = along(start.origin, 1.0, off);
        let mut ray = GRay { origin, direction: start.direction, t_max: f64::INFINITY };
        let mut flux = start.flux;
        for vertex in 0..=BOUNCES_MAX {
            stats.rays += 1;
            let Some(hit) = self.voxels.leaf_hit(&ray, &self.world.materials) else { return };
            let is_pure_mirror = hit.material.mirror && hit.material.kd == [0.0; 3];
            if !is_pure_mirror {
                pass.add(hit.facet, flux);
                stats.deposits += 1;
            }
            let u = sampler.draw(Decision::Gather { vertex, index: 0, count: 1 });
            let to_viewer = scale(-1.0, ray.direction);
            let Some(bounce) = scatter(hit.material, hit.normal, to_viewer, u) else { return };
            let chance = max_rgb(bounce.weight).min(ROULETTE_MAX);
            if sampler.draw(Decision::Roulette(vertex))[0] >= chance {
                return;
            }
            flux = scale_rgb(1.0 / chance, mul_rgb(flux, bounce.weight));
            ray = self.voxels.ray_from_leaf(&hit, bounce.direction);
        }
    }
}
