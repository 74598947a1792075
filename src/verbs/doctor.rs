//! `trex doctor`: what this machine offers, what trex will use of it, and why.
//!
//! Invariant: it changes nothing but for a small file that it writes and removes where it is asked to look at a disk.

use crate::args::DoctorArgs;
use crate::context::Context;
use crate::failure::Exit;
use crate::host::HostMemory;
use crate::size;
use serde::Serialize;
use std::fmt;
use std::io::Write;
use std::path::Path;
use trex_render::PacketWidth;
use trex_store::io::{DirectChoice, IoChoice, IoDescription, IoOptions, open};
use trex_store::printable::one_line;
use trex_store::{Error, Result};

/// Bytes of the file that is read to see how disks are read: some blocks.
const PROBE_BYTES: usize = 64 << 10;
/// Bytes of an octree's leaf in the largest of its buffers.
const LEAF_BYTES: u64 = 8;

/// Runs `trex doctor`.
pub fn run(args: &DoctorArgs, ctx: &Context) -> anyhow::Result<Exit> {
    ctx.done(&DoctorReport::new(args, ctx)?)
}

/// What the machine offers.
#[derive(Debug, Serialize)]
struct DoctorReport {
    processor: Processor,
    memory: MemoryLimits,
    disk: DiskOffers,
    gpus: Vec<Gpu>,
    /// What is often missing, and is here.
    hints: Vec<String>,
    uses: Uses,
}

#[derive(Debug, Serialize)]
struct Processor {
    thread_count: usize,
    /// Lanes of rays through the voxels.
    voxel_lanes: &'static str,
    /// Arithmetic of rays on the mesh.
    mesh: &'static str,
}

#[derive(Debug, Serialize)]
struct MemoryLimits {
    installed_bytes: Option<u64>,
    cgroup_limit_bytes: Option<u64>,
    /// In force: `--memory-limit`, or what it is by itself.
    limit_bytes: u64,
}

#[derive(Debug, Serialize)]
struct DiskOffers {
    folder: String,
    uring: Offer,
    direct: Offer,
    /// What is used when nothing is said.
    chosen: IoDescription,
}

/// Whether something works here; if not, why.
#[derive(Debug, Serialize)]
struct Offer {
    works: bool,
    reason: String,
}

#[derive(Debug, Serialize)]
struct Gpu {
    name: String,
    driver: String,
    is_hardware: bool,
    binding_bytes: u64,
    buffer_bytes: u64,
    storage_buffers: u32,
    has_timestamps: bool,
    /// Leaves of the largest octree that it can hold.
    leaves_max: u64,
    /// Why it cannot be used, if so.
    refusal: Option<String>,
}

/// What answers rays through the voxels.
#[derive(Debug, Serialize)]
struct Uses {
    /// Where nothing is said.
    render: String,
    view: String,
    /// With `--device auto`.
    auto: String,
    /// Why `auto` is that.
    reason: String,
}

impl DoctorReport {
    fn new(args: &DoctorArgs, ctx: &Context) -> Result<DoctorReport> {
        let host = HostMemory::detect();
        let gpus = gpus();
        let usable = gpus.iter().find(|gpu| gpu.is_hardware && gpu.refusal.is_none());
        let reason = match (usable, gpus.is_empty()) {
            (Some(_), _) => "the first GPU in hardware that can be used",
            (None, true) if cfg!(feature = "gpu") => "there is no GPU",
            (None, true) => "this build knows no GPUs",
            (None, false) => {
                "no GPU in hardware can be used; one in software is the processor by a longer way"
            }
        };
        let [render, view] = ["cpu", "cpu"].map(str::to_owned);
        let auto = usable.map_or("cpu", |gpu| &gpu.name).to_owned();
        let uses = Uses { render, view, auto, reason: reason.to_owned() };
        let hints = if usable.is_some() { vec![] } else { Surroundings::detect().hints() };
        Ok(DoctorReport {
            processor: Processor {
                thread_count: ctx.threads,
                voxel_lanes: match PacketWidth::widest() {
                    PacketWidth::Sixteen => "avx512",
                    PacketWidth::Eight => "avx2",
                    PacketWidth::One => "scalar",
                },
                mesh: if PacketWidth::Eight.is_available() { "avx2" } else { "scalar" },
            },
            memory: MemoryLimits {
                installed_bytes: host.physical_bytes,
                cgroup_limit_bytes: host.cgroup_limit_bytes,
                limit_bytes: ctx.budget.limit_bytes(),
            },
            disk: DiskOffers::probe(&args.folder)?,
            gpus,
            hints,
            uses,
        })
    }
}

