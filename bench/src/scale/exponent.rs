//! How a cost grows with size: `cost ~ size ^ exponent`, the straight line of least squares through logarithms.

use serde::Serialize;

/// How a cost grows.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Exponent {
    /// 0: the same whatever the size; 1: in proportion.
    pub exponent: f64,
    /// What ten times the size multiplies the cost by.
    pub at_ten_times: f64,
    /// The farthest that a point lies off the line: the greater of cost over line and line over cost.
    pub worst_ratio: f64,
    /// Points.
    pub point_count: usize,
}

impl Exponent {
    /// Of (size, cost), both above zero. `None` for fewer than two sizes.
    pub(super) fn of(points: &[(f64, f64)]) -> Option<Exponent> {
        let logs: Vec<(f64, f64)> = points.iter().map(|(size, cost)| (size.ln(), cost.ln())).collect();
        let count = logs.len() as f64;
        let mean_x = logs.iter().map(|(x, _)| x).sum::<f64>() / count;
        let mean_y = logs.iter().map(|(_, y)| y).sum::<f64>() / count;
        let spread = logs.iter().map(|(x, _)| (x - mean_x).powi(2)).sum::<f64>();
        if !spread.is_finite() || spread < f64::EPSILON {
            return None;
        }
        let exponent = logs.iter().map(|(x, y)| (x - mean_x) * (y - mean_y)).sum::<f64>() / spread;
        let off = |(x, y): &(f64, f64)| (y - (mean_y + exponent * (x - mean_x))).abs();
        let worst = logs.iter().map(off).fold(0.0, f64::max);
        Some(Exponent {
            exponent,
            at_ten_times: 10f64.powf(exponent),
            worst_ratio: worst.exp(),
            point_count: logs.len(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn powers_are_found() {
        for power in [-0.5, 0.0, 0.37, 1.0, 2.0] {
            let points = [1e6, 2e6, 1e7, 4.69e8].map(|size: f64| (size, 3.0 * size.powf(power)));
            let found = Exponent::of(&points).unwrap();
            assert!((found.exponent - power).abs() < 1e-9 && found.worst_ratio < 1.0 + 1e-9, "{found:?}");
            assert!((found.at_ten_times - 10f64.powf(power)).abs() < 1e-6, "{found:?}");
        }
    }

    #[test]
    fn a_point_off_the_line_is_told() {
        // Two of each size, a factor of four apart: the line goes between them, twice off either.
        let points = [(1.0, 1.0), (1.0, 4.0), (100.0, 1.0), (100.0, 4.0)];
        let found = Exponent::of(&points).unwrap();
        assert!(found.exponent.abs() < 1e-12 && (found.worst_ratio - 2.0).abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn one_size_has_no_exponent() {
        assert_eq!(Exponent::of(&[]), None);
        assert_eq!(Exponent::of(&[(5.0, 1.0)]), None);
        assert_eq!(Exponent::of(&[(5.0, 1.0), (5.0, 2.0)]), None);
    }
}
