//! The command line of `trex bench`.

use super::{CommonArgs, DeviceArgs, DiskArgs, ScratchArgs, keys};
use crate::values::{self, Bytes, Resolution};
use clap::builder::PossibleValuesParser;
use clap::{Args, Subcommand};
use std::path::PathBuf;

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
    /// Pages per second, read at random: as they are, hashed, and ready to trace
    Io(BenchIoArgs),
    /// Triangles per second of a build, generation not counted
    Build(BenchBuildArgs),
    /// Error of pictures against their time and memory, for each turn of each knob
    Tradeoff(BenchTradeoffArgs),
    /// Build, disk, memory, pictures and rays of models of rising size, and how each grows
    Scale(BenchScaleArgs),
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
    /// Count visits per ray by level, beside those of a reference tree over the same triangles
    #[arg(long)]
    pub stats: bool,
    #[command(flatten)]
    pub device: DeviceArgs,
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
  trex bench rays iso.trex --memory-limit 96MiB --resolution 512x512 --json
  trex bench rays iso.trex --device gpu                the rays through the voxels on a GPU, too";

/// `trex bench io`
#[derive(Debug, Args)]
#[command(after_help = AFTER_BENCH_IO)]
pub struct BenchIoArgs {
    /// A page file, or a generated mesh (gen:pipes:5M), which is built first
    #[arg(value_name = "FILE")]
    pub model: String,
    /// Reads in flight; several, by commas, give a figure each
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [1, 8, 32],
        value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub depth: Vec<u16>,
    /// Measured rounds; figures are their medians
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub rounds: u16,
    /// Seed of the order of pages
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub scratch: ScratchArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_BENCH_IO: &str = "\
The system is asked to drop the file from its cache before each round.

Examples:
  trex bench io statue.trex
  trex bench io statue.trex --depth 4,64 --json";

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

/// `trex bench tradeoff`
#[derive(Debug, Args)]
#[command(after_help = AFTER_BENCH_TRADEOFF)]
pub struct BenchTradeoffArgs {
    /// A page file, a scene (.toml), or what is built first, in several ways: a mesh file or gen:pipes:5M
    #[arg(value_name = "FILE")]
    pub input: String,
    /// The folder of what is measured and drawn; a run that was stopped goes on in it
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
    /// Knobs to turn, by commas [default: all]
    #[arg(long, value_name = "KNOB", value_delimiter = ',',
        value_parser = PossibleValuesParser::new(trex_bench::tradeoff::names()))]
    pub knobs: Vec<String>,
    /// Size of the pictures, pixels
    #[arg(long, value_name = "WxH", default_value = "512x512", value_parser = values::resolution)]
    pub resolution: Resolution,
    /// Samples a pixel of each of the two references, by path
    #[arg(long, value_name = "N", default_value_t = 256, value_parser = keys::samples)]
    pub reference_spp: u32,
    /// Runs of each point; times are their medians
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub rounds: u16,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_BENCH_TRADEOFF: &str = "\
Each point is a process of its own: its time goes from its start to the file of the picture. Errors are \
relMSE, PSNR and FLIP, of the whole picture and of its hard parts: borders of shadows, places where surfaces \
meet, places whose light has mostly been reflected, glossy surfaces and mirrors.

FOLDER gets error-time.svg, error-memory.svg, and the reference pictures.

Examples:
  trex bench tradeoff ship.trex -o ship-tradeoff
  trex bench tradeoff gen:pipes:5M -o plant --knobs quality,spp,photons,grid-bits --rounds 3
  trex bench tradeoff room.toml -o room --reference-spp 4096 --json > room.json";

/// `trex bench scale`
#[derive(Debug, Args)]
#[command(after_help = AFTER_BENCH_SCALE)]
pub struct BenchScaleArgs {
    /// Page files, or what is built first: mesh files and generated meshes (gen:pipes:5M)
    #[arg(value_name = "FILE", required = true)]
    pub models: Vec<String>,
    /// The folder of what is built, measured and drawn; a run that was stopped goes on in it
    #[arg(short, long, value_name = "FOLDER")]
    pub output: PathBuf,
    /// Memory limit of the views that jump and of the start; builds and rays have --memory-limit
    #[arg(long, value_name = "LIMIT", default_value = "256MiB", value_parser = values::render_limit)]
    pub views_limit: Bytes,
    /// Size of the views that jump, pixels
    #[arg(long, value_name = "WxH", default_value = "512x512", value_parser = values::resolution)]
    pub resolution: Resolution,
    /// Views that jump, a model
    #[arg(long, value_name = "N", default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub switches: u32,
    /// Runs of each build and each start; times are their medians
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub rounds: u16,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_BENCH_SCALE: &str = "\
Each step is a process of its own. What is built is removed before the next model is built. An exponent of 1 says that \
a cost grows as the triangles do, 0 that it stays.

FOLDER gets scale.svg. More models may be named the next time.

Examples:
  trex bench scale gen:isosurface:1M gen:isosurface:10M gen:isosurface:100M -o scale
  trex bench scale hull.ply ship.ply fleet.ply -o ships --views-limit 512MiB --rounds 3
  trex bench scale a.trex b.trex -o files --json > files.json";
