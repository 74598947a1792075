//! SIMD of G-rays: packets of lanes, and the machines that they run on.

pub(super) mod avx2;
pub(super) mod avx512;
mod packet;

pub(super) use packet::{Queue, fits};
