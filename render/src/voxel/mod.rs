//! G-rays on the voxel octree: what the CPU does, and the twin of each shader to come. Paper, section 5.

mod batch;
mod g_ray;
mod leaf;
mod lower;
mod lower_batch;
#[cfg(target_arch = "x86_64")]
mod simd;
mod steps;
mod traverse;
mod voxels;

pub use batch::PacketWidth;
pub use g_ray::{GAnswer, GKind, GRay};
pub(crate) use leaf::{LeafHit, VoxelSurface};
pub use lower::{LowerHit, LowerLeaf, LowerScene, MissingUnits};
pub use traverse::{Occluders, VoxelHit, VoxelScene};
pub use voxels::Voxels;
