//! `IndirectLight`: what keeps the light that photons bring, and has them sent: at leisure all of them at once, in
//! frames a part of them each.
//!
//! ```text
//! at leisure   illuminate -> irradiance | photon_tree         an edit: forget
//! in frames    go_live -> advance, advance ... -> is_whole    an edit: restart -> advance ...
//!              leave_frames
//! ```
//!
//! Why a trait object: frames, shares of memory and passes over tiles ask the same few questions of every kind of
//! light, and each kind answers them in one file; an enum would repeat each question as a match. A call is made per
//! frame or per slice of photons, never per ray.
//!
//! Invariants: 1. light that is whole depends on world and photon count alone; 2. a pass of photons counts whole or not
//! at all; 3. in frames the light on show stays until what comes after it is there, or there is no room for both.

use crate::g_stage::GStage;
use crate::photon::irradiance::{Irradiance, PhotonMap};
use crate::photon::kd_tree::PhotonTree;
use crate::photon::tracers::PhotonTracers;
use crate::photon::voxel::VoxelPhotons;
use crate::scene::world::{Model, World};
use crate::shading::light::PhotonSources;
use crate::stats::PhotonStats;
use rayon::ThreadPool;
use std::fmt::Debug;
use std::time::Instant;
use trex_store::{Budget, Lease, Result};

/// The indirect light of a session: see the top of the file. The defaults are those of a light that keeps nothing and
/// is always whole.
pub(crate) trait IndirectLight: Debug + Send + Sync {
    /// The leases that go when light of another kind takes the place of this.
    fn leases_mut(&mut self) -> Vec<&mut Lease> {
        vec![]
    }

    /// Forgets all photons.
    fn forget(&mut self) {}

    /// Sends the photons that are still to be sent, of those that the settings ask for, until the work stops. `tell`
    /// hears how many are done, and of how many.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for what is leased while they are sent.
    fn illuminate(&mut self, _: &mut LightWork<'_>, _tell: &mut dyn FnMut(u64, u64)) -> Result<PhotonStats> {
        Ok(PhotonStats::default())
    }

    /// Begins to work in frames, in a lease of [`LightBytes::in_frames`]; where nothing is kept yet, photons are on
    /// their way from then on.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for photons to begin with.
    fn go_live(&mut self, _: &LightWork<'_>, _room: Lease) -> Result<()> {
        Ok(())
    }

    /// Ends the work in frames. Light that has changed and is not whole is forgotten.
    fn leave_frames(&mut self) {}

    /// Starts again, in frames: lights, materials or settings have changed, and photons on their way are out of date.
    fn restart(&mut self, _: &LightWork<'_>) {}

    /// Sends photons until `deadline` has passed or the work stops. Gives the count of rays, and their effect.
    fn advance(&mut self, _: &mut LightWork<'_>, _deadline: Instant) -> (u64, Arrival) {
        (0, Arrival::Nothing)
    }

    /// Share of the photons on their way that are in, 0 to 1; 1 when it is whole.
    fn share(&self) -> f64 {
        1.0
    }

    /// True when nothing is on its way.
    fn is_whole(&self) -> bool {
        true
    }

    /// True when a first picture waits for photons: there is no light at all.
    fn precedes_response(&self) -> bool {
        false
    }

    /// The light in the voxels.
    fn irradiance(&self) -> Irradiance<'_> {
        Irradiance::NONE
    }

    /// What keeps the light in the voxels, as it is on show.
    fn photon_map(&self) -> Option<&PhotonMap> {
        None
    }

    /// Photons, each by itself.
    fn photon_tree(&self) -> Option<&PhotonTree> {
        None
    }
}

/// The effect of photons on the light that gather rays find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Arrival {
    /// The light is what it was.
    Nothing,
    /// Some of it has changed: what was shown is near to it.
    Blended,
    /// All of it is other light.
    Replaced,
}

/// What photons fly through, and who sends them.
pub(crate) struct LightWork<'a> {
    pub(crate) world: &'a World,
    pub(crate) model: &'a Model,
    pub(crate) g_stage: &'a dyn GStage,
    pub(crate) tracers: &'a mut dyn PhotonTracers,
    pub(crate) pool: &'a ThreadPool,
    pub(crate) budget: &'a Budget,
    /// Asked between photons: true ends the work.
    pub(crate) stop: &'a (dyn Fn() -> bool + Sync),
}

/// Bytes that a light takes, by when they are leased.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct LightBytes {
    /// For the life of the session.
    pub(crate) lasting: u64,
    /// Beside these, while pictures come in frames.
    pub(crate) in_frames: u64,
    /// While a pass of photons goes into the voxels at leisure.
    pub(crate) pass: u64,
    /// For photons side by side in the voxels, beyond what is too small for the ledger: a part of the room of passes.
    pub(crate) flocks: u64,
    /// For photons that are kept each by itself, and those under way on the mesh; leased when they are sent.
    pub(crate) photons: u64,
    /// As `photons`, in frames, where the light on show stays until what comes after it is there.
    pub(crate) photons_in_frames: u64,
}

impl LightBytes {
    /// What it takes while pictures come at leisure.
    pub(crate) fn at_leisure(self) -> LightBytes {
        LightBytes { in_frames: 0, photons_in_frames: 0, ..self }
    }

    /// What it takes while pictures come in frames: sums of a pass last.
    pub(crate) fn live(self) -> LightBytes {
        LightBytes { pass: 0, photons: self.photons_in_frames, ..self }
    }
}

/// The leases that a light is made in.
pub(crate) struct LightRoom {
    /// Of [`LightBytes::lasting`].
    pub(crate) lasting: Lease,
    /// Of [`LightBytes::in_frames`]; `None` at leisure.
    pub(crate) in_frames: Option<Lease>,
}

impl<'a> LightWork<'a> {
    /// The voxels that photons go through, with the world; `None` for a model without voxels.
    pub(crate) fn voxel_photons(&self) -> Option<VoxelPhotons<'a>> {
        let voxels = self.model.voxels.as_ref()?;
        Some(VoxelPhotons {
            world: self.world,
            bounds: &self.model.bounds,
            voxels: voxels.scene(self.world.settings.occluders),
            g_stage: self.g_stage,
            pool: self.pool,
            budget: self.budget,
        })
    }

    /// What sends photons; `None` where nothing gives light.
    pub(crate) fn sources(&self) -> Option<PhotonSources<'a>> {
        PhotonSources::new(&self.world.lights, &self.model.bounds)
    }
}
