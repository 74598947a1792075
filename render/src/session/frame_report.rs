//! `FrameReport`: what a frame has come to.

use crate::stats::{PassStats, RayCounts};

/// The state of a picture in the making.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum FrameProgress {
    /// Some samples of a preview are taken: what was on show still is.
    PreviewPart,
    /// The picture shows what is resident, by a sample at some pixels.
    Preview,
    /// Some tiles are done, less than a fetch block.
    Part,
    /// A fetch block or more is done: the response.
    Block,
    /// Every pixel has a sample that was taken after the event.
    Complete,
    /// Every pixel has all samples that were asked for, and all photons are in.
    Done,
}

/// The report of a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameReport {
    /// The state of the picture now.
    pub progress: FrameProgress,
    /// Tiles of the first fetch block since the event; until it is done, of the block that is made.
    pub block_tiles: u32,
    /// Tiles of a fetch block that was finished in this state, over those of the picture; 0 before.
    pub block_share: f64,
    /// Most pixels between two samples that were taken after the event; `None` while any pixel shows what was there
    /// before.
    pub sample_step: Option<u32>,
    /// Tiles that show the preview alone.
    pub preview_tiles: u32,
    /// Tiles that show nothing at all.
    pub hole_tiles: u32,
    /// Share of the photons of changed light that are in and shown, 0 to 1; 1 where none are on their way.
    pub light_share: f64,
    /// Error of the footprint rule, pixels.
    pub lod_error: f64,
    /// Counts of the pass in this frame.
    pub pass: PassStats,
    /// Rays of the preview in this frame.
    pub preview_rays: RayCounts,
    /// Samples of the preview in this frame.
    pub preview_samples: u64,
    /// Those of them whose ray from the camera met the model.
    pub preview_covered: u64,
    /// Rays of photons in this frame.
    pub photon_rays: u64,
}
