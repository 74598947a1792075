//! Other parts of a model on show: voxels, lamps and tracers follow, and the light is sent anew.
//!
//! Invariant: what is refused changes nothing.

use super::parts::{cap_room, show, shown_voxels};
use super::{Change, Session};
use crate::scene::world::{Model, View, World};
use crate::trace::{OpenParts, PagedTracer, Parts};
use std::sync::Arc;
use trex_store::Result;

impl<T: PagedTracer + Send> Session<T> {
    /// Shows other parts of the model.
    pub(super) fn change_parts(&mut self, parts: Arc<Parts>) -> Result<Change> {
        if parts == self.view.parts {
            return Ok(Change::Nothing);
        }
        let hides_alike = parts.hidden() == self.view.parts.hidden();
        let view = View { parts, ..self.view.clone() };
        let voxels = match hides_alike {
            true => self.model.voxels.clone(),
            false => shown_voxels(self.shown.whole.as_ref(), &view.parts, &self.budget)?,
        };
        let model = Model { voxels, ..self.model.clone() };
        let world = World::new(&model, &view)?;
        // Their size depends on nothing but whether there are any.
        let keeps_caps = view.parts.needs().is_cut == self.view.parts.needs().is_cut;
        let caps = match keeps_caps {
            true => None,
            false => cap_room(&view.parts, self.tracers.len(), &self.budget)?,
        };
        if !hides_alike && let Some(voxels) = &model.voxels {
            self.g_stage.set_octree(voxels)?;
        }
        (self.model, self.view, self.world) = (model, view, world);
        if !keeps_caps {
            self.shown.caps = caps;
        }
        show(&mut self.tracers, &self.world.parts);
        Ok(Change::Light)
    }

    /// The open parts that rays have met on sections since they are as they are.
    pub fn open_parts(&self) -> OpenParts {
        let mut open = OpenParts::default();
        for mine in self.tracers.iter().map(PagedTracer::open_parts) {
            open.rays += mine.rays;
            open.materials.extend(mine.materials);
        }
        open.materials.sort_unstable();
        open.materials.dedup();
        open
    }
}
