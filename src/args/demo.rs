//! The command line of `trex demo` and `trex gen`.

use super::{CommonArgs, DiskArgs, Kind, OverwriteArgs, ScratchArgs, keys};
use crate::values::{self, Resolution};
use clap::{Args, ValueEnum};
use datasets_gen::ColourFrequency;
use std::path::PathBuf;
use trex_render::RenderKeys;

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
    /// Triangles to generate, within 1 % (250k, 5M, 1G); normals are made of them
    #[arg(long, value_name = "N", default_value = "5M", value_parser = values::count)]
    pub triangles: u64,
    /// Size of the picture, pixels
    #[arg(long, value_name = "WxH", default_value = "1024x1024", value_parser = values::resolution)]
    pub resolution: Resolution,
    /// Samples per pixel
    #[arg(long, value_name = "N", default_value_t = RenderKeys::default().spp, value_parser = keys::samples)]
    pub spp: u32,
    /// Seed of the mesh and of the samples
    #[arg(long, value_name = "N", default_value_t = RenderKeys::default().seed, value_parser = keys::seed)]
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
    /// The file; its ending chooses the format: .ply (binary), .obj, .glb or .stl (binary)
    #[arg(short, long, value_name = "FILE")]
    pub output: PathBuf,
    /// Seed; the same seed gives the same bytes
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Colours of the vertices, waves over the place; none without
    #[arg(long, value_enum, value_name = "FREQUENCY")]
    pub colors: Option<GeneratedColors>,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

/// Colours of a generated mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum GeneratedColors {
    /// Waves of a tenth of the model and more
    Low,
    /// Also of some edges, with noise
    High,
}

impl GeneratedColors {
    /// The generator's form.
    pub fn frequency(self) -> ColourFrequency {
        match self {
            GeneratedColors::Low => ColourFrequency::Low,
            GeneratedColors::High => ColourFrequency::High,
        }
    }
}

const AFTER_GEN: &str = "\
`trex build gen:KIND:COUNT[:SEED][:colors=low|high] -o OUT.trex` builds the same mesh with no file between.

Examples:
  trex gen isosurface --triangles 20M -o iso.ply
  trex gen pipes --triangles 1M --seed 7 -o plant.obj
  trex gen scan --triangles 5M --colors high -o statue.ply";
