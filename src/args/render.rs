//! The command line of `trex render`, and of the pictures that `trex stress` makes.

use super::{CommonArgs, DiskArgs, OverwriteArgs};
use crate::values::{self, Milliseconds, Resolution, Seconds, Vec3};
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::time::Duration;
use trex_render::{
    FetchBlock, Filter, FrameOptions, Method, Near, Occluders, Quality, RenderEdit, Saliency, Scene,
    TileOrder,
};

/// Heading of what a picture is of. A group of flags stands where its first flag is declared, so the verbs declare one
/// of these first, and [`PictureArgs`] and [`DeadlineArgs`] last: research comes last then.
pub const PICTURE: &str = "Picture options (default: the scene's)";
/// Heading of what is turned to compare methods, not to make pictures.
const RESEARCH: &str = "Research options";

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
    /// Samples per pixel (default: the scene's, else 16)
    #[arg(long, help_heading = PICTURE, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub spp: Option<u32>,
    /// Stop after this time, with the samples done by then (90s, 2min, 1500ms)
    #[arg(long, value_name = "TIME", value_parser = values::seconds)]
    pub time_limit: Option<Seconds>,
    /// Factor on the light before it becomes a PNG (default: the scene's, else 1)
    #[arg(long, help_heading = PICTURE, value_name = "FACTOR", value_parser = values::positive)]
    pub exposure: Option<f64>,
    /// A picture from each of these viewpoints, PICTURE-0001.png and so on, in place of the camera's own. TOML: an
    /// array of tables `view`, each with position, target and, if you like, up
    #[arg(long, value_name = "VIEWS.toml", conflicts_with = "t_max")]
    pub camera_path: Option<PathBuf>,
    /// Exit with 0 also when damaged pages are left out of the picture
    #[arg(long)]
    pub allow_damage: bool,
    /// Further layers of an EXR
    #[arg(long, value_enum, value_name = "LAYER", value_delimiter = ',')]
    pub layers: Vec<Layer>,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub disk: DiskArgs,
    #[command(flatten)]
    pub common: CommonArgs,
    #[command(flatten)]
    pub picture: PictureArgs,
    #[command(flatten)]
    pub deadline: DeadlineArgs,
}

const AFTER_RENDER: &str = "\
The picture depends on scene, seed and samples alone, not on the memory limit or the thread count.

Exit status 1 when pages that the picture asked for are damaged: it is written without them, and says so.

Examples:
  trex render statue.trex -o statue.png
  trex render iso.trex -o iso.exr --layers depth,normal --memory-limit 128MiB
  trex render ship.trex -o hull.png --camera-position 10,5,2 --camera-target 0,0,0 --spp 64
  trex render ship.trex -o round.png --camera-path round.toml --spp 32
  trex render ship.trex -o hull.png --integrator photon --t-max 33 --lod-error 1 --time-limit 2s";

