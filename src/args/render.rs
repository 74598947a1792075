//! The command line of `trex render`, and of the pictures that `trex stress` makes.

use super::keys::{PICTURE, PictureKeys, RESEARCH, ResearchKeys};
use super::{CachedNetworkArgs, CommonArgs, DeviceArgs, DiskArgs, OverwriteArgs, PartArgs};
use crate::values::{self, Milliseconds, SampleRange, Seconds, TileShare, Vec3};
use clap::{Args, ValueEnum};
use std::path::PathBuf;
use std::time::Duration;
use trex_render::{FetchBlock, FrameOptions, Saliency, Scene, TileOrder};

/// `trex render`
#[derive(Debug, Args)]
#[command(after_help = AFTER_RENDER)]
pub struct RenderArgs {
    /// A page file, also at an http(s):// or s3:// address, or a scene (.toml) that names one
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// The picture: .png, or .exr for linear values and layers; of a part, .trexpart
    #[arg(short, long, value_name = "PICTURE")]
    pub output: PathBuf,
    /// Stop after this time, with the samples done by then (90s, 2min, 1500ms); photons get half of it, or three
    /// quarters where that brings none; smoothing and writing the picture come after it
    #[arg(long, value_name = "TIME", value_parser = values::seconds)]
    pub time_limit: Option<Seconds>,
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
    /// Render share I of N of the tiles alone, 1/N to N/N, to a .trexpart that `trex image merge` puts together
    #[arg(long, value_name = "I/N", value_parser = values::tile_share,
          conflicts_with_all = ["time_limit", "camera_path", "t_max"])]
    pub tiles: Option<TileShare>,
    /// Render these of the --spp samples alone, from A to the one before B, counted from 0, to a .trexpart
    #[arg(long, value_name = "A..B", value_parser = values::sample_range,
          conflicts_with_all = ["time_limit", "camera_path", "t_max"])]
    pub samples: Option<SampleRange>,
    #[command(flatten)]
    pub picture: PictureArgs,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub device: DeviceArgs,
    #[command(flatten)]
    pub disk: DiskArgs,
    #[command(flatten)]
    pub network: CachedNetworkArgs,
    #[command(flatten)]
    pub common: CommonArgs,
    #[command(flatten)]
    pub deadline: DeadlineArgs,
    #[command(flatten)]
    pub research: ResearchKeys,
}

const AFTER_RENDER: &str = "\
The picture depends on scene, seed and samples alone, not on the memory limit or the thread count.

Exit status 1 when pages that the picture asked for are damaged: it is written without them, and says so.

Examples:
  trex render statue.trex -o statue.png
  trex render iso.trex -o iso.exr --layers depth,normal --memory-limit 128MiB
  trex render ship.trex -o hull.png --camera-position 10,5,2 --camera-target 0,0,0 --spp 64
  trex render ship.trex -o cut.png --section 0,0,0,0,0,-1 --hide glass
  trex render ship.trex -o 3.trexpart --tiles 3/8      one of 8 parts; trex image merge joins them
  trex render ship.trex -o round.png --camera-path round.toml --spp 32
  trex render ship.trex -o hull.png --integrator photon --t-max 33 --lod-error 1 --time-limit 2s";

/// What a picture is of. What is not given comes from the scene.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = PICTURE)]
pub struct PictureArgs {
    #[command(flatten)]
    pub keys: PictureKeys,
    #[command(flatten)]
    pub parts: PartArgs,
    #[command(flatten)]
    pub camera: CameraArgs,
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
    /// Which tiles come first [default: error]
    #[arg(long, help_heading = RESEARCH, value_enum, value_name = "ORDER")]
    pub tile_order: Option<TileOrderArg>,
    /// What catches the eye [default: achanta]
    #[arg(long, help_heading = RESEARCH, value_enum, value_name = "METRIC")]
    pub saliency: Option<SaliencyArg>,
    /// Whether pages of the view that is likely to come next are read ahead, where there is room for them [default:
    /// off]
    #[arg(long, help_heading = RESEARCH, value_enum, value_name = "on|off")]
    pub prefetch: Option<PrefetchArg>,
    /// What light of earlier pictures is in those of a camera that moves [default: on]
    #[arg(long, help_heading = RESEARCH, value_enum, value_name = "on|picture|off")]
    pub history: Option<HistoryArg>,
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
    /// Where the last picture is likely to be wrong, and what of that catches the eye
    Error,
}

