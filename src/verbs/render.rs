//! `trex render`: a page file or a scene to a picture.

use super::picture_file::PictureFile;
use super::shares::{Picture, Shares, model_bytes};
use crate::args::{CameraArgs, DiskArgs, GRayArgs, Integrator, Layer, NearArg, OccludersArg, RenderArgs};
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use serde::Serialize;
use std::fmt;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{Duration, Instant};
use trex_render::emitter::Emitter;
use trex_render::film::Layers;
use trex_render::integrator::{Method, RayCounts};
use trex_render::scene::Scene;
use trex_render::session::Session;
use trex_render::trace::tracers;
use trex_render::voxel::{Near, Occluders, PhotonStats, Voxels};
use trex_render::world::Model;
use trex_store::io::{IoDescription, IoOptions};
use trex_store::pool::{PagePool, PoolStats};
use trex_store::{Budget, Code, Error, PageFile, Progress, Result};

/// Runs `trex render`.
pub fn run(args: &RenderArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let (mut scene, path) = open_scene(&args.file)?;
    override_scene(&mut scene, args);
    let layers = Layers {
        depth: args.layers.contains(&Layer::Depth),
        normal: args.layers.contains(&Layer::Normal),
        albedo: args.layers.contains(&Layer::Albedo),
        id: args.layers.contains(&Layer::Id),
    };
    let job = Job {
        scene: &scene,
        file: &path,
        output: &args.output,
        overwrite: args.overwrite.overwrite,
        layers,
        io: io_options(&args.disk),
        time_limit: args.time_limit.as_ref().map(|limit| Duration::from_secs_f64(limit.0)),
    };
    ctx.done(&job.render(ctx)?)
}

/// A `.toml` is a scene that names a page file; anything else is a page file with the default scene.
fn open_scene(file: &Path) -> Result<(Scene, PathBuf)> {
    if !file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("toml")) {
        return Ok((Scene::default(), file.to_path_buf()));
    }
    let text = std::fs::read_to_string(file).map_err(|error| Error::io("read the scene", file, &error))?;
    let scene = Scene::parse(&text, file)?;
    let model = file.parent().unwrap_or(Path::new("")).join(&scene.model);
    Ok((scene, model))
}

/// What the command line says goes before what the scene says.
fn override_scene(scene: &mut Scene, args: &RenderArgs) {
    let CameraArgs { camera_position, camera_target, camera_up, fov_x, fov_y } = &args.camera;
    let camera = &mut scene.camera;
    camera.position = camera_position.as_ref().map(|v| v.0).or(camera.position);
    camera.target = camera_target.as_ref().map(|v| v.0).or(camera.target);
    camera.up = camera_up.as_ref().map(|v| v.0).or(camera.up);
    if fov_x.is_some() || fov_y.is_some() {
        (camera.fov_x, camera.fov_y) = (*fov_x, *fov_y);
    }
    let render = &mut scene.render;
    render.integrator = args.integrator.map_or(render.integrator, |integrator| match integrator {
        Integrator::Direct => Method::Direct,
        Integrator::Path => Method::Path,
        Integrator::Ao => Method::Ao,
        Integrator::Photon => Method::Photon,
        Integrator::DebugUpper => Method::DebugUpper,
        Integrator::DebugOccluders => Method::DebugOccluders,
        Integrator::DebugPages => Method::DebugPages,
    });
    render.resolution = args.resolution.as_ref().map_or(render.resolution, |r| [r.width, r.height]);
    render.spp = args.spp.unwrap_or(render.spp);
    render.n_shadow = args.n_shadow.unwrap_or(render.n_shadow);
    let GRayArgs { n_gather, photons, near, occluders } = &args.g_rays;
    render.n_gather = n_gather.unwrap_or(render.n_gather);
    render.photons = photons.unwrap_or(render.photons);
    render.near = near.map_or(render.near, |near| match near {
        NearArg::Voxel => Near::Voxel,
        NearArg::Exact => Near::Exact,
    });
    render.occluders = occluders.map_or(render.occluders, |occluders| match occluders {
        OccludersArg::On => Occluders::On,
        OccludersArg::Off => Occluders::Off,
    });
    render.seed = args.seed.unwrap_or(render.seed);
    render.exposure = args.exposure.map_or(render.exposure, |exposure| exposure as f32);
}

