//! G-rays of many samples, asked and taken together: what one sample asks for after a hit is too little to keep a
//! processor busy.
//!
//! ```text
//! path at a surface -> asks: its shadow and gather rays go to the batch, the path waits
//! all paths of a tile have asked or ended -> the batch is traced -> each takes its answers, in order
//! ```
//!
//! Only rays that the resident octree answers go here: with `near = exact`, or with units, a ray may be blocked, and
//! is asked alone.
//!
//! Invariants: 1. a sample gets the same bytes as from rays asked one by one: the same numbers, added in the same
//! order; 2. a path that has asked takes its answers before the batch is cleared; 3. a path asks for at most
//! `ASKED_MAX` at a time.

use super::Integrator;
use super::context::RenderContext;
use super::g_batch::{ASKED_MAX, GBatch, Part, Place};
use super::gather::GatherQuery;
use super::path_state::{Path, Stage};
use crate::scene::settings::Near;
use crate::shading::surface::SurfaceInteraction;

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
        self.g_scene().is_some_and(|scene| scene.near == Near::Voxel && scene.lower.is_none())
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
        let (from, next) = (batch.entry_count(), n_shadow.min(first.shadow + ASKED_MAX));
        let left = if next == n_shadow { ASKED_MAX - (next - first.shadow) } else { 0 };
        for index in first.shadow..next {
            if let Some(query) = integrator.shadow_query(self, path, surface, index) {
                path.sample.rays.count(integrator.shadow_kind());
                let ray = scene.leave(surface, query.direction, query.distance, query.front);
                batch.push(ray, query.light);
            }
        }
        let shadow = Part { entries: from..batch.entry_count(), next };
        let next = self.n_gather().min(first.gather + left);
        for index in first.gather..next {
            if let Some(GatherQuery { direction, weight }) = self.gather_query(path, surface, index) {
                batch.push(scene.leave(surface, direction, f64::INFINITY, None), weight);
            }
        }
        let gather = Part { entries: shadow.entries.end..batch.entry_count(), next };
        Stage::TakeGRays(Place { surface: *surface, shadow, gather })
    }

    /// Takes what these rays brought.
    pub(super) fn take(&self, path: &mut Path, place: &Place, batch: &GBatch) -> Stage {
        let Place { surface, shadow, gather } = place;
        for &(ray, light) in batch.entries(shadow) {
            if ray.is_none_or(|ray| batch.answer(ray).1.is_none()) {
                path.gain(light);
            }
        }
        if shadow.next < self.n_shadow() {
            return Stage::Shadow { surface: *surface, index: shadow.next };
        }
        let scene = self.g_scene().expect("batches have voxels");
        for &(ray, weight) in batch.entries(gather) {
            let Some(ray) = ray else { continue };
            let (ray, found) = batch.answer(ray);
            let found = scene.gather_from(ray, found, self.world);
            path.sample.rays.gather += found.rays;
            path.gain_indirect(weight * found.radiance);
        }
        self.after_gather_ray(*surface, gather.next)
    }
}
