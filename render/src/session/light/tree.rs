//! `TreeLight`: the light of `full-gi`, photons of the exact mesh, each by itself, in a kd-tree.
//!
//! ```text
//! at leisure   all photons into a store -> tree
//! in frames    waiting: for room, and for a tree that nobody wants any more
//!              -> growing: some whole batches of photons a frame
//!              -> building, on a thread beside the frames -> the tree takes the place of the one before
//! ```
//!
//! Invariants: 1. the tree is the same at leisure and in frames; 2. the one before is on show until it is there, unless
//! there is no room for both; 3. in frames a batch of photons is sent to its end, however long its pages take.

use super::indirect::{Arrival, IndirectLight, LightBytes, LightWork};
use crate::photon::kd_tree::{PhotonStore, PhotonTree};
use crate::photon::mesh::{BATCH, Deposit, MeshPhotons, flight_bytes};
use crate::photon::trace::{PASS_PHOTONS, send_in_passes};
use crate::scene::settings::RenderSettings;
use crate::stats::PhotonStats;
use std::ops::{ControlFlow, Range};
use std::sync::Mutex;
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};
use trex_store::{Lease, Result};

/// Time that a frame waits for the tree: little, and frames that have nothing else to do take some.
const BUILDING_WAIT: Duration = Duration::from_millis(1);

// Passes are whole batches: what landed of the last whole pass is what counts.
const _: () = assert!(PASS_PHOTONS.is_multiple_of(BATCH));

/// The tree on show, and in frames what comes after it.
#[derive(Debug, Default)]
pub(super) struct TreeLight {
    /// `None` before photons were sent.
    tree: Option<PhotonTree>,
    /// `None` when nothing is on its way.
    next: Option<NextTree>,
}

/// Photons on their way to a tree.
#[derive(Debug)]
enum NextTree {
    /// There is no room yet: a tree that nobody wants any more may still be built.
    Waiting(Option<TreeThread>),
    /// So many of all have been sent.
    Growing { store: PhotonStore, sent: u64, target: u64 },
    /// All have.
    Building { thread: TreeThread, photons: u64 },
}

/// A thread that builds a tree; joined at the latest when it is dropped.
#[derive(Debug)]
struct TreeThread {
    handle: Option<JoinHandle<PhotonTree>>,
    /// The room of its photons and of their tree, which other light can take over.
    room: Lease,
}

impl TreeLight {
    /// What the photons take at most, with those under way: in frames twice, since the light on show stays until what
    /// comes after it is there.
    pub(super) fn bytes(settings: &RenderSettings, workers: usize) -> LightBytes {
        let photons = PhotonTree::bytes(settings.photons) + flight_bytes(workers);
        LightBytes { photons, photons_in_frames: 2 * photons, ..LightBytes::default() }
    }

    /// True when photons are to be sent. A tree of fewer than are asked for goes: sending them was stopped.
    fn lacks_photons(&mut self, work: &LightWork<'_>) -> bool {
        self.tree.take_if(|tree| tree.photons() < work.world.settings.photons);
        self.tree.is_none() && work.sources().is_some()
    }
}

impl IndirectLight for TreeLight {
    fn leases_mut(&mut self) -> Vec<&mut Lease> {
        let next = match &mut self.next {
            Some(NextTree::Growing { store, .. }) => Some(store.lease_mut()),
            Some(NextTree::Building { thread, .. } | NextTree::Waiting(Some(thread))) => {
                Some(&mut thread.room)
            }
            Some(NextTree::Waiting(None)) | None => None,
        };
        self.tree.as_mut().map(PhotonTree::lease_mut).into_iter().chain(next).collect()
    }

    fn forget(&mut self) {
        self.tree = None;
    }

    /// Sends all photons; there is no tree where there is no light.
    fn illuminate(
        &mut self,
        work: &mut LightWork<'_>,
        tell: &mut dyn FnMut(u64, u64),
    ) -> Result<PhotonStats> {
        if !self.lacks_photons(work) {
            return Ok(PhotonStats::default());
        }
        let mut store = photon_store(work)?;
        let target = work.world.settings.photons;
        let send = |indices| match send_to_store(&mut store, indices, work) {
            Some(pass) => ControlFlow::Continue(pass),
            None => ControlFlow::Break(PhotonStats::default()),
        };
        let stats = send_in_passes(0..target, send, &mut |done| tell(done, target));
        self.tree = Some(store.into_tree(stats.photons));
        Ok(stats)
    }

    fn go_live(&mut self, work: &LightWork<'_>, _room: Lease) -> Result<()> {
        if self.lacks_photons(work) {
            self.next = Some(NextTree::new(work)?);
        }
        Ok(())
    }

    fn leave_frames(&mut self) {
        if self.next.take().is_some() {
            self.forget();
        }
    }

    fn restart(&mut self, work: &LightWork<'_>) {
        let next = NextTree::restarted(self.next.take());
        match work.sources() {
            Some(_) => self.next = Some(next),
            None => self.forget(),
        }
    }

