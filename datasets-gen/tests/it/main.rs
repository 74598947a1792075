//! What every generator promises, and what the writers promise. One binary, a module per theme.

mod files;
mod streams;
mod surfaces;

use datasets_gen::{GenOptions, Kind, Spec};
use trex_store::{TriangleBatch, TriangleSource};

/// The stream of a spec with seed 1.
fn open(kind: Kind, triangles: u64, threads: usize) -> Box<dyn TriangleSource> {
    open_seeded(Spec { kind, triangles, seed: 1, colours: None }, threads)
}

fn open_seeded(spec: Spec, threads: usize) -> Box<dyn TriangleSource> {
    datasets_gen::open(&spec, &GenOptions { threads, ..GenOptions::default() }).unwrap()
}

/// The whole stream as one batch.
fn collect(source: &mut dyn TriangleSource) -> TriangleBatch {
    let (mut all, mut batch) = (TriangleBatch::default(), TriangleBatch::default());
    while source.next_batch(&mut batch).unwrap() {
        assert_eq!(batch.corners.len(), batch.material.len());
        assert!(batch.len() <= 2 * TriangleBatch::TARGET_TRIANGLES);
        all.corners.extend_from_slice(&batch.corners);
        all.material.extend_from_slice(&batch.material);
    }
    assert!(batch.is_empty());
    all
}
