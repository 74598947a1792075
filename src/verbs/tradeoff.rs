//! `trex bench tradeoff`: pictures for each turn of each knob, and which of them no other beats.

use super::campaign::campaign;
use crate::args::BenchTradeoffArgs;
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use serde::Serialize;
use std::fmt;
use std::path::PathBuf;
use trex_bench::tradeoff::{self, PointFigures, TradeoffFigures, TradeoffOptions};

/// Runs `trex bench tradeoff`.
pub fn run(args: &BenchTradeoffArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let figures = campaign(ctx, "tradeoff", "pictures", |program, around| {
        let options = TradeoffOptions {
            program,
            input: args.input.clone(),
            folder: args.output.clone(),
            resolution: [args.resolution.width, args.resolution.height],
            reference_spp: args.reference_spp,
            knobs: args.knobs.clone(),
            rounds: usize::from(args.rounds),
        };
        tradeoff::run(&options, around)
    })?;
    ctx.done(&TradeoffReport { figures, folder: args.output.clone(), memory: Memory::new(&ctx.budget) })
}

#[derive(Serialize)]
struct TradeoffReport {
    #[serde(flatten)]
    figures: TradeoffFigures,
    folder: PathBuf,
    memory: Memory,
}

impl fmt::Display for TradeoffReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let figures = &self.figures;
        let [width, height] = figures.resolution;
        writeln!(
            f,
            "{}: {width}x{height}; the references' own noise comes to a relMSE of {:.1e}",
            figures.scene, figures.reference_relmse
        )?;
        writeln!(
            f,
            "{:<34} {:>8} {:>9} {:>8} {:>6} {:>9} {:>9} {:>9} {:>9} {:>9}  {:>9}",
            "on the front of time",
            "s",
            "relMSE",
            "PSNR dB",
            "FLIP",
            "shadow",
            "contact",
            "indirect",
            "gloss",
            "mirror",
            "memory"
        )?;
        let mut front: Vec<&PointFigures> =
            figures.points.iter().filter(|point| point.is_on_time_front || point.knob == "quality").collect();
        let time = |point: &PointFigures| point.measured.as_ref().map_or(0.0, |measured| measured.picture_ms);
        front.sort_by(|a, b| time(a).total_cmp(&time(b)));
        for point in front {
            let name = format!("{} {}", point.knob, point.value.replace("--", ""));
            let beaten = point.front_distance.filter(|_| !point.is_on_time_front);
            let beaten = beaten.map_or_else(String::new, |by| format!("  {by:.1} x the front"));
            match &point.measured {
                None => writeln!(f, "{name:<34} {}", point.refused.as_deref().unwrap_or_default())?,
                Some(measured) => {
                    let error = |region: &str| match measured.errors[region].relmse {
                        Some(error) => format!("{error:.1e}"),
                        None => "-".to_owned(),
                    };
                    let whole = measured.errors["whole"];
                    writeln!(
                        f,
                        "{name:<34} {:>8.2} {:>9} {:>8} {:>6.3} {:>9} {:>9} {:>9} {:>9} {:>9}  {:>9}{beaten}",
                        measured.picture_ms / 1e3,
                        error("whole"),
                        whole.psnr_db.map_or_else(|| "inf".into(), |psnr| format!("{psnr:.1}")),
                        whole.flip.unwrap_or_default(),
                        error("shadow"),
                        error("contact"),
                        error("indirect"),
                        error("gloss"),
                        error("mirror"),
                        size::bytes(measured.peak_rss_bytes)
                    )?;
                }
            }
        }
        for (part, without) in &figures.without {
            let part = part.replace('_', " ");
            writeln!(
                f,
                "normal without {part}: {:.2} times the time, {:.2} times the relMSE",
                without.time_ratio, without.relmse_ratio
            )?;
        }
        if !figures.left_out.is_empty() {
            let knobs = figures.left_out.join(", ");
            writeln!(f, "not turned, since they are of the build: {knobs}; name the mesh or a gen: model")?;
        }
        write!(
            f,
            "{} points in {}, with error-time.svg and error-memory.svg",
            figures.points.len(),
            self.folder.display()
        )
    }
}
