//! The thread between the stage and the device's queue: it sends batches to slots, and hands their words on.
//!
//! ```text
//! batch -> pieces of at most a slot's rays -> slot -> words, piece after piece -> done
//! ```
//!
//! Invariants: 1. each batch is done once, with its words or with nothing, in the order in which batches came; 2. the
//! thread waits for a new batch only when none is under way; 3. what is under way for longer than [`ANSWER_WAIT`] is
//! the end of the device: all that wait are told.

use crate::device::GpuDevice;
use crate::kernels::Kernels;
use crate::octree::OctreeBuffers;
use crate::packing::PackedRays;
use crate::slots::{SLOTS, SlotState, Slots};
use crate::units::{UnitCache, UnitUpload};
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, TryRecvError};
use std::time::{Duration, Instant};
use trex_render::{Occluders, Voxels};
use trex_store::Result;

/// Longest time for a batch: far above that of the largest, in software, on a machine with much else to do.
const ANSWER_WAIT: Duration = Duration::from_secs(60);
/// Wait between two looks for new batches, while others are under way.
const LOOK_EVERY: Duration = Duration::from_millis(1);

/// Does something with the words of a batch, or without, where the device is lost.
pub(crate) type Completion = Box<dyn FnOnce(&PackedRays, Option<&[u32]>) + Send>;

/// Rays to be answered.
pub(crate) struct Batch {
    pub(crate) rays: PackedRays,
    pub(crate) occluders: Occluders,
    /// True when rays go on into units.
    pub(crate) asks_units: bool,
    /// Pages of units that go before the rays.
    pub(crate) uploads: Vec<UnitUpload>,
    pub(crate) when_done: Completion,
}

/// What the thread is asked.
pub(crate) enum Request {
    /// Take this octree; the answer says how many pages of units have room.
    Octree(Arc<Voxels>, Sender<Result<usize>>),
    /// Answer these rays.
    Batch(Batch),
}

/// A batch whose pieces are sent, some of which have come back.
struct BatchInWork {
    batch: Batch,
    sent_rays: usize,
    pieces_under_way: usize,
    words: Vec<u32>,
}

/// All of an octree that is in video memory.
struct OctreeOnDevice {
    slots: Slots,
    units: UnitCache,
    octree: OctreeBuffers,
}

/// The state of the thread.
pub(crate) struct Worker {
    device: Arc<GpuDevice>,
    kernels: Kernels,
    rays_max: usize,
    octree: Option<OctreeOnDevice>,
    batches: VecDeque<BatchInWork>,
    /// When each piece was sent that is under way, the oldest first.
    sent: VecDeque<Instant>,
    /// Number of the oldest piece under way.
    first: usize,
}

impl Worker {
    /// A worker whose batches go in pieces of so many rays.
    pub(crate) fn new(device: Arc<GpuDevice>, kernels: Kernels, rays_max: usize) -> Worker {
        let (batches, sent) = (VecDeque::new(), VecDeque::new());
        Worker { device, kernels, rays_max, octree: None, batches, sent, first: 0 }
    }

    /// Answers requests until nobody can make any more.
    pub(crate) fn run(mut self, requests: &Receiver<Request>) {
        loop {
            self.send_pieces();
            if !self.is_full() {
                let request = match self.batches.is_empty() {
                    true => requests.recv().map_err(|_| TryRecvError::Disconnected),
                    false => requests.try_recv(),
                };
                match request {
                    Ok(request) => {
                        self.begin(request);
                        continue;
                    }
                    Err(TryRecvError::Disconnected) if self.batches.is_empty() => return,
                    Err(_) => {}
                }
            }
            self.collect();
        }
    }

    fn is_full(&self) -> bool {
        self.sent.len() == SLOTS
    }

    fn begin(&mut self, request: Request) {
        match request {
            Request::Octree(voxels, told) => {
                while !self.batches.is_empty() {
                    self.send_pieces();
                    self.collect();
                }
                // Who asked may have given up.
                let _ = told.send(self.set_octree(&voxels));
            }
            Request::Batch(batch) => {
                let on_device = self.octree.as_mut().expect("the octree is set");
                for upload in &batch.uploads {
                    if on_device.units.slot_count() > 0 {
                        on_device.units.install(&self.device, upload);
                    }
                }
                self.batches.push_back(BatchInWork {
                    batch,
                    sent_rays: 0,
                    pieces_under_way: 0,
                    words: Vec::new(),
                });
            }
        }
    }

    fn set_octree(&mut self, voxels: &Arc<Voxels>) -> Result<usize> {
        // The one before goes first.
        self.octree = None;
        let octree = OctreeBuffers::new(&self.device, voxels)?;
        let lease = Slots::lease(&self.device, self.rays_max)?;
        let units = UnitCache::new(&self.device, voxels)?;
        let slots = Slots::new(&self.device, &self.kernels, (&octree, &units), (self.rays_max, lease))?;
        let slot_count = units.slot_count();
        self.octree = Some(OctreeOnDevice { slots, units, octree });
        Ok(slot_count)
    }

    /// Sends pieces while there are slots.
    fn send_pieces(&mut self) {
        if self.device.lost().is_some() {
            return self.drop_all();
        }
        let Some(OctreeOnDevice { slots, units, octree }) = &mut self.octree else { return };
        for work in &mut self.batches {
            let Batch { rays, occluders, asks_units, .. } = &work.batch;
            while work.sent_rays < rays.len() && self.sent.len() < SLOTS {
                let (piece, shadow_count) = rays.piece(work.sent_rays, slots.rays_max);
                let mut params = octree.params();
                params.is_whole = u32::from(*occluders == Occluders::Off);
                params.finer = if *asks_units { octree.finer() } else { 0 };
                params.ray_count = piece.len() as u32;
                params.shadow_count = shadow_count as u32;
                let slot = slots.slot(self.first + self.sent.len());
                slot.send((&self.device, &self.kernels), units, params, piece);
                self.sent.push_back(Instant::now());
                work.sent_rays += piece.len();
                work.pieces_under_way += 1;
            }
        }
    }

    /// Waits a little for the oldest piece.
    fn collect(&mut self) {
        let Some(&sent) = self.sent.front() else { return };
        let Some(OctreeOnDevice { slots, units, .. }) = &mut self.octree else { return };
        match slots.slot(self.first).collect(&self.device, units, LOOK_EVERY) {
            SlotState::UnderWay if sent.elapsed() < ANSWER_WAIT => return,
            SlotState::UnderWay => {
                self.device.give_up(&format!("no answer within {} s", ANSWER_WAIT.as_secs()));
                return self.drop_all();
            }
            SlotState::Failed(why) => {
                self.device.give_up(&why);
                return self.drop_all();
            }
            SlotState::Answered(words, used) => {
                units.note_used(&used);
                let work = self.batches.front_mut().expect("the piece is of a batch");
                work.words.extend(words);
                work.pieces_under_way -= 1;
            }
        }
        self.sent.pop_front();
        self.first += 1;
        if self.batches.front().is_some_and(BatchInWork::is_whole) {
            let BatchInWork { batch, words, .. } = self.batches.pop_front().expect("it is there");
            (batch.when_done)(&batch.rays, Some(&words));
        }
    }

    /// Tells all who wait that there is no device any more.
    fn drop_all(&mut self) {
        self.sent.clear();
        for BatchInWork { batch, .. } in self.batches.drain(..) {
            (batch.when_done)(&batch.rays, None);
        }
    }
}

impl BatchInWork {
    fn is_whole(&self) -> bool {
        self.sent_rays == self.batch.rays.len() && self.pieces_under_way == 0
    }
}
