//! The adapters of this machine: what there is, what each allows, and which is meant by a name.
//!
//! Invariants: 1. `auto` takes hardware alone: a software adapter is the processor by a longer way; 2. the order of
//! adapters is that of the system, hardware first.

use trex_store::{Code, Error, NextStep, Result};

/// Storage buffers that the kernels bind.
pub(crate) const STORAGE_BUFFERS: u32 = 8;
/// Invocations of a workgroup.
const WORKGROUP_SIDE: u32 = 64;

/// Which adapter is meant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DeviceQuery<'a> {
    /// The first that is hardware.
    Hardware,
    /// The first that is hardware, else one in software.
    Any,
    /// The first whose name holds these words, whatever their case.
    Name(&'a str),
}

/// What is known of an adapter before it is opened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct AdapterReport {
    /// Its name.
    pub name: String,
    /// Name and version of its driver.
    pub driver: String,
    /// False for one in software.
    pub is_hardware: bool,
    /// Most bytes of one binding: of the bitmaps of an octree, and of the units in video memory.
    pub binding_bytes: u64,
    /// Most bytes of one buffer.
    pub buffer_bytes: u64,
    /// Storage buffers that a kernel may bind.
    pub storage_buffers: u32,
    /// True when it can tell how long kernels take.
    pub has_timestamps: bool,
    /// Why it cannot be used; `None` where it can.
    pub refusal: Option<String>,
}

impl AdapterReport {
    fn of(adapter: &wgpu::Adapter) -> AdapterReport {
        let (info, limits) = (adapter.get_info(), adapter.limits());
        let storage_buffers = limits.max_storage_buffers_per_shader_stage;
        let least = wgpu::Limits::default();
        let refusal = if storage_buffers < STORAGE_BUFFERS {
            Some(format!("{storage_buffers} storage buffers a kernel, {STORAGE_BUFFERS} needed"))
        } else if limits.max_compute_workgroup_size_x < WORKGROUP_SIDE {
            Some(format!(
                "{} invocations in a row, {WORKGROUP_SIDE} needed",
                limits.max_compute_workgroup_size_x
            ))
        } else if !least.check_limits(&limits) {
            Some("its limits are below those that WebGPU grants everywhere".to_owned())
        } else {
            None
        };
        AdapterReport {
            name: info.name,
            driver: [info.driver, info.driver_info].join(" ").trim().to_owned(),
            is_hardware: info.device_type != wgpu::DeviceType::Cpu,
            binding_bytes: limits.max_storage_buffer_binding_size,
            buffer_bytes: limits.max_buffer_size,
            storage_buffers,
            has_timestamps: adapter.features().contains(wgpu::Features::TIMESTAMP_QUERY),
            refusal,
        }
    }

    /// What is at fault where no adapter is found: the most frequent reasons on servers.
    const NONE_WHY: &str =
        "no Vulkan adapter; often libvulkan1, the driver's ICD file or /dev/dri is missing";
}

/// The adapters, hardware first.
pub fn adapters() -> Vec<AdapterReport> {
    found().iter().map(|(_, report)| report.clone()).collect()
}

fn found() -> Vec<(wgpu::Adapter, AdapterReport)> {
    let backends = wgpu::Backends::VULKAN;
    let descriptor =
        wgpu::InstanceDescriptor { backends, ..wgpu::InstanceDescriptor::new_without_display_handle() };
    let instance = wgpu::Instance::new(descriptor);
    let adapters = pollster::block_on(instance.enumerate_adapters(backends));
    let mut all: Vec<_> =
        adapters.into_iter().map(|adapter| (AdapterReport::of(&adapter), adapter)).collect();
    all.sort_by_key(|(report, _)| !report.is_hardware);
    all.into_iter().map(|(report, adapter)| (adapter, report)).collect()
}

/// True when the system shows a GPU in hardware: a render node, NVIDIA's device, or that of a guest of Windows. Where
/// none is, no driver need be loaded to know that: those in software write to stderr, and take time.
fn has_hardware_node() -> bool {
    let is_render_node =
        |entry: std::fs::DirEntry| entry.file_name().to_string_lossy().starts_with("renderD");
    ["/dev/nvidiactl", "/dev/dxg"].iter().any(|node| std::path::Path::new(node).exists())
        || std::fs::read_dir("/dev/dri").is_ok_and(|nodes| nodes.flatten().any(is_render_node))
}

/// The adapter that is meant.
///
/// # Errors
/// [`Code::NoAdapter`] with those that there are.
pub(crate) fn choose(query: DeviceQuery<'_>) -> Result<(wgpu::Adapter, AdapterReport)> {
    let all = if query != DeviceQuery::Hardware || has_hardware_node() { found() } else { Vec::new() };
    let is_meant = |report: &AdapterReport| match query {
        DeviceQuery::Hardware => report.is_hardware,
        DeviceQuery::Any => true,
        DeviceQuery::Name(name) => report.name.to_lowercase().contains(&name.to_lowercase()),
    };
    let mut refused = Vec::new();
    let mut names = Vec::new();
    for (adapter, report) in all {
        names.push(report.name.clone());
        match (is_meant(&report), &report.refusal) {
            (true, None) => return Ok((adapter, report)),
            (true, Some(why)) => refused.push(format!("{}: {why}", report.name)),
            (false, _) => {}
        }
    }
    let place = match query {
        DeviceQuery::Hardware => "the hardware GPUs of this machine".to_owned(),
        DeviceQuery::Any => "the GPUs of this machine".to_owned(),
        DeviceQuery::Name(name) => format!("the device {name:?}"),
    };
    let numbers = match (refused.as_slice(), names.as_slice()) {
        ([_, ..], _) => refused.join("; "),
        ([], []) => AdapterReport::NONE_WHY.to_owned(),
        ([], [..]) => format!("there are: {}", names.join(", ")),
    };
    Err(Error::new(Code::NoAdapter, "no such device can be used")
        .at_place(place)
        .numbers(numbers)
        .next(NextStep::OtherDevice))
}
