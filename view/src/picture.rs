//! `Picture`: what clients are shown, in 8 bits: the whole picture, or every so many pixels of it while it moves.
//!
//! Invariants: 1. only tiles whose stamp has changed are looked at, and only blocks whose bytes have changed are marked;
//! 2. its memory does not grow after [`Picture::new`]; 3. `frame` grows with each change.

use crate::blocks::{BLOCK_SIDE, BLOCKS_MAX, Layout, Marks};
use crate::tone::Tone;
use std::sync::Arc;

/// Side of a tile of the renderer, pixels.
const TILE_SIDE: u32 = trex_render::TILE_SIDE_PIXELS;
/// Pixels from one that is sent to the next: the largest.
pub(crate) const SCALE_MAX: u32 = 8;

const _: () = assert!(BLOCK_SIDE.is_multiple_of(TILE_SIDE) && TILE_SIDE.is_multiple_of(SCALE_MAX));

/// Bits of the flags of a frame.
pub(crate) mod flag {
    /// Some of it is a preview.
    pub(crate) const PREVIEW: u8 = 1;
    /// It is one of many that follow each other fast.
    pub(crate) const MOVING: u8 = 2;
    /// Every pixel has a sample of the present state.
    pub(crate) const COMPLETE: u8 = 4;
    /// It will not change by itself any more.
    pub(crate) const DONE: u8 = 8;
}

/// A PNG of the settled picture.
#[derive(Clone, Debug)]
pub(crate) struct Settled {
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
    /// See [`flag`].
    pub(crate) flags: u8,
    /// The same without loss, once it stands still.
    pub(crate) settled: Option<Settled>,
    /// What the renderer said of each tile when it was looked at.
    stamps: Vec<u64>,
}

/// The blocks that have changed.
#[derive(Debug, PartialEq, Eq)]
pub(crate) enum Changed {
    /// These.
    Some(Marks),
    /// All of them: there are others than before.
    All,
}

/// What the renderer shows: a stamp for each tile, which changes when what it shows does, and radiances of pixels of one
/// row of one tile, from the first on.
pub(crate) struct Shown<'a> {
    pub(crate) stamp: &'a dyn Fn(u32) -> u64,
    pub(crate) show: &'a dyn Fn([u32; 2], &mut [[f32; 3]]),
}

impl Picture {
    /// Bytes of a picture of `full` pixels.
    pub(crate) fn bytes([width, height]: [u32; 2]) -> u64 {
        let tiles = u64::from(width.div_ceil(TILE_SIDE)) * u64::from(height.div_ceil(TILE_SIDE));
        u64::from(width) * u64::from(height) * 3 + tiles * 8
    }

    /// A black picture of `full` pixels.
    pub(crate) fn new(full: [u32; 2]) -> Picture {
        let scale = Picture::least_scale(full);
        let layout = Layout::new(full, scale);
        let tiles = full.map(|side| side.div_ceil(TILE_SIDE) as usize);
        let mut rgb = Vec::with_capacity(full[0] as usize * full[1] as usize);
        rgb.resize(layout.size[0] as usize * layout.size[1] as usize, [0; 3]);
        let stamps = vec![u64::MAX; tiles[0] * tiles[1]];
        Picture { full, scale, layout, rgb, frame: 0, seq: 0, flags: 0, settled: None, stamps }
    }

    /// The smallest scale at which blocks can be numbered.
    pub(crate) fn least_scale(full: [u32; 2]) -> u32 {
        let fits = |scale: &u32| Layout::new(full, *scale).count() <= BLOCKS_MAX;
        [1, 2, 4].into_iter().find(fits).unwrap_or(SCALE_MAX)
    }

    /// Has every tile looked at the next time.
    pub(crate) fn forget_stamps(&mut self) {
        self.stamps.fill(u64::MAX);
    }

