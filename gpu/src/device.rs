//! `GpuDevice`: an adapter that was opened: queue, limits, the ledger of its memory, whether it is lost, and counters.
//!
//! Invariants: 1. what is taken of video memory was leased before, from the ledger of its limit, and on a software
//! adapter, whose memory is the process's, from the process's ledger, too; 2. once lost, it stays lost; why is told
//! once.

use crate::adapters::{AdapterReport, DeviceQuery, choose};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};
use trex_store::{Budget, Code, Error, Lease, NextStep, RESERVE_BYTES, Result};

/// Bytes of host memory that the driver takes for a device with these kernels, beside what is asked of it: 92 MiB
/// measured with Mesa's llvmpipe on two cores, most of it for its compiler (`docs/gpu.md`).
const DRIVER_BYTES: u64 = 128 << 20;
/// Limit of video memory that is not named, of a hardware adapter: what devices of ten years have. Drivers do not
/// say, through Vulkan's portable part, how much of their memory is free.
const HARDWARE_LIMIT_BYTES: u64 = 2 << 30;
/// Share of the process's memory limit that is the video memory of a software adapter where no limit is named.
const SOFTWARE_SHARE: u64 = 4;
/// Between two looks at what the device has done: first, and at most.
const PAUSE_LEAST: Duration = Duration::from_micros(20);
const PAUSE_MOST: Duration = Duration::from_micros(200);

/// How a device is opened.
#[derive(Clone, Debug)]
pub struct GpuOptions {
    /// Most bytes of video memory; `None`: 2 GiB of a hardware adapter, a quarter of the process's limit of one in
    /// software.
    pub memory_limit_bytes: Option<u64>,
    /// The ledger of the process's memory.
    pub budget: Budget,
}

/// What a device has done.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct GpuCounts {
    /// Rays that it has answered.
    pub rays: u64,
    /// Rays that the processor has answered in its place.
    pub processor_rays: u64,
    /// Batches that it was given.
    pub batches: u64,
    /// Bytes of rays, octrees and units that went to it.
    pub uploaded_bytes: u64,
    /// Bytes of answers that came back.
    pub read_back_bytes: u64,
    /// Pages of units that went to it.
    pub unit_uploads: u64,
    /// Pages of units that gave way to others.
    pub unit_evictions: u64,
    /// Steps of all walks, of stages that count them ([`crate::StepCounts`]).
    pub steps: u64,
    /// Time of the kernel of shadow rays, ns; 0 of a device without timestamps.
    pub shadow_ns: u64,
    /// Time of the kernel of all other rays, ns.
    pub surface_ns: u64,
}

/// [`GpuCounts`], counted by several threads.
#[derive(Debug, Default)]
pub(crate) struct Counters {
    pub(crate) rays: AtomicU64,
    pub(crate) processor_rays: AtomicU64,
    pub(crate) batches: AtomicU64,
    pub(crate) uploaded_bytes: AtomicU64,
    pub(crate) read_back_bytes: AtomicU64,
    pub(crate) unit_uploads: AtomicU64,
    pub(crate) unit_evictions: AtomicU64,
    pub(crate) steps: AtomicU64,
    pub(crate) shadow_ns: AtomicU64,
    pub(crate) surface_ns: AtomicU64,
}

/// Adds to a counter.
pub(crate) fn count(counter: &AtomicU64, by: u64) {
    counter.fetch_add(by, Ordering::Relaxed);
}

/// Whether a device is lost, and why.
#[derive(Debug, Default)]
struct Loss {
    is_lost: AtomicBool,
    why: OnceLock<String>,
}

impl Loss {
    fn note(&self, why: &str) {
        let _ = self.why.set(why.to_owned());
        self.is_lost.store(true, Ordering::Release);
    }
}

/// A device.
#[derive(Debug)]
pub struct GpuDevice {
    report: AdapterReport,
    pub(crate) device: wgpu::Device,
    pub(crate) queue: wgpu::Queue,
    loss: Arc<Loss>,
    pub(crate) counters: Counters,
    notice: OnceLock<String>,
    memory: Budget,
    /// Of the process's ledger: what the driver takes, and the video memory of a software adapter.
    lease: Lease,
}

