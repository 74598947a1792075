//! `Display`: what a picture in frames shows where its film has no samples: previews, stand-ins, the last state.
//!
//! Invariants: 1. nothing of it is ever on the film; 2. its memory is leased before it is taken.

use super::film::Film;
use super::tile::{Tile, Tiles, tile_count};
use trex_store::{Budget, Lease, Result};

/// The content of a tile on show that has no samples.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shows {
    Nothing,
    /// The radiance that one voxel ray saw, linear RGB.
    Preview([f32; 3]),
    /// The pixels of the last state, in `radiance`.
    Before,
    StandIn,
}

/// The picture where the film has none.
#[derive(Debug)]
pub struct Display {
    resolution: [u32; 2],
    radiance: Vec<[f32; 3]>,
    tiles: Vec<Shows>,
    _lease: Lease,
}

impl Display {
    /// Bytes that a display takes at `resolution` (width, height; pixels).
    pub fn bytes(resolution: [u32; 2]) -> u64 {
        let pixels = u64::from(resolution[0]) * u64::from(resolution[1]);
        pixels * size_of::<[f32; 3]>() as u64 + u64::from(tile_count(resolution)) * size_of::<Shows>() as u64
    }

    /// A display of `resolution` (width, height; pixels) that shows nothing.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when `budget` has no room for [`Display::bytes`].
    pub(crate) fn new(resolution: [u32; 2], budget: &Budget) -> Result<Display> {
        let lease = budget.lease("the picture on show", Display::bytes(resolution))?;
        let pixels = resolution[0] as usize * resolution[1] as usize;
        let tiles = vec![Shows::Nothing; tile_count(resolution) as usize];
        Ok(Display { resolution, radiance: vec![[0.0; 3]; pixels], tiles, _lease: lease })
    }

    /// Radiance on show at pixel (x, y), which is of tile `tile`; linear RGB.
    pub(crate) fn radiance(&self, pixel: [u32; 2], tile: u32) -> [f32; 3] {
        match self.tiles[tile as usize] {
            Shows::Preview(radiance) => radiance,
            _ => self.radiance[self.place(pixel)],
        }
    }

    /// Sets the radiance of a pixel (x, y), linear RGB; its tile says whether it is shown.
    pub(crate) fn set(&mut self, pixel: [u32; 2], radiance: [f32; 3]) {
        let at = self.place(pixel);
        self.radiance[at] = radiance;
    }

    /// Shows one radiance for all of a tile, linear RGB.
    pub(crate) fn set_preview(&mut self, tile: &Tile, radiance: [f32; 3]) {
        self.tiles[tile.index as usize] = Shows::Preview(radiance);
    }

    /// True when the pixels of `tile` stand in for pages on their way.
    pub(crate) fn has_stand_in(&self, tile: &Tile) -> bool {
        self.tiles[tile.index as usize] == Shows::StandIn
    }

    /// Takes the pixels that were set for a stand-in of `tile`.
    pub(crate) fn mark_stand_in(&mut self, tile: &Tile) {
        self.tiles[tile.index as usize] = Shows::StandIn;
    }

    /// Takes over what `film` shows, before it is cleared; it counts as a picture of the last state.
    pub(crate) fn keep(&mut self, film: &Film, tiles: &Tiles) {
        for index in 0..tiles.count() {
            if film.tile_samples(index) > 0 {
                let tile = tiles.tile(index);
                for pixel in (0..tile.pixel_count()).map(|pixel| tile.pixel(pixel)) {
                    self.set(pixel, film.radiance(pixel));
                }
                self.tiles[index as usize] = Shows::Before;
            }
        }
    }

    /// Tiles without samples on `film`: those that show a stand-in, and those that show nothing.
    pub(crate) fn count(&self, film: &Film) -> [u32; 2] {
        let mut counts = [0; 2];
        for (index, shows) in self.tiles.iter().enumerate() {
            if film.tile_samples(index as u32) == 0 {
                counts[0] += u32::from(*shows == Shows::StandIn);
                counts[1] += u32::from(*shows == Shows::Nothing);
            }
        }
        counts
    }

    fn place(&self, [x, y]: [u32; 2]) -> usize {
        y as usize * self.resolution[0] as usize + x as usize
    }
}
