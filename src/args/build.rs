//! The command line of `trex build`, `trex info` and `trex verify`.

use super::{CachedNetworkArgs, CommonArgs, NetworkArgs, OverwriteArgs, RawArgs, ScratchArgs, VolumeArgs};
use crate::values::{self, Bytes, Input, ShardNumber};
use clap::builder::{OsStringValueParser, TypedValueParser};
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use trex_store::AttributeSet;
use trex_store::build::Precision;
use trex_store::verify::Level;

/// What becomes of the mesh itself.
const MESH: &str = "Mesh options";

/// `trex build`
#[derive(Debug, Args)]
#[command(after_help = AFTER_BUILD)]
pub struct BuildArgs {
    /// Meshes: .ply, .obj, .stl, .gltf or .glb files, or gen:KIND:COUNT, also with :SEED and
    /// :colors=low or :colors=high; volumes: .nrrd, .nhdr, .mhd, .mha or .raw, with --iso; several become one model
    #[arg(value_name = "INPUT", required_unless_present_any = ["clean", "plan"], num_args = 1..,
          value_parser = OsStringValueParser::new().map(Input::from))]
    pub inputs: Vec<Input>,
    /// The page file to publish; with --shard, the fragment
    #[arg(short, long, value_name = "OUT.trex")]
    pub output: PathBuf,
    #[command(flatten)]
    pub lattice: LatticeArgs,
    #[command(flatten)]
    pub attributes: AttributeArgs,
    #[command(flatten)]
    pub volumes: VolumeArgs,
    #[command(flatten)]
    pub voxels: VoxelArgs,
    #[command(flatten)]
    pub resume: ResumeArgs,
    #[command(flatten)]
    pub shard: ShardArgs,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

/// What is kept of what corners have.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = MESH)]
pub struct AttributeArgs {
    /// What becomes of the colours of vertices and faces, which multiply the diffuse colour of their material
    #[arg(long, value_enum, value_name = "WHAT", default_value_t = AttributeChoice::Keep)]
    colors: AttributeChoice,
    /// What becomes of the normals of vertices, which shade the mesh as if it were smooth: `keep`, `drop`, or
    /// `from-crease:DEG`, made of the planes at each place that differ by DEG degrees at most (0 to 180)
    #[arg(long, value_name = "WHAT", value_parser = normal_choice, default_value = "keep")]
    normals: NormalChoice,
}

impl AttributeArgs {
    /// What corners lose.
    pub fn dropped(&self) -> AttributeSet {
        AttributeSet {
            colours: self.colors == AttributeChoice::Drop,
            normals: self.normals == NormalChoice::Drop,
        }
    }

    /// Degrees up to which planes that meet are one smooth surface, where normals are made.
    pub fn crease_deg(&self) -> Option<f64> {
        match self.normals {
            NormalChoice::FromCrease(degrees) => Some(degrees),
            NormalChoice::Keep | NormalChoice::Drop => None,
        }
    }
}

/// The lattice of a build.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = MESH)]
pub struct LatticeArgs {
    /// Bits of the lattice along the model's longest side (default: chosen from the edges, see `trex info`)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(8..=40), conflicts_with = "error")]
    pub grid_bits: Option<u8>,
    /// Largest distance a vertex may move when snapped to the lattice, model units
    #[arg(long, value_name = "LENGTH", value_parser = values::positive)]
    pub error: Option<f64>,
}

impl LatticeArgs {
    /// The library's form.
    pub fn precision(&self) -> Precision {
        match (self.grid_bits, self.error) {
            (Some(bits), _) => Precision::GridBits(u32::from(bits)),
            (None, Some(error)) => Precision::Error(error),
            (None, None) => Precision::Default,
        }
    }
}

/// `--normals`.
#[derive(Clone, Copy, Debug, PartialEq)]
enum NormalChoice {
    Keep,
    Drop,
    /// Made from the mesh: planes that differ by so many degrees at most are one surface.
    FromCrease(f64),
}

/// Parses `keep`, `drop` or `from-crease:DEG`.
fn normal_choice(text: &str) -> Result<NormalChoice, String> {
    let degrees = text.strip_prefix("from-crease:").and_then(|degrees| degrees.parse::<f64>().ok());
    match (text, degrees) {
        ("keep", _) => Ok(NormalChoice::Keep),
        ("drop", _) => Ok(NormalChoice::Drop),
        (_, Some(degrees)) if (0.0..=180.0).contains(&degrees) => Ok(NormalChoice::FromCrease(degrees)),
        _ => Err("accepted are keep, drop and from-crease:DEG, an angle from 0 to 180 degrees".into()),
    }
}

/// `--colors`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum AttributeChoice {
    /// In pages of their own
    Keep,
    /// Left out: the model is its materials, or its planes, alone
    Drop,
}

/// What becomes of a build that is killed or interrupted.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Resume options")]
pub struct ResumeArgs {
    /// Keep nothing that a build could go on from, and remove what an earlier one has left
    #[arg(long)]
    pub no_resume: bool,
    /// Build nothing: remove what unfinished builds of the output have left; of all outputs in a folder, where -o names
    /// one
    #[arg(long, conflicts_with_all = ["inputs", "no_resume"])]
    pub clean: bool,
    /// About how much work a kill may cost, once the input has been read
    #[arg(long, value_name = "TIME", value_parser = values::seconds, default_value = "3s")]
    pub journal_every: values::Seconds,
}

