//! `NextTree`: the photons of `full-gi` of light that has changed, sent while frames go on; when all have landed their
//! tree is built on a thread beside the frames, and takes the place of the one before.
//!
//! ```text
//! waiting: for room, and for a tree that nobody wants any more -> growing: some whole batches of photons a frame
//!                                                              -> building -> there
//! ```
//!
//! Invariants: 1. the tree is that of [`Session::illuminate`]; 2. the one before is on show until it is there, unless
//! there is no room for both; 3. a batch of photons is sent to its end, however long its pages take.

use super::Session;
use crate::photon::kd_tree::{PhotonStore, PhotonTree};
use crate::photon::mesh::BATCH;
use crate::stats::PhotonStats;
use crate::trace::PagedTracer;
use std::thread::{Builder, JoinHandle};
use std::time::{Duration, Instant};
use trex_store::Result;

/// Time that a frame waits for the tree: little, and frames that have nothing else to do take some.
const BUILDING_WAIT: Duration = Duration::from_millis(1);

/// Photons on their way to a tree.
#[derive(Debug)]
pub(super) enum NextTree {
    /// There is no room yet: a tree that nobody wants any more may still be built.
    Waiting(Option<TreeThread>),
    /// So many have been sent.
    Growing { store: PhotonStore, sent: u64 },
    /// All have.
    Building(TreeThread),
}

/// A thread that builds a tree; joined at the latest when it is dropped.
#[derive(Debug)]
pub(super) struct TreeThread(Option<JoinHandle<PhotonTree>>);

impl NextTree {
    /// A tree of `session`'s light, of which nothing is there yet.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for the photons beside those on show.
    pub(super) fn new<T: PagedTracer + Send>(session: &Session<T>) -> Result<NextTree> {
        Ok(NextTree::Growing { store: session.photon_store()?, sent: 0 })
    }

    /// The tree that comes when light has changed again: what was on its way is out of date.
    pub(super) fn again(before: Option<NextTree>) -> NextTree {
        match before {
            Some(NextTree::Building(thread) | NextTree::Waiting(Some(thread))) => {
                NextTree::Waiting(Some(thread))
            }
            Some(NextTree::Growing { .. } | NextTree::Waiting(None)) | None => NextTree::Waiting(None),
        }
    }

    /// Share of the photons of the tree that have landed, less than 1 until it is there.
    pub(super) fn share(&self, target: u64) -> f64 {
        let landed = match self {
            NextTree::Waiting(_) => 0,
            NextTree::Growing { sent, .. } => *sent,
            NextTree::Building(_) => target,
        };
        landed as f64 / (target + 1) as f64
    }

    /// Sends photons until `deadline` has passed or `stop` says so: whole batches, at least one a worker. Gives what is
    /// still to come, or the tree, and the count of rays.
    ///
    /// # Panics
    /// When the building of the tree did.
    pub(super) fn go_on<T: PagedTracer + Send>(
        self,
        session: &mut Session<T>,
        deadline: Instant,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> (std::result::Result<PhotonTree, NextTree>, u64) {
        let (store, sent) = match self {
            NextTree::Growing { store, sent } => (store, sent),
            NextTree::Waiting(Some(thread)) if !thread.is_done() => {
                return (Err(NextTree::Waiting(Some(thread))), 0);
            }
            NextTree::Waiting(abandoned) => {
                drop(abandoned);
                let begun = session.photon_store().or_else(|_| {
                    // No room for both: the light on show goes.
                    session.photon_tree = None;
                    session.photon_store()
                });
                match begun {
                    Ok(store) => (store, 0),
                    Err(_) => return (Err(NextTree::Waiting(None)), 0),
                }
            }
            NextTree::Building(thread) if thread.is_done() => return (Ok(thread.join()), 0),
            NextTree::Building(thread) => return (Err(NextTree::Building(thread)), 0),
        };
        NextTree::grow((store, sent), session, deadline, stop)
    }

    /// Sends more photons to a store that has so many.
    fn grow<T: PagedTracer + Send>(
        (mut store, mut sent): (PhotonStore, u64),
        session: &mut Session<T>,
        deadline: Instant,
        stop: &(dyn Fn() -> bool + Sync),
    ) -> (std::result::Result<PhotonTree, NextTree>, u64) {
        let target = session.view.settings.photons;
        let slice = BATCH * session.tracers.len() as u64;
        let mut stats = PhotonStats::default();
        while sent < target {
            let end = target.min(sent + slice);
            let Some(landed) = session.send_to_store(&mut store, sent..end, stop) else { break };
            stats.add(&landed);
            sent = end;
            if Instant::now() >= deadline {
                break;
            }
        }
        if sent < target {
            return (Err(NextTree::Growing { store, sent }), stats.rays);
        }
        // Not on the pool of the workers: frames would wait for it.
        let build = move || store.into_tree(target);
        let thread = Builder::new().name("trex-photon-tree".to_owned()).spawn(build);
        let thread = TreeThread(Some(thread.expect("a thread can be begun")));
        (Err(NextTree::Building(thread)), stats.rays)
    }
}

impl TreeThread {
    /// True when the tree is there, after a moment's wait.
    fn is_done(&self) -> bool {
        let is_done = || self.0.as_ref().is_none_or(JoinHandle::is_finished);
        if !is_done() {
            std::thread::sleep(BUILDING_WAIT);
        }
        is_done()
    }

    fn join(mut self) -> PhotonTree {
        let thread = self.0.take().expect("it is joined once");
        thread.join().expect("the tree of photons was not built")
    }
}

impl Drop for TreeThread {
    fn drop(&mut self) {
        if let Some(thread) = self.0.take() {
            // Nobody wants its tree any more.
            let _ = thread.join();
        }
    }
}
