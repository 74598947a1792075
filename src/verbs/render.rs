//! `trex render`: a page file or a scene to a picture.

use super::picture_file::PictureFile;
use super::shares::Shares;
use super::stage::{Play, Stage, io_options, open_scene, read_views};
use crate::args::{Layer, RenderArgs, Switch};
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use serde::Serialize;
use std::ffi::OsStr;
use std::fmt;
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use trex_bench::stress::Times;
use trex_render::camera::Camera;
use trex_render::film::Layers;
use trex_render::filter::Filter;
use trex_render::frame::PagedTracer;
use trex_render::integrator::{RayCounts, RayRates};
use trex_render::live::{self, FrameOptions};
use trex_render::scene::Scene;
use trex_render::session::{Event, RenderStats, Session};
use trex_render::voxel::PhotonStats;
use trex_store::io::{IoDescription, IoOptions};
use trex_store::pool::PoolStats;
use trex_store::{Progress, Result};

/// Runs `trex render`.
pub fn run(args: &RenderArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let (mut scene, path) = open_scene(&args.file)?;
    override_scene(&mut scene, args);
    let layers = Layers {
        depth: args.layers.contains(&Layer::Depth),
        normal: args.layers.contains(&Layer::Normal),
        albedo: args.layers.contains(&Layer::Albedo),
        id: args.layers.contains(&Layer::Id),
        filter: scene.render.filter == Filter::On,
    };
    let job = Job {
        scene: &scene,
        file: &path,
        output: &args.output,
        camera_path: args.camera_path.as_deref(),
        overwrite: args.overwrite.overwrite,
        layers,
        io: io_options(&args.disk),
        time_limit: args.time_limit.as_ref().map(|limit| Duration::from_secs_f64(limit.0)),
        live: args.deadline.t_max.as_ref().map(|t_max| args.deadline.options(t_max)),
    };
    ctx.done(&job.render(ctx)?)
}

/// What the command line says goes before what the scene says.
fn override_scene(scene: &mut Scene, args: &RenderArgs) {
    args.picture.override_scene(scene);
    let render = &mut scene.render;
    render.spp = args.spp.unwrap_or(render.spp);
    render.filter = args.filter.map_or(render.filter, |filter| match filter {
        Switch::On => Filter::On,
        Switch::Off => Filter::Off,
    });
    render.exposure = args.exposure.map_or(render.exposure, |exposure| exposure as f32);
}

/// A picture, as `render` and `demo` ask for it, or one from each viewpoint of a path.
pub struct Job<'a> {
    pub scene: &'a Scene,
    pub file: &'a Path,
    pub output: &'a Path,
    pub camera_path: Option<&'a Path>,
    pub overwrite: bool,
    pub layers: Layers,
    pub io: IoOptions,
    pub time_limit: Option<Duration>,
    /// How frames with a deadline are made, if there is one.
    pub live: Option<FrameOptions>,
}

