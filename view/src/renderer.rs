//! What a live session shows, as the picture takes it over.

use crate::picture::TileSource;
use trex_render::{LiveSession, PagedTracer, TILE_SIDE_PIXELS, TileStamp};

/// What the session said of each tile when it was looked at last.
#[derive(Debug, Default)]
pub(crate) struct Stamps {
    stamps: Vec<Option<TileStamp>>,
}

impl Stamps {
    /// Bytes of the stamps of a picture of `full` pixels.
    pub(crate) fn bytes(full: [u32; 2]) -> u64 {
        let [columns, rows] = full.map(|side| u64::from(side.div_ceil(TILE_SIDE_PIXELS)));
        columns * rows * size_of::<Option<TileStamp>>() as u64
    }

    /// Gives what `session` shows to `then`.
    pub(crate) fn with_shown<T: PagedTracer + Send, R>(
        &mut self,
        session: &LiveSession<T>,
        then: impl FnOnce(&mut TileSource<'_>) -> R,
    ) -> R {
        let full = session.view().settings.resolution;
        let count = full.iter().map(|side| side.div_ceil(TILE_SIDE_PIXELS) as usize).product();
        if self.stamps.len() != count {
            // Exactly so many are leased.
            self.stamps = vec![None; count];
        }
        let mut has_changed = |tile: u32| {
            let stamp = Some(session.tile_stamp(tile));
            std::mem::replace(&mut self.stamps[tile as usize], stamp) != stamp
        };
        let show = |first: [u32; 2], radiances: &mut [[f32; 3]]| session.show(first, radiances);
        then(&mut TileSource { has_changed: &mut has_changed, show: &show })
    }
}
