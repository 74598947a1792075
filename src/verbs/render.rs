//! `trex render`: a page file or a scene to a picture.
//!
//! ```text
//! check the output -> open the stage -> photons -> a picture from each viewpoint -> what is to be told
//! ```

use super::clock::Clock;
use super::damage::Damage;
use super::picture_file::PictureFile;
use super::render_part::{self, PartReport};
use super::render_report::{Image, Picture, RenderReport};
use super::show::Show;
use super::stage::{Play, Stage, io_options, read_views, suit_file};
use crate::args::{Layer, RenderArgs};
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use trex_model::RayRates;
use trex_model::{DeviceOptions, Pace, SessionOptions, open_scene};
use trex_render::{
    Camera, Event, Fov, FrameOptions, Layers, MeshTracer, PagedTracer, PhotonStats, Portion, RayCounts,
    RenderKeys, RenderStats, Scene, Session,
};
use trex_store::io::IoOptions;
use trex_store::{Code, Error, Progress, Result};

/// Runs `trex render`.
pub fn run(args: &RenderArgs, ctx: &Context) -> anyhow::Result<Exit> {
    if let Some(flag) = args.deadline.given().filter(|_| args.deadline.t_max.is_none()) {
        return Err(Error::new(Code::Usage, "this flag is of frames with a deadline, and there is none")
            .at_place(flag)
            .numbers("--t-max was not given; it takes 0.1 ms to 3600000 ms")
            .next("give --t-max too, or leave the flag away")
            .into());
    }
    let (mut scene, path) = open_scene(&args.file)?;
    args.picture.override_scene(&args.research, &mut scene);
    suit_file(&mut scene, &path, ctx)?;
    let layers = Layers {
        depth: args.layers.contains(&Layer::Depth),
        normal: args.layers.contains(&Layer::Normal),
        albedo: args.layers.contains(&Layer::Albedo),
        id: args.layers.contains(&Layer::Id),
        ..Layers::default()
    };
    let job = Job {
        scene: &scene,
        scene_file: Some(&args.file),
        file: &path,
        output: &args.output,
        camera_path: args.camera_path.as_deref(),
        overwrite: args.overwrite.overwrite,
        layers,
        portion: render_part::portion(args, &scene.render)?,
        io: io_options(&args.disk),
        device: args.device.options(),
        // Beyond what a duration holds there is no limit.
        time_limit: args.time_limit.as_ref().and_then(|limit| Duration::try_from_secs_f64(limit.0).ok()),
        live: args.deadline.t_max.as_ref().map(|t_max| args.deadline.options(t_max)),
    };
    let rendered = job.render(ctx)?;
    let is_whole = rendered.damaged_pages.is_empty();
    ctx.done(&rendered)?;
    Ok(if is_whole || args.allow_damage { Exit::Done } else { Exit::No })
}

/// A picture, as `render` and `demo` ask for it, or one from each viewpoint of a path.
pub struct Job<'a> {
    pub scene: &'a Scene,
    /// Where the scene was read, if it was.
    pub scene_file: Option<&'a Path>,
    pub file: &'a Path,
    pub output: &'a Path,
    pub camera_path: Option<&'a Path>,
    pub overwrite: bool,
    pub layers: Layers,
    /// The part of the picture that is made; `None` for all of it.
    pub portion: Option<Portion>,
    pub io: IoOptions,
    pub device: DeviceOptions,
    pub time_limit: Option<Duration>,
    /// How frames with a deadline are made, if there is one.
    pub live: Option<FrameOptions>,
}

/// Photons, and how long what took.
struct Times {
    photons: PhotonStats,
    photons_s: f64,
    /// All but filter and file.
    total_s: f64,
    passed_ms: u64,
}

/// A picture to be made.
struct Shot {
    /// `None`: as the session stands.
    camera: Option<Camera>,
    target: PictureFile,
    output: PathBuf,
}