/// The libraries' form of `--io` and `--direct`.
pub fn io_options(disk: &DiskArgs) -> IoOptions {
    IoOptions { io: disk.io.choice(), direct: disk.direct.choice(), ..IoOptions::default() }
}

/// One picture, as `render` and `demo` ask for it.
pub struct Job<'a> {
    pub scene: &'a Scene,
    pub file: &'a Path,
    pub output: &'a Path,
    pub overwrite: bool,
    pub layers: Layers,
    pub io: IoOptions,
    pub time_limit: Option<Duration>,
}

impl Job<'_> {
    /// Renders and writes the picture.
    pub fn render(&self, ctx: &Context) -> Result<Rendered> {
        let start = Instant::now();
        let target = PictureFile::check(self.output, self.overwrite, self.layers)?;
        let keys = &self.scene.render;
        let (layers, method) = (self.layers, keys.integrator);
        let picture = Picture { resolution: keys.resolution, layers, workers: ctx.threads, method };
        let file = Arc::new(open_for(self.file, &picture, ctx)?);
        let shares = Shares::for_picture(&file, &picture, ctx.budget.limit_bytes())?;
        let voxels = if method.asks_voxels() { Voxels::of(&file, &ctx.budget)? } else { None };
        let pool_options = trex_store::pool::PoolOptions { io: self.io.clone(), ..shares.pool_options() };
        let pool = PagePool::open(file.clone(), self.file, &ctx.budget, &pool_options)?;
        tracing::info!("{:?}; {shares}", pool.io());

        let _model_lease = ctx.budget.lease("materials and emitters", model_bytes(&file))?;
        let mut model = model_of(&file);
        model.voxels = voxels.map(Arc::new);
        let view = self.scene.view(&mut model)?;
        let tracers = tracers(&file, &pool, ctx.threads);
        let arithmetic = tracers[0].arithmetic().name();
        let mut session = Session::new(model, view, self.layers, &ctx.budget, tracers)?;

        let late = || self.time_limit.is_some_and(|limit| start.elapsed() >= limit);
        let stop = || ctx.interrupt.is_raised() || late();
        let show = ctx.report();
        let photon_start = Instant::now();
        let mut tell_photons = |done, total| {
            let memory_bytes = ctx.budget.used_bytes();
            show(Progress { phase: "photons", done, total, unit: "photons", memory_bytes });
        };
        let photons = session.illuminate(&stop, &mut tell_photons)?;
        let photon_seconds = photon_start.elapsed().as_secs_f64();
        let mut first_pass_ms = None;
        let mut after_pass = |_: &_, stats: &trex_render::session::RenderStats| {
            first_pass_ms.get_or_insert(start.elapsed().as_millis() as u64);
            let memory_bytes = ctx.budget.used_bytes();
            let pixels = u64::from(keys.resolution[0]) * u64::from(keys.resolution[1]);
            let (done, total) = (u64::from(stats.spp) * pixels, u64::from(keys.spp) * pixels);
            show(Progress { phase: "render", done, total, unit: "samples", memory_bytes });
            ControlFlow::Continue(())
        };
        let stats = session.render(keys.spp, &stop, &mut after_pass);
        ctx.interrupt.check()?;
        if stats.spp == 0 {
            ctx.console.note("note: the time limit came before every pixel had a sample; the rest is black");
        }
        let seconds = start.elapsed().as_secs_f64();
        let rays = RayCounts { photon: photons.rays, ..stats.total.rays };
        let per_s = |rays: u64| rays as f64 / (seconds - photon_seconds);
        target.write(session.film(), keys.exposure)?;
        let damage = pool.damage();
        for (page, error) in damage.iter().take(10) {
            ctx.console.note(&format!(
                "damaged page {page}, drawn as empty: {} {}",
                error.what(),
                error.place()
            ));
        }
        Ok(Rendered {
            scene: self.file.display().to_string(),
            output: self.output.display().to_string(),
            integrator: keys.integrator.as_str(),
            spp: stats.spp,
            rays,
            rays_per_s: RaysPerS {
                primary: per_s(rays.primary),
                mirror: per_s(rays.mirror),
                shadow: per_s(rays.shadow),
                gather: per_s(rays.gather),
                photon: rays.photon as f64 / photon_seconds.max(1e-9),
            },
            photons,
            photons_ms: (photon_seconds * 1e3) as u64,
            time_ms: (seconds * 1e3) as u64,
            first_picture_ms: first_pass_ms,
            complete_ms: stats.complete.then(|| start.elapsed().as_millis() as u64),
            exact: pool.stats().damaged == 0,
            damaged_pages: damage.iter().map(|(page, _)| *page).collect(),
            image: Image {
                mean: session.film().mean(),
                width: keys.resolution[0],
                height: keys.resolution[1],
            },
            waits: stats.total.waits,
            narrow_samples: stats.total.narrow_samples,
            pool: pool.stats(),
            shares,
            memory: Memory::of(&ctx.budget),
            io_backend: pool.io().clone(),
            device: "cpu",
            arithmetic,
        })
    }
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

