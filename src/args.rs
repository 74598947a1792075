//! The command line, declared: every verb, every flag, its unit, its default.
//!
//! Invariants: 1. a flag that is listed does something; 2. what clap accepted is in range (`values`), so verbs
//! check only what needs a file; 3. the same flag has the same name and meaning at every verb.

mod image;
mod render;
mod stress;

use crate::progress::Mode;
use crate::values::{self, Bytes, Input, MemoryLimit, Resolution};
use clap::builder::{OsStringValueParser, TypedValueParser};
use clap::{ArgAction, Args, Parser, Subcommand, ValueEnum};
pub use image::{ImageArgs, ImageDiffArgs, ImageVerb, Metric};
pub use render::{DeadlineArgs, Layer, PictureArgs, RenderArgs, Switch};
use std::path::PathBuf;
pub use stress::StressArgs;
use trex_store::io::{DirectChoice, IoChoice};

/// Opens triangle meshes far larger than memory and renders them under a memory limit.
#[derive(Debug, Parser)]
#[command(name = "trex", version, max_term_width = 100, subcommand_required = true, after_help = AFTER_TREX)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
}

const AFTER_TREX: &str = "\
Examples:
  trex demo                                            generate, build and render: one picture
  trex build statue.ply -o statue.trex                 mesh file to page file
  trex build gen:isosurface:20M -o iso.trex --memory-limit 512MiB
  trex info statue.trex                                what is inside
  trex render statue.trex -o statue.png --memory-limit 128MiB
  trex stress statue.trex --scenario flip              two views in turn: how fast it responds
  trex image diff a.exr reference.exr                  how far apart two pictures are

Results go to stdout, all else to stderr; --json makes the result one JSON document.
Exit status: 0 done; 1 ran, and the answer is no; 2 usage; 3 bad input; 4 memory limit too small;
5 disk full; 7 reading or writing failed; 70 a bug in trex; 130 interrupted.";

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Generate a mesh, build it and render it under a memory limit: one command, one picture
    Demo(DemoArgs),
    /// Write a generated mesh to a file
    Gen(GenArgs),
    /// Turn meshes into a page file
    Build(BuildArgs),
    /// Describe a mesh or a page file without loading it
    Info(InfoArgs),
    /// Check every byte of a page file
    Verify(VerifyArgs),
    /// Render a page file or a scene
    Render(RenderArgs),
    /// Change views, lights or limits faster than a model likes, and judge the responses
    Stress(StressArgs),
    /// Measure this machine on a model
    Bench(BenchArgs),
    /// Compare pictures
    Image(ImageArgs),
}

impl Verb {
    /// The verb as typed; also the middle of its JSON schema's name.
    pub fn name(&self) -> &'static str {
        match self {
            Verb::Demo(_) => "demo",
            Verb::Gen(_) => "gen",
            Verb::Build(_) => "build",
            Verb::Info(_) => "info",
            Verb::Verify(_) => "verify",
            Verb::Render(_) => "render",
            Verb::Stress(_) => "stress",
            Verb::Bench(BenchArgs { verb: BenchVerb::Rays(_) }) => "bench-rays",
            Verb::Bench(BenchArgs { verb: BenchVerb::Build(_) }) => "bench-build",
            Verb::Image(ImageArgs { verb: ImageVerb::Diff(_) }) => "image-diff",
        }
    }

    /// The flags that every verb has.
    pub fn common(&self) -> &CommonArgs {
        match self {
            Verb::Demo(args) => &args.common,
            Verb::Gen(args) => &args.common,
            Verb::Build(args) => &args.common,
            Verb::Info(args) => &args.common,
            Verb::Verify(args) => &args.common,
            Verb::Render(args) => &args.common,
            Verb::Stress(args) => &args.common,
            Verb::Bench(BenchArgs { verb: BenchVerb::Rays(args) }) => &args.common,
            Verb::Bench(BenchArgs { verb: BenchVerb::Build(args) }) => &args.common,
            Verb::Image(ImageArgs { verb: ImageVerb::Diff(args) }) => &args.common,
        }
    }

    /// The memory limit that holds when none is given.
    pub fn default_limit(&self) -> MemoryLimit {
        match self {
            Verb::Demo(_) => MemoryLimit::Bytes(DEMO_LIMIT_BYTES),
            _ => MemoryLimit::AUTO,
        }
    }
}