/// `--prefetch`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PrefetchArg {
    /// Where the hand moves to, and the view before once a picture is complete
    On,
    /// What rays wait for alone
    Off,
}

/// `--history`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum HistoryArg {
    /// That of the picture before, and that kept where it was found in the world
    On,
    /// That of the picture before, carried to where its surfaces are seen
    Picture,
    /// None: each is made of its own rays alone
    Off,
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
    pub fn override_scene(&self, research: &ResearchKeys, scene: &mut Scene) {
        let CameraArgs { camera_position, camera_target, camera_up, camera_direction, fov_x, fov_y } =
            &self.camera;
        let camera = &mut scene.camera;
        camera.position = camera_position.as_ref().map(|v| v.0).or(camera.position);
        camera.target = camera_target.as_ref().map(|v| v.0).or(camera.target);
        // What is up in the model goes before what the scene's camera says.
        let given_up = camera_up.as_ref().map(|v| v.0);
        camera.up = given_up.or(camera.up.filter(|_| self.keys.edit().up.is_none()));
        if let Some(direction) = camera_direction {
            // The scene's camera gives way to one that looks so.
            (camera.position, camera.target, camera.direction) = (None, None, Some(direction.0));
        } else if camera_position.is_some() {
            camera.direction = None;
        }
        if fov_x.is_some() || fov_y.is_some() {
            (camera.fov_x, camera.fov_y) = (*fov_x, *fov_y);
        }
        self.parts.override_parts(&mut scene.parts);
        let (edit, research) = (self.keys.edit(), research.edit());
        scene.render = research.apply(&edit.apply(&scene.render));
        scene.given.quality = edit.quality.or(scene.given.quality);
        scene.given.integrator = edit.integrator.or(scene.given.integrator);
        scene.given.lod_error = edit.lod_error.or(research.lod_error).or(scene.given.lod_error);
    }
}

impl DeadlineArgs {
    /// The flag of these that was given, if any: none of them says anything of a picture without a deadline.
    pub fn given(&self) -> Option<&'static str> {
        let flags = [
            ("--fetch-block", self.fetch_block.is_some()),
            ("--tile-order", self.tile_order.is_some()),
            ("--saliency", self.saliency.is_some()),
            ("--prefetch", self.prefetch.is_some()),
            ("--history", self.history.is_some()),
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
            carries_light: self.history.map_or(defaults.carries_light, |arg| arg != HistoryArg::Off),
            caches_light: self.history.map_or(defaults.caches_light, |arg| arg == HistoryArg::On),
            looks_ahead: self.prefetch.map_or(defaults.looks_ahead, |arg| arg == PrefetchArg::On),
            order: match self.tile_order {
                Some(TileOrderArg::Zcurve) => TileOrder::ZCurve,
                Some(TileOrderArg::Row) => TileOrder::Row,
                Some(TileOrderArg::Random) => TileOrder::Random,
                Some(TileOrderArg::Saliency) => TileOrder::Saliency(saliency),
                None | Some(TileOrderArg::Error) => TileOrder::Error(saliency),
            },
            ..defaults
        }
    }
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
    /// Which way is up in the picture (--up says it of the model)
    #[arg(long, value_name = "X,Y,Z", value_parser = values::vec3, allow_hyphen_values = true)]
    pub camera_up: Option<Vec3>,
    /// The direction it looks in, from where all of the model is seen
    #[arg(long, value_name = "X,Y,Z", value_parser = values::direction, allow_hyphen_values = true,
          conflicts_with_all = ["camera_position", "camera_target"])]
    pub camera_direction: Option<Vec3>,
    /// Field of view across, degrees
    #[arg(long, value_name = "DEG", value_parser = values::degrees, conflicts_with = "fov_y")]
    pub fov_x: Option<f64>,
    /// Field of view from bottom to top, degrees
    #[arg(long, value_name = "DEG", value_parser = values::degrees)]
    pub fov_y: Option<f64>,
}

/// `--layers`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Layer {
    /// Distance from the camera, model units
    Depth,
    /// Normal in model space
    Normal,
    /// Colour without light; of a lamp with its own, up to 1
    Albedo,
    /// Store id of the triangle
    Id,
}
