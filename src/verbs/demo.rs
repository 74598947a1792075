//! `trex demo`: generate, build and render under a memory limit; the other verbs in a row.

use super::build::{BuildSummary, Work, with_source};
use super::inputs::InputList;
use super::picture_file::PictureFile;
use super::render::Job;
use super::render_report::RenderReport;
use super::stage::io_options;
use crate::args::DemoArgs;
use crate::context::Context;
use crate::failure::Exit;
use crate::values::Input;
use datasets_gen::{Spec, views};
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use trex_model::DeviceOptions;
use trex_render::{Layers, Scene};
use trex_store::build::{ExistingOutput, Precision, Voxels};
use trex_store::import::VolumeOptions;
use trex_store::printable::one_line;
use trex_store::{Code, Error};

/// Folder of the demo's files when no other is named; it is the demo's own.
const FOLDER: &str = "out";
/// Degrees up to which planes that meet are one smooth surface: edges of bolts stay sharp.
const CREASE_DEG: f64 = 55.0;

/// Runs `trex demo`.
pub fn run(args: &DemoArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let name = format!("gen:{}:{}:{}", args.kind.as_str(), args.triangles, args.seed);
    let spec = Spec::parse(&name)?;
    let folder = args.output.parent().unwrap_or(Path::new(""));
    let own = folder == Path::new(FOLDER);
    if own {
        std::fs::create_dir_all(folder).map_err(|error| Error::io("make the folder", folder, &error))?;
    }
    let overwrite = own || args.overwrite.overwrite;
    let page_file = args.output.with_extension("trex");
    if page_file == args.output {
        return Err(Error::new(Code::Usage, "the demo's output is a picture")
            .at(&page_file)
            .next("end it in .png or .exr")
            .into());
    }
    PictureFile::check(&args.output, overwrite, Layers::default(), &[&page_file])?;

    ctx.console.note(&format!("generating and building {} triangles", args.triangles));
    let work = Work {
        output: &page_file,
        temp_dir: args.scratch.temp_dir.as_deref(),
        existing: ExistingOutput::replace_if(overwrite),
        precision: Precision::Default,
        voxels: Voxels::default(),
        resume: None,
    };
    let (inputs, volumes) = ([Input::Generated(name)], VolumeOptions::default());
    let inputs = InputList { crease_deg: Some(CREASE_DEG), ..InputList::whole(&inputs, &volumes) };
    let build = with_source(inputs, &work.scratch_folder(), ctx, |source| work.build(source, ctx))?;
    ctx.console.finish();

    let mut scene = Scene::default();
    if let Some(view) = views(&spec).first() {
        scene.camera.position = Some(view.position);
        scene.camera.target = Some(view.target);
        scene.camera.up = Some(view.up);
        scene.camera.fov_x = Some(view.fov_x_deg);
    }
    scene.render.resolution = [args.resolution.width, args.resolution.height];
    scene.render.spp = args.spp;
    scene.render.seed = args.seed;
    let job = Job {
        scene: &scene,
        scene_file: None,
        file: &page_file,
        output: &args.output,
        camera_path: None,
        overwrite,
        layers: Layers::default(),
        portion: None,
        io: io_options(&args.disk),
        device: DeviceOptions::default(),
        time_limit: None,
        live: None,
    };
    let render = job.render(ctx)?;
    ctx.done(&Demo { build, render, page_file })
}

#[derive(Serialize)]
struct Demo {
    build: BuildSummary,
    render: RenderReport,
    /// What `view` would show.
    #[serde(skip)]
    page_file: PathBuf,
}

impl fmt::Display for Demo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}\n{}", self.build, self.render)?;
        write!(f, "live in a browser: trex view {}", one_line(&self.page_file.display().to_string()))
    }
}
