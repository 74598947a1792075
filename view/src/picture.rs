//! `Picture`: what clients are shown, in 8 bits: the whole picture, or every so many pixels of it while it moves.
//!
//! Invariants: 1. only tiles that may have changed are looked at, and only blocks whose bytes have changed are marked;
//! 2. its memory does not grow after [`Picture::new`]; 3. `frame` grows with each change.

use crate::blocks::{BLOCKS_MAX, Layout, Marks};
use crate::tone::Tone;
use crate::wire::BLOCK_SIDE;
use std::sync::Arc;

/// Side of a tile of the renderer, pixels.
const TILE_SIDE: u32 = trex_render::TILE_SIDE_PIXELS;
/// Pixels from one that is sent to the next: the largest.
pub(crate) const SCALE_MAX: u32 = 8;

const _: () = assert!(BLOCK_SIDE.is_multiple_of(TILE_SIDE) && TILE_SIDE.is_multiple_of(SCALE_MAX));

/// A PNG of the settled picture; it goes in parts, so that what is newer never waits for long.
#[derive(Clone, Debug)]
pub(crate) struct SettledPng {
    /// The frame that it is of.
    pub(crate) frame: u32,
    pub(crate) png: Arc<Vec<u8>>,
}

/// What is on show.
#[derive(Debug)]
pub(crate) struct Picture {
    /// Width and height of the whole picture, pixels.
    pub(crate) full: [u32; 2],
    /// Pixels of the whole picture from one of these to the next: 1, 2, 4 or 8.
    pub(crate) scale: u32,
    /// The blocks of what is sent.
    pub(crate) layout: Layout,
    /// What is sent, by rows.
    pub(crate) rgb: Vec<[u8; 3]>,
    /// Counts changes.
    pub(crate) frame: u32,
    /// The driver's last event that is in it.
    pub(crate) seq: u32,
    /// Flags of [`crate::wire`].
    pub(crate) flags: u8,
    /// The same without loss, once it stands still.
    pub(crate) settled: Option<SettledPng>,
    /// Nothing has been taken over yet: there is nothing to be sent.
    is_blank: bool,
    /// Every tile is to be looked at the next time.
    forgets: bool,
}

/// The blocks that have changed.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum BlockChanges {
    /// These.
    Some(Marks),
    /// All of them: there are others than before.
    All,
}

/// Gives the radiances of pixels of one row of one tile, from the first on.
pub(crate) type Show<'a> = dyn Fn([u32; 2], &mut [[f32; 3]]) + 'a;

/// What the renderer shows: whether a tile may have changed since this was asked last, and what it shows.
pub(crate) struct TileSource<'a> {
    pub(crate) has_changed: &'a mut dyn FnMut(u32) -> bool,
    pub(crate) show: &'a Show<'a>,
}

impl Picture {
    /// Bytes of a picture of `full` pixels.
    pub(crate) fn bytes([width, height]: [u32; 2]) -> u64 {
        u64::from(width) * u64::from(height) * 3
    }

    /// A picture of `full` pixels that shows nothing.
    pub(crate) fn new(full: [u32; 2]) -> Picture {
        let scale = Picture::least_scale(full);
        let layout = Layout::new(full, scale);
        let mut rgb = Vec::with_capacity(full[0] as usize * full[1] as usize);
        rgb.resize(layout.size[0] as usize * layout.size[1] as usize, [0; 3]);
        Picture {
            full,
            scale,
            layout,
            rgb,
            frame: 0,
            seq: 0,
            flags: 0,
            settled: None,
            is_blank: true,
            forgets: true,
        }
    }

    /// The smallest scale at which blocks can be numbered.
    pub(crate) fn least_scale(full: [u32; 2]) -> u32 {
        let fits = |scale: &u32| Layout::new(full, *scale).count() <= BLOCKS_MAX;
        [1, 2, 4].into_iter().find(fits).unwrap_or(SCALE_MAX)
    }

    /// The blocks that somebody has not seen who has seen nothing.
    pub(crate) fn unseen(&self) -> Marks {
        if self.is_blank { Marks::none(self.layout) } else { Marks::all(self.layout) }
    }

    /// Has every tile looked at the next time.
    pub(crate) fn forget(&mut self) {
        self.forgets = true;
    }

    /// Takes over what has changed, at every `scale`-th pixel.
    pub(crate) fn refresh(&mut self, scale: u32, tone: &Tone, shown: &mut TileSource<'_>) -> BlockChanges {
        let is_other = std::mem::take(&mut self.is_blank) || scale != self.scale;
        if is_other {
            self.scale = scale;
            self.layout = Layout::new(self.full, scale);
            self.rgb.resize(self.layout.size[0] as usize * self.layout.size[1] as usize, [0; 3]);
        }
        let forgets = std::mem::take(&mut self.forgets) || is_other;
        let mut marks = Marks::none(self.layout);
        let [columns, rows] = self.full.map(|side| side.div_ceil(TILE_SIDE));
        for tile in 0..columns * rows {
            if (shown.has_changed)(tile) || forgets {
                let first = [tile % columns * TILE_SIDE, tile / columns * TILE_SIDE];
                if self.refresh_tile(first, tone, shown.show) {
                    marks.set(self.layout.block_of(first.map(|x| x / scale)));
                }
            }
        }
        if is_other { BlockChanges::All } else { BlockChanges::Some(marks) }
    }

