//! Photons: how they fly through mesh and voxels, and what keeps the light that they bring.

pub(crate) mod bake;
pub(crate) mod irradiance;
pub(crate) mod kd_tree;
pub(crate) mod mesh;
pub(crate) mod trace;
pub(crate) mod tracers;
pub(crate) mod voxel;
