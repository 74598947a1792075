//! `trex view`: a page file or a scene, live in a browser page.
//!
//! ```text
//! listen -> build, if it has to be: pages that come are told how far -> scene, flags -> stage -> say where
//!        -> serve until Ctrl-C -> what was served
//!        -> with --watch until the model has changed -> listen, and all of it again, from where it was looked at
//! ```

use super::command_line::render_line;
use super::damage::Damage;
use super::door::Door;
use super::shown_file::ShownInput;
use super::stage::{Play, Stage, io_options, suit_file};
use super::watch::{LOOK_EVERY, Watch};
use crate::args::ViewArgs;
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use crate::values::Milliseconds;
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use trex_model::{DeviceReport, LiveSession, SessionOptions, ShownModel, open_scene};
use trex_render::{Exposure, FrameOptions, Scene};
use trex_store::io::IoDescription;
use trex_store::{Code, Error, Result, StopSignal};
use trex_view::{Recipe, SIDE_MAX, ServeOptions, ServeReport, WaitingRoom, WaitingText};

/// Longest frame when no other is asked for.
const T_MAX: Milliseconds = Milliseconds(100.0);
/// Size of the picture until the page says its own.
pub(super) const FIRST_RESOLUTION: [u32; 2] = [1280, 720];
/// Smallest side of a picture that is tried where memory is short, pixels.
const SIDE_LEAST: u32 = 80;

/// Runs `trex view`.
pub fn run(args: &ViewArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let input = ShownInput::of(args)?;
    let viewer = Viewer { args, ctx, input, begun: Instant::now() };
    let mut door = Door::open(args)?;
    let mut shows = Shows::default();
    loop {
        let watch = args.watch.then(|| Watch::begin(viewer.input.watched(ctx)?)).transpose()?;
        let has_changed = || watch.as_ref().is_some_and(Watch::has_changed);
        match viewer.show(&mut door, &mut shows, &has_changed) {
            Ok((report, is_whole)) if ctx.interrupt.is_raised() || !has_changed() => {
                ctx.done(&report)?;
                return Ok(if is_whole || args.allow_damage { Exit::Done } else { Exit::No });
            }
            Ok(_) => {
                viewer.input.outdate();
                ctx.console.note("the model has changed: it is opened again");
            }
            // What was on show has gone, and the next may be better.
            Err(error) if shows.count > 0 && error.code() != Code::Interrupted => {
                viewer.wait_for_change(&door, &error, &has_changed)?;
                viewer.input.outdate();
            }
            Err(error) => return Err(error.into()),
        }
    }
}

/// What was shown so far.
#[derive(Default)]
struct Shows {
    count: u32,
    /// What the last one ended with.
    served: ServeReport,
}

/// A model that is opened to be shown.
struct OpenModel {
    stage: Stage,
    session: LiveSession,
    /// What was asked for, and what that names.
    file: PathBuf,
    scene: Scene,
    path: PathBuf,
    options: ServeOptions,
    /// The session is on what was on show before, with lights or materials that are not those of the file.
    is_edited: bool,
}

/// The verb's surroundings.
struct Viewer<'a> {
    args: &'a ViewArgs,
    ctx: &'a Context,
    input: ShownInput,
    begun: Instant,
}

