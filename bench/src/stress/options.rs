//! What a stress run is asked to do.

use serde::Serialize;
use std::str::FromStr;
use std::time::Duration;
use trex_render::Camera;

/// What happens. Its names are those of the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Scenario {
    /// Two views from opposite sides, as near as the model fills them.
    Flip,
    /// Overview and interior.
    Inside,
    /// Overview and close-up.
    Pingpong,
    /// One of twelve poses, by chance.
    Teleport,
    /// An orbit faster than the disk.
    Sweep,
    /// Lights and materials.
    LightEdit,
    /// Flip, while the limit is halved and restored.
    Squeeze,
    /// All viewpoints in turn, while memory is watched.
    Soak,
    /// One view, again and again.
    Still,
    /// A hand that orbits, pans and zooms, 30 events a second for 5 s, and rests; each switch is such a way.
    Drag,
    /// A hand that flies from the overview into the model and on through it, as fast; views of your own are flown
    /// through one after the other.
    Fly,
}

impl Scenario {
    /// True where views jump that are the scenario's own.
    pub(super) fn jumps(self) -> bool {
        matches!(self, Scenario::Flip | Scenario::Inside | Scenario::Squeeze)
    }

    /// The name as typed.
    pub fn name(self) -> &'static str {
        match self {
            Scenario::Flip => "flip",
            Scenario::Inside => "inside",
            Scenario::Pingpong => "pingpong",
            Scenario::Teleport => "teleport",
            Scenario::Sweep => "sweep",
            Scenario::LightEdit => "light-edit",
            Scenario::Squeeze => "squeeze",
            Scenario::Soak => "soak",
            Scenario::Still => "still",
            Scenario::Drag => "drag",
            Scenario::Fly => "fly",
        }
    }
}

/// What is done to the session.
#[derive(Clone, Debug)]
pub struct StressOptions {
    /// The scenario.
    pub scenario: Scenario,
    /// Events.
    pub switches: u32,
    /// How long a view is held at most; it ends when every pixel has an exact sample and all light is in.
    pub hold: Duration,
    /// Names the random poses.
    pub seed: u64,
    /// Viewpoints instead of the scenario's own.
    pub views: Vec<Camera>,
    /// Whether the scenario may take nearer views than the session's, which the model fills.
    pub fills: bool,
    /// What the times must not pass.
    pub requirements: Vec<Requirement>,
}

/// A time that is measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum StressFigure {
    /// Event to the first picture of the new state.
    First,
    /// Event to a lit C-ray at every fourth pixel.
    Rough,
    /// Event to one at every second pixel.
    Whole,
    /// Event to an exact fetch block.
    Response,
    /// Event to an exact sample in every pixel.
    Complete,
    /// Event to the same with all photons in.
    Converged,
    /// Length of a frame.
    Frame,
}

impl StressFigure {
    /// All of them, by name.
    pub const NAMED: [(&str, StressFigure); 7] = [
        ("first", StressFigure::First),
        ("rough", StressFigure::Rough),
        ("whole", StressFigure::Whole),
        ("response", StressFigure::Response),
        ("complete", StressFigure::Complete),
        ("converged", StressFigure::Converged),
        ("frame", StressFigure::Frame),
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        StressFigure::NAMED[self as usize].0
    }
}

/// A percentile of a time that must not pass a limit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Requirement {
    /// The time.
    pub figure: StressFigure,
    /// The percentile, above 0, at most 100.
    pub percentile: f64,
    /// Its limit, ms.
    pub ms: f64,
}

impl Requirement {
    /// What a run is judged by when nothing else is asked: in 99 of 100 events the picture is whole after a frame of
    /// `t_max`.
    pub fn default_for(t_max: Duration) -> Requirement {
        Requirement { figure: StressFigure::Whole, percentile: 99.0, ms: t_max.as_secs_f64() * 1e3 }
    }
}

impl FromStr for Requirement {
    type Err = String;

    /// Parses `whole.p99=33`, `frame.max=100`: a figure, a percentile, milliseconds.
    fn from_str(text: &str) -> Result<Requirement, String> {
        let parsed = || {
            let (name, ms) = text.split_once('=')?;
            let (figure, percentile) = name.trim().split_once('.')?;
            let (_, figure) = StressFigure::NAMED.into_iter().find(|(name, _)| *name == figure)?;
            let percentile = match percentile {
                "max" => 100.0,
                percentile => percentile.strip_prefix('p')?.parse().ok()?,
            };
            let ms: f64 = ms.trim().strip_suffix("ms").unwrap_or(ms).trim().parse().ok()?;
            let is_sound =
                (0.0..=100.0).contains(&percentile) && percentile > 0.0 && ms > 0.0 && ms.is_finite();
            is_sound.then_some(Requirement { figure, percentile, ms })
        };
        parsed().ok_or_else(|| {
            let names = StressFigure::NAMED.map(|(name, _)| name).join(", ");
            format!("accepted are times like whole.p99=33 or frame.max=100, of {names}; in milliseconds")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requirements_are_read_and_refused() {
        let read = |text: &str| text.parse::<Requirement>();
        let expected = |figure, percentile, ms| Ok(Requirement { figure, percentile, ms });
        assert_eq!(read("whole.p99=33"), expected(StressFigure::Whole, 99.0, 33.0));
        assert_eq!(read("frame.max = 100ms"), expected(StressFigure::Frame, 100.0, 100.0));
        assert_eq!(read("complete.p50=0.5"), expected(StressFigure::Complete, 50.0, 0.5));
        for text in [
            "",
            "whole",
            "whole.p99",
            "all.p99=3",
            "whole.p0=3",
            "whole.p101=3",
            "whole.p99=-1",
            "whole.p99=inf",
        ] {
            assert!(read(text).unwrap_err().contains("whole.p99=33"), "{text}");
        }
        for (name, figure) in StressFigure::NAMED {
            assert_eq!(figure.name(), name);
        }
    }
}
