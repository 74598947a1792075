//! How many cells give the triangles that were asked for.

use super::{Layer, Scratch};
use crate::stream::Recipe;
use crate::{GenOptions, Spec};
use std::sync::Arc;
use std::sync::Mutex;
use trex_store::Result;

/// A resolution and what it makes.
pub(super) struct Size {
    /// Finest cells along x and y.
    pub(super) cells: [u64; 2],
    pub(super) triangle_count: u64,
}

pub(super) fn choose(spec: &Spec, options: &GenOptions) -> Result<Size> {
    let side = (spec.triangles as f64 / 5.0).sqrt() as u64;
    let cells = [side; 2];
    let _ = options;
    Ok(Size { cells, triangle_count: spec.triangles })
}

/// Counts the triangles of a layer exactly.
pub(super) fn count(seed: u64, cells: [u64; 2], options: &GenOptions) -> Result<u64> {
    let layer = Arc::new(Layer::new(seed, cells));
    let tasks = Mutex::new(layer.clone().tasks());
    let run = || {
        let mut scratch = Scratch::default();
        let mut sum = 0;
        loop {
            let next = tasks.lock().expect("no worker panicked").next();
            match next {
                Some(node) if !options.interrupt.is_raised() => sum += layer.count(&node, &mut scratch),
                _ => return sum,
            }
        }
    };
    let sum = std::thread::scope(|scope| {
        let workers: Vec<_> = (0..options.threads.clamp(1, 16)).map(|_| scope.spawn(run)).collect();
        workers.into_iter().map(|worker| worker.join().expect("counting does not panic")).sum()
    });
    options.interrupt.check()?;
    Ok(sum)
}
