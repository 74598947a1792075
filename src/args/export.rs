//! The command line of `trex export`.

use super::{CachedNetworkArgs, CommonArgs, OverwriteArgs};
use crate::values::{self, ModelBox};
use clap::Args;
use std::path::PathBuf;

/// `trex export`
#[derive(Debug, Args)]
#[command(after_help = AFTER_EXPORT)]
pub struct ExportArgs {
    /// The page file, also at an http(s):// or s3:// address
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// The mesh; its ending chooses the format: .ply (binary), .obj with its .mtl, .glb, or .stl (binary)
    #[arg(short, long, value_name = "MESH")]
    pub output: PathBuf,
    /// Only triangles whose middle is in this box, model units (default: all)
    #[arg(long = "box", value_name = "X0,Y0,Z0,X1,Y1,Z1", value_parser = values::model_box, allow_hyphen_values = true)]
    pub bounds: Option<ModelBox>,
    /// Only triangles of this material; several may be named (default: all)
    #[arg(long, value_name = "NAME")]
    pub material: Vec<String>,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub network: CachedNetworkArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_EXPORT: &str = "\
Vertices stand where the page file has them, to the bit; .stl rounds them to single precision. Materials go to .obj \
and .glb. The file tells origin and step of the lattice, so that `trex build` gives the same triangles again. Boxes \
that fill space without gaps share no triangle. A .glb holds 4 GiB at most.

Examples:
  trex export statue.trex -o statue.ply
  trex export plant.trex -o corner.obj --box 0,0,0,10,10,4
  trex export ship.trex -o hull.ply --material hull
  trex export engine.trex -o engine.glb";
