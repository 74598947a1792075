//! The command line of `trex stress`.

use super::{CommonArgs, DeadlineArgs, DiskArgs, PictureArgs};
use crate::values::{self, Milliseconds, Triple};
use clap::Args;
use std::path::PathBuf;
use trex_bench::stress::Scenario;

/// `trex stress`
#[derive(Debug, Args)]
#[command(after_help = AFTER_STRESS)]
pub struct StressArgs {
    /// A page file, or a scene (.toml) that names one
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// What is done to it
    #[arg(long, value_enum, value_name = "NAME")]
    pub scenario: Scenario,
    /// Viewpoints, lights or limits, one after the other
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub switches: u32,
    /// Longest that a view is held; it ends when every pixel has a sample
    #[arg(long, value_name = "MS", default_value = "1000", value_parser = values::milliseconds)]
    pub hold: Milliseconds,
    /// Viewpoints of your own, in TOML: an array of tables `view`, each with position, target and, if you like, up
    #[arg(long, value_name = "VIEWS.toml")]
    pub views: Option<PathBuf>,
    /// Times that must not be passed, ms: median response, 99th percentile of it, longest frame
    #[arg(long, value_name = "P50,P99,FRAME", value_parser = values::triple)]
    pub require: Option<Triple>,
    /// Where to write the picture that is on show at the end (.png, .exr)
    #[arg(short, long, value_name = "PICTURE")]
    pub output: Option<PathBuf>,
    /// Replace the picture if it exists
    #[arg(long)]
    pub overwrite: bool,
    #[command(flatten)]
    pub picture: PictureArgs,
    #[command(flatten)]
    pub deadline: DeadlineArgs,
    #[command(flatten)]
    pub disk: DiskArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_STRESS: &str = "\
Exit status 1 and the reasons when a view had no response for a second, a tile showed nothing, memory
passed its limit or grew, or a time that was required was not kept.

Examples:
  trex stress ship.trex --scenario inside --memory-limit 128MiB
  trex stress iso.trex --scenario flip --memory-limit 128MiB --t-max 33 --fetch-block 128 --require 20,33,100
  trex stress ship.trex --scenario flip --views cockpit-and-hull.toml --json";
