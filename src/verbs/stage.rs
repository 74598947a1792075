//! `Stage`: a page file on show: opened, its memory shared out, its pool started. What `render`, `demo` and `stress` begin with.

use super::shares::{Picture, Shares, model_bytes};
use crate::args::DiskArgs;
use crate::context::Context;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use trex_bench::stress;
use trex_render::camera::Camera;
use trex_render::emitter::Emitter;
use trex_render::film::Layers;
use trex_render::live::FrameOptions;
use trex_render::scene::Scene;
use trex_render::session::Session;
use trex_render::trace::{PagedMesh, PooledPages, tracers};
use trex_render::voxel::Voxels;
use trex_render::world::{Model, View};
use trex_store::io::IoOptions;
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{Budget, Code, Error, Lease, PageFile, Result};

/// A file, its pool, and what the scene says of them.
pub struct Stage {
    pub file: Arc<PageFile>,
    pub pool: PagePool,
    pub shares: Shares,
    model: Model,
    view: View,
    layers: Layers,
    _lease: Lease,
}

/// What is to be shown, and how.
#[derive(Clone, Copy)]
pub struct Play<'a> {
    pub scene: &'a Scene,
    pub file: &'a Path,
    pub layers: Layers,
    pub io: &'a IoOptions,
    /// How frames with a deadline are made, if there is one.
    pub live: Option<FrameOptions>,
}

impl Stage {
    /// Opens the file under the limit of `ctx`.
    pub fn open(play: &Play<'_>, ctx: &Context) -> Result<Stage> {
        let picture = Picture::of(play, ctx.threads);
        let file = Arc::new(open_for(play.file, &picture, ctx)?);
        let shares = Shares::for_picture(&file, &picture, ctx.budget.limit_bytes())?;
        let voxels = if picture.asks_voxels() { Voxels::of(&file, &ctx.budget)? } else { None };
        let pool_options = PoolOptions { io: play.io.clone(), ..shares.pool_options() };
        let pool = PagePool::open(file.clone(), play.file, &ctx.budget, &pool_options)?;
        tracing::info!("{:?}; {shares}", pool.io());

        let lease = ctx.budget.lease("materials and emitters", model_bytes(&file))?;
        let mut model = model_of(&file);
        model.voxels = voxels.map(Arc::new);
        let view = play.scene.view(&mut model)?;
        Ok(Stage { file, pool, shares, model, view, layers: play.layers, _lease: lease })
    }

    /// A session on this stage.
    pub fn session(&self, ctx: &Context) -> Result<Session<PagedMesh<'_, PooledPages<'_>>>> {
        let tracers = tracers(&self.file, &self.pool, ctx.threads);
        Session::new(self.model.clone(), self.view.clone(), self.layers, &ctx.budget, tracers)
    }
}

/// A `.toml` is a scene that names a page file; anything else is a page file with the default scene.
pub fn open_scene(file: &Path) -> Result<(Scene, PathBuf)> {
    if !file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("toml")) {
        return Ok((Scene::default(), file.to_path_buf()));
    }
    let text = std::fs::read_to_string(file).map_err(|error| Error::io("read the scene", file, &error))?;
    let scene = Scene::parse(&text, file)?;
    let model = file.parent().unwrap_or(Path::new("")).join(&scene.model);
    Ok((scene, model))
}

/// The libraries' form of `--io` and `--direct`.
pub fn io_options(disk: &DiskArgs) -> IoOptions {
    IoOptions { io: disk.io.choice(), direct: disk.direct.choice(), ..IoOptions::default() }
}

/// Opens a file to be rendered. A limit that is too small for its tables is told as too small for the picture: the
/// limit that is named must do for all of it.
fn open_for(path: &Path, picture: &Picture, ctx: &Context) -> Result<PageFile> {
    PageFile::open(path, &ctx.budget).map_err(|error| match error.code() {
        Code::MemoryLimit => PageFile::open(path, &Budget::unlimited())
            .and_then(|file| Shares::for_picture(&file, picture, ctx.budget.limit_bytes()))
            .err()
            .unwrap_or(error),
        _ => error,
    })
}

/// What the renderer is told of a file.
fn model_of(file: &PageFile) -> Model {
    let block = file.superblock();
    let emitter = |e: &trex_store::Emitter| Emitter {
        corners: e.corners.map(|q| block.lattice.position(q)),
        material: e.material,
    };
    Model {
        bounds: block.bounds,
        materials: file.materials().to_vec(),
        emitters: file.emitters().iter().map(emitter).collect(),
        voxels: None,
    }
}

/// The viewpoints of a file, otherwise like `camera`.
pub fn read_views(path: &Path, camera: &Camera) -> Result<Vec<Camera>> {
    let text = std::fs::read_to_string(path).map_err(|error| Error::io("read the views", path, &error))?;
    stress::views(&text, camera).map_err(|error| {
        Error::new(Code::SceneFormat, "this is no list of views")
            .at(path)
            .numbers(error.to_string())
            .next("write a [[view]] with position = [x, y, z] and target = [x, y, z] for each")
    })
}