impl DiskOffers {
    /// Reads a small file in `folder` in each way.
    fn probe(folder: &Path) -> Result<DiskOffers> {
        let failed = |doing: &str, error: std::io::Error| Error::writing(doing, folder, &error);
        let mut file =
            tempfile::NamedTempFile::new_in(folder).map_err(|error| failed("make a file", error))?;
        let written = file.write_all(&[0; PROBE_BYTES]).and_then(|()| file.as_file().sync_all());
        written.map_err(|error| failed("write a file", error))?;
        let offer = |io, direct| match open(file.path(), &IoOptions { io, direct, ..IoOptions::default() }) {
            Ok(backend) => Offer { works: true, reason: backend.describe().reason.clone() },
            Err(error) => {
                Offer { works: false, reason: format!("{}: {}", error.what(), error.numbers_text()) }
            }
        };
        Ok(DiskOffers {
            folder: folder.display().to_string(),
            uring: offer(IoChoice::Uring, DirectChoice::Off),
            direct: offer(IoChoice::Pread, DirectChoice::On),
            chosen: open(file.path(), &IoOptions::default())?.describe().clone(),
        })
    }
}

#[cfg(feature = "gpu")]
fn gpus() -> Vec<Gpu> {
    let gpu = |report: trex_gpu::AdapterReport| Gpu {
        leaves_max: report.binding_bytes.min(report.buffer_bytes) / LEAF_BYTES,
        name: report.name,
        driver: report.driver,
        is_hardware: report.is_hardware,
        binding_bytes: report.binding_bytes,
        buffer_bytes: report.buffer_bytes,
        storage_buffers: report.storage_buffers,
        has_timestamps: report.has_timestamps,
        refusal: report.refusal,
    };
    trex_gpu::adapters().into_iter().map(gpu).collect()
}

#[cfg(not(feature = "gpu"))]
fn gpus() -> Vec<Gpu> {
    Vec::new()
}

/// What a Vulkan driver needs, as files say it.
#[derive(Clone, Copy, Debug, Default)]
struct Surroundings {
    has_loader: bool,
    has_driver_files: bool,
    has_render_nodes: bool,
    has_nvidia: bool,
    has_nvidia_driver_file: bool,
    has_nvidia_egl: bool,
    has_mig: bool,
}

impl Surroundings {
    /// Asks the running system.
    fn detect() -> Surroundings {
        let exists = |path: &str| Path::new(path).exists();
        let listed = |folder: &str| -> Vec<String> {
            let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
            entries.map(|entry| entry.file_name().to_string_lossy().into_owned()).collect()
        };
        let libraries =
            ["/usr/lib", "/usr/lib64", "/lib64", "/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu"];
        let drivers = [listed("/usr/share/vulkan/icd.d"), listed("/etc/vulkan/icd.d")].concat();
        Surroundings {
            has_loader: libraries.iter().any(|folder| exists(&format!("{folder}/libvulkan.so.1"))),
            has_driver_files: !drivers.is_empty(),
            has_render_nodes: listed("/dev/dri").iter().any(|name| name.starts_with("renderD")),
            has_nvidia: exists("/dev/nvidiactl") || exists("/proc/driver/nvidia/version"),
            has_nvidia_driver_file: drivers.iter().any(|name| name.contains("nvidia")),
            has_nvidia_egl: ["/usr/share/glvnd/egl_vendor.d", "/etc/glvnd/egl_vendor.d"]
                .iter()
                .any(|folder| listed(folder).iter().any(|name| name.contains("nvidia"))),
            has_mig: listed("/proc/driver/nvidia/capabilities")
                .iter()
                .any(|name| exists(&format!("/proc/driver/nvidia/capabilities/{name}/mig/gi0"))),
        }
    }

