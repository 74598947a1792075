//! What a session keeps of the parts that it shows.
//!
//! ```text
//! sections            tracers, G-rays and lamps leave out what is cut away; caps take memory a worker
//! hidden materials    the same, and an octree without their leaves, which shares all but bitmaps with the whole one
//! ```
//!
//! Invariant: what parts take is leased as long as they are shown, caps and
//! octree alike: [`PartNeeds`].

use crate::scene::world::Model;
use crate::trace::{PagedTracer, Parts};
use crate::voxel::Voxels;
use std::sync::Arc;
use trex_store::{Budget, Lease, Result};

/// What a session keeps of the parts that it shows.
#[derive(Debug)]
pub(super) struct ShownModel {
    /// The octree with all materials.
    pub(super) whole: Option<Arc<Voxels>>,
    /// Room of the caps of all workers.
    pub(super) caps: Option<Lease>,
}

/// Room of the caps of so many workers; none without sections.
pub(super) fn cap_room(parts: &Parts, workers: usize, budget: &Budget) -> Result<Option<Lease>> {
    let needs = parts.needs();
    needs.is_cut.then(|| budget.lease("caps of sections", needs.cap_bytes(workers))).transpose()
}

/// The octree of what is shown.
pub(super) fn shown_voxels(
    whole: Option<&Arc<Voxels>>,
    parts: &Parts,
    budget: &Budget,
) -> Result<Option<Arc<Voxels>>> {
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
        let caps = cap_room(parts, workers, budget)?;
        model.voxels = shown_voxels(whole.as_ref(), parts, budget)?;
        Ok(ShownModel { whole, caps })
    }
}