impl Viewer<'_> {
    /// Shows the model until it has changed or the user has seen enough. Gives what was served, and whether all of the
    /// model was seen.
    fn show(
        &self,
        door: &mut Door<'_>,
        shows: &mut Shows,
        has_changed: &(dyn Fn() -> bool + Sync),
    ) -> Result<(ViewReport, bool)> {
        let ctx = self.ctx;
        let opened = if shows.count > 0 || self.input.needs_build(ctx) {
            door.tell(ctx);
            self.while_pages_wait(door, || self.open(door, &shows.served))?
        } else {
            self.open(door, &shows.served)?
        };
        let OpenModel { stage, session, file, scene, path, options, is_edited } = opened;
        door.tell(ctx);
        let name = path.file_stem().unwrap_or_default().to_string_lossy();
        let model_path = std::fs::canonicalize(&path).unwrap_or_else(|_| path.clone());
        let input = file.display().to_string();
        let shown = ShownModel {
            name: &name,
            path: &model_path.display().to_string(),
            scene: &scene,
            words: &|recipe| render_line(&input, if is_edited { &Recipe::Saved } else { recipe }),
            peak_rss_bytes: &|| Memory::new(&ctx.budget).peak_rss_bytes,
            stop: &|| ctx.interrupt.is_raised() || has_changed(),
        };
        let served = stage.model.show(session, &door.listener, &options, &shown)?;
        shows.count += 1;
        shows.served = ServeReport {
            is_as_opened: served.is_as_opened && !is_edited,
            are_parts_edited: served.are_parts_edited || shows.served.are_parts_edited,
            ..served.clone()
        };
        if !ctx.interrupt.is_raised() {
            door.listen_again()?;
        }
        let damage = Damage::of(&stage);
        damage.report(ctx);
        let is_whole = damage.page_count == 0;
        let report = ViewReport {
            scene: path.display().to_string(),
            address: door.address.to_string(),
            time_ms: self.begun.elapsed().as_millis() as u64,
            shows: shows.count,
            served,
            damaged_pages: stage.pool.damage().iter().map(|(page, _)| *page).collect(),
            damage,
            io_backend: stage.io(ctx),
            device: stage.device(ctx),
            pool: stage.pool.stats(),
            memory: Memory::new(&ctx.budget),
        };
        Ok((report, is_whole))
    }

    /// Builds what has to be built, and begins a session on it: on what was on show before, if there was something.
    fn open(&self, door: &Door<'_>, before: &ServeReport) -> Result<OpenModel> {
        let Viewer { args, ctx, input, .. } = self;
        let file = input.ready(args, ctx)?;
        let (mut scene, path) = open_scene(&file)?;
        let follows_page = follows_page(args, &scene);
        scene.begin_live();
        if scene.given.exposure.is_none() {
            scene.render.exposure = Exposure::Auto;
        }
        if follows_page {
            scene.render.resolution = FIRST_RESOLUTION;
        }
        args.picture.override_scene(&args.research, &mut scene);
        check_resolution(&scene)?;
        suit_file(&mut scene, &path, ctx)?;
        let t_max = args.deadline.t_max.as_ref().unwrap_or(&T_MAX);
        // Pages are sent the samples themselves while the hand moves.
        let frames = FrameOptions { fills_while_moving: false, ..args.deadline.options(t_max) };
        let options = door.options(frames, follows_page);
        let again = seen_again(before, &scene, &path);
        let is_edited = again.is_some() && !before.is_as_opened;
        let session_scene = again.as_ref().unwrap_or(&scene);
        let opened = open_stage(args, follows_page, session_scene.clone(), &path, ctx);
        let (stage, session) = match opened {
            // A material has another name now.
            Err(error) if again.is_some() && error.code() == Code::SceneFormat => {
                ctx.console.note(&format!("note: seen as at first: {}", error.what()));
                return self.open(door, &ServeReport::default());
            }
            opened => opened?,
        };
        let session = session.go_live(stage.model.planned_frames(frames))?;
        Ok(OpenModel { stage, session, file, scene, path, options, is_edited })
    }

    /// Does `work` while pages that come are told how far it is; without them where the limit has no room for both.
    fn while_pages_wait<R>(&self, door: &Door<'_>, mut work: impl FnMut() -> Result<R>) -> Result<R> {
        let Viewer { ctx, .. } = self;
        let tell = || {
            let (text, percent) = ctx.console.under_way().unwrap_or(("opening the model".into(), None));
            WaitingText { text, share: percent.map(|percent| percent as f32 / 100.0) }
        };
        let options = door.options(FrameOptions::default(), true);
        let room = WaitingRoom::new(&door.listener, &options, &ctx.budget);
        match room.and_then(|room| room.during(&tell, &mut work)?) {
            Err(error) if error.code() == Code::MemoryLimit => work(),
            done => done,
        }
    }

    /// Tells what is wrong with what there is now, here and in pages, until it has changed.
    fn wait_for_change(
        &self,
        door: &Door<'_>,
        error: &Error,
        has_changed: &(dyn Fn() -> bool + Sync),
    ) -> Result<()> {
        let Viewer { ctx, .. } = self;
        ctx.console.abandon();
        ctx.console.note(&format!("note: cannot be shown, waiting for it to change: {error}"));
        let tell = || WaitingText { text: format!("waiting for the model to change\n{error}"), share: None };
        let options = door.options(FrameOptions::default(), true);
        WaitingRoom::new(&door.listener, &options, &ctx.budget)?.during(&tell, || {
            while !ctx.interrupt.is_raised() && !has_changed() {
                std::thread::sleep(LOOK_EVERY);
            }
        })
    }
}

