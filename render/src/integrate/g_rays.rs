//! Shadow and gather rays of many samples, asked and taken together: what one sample asks for after a hit is too little
//! to keep a processor, or another device, busy.
//!
//! ```text
//! path at a surface -> asks: its rays go to the batch of its tile, the path waits
//!   near = exact       a shadow ray is asked on the mesh, too; a gather ray begins there at once
//!   no voxels          a shadow ray is asked on the mesh alone; gather rays go their own way (`final_gather.rs`)
//! all paths of a tile have asked or ended -> the mesh and the G-stage answer -> each path takes its answers, in order
//!     a shadow ray met a voxel  -> with shadows = mesh it is asked there, the path waits again
//!     a gather ray met a mirror -> its next leg is asked, the path waits again
//!     one of them is blocked    -> the path asks all of these again
//! ```
//!
//! Invariants: 1. a sample gets the same bytes as from rays asked one by one: the same numbers, added in the same
//! order; 2. a path that has asked takes its answers before the batch is cleared; 3. a path asks for at most
//! `GBatches::most` at a time.

use super::Integrator;
use super::context::RenderContext;
use super::g_batch::{GBatch, GBatches, Occlusion, Part, Place, RAYS_ASKED_MAX, ShadowParts, ShadowRay};
use super::g_scene::NearMesh;
use super::gather::GatherQuery;
use super::gather_leg::GatherLeg;
use super::path_state::{Path, ShadowQuery, Stage};
use crate::scene::method::Shadows;
use crate::shading::surface::SurfaceInteraction;
use crate::trace::{Answer, Ray, Tracer};
use crate::voxel::GKind;
use glam::Vec3;

/// A surface, and the first shadow and the first gather ray there that a path has not asked for yet.
#[derive(Clone, Copy, Debug)]
pub(super) struct FirstRays<'a> {
    pub(super) surface: &'a SurfaceInteraction,
    pub(super) shadow: u32,
    pub(super) gather: u32,
}

