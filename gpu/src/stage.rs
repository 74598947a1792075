//! `GpuStage`: the G-stage on a device.
//!
//! ```text
//! submit -> no units:  pack -> worker -> answers -> the call arrives later
//!        -> units:     pack -> worker -> wanted pages: lent ones are copied to the device, and their rays asked again
//!                                        missing ones block, or coarser voxels stand in
//!                      some rounds without an end -> the processor answers what is left
//!        -> the device is lost, or cannot hold the octree: the processor answers
//! ```
//!
//! Invariants: 1. which device answers a ray does not depend on the rays beside it, but where the device cannot
//! answer it at all; 2. rays in units are answered while their pages are lent; 3. an octree that is refused leaves the
//! one before it, on the device and on the processor alike.

use crate::device::{GpuDevice, count};
use crate::kernels::{Kernels, StepCounts};
use crate::packing::{DeviceAnswer, PackedRays};
use crate::slots::Slots;
use crate::units::UnitUpload;
use crate::worker::{Batch, Completion, Request, SpareWords, Worker};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::mpsc::{SyncSender, channel, sync_channel};
use std::thread::JoinHandle;
use trex_render::{
    CpuStage, GAnswer, GCall, GEnd, GNeeds, GRay, GRays, GStage, GTurn, GUnits, GView, MissingUnits, Page,
    Pages, Voxels,
};
use trex_store::{Code, Error, Result};

/// Rays of a batch of a hardware device: what a worker keeps while it goes on with other tiles.
const HARDWARE_RAYS: usize = 1 << 14;
/// Batches that a hardware device is given together, to fill it.
const HARDWARE_BATCHES: usize = 8;
/// Batches that a worker has under way: the answer of a hardware device comes as late as some tiles take.
const HARDWARE_CALLS: usize = 4;
/// Rays of a batch of a software device: those of the processor.
const SOFTWARE_RAYS: usize = 1 << 12;
/// Requests that wait for the thread; who makes more waits.
const REQUESTS_MAX: usize = 64;
/// Rounds in which rays get pages of units that they want, and after which the processor answers.
const ROUNDS_MAX: usize = 24;
/// Pages that go to the device in a round.
const ROUND_PAGES_MAX: usize = 64;

/// What becomes of an octree that the device cannot hold.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WhenTooLarge {
    /// It is an error: the device was asked for by name.
    #[default]
    Refuse,
    /// The processor answers.
    UseProcessor,
}

/// A stage whose rays a device answers.
#[derive(Debug)]
pub struct GpuStage {
    device: Arc<GpuDevice>,
    processor: CpuStage,
    /// The octree that the processor has, and the device where it has room.
    octree: Option<Arc<Voxels>>,
    when_too_large: WhenTooLarge,
    requests: Option<SyncSender<Request>>,
    spare_words: Arc<SpareWords>,
    thread: Option<JoinHandle<()>>,
    /// Pages of units that have room on the device; `None` while the processor answers all.
    unit_slots: Option<usize>,
    has_units: bool,
}

/// The pages of calls that ask no units.
struct NoUnits;

impl Pages for NoUnits {
    fn page(&mut self, _page: u32) -> Page<'_> {
        Page::Damaged
    }
}

impl GpuStage {
    /// A stage on a device.
    ///
    /// # Errors
    /// [`Code::NoAdapter`] when its driver refuses the kernels; [`Code::Io`] when the system refuses a thread.
    pub fn new(device: Arc<GpuDevice>, when_too_large: WhenTooLarge) -> Result<GpuStage> {
        GpuStage::counting(device, when_too_large, StepCounts::Off)
    }

    /// A stage on a device, whose kernels count their steps, or not.
    ///
    /// # Errors
    /// Those of [`GpuStage::new`].
    pub fn counting(
        device: Arc<GpuDevice>,
        when_too_large: WhenTooLarge,
        steps: StepCounts,
    ) -> Result<GpuStage> {
        let kernels = Kernels::new(&device, steps)?;
        let spare_words = Arc::<SpareWords>::default();
        let worker = Worker::new(device.clone(), kernels, GpuStage::slot_rays(&device), spare_words.clone());
        let (requests, received) = sync_channel(REQUESTS_MAX);
        let thread = std::thread::Builder::new().name("trex-gpu".into()).spawn(move || worker.run(&received));
        let thread = thread.map_err(|error| Error::thread_refused("the thread of the GPU", &error))?;
        Ok(GpuStage {
            device,
            processor: CpuStage::default(),
            octree: None,
            when_too_large,
            requests: Some(requests),
            spare_words,
            thread: Some(thread),
            unit_slots: None,
            has_units: false,
        })
    }

