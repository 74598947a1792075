//! The command line of `trex bench`.

use super::{CommonArgs, DiskArgs, ScratchArgs};
use crate::values::{self, Resolution};
use clap::{Args, Subcommand};

/// `trex bench`
#[derive(Debug, Args)]
pub struct BenchArgs {
    /// What to measure.
    #[command(subcommand)]
    pub verb: BenchVerb,
}

/// The workloads.
#[derive(Debug, Subcommand)]
pub enum BenchVerb {
    /// Rays per second: primary, shadow, incoherent
    Rays(BenchRaysArgs),
    /// Triangles per second of a build, generation not counted
    Build(BenchBuildArgs),
}

/// `trex bench rays`
#[derive(Debug, Args)]
#[command(after_help = AFTER_BENCH_RAYS)]
pub struct BenchRaysArgs {
    /// A page file, or a generated mesh (gen:pipes:5M), which is built first
    #[arg(value_name = "FILE")]
    pub model: String,
    /// Size of the picture, pixels; each gives a ray
    #[arg(long, value_name = "WxH", default_value = "1024x1024", value_parser = values::resolution)]
    pub resolution: Resolution,
    /// Measured rounds; figures are their medians
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub rounds: u16,
    /// Seed of the gather rays
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub scratch: ScratchArgs,
    #[command(flatten)]
    pub disk: DiskArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_BENCH_RAYS: &str = "\
All pages are in memory where the limit has room for them; below that they come and go.

Examples:
  trex bench rays statue.trex
  trex bench rays iso.trex --memory-limit 96MiB --resolution 512x512 --json";

/// `trex bench build`
#[derive(Debug, Args)]
pub struct BenchBuildArgs {
    /// A generated mesh: gen:KIND:COUNT or gen:KIND:COUNT:SEED
    #[arg(value_name = "SPEC")]
    pub spec: String,
    /// Measured rounds; figures are their medians
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub rounds: u16,
    #[command(flatten)]
    pub scratch: ScratchArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}
