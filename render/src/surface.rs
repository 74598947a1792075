//! `Surface`: where a ray met the mesh, and the rays that leave from there.
//!
//! Invariants: 1. the normal is on the side that the ray came from; 2. a ray that leaves does not meet the surface
//! that it leaves, nor the one that it is sent to.

use crate::light::Receiver;
use crate::math::{along, dot, length, scale, sub, to_f64, unit};
use crate::trace::{Hit, Ray};
use trex_store::Material;

/// Secondary rays start off the surface by this many bounds on the error of the hit: one for the point itself, one
/// for the rounding of the next ray's test against the same plane, doubled since neither bound is along the normal.
pub(crate) const OFFSET_ERRORS: f64 = 4.0;
/// A shadow ray ends before the light by this share of its length: some f32 ulps, the rounding of a tracer that
/// works in f32 relative to the ray, whose error at the far end no hit has told.
const END_SHARE: f64 = 1.0 / (1 << 20) as f64;

/// A hit, seen from the side that the ray came from.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface {
    pub(crate) point: [f64; 3],
    pub(crate) normal: [f64; 3],
    pub(crate) to_viewer: [f64; 3],
    error: f64,
    pub(crate) material: u32,
}

impl Surface {
    pub(crate) fn new(ray: &Ray, hit: &Hit) -> Surface {
        // A needle whose corners lie on one line has no normal, but rays do hit it: it faces them.
        let normal = unit(to_f64(hit.normal)).unwrap_or(scale(-1.0, ray.direction));
        let side = if dot(normal, ray.direction) > 0.0 { -1.0 } else { 1.0 };
        Surface {
            point: along(ray.origin, hit.t, ray.direction),
            normal: scale(side, normal),
            to_viewer: scale(-1.0, ray.direction),
            error: hit.error,
            material: hit.material,
        }
    }

    /// The same place, as lights see it; `materials` are the world's.
    pub(crate) fn receiver<'a>(&self, materials: &'a [Material]) -> Receiver<'a> {
        let (normal, to_viewer) = (self.normal, self.to_viewer);
        Receiver { point: self.point, normal, to_viewer, material: &materials[self.material as usize] }
    }

    /// How far off the surface rays start, for the error of the hit, model units.
    pub(crate) fn offset(&self) -> f64 {
        OFFSET_ERRORS * self.error
    }

    /// A ray off this surface in unit `direction`; where the other end, `distance` away, lies on a surface with
    /// normal `front`, it leaves that one too.
    pub(crate) fn ray_to(&self, direction: [f64; 3], distance: f64, front: Option<[f64; 3]>) -> Ray {
        let offset = self.offset();
        let origin = along(self.point, offset, self.normal);
        if distance == f64::INFINITY {
            return Ray { origin, direction, t_max: distance };
        }
        let mut end = along(self.point, distance, direction);
        if let Some(front) = front {
            end = along(end, offset + END_SHARE * distance, front);
        }
        let way = sub(end, origin);
        match unit(way) {
            Some(direction) => Ray { origin, direction, t_max: length(way) },
            // The light touches the surface to within the error of the hit: nothing fits between.
            None => Ray { origin, direction, t_max: 0.0 },
        }
    }
}
