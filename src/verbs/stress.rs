//! `trex stress`: views, lights and limits that change, and a verdict.

use super::picture_file::PictureFile;
use super::references::{self, references, snapshots};
use super::stage::{Play, ResidentPages, Stage, io_options, suit_file};
use super::stress_options::{T_MAX, stress_options, tell};
use super::stress_pictures::StressPictures;
use crate::args::{STRESS_RESOLUTION, StressArgs};
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::{Memory, resident_bytes};
use crate::size;
use serde::Serialize;
use std::fmt;
use std::path::Path;
use trex_bench::stress::{self, DragFigures, Snapshots, Stand, StressFigures};
use trex_model::{DeviceReport, Pace, SessionOptions, Times, open_scene};
use trex_render::{FetchBlock, Layers};
use trex_store::StopSignal;
use trex_store::io::IoDescription;

/// Runs `trex stress`.
pub fn run(args: &StressArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let (mut scene, path) = open_scene(&args.file)?;
    let inputs = [args.file.as_path(), &path].into_iter().chain(args.views.as_deref()).collect::<Vec<_>>();
    args.references.as_deref().map(|path| references::check(path, &inputs)).transpose()?;
    let read: Vec<&Path> = inputs.iter().copied().chain(args.references.as_deref()).collect();
    let check = |path| PictureFile::check(path, args.overwrite, Layers::default(), &read);
    let output = args.output.as_deref().map(check).transpose()?;
    let pictures = |folder| StressPictures::check(folder, args.overwrite, &read);
    let pictures = args.pictures.as_deref().map(pictures).transpose()?;
    scene.begin_live();
    if scene.model.is_empty() {
        scene.render.resolution = STRESS_RESOLUTION;
    }
    args.picture.override_scene(&args.research, &mut scene);
    suit_file(&mut scene, &path, ctx)?;
    let frames = args.deadline.options(args.deadline.t_max.as_ref().unwrap_or(&T_MAX));
    let io = io_options(&args.disk);
    let references = match args.reference_spp {
        Some(spp) => Some(references(args, ctx, &mut scene, &path, spp)?),
        None => None,
    };
    let resolution = scene.render.resolution;
    let copies_bytes = if references.is_some() { Snapshots::bytes(resolution) } else { 0 };
    let options = SessionOptions { pace: Pace::InFrames, copies_bytes, ..SessionOptions::default() };
    let device = args.device.options();
    let stop_signal = StopSignal::new(&ctx.interrupt, None);
    let play = Play { scene: &scene, file: &path, options, io: &io, device: &device, stop: &stop_signal };
    let (stage, mut session) = Stage::open(&play, ctx)?;
    let mut snapshots = references.map(|references| snapshots(args, ctx, references)).transpose()?;
    let stop = || ctx.interrupt.is_raised();
    session.illuminate(&stop, &mut |done, total| tell(ctx, "photons", [done, total], "photons"))?;
    ctx.interrupt.check()?;
    let mut session = session.go_live(stage.model.planned_frames(frames))?;
    let options = stress_options(args, &scene, &session)?;
    let switches = u64::from(options.switches);
    let stand = Stand {
        pool: &stage.pool,
        resident_bytes: &resident_bytes,
        interrupt: &ctx.interrupt,
        tell: &|done| tell(ctx, "stress", [done, switches], "switches"),
        t_max: frames.t_max,
    };
    let mut figures = stress::run(&mut session, &options, snapshots.as_mut(), &stand)?;
    let exposure = session.view().settings.exposure.factor();
    if let Some(output) = output {
        output.write(&session, exposure, session.thread_pool())?;
    }
    if let (Some(pictures), Some(snapshots)) = (pictures, &snapshots) {
        pictures.write(snapshots, session.film(), exposure, session.thread_pool())?;
    }
    let memory = Memory::new(&ctx.budget);
    if memory.peak_rss_bytes.is_some_and(|peak| peak > memory.limit_bytes) {
        figures.failures.push("memory passed its limit".into());
    }
    let passed = figures.failures.is_empty();
    let stressed = StressReport {
        scene: path.display().to_string(),
        integrator: scene.render.integrator.as_str(),
        resolution,
        triangle_count: stage.model.file().superblock().triangle_count,
        file_bytes: stage.model.file().superblock().file_bytes,
        n_shadow: scene.render.n_shadow,
        n_gather: scene.render.n_gather,
        t_max_ms: frames.t_max.as_secs_f64() * 1e3,
        fetch_block: match frames.fetch_block {
            FetchBlock::Tiles(tiles) => Some(tiles),
            FetchBlock::Adaptive => None,
        },
        reference_spp: args.reference_spp,
        figures,
        memory,
        resident_pages: stage.resident_pages(),
        io_backend: stage.io(ctx),
        device: stage.device(ctx),
        verdict: if passed { "pass" } else { "fail" },
    };
    ctx.done(&stressed)?;
    Ok(if passed { Exit::Done } else { Exit::No })
}

