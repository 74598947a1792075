//! Other people's ray tracers. Each needs a library of the system and stands behind a feature of its own.

#[cfg(feature = "peer-embree")]
pub(crate) mod embree;