/// What a picture is of. What is not given comes from the scene.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = PICTURE)]
pub struct PictureArgs {
    /// Many of these at once, a trade of time for accuracy; those given beside it go before it (else normal)
    #[arg(long, value_enum, value_name = "NAME")]
    pub quality: Option<QualityArg>,
    /// How light is computed (else photon; direct where the file has no voxels)
    #[arg(long, value_enum, value_name = "NAME")]
    pub integrator: Option<Integrator>,
    /// Size of the picture, pixels (else 1024x1024; stress: 512x512)
    #[arg(long, value_name = "WxH", value_parser = values::resolution)]
    pub resolution: Option<Resolution>,
    /// Shadow rays per hit (else 2)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=4096))]
    pub n_shadow: Option<u32>,
    /// Gather rays per hit, of photon and full-gi (else 2)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=4096))]
    pub n_gather: Option<u32>,
    /// Photons in all (else 1M; stress, view: 2M)
    #[arg(long, value_name = "N", value_parser = values::count)]
    pub photons: Option<u64>,
    /// How shadow and gather rays of photon and ao begin: a voxel off the surface, or on the exact mesh (else voxel)
    #[arg(long, value_enum, value_name = "HOW")]
    pub near: Option<NearArg>,
    /// Smooth indirect light where the pixels show the same surface, of photon and full-gi (else on)
    #[arg(long, value_enum, value_name = "WHETHER")]
    pub filter: Option<Switch>,
    /// Where a leaf voxel covers at most this many pixels it stands for the mesh; 0 = the exact mesh everywhere (else
    /// 0; stress: 1)
    #[arg(long, value_name = "PX", value_parser = values::pixels)]
    pub lod_error: Option<f64>,
    /// Seed of the samples (else 1)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(..1 << 63))]
    pub seed: Option<u64>,
    #[command(flatten)]
    pub camera: CameraArgs,
    /// Photons that tell the light of a place, of full-gi (else 50)
    #[arg(long, help_heading = RESEARCH, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=1024))]
    pub k_nearest: Option<u32>,
    /// Send the photons of photon through the exact mesh: slower, and closer to it
    #[arg(long, help_heading = RESEARCH)]
    pub bake: bool,
    /// Whether voxels are what their bitmaps say, or whole cubes (else on)
    #[arg(long, help_heading = RESEARCH, value_enum, value_name = "WHETHER")]
    pub occluders: Option<Switch>,
}

/// Frames with a deadline.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = PICTURE)]
pub struct DeadlineArgs {
    /// Longest time of a frame: the picture is made in frames, as a viewer would show them (stress: 100; render: none)
    #[arg(long, value_name = "MS", value_parser = values::milliseconds)]
    pub t_max: Option<Milliseconds>,
    /// Tiles of 8x8 pixels that are shown together, or `adaptive`: as many as take half of the frame at the speed of
    /// late [default: 64]
    #[arg(long, help_heading = RESEARCH, value_name = "N", value_parser = values::fetch_block)]
    pub fetch_block: Option<FetchBlock>,
    /// Which tiles come first [default: saliency]
    #[arg(long, help_heading = RESEARCH, value_enum, value_name = "ORDER")]
    pub tile_order: Option<TileOrderArg>,
    /// What catches the eye [default: achanta]
    #[arg(long, help_heading = RESEARCH, value_enum, value_name = "METRIC")]
    pub saliency: Option<SaliencyArg>,
}

/// `--tile-order`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum TileOrderArg {
    /// Neighbours after each other: the fastest
    Zcurve,
    /// Row by row
    Row,
    /// By chance
    Random,
    /// What catches the eye in the last picture
    Saliency,
}

/// `--saliency`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum SaliencyArg {
    /// Colours far from the mean colour (Achanta et al. 2009)
    Achanta,
    /// Contrast of intensity, colour and orientation (Itti et al. 1998)
    Itti,
}

impl PictureArgs {
    /// What is given goes before what the scene says.
    pub fn override_scene(&self, scene: &mut Scene) {
        let CameraArgs { camera_position, camera_target, camera_up, fov_x, fov_y } = &self.camera;
        let camera = &mut scene.camera;
        camera.position = camera_position.as_ref().map(|v| v.0).or(camera.position);
        camera.target = camera_target.as_ref().map(|v| v.0).or(camera.target);
        camera.up = camera_up.as_ref().map(|v| v.0).or(camera.up);
        if fov_x.is_some() || fov_y.is_some() {
            (camera.fov_x, camera.fov_y) = (*fov_x, *fov_y);
        }
        let edit = self.edit();
        scene.render = edit.apply(&scene.render);
        scene.given.quality = edit.quality.or(scene.given.quality);
        scene.given.integrator = edit.integrator.or(scene.given.integrator);
    }

