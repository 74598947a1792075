//! trex-gpu: the G-stage on a GPU: its rays answered by compute shaders, on the octree in video memory. Paper,
//! section 5.1.
//!
//! Life of a batch: a worker of the renderer hands a [`trex_render::GCall`] to [`GpuStage`]; its rays are packed,
//! shadow rays first, and sent to the thread that owns the device's queue. That thread writes them to one of a few
//! slots, has `shadow_rays` and `surface_rays` answer them, reads the words back, and puts the answers where the rays
//! were. What the device cannot answer, the processor does ([`trex_render::CpuStage`]): rays in units that are not in
//! video memory, and all rays once the device is lost.
//!
//! ```text
//! words     rays, answers and parameters as shaders see them
//! adapters  what there is, and which of it is meant
//! device    an opened adapter: limits, ledger of video memory, whether it is lost, counters
//! kernels   the shaders and their pipelines
//! octree    the octree in video memory
//! packing   rays of a call to words and back
//! units     pages of units in video memory
//! slots     buffers of the batches under way
//! worker    the thread between stage and device
//! stage     the stage
//! ```
//!
//! Each file imports those before it alone. This crate is the only one that names wgpu.
//!
//! Invariants: 1. an answer is that of the processor's walk, but where rounding differs: then the ray passes within a
//! subvoxel of what the other met; 2. video memory is counted against its limit before it is taken; 3. nothing waits
//! without a bound: a device that does not answer in time counts as lost, and the processor goes on.

mod adapters;
mod device;
mod kernels;
mod octree;
mod packing;
mod slots;
mod stage;
mod units;
mod words;
mod worker;

pub use adapters::{AdapterReport, DeviceQuery, adapters};
pub use device::{GpuCounts, GpuDevice, GpuOptions};
pub use kernels::StepCounts;
pub use stage::{GpuStage, WhenTooLarge};
