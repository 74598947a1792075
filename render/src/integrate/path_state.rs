//! `Path`: one sample of a pixel on its way, a ray at a time, and what it comes to.
//!
//! Invariants: 1. it holds all that a retry needs, so a path gives the same bytes however often it was blocked; 2. each
//! ray is counted once, when it was answered; 3. a path has at most `BOUNCES_MAX` bounces (`roulette.rs`).

use super::c_ray::AskedFar;
use super::g_batch::Place;
use super::mesh_rays::Start;
use super::mirrors::Mirrors;
use super::roulette::{MIRROR_CHANCE, SURFACE_CHANCE, survives};
use crate::sampler::{Decision, Sampler};
use crate::shading::surface::SurfaceInteraction;
use crate::stats::{RayCounts, RayKind};
use crate::trace::{Ray, ShadedHit};
use glam::{DVec3, Vec3};
use trex_film::LayerPixel;

/// The result of a sample of a pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Sample {
    /// Radiance, linear RGB.
    pub radiance: Vec3,
    /// The part of `radiance` that gather rays brought to the surface that is seen.
    pub indirect: Vec3,
    /// Layers at the pixel's centre; of the first sample only, and only when layers are asked for. Of a preview, and of
    /// the first sample beside one: those where its ray from the camera ended.
    pub layers: Option<LayerPixel>,
    /// True when the ray from the camera met the model.
    pub meets_model: bool,
    /// Rays that the sample took.
    pub rays: RayCounts,
    /// Look-ups of the photons next to a place; of `full-gi`.
    pub look_ups: u64,
}

/// One sample of one pixel on its way: all that a retry needs.
#[derive(Clone, Debug)]
pub(crate) struct Path {
    pub(crate) pixel: [u32; 2],
    pub(crate) sampler: Sampler,
    pub(crate) stage: Stage,
    /// Index of the path vertex at the end of the current C-ray.
    pub(crate) vertex: u32,
    /// Length of the C-rays before the current one, model units.
    pub(crate) travelled: f64,
    /// True when the current C-ray leaves a place that voxels answered for.
    pub(crate) is_far: bool,
    /// True while the sample's layers are to be those of the place where its next C-ray ends: of the ray from the
    /// camera, and of those that mirrors send on.
    pub(crate) keeps_seen: bool,
    pub(crate) throughput: Vec3,
    /// The origin of the current C-ray.
    pub(crate) origin: Origin,
    pub(crate) sample: Sample,
}

/// The next step of a path.
#[derive(Clone, Debug)]
pub(crate) enum Stage {
    /// The ray through the pixel's centre, for the layers.
    Layers,
    /// A ray that asks for the closest hit.
    CRay(Ray),
    /// The mesh has answered a C-ray up to the cut of the footprint rule.
    Met {
        ray: Ray,
        cut: f64,
        found: Option<ShadedHit>,
    },
    /// Ray `index` from a surface that asks whether anything is hit.
    Shadow {
        surface: SurfaceInteraction,
        index: u32,
    },
    /// Ray `index` from a surface that gathers light.
    Gather {
        surface: SurfaceInteraction,
        index: u32,
    },
    /// The part of a C-ray behind the cut has been asked in a batch.
    TakeFar {
        ray: Ray,
        far: AskedFar,
    },
    /// As `TakeFar`, of the ray through the pixel's centre.
    TakeLayer(AskedFar),
    /// A ray from the camera has been asked of the voxels, which are drawn as they are.
    TakeShown {
        ray: Ray,
        place: u32,
    },
    /// Shadow and gather rays have been asked in a batch.
    TakeGRays(Place),
    /// A ray that gathers light on the exact mesh, on its way.
    GatherRay(GatherRay),
    /// The bounce after a surface's shadow and gather rays.
    Bounce(SurfaceInteraction),
    Done,
}

/// A ray from a surface that asks whether anything is hit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ShadowQuery {
    pub(crate) direction: DVec3,
    pub(crate) distance: f64,
    /// Normal of the surface at the other end, if there is one.
    pub(crate) front: Option<DVec3>,
    /// Radiance that is gained when nothing is hit.
    pub(crate) light: Vec3,
}

/// A gather ray on its way through the mesh: `index` of those that leave `surface`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct GatherRay {
    pub(crate) surface: SurfaceInteraction,
    pub(crate) index: u32,
    pub(crate) ray: Ray,
    /// Factor on the radiance that arrives at `surface`.
    pub(crate) weight: Vec3,
    /// Mirrors that the ray has followed.
    pub(crate) mirrors: Mirrors,
}

/// The origin of a C-ray: what it sees has another weight where light samples could have found it too.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Origin {
    Camera,
    Mirror,
    /// Drawn at a surface, with this density per solid angle.
    Scattered {
        from: SurfaceInteraction,
        pdf: f64,
    },
}

impl Stage {
    /// True when rays have been asked in a batch: the path waits for their answers.
    pub(super) fn asks(&self) -> bool {
        matches!(
            self,
            Stage::TakeFar { .. } | Stage::TakeLayer(_) | Stage::TakeShown { .. } | Stage::TakeGRays(_)
        )
    }
}

impl Origin {
    /// The kind that the C-ray is counted as.
    pub(crate) fn ray_kind(&self) -> RayKind {
        match self {
            Origin::Camera => RayKind::Primary,
            Origin::Mirror => RayKind::Mirror,
            Origin::Scattered { .. } => RayKind::Gather,
        }
    }

    /// The start of the rays that leave what it sees.
    pub(super) fn start(&self) -> Start {
        match self {
            Origin::Camera | Origin::Mirror => Start::Near,
            Origin::Scattered { .. } => Start::Scattered,
        }
    }
}

impl Path {
    /// A sample of `pixel` (x, y) that begins with `stage`.
    #[inline]
    pub(super) fn new(pixel: [u32; 2], sampler: Sampler, stage: Stage) -> Path {
        Path {
            pixel,
            sampler,
            stage,
            vertex: 0,
            travelled: 0.0,
            is_far: false,
            keeps_seen: false,
            throughput: Vec3::ONE,
            origin: Origin::Camera,
            sample: Sample::default(),
        }
    }

    /// Rays answered up to now: grows with every step forward.
    pub(crate) fn answered(&self) -> u64 {
        self.sample.rays.total()
    }

    /// Adds radiance that arrives at the current vertex.
    pub(crate) fn gain(&mut self, radiance: Vec3) {
        self.sample.radiance += self.throughput * radiance;
    }

    /// Adds radiance that gather rays brought to the current vertex: what the filter may smooth, unless a mirror
    /// shows it.
    pub(crate) fn gain_indirect(&mut self, radiance: Vec3) {
        self.gain(radiance);
        if self.vertex == 0 {
            self.sample.indirect += self.throughput * radiance;
        }
    }

    /// Decides whether the path goes on after its vertex, a mirror or not: by roulette, with what it can still bring.
    pub(crate) fn survives(&mut self, is_mirror: bool) -> bool {
        let most = if is_mirror { MIRROR_CHANCE } else { SURFACE_CHANCE };
        let draw = || self.sampler.draw(Decision::Roulette(self.vertex))[0];
        survives(&mut self.throughput, self.vertex, most, draw)
    }
}
