//! The picture: film and tiles, the order of tiles, the filter, and the files that it is encoded to.

pub(crate) mod coarse;
pub(crate) mod display;
pub(crate) mod encode;
pub(crate) mod film;
pub(crate) mod filter;
pub(crate) mod packed;
pub(crate) mod saliency;
pub(crate) mod tile;

#[cfg(test)]
mod tests;