impl Job<'_> {
    /// What is to be made, checked: viewpoints are otherwise like `camera`.
    fn shots(&self, camera: &Camera) -> Result<Vec<Shot>> {
        let Some(path) = self.camera_path else {
            return Ok(vec![Shot { camera: None, output: self.output.to_path_buf() }]);
        };
        let shot = |(camera, number): (Camera, usize)| {
            let place = || format!("{}, view {number}", path.display());
            camera.project(self.scene.render.resolution).map_err(|error| error.at_place(place()))?;
            Ok(Shot { camera: Some(camera), output: numbered(self.output, number) })
        };
        read_views(path, camera)?.into_iter().zip(1..).map(shot).collect()
    }

    /// Renders and writes the pictures.
    pub fn render(&self, ctx: &Context) -> Result<Rendered> {
        let start = Instant::now();
        let Job { scene, file, layers, io, live, .. } = self;
        let check = |path: &Path| PictureFile::check(path, self.overwrite, *layers);
        if self.camera_path.is_none() {
            check(self.output)?;
        }
        let keys = &scene.render;
        let stage = Stage::open(&Play { scene, file, layers: *layers, io, live: *live }, ctx)?;
        let pool = &stage.pool;
        let mut session = stage.session(ctx)?;
        let shots = self.shots(&session.view().camera)?;
        let targets = shots.iter().map(|shot| check(&shot.output)).collect::<Result<Vec<_>>>()?;

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
        let mut first_picture_ms = None;
        let mut tell = |before: usize, spp: u32| {
            first_picture_ms.get_or_insert(start.elapsed().as_millis() as u64);
            let memory_bytes = ctx.budget.used_bytes();
            let pixels = u64::from(keys.resolution[0]) * u64::from(keys.resolution[1]);
            let whole = u64::from(keys.spp) * pixels;
            let (done, total) = (before as u64 * whole + u64::from(spp) * pixels, shots.len() as u64 * whole);
            show(Progress { phase: "render", done, total, unit: "samples", memory_bytes });
        };
        let mut frames = None;
        let mut pictures = vec![];
        // Of filter and file, which are no part of the figures.
        let mut finishing = Duration::ZERO;
        let mut stats = RenderStats { complete: true, spp: u32::MAX, ..RenderStats::default() };
        for (place, (shot, target)) in shots.iter().zip(&targets).enumerate() {
            if let Some(camera) = shot.camera {
                session.apply(Event::Camera(camera))?;
            }
            let begin = Instant::now();
            let one = match self.live {
                None => session.render(keys.spp, &stop, &mut |_, stats| {
                    tell(place, stats.spp);
                    ControlFlow::Continue(())
                }),
                Some(options) => {
                    let log = frames.insert(Frames::default());
                    log.render(&mut session, (options, keys.spp), &stop, &mut |spp| tell(place, spp))?
                }
            };
            ctx.interrupt.check()?;
            let rendered = Instant::now();
            session.smooth()?;
            target.write(&session, keys.exposure)?;
            finishing += rendered.elapsed();
            stats.total.add(&one.total);
            (stats.spp, stats.complete) = (stats.spp.min(one.spp), stats.complete && one.complete);
            let (output, time) = (shot.output.display().to_string(), rendered - begin);
            pictures.push(Picture { output, spp: one.spp, time_ms: time.as_millis() as u64 });
            if late() {
                break;
            }
        }
        if pictures.len() < shots.len() {
            stats.complete = false;
            ctx.console.note(&format!(
                "note: the time limit came in picture {} of {}; the others are not made",
                pictures.len(),
                shots.len()
            ));
        }
        if stats.spp == 0 {
            let rest = if frames.is_some() { "a stand-in" } else { "black" };
            ctx.console.note(&format!(
                "note: the time limit came before every pixel had a sample; the rest is {rest}"
            ));
        }
        let seconds = (start.elapsed() - finishing).as_secs_f64();
        let rays = RayCounts { photon: photons.rays, ..stats.total.rays };
        let render_seconds = seconds - photon_seconds;
        let io_backend = pool.io();
        if let Some(notice) = &io_backend.notice {
            ctx.console.note(&format!("note: {notice}"));
        }
        let damage = pool.damage();
        for (page, error) in damage.iter().take(10) {
            let drawn = if stage.file.has_units(*page) { "by coarser voxels" } else { "as empty" };
            ctx.console.note(&format!(
                "damaged page {page}, drawn {drawn}: {} {}",
                error.what(),
                error.place()
            ));
        }
        Ok(Rendered {
            scene: self.file.display().to_string(),
            output: pictures[0].output.clone(),
            pictures,
            integrator: keys.integrator.as_str(),
            spp: stats.spp,
            rays,
            rays_per_s: RayRates { photon: rays.per_s(photon_seconds).photon, ..rays.per_s(render_seconds) },
            photons,
            photons_ms: (photon_seconds * 1e3) as u64,
            look_ups: stats.total.look_ups,
            look_ups_per_s: stats.total.look_ups as f64 / render_seconds,
            time_ms: (seconds * 1e3) as u64,
            first_picture_ms,
            frames,
            complete_ms: stats.complete.then(|| start.elapsed().as_millis() as u64),
            exact: pool.stats().damaged == 0 && stats.spp > 0 && keys.lod_error == 0.0,
            lod_error_px: keys.lod_error,
            damaged_pages: damage.iter().map(|(page, _)| *page).collect(),
            image: Image {
                mean: session.film().mean(),
                width: keys.resolution[0],
                height: keys.resolution[1],
            },
            waits: stats.total.waits,
            narrow_samples: stats.total.narrow_samples,
            pool: pool.stats(),
            shares: stage.shares,
            memory: Memory::of(&ctx.budget),
            io_backend,
            device: "cpu",
            arithmetic: session.tracers()[0].arithmetic().name(),
        })
    }
}

