//! The choice of the lattice: one step for the whole model.
//!
//! Invariants: 1. a lattice that the input states, and all of whose vertices lie on it, is taken where nothing else was
//! asked for: what was exported comes back as it was; 2. the origin of one that is chosen is a multiple of the step, so
//! that an input that lies on the lattice stays exact.

use super::Scan;
use super::rejected::{RejectedCounts, no_triangles};
use crate::build::options::Precision;
use crate::error::{Code, Error, Result};
use crate::geom::{Lattice, exp2i};

/// The lattice and how many bits its coordinates take.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Grid {
    pub(crate) lattice: Lattice,
    pub(crate) bits: u32,
}

/// The lattice for what the scan has seen. `name` is the input's, for messages.
pub(crate) fn choose(scan: &Scan, precision: Precision, name: &str) -> Result<Grid> {
    let extent = scan.bounds.extent();
    if extent.is_nan() || extent <= 0.0 {
        // What is finite lies in one point.
        let Scan { triangle_count: read, non_finite_count: non_finite, .. } = *scan;
        return Err(no_triangles(
            name,
            RejectedCounts { read, non_finite, degenerate: read - non_finite, collapsed: 0 },
        ));
    }
    let magnitude = scan.bounds.lo.iter().chain(&scan.bounds.hi).fold(0.0f64, |m, v| m.max(v.abs()));
    if !(1e-200..1e200).contains(&extent) {
        return Err(Error::new(Code::InputEmpty, "the input has no extent that a lattice could divide")
            .at_place(name)
            .numbers(format!("extent {extent:e}, {} triangles", scan.triangle_count))
            .next("check the input's coordinates"));
    }
    if let (Precision::Default, Some(lattice)) = (precision, scan.lattice) {
        let last = lattice.snap(scan.bounds.hi).into_iter().fold(0, i64::max);
        return Ok(Grid { lattice, bits: 64 - last.leading_zeros() });
    }
    let finest = floor_log2(extent) - 38;
    let exponent = match precision {
        Precision::Default => {
            let median = if scan.median_edge > 0.0 { scan.median_edge / 128.0 } else { f64::INFINITY };
            let half_step = median.min(extent * exp2i(-17));
            // f64 itself ends the useful steps: nothing finer than the last bit of the coordinates.
            (floor_log2(half_step) + 1).max(finest).max(floor_log2(magnitude) - 52)
        }
        Precision::GridBits(bits) => {
            let cells = exp2i(bits as i32) - 1.0;
            let exact = extent / cells;
            if exact > exp2i(floor_log2(exact)) { floor_log2(exact) + 1 } else { floor_log2(exact) }
        }
        // The last step that is a number: all triangles collapse.
        Precision::Error(bound) => (floor_log2(bound) + 1).min(1022),
    };
    let step = exp2i(exponent);
    let floor = |v: f64| if (v / step).abs() < exp2i(52) { (v / step).floor() * step } else { v };
    let lattice = Lattice { origin: scan.bounds.lo.map(floor), exponent };
    let far = (0..3).map(|a| (scan.bounds.hi[a] - lattice.origin[a]) / step).fold(0.0, f64::max).ceil();
    if far >= exp2i(Lattice::MAX_BITS as i32) {
        return Err(Error::new(Code::Usage, "the lattice is too fine for the model")
            .at_place(name)
            .numbers(format!("extent {extent:e} / step {step:e} takes {:.1} bits, at most 40", far.log2()))
            .next(format!(
                "ask for an error of at least {:e}, or leave it to the default",
                exp2i(finest) / 2.0
            )));
    }
    Ok(Grid { lattice, bits: 64 - (far as u64).leading_zeros() })
}

/// `floor(log2(value))` of a normal number.
fn floor_log2(value: f64) -> i32 {
    ((value.to_bits() >> 52 & 0x7ff) as i32) - 1023
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geom::Aabb;

    fn scan_of(lo: [f64; 3], hi: [f64; 3], median_edge: f64) -> Scan {
        let (triangle_count, non_finite_count, lattice, attributes) = (1, 0, None, Default::default());
        Scan { bounds: Aabb { lo, hi }, median_edge, triangle_count, non_finite_count, lattice, attributes }
    }

    #[test]
    fn the_default_step_keeps_both_promises() {
        for (extent, median) in [(1.0, 0.01), (1e9, 3.0), (1e-6, 1e-9), (100.0, 100.0), (3.0, 1e-3)] {
            let grid = choose(&scan_of([0.0; 3], [extent; 3], median), Precision::Default, "t").unwrap();
            let half = grid.lattice.step() / 2.0;
            assert!(half <= median / 128.0 && half <= extent / 131072.0, "{extent} {median}: {half}");
            assert!(
                half > (median / 128.0).min(extent / 131072.0) / 2.0,
                "{extent} {median}: {half} is too fine"
            );
            assert!(extent / grid.lattice.step() < exp2i(grid.bits as i32));
        }
    }

    #[test]
    fn a_stated_lattice_is_taken_where_nothing_else_was_asked_for() {
        let stated = Lattice { origin: [-7.0, 0.0, 0.0], exponent: -4 };
        let scan = Scan { lattice: Some(stated), ..scan_of([-5.0, 0.0, 0.0], [6.0, 1.0, 2.0], 0.1) };
        let grid = choose(&scan, Precision::Default, "t").unwrap();
        assert_eq!((grid.lattice, grid.bits), (stated, 8));
        assert_ne!(choose(&scan, Precision::GridBits(20), "t").unwrap().lattice, stated);
        assert_ne!(choose(&scan, Precision::Error(0.001), "t").unwrap().lattice, stated);
    }

    #[test]
    fn grid_bits_and_error_are_kept() {
        let scan = scan_of([-5.0, 0.0, 0.0], [6.0, 1.0, 2.0], 0.1);
        let grid = choose(&scan, Precision::GridBits(20), "t").unwrap();
        assert!(grid.bits <= 21 && grid.bits >= 19, "{}", grid.bits);
        let grid = choose(&scan, Precision::Error(0.001), "t").unwrap();
        assert!(grid.lattice.step() <= 0.002 && grid.lattice.step() > 0.001);
        let refused = choose(&scan, Precision::Error(1e-13), "t").unwrap_err();
        assert_eq!(refused.code(), Code::Usage);
        // It was a panic.
        for bound in [1e300, f64::MAX] {
            assert!(choose(&scan, Precision::Error(bound), "t").unwrap().lattice.step() >= 1e300);
        }
    }
}