    /// What a stage on this device asks of who calls it.
    pub fn needs_of(device: &GpuDevice) -> GNeeds {
        GNeeds {
            batch_rays: GpuStage::batch_rays(device),
            ray_bytes: PackedRays::RAY_BYTES + CpuStage::NEEDS.ray_bytes,
            calls: if device.report().is_hardware { HARDWARE_CALLS } else { 2 },
            photons: GpuStage::batch_rays(device) / 8,
        }
    }

    /// Bytes of video memory that rays under way and their answers take.
    pub fn batch_bytes(device: &GpuDevice) -> u64 {
        Slots::bytes(GpuStage::slot_rays(device))
    }

    fn batch_rays(device: &GpuDevice) -> usize {
        if device.report().is_hardware { HARDWARE_RAYS } else { SOFTWARE_RAYS }
    }

    /// Rays of a slot.
    fn slot_rays(device: &GpuDevice) -> usize {
        let batches = if device.report().is_hardware { HARDWARE_BATCHES } else { 1 };
        batches * GpuStage::batch_rays(device)
    }

    /// Gives an octree to the processor and to the device; while the device has none, the processor answers.
    fn install(&mut self, octree: &Arc<Voxels>) -> Result<()> {
        self.processor.set_octree(octree)?;
        self.has_units = octree.links().is_some();
        self.unit_slots = None;
        let (told, outcome) = channel();
        self.ask(Request::Octree(octree.clone(), told));
        self.unit_slots = Some(outcome.recv().expect("the thread of the GPU answers")?);
        Ok(())
    }

    fn ask(&self, request: Request) {
        let requests = self.requests.as_ref().expect("until it is dropped");
        requests.send(request).expect("the thread of the GPU lives as long as the stage");
    }

    /// Answers a call without units later: its words become answers in the thread that waits for them.
    fn answer_later(&self, mut call: GCall) -> GTurn {
        let (to, turn) = channel();
        let (processor, device, view) = (self.processor.clone(), self.device.clone(), call.view);
        let spare_words = self.spare_words.clone();
        let rays = PackedRays::of_call(&call);
        let when_done: Completion = Box::new(move |rays, words| {
            let end: GEnd = Box::new(move || {
                let Some(words) = words else {
                    return by_processor(call, &processor, &device, &mut NoUnits);
                };
                let mut answers = rays.in_words(&words);
                put_back(&mut call, |ray| answers.of(ray), (&processor, &device), &mut NoUnits);
                spare_words.put(words);
                call
            });
            // Who asked may have given up.
            let _ = to.send(end);
        });
        let (occluders, uploads) = (view.occluders, Vec::new());
        self.ask(Request::Batch(Batch { rays, occluders, asks_units: false, uploads, when_done }));
        GTurn::UnderWay(turn)
    }

    /// Asks the device, and waits: the answer of each ray by its place; false when it is lost.
    fn ask_now(
        &self,
        batch: (PackedRays, Vec<UnitUpload>),
        view: GView,
        answers: &mut [DeviceAnswer],
    ) -> bool {
        let (to, arrived) = channel();
        let when_done: Completion = Box::new(move |rays, words| {
            // Who asked may have given up.
            let _ = to.send((rays, words));
        });
        let (rays, uploads) = batch;
        let occluders = view.occluders;
        self.ask(Request::Batch(Batch { rays, occluders, asks_units: true, uploads, when_done }));
        let Ok((rays, Some(words))) = arrived.recv() else { return false };
        rays.answers(&words, |place, answer| answers[place as usize] = answer);
        self.spare_words.put(words);
        true
    }

    /// Answers a call whose rays may go on into units.
    fn answer_in_units(&self, mut call: GCall, missing: MissingUnits, pages: &mut dyn Pages) -> GCall {
        let all: Vec<&GRay> = call.parts.iter().flat_map(|part| part.rays()).collect();
        let mut answers = vec![DeviceAnswer::None; all.len()];
        let mut open: Vec<u32> = (0..all.len() as u32).collect();
        let mut uploads = Vec::new();
        for _ in 0..ROUNDS_MAX {
            let rays = PackedRays::new(&all, open.iter().copied());
            if !self.ask_now((rays, std::mem::take(&mut uploads)), call.view, &mut answers) {
                drop(all);
                return by_processor(call, &self.processor, &self.device, pages);
            }
            let mut looked_up = LookUps::default();
            open.retain(|&place| looked_up.is_to_ask_again(&mut answers[place as usize], missing, pages));
            uploads = looked_up.uploads;
            if open.is_empty() || uploads.is_empty() {
                break;
            }
        }
        open.iter().for_each(|&place| answers[place as usize] = DeviceAnswer::None);
        drop(all);
        let mut answers = answers.into_iter();
        let answer_of = |_: &GRay| answers.next().expect("one a ray");
        put_back(&mut call, answer_of, (&self.processor, &self.device), pages);
        call
    }
}

