//! The command line of `trex render`.

use super::{CommonArgs, DiskArgs, OverwriteArgs};
use crate::values::{self, Resolution, Seconds, Vec3};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// `trex render`
#[derive(Debug, Args)]
#[command(after_help = AFTER_RENDER)]
pub struct RenderArgs {
    /// A page file, or a scene (.toml) that names one
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// The picture: .png, or .exr for linear values and layers
    #[arg(short, long, value_name = "PICTURE")]
    pub output: PathBuf,
    /// How light is computed (default: the scene's, else direct)
    #[arg(long, value_enum, value_name = "NAME")]
    pub integrator: Option<Integrator>,
    /// Size of the picture, pixels (default: the scene's, else 1024x1024)
    #[arg(long, value_name = "WxH", value_parser = values::resolution)]
    pub resolution: Option<Resolution>,
    /// Samples per pixel (default: the scene's, else 16)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub spp: Option<u32>,
    /// Stop after this time, with the samples done by then (90s, 2min, 1500ms)
    #[arg(long, value_name = "TIME", value_parser = values::seconds)]
    pub time_limit: Option<Seconds>,
    /// Shadow rays per hit (default: the scene's, else 2)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=4096))]
    pub n_shadow: Option<u32>,
    #[command(flatten)]
    pub g_rays: GRayArgs,
    /// Seed of the samples (default: the scene's, else 1)
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// Factor on the light before it becomes a PNG (default: the scene's, else 1)
    #[arg(long, value_name = "FACTOR", value_parser = values::positive)]
    pub exposure: Option<f64>,
    /// Further layers of an EXR
    #[arg(long, value_enum, value_name = "LAYER", value_delimiter = ',')]
    pub layers: Vec<Layer>,
    #[command(flatten)]
    pub camera: CameraArgs,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub disk: DiskArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_RENDER: &str = "\
The picture depends on scene, seed and samples alone, not on the memory limit or the thread count.

Examples:
  trex render statue.trex -o statue.png
  trex render iso.trex -o iso.exr --layers depth,normal --memory-limit 128MiB
  trex render ship.trex -o hull.png --camera-position 10,5,2 --camera-target 0,0,0 --spp 64";

/// How indirect light is found.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Options of photon and ao (default: the scene's)")]
pub struct GRayArgs {
    /// Gather rays per hit (else 2)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=4096))]
    pub n_gather: Option<u32>,
    /// Photons in all (else 2M)
    #[arg(long, value_name = "N", value_parser = values::count)]
    pub photons: Option<u64>,
    /// How shadow and gather rays begin: a voxel off the surface, or on the exact mesh (else voxel)
    #[arg(long, value_enum, value_name = "HOW")]
    pub near: Option<NearArg>,
    /// Whether voxels are what their bitmaps say, or whole cubes (else on)
    #[arg(long, value_enum, value_name = "WHETHER")]
    pub occluders: Option<OccludersArg>,
}

/// `--near`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum NearArg {
    /// A voxel off the surface
    Voxel,
    /// On the exact mesh for some voxels' length
    Exact,
}

/// `--occluders`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum OccludersArg {
    /// Bitmaps count
    On,
    /// Voxels are cubes
    Off,
}

/// The view. What is not given comes from the scene, else from a camera that frames the model.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Camera options (default: the scene's, else one that frames the model)")]
pub struct CameraArgs {
    /// Where the camera stands, model units
    #[arg(long, value_name = "X,Y,Z", value_parser = values::vec3, allow_hyphen_values = true)]
    pub camera_position: Option<Vec3>,
    /// The point it looks at, model units
    #[arg(long, value_name = "X,Y,Z", value_parser = values::vec3, allow_hyphen_values = true)]
    pub camera_target: Option<Vec3>,
    /// Which way is up
    #[arg(long, value_name = "X,Y,Z", value_parser = values::vec3, allow_hyphen_values = true)]
    pub camera_up: Option<Vec3>,
    /// Field of view across, degrees
    #[arg(long, value_name = "DEG", value_parser = values::degrees, conflicts_with = "fov_y")]
    pub fov_x: Option<f64>,
    /// Field of view from bottom to top, degrees
    #[arg(long, value_name = "DEG", value_parser = values::degrees)]
    pub fov_y: Option<f64>,
}

/// `--integrator`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Integrator {
    /// Direct light and perfect mirrors on the exact mesh
    Direct,
    /// All light, unbiased, on the exact mesh
    Path,
    /// All light but caustics of lobes, by photons and voxels: what is seen and its mirrors on the exact mesh
    Photon,
    /// Ambient occlusion: white light from all sides on white surfaces, by voxels where the file has them
    Ao,
    /// The voxels, as cubes
    DebugUpper,
    /// The voxels' bitmaps
    DebugOccluders,
    /// The mesh, a colour per page
    DebugPages,
}

/// `--layers`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Layer {
    /// Distance from the camera, model units
    Depth,
    /// Normal in model space
    Normal,
    /// Colour without light
    Albedo,
    /// Store id of the triangle
    Id,
}