    /// Takes over what has changed, at every `scale`-th pixel.
    pub(crate) fn refresh(&mut self, scale: u32, tone: &Tone, shown: &Shown<'_>) -> Changed {
        let is_other = scale != self.scale;
        if is_other {
            self.scale = scale;
            self.layout = Layout::new(self.full, scale);
            self.rgb.resize(self.layout.size[0] as usize * self.layout.size[1] as usize, [0; 3]);
            self.forget_stamps();
        }
        let mut marks = Marks::none(self.layout);
        let columns = self.full[0].div_ceil(TILE_SIDE);
        for tile in 0..self.stamps.len() as u32 {
            let stamp = (shown.stamp)(tile);
            if std::mem::replace(&mut self.stamps[tile as usize], stamp) != stamp {
                let first = [tile % columns * TILE_SIDE, tile / columns * TILE_SIDE];
                if self.refresh_tile(first, tone, shown) {
                    marks.set(self.layout.block_of(first.map(|x| x / scale)));
                }
            }
        }
        if is_other { Changed::All } else { Changed::Some(marks) }
    }

    /// Takes over the tile that begins at `first`; true when any byte has changed.
    fn refresh_tile(&mut self, first: [u32; 2], tone: &Tone, shown: &Shown<'_>) -> bool {
        let width = TILE_SIDE.min(self.full[0] - first[0]) as usize;
        let rows = first[1]..self.full[1].min(first[1] + TILE_SIDE);
        let scale = self.scale as usize;
        let mut has_changed = false;
        for y in rows.step_by(scale) {
            let mut radiances = [[0.0; 3]; TILE_SIDE as usize];
            (shown.show)([first[0], y], &mut radiances[..width]);
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
    use std::cell::{Cell, RefCell};

    /// A picture whose tiles have values and stamps that a test sets.
    struct Source {
        columns: u32,
        values: RefCell<Vec<f32>>,
        stamps: RefCell<Vec<u64>>,
        looked: Cell<u32>,
    }

    impl Source {
        fn new(size: [u32; 2]) -> Source {
            let columns = size[0].div_ceil(8);
            let count = (columns * size[1].div_ceil(8)) as usize;
            let (values, stamps) = (RefCell::new(vec![0.0; count]), RefCell::new(vec![0; count]));
            Source { columns, values, stamps, looked: Cell::new(0) }
        }

        fn set(&self, tile: usize, value: f32) {
            self.values.borrow_mut()[tile] = value;
            self.stamps.borrow_mut()[tile] += 1;
        }

        fn refresh(&self, picture: &mut Picture, scale: u32) -> Changed {
            let show = |[x, y]: [u32; 2], radiances: &mut [[f32; 3]]| {
                self.looked.set(self.looked.get() + 1);
                radiances.fill([self.values.borrow()[(y / 8 * self.columns + x / 8) as usize]; 3]);
            };
            let stamp = |tile: u32| self.stamps.borrow()[tile as usize];
            picture.refresh(scale, &Tone::new(1.0), &Shown { stamp: &stamp, show: &show })
        }
    }

    fn taken(changed: Changed) -> Vec<u16> {
        let Changed::Some(mut marks) = changed else { panic!("all of them") };
        let mut taken = vec![];
        marks.take(usize::MAX, &mut taken);
        taken
    }

    #[test]
    fn blocks_are_marked_whose_bytes_have_changed() {
        let size = [100, 50];
        let (source, mut picture) = (Source::new(size), Picture::new(size));
        assert_eq!(taken(source.refresh(&mut picture, 1)), [0; 0]);
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
        let (source, mut picture) = (Source::new(size), Picture::new(size));
        source.set(12, 1.0);
        assert_eq!(source.refresh(&mut picture, 4), Changed::All);
        assert_eq!((picture.layout.size, picture.rgb.len()), ([25, 13], 25 * 13));
        assert_eq!((picture.rgb[24], picture.rgb[23], picture.rgb[49]), ([255; 3], [0; 3], [255; 3]));
        source.set(12, 0.0);
        assert_eq!(taken(source.refresh(&mut picture, 4)), [1]);
        assert_eq!(source.refresh(&mut picture, 1), Changed::All);
        assert_eq!(picture.rgb.len(), 5000);
    }

    #[test]
    fn pictures_of_any_size_have_numbers_for_their_blocks() {
        for (size, scale) in [([1280, 720], 1), ([5120, 2880], 1), ([8192, 8192], 4), ([16384, 16384], 4)] {
            assert_eq!(Picture::least_scale(size), scale, "{size:?}");
        }
    }
}
