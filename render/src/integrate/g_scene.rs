//! `GScene`: rays between a surface of the exact mesh and the voxels: how they leave it, what stops them, what they
//! bring back.
//!
//! ```text
//! voxel   surface --clearance along the normal--> voxels
//! exact   surface --mesh for some leaves' length--> voxels          (`near = "exact"`: no boxes in corners; Fig. 8)
//! contact exact where the voxel off the surface is another surface's, else voxel
//! ```
//!
//! A section ends rays, and begins those that come from beyond it; there are no caps in voxels, and no ray needs them:
//! one that leaves a surface which is kept goes through a section outside of solids, and does not come back.
//!
//! Invariants: 1. a ray that leaves a plane meets none of that plane's voxels, at either end; 2. where there are
//! units, rays wait for those that they need; light is kept by the sides of facets of the upper leaves above them.

use super::gather_leg::GatherLeg;
use super::mirrors::Mirrors;
use crate::g_stage::{GUnits, GView};
use crate::math::unit;
use crate::photon::irradiance::Irradiance;
use crate::scene::method::{Near, Shadows};
use crate::scene::world::World;
use crate::shading::bsdf::diffuse_equivalent;
use crate::shading::surface::SurfaceInteraction;
use crate::trace::{Parts, Ray};
use crate::voxel::{GKind, GRay, LeafHit, LowerScene, VoxelScene, VoxelSurface};
use glam::{DVec3, Vec3};
use trex_store::Material;
use trex_store::octree::NODE_SIDE;

/// Length of the part of a ray that `near = exact` takes from the mesh, in leaves.
const NEAR_LEAVES: f64 = 2.0;
/// Greatest length of that part, in leaves: where a ray grazes its surface.
const NEAR_LEAVES_MAX: f64 = 16.0;

/// Growth of the cone of a gather ray: beyond five times the side of a voxel, voxels of that side answer. As exact as
/// the finest all the way, with a third of the units and in four fifths of the time (plant, 512/2048). A shadow ray
/// reads the finest to its end: coarser ones throw false shadows, however narrow its cone is.
const GATHER_SPREAD: f32 = 0.2;

/// Voxels, and the light in them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GScene<'a> {
    pub(crate) voxels: VoxelScene<'a>,
    /// The octree with units, for rays that may ask for them.
    pub(crate) lower: Option<LowerScene<'a>>,
    pub(crate) irradiance: Irradiance<'a>,
    pub(crate) near: Near,
    pub(crate) shadows: Shadows,
    /// True when G-rays are asked of the voxels; else these stand in for the mesh alone.
    pub(crate) answers_g_rays: bool,
    pub(crate) parts: &'a Parts,
}

/// How rays from a surface begin on the mesh.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NearMesh {
    normal: DVec3,
    /// Distance off the surface at which rays are clear of its voxels, and side of the finest leaves, model units.
    clearance: f64,
    leaf_side: f64,
}

impl NearMesh {
    /// Length of the part of a ray in unit `direction` that the mesh answers.
    pub(crate) fn length(&self, direction: DVec3) -> f64 {
        let clear = self.clearance / self.normal.dot(direction).max(1e-9);
        clear.clamp(NEAR_LEAVES * self.leaf_side, NEAR_LEAVES_MAX * self.leaf_side)
    }
}