/// The voxel octree of a build.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Voxel options")]
pub struct VoxelArgs {
    /// Leaf voxels along the model's longest side: RU in the resident octree, RFINEST (1, 4 or 16 times RU) in units
    /// below it that are read when rays ask for them (default: as many RU as the mesh's own size and --upper-budget
    /// allow, and no units)
    #[arg(long, value_name = "RU[/RFINEST]", value_parser = values::voxels, conflicts_with = "no_asvo")]
    pub voxels: Option<values::Voxels>,
    /// Most memory that the resident voxel octree may take while rendering, without light
    #[arg(long, value_name = "SIZE", value_parser = values::upper_budget, default_value = "64MiB")]
    pub upper_budget: Bytes,
    /// The memory limit that pictures will be made under: sets --upper-budget so that the voxels with their light
    /// take at most two fifths of it
    #[arg(long, value_name = "SIZE", value_parser = values::render_limit,
          conflicts_with_all = ["upper_budget", "voxels"])]
    pub render_limit: Option<Bytes>,
    /// Leave the voxel octree out: smaller, but without global illumination
    #[arg(long)]
    pub no_asvo: bool,
}

/// The share of a build that one machine does.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Shard options")]
pub struct ShardArgs {
    /// Build a shard of this plan, which `trex scan` has made of the same inputs; lattice and voxels are the plan's. No
    /// INPUT needs to be named where the plan holds the triangles
    #[arg(long, value_name = "PLAN", requires = "shard",
          conflicts_with_all = ["grid_bits", "error", "voxels", "upper_budget", "render_limit", "no_asvo", "clean"])]
    pub plan: Option<PathBuf>,
    /// Build shard I of N alone, 1/N to N/N, to a fragment that `trex merge` puts together; one that is there is left
    /// as it is
    #[arg(long, value_name = "I/N", value_parser = values::shard_number, requires = "plan")]
    pub shard: Option<ShardNumber>,
}

const AFTER_BUILD: &str = "\
The plan (memory, scratch and output size against the limit and the free space) is printed before work starts. \
The output appears under its name only when it is whole. A build that is killed, interrupted or ended by its \
limit goes on when the same command runs again, with any limit: a journal beside the output tells how far it was, \
and `trex info FOLDER` lists such builds. \
Camera and lights of glTF go to OUT.toml, a scene beside the output, unless a file of that name is there.

Examples:
  trex build statue.ply -o statue.trex
  trex build hull.obj engine.stl -o ship.trex --error 0.0001
  trex build hull.obj -o ship.trex --render-limit 128MiB
  trex build head.nrrd -o head.trex --iso 60 --iso 120
  trex build head.raw -o head.trex --iso 60 --size 256x256x180 --type uint16
  trex build gen:isosurface:20M:7 -o iso.trex --memory-limit 512MiB --json
  trex build statue.ply --plan statue.trexplan --shard 3/8 -o 3.trexfrag     see trex scan
  trex build --clean -o ship.trex                      remove what a killed build has left";

/// `trex info`
#[derive(Debug, Args)]
#[command(after_help = AFTER_INFO)]
pub struct InfoArgs {
    /// A page file, also at an http(s):// or s3:// address, a mesh (.ply, .obj, .stl, .gltf, .glb or
    /// gen:KIND:COUNT), a volume (.nrrd, .nhdr, .mhd, .mha or .raw), a part of a picture (.trexpart), or a folder or an
    /// output with unfinished builds
    #[arg(value_name = "FILE", value_parser = OsStringValueParser::new().map(Input::from))]
    pub input: Input,
    #[command(flatten)]
    pub raw: RawArgs,
    #[command(flatten)]
    pub network: CachedNetworkArgs,
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
    /// The page file, also at an http(s):// or s3:// address; of it nothing is kept
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Check the structure only: superblocks, tables, ranges; pages are not read
    #[arg(long, conflicts_with = "deep")]
    pub quick: bool,
    /// Decode every page too, and check that mesh, octree and units agree
    #[arg(long)]
    pub deep: bool,
    /// Most bytes to read in a second, with their unit (50MB); as fast as it goes without
    #[arg(long, value_name = "BYTES/S", value_parser = values::rate)]
    pub rate: Option<values::Bytes>,
    #[command(flatten)]
    pub network: NetworkArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

impl VerifyArgs {
    /// How far the file is looked at.
    pub fn level(&self) -> Level {
        match (self.quick, self.deep) {
            (true, _) => Level::Quick,
            (_, true) => Level::Deep,
            _ => Level::Hashes,
        }
    }
}

const AFTER_VERIFY: &str = "\
Without --quick or --deep every byte is read and compared with its hash. --deep takes memory for the octree, too. \
Behind a damaged table it is not known where pages lie, and that table is named alone. \
Exit status 0: clean. 1: damaged; pages, byte ranges, boxes and counts of triangles are named.

Examples:
  trex verify statue.trex
  trex verify statue.trex --quick                      is it whole at a glance?
  trex verify statue.trex --deep --rate 50MB           beside other work";
