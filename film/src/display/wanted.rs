//! Which samples of a grid a display wants: those of a picture that is made finer, and those to look at again.

use super::Display;
use crate::coarse::STEPS;

/// Which samples of a grid are taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum GridPart {
    /// Those that no coarser grid holds.
    New,
    /// Those, and the others where stand-ins were seen; but where there are exact samples.
    NewAndStandIns,
    /// Where stand-ins were seen, but where there are exact samples.
    StandIns,
}

impl Display {
    /// True when a sample is to be taken at a pixel (x, y) of the grid of every `step`-th; voxels nearer than
    /// `stand_ins_to`, model units, stand in for mesh that was missing.
    pub fn wants(&self, (step, part): (u32, GridPart), stand_ins_to: f32, pixel: [u32; 2]) -> bool {
        let is_new = step == STEPS[0] || pixel.iter().any(|v| v % (2 * step) != 0);
        if part == GridPart::New {
            return is_new;
        }
        let is_wanted =
            part == GridPart::NewAndStandIns && is_new || self.has_voxels_before(stand_ins_to, pixel);
        // Where there are exact samples, they have said what its pixels are of one surface with.
        is_wanted && self.standings[self.tile_at(pixel)].corners.any() == 0
    }

    /// True where the sample at pixel (x, y), one of the finest grid, saw voxels nearer than `depth`, model units.
    pub fn has_voxels_before(&self, depth: f32, pixel: [u32; 2]) -> bool {
        self.coarse.has_voxels_before(depth, pixel)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::film::{LayerPixel, NO_ID};
    use crate::tile::tile;
    use glam::Vec3;
    use trex_store::Budget;

    /// A tile with exact samples, one of mesh, and one of voxels at distance 2.
    #[test]
    fn what_is_new_and_what_stood_in_is_wanted_where_nothing_is_exact() {
        let resolution = [24, 8];
        let lease = Budget::unlimited().lease("the picture on show", Display::bytes(resolution)).unwrap();
        let mut display = Display::in_lease(resolution, lease);
        let pixels = || (0..8).flat_map(|y| (0..24).map(move |x| [x, y]));
        let mesh = LayerPixel {
            depth: 2.0,
            normal: [0.0, 0.0, 1.0],
            albedo: [0.5; 3],
            id: 0,
            ..LayerPixel::NOTHING
        };
        for pixel in pixels().filter(|pixel| pixel.iter().all(|v| v % 2 == 0)) {
            let id = if pixel[0] < 16 { 0 } else { NO_ID };
            display.set(pixel, Vec3::ONE, &LayerPixel { id, ..mesh });
        }
        let first = tile(resolution, 0);
        display.learn(&first, &(0..64).map(|i| (first.pixel(i), mesh)).collect::<Vec<_>>());
        for pixel in pixels().filter(|pixel| pixel.iter().all(|v| v % 2 == 0)) {
            let is_new = pixel.iter().any(|v| v % 4 == 2);
            let (is_open, is_voxel) = (pixel[0] >= 8, pixel[0] >= 16);
            let wants = |part, stand_ins_to| display.wants((2, part), stand_ins_to, pixel);
            for (stand_ins_to, stands_in) in [(1.9, false), (2.1, is_voxel)] {
                assert_eq!(wants(GridPart::New, stand_ins_to), is_new, "{pixel:?}");
                assert_eq!(wants(GridPart::NewAndStandIns, stand_ins_to), is_open && (is_new || stands_in));
                assert_eq!(wants(GridPart::StandIns, stand_ins_to), stands_in);
            }
            assert!(display.wants((8, GridPart::New), 0.0, pixel), "the coarsest grid is all new");
        }
    }
}
