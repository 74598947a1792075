//! `Divisor`: whole quotients by a number that is the same for many, by a product with its inverse.

/// Whole quotients by a number that is the same for many.
pub(super) struct Divisor {
    by: i64,
    inverse: f64,
}

impl Divisor {
    /// Quotients by `by`, from 1 on.
    pub(super) fn new(by: i64) -> Divisor {
        Divisor { by, inverse: 1.0 / by as f64 }
    }

    /// `value / by`, rounded down; `value` is from 0 to 2^52.
    pub(super) fn of(&self, value: i64) -> i64 {
        // One too many or one too few at most: the product is wrong by three roundings of what is below 2^52.
        let near = (value as f64 * self.inverse) as i64;
        let rest = value - near * self.by;
        near + i64::from(rest >= self.by) - i64::from(rest < 0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quotients_are_rounded_down() {
        for by in [2, 6, 14, 1 << 20, (1 << 40) - 2, 3 << 37] {
            let divisor = Divisor::new(by);
            for quotient in [0, 1, 2, 1023, (1 << 41) / by, (1 << 52) / by] {
                for value in [quotient * by - 1, quotient * by, quotient * by + 1, quotient * by + by - 1] {
                    let value = value.clamp(0, 1 << 52);
                    assert_eq!(divisor.of(value), value / by, "{value} / {by}");
                }
            }
        }
    }
}
