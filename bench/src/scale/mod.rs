//! What models of rising size cost: `trex bench scale`.
//!
//! ```text
//! model -> trex build          time, memory, bytes; a page file is taken as it is
//!       -> trex render         a small picture of direct light, from the start of the process to the file: the start
//!       -> trex stress         views that jump from outside to inside and back, in the limit of views
//!       -> trex bench rays     rays a second, all pages in memory where the limit has room
//! all models -> cost ~ triangles ^ exponent
//! ```
//!
//! Each is a process of its own and a command that a user can type.
//!
//! Invariants: 1. one page file that was built here lies in the folder at a time; 2. a model that the limit refuses is
//! told, and the others are measured.

mod exponent;
mod figures;

pub use crate::campaign::Around;
use crate::campaign::{Campaign, Input, refusal};
use crate::median::median;
pub use exponent::Exponent;
pub use figures::{MEASURES, Measure, ModelCost, ScaleFigures, ScalePoint};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::fs;
use std::path::PathBuf;
use trex_store::{Code, Error};

/// Rounds of the rays of a model.
const RAY_ROUNDS: u32 = 3;
/// Width and height of the picture of the start, pixels.
const START_RESOLUTION: &str = "64x64";

/// What is measured.
#[derive(Clone, Debug)]
pub struct ScaleOptions {
    /// The command, which is run for each step.
    pub program: PathBuf,
    /// Page files, or what is built first: mesh files and generators' names.
    pub models: Vec<String>,
    /// The folder of what is built and measured; a run that was stopped goes on in it.
    pub folder: PathBuf,
    /// Width and height of the views that jump, pixels.
    pub resolution: [u32; 2],
    /// Views that jump, a model.
    pub switches: u32,
    /// Memory limit of the views that jump and of the start, bytes.
    pub views_limit_bytes: u64,
    /// Runs of each build and each start; times are their medians.
    pub rounds: usize,
}

/// What a folder is of.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct ScaleSubject {
    version: String,
    resolution: [u32; 2],
    switches: u32,
    views_limit_bytes: u64,
    memory_limit_bytes: u64,
    rounds: usize,
}

/// Measures what has not been measured yet. More models may be named than the last time.
///
/// # Errors
/// Those of the command and of the folder; a model that is not there; [`Code::InputMismatch`] for a folder of other
/// options.
pub fn run(options: &ScaleOptions, around: &Around<'_>) -> anyhow::Result<ScaleFigures> {
    let memory_limit_bytes = around.left_bytes();
    let inputs: Vec<Input> =
        options.models.iter().map(|name| Input::named(name)).collect::<Result<_, _>>()?;
    let subject = ScaleSubject {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        resolution: options.resolution,
        switches: options.switches,
        views_limit_bytes: options.views_limit_bytes,
        memory_limit_bytes,
        rounds: options.rounds,
    };
    let mut campaign = Campaign::open(&options.program, &options.folder, &subject, around.interrupt)?;
    let mut points = Vec::new();
    for (done, input) in (0..).zip(&inputs) {
        (around.tell)(done, inputs.len() as u64);
        let model = ScaleModel { input, options, memory_limit_bytes };
        let cost: Result<ModelCost, String> =
            campaign.once(&serde_json::to_string(input)?, |campaign| match model.measure(campaign) {
                Ok(cost) => Ok(Ok(cost)),
                Err(error) => match error.downcast_ref::<Error>().map(|error| (error.code(), error.what())) {
                    Some((Code::MemoryLimit, what)) => Ok(Err(what.to_owned())),
                    _ => Err(error),
                },
            })?;
        points.push(ScalePoint {
            model: input.name.clone(),
            refused: cost.as_ref().err().cloned(),
            cost: cost.ok(),
        });
    }
    let figures = ScaleFigures::new(points, options);
    figures.plot(&options.folder)?;
    Ok(figures)
}

/// A model while it is measured.
struct ScaleModel<'a> {
    input: &'a Input,
    options: &'a ScaleOptions,
    memory_limit_bytes: u64,
}

/// What the runs of a command came to.
struct Runs {
    /// From the start of the process to its end, the median, milliseconds.
    ms: f64,
    /// The most memory of all, as the kernel counted it.
    peak_rss_bytes: u64,
}

