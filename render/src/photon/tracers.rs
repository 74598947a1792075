//! `PhotonTracers`: the tracers of all workers, of whatever type, so that the light of a session need not be generic
//! over it. A call sends a slice of photons; each of their rays is answered by the tracer's own type.

use super::mesh::MeshPhotons;
use crate::stats::PhotonStats;
use crate::trace::PagedTracer;
use std::ops::Range;

/// The tracers of all workers.
pub(crate) trait PhotonTracers {
    /// Count of workers.
    fn count(&self) -> usize;

    /// Sends the photons with these indices through the mesh: see [`MeshPhotons::trace`].
    fn trace(&mut self, photons: &MeshPhotons<'_>, indices: Range<u64>) -> Option<PhotonStats>;
}

impl<T: PagedTracer + Send> PhotonTracers for Vec<T> {
    fn count(&self) -> usize {
        self.len()
    }

    fn trace(&mut self, photons: &MeshPhotons<'_>, indices: Range<u64>) -> Option<PhotonStats> {
        photons.trace(self, indices)
    }
}
