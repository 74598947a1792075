//! The front: the points that no other beats in both of two figures.

/// Which of `points` (cost, error; lower is better) no other beats: none costs at most as much and errs less.
pub(super) fn front(points: &[(f64, f64)]) -> Vec<bool> {
    let is_beaten = |i: usize| {
        let (cost, error) = points[i];
        let beats = |j: usize, (c, e): (f64, f64)| {
            j != i && c <= cost && e <= error && (c < cost || e < error || j < i)
        };
        points.iter().enumerate().any(|(j, &other)| beats(j, other))
    };
    (0..points.len()).map(|i| !is_beaten(i)).collect()
}

/// How many times the least error that is had at the cost of `point` or below it its own error is: 1 on the front.
pub(super) fn distance(point: (f64, f64), points: &[(f64, f64)]) -> f64 {
    let affordable = points.iter().filter(|other| other.0 <= point.0).map(|other| other.1);
    point.1 / affordable.fold(point.1, f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_beaten_is_not_on_it() {
        let points = [(1.0, 9.0), (2.0, 3.0), (2.0, 4.0), (3.0, 5.0), (4.0, 1.0), (4.0, 1.0)];
        assert_eq!(front(&points), [true, true, false, false, true, false]);
        assert_eq!(distance(points[1], &points), 1.0);
        assert_eq!(distance(points[3], &points), 5.0 / 3.0);
    }
}