    /// What stands between this machine and a GPU in hardware, in words.
    fn hints(self) -> Vec<String> {
        let mut hints = Vec::new();
        let mut hint = |is_so: bool, words: &str| hints.extend(is_so.then(|| words.to_owned()));
        hint(!self.has_loader, "there is no Vulkan loader (libvulkan.so.1): install libvulkan1");
        hint(
            self.has_loader && !self.has_driver_files,
            "no Vulkan driver is announced in /usr/share/vulkan/icd.d or /etc/vulkan/icd.d: install the driver's \
             Vulkan part (mesa-vulkan-drivers, or NVIDIA's libnvidia-gl)",
        );
        hint(
            self.has_nvidia && !self.has_nvidia_driver_file,
            "there is an NVIDIA driver without its Vulkan part: install libnvidia-gl, or in a container ask for the \
             graphics capability (NVIDIA_DRIVER_CAPABILITIES=all)",
        );
        hint(
            self.has_nvidia && !self.has_nvidia_egl,
            "NVIDIA's EGL vendor file (10_nvidia.json in /usr/share/glvnd/egl_vendor.d) is missing: without a display \
             its Vulkan driver needs it",
        );
        let has_all =
            self.has_loader && self.has_driver_files && self.has_nvidia_driver_file && self.has_nvidia_egl;
        hint(
            has_all && self.has_nvidia && !self.has_mig,
            "NVIDIA's Vulkan driver is announced and cannot be loaded, often for want of libraries: install libx11-6, \
             libxext6, libegl1; ldd on its libGLX_nvidia.so.0 names what is missing",
        );
        hint(self.has_mig, "the GPU is divided (MIG): its parts have no Vulkan");
        hint(
            !self.has_nvidia && !self.has_render_nodes,
            "there is no /dev/dri/renderD* and no NVIDIA device: no GPU is there, or the container was not given it",
        );
        hints
    }
}

impl fmt::Display for DoctorReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let DoctorReport { processor, memory, disk, gpus, hints, uses } = self;
        writeln!(
            f,
            "processor: {} threads; rays on the mesh {}, through the voxels {}",
            processor.thread_count, processor.mesh, processor.voxel_lanes
        )?;
        let amount = |bytes: Option<u64>, none: &str| bytes.map_or(none.to_owned(), size::bytes);
        writeln!(
            f,
            "memory: {} installed, control group {}; limit {}",
            amount(memory.installed_bytes, "an unknown amount"),
            amount(memory.cgroup_limit_bytes, "without a limit"),
            size::bytes(memory.limit_bytes)
        )?;
        let yes =
            |offer: &Offer| if offer.works { "works".to_owned() } else { format!("no ({})", offer.reason) };
        writeln!(
            f,
            "disk of {}: io_uring {}; past the page cache {}",
            one_line(&disk.folder),
            yes(&disk.uring),
            yes(&disk.direct)
        )?;
        if gpus.is_empty() {
            writeln!(f, "GPU: none")?;
        }
        for gpu in gpus {
            writeln!(
                f,
                "GPU: {} ({}, {}): {} a binding, so octrees of up to {} leaves; {} storage buffers; {}{}",
                one_line(&gpu.name),
                if gpu.is_hardware { "hardware" } else { "software" },
                one_line(&gpu.driver),
                size::bytes(gpu.binding_bytes),
                size::count(gpu.leaves_max),
                gpu.storage_buffers,
                if gpu.has_timestamps { "timestamps" } else { "no timestamps" },
                gpu.refusal.as_ref().map_or(String::new(), |why| format!("; cannot be used: {why}"))
            )?;
        }
        for hint in hints {
            writeln!(f, "hint: {hint}")?;
        }
        writeln!(f, "pages are read by {}: {}", disk.chosen.backend, disk.chosen.reason)?;
        write!(
            f,
            "rays through the voxels are answered by {}, with --device auto by {}: {}",
            uses.render,
            one_line(&uses.auto),
            uses.reason
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_gap_has_its_hint_and_nothing_else_has() {
        let whole = Surroundings {
            has_loader: true,
            has_driver_files: true,
            has_render_nodes: true,
            has_nvidia: true,
            has_nvidia_driver_file: true,
            has_nvidia_egl: true,
            has_mig: false,
        };
        let none = Surroundings::default();
        for (around, words) in [
            // All is there, and none of it loads.
            (whole, &["libx11-6"][..]),
            (none, &["libvulkan1", "/dev/dri"][..]),
            (Surroundings { has_driver_files: false, ..whole }, &["icd.d"]),
            (Surroundings { has_nvidia_driver_file: false, ..whole }, &["libnvidia-gl"]),
            (Surroundings { has_nvidia_egl: false, ..whole }, &["EGL"]),
            (Surroundings { has_mig: true, ..whole }, &["MIG"]),
        ] {
            let hints = around.hints();
            assert_eq!(hints.len(), words.len(), "{around:?}: {hints:?}");
            for (hint, word) in hints.iter().zip(words) {
                assert!(hint.contains(word), "{around:?}: {hint}");
            }
        }
    }
}
