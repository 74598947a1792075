//! `Stage`: a page file on show: opened, its memory shared out, its pool started. What `render`, `demo` and `stress`
//! begin with.

use crate::args::DiskArgs;
use crate::context::Context;
use crate::size;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use trex_render::{
    Camera, CpuStage, Emitter, Filter, FrameOptions, Layers, MemoryPlan, Method, Model, PagedMesh,
    PictureNeeds, PooledPages, RenderEdit, RenderKeys, RenderSettings, Scene, Session, SessionSetup, View,
    Voxels, model_bytes, parse_views, pooled_tracers,
};
use trex_store::io::IoOptions;
use trex_store::layout::{PageKind, SectionKind};
use trex_store::pool::{PagePool, PageState, PoolOptions};
use trex_store::{Budget, Code, Error, Lease, PageFile, Result, open_regular};

/// Counts of pages that are in frames.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct ResidentPages {
    /// Clusters and their trees.
    pub mesh: u32,
    /// Units of the finer octrees.
    pub units: u32,
}

/// A file, its pool, and what the scene says of them.
pub struct Stage {
    pub file: Arc<PageFile>,
    pub pool: PagePool,
    pub shares: MemoryPlan,
    model: Model,
    view: View,
    layers: Layers,
    _lease: Lease,
}

/// What answers the rays of a stage.
pub type StageTracer<'a> = PagedMesh<'a, PooledPages<'a>>;

/// What is to be shown, and how.
#[derive(Clone, Copy)]
pub struct Play<'a> {
    pub scene: &'a Scene,
    pub file: &'a Path,
    pub layers: Layers,
    pub io: &'a IoOptions,
    /// How frames with a deadline are made, if there is one.
    pub live: Option<FrameOptions>,
    /// Bytes that are leased beside the session, for copies of pictures.
    pub copies_bytes: u64,
}

impl Stage {
    /// Opens the file under the limit of `ctx`.
    pub fn open(play: &Play<'_>, ctx: &Context) -> Result<Stage> {
        let settings = RenderSettings::new(play.scene.render)?;
        let (layers, is_live) = (play.layers, play.live.is_some());
        let copies_bytes = play.copies_bytes;
        let picture = PictureNeeds { settings, layers, workers: ctx.threads, is_live, copies_bytes };
        let file = Arc::new(open_for(play.file, &picture, ctx)?);
        let shares = MemoryPlan::new(&file, &picture, ctx.budget.limit_bytes())?;
        let voxels = if picture.asks_voxels() { Voxels::open(&file, &ctx.budget)? } else { None };
        let pool_options = PoolOptions { io: play.io.clone(), ..shares.pool_options() };
        let pool = PagePool::open(file.clone(), play.file, &ctx.budget, &pool_options)?;
        tracing::info!("{:?}; {}", pool.io(), size::memory_plan(&shares));

        let lease = ctx.budget.lease("materials and emitters", model_bytes(&file))?;
        let mut model = model_of(&file);
        model.voxels = voxels.map(Arc::new);
        let view = play.scene.view(&mut model)?;
        Ok(Stage { file, pool, shares, model, view, layers, _lease: lease })
    }

    /// The pages that are in frames now, by what they hold.
    pub fn resident_pages(&self) -> ResidentPages {
        let mut resident = ResidentPages::default();
        for (page, entry) in (0..).zip(self.file.pages()) {
            if self.pool.state(page) == PageState::Resident {
                *match entry.kind {
                    PageKind::Mesh => &mut resident.mesh,
                    PageKind::Units => &mut resident.units,
                } += 1;
            }
        }
        resident
    }

    /// A session on this stage.
    pub fn session(&self, ctx: &Context) -> Result<Session<StageTracer<'_>>> {
        let tracers = pooled_tracers(&self.file, &self.pool, ctx.threads);
        let (model, view, layers) = (self.model.clone(), self.view.clone(), self.layers);
        let g_stage = Box::new(CpuStage::default());
        let setup = SessionSetup { model, view, layers, tracers, pool: ctx.thread_pool()?, g_stage };
        Session::new(setup, &ctx.budget)
    }
}

/// A `.toml` is a scene that names a page file; anything else is a page file with the default scene.
pub fn open_scene(file: &Path) -> Result<(Scene, PathBuf)> {
    if !file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("toml")) {
        return Ok((Scene::default(), file.to_path_buf()));
    }
    let text = read_text("read the scene", file)?;
    let scene = Scene::parse(&text, file)?;
    let model = file.parent().unwrap_or(Path::new("")).join(&scene.model);
    Ok((scene, model))
}

/// What is looked at while it changes begins without the filter and, without a scene, with the footprint rule: frames
/// come sooner.
pub fn begin_live(scene: &mut Scene) {
    if scene.model.is_empty() {
        scene.render.lod_error = 1.0;
    }
    if scene.given.filter.is_none() && scene.given.quality.is_none() {
        scene.render.filter = Filter::Off;
    }
    // Photons go on coming while the picture is looked at.
    if scene.given.photons.is_none() && scene.given.quality.is_none() {
        scene.render.photons = RenderKeys::default().photons;
    }
}

/// Smoothed light needs layers.
pub fn layers_of(keys: &RenderKeys) -> Layers {
    Layers { filter: keys.filter == Filter::On, ..Layers::default() }
}

/// What nobody has asked for gives way to what the file has: without voxels there is direct light.
///
/// # Errors
/// Those of [`PageFile::superblock_of`].
pub fn suit_file(scene: &mut Scene, file: &Path, ctx: &Context) -> Result<()> {
    if scene.given.says_integrator() || !scene.render.integrator.needs_voxels() {
        return Ok(());
    }
    if PageFile::superblock_of(file)?.find_section(SectionKind::Upper).is_none() {
        let direct = RenderEdit { integrator: Some(Method::Direct), ..RenderEdit::default() };
        scene.render = direct.apply(&scene.render);
        ctx.console
            .note("note: the file has no voxels, so that light is direct; --integrator path has all of it");
    }
    Ok(())
}

/// The libraries' form of `--io` and `--direct`.
pub fn io_options(disk: &DiskArgs) -> IoOptions {
    IoOptions { io: disk.io.choice(), direct: disk.direct.choice(), ..IoOptions::default() }
}

/// Opens a file to be rendered. A limit that is too small for its tables is told as too small for the picture: the
/// limit that is named must do for all of it.
fn open_for(path: &Path, picture: &PictureNeeds, ctx: &Context) -> Result<PageFile> {
    PageFile::open(path, &ctx.budget).map_err(|error| match error.code() {
        Code::MemoryLimit => PageFile::open(path, &Budget::unlimited())
            .and_then(|file| MemoryPlan::new(&file, picture, ctx.budget.limit_bytes()))
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

/// The text of a file.
fn read_text(doing: &str, path: &Path) -> Result<String> {
    let file = open_regular(path)?;
    std::io::read_to_string(file).map_err(|error| Error::io(doing, path, &error))
}

/// The viewpoints of a file, otherwise like `camera`.
pub fn read_views(path: &Path, camera: &Camera) -> Result<Vec<Camera>> {
    let text = read_text("read the views", path)?;
    parse_views(&text, camera).map_err(|error| error.at(path))
}
