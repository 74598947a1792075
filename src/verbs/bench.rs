//! `trex bench rays`, `io`, `build`, `tradeoff` and `scale`: the workloads of `trex-bench` without its peers.

use super::stage::io_options;
use super::{scale, tradeoff};
use crate::args::{BenchArgs, BenchBuildArgs, BenchIoArgs, BenchRaysArgs, BenchVerb};
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use trex_bench::building::{self, BuildFigures};
use trex_bench::model::{Model, Surroundings};
use trex_bench::page_io::{self, PageIoFigures, PageIoOptions, ReadStage};
use trex_bench::rays::{
    self, DeviceFigures, DeviceSetFigures, MixFigures, RayFigures, RayOptions, SetFigures, VisitFigures,
};
use trex_store::printable::one_line;

/// Runs `trex bench`.
pub fn run(args: &BenchArgs, ctx: &Context) -> anyhow::Result<Exit> {
    match &args.verb {
        BenchVerb::Rays(args) => run_rays(args, ctx),
        BenchVerb::Io(args) => run_io(args, ctx),
        BenchVerb::Build(args) => run_build(args, ctx),
        BenchVerb::Tradeoff(args) => tradeoff::run(args, ctx),
        BenchVerb::Scale(args) => scale::run(args, ctx),
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
        stats: args.stats,
        device: args.device.device.is_some().then(|| args.device.options()),
        peer: None,
    };
    let figures = rays::run(&model, &options, &around)?;
    ctx.done(&RayBenchReport { figures, memory: Memory::new(&ctx.budget) })
}

fn run_io(args: &BenchIoArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let around = surroundings(args.scratch.temp_dir.as_deref(), ctx);
    let model = Model::open(&args.model, &around)?;
    let options = PageIoOptions {
        depths: args.depth.iter().map(|&depth| usize::from(depth)).collect(),
        rounds: usize::from(args.rounds),
        seed: args.seed,
        fio: false,
        mapped: false,
    };
    let figures = page_io::run(&model, &options, &around)?;
    ctx.done(&IoBenchReport { figures, memory: Memory::new(&ctx.budget) })
}

fn run_build(args: &BenchBuildArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let around = surroundings(args.scratch.temp_dir.as_deref(), ctx);
    let figures = building::run(&args.spec, usize::from(args.rounds), &around)?;
    ctx.done(&BuildBenchReport { figures, memory: Memory::new(&ctx.budget) })
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
struct RayBenchReport {
    #[serde(flatten)]
    figures: RayFigures,
    memory: Memory,
}

impl fmt::Display for RayBenchReport {
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
        for (name, set) in
            [("primary, shaded", &figures.primary_shaded), ("incoherent, shaded", &figures.incoherent_shaded)]
        {
            set.as_ref().map_or(Ok(()), |set| write!(f, "\n{}", line(name, set)))?;
        }
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
        figures.device.as_ref().map_or(Ok(()), |device| show_device(device, f))?;
        figures.visits.as_ref().map_or(Ok(()), |visits| show_visits(visits, f))
    }
}

/// A line a set.
fn show_device(device: &DeviceFigures, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    let DeviceFigures { report, call_ray_count, gather, shadow, mixes, .. } = device;
    let DeviceFigures { finest_gather, finest_shadow, finest_mixes, .. } = device;
    write!(f, "\n{}, {call_ray_count} rays a call: {}", one_line(&report.name), report.reason)?;
    let mixed = |mix: &MixFigures, finest: &str| {
        (format!("{} shadow, {} gather{finest}", mix.n_shadow, mix.n_gather), mix.set)
    };
    let named = |name: &str, set: &DeviceSetFigures| (name.to_owned(), *set);
    let sets = [named("gather", gather), named("shadow", shadow)]
        .into_iter()
        .chain(mixes.iter().map(|mix| mixed(mix, "")))
        .chain(finest_gather.iter().map(|set| named("gather, finest", set)))
        .chain(finest_shadow.iter().map(|set| named("shadow, finest", set)))
        .chain(finest_mixes.iter().map(|mix| mixed(mix, ", finest")));
    for (name, set) in sets {
        let [lanes, scalar] = [set.lanes_per_s, set.scalar_per_s].map(|rate| size::rate(rate, "rays"));
        write!(f, "\n{name}: {}; lanes {lanes}, scalar {scalar}", size::rate(set.per_s, "rays"))?;
        if let Some(kernel) = set.kernel_per_s {
            write!(f, ", in kernels {}", size::rate(kernel, "rays"))?;
        }
        write!(
            f,
            "; {} of {} hit, {} not as the processor's",
            set.hit_count, set.ray_count, set.other_count
        )?;
        let steps = set.steps_per_ray.unwrap_or(set.scalar_steps_per_ray);
        write!(f, "; steps a ray: {steps:.2}, scalar {:.2}", set.scalar_steps_per_ray)?;
    }
    Ok(())
}

/// A line a set, and one a tree.
fn show_visits(visits: &VisitFigures, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    let VisitFigures { ours, reference } = visits;
    for (name, ours, reference) in [
        ("primary", ours.primary, reference.primary),
        ("shadow", ours.shadow, reference.shadow),
        ("incoherent", ours.incoherent, reference.incoherent),
    ] {
        write!(
            f,
            "\nvisits, {name}: {:.2} (top {:.2}, nodes {:.2}, clusters {:.2}, leaves {:.2}); reference {:.2}",
            ours.total, ours.top, ours.node, ours.cluster, ours.leaf, reference.total
        )?;
    }
    for (name, tree) in [("tree", ours), ("reference", reference)] {
        write!(
            f,
            "\n{name}: SAH cost {:.1}, overlap {:.2}, {:.2} triangles a leaf",
            tree.sah_cost, tree.overlap, tree.leaf_triangles
        )?;
    }
    Ok(())
}

#[derive(Serialize)]
struct IoBenchReport {
    #[serde(flatten)]
    figures: PageIoFigures,
    memory: Memory,
}

impl fmt::Display for IoBenchReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let figures = &self.figures;
        write!(
            f,
            "{} pages a round, {} on disk and {:.0} triangles each, {} rounds",
            figures.page_count,
            size::bytes(figures.bytes_per_page as u64),
            figures.triangles_per_page,
            figures.round_count
        )?;
        for way in figures.ways.values() {
            let how = if way.direct { "direct" } else { "cached" };
            let stage = match way.stage {
                ReadStage::Raw => "raw",
                ReadStage::Hashed => "hashed",
                ReadStage::Traceable => "traceable, clusters packed",
                ReadStage::Ready => "ready, all clusters unpacked",
                ReadStage::Waited => "waited for",
                ReadStage::WaitedBusy => "waited for beside a full queue",
            };
            write!(
                f,
                "\n{} {how}, depth {}, {stage}: {}, {}/s, {:.1} us of processor a page",
                way.backend,
                way.depth,
                size::rate(way.pages_per_s, "pages"),
                size::bytes(way.bytes_per_s as u64),
                way.cpu_us_per_page
            )?;
            if let Some(latency) = way.latency_us {
                write!(f, ", {} us (p99 {})", latency.p50, latency.p99)?;
            }
        }
        Ok(())
    }
}

#[derive(Serialize)]
struct BuildBenchReport {
    #[serde(flatten)]
    figures: BuildFigures,
    memory: Memory,
}

impl fmt::Display for BuildBenchReport {
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
