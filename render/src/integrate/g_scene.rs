//! `GScene`: rays between a surface of the exact mesh and the voxels: how they leave it, what stops them, what they
//! bring back.
//!
//! ```text
//! voxel   surface --clearance along the normal--> voxels
//! exact   surface --mesh for some leaves' length--> voxels          (`--near exact`: no boxes in corners; Fig. 8)
//! ```
//!
//! Invariants: 1. a ray that leaves a plane meets none of that plane's voxels, at either end; 2. where there are
//! units, rays wait for those that they need; light is kept by the facets of the upper leaves above them.

use super::mirrors::Mirrors;
use crate::math::unit;
use crate::photon::irradiance::Irradiance;
use crate::scene::settings::Near;
use crate::scene::world::World;
use crate::shading::bsdf::diffuse_equivalent;
use crate::shading::light::Lights;
use crate::shading::surface::SurfaceInteraction;
use crate::trace::{Answer, Ray, Tracer};
use crate::voxel::{LeafHit, LowerScene, VoxelScene, VoxelSurface};
use glam::{DVec3, Vec3};
use trex_store::Material;

/// Length of the part of a ray that `near = exact` takes from the mesh, in leaves.
const NEAR_LEAVES: f64 = 2.0;
/// Greatest length of that part, in leaves: where a ray grazes its surface.
const NEAR_LEAVES_MAX: f64 = 16.0;

/// Voxels, and the light in them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GScene<'a> {
    pub(crate) voxels: VoxelScene<'a>,
    /// The octree with units, for rays that may ask for them.
    pub(crate) lower: Option<LowerScene<'a>>,
    pub(crate) irradiance: Irradiance<'a>,
    pub(crate) near: Near,
    /// True when G-rays are asked of the voxels; else these stand in for the mesh alone.
    pub(crate) answers_g_rays: bool,
}

/// The yield of a gather ray.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Gathered {
    /// Radiance; lamps that no mirror shows are left out.
    pub(crate) radiance: Vec3,
    pub(crate) rays: u64,
}

impl Gathered {
    /// Of a ray of which nothing is left.
    pub(super) const NOTHING: Gathered = Gathered { radiance: Vec3::ZERO, rays: 0 };

    /// Adds radiance that so many more rays have brought.
    pub(super) fn add(&mut self, radiance: Vec3, rays: u64) {
        self.radiance += radiance;
        self.rays += rays;
    }
}

impl<'a> GScene<'a> {
    /// Length of the part of a ray from `surface` in unit `direction` that the mesh answers; `None` for none.
    pub(crate) fn near_length(&self, surface: &SurfaceInteraction, direction: DVec3) -> Option<f64> {
        let leaf = self.lower.map_or(self.voxels.leaf_side(), |lower| lower.leaf_side());
        let clear = self.clearance(surface.normal) / surface.normal.dot(direction).max(1e-9);
        (self.near == Near::Exact).then(|| clear.clamp(NEAR_LEAVES * leaf, NEAR_LEAVES_MAX * leaf))
    }

    /// Distance off a surface of unit `normal` at which rays start and end, model units.
    fn clearance(&self, normal: DVec3) -> f64 {
        let normal = normal.to_array();
        self.lower.map_or(self.voxels.clearance(normal), |lower| lower.clearance(normal))
    }

    /// True when `ray` meets any voxel.
    pub(crate) fn occluded<T: Tracer>(&self, ray: &Ray, tracer: &mut T) -> Answer<bool> {
        match &self.lower {
            Some(lower) => lower.occluded(ray, &mut tracer.lend_pages()),
            None => Answer::Exact(self.voxels.occluded(ray)),
        }
    }

