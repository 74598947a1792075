//! What a C-ray meets first: a place on the mesh, or behind the cut of the footprint rule in the voxels.

use crate::scene::world::World;
use crate::shading::surface::{HitPoint, OFFSET_ERRORS};
use crate::trace::{Ray, ShadedHit};
use crate::voxel::{VoxelScene, VoxelSurface};
use trex_film::NO_ID;

/// Clearances that a ray leaves a voxel by: the point of the hit is within one of the surface.
const CLEARANCES: f64 = 2.0;

/// The first thing that a C-ray met.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CRayHit {
    pub(crate) point: HitPoint,
    pub(crate) form: Form,
}

/// The form of the model that answered a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Form {
    /// The exact mesh: store id of the triangle, and its page.
    Mesh { triangle: u32, page: u32 },
    /// The voxels.
    Voxel,
}

impl From<ShadedHit> for CRayHit {
    fn from(shaded: ShadedHit) -> CRayHit {
        let form = Form::Mesh { triangle: shaded.hit.triangle, page: shaded.hit.page };
        CRayHit { point: HitPoint::from(&shaded), form }
    }
}

impl CRayHit {
    /// The id that a layer shows.
    pub(crate) fn layer_id(&self) -> u32 {
        match self.form {
            Form::Mesh { triangle, .. } => triangle,
            Form::Voxel => NO_ID,
        }
    }
}

/// The part of a C-ray behind the cut.
#[derive(Clone, Copy, Debug)]
pub(crate) struct FarRay {
    pub(crate) ray: Ray,
    /// Parameter on the C-ray where it begins.
    cut: f64,
}

/// The part of a C-ray behind the cut, asked in a batch.
#[derive(Clone, Copy, Debug)]
pub(crate) struct AskedFar {
    pub(crate) far: FarRay,
    /// Distance of its start to the cube.
    pub(crate) t_in: f64,
    /// Its place in the batch.
    pub(crate) place: u32,
}

impl FarRay {
    /// The part of `ray` behind `cut`.
    pub(crate) fn new(ray: &Ray, cut: f64) -> FarRay {
        FarRay { ray: Ray { origin: ray.at(cut).to_array(), t_max: ray.t_max - cut, ..*ray }, cut }
    }

    /// The surface `found`, as a hit of the C-ray.
    pub(crate) fn hit(
        &self,
        voxels: &VoxelScene<'_>,
        found: Option<VoxelSurface>,
        world: &World,
    ) -> Option<CRayHit> {
        let VoxelSurface { t, normal, material, .. } = found?;
        let error = CLEARANCES * voxels.clearance(normal.as_dvec3().into()) / OFFSET_ERRORS;
        let t = self.cut + t;
        let (_, colour) = world.voxel_material(material);
        let point = HitPoint { t, material, normal, shading_normal: normal, colour, error };
        Some(CRayHit { point, form: Form::Voxel })
    }
}
