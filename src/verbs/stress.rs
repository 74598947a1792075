//! `trex stress`: views, lights and limits that change, and a verdict.

use super::picture_file::PictureFile;
use super::stage::{Play, Stage, io_options, open_scene, read_views};
use crate::args::StressArgs;
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::{Memory, resident_bytes};
use crate::size;
use crate::values::Milliseconds;
use serde::Serialize;
use std::fmt;
use std::time::Duration;
use trex_bench::stress::{self, Limits, Stand, StressFigures, StressOptions, Times};
use trex_render::{Layers, Method};
use trex_store::Progress;
use trex_store::io::IoDescription;

/// Longest frame when no other is asked for: what the paper takes for the longest that users bear.
const T_MAX: Milliseconds = Milliseconds(100.0);

/// Runs `trex stress`.
pub fn run(args: &StressArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let output = args.output.as_ref().map(|path| PictureFile::check(path, args.overwrite, Layers::default()));
    let output = output.transpose()?;
    let (mut scene, path) = open_scene(&args.file)?;
    let is_page_file = scene.model.is_empty();
    let render = &mut scene.render;
    if is_page_file {
        (render.integrator, render.resolution, render.lod_error) = (Method::Photon, [512, 512], 1.0);
    }
    args.picture.override_scene(&mut scene);
    let frames = args.deadline.options(args.deadline.t_max.as_ref().unwrap_or(&T_MAX));
    let play = Play {
        scene: &scene,
        file: &path,
        layers: Layers::default(),
        io: &io_options(&args.disk),
        live: Some(frames),
    };
    let stage = Stage::open(&play, ctx)?;
    let mut session = stage.session(ctx)?;
    let show = ctx.report();
    let tell = |phase, done, total, unit| {
        show(Progress { phase, done, total, unit, memory_bytes: ctx.budget.used_bytes() });
    };
    let stop = || ctx.interrupt.is_raised();
    session.illuminate(&stop, &mut |done, total| tell("photons", done, total, "photons"))?;
    ctx.interrupt.check()?;
    let mut session = session.go_live(frames)?;
    let views = args.views.as_ref().map(|path| read_views(path, &session.view().camera)).transpose()?;
    let options = StressOptions {
        scenario: args.scenario,
        switches: args.switches,
        hold: Duration::from_secs_f64(args.hold.0 / 1e3),
        seed: scene.render.seed,
        views: views.unwrap_or_default(),
        limits: args.require.as_ref().map(|triple| {
            let [p50_ms, p99_ms, frame_max_ms] = triple.0;
            Limits { p50_ms, p99_ms, frame_max_ms }
        }),
    };
    let switches = u64::from(options.switches);
    let stand = Stand {
        pool: &stage.pool,
        resident_bytes: &resident_bytes,
        interrupt: &ctx.interrupt,
        tell: &|done| tell("stress", done, switches, "switches"),
    };
    let mut figures = stress::run(&mut session, &options, &stand)?;
    if let Some(output) = output {
        output.write(&session, scene.render.exposure, session.thread_pool())?;
    }
    let memory = Memory::new(&ctx.budget);
    if memory.peak_rss_bytes.is_some_and(|peak| peak > memory.limit_bytes) {
        figures.failures.push("memory passed its limit".into());
    }
    let passed = figures.failures.is_empty();
    let stressed = Stressed {
        scene: path.display().to_string(),
        integrator: scene.render.integrator.as_str(),
        resolution: scene.render.resolution,
        n_shadow: scene.render.n_shadow,
        n_gather: scene.render.n_gather,
        t_max_ms: frames.t_max.as_secs_f64() * 1e3,
        fetch_block: frames.fetch_block,
        figures,
        memory,
        io_backend: stage.pool.io(),
        verdict: if passed { "pass" } else { "fail" },
    };
    ctx.done(&stressed)?;
    Ok(if passed { Exit::Done } else { Exit::No })
}

#[derive(Serialize)]
struct Stressed {
    scene: String,
    integrator: &'static str,
    resolution: [u32; 2],
    n_shadow: u32,
    n_gather: u32,
    t_max_ms: f64,
    fetch_block: u32,
    #[serde(flatten)]
    figures: StressFigures,
    memory: Memory,
    io_backend: IoDescription,
    verdict: &'static str,
}

impl fmt::Display for Stressed {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let figures = &self.figures;
        let mut line = |name: &str, times: &Times| {
            if times.count() == 0 {
                return writeln!(f, "{name}: none");
            }
            let [p50, p99, max] = [times.percentile(50.0), times.percentile(99.0), times.max()];
            writeln!(
                f,
                "{name}: median {p50:.1} ms, 99 % within {p99:.1} ms, longest {max:.1} ms ({})",
                times.count()
            )
        };
        line("first picture", &figures.first_picture_ms)?;
        line("response", &figures.response_ms)?;
        line("complete picture", &figures.complete_ms)?;
        line("frames", &figures.frame_ms)?;
        writeln!(
            f,
            "{} tiles a block, {}; error of the footprint {} px asked, {} px at worst",
            figures.block_tiles.round(),
            size::rate(figures.rays.total() as f64 * 1e3 / figures.time_ms.max(1) as f64, "rays"),
            figures.pixel_error.asked,
            figures.pixel_error.worst
        )?;
        writeln!(
            f,
            "pages: {} read, {:.0} % of them again; {:.1} missed a switch; {} from the disk; memory limit {}, peak {}",
            size::count(figures.pool.pages_read),
            100.0 * figures.refault_ratio,
            figures.first_touch_misses,
            size::bytes(figures.bytes_read),
            size::bytes(self.memory.limit_bytes),
            self.memory.peak_rss_bytes.map_or_else(|| "unknown".into(), size::bytes)
        )?;
        for failure in &figures.failures {
            writeln!(f, "failed: {failure}")?;
        }
        write!(f, "{}: {}", figures.scenario, self.verdict)
    }
}