/// The result of a render.
#[derive(Debug, Serialize)]
pub struct Rendered {
    pub scene: String,
    pub output: String,
    pub integrator: &'static str,
    pub spp: u32,
    pub rays: RayCounts,
    pub rays_per_s: RaysPerS,
    pub photons: PhotonStats,
    pub photons_ms: u64,
    pub time_ms: u64,
    pub first_picture_ms: Option<u64>,
    pub complete_ms: Option<u64>,
    pub exact: bool,
    pub damaged_pages: Vec<u32>,
    pub image: Image,
    pub waits: u64,
    pub narrow_samples: u64,
    pub pool: PoolStats,
    pub shares: Shares,
    pub memory: Memory,
    pub io_backend: IoDescription,
    pub device: &'static str,
    pub arithmetic: &'static str,
}

#[derive(Debug, Serialize)]
pub struct RaysPerS {
    pub primary: f64,
    pub mirror: f64,
    pub shadow: f64,
    pub gather: f64,
    pub photon: f64,
}

#[derive(Debug, Serialize)]
pub struct Image {
    pub mean: [f64; 3],
    pub width: u32,
    pub height: u32,
}

impl fmt::Display for Rendered {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (rays, pool) = (&self.rays, &self.pool);
        let total = rays.total();
        writeln!(
            f,
            "{}: {}x{}, {} samples a pixel, {}",
            self.output,
            self.image.width,
            self.image.height,
            self.spp,
            size::duration(Duration::from_millis(self.time_ms))
        )?;
        writeln!(
            f,
            "{} ({} primary, {} mirror, {} shadow, {} gather, {} photon), {}",
            size::count(total),
            size::count(rays.primary),
            size::count(rays.mirror),
            size::count(rays.shadow),
            size::count(rays.gather),
            size::count(rays.photon),
            size::rate(total as f64 * 1e3 / self.time_ms.max(1) as f64, "rays")
        )?;
        if !self.damaged_pages.is_empty() {
            writeln!(
                f,
                "not whole: {} damaged pages, drawn as empty; see `trex verify`",
                self.damaged_pages.len()
            )?;
        }
        write!(
            f,
            "pages: {} read ({}), {} evicted, {} read again; memory limit {}, peak {}",
            size::count(pool.pages_read),
            size::bytes(pool.bytes_read),
            size::count(pool.evictions),
            size::count(pool.refaults),
            size::bytes(self.memory.limit_bytes),
            self.memory.peak_rss_bytes.map_or_else(|| "unknown".into(), size::bytes)
        )
    }
}
