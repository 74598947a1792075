//! What a stress run is asked to do.

use serde::Serialize;
use std::time::Duration;
use trex_render::Camera;

/// What happens. Its names are those of the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Scenario {
    /// Two views from opposite sides.
    Flip,
    /// Overview and interior.
    Inside,
    /// Overview and close-up.
    Pingpong,
    /// Poses by chance.
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
}

impl Scenario {
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
    /// How long a view is held at most; it ends when every pixel has a sample.
    pub hold: Duration,
    /// Names the random poses.
    pub seed: u64,
    /// Viewpoints instead of the scenario's own.
    pub views: Vec<Camera>,
    /// What the times must not pass.
    pub limits: Option<Limits>,
}

/// Times that a run must not pass, ms.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Limits {
    /// Median of the responses.
    pub p50_ms: f64,
    /// 99th percentile of the responses.
    pub p99_ms: f64,
    /// Longest frame.
    pub frame_max_ms: f64,
}
