//! Flags of verbs whose G-rays a GPU may answer.

use crate::values::{self, GpuMemoryLimit};
use clap::Args;
use trex_model::{Device, DeviceOptions};

/// Which device answers the rays that ask the voxels.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Device options")]
pub struct DeviceArgs {
    /// What answers rays through the voxels: cpu, gpu, a part of a GPU's name, or auto = a GPU in hardware if there
    /// is one [default: cpu: the same bytes everywhere, and pictures sooner (docs/gpu.md)]
    #[arg(long, value_name = "DEVICE", value_parser = values::device)]
    pub device: Option<Device>,
    /// Most video memory to take: an amount (512MiB), or auto = 2GiB, of a GPU in software a quarter of --memory-limit,
    /// whose memory is this process's [default: auto]
    #[arg(long, value_name = "LIMIT", value_parser = values::gpu_memory_limit)]
    pub gpu_memory_limit: Option<GpuMemoryLimit>,
}

impl DeviceArgs {
    /// The library's form.
    pub fn options(&self) -> DeviceOptions {
        DeviceOptions {
            device: self.device.clone().unwrap_or_default(),
            gpu_memory_limit_bytes: self.gpu_memory_limit.and_then(|limit| limit.0),
        }
    }
}
