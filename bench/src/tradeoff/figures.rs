//! What a campaign came to: its points, which of them are on a front, and the plots.

use super::regions::RegionError;
use super::{front, knobs};
use crate::plot::{self, Line};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use trex_store::Error;

const MIB: u64 = 1 << 20;
/// Ways through several knobs, which the plot of time has lines for.
const TIME_LINES: [&str; 5] = ["quality", "photon", "full-gi", "path", "time"];
/// What `normal` is without a part, by the part: a knob and the value that turns it off, with as many samples as
/// `normal` has.
const PARTS: [(&str, &str, &str); 7] = [
    ("bitmaps", "occluders", "off"),
    ("contacts", "near", "voxel"),
    ("shadows_on_the_mesh", "shadows", "voxel"),
    ("filter", "filter", "off"),
    ("gathered_light", "n-gather", "0"),
    ("light_in_voxels", "full-gi", "16"),
    ("octree", "no-asvo", "plain"),
];
/// What memory goes by.
const MEMORY_LINES: [&str; 4] = ["quality", "memory", "upper", "finest"];

/// What came of it.
#[derive(Debug, Serialize)]
pub struct TradeoffFigures {
    /// The model or scene.
    pub scene: String,
    /// Width and height, pixels.
    pub resolution: [u32; 2],
    /// Samples of each of the two references.
    pub reference_spp: u32,
    /// The relMSE that the noise of their mean comes to.
    pub reference_relmse: f64,
    /// Runs of each point.
    pub round_count: usize,
    /// All of them, in the order of the sweep.
    pub points: Vec<PointFigures>,
    /// All of them that have a picture, in short, by their settings.
    pub settings: BTreeMap<String, Summary>,
    /// The qualities, by name.
    pub qualities: BTreeMap<String, Summary>,
    /// What `normal` is without each of its parts, where these knobs were turned.
    pub without: BTreeMap<&'static str, Without>,
    /// What no point beats in time and error, by its time in whole milliseconds.
    pub front: BTreeMap<u64, Summary>,
    /// Knobs that turn the build, of a model that is not built here.
    pub left_out: Vec<&'static str>,
}

/// A picture in short.
#[derive(Clone, Debug, Serialize)]
pub struct Summary {
    /// The knob and what it is turned to, joined by dashes: `n-gather-8`, `photon-spp-32-photons-4M-near-exact`.
    pub setting: String,
    /// From the start of the process to its end, milliseconds.
    pub picture_ms: f64,
    /// relMSE of the whole picture.
    pub relmse: f64,
    /// relMSE of each hard part that has pixels.
    pub parts_relmse: BTreeMap<String, f64>,
    /// PSNR of the whole picture for a peak of 1; `None` without an error.
    pub psnr_db: Option<f64>,
    /// FLIP of the whole picture.
    pub flip: Option<f64>,
    /// FLIP of each hard part that has pixels.
    pub parts_flip: BTreeMap<String, f64>,
    /// What the kernel counted, bytes.
    pub peak_rss_bytes: u64,
    /// Its relMSE over the least that is had in its time.
    pub front_distance: Option<f64>,
}

/// A picture of `normal` without a part, beside that with it.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Without {
    /// Its time over that of `normal`.
    pub time_ratio: f64,
    /// Its relMSE over that of `normal`.
    pub relmse_ratio: f64,
}

/// A point.
#[derive(Debug, Serialize)]
pub struct PointFigures {
    /// The knob.
    pub knob: String,
    /// What it is turned to.
    pub value: String,
    /// The command that gives it again.
    pub render_command: String,
    /// Why there is no picture.
    pub refused: Option<String>,
    /// What the picture cost and how wrong it is; `None` where there is none.
    #[serde(flatten)]
    pub measured: Option<Measurement>,
    /// True when no point is as fast and less wrong.
    pub is_on_time_front: bool,
    /// True when no point takes as little memory and is less wrong.
    pub is_on_memory_front: bool,
    /// Its relMSE over the least that is had in its time.
    pub front_distance: Option<f64>,
}

/// What a picture cost, and how wrong it is.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Measurement {
    /// From the start of the process to its end, milliseconds.
    pub picture_ms: f64,
    /// Rays of all kinds, a second of rendering.
    pub rays_per_s: BTreeMap<String, f64>,
    /// What the kernel counted, bytes.
    pub peak_rss_bytes: u64,
    /// Read from the disk while rendering, bytes.
    pub bytes_read: u64,
    /// The page file, bytes.
    pub file_bytes: u64,
    /// Errors of the whole and of its hard parts.
    pub errors: BTreeMap<String, RegionError>,
}

/// Marks what is on the fronts.
pub(super) fn mark(points: &mut [PointFigures]) {
    let costs = |cost: fn(&Measurement) -> f64| {
        let cost = |(at, point): (usize, &PointFigures)| {
            let measured = point.measured.as_ref()?;
            Some((at, (cost(measured), measured.relmse()?)))
        };
        points.iter().enumerate().filter_map(cost).unzip::<_, _, Vec<usize>, Vec<(f64, f64)>>()
    };
    let (times, memory) = (costs(|m| m.picture_ms), costs(|m| m.peak_rss_bytes as f64));
    for ((at, is_on), cost) in times.0.iter().zip(front::front(&times.1)).zip(&times.1) {
        points[*at].is_on_time_front = is_on;
        points[*at].front_distance = Some(front::distance(*cost, &times.1));
    }
    for (at, is_on) in memory.0.iter().zip(front::front(&memory.1)) {
        points[*at].is_on_memory_front = is_on;
    }
}

