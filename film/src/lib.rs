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
//! saliency tile           what catches the eye; parts of a picture, and their order
//! film                    sums of samples, layers beside them
//! filter coarse           indirect light smoothed; a picture of few samples
//! display encode          the picture on show; PNG and EXR
//! ```
//!
//! This crate knows no rays, no scenes and no files: who gives it samples decides what they are of.

mod coarse;
mod display;
mod encode;
mod film;
mod filter;
mod hash;
mod lens;
mod packed;
mod rgb_sum;
mod saliency;
#[cfg(test)]
mod testing;
#[cfg(test)]
mod tests;
mod tile;

pub use coarse::{STEPS, grid_size};
pub use display::Display;
pub use encode::{Image, encoder_bytes, write_exr, write_png};
pub use film::{Film, LayerPixel, Layers, NO_ID, film_bytes};
pub use filter::{filter_bytes, smooth};
pub use hash::{chances, mix};
pub use lens::{Eye, Lens};
pub use packed::PackedLight;
pub use saliency::{ReducedPicture, Saliency};
pub use tile::{TILE_SIDE_PIXELS, Tile, TileOrder, Tiles, tile, tile_count};
