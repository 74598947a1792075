//! `PoolOptions`, and the sizes that follow from them for a file.

use super::clock::Clock;
use super::requests::Requests;
use super::want::PageStore;
use super::word::{self, Word};
use crate::error::{Code, Error, Result};
use crate::io::{CONNECTION_BYTES, IoOptions, staging_bytes_for};

/// Fewest frames that a pool works with: one for the page in use, one for the page that arrives.
pub const FRAMES_MIN: usize = 2;

/// Most pages that there are addresses for in place of one that takes all of its frame.
const PAGES_PER_FRAME: u64 = 4;

/// Most decode threads.
pub const DECODE_THREADS_MAX: usize = 16;

/// How a pool is set up.
#[derive(Clone, Debug)]
pub struct PoolOptions {
    /// Memory for frames at open. At least [`FRAMES_MIN`] frames.
    pub frames_bytes: u64,
    /// The most that `set_limit` may ever ask for; addresses are reserved for it. `None`: all pages of the file.
    pub frames_bytes_max: Option<u64>,
    /// Buffers between disk and decoder, each of `merge_bytes` and two blocks more. At least 1; more than `io.depth`
    /// lets decoders work while the queue of the disk is full.
    pub staging_slots: usize,
    /// Longest read that several pages share. A page that is longer is read alone.
    pub merge_bytes: u32,
    /// Threads that check and decode, 1 to 16; what is read ahead has one more.
    pub decode_threads: usize,
    /// Most pages wanted at once.
    pub queue_capacity: usize,
    /// How the file is read.
    pub io: IoOptions,
}

impl Default for PoolOptions {
    fn default() -> PoolOptions {
        PoolOptions {
            frames_bytes: 64 << 20,
            frames_bytes_max: None,
            staging_slots: 40,
            merge_bytes: 256 << 10,
            decode_threads: 2,
            queue_capacity: 4096,
            io: IoOptions::default(),
        }
    }
}

/// The room of what reads take under a memory limit: buffers between disk and decoder, and connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadRoom {
    slots: usize,
    connections: usize,
}

impl ReadRoom {
    /// The least: fewer buffers delay reads.
    pub const LEAST: ReadRoom = ReadRoom { slots: 4, connections: 0 };
    /// The most where pages are near: more gains nothing.
    const NEAR: ReadRoom = ReadRoom { slots: 40, connections: 0 };
    /// The most where pages come from afar: 64 reads in flight.
    const FAR: ReadRoom = ReadRoom { slots: 72, connections: 32 };
    /// Bytes that one buffer reads at most.
    const MERGE_BYTES: u32 = 128 << 10;
    /// Most part of a limit: one over this.
    const PART: u64 = 10;

    fn bytes(self) -> u64 {
        self.slots as u64 * u64::from(ReadRoom::MERGE_BYTES) + self.connections as u64 * CONNECTION_BYTES
    }

    /// As much as helps where pages are near or come from afar ([`PageStore::is_far`]), in a tenth of a limit.
    pub fn within(limit_bytes: u64, is_far: bool) -> ReadRoom {
        let most = limit_bytes / ReadRoom::PART;
        if is_far && ReadRoom::FAR.bytes() <= most {
            return ReadRoom::FAR;
        }
        let slots = usize::try_from(most / u64::from(ReadRoom::MERGE_BYTES)).unwrap_or(usize::MAX);
        ReadRoom { slots: slots.clamp(ReadRoom::LEAST.slots, ReadRoom::NEAR.slots), ..ReadRoom::NEAR }
    }

    /// Options of a pool with this room, which reads as `io` says.
    pub fn pool_options(self, io: &IoOptions) -> PoolOptions {
        PoolOptions {
            staging_slots: self.slots,
            merge_bytes: ReadRoom::MERGE_BYTES,
            io: IoOptions { connections: self.connections, ..io.clone() },
            ..PoolOptions::default()
        }
    }
}

/// The sizes that follow from a file and the options.
pub(super) struct PoolPlan {
    /// Frames that there are addresses for.
    pub(super) frames_max: usize,
    /// Whole frames that there may ever be memory for.
    pub(super) frames_most: usize,
    pub(super) slot_bytes: usize,
    pub(super) overhead_bytes: u64,
}

impl PoolPlan {
    pub(super) fn new(store: &dyn PageStore, options: &PoolOptions) -> Result<PoolPlan> {
        let longest = (0..store.page_count()).map(|page| store.extent(page).stored_bytes).max();
        PoolPlan::of((store.page_count(), longest.unwrap_or(1)), store.frame_bytes(), options)
    }

    /// The sizes for so many pages, of which the longest has so many stored bytes.
    pub(super) fn of(
        (pages, longest): (u32, u32),
        frame_bytes: usize,
        options: &PoolOptions,
    ) -> Result<PoolPlan> {
        let out_of_range = options.staging_slots == 0
            || options.staging_slots > crate::io::DEPTH_MAX
            || options.decode_threads == 0
            || options.decode_threads > DECODE_THREADS_MAX
            || options.queue_capacity == 0;
        if out_of_range {
            return Err(Error::new(Code::Usage, "a pool option is out of range")
                .numbers(format!(
                    "{} staging slots, {} decode threads, room for {} wants",
                    options.staging_slots, options.decode_threads, options.queue_capacity
                ))
                .next("use the defaults of PoolOptions"));
        }
        assert!(frame_bytes > 0 && frame_bytes.is_multiple_of(crate::io::ALIGN_BYTES));
        let slot_bytes = staging_bytes_for(longest.max(options.merge_bytes) as usize);
        let wanted_max = match options.frames_bytes_max {
            Some(bytes) => bytes.max(options.frames_bytes) / frame_bytes as u64,
            None => u64::from(pages),
        };
        let most = u64::from(pages).min(word::FRAMES_MAX as u64);
        let at_most = |frames: u64| (frames.min(most) as usize).max(FRAMES_MIN);
        let (frames_max, frames_most) = (at_most(wanted_max * PAGES_PER_FRAME), at_most(wanted_max));
        let overhead_bytes = (options.staging_slots * slot_bytes) as u64
            + u64::from(pages) * (size_of::<Word>() + size_of::<u16>()) as u64
            + frames_max as u64 * Clock::BYTES_PER_FRAME
            + options.queue_capacity as u64 * Requests::BYTES_PER_WANT
            + options.io.connections as u64 * CONNECTION_BYTES
            // What a decoder may keep as scratch, that of pages read ahead, too.
            + ((options.decode_threads + 1) * frame_bytes) as u64;
        Ok(PoolPlan { frames_max, frames_most, slot_bytes, overhead_bytes })
    }
}