    /// Takes over the tile that begins at `first`; true when any byte has changed.
    fn refresh_tile(&mut self, first: [u32; 2], tone: &Tone, show: &Show<'_>) -> bool {
        let width = TILE_SIDE.min(self.full[0] - first[0]) as usize;
        let rows = first[1]..self.full[1].min(first[1] + TILE_SIDE);
        let scale = self.scale as usize;
        let mut has_changed = false;
        for y in rows.step_by(scale) {
            let mut radiances = [[0.0; 3]; TILE_SIDE as usize];
            show([first[0], y], &mut radiances[..width]);
            let at = y as usize / scale * self.layout.size[0] as usize + first[0] as usize / scale;
            for (old, radiance) in self.rgb[at..].iter_mut().zip(radiances[..width].iter().step_by(scale)) {
                let new = tone.pixel(*radiance);
                has_changed |= *old != new;
                *old = new;
            }
        }
        has_changed
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::Cell;

    /// A picture whose tiles have values that a test sets.
    struct Source {
        columns: u32,
        values: Vec<f32>,
        changed: Vec<bool>,
        looked: Cell<u32>,
    }

    impl Source {
        fn new(size: [u32; 2]) -> Source {
            let columns = size[0].div_ceil(8);
            let count = (columns * size[1].div_ceil(8)) as usize;
            Source { columns, values: vec![0.0; count], changed: vec![false; count], looked: Cell::new(0) }
        }

        fn set(&mut self, tile: usize, value: f32) {
            (self.values[tile], self.changed[tile]) = (value, true);
        }

        fn refresh(&mut self, picture: &mut Picture, scale: u32) -> BlockChanges {
            let show = |[x, y]: [u32; 2], radiances: &mut [[f32; 3]]| {
                self.looked.set(self.looked.get() + 1);
                radiances.fill([self.values[(y / 8 * self.columns + x / 8) as usize]; 3]);
            };
            let mut has_changed = |tile: u32| std::mem::take(&mut self.changed[tile as usize]);
            let mut shown = TileSource { has_changed: &mut has_changed, show: &show };
            picture.refresh(scale, &Tone::new(1.0), &mut shown)
        }
    }

    fn taken(changed: BlockChanges) -> Vec<u16> {
        let BlockChanges::Some(mut marks) = changed else { panic!("all of them") };
        let mut taken = vec![];
        marks.take(usize::MAX, &mut taken);
        taken
    }

    #[test]
    fn blocks_are_marked_whose_bytes_have_changed() {
        let size = [100, 50];
        let (mut source, mut picture) = (Source::new(size), Picture::new(size));
        assert!(picture.unseen().is_empty());
        assert_eq!(source.refresh(&mut picture, 1), BlockChanges::All);
        assert_eq!(picture.unseen(), Marks::all(picture.layout));
        let looked = source.looked.get();
        assert_eq!(taken(source.refresh(&mut picture, 1)), [0; 0]);
        assert_eq!(source.looked.get(), looked);
        // 13 tiles and 7 blocks in a row: the tile at (96, 8) is in the last block of the first row.
        source.set(13 + 12, 1.0);
        source.set(0, 0.0);
        assert_eq!(taken(source.refresh(&mut picture, 1)), [6]);
        assert_eq!((picture.rgb[8 * 100 + 99], picture.rgb[8 * 100 + 95]), ([255; 3], [0; 3]));
        assert_eq!(source.looked.get(), looked + 16);
    }

    #[test]
    fn another_scale_is_another_picture() {
        let size = [100, 50];
        let (mut source, mut picture) = (Source::new(size), Picture::new(size));
        source.set(12, 1.0);
        assert_eq!(source.refresh(&mut picture, 4), BlockChanges::All);
        assert_eq!((picture.layout.size, picture.rgb.len()), ([25, 13], 25 * 13));
        assert_eq!((picture.rgb[24], picture.rgb[23], picture.rgb[49]), ([255; 3], [0; 3], [255; 3]));
        source.set(12, 0.0);
        assert_eq!(taken(source.refresh(&mut picture, 4)), [1]);
        assert_eq!(source.refresh(&mut picture, 1), BlockChanges::All);
        assert_eq!(picture.rgb.len(), 5000);
    }

    #[test]
    fn pictures_of_any_size_have_numbers_for_their_blocks() {
        for (size, scale) in [([1280, 720], 1), ([5120, 2880], 1), ([8192, 8192], 4), ([16384, 16384], 8)] {
            assert_eq!(Picture::least_scale(size), scale, "{size:?}");
        }
    }
}
