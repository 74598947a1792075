//! `TileCorners`: which samples of the grid the pixels of a tile are of one surface with.

use crate::tile::bit;

/// Of the pixels of a tile, a bit each, those that are of one surface with the sample at a corner of their cell: at the
/// upper left one, which is the cell's own, the upper right, the lower left and the lower right one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct TileCorners(pub(super) [u64; 4]);

/// The corners of a tile; `None` for one without exact samples.
pub(crate) type CornersOf<'a> = &'a (dyn Fn(u32) -> Option<TileCorners> + Sync);

impl TileCorners {
    /// The pixels of the tile that are of one surface with any corner.
    pub(crate) fn any(&self) -> u64 {
        self.0.iter().fold(0, |any, corner| any | corner)
    }

    /// The corners that a pixel (x, y) is of one surface with.
    pub(super) fn of(&self, pixel: [u32; 2]) -> [bool; 4] {
        self.0.map(|corner| corner >> bit(pixel) & 1 == 1)
    }
}