    fn advance(&mut self, work: &mut LightWork<'_>, deadline: Instant) -> (u64, Arrival) {
        let next = match self.next.take() {
            None => return (0, Arrival::Nothing),
            Some(NextTree::Building { thread, .. }) if thread.is_done() => {
                self.tree = Some(thread.join());
                return (0, Arrival::Replaced);
            }
            Some(NextTree::Waiting(abandoned)) if abandoned.as_ref().is_none_or(TreeThread::is_done) => {
                drop(abandoned);
                let begun = NextTree::new(work).or_else(|_| {
                    // No room for both: the light on show goes.
                    self.tree = None;
                    NextTree::new(work)
                });
                begun.unwrap_or(NextTree::Waiting(None))
            }
            Some(next) => next,
        };
        let (next, rays) = next.grow(work, deadline);
        self.next = Some(next);
        (rays, Arrival::Nothing)
    }

    fn share(&self) -> f64 {
        self.next.as_ref().map_or(1.0, NextTree::share)
    }

    fn is_whole(&self) -> bool {
        self.next.is_none()
    }

    fn photon_tree(&self) -> Option<&PhotonTree> {
        self.tree.as_ref()
    }
}

impl NextTree {
    /// A tree of which nothing is there yet.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for the photons beside those on show.
    fn new(work: &LightWork<'_>) -> Result<NextTree> {
        Ok(NextTree::Growing { store: photon_store(work)?, sent: 0, target: work.world.settings.photons })
    }

    /// The tree that comes when light has changed again: what was on its way is out of date.
    fn restarted(before: Option<NextTree>) -> NextTree {
        match before {
            Some(NextTree::Building { thread, .. } | NextTree::Waiting(Some(thread))) => {
                NextTree::Waiting(Some(thread))
            }
            Some(NextTree::Growing { .. } | NextTree::Waiting(None)) | None => NextTree::Waiting(None),
        }
    }

    /// Share of the photons of the tree that have landed, less than 1 until it is there.
    fn share(&self) -> f64 {
        let (landed, target) = match *self {
            NextTree::Waiting(_) => (0, 0),
            NextTree::Growing { sent, target, .. } => (sent, target),
            NextTree::Building { photons, .. } => (photons, photons),
        };
        landed as f64 / (target + 1) as f64
    }

    /// Sends photons until `deadline` has passed or the work stops: whole batches, at least one a worker. Gives what is
    /// still to come, and the count of rays.
    fn grow(self, work: &mut LightWork<'_>, deadline: Instant) -> (NextTree, u64) {
        let NextTree::Growing { mut store, mut sent, target } = self else { return (self, 0) };
        let slice = BATCH * work.tracers.count() as u64;
        let mut stats = PhotonStats::default();
        while sent < target {
            let end = target.min(sent + slice);
            let Some(landed) = send_to_store(&mut store, sent..end, work) else { break };
            stats.add(&landed);
            sent = end;
            if Instant::now() >= deadline {
                break;
            }
        }
        if sent < target {
            return (NextTree::Growing { store, sent, target }, stats.rays);
        }
        (NextTree::Building { thread: TreeThread::start(store, target), photons: target }, stats.rays)
    }
}

impl TreeThread {
    /// A thread that builds the tree of so many photons. Not on the pool of the workers: frames would wait for it.
    fn start(mut store: PhotonStore, photons: u64) -> TreeThread {
        let bytes = store.lease_mut().bytes();
        let room = store.lease_mut().split(bytes);
        let build = move || store.into_tree(photons);
        let thread = Builder::new().name("trex-photon-tree".to_owned()).spawn(build);
        TreeThread { handle: Some(thread.expect("a thread can be begun")), room }
    }

    /// True when the tree is there, after a moment's wait.
    fn is_done(&self) -> bool {
        let is_done = || self.handle.as_ref().is_none_or(JoinHandle::is_finished);
        if !is_done() {
            std::thread::sleep(BUILDING_WAIT);
        }
        is_done()
    }

    fn join(mut self) -> PhotonTree {
        let thread = self.handle.take().expect("it is joined once");
        let room = self.room.split(self.room.bytes());
        thread.join().expect("the tree of photons was not built").in_lease(room)
    }
}

impl Drop for TreeThread {
    fn drop(&mut self) {
        if let Some(thread) = self.handle.take() {
            // Nobody wants its tree any more.
            let _ = thread.join();
        }
    }
}

/// Room for all photons that the settings ask for.
///
/// # Errors
/// [`trex_store::Code::MemoryLimit`] when the budget has no room for them, and for those under way.
fn photon_store(work: &LightWork<'_>) -> Result<PhotonStore> {
    let flights = flight_bytes(work.tracers.count());
    let center = work.model.bounds.center().into();
    PhotonStore::new(work.world.settings.photons, center, flights, work.budget)
}

/// Sends the photons with these indices, from a whole batch on, through the mesh. `None` when it was stopped: some
/// batches have landed then, and are to be sent again with the others.
fn send_to_store(
    store: &mut PhotonStore,
    indices: Range<u64>,
    work: &mut LightWork<'_>,
) -> Option<PhotonStats> {
    let LightWork { world, pool, stop, .. } = *work;
    let sources = work.sources()?;
    let store = Mutex::new(store);
    let land = |batch, deposits: &[Deposit]| {
        store.lock().expect("a worker panicked").land(batch, deposits);
        deposits.len() as u64
    };
    let photons = MeshPhotons { world, sources: &sources, land: &land, stop, pool };
    work.tracers.trace(&photons, indices)
}