#[derive(Serialize)]
struct StressReport {
    scene: String,
    integrator: &'static str,
    resolution: [u32; 2],
    triangle_count: u64,
    file_bytes: u64,
    n_shadow: u32,
    n_gather: u32,
    t_max_ms: f64,
    /// Tiles, as asked; `null` where it follows the speed of late.
    fetch_block: Option<u32>,
    reference_spp: Option<u32>,
    #[serde(flatten)]
    figures: StressFigures,
    memory: Memory,
    /// At the end, by what they hold.
    resident_pages: ResidentPages,
    io_backend: IoDescription,
    device: DeviceReport,
    verdict: &'static str,
}

impl fmt::Display for StressReport {
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
        line("rough picture (a ray at every 4th pixel)", &figures.rough_ms)?;
        line("whole picture (a ray at every 2nd pixel)", &figures.whole_ms)?;
        line("response (an exact fetch block)", &figures.response_ms)?;
        line("complete picture (all exact)", &figures.complete_ms)?;
        line("all light in", &figures.converged_ms)?;
        line("frames", &figures.frame_ms)?;
        writeln!(
            f,
            "{} tiles a block, {:.1} % of the picture; {}; error of the footprint {} px asked, {} px at worst",
            figures.block_tiles.round(),
            100.0 * figures.response_share,
            size::rate(figures.rays.total() as f64 * 1e3 / figures.time_ms.max(1) as f64, "rays"),
            figures.pixel_error.asked,
            figures.pixel_error.worst
        )?;
        for (ms, error) in figures.error_at_ms.iter().flatten() {
            writeln!(
                f,
                "at {ms} ms: relMSE median {:.4}, greatest {:.4}; FLIP {:.3}, {:.3} ({})",
                error.median, error.max, error.flip.median, error.flip.max, error.count
            )?;
        }
        if let Some(drag) = figures.drag.as_ref().or(figures.fly.as_ref()) {
            drag_lines(f, drag)?;
        }
        if let Some(floor) = figures.error_floor {
            let (relmse, flip) = (floor.relmse, floor.flip);
            writeln!(f, "two references against each other: relMSE {relmse:.4}; FLIP {flip:.3}")?;
        }
        if let Some(coverage) = figures.coverage {
            writeln!(f, "the model covers {:.0} % of the pictures", 100.0 * coverage)?;
        }
        let evicted = match figures.pool.evictions {
            0 => "nothing evicted".to_owned(),
            count => format!("{} evicted", size::count(count)),
        };
        writeln!(
            f,
            "pages: {} read, {:.0} % of them again; {evicted}; {:.1} missed a switch; {} from the disk; \
             memory limit {}, peak {}",
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

/// Writes what a moving hand was shown.
fn drag_lines(f: &mut fmt::Formatter<'_>, drag: &DragFigures) -> fmt::Result {
    let [p50, p95] = [50.0, 95.0].map(|percentile| drag.picture_ms.percentile(percentile));
    writeln!(
        f,
        "while the hand moves: {:.1} pictures/s; event to picture: median {p50:.1} ms, 95 % within {p95:.1} ms",
        drag.pictures_per_s
    )?;
    if let (Some(relmse), Some(flip)) = (drag.relmse, drag.flip) {
        writeln!(
            f,
            "these pictures: relMSE median {:.4}, 95 % within {:.4}; FLIP {:.3}, {:.3} ({})",
            relmse.median, relmse.p95, flip.median, flip.p95, flip.count
        )?;
    }
    let coverage = drag.coverage.unwrap_or(0.0);
    writeln!(f, "the model covers {:.0} % of them", 100.0 * coverage)
}
