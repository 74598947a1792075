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
