//! SIMD of G-rays: packets of lanes, and the machines that they run on.

pub(super) mod avx2;
pub(super) mod avx512;
mod lower;
mod packet;
mod upper;

pub(super) use lower::{LowerQueue, Outcome};
pub(super) use packet::fits;
pub(super) use upper::UpperQueue;
