//! `Slot`: the buffers of a batch under way.
//!
//! ```text
//! free --send--> under way --collect--> free
//! ```
//!
//! Invariants: 1. a slot holds one batch at a time; 2. its buffers are as large as the largest batch from the
//! beginning; 3. while it is free, its staging buffer is mapped: rays are written to where the device takes them from.

use crate::device::{GpuDevice, VideoLease, count};
use crate::kernels::{Binding, Kernels, Pipelines, WORKGROUP_RAYS};
use crate::octree::OctreeBuffers;
use crate::packing::answer_words;
use crate::units::UnitCache;
use crate::words::{Params, RAY_BYTES, SURFACE_WORDS};
use std::sync::mpsc::{Receiver, Sender, channel};
use trex_render::GRay;
use trex_store::Result;

/// Batches under way: one that is sent, one that is answered, one that is read back.
pub(crate) const SLOTS: usize = 3;
/// Kernels of a batch, and the times that are taken of each.
const KERNEL_TIMES: u32 = 2;
const TIMES: u32 = 2 * KERNEL_TIMES;
const TIMES_BYTES: u64 = TIMES as u64 * wgpu::QUERY_SIZE as u64;
/// Bytes of a ray in a slot: on its way, as it goes in, as it is answered, as that is read back.
const SLOT_RAY_BYTES: u64 = (2 * RAY_BYTES + 2 * 4 * SURFACE_WORDS) as u64;
/// Bytes of the staging buffer before the rays: the parameters.
const STAGED_RAYS_AT: u64 = 256;
/// Buffers of a slot that are mapped once its batch is answered.
const MAPPINGS: usize = 3;

/// The buffers of a batch.
#[derive(Debug)]
pub(crate) struct Slot {
    staging: wgpu::Buffer,
    params: wgpu::Buffer,
    rays: wgpu::Buffer,
    answers: wgpu::Buffer,
    read_back: wgpu::Buffer,
    used_read_back: wgpu::Buffer,
    clock: Option<KernelClock>,
    bindings: wgpu::BindGroup,
    under_way: Option<BatchInFlight>,
}

/// When each kernel of a batch begins and ends.
#[derive(Debug)]
struct KernelClock {
    queries: wgpu::QuerySet,
    /// Where the device writes them, to be copied from.
    times: wgpu::Buffer,
}

/// A batch on its way.
#[derive(Debug)]
struct BatchInFlight {
    word_count: usize,
    /// Tells whether a buffer could be mapped, and what it told: of [`MAPPINGS`].
    mapping: Receiver<bool>,
    mapped: Vec<bool>,
}

/// What came of a look.
#[derive(Debug, PartialEq)]
pub(crate) enum SlotState {
    /// The words of the batch were handed over; these are the bits of the slots of units that it has read.
    Answered(Vec<u32>),
    /// The device is still at work.
    UnderWay,
    /// It has failed, so.
    Failed(String),
}

/// The slots.
#[derive(Debug)]
pub(crate) struct Slots {
    all: Vec<Slot>,
    _lease: VideoLease,
}

impl Slots {
    /// Bytes of slots for so many rays each.
    pub(crate) fn bytes(rays_max: usize) -> u64 {
        SLOTS as u64 * (SLOT_RAY_BYTES * rays_max as u64 + STAGED_RAYS_AT + 256)
    }

    /// Room for slots of so many rays each.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`].
    pub(crate) fn lease(device: &GpuDevice, rays_max: usize) -> Result<VideoLease> {
        device.lease("the batches", Slots::bytes(rays_max))
    }

    /// Slots in what [`Slots::lease`] has leased, bound to an octree and its units.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`].
    pub(crate) fn new(
        device: &GpuDevice,
        kernels: &Kernels,
        (octree, units): (&OctreeBuffers, &UnitCache),
        (rays_max, lease): (usize, VideoLease),
    ) -> Result<Slots> {
        let slot = |_| Slot::new(device, kernels, (octree, units), rays_max);
        Ok(Slots { all: (0..SLOTS).map(slot).collect::<Result<_>>()?, _lease: lease })
    }

    /// The slot with this number, counted on and on.
    pub(crate) fn slot(&mut self, number: usize) -> &mut Slot {
        &mut self.all[number % SLOTS]
    }
}

