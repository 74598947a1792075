//! What models of rising size came to: a cost each, the exponents, a plot.

use super::ScaleOptions;
use super::exponent::Exponent;
use crate::plot::{self, Line};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use trex_store::Error;

/// Costs that the plot has lines for.
const TIME_LINES: [&str; 5] = ["build_ms", "start_ms", "whole_p50_ms", "complete_p50_ms", "complete_p99_ms"];

/// What came of it.
#[derive(Debug, Serialize)]
pub struct ScaleFigures {
    /// Width and height of the views that jump, pixels.
    pub resolution: [u32; 2],
    /// Views that jumped, a model.
    pub switches: u32,
    /// Memory limit of the views that jump and of the start.
    pub views_limit_bytes: u64,
    /// Runs of each build and each start.
    pub round_count: usize,
    /// All models, as they were named.
    pub points: Vec<ScalePoint>,
    /// The costs by triangles; of models of one size the last.
    pub by_triangle_count: BTreeMap<u64, ModelCost>,
    /// How each cost grows, where there are two sizes.
    pub exponents: BTreeMap<&'static str, Exponent>,
}

/// A model.
#[derive(Debug, Serialize)]
pub struct ScalePoint {
    /// As it was named.
    pub model: String,
    /// Why it has no costs.
    pub refused: Option<String>,
    /// What it costs; `None` where it was refused.
    #[serde(flatten)]
    pub cost: Option<ModelCost>,
}

/// What a model costs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ModelCost {
    /// Triangles stored.
    pub triangle_count: u64,
    /// The page file.
    pub file_bytes: u64,
    /// The build, from the start of its process to its end; `None` for a page file.
    pub build_ms: Option<f64>,
    /// Most memory of a build, as the kernel counted it.
    pub build_peak_rss_bytes: Option<u64>,
    /// From the start of a process to a small picture of direct light in a file.
    pub start_ms: f64,
    /// Most memory of that process.
    pub start_peak_rss_bytes: u64,
    /// Event to a lit ray at every second pixel: median and 99 %; `None` where no view came to it.
    pub whole_p50_ms: Option<f64>,
    /// See there.
    pub whole_p99_ms: Option<f64>,
    /// Event to an exact sample in every pixel; the same.
    pub complete_p50_ms: Option<f64>,
    /// See there.
    pub complete_p99_ms: Option<f64>,
    /// Pages read while views jumped.
    pub pages_read: u64,
    /// Pages evicted meanwhile.
    pub evictions: u64,
    /// Most memory of that process.
    pub views_peak_rss_bytes: u64,
    /// Whether rays found all pages in memory.
    pub are_pages_resident: bool,
    /// Primary rays a second.
    pub primary_per_s: f64,
    /// Shadow rays a second.
    pub shadow_per_s: f64,
    /// Incoherent rays a second.
    pub incoherent_per_s: f64,
}

/// A cost that grows.
#[derive(Debug)]
pub struct Measure {
    /// Its key.
    pub key: &'static str,
    /// What it is, in words that follow "ten times the triangles: 9.3 times".
    pub name: &'static str,
    of: fn(&ModelCost) -> Option<f64>,
}

const fn measure(key: &'static str, name: &'static str, of: fn(&ModelCost) -> Option<f64>) -> Measure {
    Measure { key, name, of }
}

/// What exponents are told of.
pub const MEASURES: [Measure; 13] = [
    measure("build_ms", "the time of a build", |cost| cost.build_ms),
    measure("build_peak_rss_bytes", "the memory of a build", |cost| {
        cost.build_peak_rss_bytes.map(|n| n as f64)
    }),
    measure("file_bytes", "the bytes on disk", |cost| Some(cost.file_bytes as f64)),
    measure("start_ms", "the time from the start to a first picture", |cost| Some(cost.start_ms)),
    measure("start_peak_rss_bytes", "the memory of a start", |cost| Some(cost.start_peak_rss_bytes as f64)),
    measure("whole_p50_ms", "the time to a whole picture after a jump", |cost| cost.whole_p50_ms),
    measure("whole_p99_ms", "the time to the slowest whole picture of a hundred", |cost| cost.whole_p99_ms),
    measure("complete_p50_ms", "the time to an exact picture after a jump", |cost| cost.complete_p50_ms),
    measure("complete_p99_ms", "the time to the slowest exact picture of a hundred", |cost| {
        cost.complete_p99_ms
    }),
    measure("pages_read", "the pages that jumps read", |cost| Some(cost.pages_read as f64)),
    measure("primary_per_s", "the primary rays a second", |cost| Some(cost.primary_per_s)),
    measure("shadow_per_s", "the shadow rays a second", |cost| Some(cost.shadow_per_s)),
    measure("incoherent_per_s", "the incoherent rays a second", |cost| Some(cost.incoherent_per_s)),
];

impl ScaleFigures {
    pub(super) fn new(points: Vec<ScalePoint>, options: &ScaleOptions) -> ScaleFigures {
        let costs: Vec<&ModelCost> = points.iter().filter_map(|point| point.cost.as_ref()).collect();
        let exponents = MEASURES
            .iter()
            .filter_map(|measure| Some((measure.key, Exponent::of(&measure.points(&costs))?)))
            .collect();
        let by_triangle_count = costs.into_iter().map(|cost| (cost.triangle_count, cost.clone())).collect();
        ScaleFigures {
            resolution: options.resolution,
            switches: options.switches,
            views_limit_bytes: options.views_limit_bytes,
            round_count: options.rounds,
            points,
            by_triangle_count,
            exponents,
        }
    }

    /// Writes `scale.svg`: times over triangles.
    pub(super) fn plot(&self, folder: &Path) -> anyhow::Result<()> {
        let costs: Vec<&ModelCost> = self.points.iter().filter_map(|point| point.cost.as_ref()).collect();
        let measures = MEASURES.iter().filter(|measure| TIME_LINES.contains(&measure.key));
        let lines: Vec<Line> = measures
            .map(|measure| Line::new(measure.key, measure.points(&costs)))
            .filter(|line| !line.points.is_empty())
            .collect();
        if lines.is_empty() {
            return Ok(());
        }
        let path = folder.join("scale.svg");
        let picture = plot::render(&lines, "triangles", "ms")?;
        Ok(fs::write(&path, picture).map_err(|error| Error::writing("write", &path, &error))?)
    }
}

impl Measure {
    /// Triangles and cost of each model that has it, above zero.
    fn points(&self, costs: &[&ModelCost]) -> Vec<(f64, f64)> {
        let point = |cost: &&ModelCost| Some((cost.triangle_count as f64, (self.of)(cost)?));
        costs.iter().filter_map(point).filter(|(size, cost)| *size > 0.0 && *cost > 0.0).collect()
    }
}