impl GScene<'_> {
    /// How rays from `surface` begin on the mesh; `None` where they begin in the voxels.
    pub(crate) fn near_mesh(&self, surface: &SurfaceInteraction) -> Option<NearMesh> {
        let asks_mesh = self.near == Near::Exact || self.near == Near::Contact && self.starts_within(surface);
        asks_mesh.then(|| NearMesh {
            normal: surface.normal,
            clearance: self.clearance(surface.normal),
            leaf_side: self.lower.map_or(self.voxels.leaf_side(), |lower| lower.leaf_side()),
        })
    }

    /// True when rays that leave a surface by a voxel start within one of another surface. Asked of the upper octree,
    /// which is always there: where units are finer, of more surfaces than have one that near.
    fn starts_within(&self, surface: &SurfaceInteraction) -> bool {
        let clearance = self.voxels.clearance(surface.normal.into());
        self.voxels.is_occupied(surface.point + (clearance + surface.offset()) * surface.normal)
    }

    /// Distance off a surface of unit `normal` at which rays start and end, model units.
    fn clearance(&self, normal: DVec3) -> f64 {
        let normal = normal.to_array();
        self.lower.map_or(self.voxels.clearance(normal), |lower| lower.clearance(normal))
    }

    /// How rays see the octree.
    pub(crate) fn view(&self) -> GView {
        let units = self.lower.map_or(GUnits::None, |lower| GUnits::On(lower.missing()));
        GView { occluders: self.voxels.occluders(), units }
    }

    /// The ray as the G-stage takes it, and its distance to the cube; where there are units with a cone that grows by
    /// `spread`.
    pub(super) fn g_ray(&self, ray: &Ray, kind: GKind, spread: f32) -> (GRay, f64) {
        let (kept, from) = self.parts.piece(ray);
        let (asked, t_in) = match &self.lower {
            Some(lower) => {
                let (asked, t_in) = lower.g_ray(&kept, kind);
                (asked.with_cone(0.0, spread), t_in)
            }
            None => self.voxels.g_ray(&kept, kind),
        };
        (asked, from + t_in)
    }

    /// Growth of the cone of a gather ray that leaves a surface of this normal: so slow that the ray is clear of the
    /// surface's own voxels before it reads coarser ones.
    pub(super) fn spread(&self, normal: DVec3, direction: DVec3) -> f32 {
        let clear = self.subvoxel_side() * normal.dot(direction).abs() / self.clearance(normal);
        GATHER_SPREAD.min(0.9 * clear as f32)
    }

    /// Side of the subvoxels of gather rays, model units.
    pub(super) fn subvoxel_side(&self) -> f64 {
        self.lower.map_or(self.voxels.subvoxel_side(), |lower| lower.subvoxel_side())
    }

    /// The ray on through the voxels, which ends `distance` from the surface; at a surface with normal `front` it
    /// leaves that one's voxels, too. The mesh answers its beginning of length `near` ([`NearMesh::length`]). `None`
    /// when nothing is left of it.
    pub(crate) fn leave(
        &self,
        surface: &SurfaceInteraction,
        direction: DVec3,
        near: Option<f64>,
        (distance, front): (f64, Option<DVec3>),
    ) -> Option<Ray> {
        let clearance = self.clearance(surface.normal);
        let near = near.unwrap_or(0.0);
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
        let waits = self.near != Near::Voxel || self.lower.is_some();
        if waits { Mirrors::NONE_WAITING } else { Mirrors::NONE }
    }

    /// Adds what a leg of a gather ray brings which has `found` a surface, or nothing: the light that leaves the
    /// leaf, else the sky. The next leg, if it goes on from a mirror.
    pub(super) fn arrive(
        &self,
        leg: &mut GatherLeg,
        found: Option<VoxelSurface>,
        world: &World,
    ) -> Option<Ray> {
        let GatherLeg { ray, mirrors, gathered, spread, .. } = leg;
        let lights = &world.lights;
        let found = found.map(|surface| surface.face(ray, world.voxel_material(surface.material)));
        let direction = DVec3::from(ray.direction);
        let end = found.map_or(f64::INFINITY, |hit| (hit.point - DVec3::from(ray.origin)).dot(direction));
        let (lamp, emitted) = if mirrors.is_none() {
            (None, Vec3::ZERO)
        } else {
            let clear = |normal: DVec3| self.voxels.clearance(normal.into());
            (lights.seen_in_voxels(ray, end, clear), lights.emitted_in_voxels(ray, end, clear))
        };
        let Some(hit) = found.filter(|_| lamp.is_none()) else {
            gathered.add(mirrors.throughput * lamp.unwrap_or(lights.sky()));
            return None;
        };
        gathered.add(mirrors.throughput * (self.leaving(&hit) + emitted));
        if !mirrors.follow(ray, hit.material) {
            return None;
        }
        let direction = direction.reflect(hit.normal);
        *spread = self.spread(hit.normal, direction);
        // Whichever voxel answered, the ray is clear of it.
        Some(self.voxels.ray_from_leaf(&hit, direction))
    }

    /// The radiance that leaves a place on the exact mesh by the light in its leaf; `None` where no leaf is near.
    pub(crate) fn leaving_surface(&self, surface: &SurfaceInteraction, material: &Material) -> Option<Vec3> {
        let side = self.voxels.side_at(surface.point, surface.normal)?;
        Some(diffuse_equivalent(material, surface.colour) * self.irradiance.at(side))
    }

    /// The radiance that leaves a surface by the light that points and suns bring there over mirrors alone, which
    /// neither shadow rays nor gather rays find; `None` where it is not kept. Of the facet at a place by chance, as far
    /// from the surface point as half of one, so that no borders of facets are seen.
    pub(super) fn caustics(
        &self,
        surface: &SurfaceInteraction,
        material: &Material,
        u: [f32; 2],
    ) -> Option<Vec3> {
        if !self.irradiance.has_caustics() {
            return None;
        }
        let facet = f64::from(NODE_SIDE) * self.voxels.leaf_side();
        let (e, f) = surface.normal.any_orthonormal_pair();
        let [along_e, along_f] = u.map(|u| (f64::from(u) - 0.5) * facet);
        let side = |at| self.voxels.side_at(at, surface.normal);
        let side = side(surface.point + along_e * e + along_f * f).or_else(|| side(surface.point))?;
        Some(diffuse_equivalent(material, surface.colour) * self.irradiance.caustics_at(side))
    }

    fn leaving(&self, hit: &LeafHit<'_>) -> Vec3 {
        diffuse_equivalent(hit.material, hit.colour) * self.irradiance.at(hit.side)
    }
}
