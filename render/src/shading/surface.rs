//! `SurfaceInteraction`: where a ray met the mesh or the voxels, and the rays that leave from there.
//!
//! Invariants: 1. both normals are on the side that the ray came from; 2. a ray that leaves does not meet the surface
//! that it leaves, nor the one that it is sent to: sides and starts of rays follow from the plane of the triangle, what
//! is scattered from the shading normal.

use super::bsdf::{Bsdf, lifted, mirrored};
use crate::math::unit;
use crate::trace::{Ray, ShadedHit};
use glam::{DVec3, Vec3};
use trex_store::Material;

/// Secondary rays start off the surface by this many bounds on the error of the hit: one for the point itself, one
/// for the rounding of the next ray's test against the same plane, doubled since neither bound is along the normal.
pub(crate) const OFFSET_ERRORS: f64 = 4.0;
/// A shadow ray ends before the light by this share of its length: some f32 ulps, the rounding of a tracer that
/// works in f32 relative to the ray, whose error at the far end no hit has told.
const END_SHARE: f64 = 1.0 / (1 << 20) as f64;
/// Least cosine between the two normals: one that is farther off the plane's is brought so near.
const SHADING_COS_LEAST: f64 = 0.1;

/// The hit of a ray on a surface of whatever form.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HitPoint {
    /// Parameter of the hit on the ray.
    pub(crate) t: f64,
    /// Unit normal of the counter-clockwise side; zero where there is none.
    pub(crate) normal: Vec3,
    /// Unit normal that shades it, on the same side; `normal` where there is no other.
    pub(crate) shading_normal: Vec3,
    /// Index into the materials.
    pub(crate) material: u32,
    /// What the material's `kd` is multiplied by, linear.
    pub(crate) colour: Vec3,
    /// Bound on the distance between the surface and the point on the ray, model units.
    pub(crate) error: f64,
}

impl From<&ShadedHit> for HitPoint {
    fn from(ShadedHit { hit, colour, shading_normal }: &ShadedHit) -> HitPoint {
        HitPoint {
            t: hit.t,
            normal: hit.normal.into(),
            shading_normal: (*shading_normal).into(),
            material: hit.material,
            colour: (*colour).into(),
            error: hit.error,
        }
    }
}

/// A hit, seen from the side that the ray came from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SurfaceInteraction {
    pub(crate) point: DVec3,
    pub(crate) normal: DVec3,
    pub(crate) shading_normal: DVec3,
    pub(crate) wo: DVec3,
    error: f64,
    pub(crate) material: u32,
    /// What the material's `kd` is multiplied by, linear.
    pub(crate) colour: Vec3,
}

/// A place that light is asked for at.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ShadingPoint<'a> {
    /// Model units.
    pub(crate) point: DVec3,
    pub(crate) bsdf: Bsdf<'a>,
}

impl SurfaceInteraction {
    /// The place where `ray` met `hit`.
    pub(crate) fn new(ray: &Ray, hit: &HitPoint) -> SurfaceInteraction {
        // A needle whose corners lie on one line has no normal, but rays do hit it: it faces them.
        let direction = DVec3::from(ray.direction);
        let normal = unit(hit.normal.as_dvec3()).unwrap_or(-direction);
        let side = if normal.dot(direction) > 0.0 { -1.0 } else { 1.0 };
        let normal = side * normal;
        let shading_normal = match hit.shading_normal == hit.normal {
            true => normal,
            false => lifted(side * hit.shading_normal.as_dvec3(), normal, SHADING_COS_LEAST),
        };
        SurfaceInteraction {
            point: ray.at(hit.t),
            normal,
            shading_normal,
            wo: -direction,
            error: hit.error,
            material: hit.material,
            colour: hit.colour,
        }
    }

    /// The scattering of the surface towards where the ray came from; `materials` are the world's.
    pub(crate) fn bsdf<'a>(&self, materials: &'a [Material]) -> Bsdf<'a> {
        let material = &materials[self.material as usize];
        let SurfaceInteraction { colour, normal, shading_normal, wo, .. } = *self;
        Bsdf { material, colour, normal, shading_normal, wo }
    }

    /// As light meets it that goes from surface to surface, unseen: by the plane of the triangle, since from a smooth
    /// normal not as much would leave as came; mirrors alone turn it by theirs.
    pub(crate) fn unseen(self, materials: &[Material]) -> SurfaceInteraction {
        let turns = materials[self.material as usize].mirror;
        if turns { self } else { SurfaceInteraction { shading_normal: self.normal, ..self } }
    }

    /// The direction of a ray that the surface mirrors to its viewer.
    pub(crate) fn mirrored(&self) -> DVec3 {
        mirrored(self.wo, self.normal, self.shading_normal)
    }

    /// The place as lights see it; `materials` are the world's.
    pub(crate) fn shading_point<'a>(&self, materials: &'a [Material]) -> ShadingPoint<'a> {
        ShadingPoint { point: self.point, bsdf: self.bsdf(materials) }
    }

    /// Distance off the surface at which rays start for the error of the hit, model units.
    pub(crate) fn offset(&self) -> f64 {
        OFFSET_ERRORS * self.error
    }

    /// A ray off this surface in unit `direction`; where the other end, `distance` away, lies on a surface with
    /// normal `front`, it leaves that one too.
    pub(crate) fn ray_to(&self, direction: DVec3, distance: f64, front: Option<DVec3>) -> Ray {
        let offset = self.offset();
        let origin = self.point + offset * self.normal;
        if distance == f64::INFINITY {
            return Ray::new(origin, direction, distance);
        }
        let mut end = self.point + distance * direction;
        if let Some(front) = front {
            end += (offset + END_SHARE * distance) * front;
        }
        let way = end - origin;
        match unit(way) {
            Some(direction) => Ray::new(origin, direction, way.length()),
            // The light touches the surface to within the error of the hit: nothing fits between.
            None => Ray::new(origin, direction, 0.0),
        }
    }
}
