//! The command line of builds in shards: `trex scan` and `trex merge`.

use super::build::{AttributeArgs, LatticeArgs, VoxelArgs};
use super::{CommonArgs, OverwriteArgs, ScratchArgs, VolumeArgs};
use crate::values::Input;
use clap::Args;
use clap::builder::{OsStringValueParser, TypedValueParser};
use std::path::PathBuf;

/// `trex scan`
#[derive(Debug, Args)]
#[command(after_help = AFTER_SCAN)]
pub struct ScanArgs {
    /// Inputs as those of `trex build`; several become one model
    #[arg(value_name = "INPUT", required = true, num_args = 1..,
          value_parser = OsStringValueParser::new().map(Input::from))]
    pub inputs: Vec<Input>,
    /// The plan to publish
    #[arg(short, long, value_name = "PLAN.trexplan")]
    pub output: PathBuf,
    /// Keep the triangles in the plan, sorted, at 4 to 9 bytes each, more with colours and normals: shards read these,
    /// and no inputs
    #[arg(long)]
    pub keep_triangles: bool,
    #[command(flatten)]
    pub lattice: LatticeArgs,
    #[command(flatten)]
    pub attributes: AttributeArgs,
    #[command(flatten)]
    pub volumes: VolumeArgs,
    #[command(flatten)]
    pub voxels: VoxelArgs,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_SCAN: &str = "\
The plan holds what the shards of a build agree on: lattice, voxel resolution, materials, and the cells of the model \
with their counts. Each shard reads the same inputs, by whatever path, and keeps its share; with --keep-triangles it \
reads its share of the plan instead, wherever that lies. The merged file has the bytes of one `trex build`, whatever \
the number of shards.

Examples:
  trex scan statue.ply -o statue.trexplan
  trex build statue.ply --plan statue.trexplan --shard 1/2 -o 1.trexfrag    on one machine
  trex build statue.ply --plan statue.trexplan --shard 2/2 -o 2.trexfrag    on another
  trex merge 1.trexfrag 2.trexfrag -o statue.trex
  trex scan hull.obj -o hull.trexplan --keep-triangles
  trex build --plan hull.trexplan --shard 1/2 -o 1.trexfrag                 without the input";

/// `trex merge`
#[derive(Debug, Args)]
#[command(after_help = AFTER_MERGE)]
pub struct MergeArgs {
    /// The fragments of all shards, in any order
    #[arg(value_name = "PART.trexfrag", required = true)]
    pub fragments: Vec<PathBuf>,
    /// The page file to publish
    #[arg(short, long, value_name = "OUT.trex")]
    pub output: PathBuf,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_MERGE: &str = "\
Fragments of other plans or versions are refused, and so are those that are missing, there twice, or damaged. The \
merge packs the pages that chunks share, makes the voxel octree, the top of the tree and the tables, reads all back, \
and publishes the file under its name. One that was killed starts again.

Examples:
  trex merge 1.trexfrag 2.trexfrag -o statue.trex
  trex merge parts/*.trexfrag -o statue.trex --memory-limit 1GiB";
