//! `trex bench rays`, `trex bench build`: the workloads of `trex-bench` without its peers.

use super::stage::io_options;
use crate::args::{BenchArgs, BenchBuildArgs, BenchRaysArgs, BenchVerb};
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use trex_bench::building::{self, BuildFigures};
use trex_bench::model::{Model, Surroundings};
use trex_bench::rays::{self, RayFigures, RayOptions, SetFigures};

/// Runs `trex bench`.
pub fn run(args: &BenchArgs, ctx: &Context) -> anyhow::Result<Exit> {
    match &args.verb {
        BenchVerb::Rays(args) => run_rays(args, ctx),
        BenchVerb::Build(args) => run_build(args, ctx),
    }
}

fn run_rays(args: &BenchRaysArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let around = surroundings(args.scratch.temp_dir.as_deref(), ctx);
    let model = Model::open(&args.model, &around)?;
    let options = RayOptions {
        resolution: [args.resolution.width, args.resolution.height],
        rounds: usize::from(args.rounds),
        seed: args.seed,
        io: io_options(&args.disk),
        peer: None,
    };
    let figures = rays::run(&model, &options, &around)?;
    ctx.done(&RaysMeasured { figures, memory: Memory::new(&ctx.budget) })
}

fn run_build(args: &BenchBuildArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let around = surroundings(args.scratch.temp_dir.as_deref(), ctx);
    let figures = building::run(&args.spec, usize::from(args.rounds), &around)?;
    ctx.done(&BuildMeasured { figures, memory: Memory::new(&ctx.budget) })
}

/// A bench has no output: its temporary folder is made where it runs.
fn surroundings(temp_dir: Option<&Path>, ctx: &Context) -> Surroundings {
    Surroundings {
        threads: ctx.threads,
        budget: ctx.budget.clone(),
        folder: temp_dir.map_or_else(|| PathBuf::from("."), Path::to_path_buf),
        interrupt: ctx.interrupt.clone(),
    }
}

#[derive(Serialize)]
struct RaysMeasured {
    #[serde(flatten)]
    figures: RayFigures,
    memory: Memory,
}

impl fmt::Display for RaysMeasured {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let figures = &self.figures;
        let line = |name: &str, set: &SetFigures| {
            format!("{name}: {}, {} of {} hit", size::rate(set.per_s, "rays"), set.hit_count, set.ray_count)
        };
        writeln!(
            f,
            "{} triangles, {} ({}), {} threads, {}",
            size::count(figures.triangle_count),
            size::bytes(figures.resident_bytes),
            figures.pages,
            figures.thread_count,
            figures.arithmetic
        )?;
        writeln!(f, "{}", line("primary", &figures.primary))?;
        writeln!(f, "{}", line("shadow", &figures.shadow))?;
        write!(f, "{}", line("incoherent", &figures.incoherent))?;
        for (name, set) in [("gray", &figures.gray), ("gray, shadow", &figures.gray_shadow)] {
            if let Some(set) = set {
                write!(f, "\n{}", line(name, set))?;
                if let Some(against) = set.against_mesh {
                    let percent = |share: f64| format!("{:.2} %", 100.0 * share);
                    let (hit, miss) = (percent(against.false_hit_share), percent(against.false_miss_share));
                    write!(f, "; false: {hit} hits, {miss} misses")?;
                }
            }
        }
        Ok(())
    }
}

#[derive(Serialize)]
struct BuildMeasured {
    #[serde(flatten)]
    figures: BuildFigures,
    memory: Memory,
}

impl fmt::Display for BuildMeasured {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let figures = &self.figures;
        write!(
            f,
            "{}: {}, {:.2} bytes per triangle, {} rounds",
            figures.scene,
            size::rate(figures.triangles_per_s, "triangles"),
            figures.bytes_per_triangle,
            figures.round_count
        )
    }
}
