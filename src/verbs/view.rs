//! `trex view`: a page file or a scene, live in a browser page.
//!
//! ```text
//! scene, flags -> listen -> stage -> say where -> serve until Ctrl-C -> what was served
//! ```

use super::command_line::render_line;
use super::damage::Damage;
use super::shown_file::shown_file;
use super::stage::{Play, Stage, io_options, open_scene, suit_file};
use crate::args::ViewArgs;
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use crate::values::Milliseconds;
use serde::Serialize;
use std::fmt;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;
use trex_model::{Device, DeviceReport, SessionOptions, ShownModel};
use trex_render::{Exposure, FrameOptions, Scene};
use trex_store::io::IoDescription;
use trex_store::{Code, Error, Result, StopSignal};
use trex_view::{Embedders, SIDE_MAX, SILENCE_MAX, ServeOptions, ServeReport, Token};

/// Longest frame when no other is asked for.
const T_MAX: Milliseconds = Milliseconds(100.0);
/// Size of the picture until the page says its own.
pub(super) const FIRST_RESOLUTION: [u32; 2] = [1280, 720];
/// Smallest side of a picture that is tried where memory is short, pixels.
const SIDE_LEAST: u32 = 80;

/// Runs `trex view`.
pub fn run(args: &ViewArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let file = shown_file(args, ctx)?;
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
    let listener = listen(args)?;

    let (stage, session) = open_stage(args, &mut scene, &path, ctx)?;
    let session = session.go_live(frames)?;

    let (token, hosts) = (Token::random()?, args.host.clone());
    let (embedders, silence_max) = (Embedders::default(), SILENCE_MAX);
    let options = ServeOptions { token, hosts, frames, follows_page, embedders, silence_max };
    let address = listener.local_addr().map_err(|error| refused(args, &error))?;
    say_where(args, address, &options.token, ctx);
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let model_path = std::fs::canonicalize(&path).unwrap_or_else(|_| path.clone());
    let input = file.display().to_string();
    let shown = ShownModel {
        name: &name,
        path: &model_path.display().to_string(),
        scene: &scene,
        words: &|recipe| render_line(&input, recipe),
        peak_rss_bytes: &|| Memory::new(&ctx.budget).peak_rss_bytes,
        stop: &|| ctx.interrupt.is_raised(),
    };
    let begin = std::time::Instant::now();
    let served = stage.model.show(session, &listener, &options, &shown)?;
    let damage = Damage::of(&stage);
    damage.report(ctx);
    let is_whole = damage.page_count == 0;
    ctx.done(&ViewReport {
        scene: path.display().to_string(),
        address: address.to_string(),
        time_ms: begin.elapsed().as_millis() as u64,
        served,
        damaged_pages: stage.pool.damage().iter().map(|(page, _)| *page).collect(),
        damage,
        io_backend: stage.io(ctx),
        device: stage.device(ctx),
        pool: stage.pool.stats(),
        memory: Memory::new(&ctx.budget),
    })?;
    Ok(if is_whole || args.allow_damage { Exit::Done } else { Exit::No })
}

/// True when the picture is to be as large as the page.
fn follows_page(args: &ViewArgs, scene: &Scene) -> bool {
    args.picture.keys.edit().resolution.is_none() && scene.given.resolution.is_none()
}

/// Opens what is to be shown; where memory is short and the picture follows the page, at half of the sides, and again.
fn open_stage(
    args: &ViewArgs,
    scene: &mut Scene,
    path: &Path,
    ctx: &Context,
) -> Result<(Stage, trex_model::Session)> {
    let (io, device) = (io_options(&args.disk), args.device.options(Device::Auto));
    let stop = StopSignal::new(&ctx.interrupt, None);
    loop {
        let options = SessionOptions::shown(scene.render.resolution);
        match Stage::open(&Play { scene, file: path, options, io: &io, device: &device, stop: &stop }, ctx) {
            Err(error) if error.code() == Code::MemoryLimit && follows_page(args, scene) => {
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

fn listen(args: &ViewArgs) -> Result<TcpListener> {
    TcpListener::bind((args.bind, args.port)).map_err(|error| refused(args, &error))
}

fn refused(args: &ViewArgs, error: &std::io::Error) -> Error {
    Error::new(Code::Io, "cannot listen for the browser")
        .at_place(format!("{}", SocketAddr::new(args.bind, args.port)))
        .numbers(error.to_string())
        .next("name another --port (0 takes any that is free) or another --bind")
}

/// Tells where the page is, and opens it where there is a display and the browser is on this machine.
fn say_where(args: &ViewArgs, address: SocketAddr, token: &Token, ctx: &Context) {
    let host = match address.ip() {
        ip if ip.is_unspecified() => args.host.first().cloned().unwrap_or_else(|| "localhost".into()),
        IpAddr::V6(ip) => format!("[{ip}]"),
        IpAddr::V4(ip) => ip.to_string(),
    };
    let port = address.port();
    let url = format!("http://{host}:{port}/#token={}", token.digits());
    // It is of no use without its address: that is told even with --quiet.
    ctx.console.error(&url);
    let is_remote = std::env::var_os("SSH_CONNECTION").is_some();
    if !address.ip().is_loopback() {
        ctx.console.note(
            "note: others in the network can see the model, if they learn the token; nothing is encrypted",
        );
    } else if is_remote {
        ctx.console.note(&format!("from your own machine: ssh -L {port}:127.0.0.1:{port} {}", remote_name()));
    }
    let has_display = ["DISPLAY", "WAYLAND_DISPLAY"].iter().any(|name| std::env::var_os(name).is_some());
    if !args.no_open && has_display && !is_remote {
        open_browser(&url, ctx);
    }
}

/// What this machine is called where it was reached from, as far as it can know.
fn remote_name() -> String {
    let user = std::env::var("USER").unwrap_or_else(|_| "USER".into());
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname").unwrap_or_else(|_| "HOST".into());
    format!("{user}@{}", name.trim())
}

fn open_browser(url: &str, ctx: &Context) {
    let mut command = Command::new("xdg-open");
    command.arg(url).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    let opened = command.spawn().and_then(|mut child| {
        // It ends by itself; who waits for it is no part of what is shown.
        std::thread::Builder::new().name("view-open".into()).spawn(move || child.wait()).map(drop)
    });
    if let Err(error) = opened {
        ctx.console.note(&format!("note: no browser could be opened ({error}); open the address yourself"));
    }
}

#[derive(Serialize)]
struct ViewReport {
    scene: String,
    address: String,
    time_ms: u64,
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
        let ServeReport { clients, events, frames, frames_drawn, sent_bytes, .. } = self.served;
        writeln!(
            f,
            "{:.0} s; {clients} pages, {events} events, {frames} frames, {frames_drawn} drawn, {} sent",
            Duration::from_millis(self.time_ms).as_secs_f64(),
            size::bytes(sent_bytes)
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