    fn edit(&self) -> RenderEdit {
        let is_on = |switch: Switch| switch == Switch::On;
        RenderEdit {
            quality: self.quality.map(QualityArg::quality),
            integrator: self.integrator.map(Integrator::method),
            resolution: self.resolution.as_ref().map(|r| [r.width, r.height]),
            spp: None,
            n_shadow: self.n_shadow,
            n_gather: self.n_gather,
            photons: self.photons,
            k_nearest: self.k_nearest,
            bake: self.bake.then_some(true),
            near: self.near.map(|near| match near {
                NearArg::Voxel => Near::Voxel,
                NearArg::Exact => Near::Exact,
            }),
            occluders: self
                .occluders
                .map(|switch| if is_on(switch) { Occluders::On } else { Occluders::Off }),
            lod_error: self.lod_error,
            filter: self.filter.map(|switch| if is_on(switch) { Filter::On } else { Filter::Off }),
            exposure: None,
            seed: self.seed,
        }
    }
}

impl DeadlineArgs {
    /// The flag of these that was given, if any: none of them says anything of a picture without a deadline.
    pub fn given(&self) -> Option<&'static str> {
        let flags = [
            ("--fetch-block", self.fetch_block.is_some()),
            ("--tile-order", self.tile_order.is_some()),
            ("--saliency", self.saliency.is_some()),
        ];
        flags.into_iter().find_map(|(flag, is_given)| is_given.then_some(flag))
    }

    /// The library's form, for frames of `t_max`.
    pub fn options(&self, t_max: &Milliseconds) -> FrameOptions {
        let defaults = FrameOptions::default();
        let saliency = match self.saliency {
            None | Some(SaliencyArg::Achanta) => Saliency::Achanta,
            Some(SaliencyArg::Itti) => Saliency::Itti,
        };
        FrameOptions {
            fills_while_moving: true,
            t_max: Duration::from_secs_f64(t_max.0 / 1e3),
            fetch_block: self.fetch_block.unwrap_or(defaults.fetch_block),
            order: match self.tile_order {
                Some(TileOrderArg::Zcurve) => TileOrder::ZCurve,
                Some(TileOrderArg::Row) => TileOrder::Row,
                Some(TileOrderArg::Random) => TileOrder::Random,
                None | Some(TileOrderArg::Saliency) => TileOrder::Saliency(saliency),
            },
        }
    }
}

impl QualityArg {
    fn quality(self) -> Quality {
        match self {
            QualityArg::Draft => Quality::Draft,
            QualityArg::Normal => Quality::Normal,
            QualityArg::Reference => Quality::Reference,
        }
    }
}

impl Integrator {
    fn method(self) -> Method {
        match self {
            Integrator::Direct => Method::Direct,
            Integrator::Path => Method::Path,
            Integrator::Ao => Method::Ao,
            Integrator::Photon | Integrator::CpuGi => Method::Photon,
            Integrator::FullGi => Method::FullGi,
            Integrator::DebugUpper => Method::DebugUpper,
            Integrator::DebugLower => Method::DebugLower,
            Integrator::DebugOccluders => Method::DebugOccluders,
            Integrator::DebugPages => Method::DebugPages,
        }
    }
}

/// `--near`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum NearArg {
    /// A voxel off the surface
    Voxel,
    /// On the exact mesh for some voxels' length
    Exact,
}

/// `--occluders`, `--filter`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Switch {
    /// It does
    On,
    /// It does not
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

/// `--quality`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum QualityArg {
    /// A look, in the shortest time that shows all light
    Draft,
    /// A picture to work with
    Normal,
    /// What others are measured by: path, for as long as it takes
    Reference,
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
    /// As photon, with everything on the CPU: the same as photon as long as that has no other device
    CpuGi,
    /// All light but some caustics, by photons in a kd-tree: everything on the exact mesh
    FullGi,
    /// Ambient occlusion: white light from all sides on white surfaces, by voxels where the file has them
    Ao,
    /// The voxels of the resident octree, as cubes
    DebugUpper,
    /// The finest voxels, as cubes
    DebugLower,
    /// Their bitmaps
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
