//! `PageTrace`: the pages that a session asks for, turn by turn.
//!
//! A worker of the pool pins a page when a ray first asks for it, and keeps it until its next turn, a tile or a batch.
//! So each page counts once a turn, in the order of the first rays that ask.
//!
//! Invariant: nothing is missing while a trace is recorded, and one worker makes it: the pages of a view are those that
//! its rays ask for, in the order of its tiles.

use crate::model::{Model, Surroundings};
use crate::stress::{self, Stand, StressOptions};
use std::cell::{Cell, RefCell};
use std::num::NonZero;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use trex_model::OpenOptions;
use trex_render::{
    AllResident, Answer, CpuStage, FrameOptions, Hit, Layers, Page, PagedMesh, PagedTracer, Pages, Ray,
    Scene, Session, SessionSetup, ShadedHit, Tracer, WorkerThreads,
};
use trex_store::layout::FRAME_BYTES;
use trex_store::{PageFile, StopSignal};

/// Side of the pictures, pixels: what `trex stress` makes.
const SIDE: u32 = 512;

/// Pages in the order in which they were asked for.
pub(super) struct PageTrace {
    asked: Vec<u32>,
}

impl PageTrace {
    /// Of these pages.
    #[cfg(test)]
    pub(super) fn of(pages: &[u32]) -> PageTrace {
        PageTrace { asked: pages.to_vec() }
    }

    /// All of them.
    pub(super) fn pages(&self) -> impl DoubleEndedIterator<Item = u32> + ExactSizeIterator {
        self.asked.iter().copied()
    }

    /// How many.
    pub(super) fn len(&self) -> usize {
        self.asked.len()
    }

    /// Beyond the greatest of them.
    pub(super) fn page_end(&self) -> usize {
        self.asked.iter().max().map_or(0, |&page| page as usize + 1)
    }

    /// Different ones.
    pub(super) fn different(&self) -> usize {
        let mut seen = vec![false; self.page_end()];
        self.pages().filter(|&page| !std::mem::replace(&mut seen[page as usize], true)).count()
    }
}

/// Runs the scenario of `options` with all pages of `model` in memory.
pub(super) fn record(
    model: &Model,
    options: &StressOptions,
    around: &Surroundings,
) -> anyhow::Result<(Arc<PageFile>, PageTrace)> {
    let budget = &around.budget;
    let open = OpenOptions { budget: budget.clone(), ..OpenOptions::with_limit(budget.limit_bytes()) };
    let opened = trex_model::Model::open(&model.path, &open)?;
    let file = opened.file().clone();
    let _lease = budget.lease("all pages", (file.pages().len() * FRAME_BYTES) as u64)?;
    let pages = AllResident::load(&file);

    // What the scene leaves to be decided is decided as the command does it.
    let mut scene = Scene::of_file();
    scene.begin_live();
    scene.render.resolution = [SIDE; 2];
    let decided = opened.session(&scene)?;
    let log = Arc::<Mutex<TraceLog>>::default();
    let recorder = Recorder {
        pages: &pages,
        is_asked: vec![Cell::new(false); file.pages().len()],
        turn: RefCell::default(),
        log: log.clone(),
    };
    let setup = SessionSetup {
        model: decided.model().clone(),
        view: decided.view().clone(),
        layers: Layers::default(),
        portion: None,
        tracers: vec![RecordingTracer(PagedMesh::new(&file, recorder))],
        pool: WorkerThreads::start(NonZero::<usize>::MIN.get())?,
        g_stage: Box::new(CpuStage::default()),
    };
    let pool = opened.pool().expect("a session has a pool");
    let mut session = Session::new(setup, budget)?;
    drop(decided);
    session.illuminate(&|| around.interrupt.is_raised(), &mut |_, _| {})?;
    let frames = FrameOptions::default();
    let t_max = frames.t_max;
    let mut session = session.go_live(frames)?;
    // What the light and the first look have asked for is not of the scenario, nor is the turn that has begun.
    *lock(&log) = TraceLog { asked: vec![], begins: true };
    let stand =
        Stand { pool: &pool, resident_bytes: &|| None, interrupt: &around.interrupt, tell: &|_| {}, t_max };
    stress::run(&mut session, options, None, &stand)?;
    drop(session);
    let asked = std::mem::take(&mut lock(&log).asked);
    anyhow::ensure!(!asked.is_empty(), "no ray of {} has asked for a page", model.scene);
    Ok((file, PageTrace { asked }))
}

/// What was asked for.
#[derive(Default)]
struct TraceLog {
    asked: Vec<u32>,
    /// True until the turn that was under way when it began is over.
    begins: bool,
}

fn lock(log: &Mutex<TraceLog>) -> MutexGuard<'_, TraceLog> {
    log.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Pages that are all there, and say which were asked for.
struct Recorder<'a> {
    pages: &'a AllResident,
    /// Of the turn.
    is_asked: Vec<Cell<bool>>,
    turn: RefCell<Vec<u32>>,
    log: Arc<Mutex<TraceLog>>,
}

impl Recorder<'_> {
    /// Adds the turn to the log.
    fn end_turn(&mut self) {
        let turn = self.turn.get_mut();
        turn.iter().for_each(|&page| self.is_asked[page as usize].set(false));
        let mut log = lock(&self.log);
        match std::mem::take(&mut log.begins) {
            true => turn.clear(),
            false => log.asked.append(turn),
        }
    }
}

impl Pages for Recorder<'_> {
    fn page(&mut self, page: u32) -> Page<'_> {
        self.hold(page).expect("all are there")
    }

    fn hold(&self, page: u32) -> Option<Page<'_>> {
        if !self.is_asked[page as usize].replace(true) {
            self.turn.borrow_mut().push(page);
        }
        Some(Page::Ready(self.pages.frame(page).into()))
    }
}

impl Drop for Recorder<'_> {
    fn drop(&mut self) {
        self.end_turn();
    }
}

/// The tracer of the session.
struct RecordingTracer<'a>(PagedMesh<Recorder<'a>>);

impl Tracer for RecordingTracer<'_> {
    fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
        self.0.intersect(ray)
    }

    fn occluded(&mut self, ray: &Ray) -> Answer<bool> {
        self.0.occluded(ray)
    }

    fn shade(&mut self, hit: Hit) -> Answer<ShadedHit> {
        self.0.shade(hit)
    }

    fn intersect_coherent(&mut self, rays: &[Ray], answers: &mut Vec<Answer<Option<Hit>>>) {
        self.0.intersect_coherent(rays, answers);
    }

    fn occluded_coherent(&mut self, rays: &[Ray], answers: &mut Vec<Answer<bool>>) {
        self.0.occluded_coherent(rays, answers);
    }

    fn lend_pages(&mut self) -> &mut dyn Pages {
        self.0.lend_pages()
    }
}

impl PagedTracer for RecordingTracer<'_> {
    fn begin_tile(&mut self) {
        self.0.pages_mut().end_turn();
    }

    fn request_missing(&mut self) -> usize {
        0
    }

    fn stop_by(&mut self, _stop: &StopSignal) {}

    fn wait(&mut self, _longest: Duration) {}
}
