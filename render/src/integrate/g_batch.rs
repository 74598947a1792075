//! `GBatch`: the rays that the samples of a tile ask together, in the voxels and on the mesh, and what the samples
//! are to do with the answers.
//!
//! ```text
//! samples ask -> asked -- turn: the tracer answers rays on the mesh --> answered -- G-stage --> samples take
//! ```
//!
//! Invariant: what a path asked for is there, answered, until its tile is handed on again.

use super::c_ray::{AskedFar, FarRay};
use super::g_scene::GScene;
use super::gather_leg::GatherLeg;
use super::mesh_rays::{MeshRays, Start};
use crate::g_stage::{GCall, GRays, GStage, GView};
use crate::scene::method::{Near, Shadows};
use crate::scene::settings::RenderKeys;
use crate::shading::surface::SurfaceInteraction;
use crate::trace::{Answer, Ray, Tracer};
use crate::voxel::{GAnswer, GKind, GRay};
use glam::Vec3;
use std::ops::Range;

/// Rays of one path in a batch: bounds what a batch holds, whatever `n_shadow` and `n_gather`.
pub(crate) const RAYS_ASKED_MAX: usize = 8;

/// Most rays that paths ask for at a time.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct RayNeeds {
    /// In the voxels.
    pub(crate) voxel: usize,
    /// Shadow and gather rays, wherever they are asked.
    pub(crate) shadow: usize,
    pub(crate) gather: usize,
    /// On the mesh.
    pub(crate) mesh: usize,
}

/// Most rays that a path asks for at a time, by what the view asks for at a surface.
pub(crate) fn rays_asked(keys: &RenderKeys) -> RayNeeds {
    let RenderKeys { integrator, near, shadows, n_shadow, n_gather, .. } = *keys;
    let most = |count: u32| (count as usize).min(RAYS_ASKED_MAX);
    let asks_voxels = integrator.asks_voxels();
    let shadow = most(n_shadow);
    let gather = if asks_voxels { most(n_gather) } else { 0 };
    RayNeeds {
        // Others ask for the rest of a C-ray behind the cut.
        voxel: if asks_voxels { (shadow + gather).clamp(1, RAYS_ASKED_MAX) } else { 1 },
        shadow,
        gather,
        mesh: if asks_voxels && near == Near::Voxel && shadows == Shadows::Voxel { 0 } else { shadow },
    }
}

/// A shadow ray as a path asks for it.
#[derive(Clone, Copy, Debug)]
pub(super) struct ShadowParts {
    /// The part that the mesh answers.
    pub(super) on_mesh: Option<(Ray, Start)>,
    /// The part that the voxels answer.
    pub(super) in_voxels: Option<GRay>,
    /// Its number at the surface, where the mesh is to be asked for all of it when a voxel is met.
    pub(super) unsure: Option<u32>,
    /// The light that it brings when it meets nothing.
    pub(super) light: Vec3,
}

/// A shadow ray that was asked: its places on the mesh and in the voxels, where anything of it is there; the rest as in
/// [`ShadowParts`].
#[derive(Clone, Copy, Debug)]
pub(super) struct ShadowRay {
    on_mesh: Option<u32>,
    in_voxels: Option<u32>,
    pub(super) unsure: Option<u32>,
    pub(super) light: Vec3,
}

/// What is known of the way to a light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Occlusion {
    Clear,
    Occluded,
    /// A voxel is met, and the mesh has not been asked yet.
    Unsure,
}

/// Rays that are asked together, and their answers.
#[derive(Debug, Default)]
pub(crate) struct GBatch {
    /// In the order of asking.
    pub(super) shadows: Vec<ShadowRay>,
    pub(super) gathers: Vec<GatherLeg>,
    rays: GRays,
    on_mesh: MeshRays,
    /// Rays that may come, for vectors that do not grow past them; `None` once there is room for them.
    room: Option<RayNeeds>,
}

/// The batch that is asked, and the one before, whose answers are taken meanwhile.
#[derive(Debug)]
pub(crate) struct GBatches {
    pub(super) asked: GBatch,
    pub(super) answered: GBatch,
    room: RayNeeds,
    /// Most rays of a path at a time.
    pub(super) most: usize,
}

