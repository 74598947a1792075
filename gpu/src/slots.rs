//! `Slot`: the buffers of a batch under way.
//!
//! ```text
//! free --send--> under way --collect--> free
//! ```
//!
//! Invariants: 1. a slot holds one batch at a time; 2. its buffers are as large as the largest batch from the
//! beginning.

use crate::device::{GpuDevice, VideoLease, count};
use crate::kernels::{Binding, Kernels, WORKGROUP_RAYS};
use crate::octree::OctreeBuffers;
use crate::packing::PackedRays;
use crate::units::UnitCache;
use crate::words::{Params, RAY_BYTES, SURFACE_WORDS};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;
use trex_render::GRay;
use trex_store::Result;

/// Batches under way: one that is sent, one that is answered, one that is read back.
pub(crate) const SLOTS: usize = 3;
/// Bytes of a ray in a slot: as it goes in, as it is answered, as that is read back.
const SLOT_RAY_BYTES: u64 = (RAY_BYTES + 2 * 4 * SURFACE_WORDS) as u64;

/// The buffers of a batch.
#[derive(Debug)]
pub(crate) struct Slot {
    params: wgpu::Buffer,
    rays: wgpu::Buffer,
    answers: wgpu::Buffer,
    read_back: wgpu::Buffer,
    used_read_back: wgpu::Buffer,
    bindings: wgpu::BindGroup,
    under_way: Option<BatchInFlight>,
}

/// A batch on its way.
#[derive(Debug)]
struct BatchInFlight {
    submission: wgpu::SubmissionIndex,
    word_count: usize,
    /// Whether each of the two buffers could be mapped.
    mapped: Receiver<bool>,
}

/// What came of a wait.
#[derive(Debug, PartialEq)]
pub(crate) enum SlotState {
    /// The words of the batch, and the bits of the slots of units that it has read.
    Answered(Vec<u32>, Vec<u32>),
    /// The device is still at work.
    UnderWay,
    /// It has failed, so.
    Failed(String),
}

/// The slots, and the rays that each may hold.
#[derive(Debug)]
pub(crate) struct Slots {
    all: Vec<Slot>,
    pub(crate) rays_max: usize,
    _lease: VideoLease,
}

impl Slots {
    /// Slots for batches of so many rays.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`].
    pub(crate) fn lease(device: &GpuDevice, rays_max: usize) -> Result<VideoLease> {
        device.lease("the batches", SLOTS as u64 * (SLOT_RAY_BYTES * rays_max as u64 + 256))
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
        Ok(Slots { all: (0..SLOTS).map(slot).collect::<Result<_>>()?, rays_max, _lease: lease })
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
        let params =
            device.buffer("parameters", size_of::<Params>() as u64, Usage::UNIFORM | Usage::COPY_DST)?;
        let rays = device.buffer("rays", ray_bytes, Usage::STORAGE | Usage::COPY_DST)?;
        let answers = device.buffer("answers", answer_bytes, Usage::STORAGE | Usage::COPY_SRC)?;
        let to_read = Usage::MAP_READ | Usage::COPY_DST;
        let read_back = device.buffer("answers to read", answer_bytes, to_read)?;
        let used_read_back = device.buffer("slots to read", 4 * units.used_words() as u64, to_read)?;
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
        Ok(Slot { params, rays, answers, read_back, used_read_back, bindings, under_way: None })
    }

    /// Sends a batch: rays, of which the first are shadow rays, as `params` says.
    pub(crate) fn send(
        &mut self,
        (device, kernels): (&GpuDevice, &Kernels),
        units: &UnitCache,
        params: Params,
        rays: &[GRay],
    ) {
        let word_count = PackedRays::word_count(rays.len(), params.shadow_count as usize);
        let ray_bytes: &[u8] = bytemuck::cast_slice(rays);
        device.queue.write_buffer(&self.params, 0, bytemuck::bytes_of(&params));
        device.queue.write_buffer(&self.rays, 0, ray_bytes);
        let mut encoder = device.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        encoder.clear_buffer(&units.slots_used, 0, None);
        {
            let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
            pass.set_bind_group(0, &self.bindings, &[]);
            let other_count = params.ray_count - params.shadow_count;
            for (kernel, count) in
                [(&kernels.shadow_rays, params.shadow_count), (&kernels.surface_rays, other_count)]
            {
                if count > 0 {
                    pass.set_pipeline(kernel);
                    pass.dispatch_workgroups(count.div_ceil(WORKGROUP_RAYS), 1, 1);
                }
            }
        }
        let (answer_bytes, used_bytes) = (4 * word_count as u64, 4 * units.used_words() as u64);
        encoder.copy_buffer_to_buffer(&self.answers, 0, &self.read_back, 0, answer_bytes);
        encoder.copy_buffer_to_buffer(&units.slots_used, 0, &self.used_read_back, 0, used_bytes);
        let submission = device.queue.submit([encoder.finish()]);
        let (is_mapped, mapped) = channel();
        map(&self.read_back, answer_bytes, is_mapped.clone());
        map(&self.used_read_back, used_bytes, is_mapped);
        self.under_way = Some(BatchInFlight { submission, word_count, mapped });
        count(&device.counters.batches, 1);
        count(&device.counters.rays, u64::from(params.ray_count));
        count(&device.counters.uploaded_bytes, ray_bytes.len() as u64);
        count(&device.counters.read_back_bytes, answer_bytes);
    }

    /// Waits so long for the batch at most.
    ///
    /// # Panics
    /// When none is under way.
    pub(crate) fn collect(&mut self, device: &GpuDevice, units: &UnitCache, wait: Duration) -> SlotState {
        let sending = self.under_way.as_ref().expect("a batch is under way");
        let submission_index = Some(sending.submission.clone());
        match device.device.poll(wgpu::PollType::Wait { submission_index, timeout: Some(wait) }) {
            Err(wgpu::PollError::Timeout) => return SlotState::UnderWay,
            Err(error) => return SlotState::Failed(error.to_string()),
            Ok(_) => {}
        }
        // What was submitted has ended, and with it both callbacks; each of them drops its sender.
        let is_mapped = [sending.mapped.recv(), sending.mapped.recv()] == [Ok(true), Ok(true)];
        if !is_mapped || device.lost().is_some() {
            return SlotState::Failed(device.lost().unwrap_or("its answers cannot be read").to_owned());
        }
        let word_count = sending.word_count;
        self.under_way = None;
        match (read(&self.read_back, word_count), read(&self.used_read_back, units.used_words())) {
            (Some(words), Some(used)) => SlotState::Answered(words, used),
            _ => SlotState::Failed("its answers cannot be read".to_owned()),
        }
    }
}

fn map(buffer: &wgpu::Buffer, bytes: u64, is_mapped: Sender<bool>) {
    buffer.map_async(wgpu::MapMode::Read, 0..bytes, move |result| {
        // Who waits may have given up.
        let _ = is_mapped.send(result.is_ok());
    });
}

/// The first words of a mapped buffer, which is not mapped any more afterwards.
fn read(buffer: &wgpu::Buffer, words: usize) -> Option<Vec<u32>> {
    let read = buffer.get_mapped_range(0..4 * words as u64).ok().map(|range| {
        let mut copy = vec![0; words];
        bytemuck::cast_slice_mut(&mut copy).copy_from_slice(&range);
        copy
    });
    buffer.unmap();
    read
}