/// Pages that rays of a round want.
#[derive(Default)]
struct LookUps {
    uploads: Vec<UnitUpload>,
    pages: BTreeSet<u32>,
}

impl LookUps {
    /// Looks up the page that a ray wants: false where its answer is final.
    fn is_to_ask_again(
        &mut self,
        answer: &mut DeviceAnswer,
        missing: MissingUnits,
        pages: &mut dyn Pages,
    ) -> bool {
        let &mut DeviceAnswer::Wants(page, coarser) = answer else { return false };
        if self.pages.contains(&page) {
            return true;
        }
        let is_full = self.uploads.len() == ROUND_PAGES_MAX;
        match pages.page(page) {
            Page::Ready(_) | Page::Damaged if is_full => true,
            Page::Ready(frame) => {
                self.uploads.push(UnitUpload { page, frame: Some(frame.bytes().into()) });
                self.pages.insert(page)
            }
            Page::Damaged => {
                self.uploads.push(UnitUpload { page, frame: None });
                self.pages.insert(page)
            }
            Page::Missing => {
                pages.want(page);
                *answer = DeviceAnswer::Whole(match missing {
                    MissingUnits::Block => GAnswer::bare(GAnswer::BLOCKED),
                    MissingUnits::StandIn => coarser,
                });
                false
            }
        }
    }
}

/// Puts answers, in the order of asking, where their rays are; rays that there are none of are the processor's.
fn put_back(
    call: &mut GCall,
    mut answer_of: impl FnMut(&GRay) -> DeviceAnswer,
    (processor, device): (&CpuStage, &GpuDevice),
    pages: &mut dyn Pages,
) {
    let mut left = GRays::default();
    let mut left_places = Vec::new();
    for (number, part) in call.parts.iter_mut().enumerate() {
        let (rays, places) = part.parts_mut();
        for (at, (ray, place)) in rays.iter().zip(places).enumerate() {
            match answer_of(ray) {
                DeviceAnswer::Whole(answer) => *place = answer,
                DeviceAnswer::Wants(..) | DeviceAnswer::None => {
                    left.push(*ray);
                    left_places.push((number, at));
                }
            }
        }
    }
    if left_places.is_empty() {
        return;
    }
    let call_of_left = GCall { view: call.view, parts: vec![left] };
    let answered = by_processor(call_of_left, processor, device, pages);
    for ((part, at), answer) in left_places.into_iter().zip(answered.parts[0].answers()) {
        call.parts[part].set_answer(at, *answer);
    }
}

/// The call, answered by the processor.
fn by_processor(call: GCall, processor: &CpuStage, device: &GpuDevice, pages: &mut dyn Pages) -> GCall {
    let rays: usize = call.parts.iter().map(|part| part.rays().len()).sum();
    count(&device.counters.processor_rays, rays as u64);
    processor.submit(call, pages).wait()
}

impl GStage for GpuStage {
    fn set_octree(&mut self, octree: &Arc<Voxels>) -> Result<()> {
        let refused = match self.install(octree) {
            Err(error)
                if !(self.when_too_large == WhenTooLarge::UseProcessor
                    && error.code() == Code::MemoryLimit) =>
            {
                error
            }
            outcome => {
                if let Err(error) = outcome {
                    self.device.note(&error);
                }
                self.octree = Some(octree.clone());
                return Ok(());
            }
        };
        // What is on show stays as it is, so its rays have to meet the octree before.
        if let Some(before) = self.octree.clone()
            && let Err(error) = self.install(&before)
        {
            self.device.note(&error);
        }
        Err(refused)
    }

    fn needs(&self) -> GNeeds {
        GpuStage::needs_of(&self.device)
    }

    fn submit(&self, mut call: GCall, pages: &mut dyn Pages) -> GTurn {
        let Some(unit_slots) = self.unit_slots.filter(|_| self.device.lost().is_none()) else {
            return GTurn::Answered(by_processor(call, &self.processor, &self.device, pages));
        };
        if call.parts.iter().all(|part| part.rays().is_empty()) {
            // Nothing is asked; the parts are answered, all the same.
            put_back(&mut call, |_| DeviceAnswer::None, (&self.processor, &self.device), pages);
            return GTurn::Answered(call);
        }
        match call.view.units {
            GUnits::On(_) if self.has_units && unit_slots == 0 => {
                GTurn::Answered(by_processor(call, &self.processor, &self.device, pages))
            }
            GUnits::On(missing) if self.has_units => {
                GTurn::Answered(self.answer_in_units(call, missing, pages))
            }
            GUnits::On(_) | GUnits::None => self.answer_later(call),
        }
    }
}

impl Drop for GpuStage {
    fn drop(&mut self) {
        self.requests = None;
        if let Some(thread) = self.thread.take() {
            // Its panic was told when it came.
            let _ = thread.join();
        }
    }
}
