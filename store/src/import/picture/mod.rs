//! `Picture`: a PNG or JPEG file as the colours that vertices take from it.
//!
//! ```text
//! file -> decode.rs -> rows of bytes -> Shrinker: linear, boxes of texels averaged -> VertexCache -> colour at (u, v)
//! ```
//!
//! A picture is shrunk until no side is longer than 1,024 texels: a vertex stands for the surface around it, and no
//! mesh has a vertex for each texel of a larger one.
//!
//! Invariants: 1. memory is leased before it is taken, and what texels take beyond their cache goes to scratch; 2. the
//! colours depend on the file alone, not on the memory limit; 3. a file that is no picture is no error of the model: it
//! comes back as words.

mod decode;
#[cfg(test)]
mod tests;
mod texels;

pub(super) use decode::read;
pub(super) use texels::{CoarseCount, Picture, PictureFault, Wrap};