impl Slot {
    fn new(
        device: &GpuDevice,
        kernels: &Kernels,
        (octree, units): (&OctreeBuffers, &UnitCache),
        rays_max: usize,
    ) -> Result<Slot> {
        use wgpu::BufferUsages as Usage;
        let (ray_bytes, answer_bytes) =
            ((RAY_BYTES * rays_max) as u64, (4 * SURFACE_WORDS * rays_max) as u64);
        let staging_bytes = STAGED_RAYS_AT + ray_bytes;
        let staging = device.staging("rays on their way", staging_bytes)?;
        let params =
            device.buffer("parameters", size_of::<Params>() as u64, Usage::UNIFORM | Usage::COPY_DST)?;
        let rays = device.buffer("rays", ray_bytes, Usage::STORAGE | Usage::COPY_DST)?;
        let answers = device.buffer("answers", answer_bytes, Usage::STORAGE | Usage::COPY_SRC)?;
        let to_read = Usage::MAP_READ | Usage::COPY_DST;
        let read_back = device.buffer("answers to read", answer_bytes, to_read)?;
        let used_bytes = 4 * units.used_words() as u64;
        let used_read_back = device.buffer("slots and times to read", used_bytes + TIMES_BYTES, to_read)?;
        let clock = device.report().has_timestamps.then(|| KernelClock::new(device)).transpose()?;
        let bindings = kernels.bind(
            &device.device,
            [
                (Binding::Params, &params),
                (Binding::Rays, &rays),
                (Binding::Answers, &answers),
                (Binding::Nodes, &octree.nodes),
                (Binding::Bitmaps, &octree.bitmaps),
                (Binding::Payload, &octree.payload),
                (Binding::PageSlots, &units.page_slots),
                (Binding::Frames, &units.frames),
                (Binding::SlotsUsed, &units.slots_used),
            ],
        );
        Ok(Slot {
            staging,
            params,
            rays,
            answers,
            read_back,
            used_read_back,
            clock,
            bindings,
            under_way: None,
        })
    }

    /// Sends a batch: rays in some pieces, of which the first are shadow rays, as `params` says. False where the
    /// device takes none any more.
    pub(crate) fn send<'a>(
        &mut self,
        (device, kernels): (&GpuDevice, &Kernels),
        units: &UnitCache,
        params: Params,
        pieces: impl Iterator<Item = &'a [GRay]>,
    ) -> bool {
        let (ray_count, shadow_count) = (params.ray_count as usize, params.shadow_count as usize);
        let word_count = answer_words(ray_count, shadow_count);
        let ray_bytes = (RAY_BYTES * ray_count) as u64;
        if !self.stage(&params, pieces) {
            return false;
        }
        let mut encoder = device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.copy_buffer_to_buffer(&self.staging, 0, &self.params, 0, size_of::<Params>() as u64);
        encoder.copy_buffer_to_buffer(&self.staging, STAGED_RAYS_AT, &self.rays, 0, ray_bytes);
        encoder.clear_buffer(&units.slots_used, 0, None);
        let Pipelines { shadow_rays, surface_rays } =
            if params.finer == 0 { &kernels.plain } else { &kernels.in_units };
        let kernels =
            [(shadow_rays, params.shadow_count), (surface_rays, params.ray_count - params.shadow_count)];
        for (number, (kernel, count)) in (0..).zip(kernels) {
            let times = self.clock.as_ref().map(|clock| clock.writes(number));
            let descriptor = wgpu::ComputePassDescriptor { label: None, timestamp_writes: times };
            let mut pass = encoder.begin_compute_pass(&descriptor);
            pass.set_bind_group(0, &self.bindings, &[]);
            if count > 0 {
                pass.set_pipeline(kernel);
                pass.dispatch_workgroups(count.div_ceil(WORKGROUP_RAYS), 1, 1);
            }
        }
        let (answer_bytes, used_bytes) = (4 * word_count as u64, 4 * units.used_words() as u64);
        encoder.copy_buffer_to_buffer(&self.answers, 0, &self.read_back, 0, answer_bytes);
        encoder.copy_buffer_to_buffer(&units.slots_used, 0, &self.used_read_back, 0, used_bytes);
        if let Some(clock) = &self.clock {
            encoder.resolve_query_set(&clock.queries, 0..TIMES, &clock.times, 0);
            encoder.copy_buffer_to_buffer(&clock.times, 0, &self.used_read_back, used_bytes, TIMES_BYTES);
        }
        device.queue.submit([encoder.finish()]);
        let (is_mapped, mapping) = channel();
        map(&self.read_back, wgpu::MapMode::Read, answer_bytes, is_mapped.clone());
        map(&self.used_read_back, wgpu::MapMode::Read, used_bytes + TIMES_BYTES, is_mapped.clone());
        map(&self.staging, wgpu::MapMode::Write, self.staging.size(), is_mapped);
        self.under_way = Some(BatchInFlight { word_count, mapping, mapped: Vec::new() });
        count(&device.counters.batches, 1);
        count(&device.counters.rays, u64::from(params.ray_count));
        count(&device.counters.uploaded_bytes, ray_bytes);
        count(&device.counters.read_back_bytes, answer_bytes);
        true
    }

    /// Writes parameters and rays to the staging buffer, which is mapped, and gives it to the device.
    fn stage<'a>(&self, params: &Params, pieces: impl Iterator<Item = &'a [GRay]>) -> bool {
        let mut at = STAGED_RAYS_AT as usize;
        // Only a device that was lost has it unmapped.
        let Ok(mut staged) = self.staging.get_mapped_range_mut(..) else { return false };
        staged.slice(..size_of::<Params>()).copy_from_slice(bytemuck::bytes_of(params));
        for piece in pieces {
            let bytes: &[u8] = bytemuck::cast_slice(piece);
            staged.slice(at..at + bytes.len()).copy_from_slice(bytes);
            at += bytes.len();
        }
        drop(staged);
        self.staging.unmap();
        true
    }

    /// Looks whether the batch is answered, and hands its words to `take` where it is.
    ///
    /// # Panics
    /// When none is under way.
    pub(crate) fn collect(
        &mut self,
        device: &GpuDevice,
        units: &UnitCache,
        take: impl FnOnce(&[u32]),
    ) -> SlotState {
        let BatchInFlight { mapping, mapped, .. } = self.under_way.as_mut().expect("a batch is under way");
        if let Err(error) = device.device.poll(wgpu::PollType::Poll) {
            return SlotState::Failed(error.to_string());
        }
        mapped.extend(mapping.try_iter());
        if mapped.len() < MAPPINGS && device.lost().is_none() {
            return SlotState::UnderWay;
        }
        let is_mapped = *mapped == [true; MAPPINGS];
        if !is_mapped || device.lost().is_some() {
            return SlotState::Failed(device.lost().unwrap_or("its answers cannot be read").to_owned());
        }
        let word_count = self.under_way.take().expect("a batch is under way").word_count;
        let used_words = units.used_words();
        let with_times = used_words + TIMES_BYTES as usize / 4;
        let mut used = Vec::new();
        let is_read = read(&self.read_back, word_count, take)
            && read(&self.used_read_back, with_times, |words| used.extend_from_slice(words));
        if !is_read {
            return SlotState::Failed("its answers cannot be read".to_owned());
        }
        if self.clock.is_some() {
            count_times(device, &used[used_words..]);
        }
        used.truncate(used_words);
        count(&device.counters.steps, u64::from(used[used_words - 1]));
        SlotState::Answered(used)
    }
}

