//! What `rays` is asked to measure.

use trex_model::DeviceOptions;
use trex_store::io::IoOptions;

/// What to measure.
#[derive(Clone, Debug)]
pub struct RayOptions {
    /// Width and height of the picture; every pixel gives up to one ray to each set.
    pub resolution: [u32; 2],
    /// Measured rounds, at least 1.
    pub rounds: usize,
    /// Seed of the gather rays.
    pub seed: u64,
    /// How pages are read where they do not all fit.
    pub io: IoOptions,
    /// Count visits, beside those of a reference tree.
    pub stats: bool,
    /// The device that is to be asked the rays through the voxels, too.
    pub device: Option<DeviceOptions>,
    /// Whom to compare with.
    pub peer: Option<Peer>,
}

/// Somebody else's ray tracer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Peer {
    /// Intel Embree 3.
    #[cfg(feature = "peer-embree")]
    Embree,
}
