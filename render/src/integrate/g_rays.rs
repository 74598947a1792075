//! G-rays of many samples, asked and taken together: what one sample asks for after a hit is too little to keep a
//! processor, or another device, busy.
//!
//! ```text
//! path at a surface -> asks: its shadow and gather rays go to the batch of its tile, the path waits
//! all paths of a tile have asked or ended -> the G-stage answers many tiles -> each path takes its answers, in order
//!                                         -> one of them is blocked: the path asks all of these again
//! ```
//!
//! With `near = exact` rays begin on the mesh, and are asked alone.
//!
//! Invariants: 1. a sample gets the same bytes as from rays asked one by one: the same numbers, added in the same
//! order; 2. a path that has asked takes its answers before the batch is cleared; 3. a path asks for at most
//! `RAYS_ASKED_MAX` at a time.

use super::Integrator;
use super::context::RenderContext;
use super::g_batch::{GBatch, Part, Place, RAYS_ASKED_MAX};
use super::g_scene::Gathered;
use super::gather::GatherQuery;
use super::path_state::{Path, Stage};
use crate::g_stage::GKind;
use crate::scene::method::Near;
use crate::shading::surface::SurfaceInteraction;
use crate::stats::RayKind;
use crate::trace::{Answer, Tracer};

/// A surface, and the first shadow and the first gather ray there that a path has not asked for yet.
#[derive(Clone, Copy, Debug)]
pub(super) struct FirstRays<'a> {
    pub(super) surface: &'a SurfaceInteraction,
    pub(super) shadow: u32,
    pub(super) gather: u32,
}

impl RenderContext<'_> {
    /// True when shadow and gather rays are asked in batches.
    pub(super) fn batches_g_rays(&self) -> bool {
        self.g_scene().is_some_and(|scene| scene.near == Near::Voxel)
    }

    /// Asks for the shadow rays of a surface, from the first on, and with the last of them for the gather rays.
    pub(super) fn ask(
        &self,
        integrator: &dyn Integrator,
        path: &mut Path,
        first: FirstRays<'_>,
        batch: &mut GBatch,
    ) -> Stage {
        let FirstRays { surface, .. } = first;
        let scene = self.g_scene().expect("batches have voxels");
        let n_shadow = self.n_shadow();
        let (from, end) = (batch.entry_count(), n_shadow.min(first.shadow + RAYS_ASKED_MAX as u32));
        let left = if end == n_shadow { RAYS_ASKED_MAX as u32 - (end - first.shadow) } else { 0 };
        for index in first.shadow..end {
            if let Some(query) = integrator.shadow_query(self, path, surface, index) {
                let ray = scene.leave(surface, query.direction, query.distance, query.front);
                batch.push(ray, GKind::Shadow, query.light);
            }
        }
        let shadow = Part { entries: from..batch.entry_count(), rays: first.shadow..end };
        let end = self.n_gather().min(first.gather + left);
        for index in first.gather..end {
            if let Some(GatherQuery { direction, weight }) = self.gather_query(path, surface, index) {
                batch.push(scene.leave(surface, direction, f64::INFINITY, None), GKind::Gather, weight);
            }
        }
        let gather = Part { entries: shadow.entries.end..batch.entry_count(), rays: first.gather..end };
        Stage::TakeGRays(Place { surface: *surface, shadow, gather })
    }

    /// Takes what these rays brought. Blocked when any of them was: nothing is taken then.
    pub(super) fn take<T: Tracer>(
        &self,
        kind: RayKind,
        path: &mut Path,
        (place, batch): (&Place, &GBatch),
        tracer: &mut T,
    ) -> Answer<Stage> {
        let Place { surface, shadow, gather } = place;
        let answer = |ray: Option<u32>| ray.map(|ray| batch.answer(ray));
        if batch
            .entries(shadow)
            .iter()
            .any(|&(ray, _)| answer(ray).is_some_and(|(_, found)| found.is_blocked()))
        {
            return Answer::Blocked;
        }
        let scene = self.g_scene().expect("batches have voxels");
        let mut gathered = [Gathered::NOTHING; RAYS_ASKED_MAX];
        for (&(ray, _), gathered) in batch.entries(gather).iter().zip(&mut gathered) {
            let Some((ray, found)) = answer(ray) else { continue };
            let Answer::Exact(found) = found.surface() else { return Answer::Blocked };
            match scene.gather(*ray, Some(found), self.world, scene.no_mirrors(), tracer) {
                Answer::Exact(found) => *gathered = found,
                Answer::Blocked => return Answer::Blocked,
            }
        }
        for &(ray, light) in batch.entries(shadow) {
            path.sample.rays.count(kind);
            if answer(ray).is_none_or(|(_, found)| found.is_nothing()) {
                path.gain(light);
            }
        }
        if shadow.rays.end < self.n_shadow() {
            return Answer::Exact(Stage::Shadow { surface: *surface, index: shadow.rays.end });
        }
        for (&(_, weight), found) in batch.entries(gather).iter().zip(&gathered) {
            path.sample.rays.gather += found.rays;
            path.gain_indirect(weight * found.radiance);
        }
        Answer::Exact(self.after_gather_ray(*surface, gather.rays.end))
    }

    /// The stage that asks again for what a path has asked.
    pub(super) fn ask_again(&self, Place { surface, shadow, gather }: &Place) -> Stage {
        match shadow.rays.start < self.n_shadow() {
            true => Stage::Shadow { surface: *surface, index: shadow.rays.start },
            false => Stage::Gather { surface: *surface, index: gather.rays.start },
        }
    }
}