/// The part of a batch that a path has asked for.
#[derive(Clone, Debug)]
pub(crate) struct Place {
    pub(super) surface: SurfaceInteraction,
    pub(super) shadow: Part,
    pub(super) gather: Part,
}

/// Rays of one kind: their places in the batch, and their numbers at the surface; the end of these is the first that is
/// still to be asked.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    pub(super) places: Range<u32>,
    pub(super) rays: Range<u32>,
}

impl Part {
    pub(super) fn range(&self) -> Range<usize> {
        self.places.start as usize..self.places.end as usize
    }
}

impl RayNeeds {
    /// The rays of so many paths.
    pub(crate) fn times(self, paths: usize) -> RayNeeds {
        let RayNeeds { voxel, shadow, gather, mesh } = self;
        RayNeeds { voxel: paths * voxel, shadow: paths * shadow, gather: paths * gather, mesh: paths * mesh }
    }

    /// Bytes of a batch of them.
    pub(crate) fn bytes(self) -> usize {
        self.voxel * GRays::RAY_BYTES
            + self.shadow * size_of::<ShadowRay>()
            + self.gather * size_of::<GatherLeg>()
            + self.mesh * MeshRays::RAY_BYTES
    }
}

impl GBatch {
    fn with_room(room: RayNeeds) -> GBatch {
        GBatch { room: Some(room), ..GBatch::default() }
    }

    /// Asks for the rest of a C-ray, or for a ray from the camera through the upper octree.
    pub(super) fn push_far(&mut self, scene: &GScene<'_>, far: FarRay) -> AskedFar {
        let (ray, t_in) = scene.g_ray(&far.ray, GKind::Far, 0.0);
        AskedFar { far, t_in, place: self.push(ray) }
    }

    /// Asks for a ray of the voxels. Its place.
    pub(super) fn push(&mut self, ray: GRay) -> u32 {
        self.make_room();
        self.rays.push(ray)
    }

    /// Asks for what is left of a shadow ray on the mesh and in the voxels.
    pub(super) fn push_shadow(&mut self, ShadowParts { on_mesh, in_voxels, unsure, light }: ShadowParts) {
        self.make_room();
        let on_mesh = on_mesh.map(|(ray, start)| self.on_mesh.push(ray, start));
        let in_voxels = in_voxels.map(|ray| self.rays.push(ray));
        self.shadows.push(ShadowRay { on_mesh, in_voxels, unsure, light });
    }

    /// Asks for a gather ray which goes on as `ray`, if anything is left of it.
    pub(super) fn push_gather(&mut self, scene: &GScene<'_>, ray: Option<Ray>, leg: GatherLeg) {
        self.make_room();
        let leg = match ray {
            None => GatherLeg { asked: None, ..leg },
            Some(ray) => {
                let (asked, t_in) = scene.g_ray(&ray, GKind::Gather, leg.spread);
                GatherLeg { asked: Some(self.rays.push(asked)), ray, t_in, ..leg }
            }
        };
        self.gathers.push(leg);
    }

    /// Where the next rays will stand.
    pub(super) fn mark(&self) -> [usize; 4] {
        [self.shadows.len(), self.gathers.len(), self.rays.rays().len(), self.on_mesh.len()]
    }

    /// Forgets what was asked since then.
    pub(super) fn forget_from(&mut self, [shadows, gathers, rays, on_mesh]: [usize; 4]) {
        self.shadows.truncate(shadows);
        self.gathers.truncate(gathers);
        self.rays.truncate(rays);
        self.on_mesh.truncate(on_mesh);
    }

    /// The answer of a ray in the voxels.
    pub(super) fn answer(&self, place: u32) -> &GAnswer {
        &self.rays.answers()[place as usize]
    }

