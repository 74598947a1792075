//! The command line of `trex stress`.

use super::keys::ResearchKeys;
use super::{
    CachedNetworkArgs, CommonArgs, DeadlineArgs, DeviceArgs, DiskArgs, PictureArgs, ScratchArgs, keys,
};
use crate::values::{self, Milliseconds};
use clap::Args;
use std::path::PathBuf;
use trex_bench::stress::{Requirement, Scenario};

/// `trex stress`
#[derive(Debug, Args)]
#[command(after_help = AFTER_STRESS)]
pub struct StressArgs {
    /// A page file, also at an http(s):// or s3:// address, or a scene (.toml) that names one
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// What is done to it
    #[arg(long, value_enum, value_name = "NAME")]
    pub scenario: Scenario,
    /// Viewpoints, lights or limits, one after the other
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub switches: u32,
    /// Longest that a view is held; it ends when every pixel has an exact sample, all light is in, and every error that
    /// is asked for is taken
    #[arg(long, value_name = "MS", default_value = "5000", value_parser = values::milliseconds)]
    pub hold: Milliseconds,
    /// Viewpoints of your own, in TOML: an array of tables `view`, each with position, target and, if you like, up
    #[arg(long, value_name = "VIEWS.toml")]
    pub views: Option<PathBuf>,
    /// A time that must not be passed, ms: first, rough, whole, response, complete, converged or frame, with a
    /// percentile; may be given more than once [default: whole.p99 within a frame]
    #[arg(long, value_name = "TIME.PERCENTILE=MS")]
    pub require: Vec<Requirement>,
    /// Tell how wrong pictures are 33 to 3000 ms after an event, and those of drag and fly, by references of so many
    /// samples, which are rendered first (256 is good, and takes a minute or more a view)
    #[arg(long, value_name = "SPP", value_parser = keys::samples)]
    pub reference_spp: Option<u32>,
    /// Keep the references in this file for the next runs of the same model, scene and scenario; other references in it
    /// are replaced
    #[arg(long, value_name = "FILE", requires = "reference_spp")]
    pub references: Option<PathBuf>,
    /// Write what was on show at these times of the last switch, and its reference, into this folder: 80-ms.png,
    /// reference.png and so on
    #[arg(long, value_name = "FOLDER", requires = "reference_spp")]
    pub pictures: Option<PathBuf>,
    /// Where to write the picture that is on show at the end (.png, .exr)
    #[arg(short, long, value_name = "PICTURE")]
    pub output: Option<PathBuf>,
    /// Replace pictures that exist
    #[arg(long)]
    pub overwrite: bool,
    #[command(flatten)]
    pub picture: PictureArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
    #[command(flatten)]
    pub device: DeviceArgs,
    #[command(flatten)]
    pub disk: DiskArgs,
    #[command(flatten)]
    pub network: CachedNetworkArgs,
    #[command(flatten)]
    pub common: CommonArgs,
    #[command(flatten)]
    pub deadline: DeadlineArgs,
    #[command(flatten)]
    pub research: ResearchKeys,
}

const AFTER_STRESS: &str = "\
Exit status 1 and the reasons when a view had no response for a second, a tile showed nothing, memory \
passed its limit or grew, or a time that was required was not kept.

Times count from the event: rough and whole are a picture that shows nothing older, with a lit ray at \
every 4th and every 2nd pixel; response is an exact fetch block, complete an exact sample in every pixel. \
Views of flip, inside, squeeze and teleport are as near as it takes for the model to fill them, unless \
there are --views, or a camera with a place in the scene. \
A switch of drag is 150 events in 5 s, a quarter of an orbit about what the first view looks at, a pan and \
a zoom, and then the rest, from whose event times count; 11 pictures of the way are compared, too. fly is the \
same on a way from the overview into the model and on through it, or through the views of --views.

Examples:
  trex stress ship.trex --scenario inside --memory-limit 128MiB
  trex stress iso.trex --scenario flip --require whole.p99=33 --require complete.p50=80
  trex stress iso.trex --scenario teleport --memory-limit 128MiB --reference-spp 256
  trex stress iso.trex --scenario drag --switches 2 --reference-spp 64 --references iso-drag.refs
  trex stress iso.trex --scenario flip --switches 4 --reference-spp 64 --pictures first-second
  trex stress ship.trex --scenario flip --views cockpit-and-hull.toml --json";
