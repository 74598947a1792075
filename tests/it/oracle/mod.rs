//! Oracles: plain and slow, sharing no code with what they test.

pub(crate) mod exact;
pub(crate) mod mesh;
pub(crate) mod overlap;
pub(crate) mod pictures;