impl Measurement {
    /// relMSE of the whole picture.
    pub fn relmse(&self) -> Option<f64> {
        self.errors["whole"].relmse
    }
}

impl PointFigures {
    fn summary(&self) -> Option<Summary> {
        let measured = self.measured.as_ref()?;
        let parts = |error: fn(&RegionError) -> Option<f64>| {
            let parts = measured.errors.iter().filter(|(name, _)| *name != "whole");
            parts.filter_map(|(name, part)| Some((name.clone(), error(part)?))).collect()
        };
        let whole = measured.errors["whole"];
        Some(Summary {
            setting: knobs::setting(&self.knob, &self.value),
            picture_ms: measured.picture_ms,
            relmse: measured.relmse()?,
            parts_relmse: parts(|part| part.relmse),
            psnr_db: whole.psnr_db,
            flip: whole.flip,
            parts_flip: parts(|part| part.flip),
            peak_rss_bytes: measured.peak_rss_bytes,
            front_distance: self.front_distance,
        })
    }
}

/// The points that have a picture, by their settings.
pub(super) fn settings(points: &[PointFigures]) -> BTreeMap<String, Summary> {
    points
        .iter()
        .filter_map(PointFigures::summary)
        .map(|summary| (summary.setting.clone(), summary))
        .collect()
}

/// Those of `points` that are named by what the knob `quality` is turned to.
pub(super) fn qualities(points: &[PointFigures]) -> BTreeMap<String, Summary> {
    let of_quality = points.iter().filter(|point| point.knob == "quality");
    of_quality.filter_map(|point| Some((point.value.clone(), point.summary()?))).collect()
}

/// What `normal` is without each part that was turned off.
pub(super) fn without(points: &[PointFigures]) -> BTreeMap<&'static str, Without> {
    let at = |knob: &str, value: &str| {
        let point = points.iter().find(|point| point.knob == knob && point.value == value)?;
        let measured = point.measured.as_ref()?;
        Some((measured.picture_ms, measured.relmse()?))
    };
    let Some((time, relmse)) = at("quality", "normal") else { return BTreeMap::new() };
    let ratio = |(part, knob, value): &(&'static str, &str, &str)| {
        let off = at(knob, value)?;
        Some((*part, Without { time_ratio: off.0 / time, relmse_ratio: off.1 / relmse }))
    };
    PARTS.iter().filter_map(ratio).collect()
}

/// Those of `points` that are on the front of time.
pub(super) fn by_time(points: &[PointFigures]) -> BTreeMap<u64, Summary> {
    let on_front = points.iter().filter(|point| point.is_on_time_front);
    on_front
        .filter_map(|point| point.summary())
        .map(|summary| (summary.picture_ms.round() as u64, summary))
        .collect()
}

impl TradeoffFigures {
    /// Writes `error-time.svg` and `error-memory.svg`.
    pub(super) fn plot(&self, folder: &Path) -> anyhow::Result<()> {
        let line = |label: &str, is_in: &dyn Fn(&PointFigures) -> bool, cost: fn(&Measurement) -> f64| {
            let point = |point: &PointFigures| {
                let measured = point.measured.as_ref().filter(|_| is_in(point))?;
                Some((cost(measured), measured.relmse().filter(|error| *error > 0.0)?))
            };
            Line::new(label, self.points.iter().filter_map(point).collect())
        };
        let time = |m: &Measurement| m.picture_ms / 1e3;
        let memory = |m: &Measurement| m.peak_rss_bytes as f64 / MIB as f64;
        let of = |names: &[&'static str], cost| {
            names.iter().map(|&name| line(name, &|point| point.knob == name, cost)).collect::<Vec<_>>()
        };
        let mut by_time = vec![line("front", &|point| point.is_on_time_front, time)];
        by_time.extend(of(&TIME_LINES, time));
        let mut by_memory = vec![line("front", &|point| point.is_on_memory_front, memory)];
        by_memory.extend(of(&MEMORY_LINES, memory));
        for (name, lines, title) in [
            ("error-time.svg", by_time, "seconds to the picture"),
            ("error-memory.svg", by_memory, "peak memory, MiB"),
        ] {
            let lines: Vec<Line> = lines.into_iter().filter(|line| !line.points.is_empty()).collect();
            if lines.is_empty() {
                continue;
            }
            let path = folder.join(name);
            fs::write(&path, plot::render(&lines, title, "relMSE")?)
                .map_err(|error| Error::writing("write", &path, &error))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tradeoff::knobs::KNOBS;

    #[test]
    fn what_turns_a_part_off_is_a_point_of_the_sweep() {
        for (part, knob, value) in PARTS {
            let knob = KNOBS.iter().find(|other| other.name == knob).expect("a knob");
            assert!(knob.points(&[]).iter().any(|point| point.value == value), "{part}: {value}");
        }
    }
}