/// How much is done, for the progress.
struct SampleProgress {
    /// Pictures before this one, and of how many.
    place: usize,
    shots: usize,
    /// Samples that every pixel of this one has.
    spp: u32,
}

/// What the pictures came to.
struct PictureRun {
    pictures: Vec<Picture>,
    stats: RenderStats,
    first_picture_ms: Option<u64>,
    /// Time of filter and file, which are no part of the figures.
    finishing: Duration,
}

impl Job<'_> {
    /// Renders and writes the pictures.
    pub fn render(&self, ctx: &Context) -> Result<RenderReport> {
        let clock = Clock::start(self.time_limit, ctx);
        if self.camera_path.is_none() {
            self.check(self.output)?;
        }
        let pace = if self.live.is_some() { Pace::InFrames } else { Pace::AtLeisure };
        let (layers, portion) = (self.layers, self.portion);
        let options = SessionOptions { layers, portion, pace, ..SessionOptions::default() };
        let scene = self.opening_scene()?;
        let play = Play {
            scene: &scene,
            file: self.file,
            options,
            io: &self.io,
            device: &self.device,
            stop: &clock.stop,
        };
        let (stage, mut session) = Stage::open(&play, ctx)?;
        session.stop_by(&clock.stop);
        let shots = self.shots(&session.view().camera)?;

        let photons_start = Instant::now();
        let photons = send_photons(&mut session, &clock)?;
        let photons_s = photons_start.elapsed().as_secs_f64();

        let mut show = Show::new(session, self.live)?;
        let shown = self.make_pictures((&mut show, &stage), &shots, &clock)?;
        self.tell_what_is_missing(&shown, shots.len(), ctx);
        let damage = Damage::of(&stage);
        damage.report(ctx);
        let passed = clock.start.elapsed();
        let (total_s, passed_ms) = ((passed - shown.finishing).as_secs_f64(), passed.as_millis() as u64);
        let times = Times { photons, photons_s, total_s, passed_ms };
        Ok(RenderReport { damage, ..self.rendered(show, shown, &stage, &times, ctx) })
    }

    /// The scene with the first view of a path: exposure and lamps are decided by it, for all of them.
    fn opening_scene(&self) -> Result<Scene> {
        let mut scene = self.scene.clone();
        let Some(path) = self.camera_path else { return Ok(scene) };
        let any =
            Camera { position: [0.0; 3], target: [0.0, 0.0, -1.0], up: [0.0, 1.0, 0.0], fov: Fov::X(40.0) };
        let first = read_views(path, &any)?.into_iter().next();
        // One that sees nothing is refused with its number; one along what is up in the scene's camera says its own up.
        let sees = |first: &Camera| {
            let ups = scene.camera.up.map_or(vec![[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], |up| vec![up]);
            ups.into_iter().all(|up| Camera { up, ..*first }.project([1, 1]).is_ok())
        };
        if let Some(first) = first.filter(sees) {
            let keys = &mut scene.camera;
            (keys.position, keys.target) = (Some(first.position), Some(first.target));
            keys.direction = None;
        }
        Ok(scene)
    }

    fn check(&self, path: &Path) -> Result<PictureFile> {
        let inputs: Vec<&Path> =
            [self.scene_file, Some(self.file), self.camera_path].into_iter().flatten().collect();
        match self.portion {
            None => PictureFile::check(path, self.overwrite, self.layers, &inputs),
            Some(_) => PictureFile::check_part(path, self.overwrite, &inputs),
        }
    }

    /// What is to be made, checked: viewpoints are otherwise like `camera`.
    fn shots(&self, camera: &Camera) -> Result<Vec<Shot>> {
        let Some(path) = self.camera_path else {
            return Ok(vec![Shot {
                camera: None,
                target: self.check(self.output)?,
                output: self.output.to_path_buf(),
            }]);
        };
        let shot = |(camera, number): (Camera, usize)| {
            let place = || format!("{}, view {number}", path.display());
            camera.project(self.scene.render.resolution).map_err(|error| error.at_place(place()))?;
            let output = numbered(self.output, number);
            Ok(Shot { camera: Some(camera), target: self.check(&output)?, output })
        };
        read_views(path, camera)?.into_iter().zip(1..).map(shot).collect()
    }

    /// A picture from each viewpoint.
    fn make_pictures(
        &self,
        (show, stage): (&mut Show<MeshTracer>, &Stage),
        shots: &[Shot],
        clock: &Clock<'_>,
    ) -> Result<PictureRun> {
        let keys = &self.scene.render;
        let stats = RenderStats { complete: true, spp: u32::MAX, ..RenderStats::default() };
        let mut shown =
            PictureRun { pictures: vec![], stats, first_picture_ms: None, finishing: Duration::ZERO };
        for (place, shot) in shots.iter().enumerate() {
            if let Some(camera) = shot.camera {
                show.apply(Event::Camera(camera))?;
            }
            let begin = Instant::now();
            let spp = self.portion.map_or(keys.spp, |portion| portion.samples[1]);
            let one = show.render(spp, &|| clock.stops(), &mut |spp| {
                let passed = clock.start.elapsed().as_millis() as u64;
                shown.first_picture_ms.get_or_insert(passed);
                tell_samples(keys, clock.ctx, SampleProgress { place, shots: shots.len(), spp });
            });
            clock.ctx.interrupt.check()?;
            let rendered = Instant::now();
            show.smooth(&|| clock.ctx.interrupt.is_raised())?;
            clock.ctx.interrupt.check()?;
            match self.portion {
                Some(portion) => render_part::write(&shot.target, &stage.model, show.session(), portion)?,
                None => {
                    let exposure = show.session().view().settings.exposure.factor();
                    shot.target.write(show, exposure, show.session().thread_pool())?;
                }
            }
            shown.finishing += rendered.elapsed();
            let stats = &mut shown.stats;
            stats.total.add(&one.total);
            (stats.spp, stats.complete) = (stats.spp.min(one.spp), stats.complete && one.complete);
            let (output, time) = (shot.output.display().to_string(), rendered - begin);
            shown.pictures.push(Picture { output, spp: one.spp, time_ms: time.as_millis() as u64 });
            if clock.is_late() {
                break;
            }
        }
        shown.stats.complete &= shown.pictures.len() == shots.len();
        Ok(shown)
    }

    /// What the time limit has cut off.
    fn tell_what_is_missing(&self, shown: &PictureRun, shot_count: usize, ctx: &Context) {
        if shown.pictures.len() < shot_count {
            ctx.console.note(&format!(
                "note: the time limit came in picture {} of {shot_count}; the others are not made",
                shown.pictures.len()
            ));
        }
        if shown.stats.spp == 0 {
            let rest = if self.live.is_some() { "a preview" } else { "black" };
            ctx.console.note(&format!(
                "note: the time limit came before every pixel had a sample; the rest is {rest}"
            ));
        }
    }

    /// What is to be told.
    fn rendered(
        &self,
        show: Show<MeshTracer>,
        shown: PictureRun,
        stage: &Stage,
        times: &Times,
        ctx: &Context,
    ) -> RenderReport {
        let (keys, pool) = (*show.session().view().settings, &stage.pool);
        let PictureRun { pictures, stats, first_picture_ms, .. } = shown;
        let Times { photons, photons_s, total_s, passed_ms } = *times;
        let rays = RayCounts { photon: photons.rays, ..stats.total.rays };
        let render_s = total_s - photons_s;
        let [width, height] = keys.resolution;
        let part = self.portion.map(|portion| PartReport::of(portion, keys.resolution, keys.spp));
        let image = Image { mean: trex_render::Image::mean(&show), width, height };
        let device = stage.device(ctx);
        let (open_rays, open_materials) = tell_open_parts(show.session(), ctx);
        let arithmetic = show.session().tracers()[0].arithmetic().name();
        RenderReport {
            scene: self.file.display().to_string(),
            output: pictures[0].output.clone(),
            pictures,
            part,
            integrator: keys.integrator.as_str(),
            light: keys.light.as_str(),
            exposure: keys.exposure.factor(),
            spp: stats.spp - self.portion.map_or(0, |portion| portion.samples[0]),
            rays,
            rays_per_s: RayRates::new(&rays, render_s, photons_s),
            g_stage: stats.total.g_stage,
            photons,
            photons_ms: (photons_s * 1e3) as u64,
            look_ups: stats.total.look_ups,
            look_ups_per_s: stats.total.look_ups as f64 / render_s,
            time_ms: (total_s * 1e3) as u64,
            first_picture_ms,
            frames: show.frames(),
            complete_ms: stats.complete.then_some(passed_ms),
            exact: pool.stats().damaged == 0 && stats.spp > 0 && keys.lod_error == 0.0,
            lod_error_px: keys.lod_error,
            damaged_pages: pool.damage().iter().map(|(page, _)| *page).collect(),
            damage: Damage::default(),
            image,
            waits: stats.total.waits,
            narrow_samples: stats.total.narrow_samples,
            open_materials,
            open_rays,
            pool: pool.stats(),
            shares: stage.plan,
            memory: Memory::new(&ctx.budget),
            io_backend: stage.io(ctx),
            device: device.name,
            device_reason: device.reason,
            device_notice: device.notice,
            gpu: device.gpu,
            arithmetic,
        }
    }
}