    /// The ray on through the voxels, which ends `distance` from the surface; at a surface with normal `front` it
    /// leaves that one's voxels, too. `None` when nothing is left of it.
    pub(crate) fn leave(
        &self,
        surface: &SurfaceInteraction,
        direction: DVec3,
        distance: f64,
        front: Option<DVec3>,
    ) -> Option<Ray> {
        let clearance = self.clearance(surface.normal);
        let near = self.near_length(surface, direction).unwrap_or(0.0);
        if distance <= near {
            return None;
        }
        let height = near * surface.normal.dot(direction);
        let start = surface.point + near * direction;
        let origin = start + ((clearance - height).max(0.0) + surface.offset()) * surface.normal;
        if distance == f64::INFINITY {
            return Some(Ray::new(origin, direction, distance));
        }
        let mut end = surface.point + distance * direction;
        if let Some(front) = front {
            end += self.clearance(front) * front;
        }
        let way = end - origin;
        if way.dot(direction) <= 0.0 {
            return None;
        }
        Some(Ray::new(origin, unit(way)?, way.length()))
    }

    /// No mirrors followed yet: few will be, by a ray that may wait for pages.
    pub(crate) fn no_mirrors(&self) -> Mirrors {
        let waits = self.near == Near::Exact || self.lower.is_some();
        if waits { Mirrors::NONE_WAITING } else { Mirrors::NONE }
    }

    /// The radiance that arrives along `ray`, which has followed `mirrors`: the light that leaves the first leaf,
    /// which may be known; through mirrors; else the sky.
    pub(crate) fn gather<T: Tracer>(
        &self,
        ray: Ray,
        mut first: Option<Option<VoxelSurface>>,
        world: &'a World,
        mirrors: Mirrors,
        tracer: &mut T,
    ) -> Answer<Gathered> {
        let materials = &world.materials;
        let meet = |ray: &Ray| match (first.take(), &self.lower) {
            (Some(known), _) => Answer::Exact(known.map(|surface| surface.face(ray, materials))),
            (None, Some(lower)) => lower.leaf_hit(ray, materials, &mut tracer.lend_pages()),
            (None, None) => {
                let found = self.voxels.intersect(ray);
                Answer::Exact(found.map(|found| self.voxels.surface(&found).face(ray, materials)))
            }
        };
        self.collect(ray, &world.lights, mirrors, meet)
    }

    /// The light that leaves the leaves which `meet` gives.
    fn collect(
        &self,
        mut ray: Ray,
        lights: &Lights,
        mut mirrors: Mirrors,
        mut meet: impl FnMut(&Ray) -> Answer<Option<LeafHit<'a>>>,
    ) -> Answer<Gathered> {
        let (mut radiance, mut rays) = (Vec3::ZERO, 0);
        loop {
            let Answer::Exact(found) = meet(&ray) else { return Answer::Blocked };
            rays += 1;
            let direction = DVec3::from(ray.direction);
            let end = found.map_or(f64::INFINITY, |hit| (hit.point - DVec3::from(ray.origin)).dot(direction));
            let (lamp, emitted) = if mirrors.is_none() {
                (None, Vec3::ZERO)
            } else {
                let clear = |normal| self.clearance(normal);
                (lights.seen_in_voxels(&ray, end, clear), lights.emitted_in_voxels(&ray, end, clear))
            };
            let Some(hit) = found.filter(|_| lamp.is_none()) else {
                radiance += mirrors.throughput * lamp.unwrap_or(lights.sky());
                break;
            };
            radiance += mirrors.throughput * (self.leaving(&hit) + emitted);
            if !mirrors.follow(&ray, hit.material) {
                break;
            }
            let direction = direction.reflect(hit.normal);
            ray = match &self.lower {
                Some(lower) => lower.ray_from_leaf(&hit, direction),
                None => self.voxels.ray_from_leaf(&hit, direction),
            };
        }
        Answer::Exact(Gathered { radiance, rays })
    }

    /// The radiance that leaves a place on the exact mesh by the light in its leaf; `None` where no leaf is near.
    pub(crate) fn leaving_surface(&self, surface: &SurfaceInteraction, material: &Material) -> Option<Vec3> {
        let facet = self.voxels.facet_at(surface.point, surface.normal)?;
        Some(diffuse_equivalent(material) * self.irradiance.at(facet))
    }

    fn leaving(&self, hit: &LeafHit<'_>) -> Vec3 {
        diffuse_equivalent(hit.material) * self.irradiance.at(hit.facet)
    }
}