impl RenderContext<'_> {
    /// Asks for the shadow rays of a surface, from the first on, and with the last of them for the gather rays.
    /// Blocked, with nothing asked, where a gather ray begins on the mesh and a page is missing.
    pub(super) fn ask<T: Tracer>(
        &self,
        integrator: &dyn Integrator,
        path: &mut Path,
        first: FirstRays<'_>,
        (batches, tracer): (&mut GBatches, &mut T),
    ) -> Answer<Stage> {
        let FirstRays { surface, .. } = first;
        let (batch, most) = (&mut batches.asked, batches.most as u32);
        let (mark, n_shadow) = (batch.mark(), self.n_shadow());
        let near = self.g_scene().and_then(|scene| scene.near_mesh(surface));
        let (from, end) = (batch.shadows.len() as u32, n_shadow.min(first.shadow + most));
        let left = if end == n_shadow { most - (end - first.shadow) } else { 0 };
        for index in first.shadow..end {
            if let Some(query) = integrator.shadow_query(self, path, surface, index) {
                self.ask_shadow((path, surface, near.as_ref()), (&query, index), batch);
            }
        }
        let shadow = Part { places: from..batch.shadows.len() as u32, rays: first.shadow..end };
        let from = batch.gathers.len() as u32;
        let left = if self.g_scene().is_some() { left } else { 0 };
        let end = self.n_gather().min(first.gather + left).max(first.gather);
        for index in first.gather..end {
            if let Some(query) = self.gather_query(path, surface, index)
                && self.ask_gather((surface, near), &query, batch, tracer) == Answer::Blocked
            {
                batch.forget_from(mark);
                return Answer::Blocked;
            }
        }
        let gather = Part { places: from..batch.gathers.len() as u32, rays: first.gather..end };
        Answer::Exact(Stage::TakeGRays(Place { surface: *surface, shadow, gather }))
    }

    /// Asks whether anything stands between a surface and the place that a query names.
    fn ask_shadow(
        &self,
        (path, surface, near): (&Path, &SurfaceInteraction, Option<&NearMesh>),
        (query, index): (&ShadowQuery, u32),
        batch: &mut GBatch,
    ) {
        let ShadowQuery { direction, distance, front, light } = *query;
        let start = path.origin.start();
        let Some(scene) = self.g_scene() else {
            let ray = surface.ray_to(direction, distance, front);
            let parts = ShadowParts { on_mesh: Some((ray, start)), in_voxels: None, unsure: None, light };
            return batch.push_shadow(parts);
        };
        let near_length = near.map(|near| near.length(direction));
        let on_mesh = near_length.map(|near| {
            let (end, front) = if near < distance { (near, None) } else { (distance, front) };
            (surface.ray_to(direction, end, front), start)
        });
        let rest = scene.leave(surface, direction, near_length, (distance, front));
        let in_voxels = rest.map(|ray| scene.g_ray(&ray, GKind::Shadow, 0.0).0);
        // The voxels hold all of the surface: a ray that meets none of them meets no triangle. What is far is voxels,
        // which need no pages in proportion to the model.
        let unsure = (scene.shadows == Shadows::Mesh && !path.is_far).then_some(index);
        batch.push_shadow(ShadowParts { on_mesh, in_voxels, unsure, light });
    }

    /// Asks for a gather ray in the voxels, once it has left the mesh.
    fn ask_gather<T: Tracer>(
        &self,
        (surface, near): (&SurfaceInteraction, Option<NearMesh>),
        &GatherQuery { direction, weight }: &GatherQuery,
        batch: &mut GBatch,
        tracer: &mut T,
    ) -> Answer<()> {
        let scene = self.g_scene().expect("gather rays in batches have voxels");
        let begun = self.gathered_near(scene, (surface, near), direction, tracer);
        let Answer::Exact((near, mirrors, ray)) = begun else {
            return Answer::Blocked;
        };
        let mut leg = GatherLeg::new(weight, mirrors, near);
        leg.spread = scene.spread(surface.normal, direction);
        batch.push_gather(scene, ray, leg);
        Answer::Exact(())
    }

    /// Takes what these rays brought. Blocked when any of them was: nothing is taken then. Where the mesh is to be
    /// asked for shadow rays, or gather rays go on from mirrors, these are asked, and all that is left is taken when
    /// they have ended.
    pub(super) fn take(
        &self,
        integrator: &dyn Integrator,
        path: &mut Path,
        place: &Place,
        GBatches { asked, answered, .. }: &mut GBatches,
    ) -> Answer<Stage> {
        let Place { surface, shadow, gather } = place;
        let shadows = &answered.shadows[shadow.range()];
        let is_blocked = |leg: &GatherLeg| leg.asked.is_some_and(|ray| answered.answer(ray).is_blocked());
        if shadows.iter().any(|ray| self.occlusion(ray, answered) == Answer::Blocked)
            || answered.gathers[gather.range()].iter().any(is_blocked)
        {
            return Answer::Blocked;
        }
        let is_unsure = |ray: &ShadowRay| self.occlusion(ray, answered) == Answer::Exact(Occlusion::Unsure);
        let left = if shadows.iter().any(is_unsure) {
            self.ask_mesh(integrator, (path, surface), shadow, (answered, asked))
        } else {
            for ray in shadows {
                path.sample.rays.count(integrator.shadow_kind());
                if self.occlusion(ray, answered) == Answer::Exact(Occlusion::Clear) {
                    path.gain(ray.light);
                }
            }
            if shadow.rays.end < self.n_shadow() {
                return Answer::Exact(Stage::Shadow { surface: *surface, index: shadow.rays.end });
            }
            Part { places: 0..0, rays: shadow.rays.end..shadow.rays.end }
        };
        let nexts = self.mirror_legs(gather, answered);
        if !left.range().is_empty() || nexts.iter().any(Option::is_some) {
            let from = asked.gathers.len() as u32;
            for (leg, next) in answered.gathers[gather.range()].iter().zip(nexts) {
                let scene = self.g_scene().expect("gather rays in batches have voxels");
                asked.push_gather(scene, next, *leg);
            }
            let gather = Part { places: from..asked.gathers.len() as u32, rays: gather.rays.clone() };
            return Answer::Exact(Stage::TakeGRays(Place { surface: *surface, shadow: left, gather }));
        }
        for leg in &answered.gathers[gather.range()] {
            path.sample.rays.gather += u64::from(leg.near.rays + leg.gathered.rays);
            path.gain_indirect(leg.weight * (leg.near.radiance + leg.gathered.radiance));
        }
        Answer::Exact(self.after_gather_ray(*surface, gather.rays.end))
    }

    /// What is known of a shadow ray. A preview waits for no page: where one is missing, a voxel that was met throws
    /// its shadow, and without voxels there is none.
    fn occlusion(&self, ray: &ShadowRay, answered: &GBatch) -> Answer<Occlusion> {
        match answered.occlusion(ray) {
            Answer::Blocked if self.is_preview && ray.unsure.is_some() => Answer::Exact(Occlusion::Occluded),
            Answer::Blocked if self.is_preview => Answer::Exact(Occlusion::Clear),
            known => known,
        }
    }

    /// Asks the mesh for the shadow rays of a part of which the voxels leave it unsure whether they meet anything. The
    /// part as it is asked now: what is known stays known.
    fn ask_mesh(
        &self,
        integrator: &dyn Integrator,
        (path, surface): (&Path, &SurfaceInteraction),
        part: &Part,
        (answered, asked): (&GBatch, &mut GBatch),
    ) -> Part {
        let from = asked.shadows.len() as u32;
        for ray in &answered.shadows[part.range()] {
            let mut parts =
                ShadowParts { on_mesh: None, in_voxels: None, unsure: ray.unsure, light: ray.light };
            match (answered.occlusion(ray), ray.unsure) {
                (Answer::Exact(Occlusion::Unsure), Some(index)) => {
                    let query = integrator.shadow_query(self, path, surface, index);
                    let ShadowQuery { direction, distance, front, .. } = query.expect("as before");
                    parts.on_mesh = Some((surface.ray_to(direction, distance, front), path.origin.start()));
                }
                (Answer::Exact(Occlusion::Clear), _) => {}
                _ => parts.light = Vec3::ZERO,
            }
            asked.push_shadow(parts);
        }
        Part { places: from..asked.shadows.len() as u32, rays: part.rays.clone() }
    }

    /// Takes the answers of gather rays. The next legs of those that go on from a mirror, in the order of the part.
    fn mirror_legs(&self, part: &Part, answered: &mut GBatch) -> [Option<Ray>; RAYS_ASKED_MAX] {
        let mut nexts = [None; RAYS_ASKED_MAX];
        let Some(scene) = self.g_scene() else { return nexts };
        for (place, next) in part.range().zip(&mut nexts) {
            let mut leg = answered.gathers[place];
            let Some(ray) = leg.asked.take() else { continue };
            let found = answered.answer(ray).surface(leg.t_in, scene.subvoxel_side());
            *next = scene.arrive(&mut leg, found, self.world);
            answered.gathers[place] = leg;
        }
        nexts
    }

    /// The stage that asks again for what a path has asked.
    pub(super) fn ask_again(&self, Place { surface, shadow, gather }: &Place) -> Stage {
        match shadow.rays.start < self.n_shadow() {
            true => Stage::Shadow { surface: *surface, index: shadow.rays.start },
            false => Stage::Gather { surface: *surface, index: gather.rays.start },
        }
    }
}