/// Limit of the demo: its mesh, unpacked, takes several times as much.
const DEMO_LIMIT_BYTES: u64 = 256 << 20;

/// Flags of every verb.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Common options")]
pub struct CommonArgs {
    /// Most memory this process may take: an amount (512MiB, 2GB), a share of what the machine grants (50%), or
    /// auto (default: auto = 50% of the smaller of installed memory and cgroup limit; demo: 256MiB)
    #[arg(long, value_name = "LIMIT", value_parser = values::memory_limit)]
    pub memory_limit: Option<MemoryLimit>,
    /// Worker threads (default: one per core); results do not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print the result as one JSON document, units in the keys
    #[arg(long)]
    pub json: bool,
    /// How to show progress on stderr; auto = bar on a terminal, plain lines elsewhere
    #[arg(long, value_enum, value_name = "MODE", default_value_t = Mode::Auto)]
    pub progress: Mode,
    /// Tell more on stderr; twice for details
    #[arg(short, long, action = ArgAction::Count, conflicts_with = "quiet")]
    pub verbose: u8,
    /// Tell nothing on stderr but errors
    #[arg(short, long)]
    pub quiet: bool,
}

/// Flags of verbs that read page files.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Disk options")]
pub struct DiskArgs {
    /// How pages are read; auto = the fastest that the system allows (-v says which, and why)
    #[arg(long, value_enum, value_name = "BACKEND", default_value_t = Io::Auto)]
    pub io: Io,
    /// Whether reads bypass the system's file cache; auto = where the file system allows
    #[arg(long, value_enum, value_name = "WHEN", default_value_t = Direct::Auto)]
    pub direct: Direct,
}

/// Flag of verbs that write.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Output options")]
pub struct OverwriteArgs {
    /// Replace the output if it exists; without this flag that is an error
    #[arg(long)]
    pub overwrite: bool,
}

/// Flag of verbs that need scratch files.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Output options")]
pub struct ScratchArgs {
    /// Folder for scratch files (default: beside the output; bench: here); removed again, also after Ctrl-C
    #[arg(long, value_name = "DIR")]
    pub temp_dir: Option<PathBuf>,
}

/// `--io`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Io {
    /// The fastest that works here
    Auto,
    /// io_uring (Linux)
    Uring,
    /// Positioned reads on a few threads
    Pread,
    /// Memory-mapped file
    Mmap,
}

impl Io {
    /// The library's form.
    pub fn choice(self) -> IoChoice {
        match self {
            Io::Auto => IoChoice::Auto,
            Io::Uring => IoChoice::Uring,
            Io::Pread => IoChoice::Pread,
            Io::Mmap => IoChoice::Mmap,
        }
    }
}

/// `--direct`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Direct {
    /// Where the file system allows
    Auto,
    /// Always; an error where the file system refuses
    On,
    /// Never
    Off,
}

impl Direct {
    /// The library's form.
    pub fn choice(self) -> DirectChoice {
        match self {
            Direct::Auto => DirectChoice::Auto,
            Direct::On => DirectChoice::On,
            Direct::Off => DirectChoice::Off,
        }
    }
}

/// Kinds of generated meshes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// Turbulent mixing layer, detail at all scales
    Isosurface,
    /// Plant with interior: pipes, bolts, tanks, mirrors, lamps
    Pipes,
    /// Dense closed statue
    Scan,
    /// Slivers, duplicates, degenerates, far from the origin
    Soup,
}

impl Kind {
    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            Kind::Isosurface => "isosurface",
            Kind::Pipes => "pipes",
            Kind::Scan => "scan",
            Kind::Soup => "soup",
        }
    }
}