/// The scene that was on show `before`, on the model at `path` as it is now: where lights and materials were those of
/// the file, or sections and hidden materials were, they are those of `scene`, which has been read again.
fn seen_again(before: &ServeReport, scene: &Scene, path: &Path) -> Option<Scene> {
    let seen = Scene::parse(before.scene.as_deref()?, path).ok()?;
    if !before.is_as_opened {
        return Some(seen);
    }
    let parts = if before.are_parts_edited { seen.parts } else { scene.parts.clone() };
    Some(Scene { camera: seen.camera, render: seen.render, given: seen.given, parts, ..scene.clone() })
}

/// True when the picture is to be as large as the page.
fn follows_page(args: &ViewArgs, scene: &Scene) -> bool {
    args.picture.keys.edit().resolution.is_none() && scene.given.resolution.is_none()
}

/// Opens what is to be shown; where memory is short and the picture follows the page, at half of the sides, and again.
fn open_stage(
    args: &ViewArgs,
    follows_page: bool,
    mut scene: Scene,
    path: &Path,
    ctx: &Context,
) -> Result<(Stage, trex_model::Session)> {
    let (io, device) = (io_options(&args.disk), args.device.options());
    let stop = StopSignal::new(&ctx.interrupt, None);
    loop {
        let options = SessionOptions::shown(scene.render.resolution);
        let play = Play { scene: &scene, file: path, options, io: &io, device: &device, stop: &stop };
        match Stage::open(&play, ctx) {
            Err(error) if error.code() == Code::MemoryLimit && follows_page => {
                scene.render.resolution = halved(scene.render.resolution).ok_or(error)?;
            }
            opened => return opened,
        }
    }
}

/// A picture that is sent has fewer pixels on a side than one that is written.
fn check_resolution(scene: &Scene) -> Result<()> {
    let [width, height] = scene.render.resolution;
    if width <= SIDE_MAX && height <= SIDE_MAX {
        return Ok(());
    }
    Err(Error::new(Code::Usage, "this picture is too large to be shown")
        .at_place("--resolution")
        .numbers(format!("{width}x{height}, at most {SIDE_MAX} on a side"))
        .next("ask for a smaller one, or use trex render"))
}

/// A picture of half the sides; `None` when it would show nothing.
fn halved(resolution: [u32; 2]) -> Option<[u32; 2]> {
    let halved = resolution.map(|side| side / 2);
    halved.iter().all(|&side| side >= SIDE_LEAST).then_some(halved)
}

#[derive(Serialize)]
struct ViewReport {
    scene: String,
    address: String,
    time_ms: u64,
    /// How often the model was shown: more than once where it has changed meanwhile.
    shows: u32,
    #[serde(flatten)]
    served: ServeReport,
    damaged_pages: Vec<u32>,
    damage: Damage,
    io_backend: IoDescription,
    device: DeviceReport,
    pool: trex_store::pool::PoolStats,
    memory: Memory,
}

impl fmt::Display for ViewReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ServeReport { clients, events, frames, frames_drawn, sent_bytes, .. } = &self.served;
        writeln!(
            f,
            "{:.0} s; {clients} pages, {events} events, {frames} frames, {frames_drawn} drawn, {} sent",
            Duration::from_millis(self.time_ms).as_secs_f64(),
            size::bytes(*sent_bytes)
        )?;
        if self.damage.page_count > 0 {
            let count = self.damage.page_count;
            writeln!(f, "not whole: {count} damaged pages, left out; see `trex verify`")?;
        }
        write!(
            f,
            "pages: {} read; memory limit {}, peak {}",
            size::count(self.pool.pages_read),
            size::bytes(self.memory.limit_bytes),
            self.memory.peak_rss_bytes.map_or_else(|| "unknown".into(), size::bytes)
        )
    }
}