impl KernelClock {
    fn new(device: &GpuDevice) -> Result<KernelClock> {
        let descriptor =
            wgpu::QuerySetDescriptor { label: None, ty: wgpu::QueryType::Timestamp, count: TIMES };
        let queries = device.device.create_query_set(&descriptor);
        let usage = wgpu::BufferUsages::QUERY_RESOLVE | wgpu::BufferUsages::COPY_SRC;
        Ok(KernelClock { queries, times: device.buffer("times", TIMES_BYTES, usage)? })
    }

    /// Where the pass of kernel `number` notes its times.
    fn writes(&self, number: u32) -> wgpu::ComputePassTimestampWrites<'_> {
        wgpu::ComputePassTimestampWrites {
            query_set: &self.queries,
            beginning_of_pass_write_index: Some(KERNEL_TIMES * number),
            end_of_pass_write_index: Some(KERNEL_TIMES * number + 1),
        }
    }
}

/// Adds the times of both kernels, which are 64 bits each, the lower half first.
fn count_times(device: &GpuDevice, words: &[u32]) {
    let time = |at: usize| u64::from(words[2 * at]) | u64::from(words[2 * at + 1]) << 32;
    let period_ns = f64::from(device.queue.get_timestamp_period());
    let took = |begin: usize| (time(begin + 1).saturating_sub(time(begin)) as f64 * period_ns) as u64;
    count(&device.counters.shadow_ns, took(0));
    count(&device.counters.surface_ns, took(KERNEL_TIMES as usize));
}

fn map(buffer: &wgpu::Buffer, mode: wgpu::MapMode, bytes: u64, is_mapped: Sender<bool>) {
    buffer.map_async(mode, 0..bytes, move |result| {
        // Who waits may have given up.
        let _ = is_mapped.send(result.is_ok());
    });
}

/// Hands the first words of a mapped buffer over, which is not mapped any more afterwards; false where it cannot.
fn read(buffer: &wgpu::Buffer, words: usize, take: impl FnOnce(&[u32])) -> bool {
    let range = buffer.get_mapped_range(0..4 * words as u64);
    let is_read = range.map(|range| take(bytemuck::cast_slice(&range))).is_ok();
    buffer.unmap();
    is_read
}