/// Bytes of video memory that are leased.
#[derive(Debug)]
pub(crate) struct VideoLease(#[expect(dead_code, reason = "held for its drop")] Lease);

impl GpuDevice {
    /// Opens the adapter that is meant.
    ///
    /// # Errors
    /// [`Code::NoAdapter`]; [`Code::MemoryLimit`] where the process's limit has no room for the driver.
    pub fn open(query: DeviceQuery<'_>, options: &GpuOptions) -> Result<GpuDevice> {
        let (adapter, report) = choose(query)?;
        let limit = options.memory_limit_bytes.unwrap_or(match report.is_hardware {
            true => HARDWARE_LIMIT_BYTES,
            false => options.budget.limit_bytes() / SOFTWARE_SHARE,
        });
        let taken_here = DRIVER_BYTES + if report.is_hardware { 0 } else { limit };
        let lease = options.budget.lease("the driver of the GPU", taken_here)?;
        let limits = wgpu::Limits {
            max_storage_buffer_binding_size: report.binding_bytes,
            max_buffer_size: report.buffer_bytes,
            ..wgpu::Limits::default()
        };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("trex"),
            required_features: adapter.features() & wgpu::Features::TIMESTAMP_QUERY,
            required_limits: limits,
            ..wgpu::DeviceDescriptor::default()
        };
        let refused = |error: &dyn std::fmt::Display| {
            Error::new(Code::NoAdapter, "the device cannot be opened")
                .at_place(format!("the device {:?}", report.name))
                .numbers(error.to_string())
                .next(NextStep::OtherDevice)
        };
        let (device, queue) =
            pollster::block_on(adapter.request_device(&descriptor)).map_err(|error| refused(&error))?;
        let loss = Arc::<Loss>::default();
        let (told, uncaught) = (loss.clone(), loss.clone());
        device.set_device_lost_callback(move |reason, why| told.note(&format!("{reason:?}: {why}")));
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| uncaught.note(&error.to_string())));
        // Its own reserve is none of a GPU's.
        let memory = Budget::new(limit.saturating_add(RESERVE_BYTES));
        Ok(GpuDevice {
            report,
            device,
            queue,
            loss,
            counters: Counters::default(),
            notice: OnceLock::new(),
            memory,
            lease,
        })
    }

    /// What it is.
    pub fn report(&self) -> &AdapterReport {
        &self.report
    }

    /// Most bytes of video memory.
    pub fn memory_limit_bytes(&self) -> u64 {
        self.memory.ledger_bytes()
    }

    /// Bytes of video memory that are leased.
    pub fn memory_used_bytes(&self) -> u64 {
        self.memory.used_bytes()
    }

    /// Bytes of the process's memory that are leased for it.
    pub fn leased_bytes(&self) -> u64 {
        self.lease.bytes()
    }

    /// Why it is lost; `None` while it works.
    pub fn lost(&self) -> Option<&str> {
        let is_lost = self.loss.is_lost.load(Ordering::Acquire);
        is_lost.then(|| self.loss.why.get().map_or("it gave no reason", String::as_str))
    }

    /// Looks at the device until `is_done`, or it is lost; so long at most. False when the time is up. Not by wgpu's
    /// own wait for a submission: it panicked (30.0.2, software adapter) where the queue ran empty while it looked.
    ///
    /// # Errors
    /// Those of wgpu.
    pub(crate) fn poll_until(
        &self,
        longest: Duration,
        mut is_done: impl FnMut() -> bool,
    ) -> std::result::Result<bool, wgpu::PollError> {
        let (begin, mut pause) = (Instant::now(), PAUSE_LEAST);
        loop {
            self.device.poll(wgpu::PollType::Poll)?;
            if is_done() || self.lost().is_some() {
                return Ok(true);
            }
            if begin.elapsed() >= longest {
                return Ok(false);
            }
            std::thread::sleep(pause);
            pause = PAUSE_MOST.min(2 * pause);
        }
    }

    /// Gives it up, as a driver does whose hardware hangs: the processor answers from then on.
    pub fn destroy(&self) {
        self.loss.note("it was destroyed");
        self.device.destroy();
    }

    /// Notes why the processor answers although the device works; the first reason stays.
    pub(crate) fn note(&self, why: &Error) {
        let _ = self.notice.set(format!("{}: {}", why.what(), why.numbers_text()));
    }

    /// Why the processor answers, where it does: the device is lost, or has no room for the octree.
    pub fn notice(&self) -> Option<String> {
        let lost = self.lost().map(|why| format!("the device is lost ({why})"));
        lost.or_else(|| self.notice.get().cloned())
    }

    /// Notes that it cannot be used any more.
    pub(crate) fn give_up(&self, why: &str) {
        self.loss.note(why);
    }

    /// What it has done.
    pub fn counts(&self) -> GpuCounts {
        let Counters {
            rays,
            processor_rays,
            batches,
            uploaded_bytes,
            read_back_bytes,
            unit_uploads,
            unit_evictions,
            steps,
            shadow_ns,
            surface_ns,
        } = &self.counters;
        let of = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        GpuCounts {
            rays: of(rays),
            processor_rays: of(processor_rays),
            batches: of(batches),
            uploaded_bytes: of(uploaded_bytes),
            read_back_bytes: of(read_back_bytes),
            unit_uploads: of(unit_uploads),
            unit_evictions: of(unit_evictions),
            steps: of(steps),
            shadow_ns: of(shadow_ns),
            surface_ns: of(surface_ns),
        }
    }

    /// Takes `bytes` of video memory for `what`.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] with the limit that would do.
    pub(crate) fn lease(&self, what: &str, bytes: u64) -> Result<VideoLease> {
        let lease = self.memory.lease(what, bytes).map_err(|_| {
            let smallest = self.memory.used_bytes().saturating_add(bytes);
            let (free, limit) = (self.memory.free_bytes(), self.memory_limit_bytes());
            Error::new(Code::MemoryLimit, format!("the limit of video memory has no room for {what}"))
                .at_place(format!("the device {:?}", self.report.name))
                .numbers(format!("{bytes} bytes asked, {free} free of {limit}"))
                .next(NextStep::RaiseGpuLimit { bytes: smallest })
        })?;
        Ok(VideoLease(lease))
    }

    /// A buffer of leased bytes.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] where the device has no room, or binds no buffer of this size.
    pub(crate) fn buffer(&self, what: &str, bytes: u64, usage: wgpu::BufferUsages) -> Result<wgpu::Buffer> {
        self.create(what, bytes, usage, false)
    }

    /// A buffer of leased bytes that is copied from, mapped to be written.
    ///
    /// # Errors
    /// Those of [`GpuDevice::buffer`].
    pub(crate) fn staging(&self, what: &str, bytes: u64) -> Result<wgpu::Buffer> {
        self.create(what, bytes, wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC, true)
    }

    fn create(
        &self,
        what: &str,
        bytes: u64,
        usage: wgpu::BufferUsages,
        is_mapped: bool,
    ) -> Result<wgpu::Buffer> {
        let most = self.report.binding_bytes.min(self.report.buffer_bytes);
        let refused = |numbers: String| {
            Err(Error::new(Code::MemoryLimit, format!("the device has no room for {what}"))
                .at_place(format!("the device {:?}", self.report.name))
                .numbers(numbers)
                .next(NextStep::OtherDevice))
        };
        if bytes > most {
            return refused(format!("{bytes} bytes needed, a binding holds {most}"));
        }
        let scope = self.device.push_error_scope(wgpu::ErrorFilter::OutOfMemory);
        let descriptor =
            wgpu::BufferDescriptor { label: Some(what), size: bytes, usage, mapped_at_creation: is_mapped };
        let buffer = self.device.create_buffer(&descriptor);
        match pollster::block_on(scope.pop()) {
            Some(error) => refused(format!("{bytes} bytes needed: {error}")),
            None => Ok(buffer),
        }
    }
}