    /// What is known of a shadow ray.
    pub(super) fn occlusion(&self, ray: &ShadowRay) -> Answer<Occlusion> {
        match ray.on_mesh.map(|place| self.on_mesh.occluded(place)) {
            None | Some(Answer::Exact(false)) => {}
            Some(Answer::Exact(true)) => return Answer::Exact(Occlusion::Occluded),
            Some(Answer::Blocked) => return Answer::Blocked,
        }
        match ray.in_voxels.map(|place| self.answer(place).outcome) {
            Some(GAnswer::BLOCKED) => Answer::Blocked,
            Some(GAnswer::MET) if ray.unsure.is_some() => Answer::Exact(Occlusion::Unsure),
            Some(GAnswer::MET) => Answer::Exact(Occlusion::Occluded),
            _ => Answer::Exact(Occlusion::Clear),
        }
    }

    #[inline]
    fn make_room(&mut self) {
        if let Some(RayNeeds { voxel, shadow, gather, mesh }) = self.room.take() {
            self.rays.reserve_exact(voxel);
            self.shadows.reserve_exact(shadow);
            self.gathers.reserve_exact(gather);
            self.on_mesh.reserve_exact(mesh);
        }
    }
}

impl Default for GBatches {
    fn default() -> GBatches {
        GBatches::with_room(RayNeeds::default())
    }
}

impl GBatches {
    /// Batches of paths that ask for these rays at most, all together.
    pub(crate) fn with_room(room: RayNeeds) -> GBatches {
        let (asked, answered) = (GBatch::with_room(room), GBatch::default());
        GBatches { asked, answered, room, most: RAYS_ASKED_MAX }
    }

    /// Batches of a path alone, which asks for one ray at a time: its retries need the pages of that ray alone.
    pub(crate) fn of_one() -> GBatches {
        let room = RayNeeds { voxel: 1, shadow: 1, gather: 1, mesh: 1 };
        GBatches { most: 1, ..GBatches::with_room(room) }
    }

    /// Turns to what was asked since the last call: rays on the mesh are answered, those in the voxels are to be.
    pub(crate) fn turn<T: Tracer>(&mut self, tracer: &mut T) {
        self.answered = std::mem::replace(&mut self.asked, GBatch::with_room(self.room));
        let GBatch { shadows, rays, on_mesh, .. } = &mut self.answered;
        if on_mesh.len() == 0 {
            return;
        }
        on_mesh.answer(tracer);
        for ray in shadows {
            // What the mesh stops, or may stop, would ask the voxels in vain.
            if let (Some(near), Some(rest)) = (ray.on_mesh, ray.in_voxels)
                && on_mesh.occluded(near) != Answer::Exact(false)
            {
                rays.pass_by(rest);
            }
        }
    }

    /// True when the G-stage is to answer before the paths go on.
    pub(crate) fn waits_for_stage(&self) -> bool {
        !self.answered.rays.rays().is_empty()
    }

    /// The rays that the G-stage is to answer; they come back by [`GBatches::put_back`].
    pub(crate) fn take_rays(&mut self) -> GRays {
        std::mem::take(&mut self.answered.rays)
    }

    /// Takes the answered rays.
    pub(crate) fn put_back(&mut self, rays: GRays) {
        assert_eq!(rays.answers().len(), rays.rays().len(), "an answer for each ray");
        self.answered.rays = rays;
    }

    /// Has the G-stage answer the rays of this turn, and waits for it.
    ///
    /// # Panics
    /// When rays ask voxels that are not there.
    pub(crate) fn ask_stage<T: Tracer>(
        &mut self,
        (g_stage, view): (&dyn GStage, Option<GView>),
        tracer: &mut T,
    ) {
        if self.waits_for_stage() {
            let view = view.expect("rays that ask voxels have some");
            let call = GCall { view, parts: vec![self.take_rays()] };
            let mut answered = g_stage.submit(call, tracer.lend_pages()).wait();
            self.put_back(answered.parts.pop().expect("a call comes back whole"));
        }
    }

    /// Forgets what has been taken.
    pub(crate) fn forget_answered(&mut self) {
        self.answered = GBatch::default();
    }

    /// Forgets all.
    pub(crate) fn clear(&mut self) {
        *self = GBatches { most: self.most, ..GBatches::with_room(self.room) };
    }
}
