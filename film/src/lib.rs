//! trex-film: the film of a picture, what is shown of it while it comes, and the files that it is encoded to.
//!
//! ```text
//! samples of a tile -> Film ----------------------> write_png, write_exr
//!                        | where it has none yet
//! samples of a grid -> Display -> what is on show            (the film's light comes into it while samples are few)
//! ```
//!
//! Floors: each imports those above it alone.
//!
//! ```text
//! hash packed lens        numbers by chance; those of a pixel in few bytes; where pixels look
//! rgb_sum                 radiances of a pixel, summed
//! saliency tile portion   what catches the eye; tiles of a picture, and their order; shares of the work on it
//! film                    sums of samples, layers beside them
//! brightness              how bright surfaces are: an exposure
//! filter coarse part      indirect light smoothed; a picture of few samples; sums of a portion, kept in a file
//! display encode merge    the picture on show; PNG and EXR; a picture out of its parts
//! ```
//!
//! This crate knows no rays, no scenes and no files: who gives it samples decides what they are of.

mod brightness;
mod coarse;
mod display;
mod encode;
mod film;
mod filter;
mod hash;
mod lens;
mod light_key;
mod merge;
mod packed;
mod part;
mod portion;
mod rgb_sum;
mod saliency;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod tile;

pub use brightness::Brightness;
pub use coarse::{Reprojection, STEPS, grid_size};
pub use display::{Display, GridPart, KeptLight};
pub use encode::{Image, Strips, encoder_bytes, write_exr, write_exr_strips, write_png, write_png_strips};
pub use film::{Film, LayerPixel, Layers, NO_ID, film_bytes, portion_bytes};
pub use filter::{filter_bytes, smooth};
pub use hash::{chances, mix};
pub use lens::Lens;
pub use light_key::{LightKey, LightPlace};
pub use merge::{MergeSetup, MergedStrips, PartFile, merge_bytes};
pub use packed::PackedLight;
pub use part::{CAMERA_NUMBERS, PART_MAGIC, PART_VERSION, PartDifference, PartHead, digest, write_part};
pub use portion::{Misfit, Portion, misfit};
pub use saliency::{ReducedPicture, Saliency};
pub use tile::{TILE_SIDE_PIXELS, Tile, TileOrder, Tiles, tile, tile_count};
