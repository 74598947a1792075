//! Pages of which all clusters are unpacked.

use trex_store::cluster::FrameView;
use trex_store::pool::{PagePool, Pin};

/// Brings pages of the mesh and unpacks all of their clusters, by so many threads.
pub(super) fn all(pool: &PagePool, order: &[u32], threads: usize) -> trex_store::Result<()> {
    std::thread::scope(|scope| {
        let parts = order.chunks(order.len().div_ceil(threads).max(1));
        let unpack = |part| {
            let unpack = &mut |pin: Pin<'_>| FrameView::new(pin.frame()).for_each_cluster(|_| {});
            pool.visit_blocking(part, unpack)
        };
        let running: Vec<_> = parts.map(|part| scope.spawn(move || unpack(part))).collect();
        // Where one fails, the scope waits for the others.
        running.into_iter().try_for_each(|thread| thread.join().expect("a thread that does not panic"))
    })
}
