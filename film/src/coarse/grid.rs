//! The grids of a preview: samples at every so many pixels.

/// Pixels from sample to sample, the coarsest first. Powers of two, so that each grid holds those before it. None is as
/// fine as the picture: with a sample at each pixel it would cost what the exact tiles cost.
pub const STEPS: [u32; 3] = [8, 4, 2];
/// Step of the finest grid, whose samples are kept.
pub(super) const KEPT_STEP: u32 = STEPS[STEPS.len() - 1];

/// Width and height of the grid with a sample at every `step`-th pixel of a picture of `resolution`.
pub fn grid_size(resolution: [u32; 2], step: u32) -> [u32; 2] {
    resolution.map(|side| side.div_ceil(step))
}

/// Count of samples at every `step`-th pixel.
pub(super) fn sample_count(resolution: [u32; 2], step: u32) -> usize {
    grid_size(resolution, step).into_iter().map(|side| side as usize).product()
}
