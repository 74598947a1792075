//! `UnitCache`: pages of units in video memory, each in a slot, and the word a page that leads there. Paper, section
//! 4.2.
//!
//! ```text
//! a ray wants a page -> the worker that asked copies it out of its frame -> install: a slot, the frame, one word
//! a slot is needed   -> the clock's hand passes slots that rays have read since it was there, and takes the next
//! ```
//!
//! Invariants: 1. what is written stands in the queue before the batch that needs it, so a slot that changes hands is
//! read by earlier batches as it was; 2. a page that is here is whole: what rays find by it is exact, whatever the
//! pool holds.

use crate::device::{GpuDevice, VideoLease, count};
use crate::words::{PAGE_MISSING, PAGE_NEVER, PAGE_SLOTS};
use trex_render::Voxels;
use trex_store::Result;
use trex_store::layout::{FRAME_BYTES, PAGES};

/// Fewest slots that are of use: pages of some rays.
const SLOTS_MIN: u64 = 8;
/// Words behind the bits of slots: the steps of a batch. They wrap where walks have 2^17 steps on average, far more
/// than cells on a ray's way.
const STEPS_WORDS: u64 = 1;

/// A page on its way to video memory: its frame, or none where it can never be had.
#[derive(Debug)]
pub(crate) struct UnitUpload {
    pub(crate) page: u32,
    pub(crate) frame: Option<Box<[u8]>>,
}

/// The pages, and where they are.
#[derive(Debug)]
pub(crate) struct UnitCache {
    pub(crate) frames: wgpu::Buffer,
    pub(crate) page_slots: wgpu::Buffer,
    pub(crate) slots_used: wgpu::Buffer,
    /// By page: as the shaders have it.
    states: Vec<u32>,
    /// By slot: its page, and whether a ray has read it since the hand was there.
    slots: Vec<(Option<u32>, bool)>,
    hand: usize,
    _lease: VideoLease,
}

impl UnitCache {
    /// Slots for the pages of units of `voxels`, as many as the limit leaves; for one page that is never asked where
    /// there are no units, or no room.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] where not even that has room.
    pub(crate) fn new(device: &GpuDevice, voxels: &Voxels) -> Result<UnitCache> {
        let page_count = u64::from(voxels.page_count());
        let free = device.memory_limit_bytes() - device.memory_used_bytes().min(device.memory_limit_bytes());
        let tables = 4 * page_count + FRAME_BYTES as u64;
        let most = free.saturating_sub(tables).min(device.report().binding_bytes) / FRAME_BYTES as u64;
        let slots = page_count.min(most);
        // The last page could not be told from none.
        let is_of_use =
            voxels.links().is_some() && slots >= SLOTS_MIN.min(page_count) && page_count < u64::from(PAGES);
        let (pages, slots) = if is_of_use { (page_count, slots) } else { (1, 0) };
        let frame_bytes = (slots * FRAME_BYTES as u64).max(16);
        let used_words = used_words(slots);
        let lease = device.lease("the units", frame_bytes + 4 * (pages + used_words))?;
        let usage = wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_DST;
        let cache = UnitCache {
            frames: device.buffer("units", frame_bytes, usage)?,
            page_slots: device.buffer("pages of units", 4 * pages, usage)?,
            slots_used: device.buffer(
                "slots in use",
                4 * used_words,
                usage | wgpu::BufferUsages::COPY_SRC,
            )?,
            states: vec![PAGE_MISSING; pages as usize],
            slots: vec![(None, false); slots as usize],
            hand: 0,
            _lease: lease,
        };
        Ok(cache)
    }

    /// Slots that there are; 0 where units are the processor's.
    pub(crate) fn slot_count(&self) -> usize {
        self.slots.len()
    }

    /// Words of the bits of all slots, and [`STEPS_WORDS`].
    pub(crate) fn used_words(&self) -> usize {
        used_words(self.slots.len() as u64) as usize
    }

    /// Writes a page to a slot, and the word that leads there.
    pub(crate) fn install(&mut self, device: &GpuDevice, upload: &UnitUpload) {
        let page = upload.page;
        let Some(&state) = self.states.get(page as usize) else { return };
        let Some(frame) = &upload.frame else { return self.set_state(device, page, PAGE_NEVER) };
        if state != PAGE_MISSING {
            return;
        }
        let slot = self.free_slot(device);
        self.slots[slot] = (Some(page), true);
        device.queue.write_buffer(&self.frames, (slot * FRAME_BYTES) as u64, frame);
        self.set_state(device, page, PAGE_SLOTS + slot as u32);
        count(&device.counters.unit_uploads, 1);
        count(&device.counters.uploaded_bytes, frame.len() as u64);
    }

    /// Learns which slots rays have read.
    pub(crate) fn note_used(&mut self, bits: &[u32]) {
        for (slot, (_, is_used)) in self.slots.iter_mut().enumerate() {
            *is_used |= bits[slot / 32] >> (slot % 32) & 1 == 1;
        }
    }

    /// A slot to write to; the page that had it is unlinked.
    fn free_slot(&mut self, device: &GpuDevice) -> usize {
        loop {
            let slot = self.hand;
            self.hand = (self.hand + 1) % self.slots.len();
            let (page, is_used) = &mut self.slots[slot];
            match page {
                None => return slot,
                Some(_) if *is_used => *is_used = false,
                &mut Some(page) => {
                    count(&device.counters.unit_evictions, 1);
                    self.set_state(device, page, PAGE_MISSING);
                    return slot;
                }
            }
        }
    }

    fn set_state(&mut self, device: &GpuDevice, page: u32, state: u32) {
        self.states[page as usize] = state;
        device.queue.write_buffer(&self.page_slots, 4 * u64::from(page), &state.to_le_bytes());
    }
}

/// Words of the bits of so many slots, and [`STEPS_WORDS`].
fn used_words(slots: u64) -> u64 {
    slots.div_ceil(32).max(1) + STEPS_WORDS
}