/// How many rays met parts that are open where a section cuts them, and their materials; told.
fn tell_open_parts(session: &Session<MeshTracer>, ctx: &Context) -> (u64, Vec<String>) {
    let (open, model) = (session.open_parts(), session.model());
    let name = |&index: &u32| model.names.get(index as usize).unwrap_or_default().to_owned();
    let names: Vec<String> = open.materials.iter().map(name).collect();
    if open.rays > 0 {
        ctx.console.note(&format!(
            "note: {} rays came to a section where the model is open or turned inside out, and was not filled: {}",
            size::count(open.rays),
            if names.is_empty() { "too many materials to list".to_owned() } else { names.join(", ") }
        ));
    }
    (open.rays, names)
}

/// The light that photons bring. Samples are to be taken in the time that is left: photons get half of it, and where
/// that brings none three quarters.
fn send_photons<T: PagedTracer + Send>(session: &mut Session<T>, clock: &Clock<'_>) -> Result<PhotonStats> {
    let (show, budget) = (clock.ctx.report(), &clock.ctx.budget);
    let ends = [0.5, 0.75].map(|share| clock.after(share));
    let has_light = AtomicBool::new(false);
    let stops = || {
        let end = ends[usize::from(!has_light.load(Ordering::Relaxed))];
        clock.stops() || end.is_some_and(|end| Instant::now() >= end)
    };
    session.illuminate(&stops, &mut |done, total| {
        has_light.store(done > 0, Ordering::Relaxed);
        let memory_bytes = budget.used_bytes();
        show(Progress { phase: "photons", done, total, unit: "photons", memory_bytes });
    })
}

fn tell_samples(keys: &RenderKeys, ctx: &Context, done: SampleProgress) {
    let pixels = u64::from(keys.resolution[0]) * u64::from(keys.resolution[1]);
    let whole = u64::from(keys.spp) * pixels;
    let (now, total) = (done.place as u64 * whole + u64::from(done.spp) * pixels, done.shots as u64 * whole);
    let memory_bytes = ctx.budget.used_bytes();
    ctx.report()(Progress { phase: "render", done: now, total, unit: "samples", memory_bytes });
}

/// Name of a picture of a path: `turn.png` gives `turn-0001.png` and so on.
fn numbered(output: &Path, number: usize) -> PathBuf {
    let part = |part: Option<&OsStr>| part.unwrap_or_default().to_owned();
    let mut name = part(output.file_stem());
    name.push(format!("-{number:04}."));
    name.push(part(output.extension()));
    output.with_file_name(name)
}
