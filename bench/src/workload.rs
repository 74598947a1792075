//! The verbs `rays`, `io`, `build`, `smooth` and `eviction` of `trex-bench`: flags to options, figures to one JSON
//! document.
//!
//! The command `trex` has the first three as `trex bench`, without peers.

use anyhow::Context;
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;
use trex_bench::building;
use trex_bench::eviction;
use trex_bench::model::{Model, Surroundings};
use trex_bench::page_io::{self, PageIoOptions};
use trex_bench::rays::{self, Peer, RayOptions};
use trex_bench::smooth::{self, MAX_SAMPLES, SmoothOptions};
use trex_bench::stress::{Scenario, StressOptions};
use trex_render::{Camera, parse_views};
use trex_store::io::IoOptions;
use trex_store::{Budget, Interrupt, PageFile};

/// Flags of all.
#[derive(Debug, Args)]
pub(crate) struct CommonArgs {
    /// Most memory that ours may take, MiB; a peer is not counted (default: no limit)
    #[arg(long, value_name = "MIB")]
    memory_limit_mib: Option<u64>,
    /// Worker threads (default: one per core)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Measured rounds
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=1000))]
    rounds: u16,
    /// Folder for temporary files
    #[arg(long, value_name = "DIR", default_value = ".")]
    temp_dir: PathBuf,
    /// One JSON document; the only form there is, accepted for scripts that pass it to every verb
    #[arg(long)]
    json: bool,
}

/// `trex-bench rays`
#[derive(Debug, Args)]
pub(crate) struct RaysArgs {
    /// A page file, or gen:KIND:COUNT[:SEED]
    model: String,
    /// Side of the square picture, pixels; each gives a ray
    #[arg(long, value_name = "PIXELS", default_value_t = 1024, value_parser = clap::value_parser!(u32).range(1..=8192))]
    side: u32,
    /// Seed of the gather rays
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Count visits per ray by level, beside those of a reference tree
    #[arg(long)]
    stats: bool,
    /// Whom to compare with; needs a feature of this program
    #[arg(long, value_enum, value_name = "NAME")]
    peer: Option<PeerName>,
    #[command(flatten)]
    common: CommonArgs,
}

/// `--peer`.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum PeerName {
    /// Intel Embree 3: feature peer-embree
    Embree,
}

/// `trex-bench io`
#[derive(Debug, Args)]
pub(crate) struct IoArgs {
    /// A page file, or gen:KIND:COUNT[:SEED]
    model: String,
    /// Reads in flight, one figure each
    #[arg(long, value_name = "N", value_delimiter = ',', default_values_t = [1, 8, 32],
        value_parser = clap::value_parser!(u16).range(1..=1024))]
    depth: Vec<u16>,
    /// Seed of the order of pages
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Read the same extents by others, too, in turns
    #[arg(long, value_enum, value_name = "NAME")]
    peer: Vec<IoPeer>,
    #[command(flatten)]
    common: CommonArgs,
}

/// `--peer` of `io`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum IoPeer {
    /// fio, as installed
    Fio,
    /// A mapping of the file, touched by threads
    Mmap,
}

/// `trex-bench build`
#[derive(Debug, Args)]
pub(crate) struct BuildArgs {
    /// gen:KIND:COUNT[:SEED]
    spec: String,
    #[command(flatten)]
    common: CommonArgs,
}

/// `trex-bench smooth`
#[derive(Debug, Args)]
pub(crate) struct SmoothArgs {
    /// An EXR of `trex render --filter off --layers albedo,normal,depth`
    picture: PathBuf,
    /// Where what is shown goes, an EXR
    #[arg(long, short, value_name = "PICTURE")]
    output: PathBuf,
    /// Samples of each pixel that the picture has
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=i64::from(MAX_SAMPLES)))]
    spp: u32,
    #[command(flatten)]
    common: CommonArgs,
}

/// `trex-bench eviction`
#[derive(Debug, Args)]
pub(crate) struct EvictionArgs {
    /// A page file, or gen:KIND:COUNT[:SEED]
    model: String,
    /// What is done to it
    #[arg(long, value_enum, value_name = "NAME", default_value = "flip")]
    scenario: Scenario,
    /// Viewpoints, one after the other
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = clap::value_parser!(u32).range(1..))]
    switches: u32,
    /// Viewpoints of your own, as `trex stress` takes them
    #[arg(long, value_name = "VIEWS.toml")]
    views: Option<PathBuf>,
    #[command(flatten)]
    common: CommonArgs,
}

