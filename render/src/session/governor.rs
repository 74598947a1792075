//! `Governor`: raises the error of the footprint rule where the pages in demand are too many for the frames there
//! are, until every pixel has a sample; then it lets go, and the picture goes on at the error that was asked for.

/// Share of the frames in demand above which the governor raises the error, and below which it lowers it.
const DEMAND: std::ops::Range<f64> = 0.70..0.85;
/// Step of the governor.
const ERROR_GROWTH: f64 = 1.25;
/// Greatest error the governor goes to, pixels; where none was asked for it begins at 1.
const ERROR_MAX_PIXELS: f64 = 16.0;

/// Raises the error of the footprint rule where pages are too many for the frames.
#[derive(Clone, Copy, Debug)]
pub(super) struct Governor {
    asked: f64,
    error: f64,
    /// The state had its complete picture: no more raising.
    has_let_go: bool,
}

impl Governor {
    /// A governor that starts from the error that was asked for, pixels.
    pub(super) fn new(asked: f64) -> Governor {
        Governor { asked, error: asked, has_let_go: false }
    }

    /// The error in force, pixels.
    pub(super) fn error(&self) -> f64 {
        self.error
    }

    /// Raises the error within a state, where `demand` (pages in demand over frames) is too high: true when it did.
    pub(super) fn raise(&mut self, demand: f64) -> bool {
        let raised = if self.error == 0.0 { 1.0 } else { self.error * ERROR_GROWTH };
        let raises = demand > DEMAND.end && raised <= ERROR_MAX_PIXELS && !self.has_let_go;
        if raises {
            self.error = raised;
        }
        raises
    }

    /// Goes back to the error that was asked for, since the picture is complete: true when it was at a raised error.
    pub(super) fn let_go(&mut self) -> bool {
        let was_raised = self.error > self.asked;
        (self.error, self.has_let_go) = (self.asked, true);
        was_raised
    }

    /// Lowers the error between states, where `demand` (pages in demand over frames) is low.
    pub(super) fn lower(&mut self, demand: f64) {
        self.has_let_go = false;
        if demand < DEMAND.start && self.error > self.asked {
            let lowered = self.error / ERROR_GROWTH;
            self.error = if lowered <= self.asked.max(1.0 / ERROR_GROWTH) { self.asked } else { lowered };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_raises_above_its_demand_and_by_steps() {
        for demand in [0.0, 0.7, 0.85] {
            let mut governor = Governor::new(0.0);
            assert!(!governor.raise(demand));
            assert_eq!(governor.error(), 0.0);
        }
        let steps = |asked: f64| {
            let mut governor = Governor::new(asked);
            let steps: Vec<f64> =
                std::iter::from_fn(|| governor.raise(0.851).then(|| governor.error())).take(99).collect();
            // One that is refused leaves what was.
            assert_eq!(steps.last().copied().unwrap_or(asked), governor.error());
            steps
        };
        assert_eq!(steps(0.0)[..4], [1.0, 1.25, 1.5625, 1.953_125]);
        assert_eq!(steps(2.0)[..2], [2.5, 3.125]);
        // 1.25^12 pixels; another step would be 18.2.
        assert_eq!((steps(0.0).len(), steps(0.0).last().unwrap().round()), (13, 15.0));
        assert!(steps(13.0).is_empty());
    }

    #[test]
    fn it_comes_back_step_by_step_below_its_demand_and_ends_at_what_was_asked_for() {
        for (asked, down) in [(0.0, &[1.25, 1.0, 0.0, 0.0][..]), (2.0, &[3.125, 2.5, 2.0, 2.0])] {
            let mut governor = Governor::new(asked);
            for _ in 0..3 {
                assert!(governor.raise(1.0));
            }
            let raised = governor.error();
            for demand in [9.0, 0.85, 0.7] {
                governor.lower(demand);
                assert_eq!(governor.error(), raised, "{demand}");
            }
            for &error in down {
                governor.lower(0.699);
                assert!((governor.error() - error).abs() < 1e-12, "{asked}: {} {error}", governor.error());
            }
            assert_eq!(governor.error(), asked);
        }
    }

    #[test]
    fn once_it_has_let_go_it_raises_no_more_in_this_state() {
        let mut governor = Governor::new(2.0);
        assert!(!governor.let_go());
        governor.lower(1.0);
        assert!(governor.raise(1.0) && governor.raise(1.0));
        assert!(governor.let_go());
        assert_eq!((governor.error(), governor.raise(1.0), governor.error()), (2.0, false, 2.0));
        assert!(!governor.let_go());
        governor.lower(1.0);
        assert!(governor.raise(1.0));
    }
}
