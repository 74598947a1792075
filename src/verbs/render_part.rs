//! The part of a picture that `trex render --tiles I/N --samples A..B` makes: which one it is, and its file.

use super::picture_file::PictureFile;
use crate::args::RenderArgs;
use serde::Serialize;
use trex_model::{Model, Session, part_head};
use trex_render::{Portion, RenderKeys, tile_count, write_part};
use trex_store::{Code, Error, Result};

/// What is told of a part.
#[derive(Debug, Serialize)]
pub struct PartReport {
    /// Index of the first tile, and of the one behind the last; of how many.
    pub tiles: [u32; 2],
    pub tile_count: u32,
    /// Index of the first sample, and of the one behind the last; of how many.
    pub samples: [u32; 2],
    pub spp: u32,
}

/// The part that is asked for; `None` for a whole picture.
///
/// # Errors
/// [`Code::Usage`] for more shares than there are tiles, and for samples that the picture has not.
pub fn portion(args: &RenderArgs, keys: &RenderKeys) -> Result<Option<Portion>> {
    if args.tiles.is_none() && args.samples.is_none() {
        return Ok(None);
    }
    let mut portion = Portion::whole(keys.resolution, keys.spp);
    if let Some(share) = args.tiles {
        let tiles = tile_count(keys.resolution);
        if share.count > tiles {
            return Err(Error::new(Code::Usage, "there are more shares than tiles")
                .at_place("--tiles")
                .numbers(format!("{} shares of {tiles} tiles of 8x8 pixels", share.count))
                .next(format!("ask for at most {tiles} shares, or for a larger --resolution")));
        }
        portion.tiles = Portion::tiles_of_share(keys.resolution, share.number - 1, share.count);
    }
    if let Some(range) = args.samples {
        if range.end > keys.spp {
            return Err(Error::new(Code::Usage, "the picture has not so many samples")
                .at_place("--samples")
                .numbers(format!("{}..{} of {}", range.first, range.end, keys.spp))
                .next("give the samples of the whole picture with --spp, the same for all parts"));
        }
        portion.samples = [range.first, range.end];
    }
    Ok(Some(portion))
}

/// Writes the part that `session` has rendered.
pub fn write(target: &PictureFile, model: &Model, session: &Session, portion: Portion) -> Result<()> {
    let head = part_head(model, session, portion);
    target.write_with(|writer| write_part(session.film(), &head, writer))
}

impl PartReport {
    /// The part of a picture of such a size and count of samples.
    pub fn of(portion: Portion, resolution: [u32; 2], spp: u32) -> PartReport {
        let Portion { tiles, samples } = portion;
        PartReport { tiles, tile_count: tile_count(resolution), samples, spp }
    }
}