/// Longest that a view of `eviction` is held: until it is complete.
const HOLD: Duration = Duration::from_secs(60);

impl CommonArgs {
    fn surroundings(&self) -> Surroundings {
        let cores = || std::thread::available_parallelism().map_or(1, usize::from);
        Surroundings {
            threads: self.threads.map_or_else(cores, usize::from),
            budget: self.memory_limit_mib.map_or_else(Budget::unlimited, |mib| Budget::new(mib << 20)),
            folder: self.temp_dir.clone(),
            interrupt: Interrupt::default(),
        }
    }
}

/// Runs `trex-bench rays`.
pub(crate) fn rays(args: &RaysArgs, command: &str) -> anyhow::Result<()> {
    let around = args.common.surroundings();
    let model = Model::open(&args.model, &around)?;
    let options = RayOptions {
        resolution: [args.side; 2],
        rounds: usize::from(args.common.rounds),
        seed: args.seed,
        io: IoOptions::default(),
        stats: args.stats,
        device: None,
        peer: args.peer.map(peer).transpose()?,
    };
    tell("bench-rays", command, &rays::run(&model, &options, &around)?)
}

/// Runs `trex-bench io`.
pub(crate) fn io(args: &IoArgs, command: &str) -> anyhow::Result<()> {
    let around = args.common.surroundings();
    let model = Model::open(&args.model, &around)?;
    let options = PageIoOptions {
        depths: args.depth.iter().map(|&depth| usize::from(depth)).collect(),
        rounds: usize::from(args.common.rounds),
        seed: args.seed,
        fio: args.peer.contains(&IoPeer::Fio),
        mapped: args.peer.contains(&IoPeer::Mmap),
    };
    tell("bench-io", command, &page_io::run(&model, &options, &around)?)
}

/// Runs `trex-bench build`.
pub(crate) fn build(args: &BuildArgs, command: &str) -> anyhow::Result<()> {
    let around = args.common.surroundings();
    tell("bench-build", command, &building::run(&args.spec, usize::from(args.common.rounds), &around)?)
}

/// Runs `trex-bench smooth`.
pub(crate) fn smooth(args: &SmoothArgs, command: &str) -> anyhow::Result<()> {
    let options = SmoothOptions {
        picture: args.picture.clone(),
        output: args.output.clone(),
        samples: args.spp,
        rounds: usize::from(args.common.rounds),
    };
    tell("bench-smooth", command, &smooth::run(&options, &args.common.surroundings())?)
}

/// Runs `trex-bench eviction`.
pub(crate) fn eviction(args: &EvictionArgs, command: &str) -> anyhow::Result<()> {
    let around = args.common.surroundings();
    let model = Model::open(&args.model, &around)?;
    let views = args.views.as_deref().map(|views| read_views(views, &model.path)).transpose()?;
    let options = StressOptions {
        scenario: args.scenario,
        switches: args.switches,
        hold: HOLD,
        seed: 1,
        views: views.unwrap_or_default(),
        fills: true,
        requirements: vec![],
    };
    tell("bench-eviction", command, &eviction::run(&model, &options, &around)?)
}

/// The viewpoints of a file, otherwise like a camera that frames the model.
fn read_views(path: &Path, model: &Path) -> anyhow::Result<Vec<Camera>> {
    let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let framing = Camera::framing(&PageFile::superblock_of(model)?.bounds, [1; 2], None, None);
    Ok(parse_views(&text, &framing).map_err(|error| error.at(path))?)
}

#[cfg(feature = "peer-embree")]
fn peer(name: PeerName) -> anyhow::Result<Peer> {
    match name {
        PeerName::Embree => Ok(Peer::Embree),
    }
}

#[cfg(not(feature = "peer-embree"))]
fn peer(name: PeerName) -> anyhow::Result<Peer> {
    let PeerName::Embree = name;
    anyhow::bail!("this program was built without Embree: cargo run -p trex-bench --features peer-embree")
}

/// A verb's document.
#[derive(Serialize)]
struct Document<'a, T> {
    schema: String,
    command: String,
    version: &'static str,
    #[serde(flatten)]
    body: &'a T,
}

fn tell<T: Serialize>(verb: &str, command: &str, body: &T) -> anyhow::Result<()> {
    let document = Document {
        schema: format!("trex.{verb}/1"),
        command: command.to_owned(),
        version: env!("CARGO_PKG_VERSION"),
        body,
    };
    let text = serde_json::to_string_pretty(&document)? + "\n";
    io::stdout().lock().write_all(text.as_bytes()).context("cannot write to stdout")
}
