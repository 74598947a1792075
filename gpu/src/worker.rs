//! The thread between the stage and the device's queue: it sends batches to slots, and hands their words on.
//!
//! ```text
//! batches that wait -> as many as fill a slot, the last one in part -> words -> each batch's own -> done
//! ```
//!
//! A submission costs a device in hardware about as much as ten thousand rays, and a tile asks some hundred: so what
//! several workers ask meanwhile goes there together.
//!
//! Invariants: 1. each batch is done once, with its words or with nothing, in the order in which batches came; 2. the
//! thread waits for a new batch alone only when none is under way; 3. what is under way for longer than
//! [`ANSWER_WAIT`] is the end of the device: all that wait are told.

use crate::device::GpuDevice;
use crate::kernels::Kernels;
use crate::octree::OctreeBuffers;
use crate::packing::PackedRays;
use crate::slots::{SLOTS, SlotState, Slots};
use crate::units::{UnitCache, UnitUpload};
use crate::words::SURFACE_WORDS;
use std::collections::VecDeque;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use trex_render::{Occluders, Voxels};
use trex_store::Result;

/// Longest time for a batch: far above that of the largest, in software, on a machine with much else to do.
const ANSWER_WAIT: Duration = Duration::from_secs(60);
/// Looks at a device in hardware, one after the other, before the thread waits between them: it answers sooner than a
/// wait ends.
const BUSY_LOOKS: u32 = 100;
/// Wait between two looks; a request ends it.
const PAUSE: Duration = Duration::from_micros(50);

/// Does something with a batch and its words, or without, where the device is lost.
pub(crate) type Completion = Box<dyn FnOnce(PackedRays, Option<Vec<u32>>) + Send>;

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

/// A batch that is sent, in part or whole.
struct BatchInWork {
    batch: Batch,
    sent_rays: usize,
    words: Vec<u32>,
}

/// What is in a slot: pieces of batches, the oldest first.
struct Submission {
    sent: Instant,
    pieces: Vec<Piece>,
}

/// Rays of a batch in a slot.
#[derive(Clone, Copy)]
struct Piece {
    /// Number of the batch, counted on and on.
    batch: usize,
    begin: usize,
    shadow: usize,
    others: usize,
}

/// All of an octree that is in video memory.
struct OctreeOnDevice {
    slots: Slots,
    units: UnitCache,
    octree: OctreeBuffers,
}

/// Room for words whose answers were read: new pages of memory take longer than what is written to them.
#[derive(Debug, Default)]
pub(crate) struct SpareWords(Mutex<Vec<Vec<u32>>>);

/// The state of the thread.
pub(crate) struct Worker {
    device: Arc<GpuDevice>,
    kernels: Kernels,
    rays_max: usize,
    spare_words: Arc<SpareWords>,
    octree: Option<OctreeOnDevice>,
    batches: VecDeque<BatchInWork>,
    /// Number of the oldest batch.
    first_batch: usize,
    /// What is under way, the oldest first.
    sent: VecDeque<Submission>,
    /// Number of the oldest submission under way.
    first: usize,
}

impl Worker {
    /// A worker whose slots hold so many rays.
    pub(crate) fn new(
        device: Arc<GpuDevice>,
        kernels: Kernels,
        rays_max: usize,
        spare_words: Arc<SpareWords>,
    ) -> Worker {
        let (octree, batches, sent) = (None, VecDeque::new(), VecDeque::new());
        Worker { device, kernels, rays_max, spare_words, octree, batches, first_batch: 0, sent, first: 0 }
    }