impl ScaleModel<'_> {
    fn measure(&self, campaign: &Campaign<'_>) -> anyhow::Result<ModelCost> {
        if !self.input.is_mesh() {
            return self.measure_file(&self.input.name, None, campaign);
        }
        let path = campaign.folder.join("model.trex");
        let file = path.display().to_string();
        let cost =
            self.build(&file, campaign).and_then(|build| self.measure_file(&file, Some(build), campaign));
        match fs::remove_file(&path) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(Error::io("remove", &path, &error).into())
            }
            _ => cost,
        }
    }

    fn build(&self, file: &str, campaign: &Campaign<'_>) -> anyhow::Result<Runs> {
        let (limit, render_limit) = (bytes(self.memory_limit_bytes), bytes(self.options.views_limit_bytes));
        let words = ["build", &self.input.name, "-o", file, "--overwrite"];
        let limits = ["--memory-limit", &limit, "--render-limit", &render_limit];
        self.rounds(campaign, &[&words[..], &limits].concat())
    }

    fn measure_file(
        &self,
        file: &str,
        build: Option<Runs>,
        campaign: &Campaign<'_>,
    ) -> anyhow::Result<ModelCost> {
        let info = told(campaign.trex(&owned(&["info", file]))?.document)?;
        let views_limit = bytes(self.options.views_limit_bytes);
        let picture = campaign.folder.join("start.png").display().to_string();
        let words = ["render", file, "-o", &picture, "--overwrite", "--memory-limit", &views_limit];
        let direct = "--integrator direct --spp 1 --n-shadow 1 --filter off --resolution";
        let direct: Vec<&str> = direct.split(' ').chain([START_RESOLUTION]).collect();
        let start = self.rounds(campaign, &[&words[..], &direct].concat())?;

        let [width, height] = self.options.resolution;
        let (resolution, switches) = (format!("{width}x{height}"), self.options.switches.to_string());
        let words = ["stress", file, "--scenario", "inside", "--switches", &switches];
        let limits = ["--resolution", &resolution, "--memory-limit", &views_limit];
        let stress = told(campaign.trex(&owned(&[&words[..], &limits].concat()))?.document)?;

        let (limit, rounds) = (bytes(self.memory_limit_bytes), RAY_ROUNDS.to_string());
        let words = ["bench", "rays", file, "--rounds", &rounds, "--memory-limit", &limit];
        let rays = told(campaign.trex(&owned(&words))?.document)?;
        let time = |key: &str, percentile: &str| stress[key][percentile].as_f64();
        let rate = |kind: &str| number(&rays[kind]["per_s"]);
        Ok(ModelCost {
            triangle_count: whole(&info["triangle_count"])?,
            file_bytes: whole(&info["file_bytes"])?,
            build_ms: build.as_ref().map(|build| build.ms),
            build_peak_rss_bytes: build.map(|build| build.peak_rss_bytes),
            start_ms: start.ms,
            start_peak_rss_bytes: start.peak_rss_bytes,
            whole_p50_ms: time("whole_ms", "p50"),
            whole_p99_ms: time("whole_ms", "p99"),
            complete_p50_ms: time("complete_ms", "p50"),
            complete_p99_ms: time("complete_ms", "p99"),
            pages_read: whole(&stress["pool"]["pages_read"])?,
            evictions: whole(&stress["pool"]["evictions"])?,
            views_peak_rss_bytes: whole(&stress["memory"]["peak_rss_bytes"])?,
            are_pages_resident: rays["pages"] == "resident",
            primary_per_s: rate("primary")?,
            shadow_per_s: rate("shadow")?,
            incoherent_per_s: rate("incoherent")?,
        })
    }

    /// Runs a command as often as is asked for.
    fn rounds(&self, campaign: &Campaign<'_>, words: &[&str]) -> anyhow::Result<Runs> {
        let (mut walls, mut peak_rss_bytes) = (Vec::new(), 0);
        for _ in 0..self.options.rounds {
            let ran = campaign.trex(&owned(words))?;
            walls.push(ran.wall.as_secs_f64() * 1e3);
            peak_rss_bytes = peak_rss_bytes.max(whole(&told(ran.document)?["memory"]["peak_rss_bytes"])?);
        }
        Ok(Runs { ms: median(&walls), peak_rss_bytes })
    }
}

/// The document, unless it is a refusal.
fn told(document: Value) -> anyhow::Result<Value> {
    refusal(&document).map_or(Ok(document), |refusal| Err(refusal.into()))
}

fn number(value: &Value) -> anyhow::Result<f64> {
    Ok(value.as_f64().ok_or_else(|| Error::new(Code::Bug, "a document has no number where one is due"))?)
}

fn whole(value: &Value) -> anyhow::Result<u64> {
    Ok(value.as_u64().ok_or_else(|| Error::new(Code::Bug, "a document has no count where one is due"))?)
}

fn bytes(bytes: u64) -> String {
    format!("{bytes}B")
}

fn owned(words: &[&str]) -> Vec<String> {
    words.iter().map(|word| (*word).to_owned()).collect()
}