/// `trex demo`
#[derive(Debug, Args)]
#[command(after_help = AFTER_DEMO)]
pub struct DemoArgs {
    /// The picture, PNG or EXR by its ending; the page file is written beside it
    #[arg(short, long, value_name = "PICTURE", default_value = "out/demo.png")]
    pub output: PathBuf,
    /// What to generate
    #[arg(long, value_enum, value_name = "KIND", default_value_t = Kind::Isosurface)]
    pub kind: Kind,
    /// Triangles to generate, within 1 % (250k, 5M, 1G)
    #[arg(long, value_name = "N", default_value = "5M", value_parser = values::count)]
    pub triangles: u64,
    /// Size of the picture, pixels
    #[arg(long, value_name = "WxH", default_value = "1024x1024", value_parser = values::resolution)]
    pub resolution: Resolution,
    /// Samples per pixel
    #[arg(long, value_name = "N", default_value_t = 16, value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub spp: u32,
    /// Seed of the mesh and of the samples
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
    #[command(flatten)]
    pub disk: DiskArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_DEMO: &str = "\
The picture and page file of an earlier demo in out/ are replaced without --overwrite.

Examples:
  trex demo                                  5 million triangles under 256 MiB, out/demo.png
  trex demo --triangles 50M --memory-limit 512MiB
  trex demo --kind pipes -o plant.png";

/// `trex gen`
#[derive(Debug, Args)]
#[command(after_help = AFTER_GEN)]
pub struct GenArgs {
    /// What to generate
    #[arg(value_enum, value_name = "KIND")]
    pub kind: Kind,
    /// Triangles to generate, within 1 % (250k, 5M, 1G)
    #[arg(long, value_name = "N", value_parser = values::count)]
    pub triangles: u64,
    /// The file; its ending chooses the format: .ply (binary), .obj or .stl (binary)
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Seed; the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_GEN: &str = "\
`trex build gen:KIND:COUNT[:SEED] -o OUT.trex` builds the same mesh with no file between.

Examples:
  trex gen isosurface --triangles 20M -o iso.ply
  trex gen pipes --triangles 1M --seed 7 -o plant.obj";

/// `trex build`
#[derive(Debug, Args)]
#[command(after_help = AFTER_BUILD)]
pub struct BuildArgs {
    /// Meshes: .ply, .obj or .stl files, or gen:KIND:COUNT, also with :SEED; several become one model
    #[arg(value_name = "INPUT", required = true, num_args = 1..,
          value_parser = OsStringValueParser::new().map(Input::from))]
    pub inputs: Vec<Input>,
    /// The page file to publish
    #[arg(short, long, value_name = "OUT.trex")]
    pub output: PathBuf,
    /// Bits of the lattice along the model's longest side (default: chosen from the edges, see `trex info`)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(8..=40), conflicts_with = "error")]
    pub grid_bits: Option<u8>,
    /// Largest distance a vertex may move when snapped to the lattice, model units
    #[arg(long, value_name = "LENGTH", value_parser = values::positive)]
    pub error: Option<f64>,
    #[command(flatten)]
    pub voxels: VoxelArgs,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

/// The voxel octree of a build.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Voxel options")]
pub struct VoxelArgs {
    /// Leaf voxels along the model's longest side: RU in the resident octree, RFINEST (1, 4 or 16 times RU) in units
    /// below it that are read when rays ask for them (default: as many RU as the mesh's own size and --upper-budget allow, and no units)
    #[arg(long, value_name = "RU[/RFINEST]", value_parser = values::voxels, conflicts_with = "no_asvo")]
    pub voxels: Option<values::Voxels>,
    /// Most memory that the resident voxel octree may take while rendering, without light
    #[arg(long, value_name = "SIZE", value_parser = values::upper_budget, default_value = "64MiB")]
    pub upper_budget: Bytes,
    /// The memory limit that pictures will be made under: sets --upper-budget so that the voxels with their light take at most
    /// two fifths of it
    #[arg(long, value_name = "SIZE", value_parser = values::render_limit, conflicts_with_all = ["upper_budget", "voxels"])]
    pub render_limit: Option<Bytes>,
    /// Leave the voxel octree out: smaller, but without global illumination
    #[arg(long)]
    pub no_asvo: bool,
}

const AFTER_BUILD: &str = "\
The plan (memory, scratch and output size against the limit and the free space) is printed before work starts.
The output appears under its name only when it is whole: Ctrl-C leaves nothing half published.

Examples:
  trex build statue.ply -o statue.trex
  trex build hull.obj engine.stl -o ship.trex --error 0.0001
  trex build hull.obj -o ship.trex --render-limit 128MiB
  trex build gen:isosurface:20M:7 -o iso.trex --memory-limit 512MiB --json";

/// `trex info`
#[derive(Debug, Args)]
#[command(after_help = AFTER_INFO)]
pub struct InfoArgs {
    /// A page file, or a mesh: .ply, .obj, .stl or gen:KIND:COUNT
    #[arg(value_name = "FILE", value_parser = OsStringValueParser::new().map(Input::from))]
    pub input: Input,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_INFO: &str = "\
Examples:
  trex info statue.trex
  trex info statue.trex --json | jq .bytes_per_triangle";

/// `trex verify`
#[derive(Debug, Args)]
#[command(after_help = AFTER_VERIFY)]
pub struct VerifyArgs {
    /// The page file
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_VERIFY: &str = "\
Reads every byte; behind a damaged table it is not known where pages lie, and that table is named alone.
Exit status 0: clean. 1: damaged; pages, offsets and boxes are named.

Example:
  trex verify statue.trex";

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

#[cfg(test)]
mod tests {
    use super::*;
    use clap::CommandFactory;

