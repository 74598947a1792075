//! trex-image: pictures read back from PNG and EXR, and compared.
//!
//! ```text
//! reader -> source (position, end, interrupt) -> read_head ------------> Head: size, channels, bytes it will take
//!                                                   |  the caller leases
//!                                                read_picture (png, exr) -> Picture: linear RGB
//! two Pictures -> compare -> Comparison;  -> false_colour -> PNG;  -> flip -> how different they look
//! ```
//!
//! Invariants: 1. a head is read within [`HEAD_BYTES`], whatever the file says; 2. no picture is allocated before
//! its size is bounded and the file is long enough to hold it; 3. [`read_picture`] takes no more than the
//! [`Head`] said; 4. no file is opened here: the caller hands in a reader.

mod compare;
mod exr;
pub mod false_colour;
mod flip;
mod head;
mod png;
mod read;
mod source;

pub use compare::{Comparison, Constants, DEFAULT_EPSILON, DEFAULT_PEAK, Figures, compare};
pub use flip::{flip, flip_bytes, flip_each};
pub use head::{Format, HEAD_BYTES, Head, MAX_SIDE_PIXELS, Origin, Picture};
pub use read::{read_head, read_picture};

#[cfg(test)]
mod tests;
