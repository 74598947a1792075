//! The scan pass: bounds, edges and counts of the input, by which the lattice is chosen.
//!
//! Invariant: the median edge is never overstated: the histogram gives the lower end of its bin.

pub(super) mod lattice;
pub(super) mod rejected;

pub(crate) use lattice::Grid;

use crate::attributes::AttributeSet;
use crate::build::options::BuildOptions;
use crate::build::report::PhaseReport;
use crate::error::Result;
use crate::geom::{Aabb, Lattice};
use crate::source::{TriangleBatch, TriangleSource};
use crate::stated_lattice::LatticeCheck;
use std::time::Instant;

/// Bounds, edges and counts of the input, known before the lattice is chosen.
#[derive(Clone, Copy, Debug)]
pub struct Scan {
    /// Box of the finite vertices.
    pub bounds: Aabb,
    /// At most the median edge length, model units; 0 when there is no edge.
    pub median_edge: f64,
    /// Triangles to come (generators: within 1 %).
    pub triangle_count: u64,
    /// Triangles among them with a coordinate that is no finite number.
    pub non_finite_count: u64,
    /// The lattice that all of its vertices lie on, where the input states one.
    pub lattice: Option<Lattice>,
    /// What corners have beside their places.
    pub attributes: AttributeSet,
}

/// Asks the source, or reads it once.
pub(crate) fn scan(
    source: &mut dyn TriangleSource,
    options: &BuildOptions,
    report: PhaseReport<'_>,
    wait_ms: &mut u64,
) -> Result<Scan> {
    if let Some(hint) = source.hint() {
        let (bounds, median_edge) = (hint.bounds, hint.median_edge);
        let triangle_count = hint.triangle_count;
        let attributes = hint.attributes;
        let (non_finite_count, lattice) = (0, None);
        return Ok(Scan { bounds, median_edge, triangle_count, non_finite_count, lattice, attributes });
    }
    let bytes = TriangleBatch::bytes(AttributeSet::ALL) + EdgeHistogram::BYTES;
    let _lease = options.budget.lease("a batch of triangles", bytes)?;
    let mut batch = TriangleBatch::default();
    let (mut bounds, mut edges) = (Aabb::EMPTY, EdgeHistogram::new());
    let (mut triangle_count, mut non_finite_count, mut stated) = (0, 0, LatticeCheck::default());
    let (mut attributes, mut waited) = (AttributeSet::default(), std::time::Duration::ZERO);
    loop {
        let before = Instant::now();
        let more = source.next_batch(&mut batch)?;
        waited += before.elapsed();
        if !more {
            break;
        }
        options.interrupt.check()?;
        triangle_count += batch.len() as u64;
        stated.add(source.lattice(), &batch.corners);
        attributes = attributes.union(batch.attributes.set());
        for corners in &batch.corners {
            if !corners.as_flattened().iter().all(|v| v.is_finite()) {
                non_finite_count += 1;
                continue;
            }
            corners.iter().for_each(|&corner| bounds.add(corner));
            for (a, b) in [(0, 1), (1, 2), (2, 0)] {
                edges.add(corners[a], corners[b]);
            }
        }
        let stats = source.stats();
        report("scan", "bytes", stats.bytes_read, stats.bytes_total);
    }
    source.rewind()?;
    *wait_ms += waited.as_millis() as u64;
    let (median_edge, lattice) = (edges.median(), stated.lattice());
    Ok(Scan { bounds, median_edge, triangle_count, non_finite_count, lattice, attributes })
}

/// Edge lengths in bins of 1/32 octave, over the whole range of f64.
struct EdgeHistogram {
    counts: Vec<u64>,
}

impl EdgeHistogram {
    /// Squares are binned: 2048 exponents x 16 mantissa bins (1/16 octave of the square, 1/32 of the length).
    const MANTISSA_BITS: u32 = 4;
    const BYTES: u64 = 8 * (2048 << Self::MANTISSA_BITS);

    fn new() -> EdgeHistogram {
        EdgeHistogram { counts: vec![0; 2048 << Self::MANTISSA_BITS] }
    }

    fn add(&mut self, a: [f64; 3], b: [f64; 3]) {
        let square: f64 = (0..3).map(|i| (a[i] - b[i]) * (a[i] - b[i])).sum();
        if square > 0.0 && square.is_finite() {
            self.counts[(square.to_bits() >> (52 - Self::MANTISSA_BITS)) as usize] += 1;
        }
    }

    fn median(&self) -> f64 {
        let total: u64 = self.counts.iter().sum();
        let mut below = 0;
        for (bin, count) in self.counts.iter().enumerate() {
            below += count;
            if 2 * below >= total && total > 0 {
                return f64::from_bits((bin as u64) << (52 - Self::MANTISSA_BITS)).sqrt();
            }
        }
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_not_overstated() {
        let mut edges = EdgeHistogram::new();
        for i in 1..=1001 {
            edges.add([0.0; 3], [f64::from(i), 0.0, 0.0]);
        }
        let median = edges.median();
        assert!(median <= 501.0 && median > 501.0 * 0.96, "{median}");
    }
}