    fn parse(line: &str) -> Result<Verb, clap::Error> {
        Cli::try_parse_from(line.split_whitespace()).map(|cli| cli.verb)
    }

    #[test]
    fn the_declaration_is_sound() {
        Cli::command().debug_assert();
    }

    #[test]
    fn build_takes_files_and_generators() {
        let Verb::Build(args) = parse("trex build a.ply gen:soup:10k -o m.trex --error 0.5").unwrap() else {
            panic!("not a build")
        };
        assert_eq!(args.inputs, [Input::File("a.ply".into()), Input::Generated("gen:soup:10k".into())]);
        assert_eq!((args.error, args.grid_bits, args.common.memory_limit), (Some(0.5), None, None));
        assert!(parse("trex build a.ply -o m.trex --error 1 --grid-bits 20").is_err());
        assert!(parse("trex build -o m.trex").is_err());
        assert!(parse("trex build a.ply").is_err());
    }

    #[test]
    fn render_takes_negative_coordinates_and_layers() {
        let line = "trex render m.trex -o m.exr --camera-position -1,-2.5,3 --layers depth,id --fov-y 40";
        let Verb::Render(args) = parse(line).unwrap() else { panic!("not a render") };
        assert_eq!(args.picture.camera.camera_position, Some(values::Vec3([-1.0, -2.5, 3.0])));
        assert_eq!(args.layers, [Layer::Depth, Layer::Id]);
        assert!(parse("trex render m.trex -o m.png --fov-x 40 --fov-y 40").is_err());
        assert!(parse("trex render m.trex -o m.png --spp 0").is_err());
    }

    #[test]
    fn only_the_demo_has_a_limit_of_its_own() {
        assert_eq!(parse("trex demo").unwrap().default_limit(), MemoryLimit::Bytes(256 << 20));
        assert_eq!(parse("trex info a.ply").unwrap().default_limit(), MemoryLimit::AUTO);
    }

    #[test]
    fn kinds_have_the_names_that_are_typed() {
        for kind in Kind::value_variants() {
            assert_eq!(kind.to_possible_value().unwrap().get_name(), kind.as_str());
        }
    }

    #[test]
    fn refusals_name_the_value_and_what_is_accepted() {
        let message = parse("trex info a.ply --memory-limit 512M").unwrap_err().to_string();
        assert!(
            message.contains("512M") && message.contains("512MiB") && message.contains("50%"),
            "{message}"
        );
    }
}
