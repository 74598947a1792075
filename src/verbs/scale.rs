//! `trex bench scale`: what models of rising size cost, and how each cost grows.

use super::campaign::campaign;
use crate::args::BenchScaleArgs;
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use serde::Serialize;
use std::fmt;
use std::path::PathBuf;
use std::time::Duration;
use trex_bench::scale::{self, MEASURES, ModelCost, ScaleFigures, ScaleOptions};

/// Runs `trex bench scale`.
pub fn run(args: &BenchScaleArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let figures = campaign(ctx, "scale", "models", |program, around| {
        let options = ScaleOptions {
            program,
            models: args.models.clone(),
            folder: args.output.clone(),
            resolution: [args.resolution.width, args.resolution.height],
            switches: args.switches,
            views_limit_bytes: args.views_limit.0,
            rounds: usize::from(args.rounds),
        };
        scale::run(&options, around)
    })?;
    ctx.done(&ScaleReport { figures, folder: args.output.clone(), memory: Memory::new(&ctx.budget) })
}

#[derive(Serialize)]
struct ScaleReport {
    #[serde(flatten)]
    figures: ScaleFigures,
    folder: PathBuf,
    memory: Memory,
}

impl fmt::Display for ScaleReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let figures = &self.figures;
        let [width, height] = figures.resolution;
        let limit = size::bytes(figures.views_limit_bytes);
        writeln!(f, "{} jumps a model at {width}x{height} in {limit}", figures.switches)?;
        writeln!(
            f,
            "{:<24} {:>9} {:>9} {:>9} {:>8} {:>15} {:>15} {:>8}  rays/s: primary, shadow, incoherent",
            "model", "triangles", "build", "disk", "start", "whole, 99 %", "exact, 99 %", "evicted"
        )?;
        for point in &figures.points {
            match &point.cost {
                Some(cost) => line_of(&point.model, cost, f)?,
                None => writeln!(f, "{:<24} {}", point.model, point.refused.as_deref().unwrap_or_default())?,
            }
        }
        for measure in &MEASURES {
            if let Some(growth) = figures.exponents.get(measure.key) {
                writeln!(
                    f,
                    "ten times the triangles: {:.2} times {} (exponent {:.2})",
                    growth.at_ten_times, measure.name, growth.exponent
                )?;
            }
        }
        write!(f, "{} models in {}, with scale.svg", figures.points.len(), self.folder.display())
    }
}

fn line_of(model: &str, cost: &ModelCost, f: &mut fmt::Formatter<'_>) -> fmt::Result {
    let short = |ms: f64| size::duration(Duration::from_secs_f64(ms / 1e3));
    let time = |ms: Option<f64>| ms.map_or_else(|| "-".to_owned(), short);
    let both = |p50, p99| format!("{}, {}", time(p50), time(p99));
    let rates = [cost.primary_per_s, cost.shadow_per_s, cost.incoherent_per_s];
    let [primary, shadow, incoherent] = rates.map(|rate| format!("{:.2}", rate / 1e6));
    writeln!(
        f,
        "{model:<24} {:>9} {:>9} {:>9} {:>8} {:>15} {:>15} {:>8}  {primary}, {shadow}, {incoherent} M{}",
        size::count(cost.triangle_count),
        time(cost.build_ms),
        size::bytes(cost.file_bytes),
        short(cost.start_ms),
        both(cost.whole_p50_ms, cost.whole_p99_ms),
        both(cost.complete_p50_ms, cost.complete_p99_ms),
        size::count(cost.evictions),
        if cost.are_pages_resident { "" } else { ", pages come and go" },
    )
}