/// Name of a picture of a path: `turn.png` gives `turn-0001.png` and so on.
fn numbered(output: &Path, number: usize) -> PathBuf {
    let part = |part: Option<&OsStr>| part.unwrap_or_default().to_owned();
    let mut name = part(output.file_stem());
    name.push(format!("-{number:04}."));
    name.push(part(output.extension()));
    output.with_file_name(name)
}

/// Frames with a deadline: their times.
#[derive(Debug, Default, Serialize)]
pub struct Frames {
    /// From the start to the first whole fetch block.
    pub response_ms: Times,
    pub frame_ms: Times,
    pub block_tiles: u32,
}

impl Frames {
    /// Frames until every pixel has `spp` samples, or `stop`.
    fn render<T: PagedTracer + Send>(
        &mut self,
        session: &mut Session<T>,
        (options, spp): (FrameOptions, u32),
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u32),
    ) -> Result<RenderStats> {
        let start = Instant::now();
        session.go_live(options)?;
        let mut stats = RenderStats::default();
        while !stats.complete && !stop() {
            let begin = Instant::now();
            let report = session.frame(spp, stop);
            self.frame_ms.add(begin.elapsed());
            if report.progress >= live::Progress::Block && self.response_ms.count() == 0 {
                self.response_ms.add(start.elapsed());
                self.block_tiles = report.block_tiles;
            }
            stats.total.add(&report.pass);
            stats.spp = session.film().samples();
            stats.complete = report.progress == live::Progress::Done;
            tell(stats.spp);
        }
        Ok(stats)
    }
}

/// The result of a render.
#[derive(Debug, Serialize)]
pub struct Rendered {
    pub scene: String,
    pub output: String,
    /// Each picture, of a camera path one for each viewpoint.
    pub pictures: Vec<Picture>,
    pub integrator: &'static str,
    pub spp: u32,
    pub rays: RayCounts,
    pub rays_per_s: RayRates,
    pub photons: PhotonStats,
    pub photons_ms: u64,
    /// Look-ups of the photons nearest to a place; of `full-gi`.
    pub look_ups: u64,
    pub look_ups_per_s: f64,
    pub time_ms: u64,
    pub first_picture_ms: Option<u64>,
    /// Of frames with a deadline.
    #[serde(flatten)]
    pub frames: Option<Frames>,
    pub complete_ms: Option<u64>,
    pub exact: bool,
    pub lod_error_px: f64,
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

/// A picture that was written.
#[derive(Debug, Serialize)]
pub struct Picture {
    pub output: String,
    pub spp: u32,
    pub time_ms: u64,
}

/// A picture to be made.
struct Shot {
    /// `None`: as the session stands.
    camera: Option<Camera>,
    output: PathBuf,
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
        let output = match self.pictures.as_slice() {
            [first, .., last] => format!("{} to {}", first.output, last.output),
            _ => self.output.clone(),
        };
        writeln!(
            f,
            "{output}: {}x{}, {} samples a pixel, {}",
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
        if self.look_ups > 0 {
            writeln!(
                f,
                "{} photons stored, {} look-ups of the nearest, {}",
                size::count(self.photons.deposits),
                size::count(self.look_ups),
                size::rate(self.look_ups_per_s, "look-ups")
            )?;
        }
        if !self.damaged_pages.is_empty() {
            writeln!(
                f,
                "not whole: {} damaged pages, left out; see `trex verify`",
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