    /// Answers requests until nobody can make any more.
    pub(crate) fn run(mut self, requests: &Receiver<Request>) {
        let mut looks = 0;
        loop {
            requests.try_iter().for_each(|request| self.begin(request));
            self.send_pieces();
            if self.collect() {
                looks = 0;
                continue;
            }
            if self.batches.is_empty() {
                let Ok(request) = requests.recv() else { return };
                self.begin(request);
                continue;
            }
            looks += 1;
            if self.device.report().is_hardware && looks < BUSY_LOOKS {
                std::thread::yield_now();
                continue;
            }
            match requests.recv_timeout(PAUSE) {
                Ok(request) => self.begin(request),
                // What is asked already comes to its end.
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(PAUSE),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    fn begin(&mut self, request: Request) {
        match request {
            Request::Octree(voxels, told) => {
                while !self.batches.is_empty() {
                    self.send_pieces();
                    if !self.collect() {
                        std::thread::sleep(PAUSE);
                    }
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
                let words = self.spare_words.take(batch.rays.word_count());
                self.batches.push_back(BatchInWork { batch, sent_rays: 0, words });
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

    /// Sends what waits while there are slots.
    fn send_pieces(&mut self) {
        if self.device.lost().is_some() {
            return self.drop_all();
        }
        while self.sent.len() < SLOTS {
            let pieces = self.next_pieces();
            let Some(first) = pieces.first() else { return };
            let Some(OctreeOnDevice { slots, units, octree }) = &mut self.octree else { return };
            let Batch { occluders, asks_units, .. } = self.batches[first.batch - self.first_batch].batch;
            let mut params = octree.params();
            params.is_whole = u32::from(occluders == Occluders::Off);
            params.finer = if asks_units { octree.finer() } else { 0 };
            params.shadow_count = pieces.iter().map(|piece| piece.shadow as u32).sum();
            params.ray_count =
                params.shadow_count + pieces.iter().map(|piece| piece.others as u32).sum::<u32>();
            let rays = pieces.iter().map(|piece| {
                let rays = &self.batches[piece.batch - self.first_batch].batch.rays;
                rays.piece(piece.begin, piece.begin + piece.shadow + piece.others)
            });
            let rays = rays.clone().map(|(shadow, _)| shadow).chain(rays.map(|(_, others)| others));
            let slot = slots.slot(self.first + self.sent.len());
            if !slot.send((&self.device, &self.kernels), units, params, rays) {
                self.device.give_up("its memory cannot be written");
                return self.drop_all();
            }
            self.sent.push_back(Submission { sent: Instant::now(), pieces });
        }
    }

    /// What goes to the next slot: of the batches that wait, in their order, those that see the octree alike, as far as
    /// there is room. They count as sent.
    fn next_pieces(&mut self) -> Vec<Piece> {
        let (mut pieces, mut left, mut view) = (Vec::new(), self.rays_max, None);
        for (number, work) in (self.first_batch..).zip(&mut self.batches) {
            let (begin, count) = (work.sent_rays, work.batch.rays.len());
            if begin == count {
                continue;
            }
            let own = (work.batch.occluders, work.batch.asks_units);
            if left == 0 || *view.get_or_insert(own) != own {
                break;
            }
            work.sent_rays = count.min(begin + left);
            left -= work.sent_rays - begin;
            let (shadow, others) = work.batch.rays.piece(begin, work.sent_rays);
            pieces.push(Piece { batch: number, begin, shadow: shadow.len(), others: others.len() });
        }
        pieces
    }

    /// Looks at the oldest submission: false while it is under way, or where there is none.
    fn collect(&mut self) -> bool {
        let Some(Submission { sent, pieces }) = self.sent.front() else { return false };
        let Some(OctreeOnDevice { slots, units, .. }) = &mut self.octree else { return false };
        let (batches, first_batch) = (&mut self.batches, self.first_batch);
        let hand_on = |words: &[u32]| {
            let shadow_count = pieces.iter().map(|piece| piece.shadow).sum();
            let (mut shadow, mut others) = words.split_at(shadow_count);
            for piece in pieces {
                let words = &mut batches[piece.batch - first_batch].words;
                words.extend_from_slice(shadow.split_off(..piece.shadow).expect("a word each"));
                words
                    .extend_from_slice(others.split_off(..SURFACE_WORDS * piece.others).expect("eight each"));
            }
        };
        match slots.slot(self.first).collect(&self.device, units, hand_on) {
            SlotState::UnderWay if sent.elapsed() < ANSWER_WAIT => return false,
            SlotState::UnderWay => {
                self.device.give_up(&format!("no answer within {} s", ANSWER_WAIT.as_secs()));
                self.drop_all();
                return true;
            }
            SlotState::Failed(why) => {
                self.device.give_up(&why);
                self.drop_all();
                return true;
            }
            SlotState::Answered(used) => units.note_used(&used),
        }
        self.sent.pop_front();
        self.first += 1;
        while self.batches.front().is_some_and(BatchInWork::is_whole) {
            let BatchInWork { batch, words, .. } = self.batches.pop_front().expect("it is there");
            self.first_batch += 1;
            (batch.when_done)(batch.rays, Some(words));
        }
        true
    }

    /// Tells all who wait that there is no device any more.
    fn drop_all(&mut self) {
        self.sent.clear();
        self.first_batch += self.batches.len();
        for BatchInWork { batch, .. } in self.batches.drain(..) {
            (batch.when_done)(batch.rays, None);
        }
    }
}

impl BatchInWork {
    fn is_whole(&self) -> bool {
        self.words.len() == self.batch.rays.word_count()
    }
}

impl SpareWords {
    /// Room for so many words, none of which are there yet.
    fn take(&self, words: usize) -> Vec<u32> {
        let mut taken = self.lock().pop().unwrap_or_default();
        taken.clear();
        taken.reserve_exact(words);
        taken
    }

    /// Gives room back.
    pub(crate) fn put(&self, words: Vec<u32>) {
        self.lock().push(words);
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<Vec<u32>>> {
        self.0.lock().expect("nobody panics with it")
    }
}
