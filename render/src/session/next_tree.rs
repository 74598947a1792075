//! `NextTree`: the photons of `full-gi` of light that has changed, sent while frames go on; when all have landed their
//! tree is built beside the frames, and takes the place of the one before.
//!
//! ```text
//! growing: some whole batches of photons a frame -> building, on a thread of the pool -> there
//! ```
//!
//! Invariants: 1. the tree is that of [`Session::illuminate`]; 2. the one before is on show until it is there.

use super::Session;
use crate::photon::kd_tree::{PhotonStore, PhotonTree};
use crate::photon::mesh::BATCH;
use crate::stats::PhotonStats;
use crate::trace::PagedTracer;
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::time::{Duration, Instant};
use trex_store::Result;

/// Time that a frame waits for the tree: little, and frames that have nothing else to do take some.
const BUILDING_WAIT: Duration = Duration::from_millis(1);

/// Photons on their way to a tree.
#[derive(Debug)]
pub(super) enum NextTree {
    /// So many have been sent.
    Growing { store: PhotonStore, sent: u64 },
    /// All have.
    Building(Receiver<PhotonTree>),
}

impl NextTree {
    /// A tree of `session`'s light, of which nothing is there yet.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for the photons beside those on show.
    pub(super) fn new<T: PagedTracer + Send>(session: &Session<T>) -> Result<NextTree> {
        Ok(NextTree::Growing { store: session.photon_store()?, sent: 0 })
    }

    /// Share of the photons that have landed, 0 to 1.
    pub(super) fn share(&self, target: u64) -> f64 {
        match self {
            NextTree::Growing { sent, .. } => *sent as f64 / target.max(1) as f64,
            NextTree::Building(_) => 1.0,
        }
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
        let (mut store, mut sent) = match self {
            NextTree::Growing { store, sent } => (store, sent),
            NextTree::Building(tree) => {
                let built = match tree.recv_timeout(BUILDING_WAIT) {
                    Ok(tree) => Ok(tree),
                    Err(RecvTimeoutError::Timeout) => Err(NextTree::Building(tree)),
                    Err(RecvTimeoutError::Disconnected) => panic!("the tree of photons was not built"),
                };
                return (built, 0);
            }
        };
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
        let (tell, tree) = channel();
        session.pool.spawn(move || {
            // Nobody waits for it when light has changed again.
            let _ = tell.send(store.into_tree(target));
        });
        (Err(NextTree::Building(tree)), stats.rays)
    }
}
