//! Other parts of a model on show: voxels, lamps and tracers follow, and the light is sent anew.
//!
//! ```text
//! sections            tracers, G-rays and lamps leave out what is cut away; caps take memory a worker
//! hidden materials    the same, and an octree without their leaves, which shares all but bitmaps with the whole one
//! ```
//!
//! Invariants: 1. what is refused changes nothing; 2. what parts take is leased as long as they are shown, caps and
//! octree alike: [`PartNeeds`].

use super::{Change, Session};
use crate::scene::world::{Model, View, World};
use crate::trace::{OpenParts, PagedTracer, Parts};
use crate::voxel::Voxels;
use std::sync::Arc;
use trex_store::{Budget, Lease, Result};

/// What a session keeps of the parts that it shows.
#[derive(Debug)]
pub(super) struct ShownModel {
    /// The octree with all materials.
    whole: Option<Arc<Voxels>>,
    /// Room of the caps of all workers.
    _caps: Option<Lease>,
}

/// Room of the caps of so many workers; none without sections.
fn cap_room(parts: &Parts, workers: usize, budget: &Budget) -> Result<Option<Lease>> {
    let needs = parts.needs();
    needs.is_cut.then(|| budget.lease("caps of sections", needs.cap_bytes(workers))).transpose()
}

/// The octree of what is shown.
fn shown_voxels(whole: Option<&Arc<Voxels>>, parts: &Parts, budget: &Budget) -> Result<Option<Arc<Voxels>>> {
    match whole {
        Some(whole) if parts.hides_any() => Ok(Some(Arc::new(Voxels::without(whole, parts, budget)?))),
        whole => Ok(whole.cloned()),
    }
}

/// Has all tracers show `parts`.
pub(super) fn show<T: PagedTracer>(tracers: &mut [T], parts: &Arc<Parts>) {
    tracers.iter_mut().for_each(|tracer| tracer.show(parts));
}

impl ShownModel {
    /// What a session on `model` keeps of `parts`; the model has the octree of these from then on.
    pub(super) fn new(
        model: &mut Model,
        parts: &Parts,
        workers: usize,
        budget: &Budget,
    ) -> Result<ShownModel> {
        let whole = model.voxels.clone();
        let _caps = cap_room(parts, workers, budget)?;
        model.voxels = shown_voxels(whole.as_ref(), parts, budget)?;
        Ok(ShownModel { whole, _caps })
    }
}

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
        let caps = cap_room(&view.parts, self.tracers.len(), &self.budget)?;
        if !hides_alike && let Some(voxels) = &model.voxels {
            self.g_stage.set_octree(voxels)?;
        }
        (self.model, self.view, self.world) = (model, view, world);
        self.shown._caps = caps;
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
