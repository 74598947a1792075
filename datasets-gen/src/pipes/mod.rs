//! `pipes`: a CAD-like plant with an interior, from walls of hundreds of metres to bolts of some millimetres.
//!
//! Invariants: 1. the count is known exactly before the stream, part by part; 2. the first `finer_parts` parts
//! of the stream have one more step of detail than the others: that is how the count is met; 3. positions are
//! exact in f32.

mod palette;
mod parts;
mod plant;

use crate::pool::Pool;
use crate::stream::{Label, Recipe, Stream};
use crate::{GenOptions, Spec, View};
use parts::{MAX_DETAIL, Part};
use plant::Plant;
use std::sync::Arc;
use trex_store::{AttributeSet, Code, Error, Result, ScanHint, TriangleBatch, TriangleSource};

/// Triangles of the smallest plant at the coarsest detail, roughly.
const TRIANGLES_PER_BAY: f64 = 10_000.0;
/// Bays grow with this power of the count; detail takes the rest.
const BAY_POWER: f64 = 0.8;
/// A task is closed at this many triangles.
const TASK_TRIANGLES: u64 = 6_000;
/// Triangles looked at for the median edge, at least, where there are as many.
const SAMPLE_TRIANGLES: u64 = 200_000;
/// The hint must not exceed the median; a sample's median may by some percent.
const MEDIAN_SAFETY: f64 = 0.85;

/// A plant with its detail chosen.
struct Pipes {
    plant: Plant,
    detail: u32,
    finer_parts: u64,
    triangle_count: u64,
    part_count: u64,
}

/// The stream of `spec`.
pub(crate) fn open(spec: &Spec, options: &GenOptions) -> Result<Box<dyn TriangleSource>> {
    let pipes = Pipes::new(spec)?;
    let hint = pipes.hint();
    let label = Label { name: spec.to_string(), hint, materials: palette::materials() };
    let stream = Stream::new(pipes, label, Pool::new(spec, options.threads)?, options)?;
    Ok(Box::new(stream))
}

/// From a corner below the roof, and from an aisle.
pub(crate) fn views(spec: &Spec) -> Vec<View> {
    let plant = plant_of(spec);
    let ([w, d], h) = (plant.floor(), plant.height());
    let up = [0.0, 0.0, 1.0];
    let aisle = (plant.bays[1] / 2) as f64 * plant::BAY + 1.4;
    let across = (plant.bays[0] / 2) as f64 * plant::BAY;
    // A small plant fits into no view from within: step back through the open side.
    let back = if plant.bays[0] < 4 { -1.2 * w.max(d) } else { 1.0 };
    vec![
        View {
            name: "overview",
            position: [0.5 * w / plant.bays[0].min(40) as f64, back, 0.8 * h],
            target: [0.55 * w, 0.6 * d, 0.0],
            up,
            fov_x_deg: 75.0,
        },
        View {
            name: "interior",
            position: [across + 0.8, aisle, 0.6 * plant::AISLE_HEIGHT],
            target: [across + 9.0, aisle + 5.5, 2.6],
            up,
            fov_x_deg: 80.0,
        },
    ]
}

/// The plant, before its detail.
fn plant_of(spec: &Spec) -> Plant {
    let bays = (spec.triangles as f64 / TRIANGLES_PER_BAY).powf(BAY_POWER).max(1.0);
    let columns = (1.5 * bays).sqrt().round().max(1.0);
    let rows = (bays / columns).round().max(1.0);
    Plant { seed: spec.seed, bays: [columns as u64, rows as u64] }
}

impl Pipes {
    /// Finds the detail between whose counts the asked one lies, and how many parts get one step more.
    fn new(spec: &Spec) -> Result<Pipes> {
        let mut plant = plant_of(spec);
        let mut counts = DetailCounts::new(&plant);
        // Bays differ by seed: a plant that is too rich for the count loses a row or a column.
        while counts.at[0] > spec.triangles && plant.bays[0] * plant.bays[1] > 1 {
            let longer = usize::from(plant.bays[1] > plant.bays[0]);
            plant.bays[longer] -= 1;
            counts = DetailCounts::new(&plant);
        }
        let fits = (0..MAX_DETAIL as usize).rev().find(|&detail| counts.at[detail] <= spec.triangles);
        let detail = fits.unwrap_or(0) as u32;
        let mut pipes = Pipes {
            plant,
            detail,
            finer_parts: 0,
            triangle_count: counts.at[detail as usize],
            part_count: counts.parts,
        };
        pipes.refine_until(spec.triangles);
        let off = pipes.triangle_count.abs_diff(spec.triangles);
        if off * 100 > spec.triangles {
            return Err(Error::new(Code::Usage, "no plant has this many triangles")
                .at_place(spec.to_string())
                .numbers(format!("{} asked, {} is the nearest", spec.triangles, pipes.triangle_count))
                .next("ask for that count, or use another seed"));
        }
        Ok(pipes)
    }

    /// Gives one more step of detail to parts in order while the count stays at most `asked`.
    fn refine_until(&mut self, asked: u64) {
        let mut parts = Vec::new();
        for group in 0..self.plant.group_count() {
            self.plant.group(group, &mut parts);
            for part in &parts {
                let more = part.count(self.detail + 1) - part.count(self.detail);
                if self.triangle_count + more > asked {
                    return;
                }
                self.triangle_count += more;
                self.finer_parts += 1;
            }
        }
    }

    fn hint(&self) -> ScanHint {
        ScanHint {
            bounds: self.plant.bounds(),
            median_edge: MEDIAN_SAFETY * self.sample_median_edge(),
            triangle_count: self.triangle_count,
            attributes: AttributeSet::default(),
        }
    }

    /// Median edge over every n-th part.
    fn sample_median_edge(&self) -> f64 {
        let stride =
            (self.triangle_count / SAMPLE_TRIANGLES).clamp(1, (self.part_count / 300).max(1)) as usize;
        let mut batch = TriangleBatch::default();
        for (detail, part) in Walk::new(&self.plant, self).step_by(stride) {
            part.tessellate(detail, &mut batch);
        }
        crate::median_edge(&batch.corners)
    }
}

/// Triangles of a plant at each detail, and its parts.
struct DetailCounts {
    at: [u64; MAX_DETAIL as usize + 1],
    parts: u64,
}

impl DetailCounts {
    fn new(plant: &Plant) -> DetailCounts {
        let mut counts = DetailCounts { at: [0; MAX_DETAIL as usize + 1], parts: 0 };
        let mut parts = Vec::new();
        for group in 0..plant.group_count() {
            plant.group(group, &mut parts);
            counts.parts += parts.len() as u64;
            for part in &parts {
                for (detail, sum) in counts.at.iter_mut().enumerate() {
                    *sum += part.count(detail as u32);
                }
            }
        }
        counts
    }
}

/// All parts with their detail, in the order of the stream.
struct Walk<P: std::borrow::Borrow<Plant>> {
    plant: P,
    detail: u32,
    finer_left: u64,
    next_group: u64,
    parts: std::vec::IntoIter<Part>,
}

impl<P: std::borrow::Borrow<Plant>> Walk<P> {
    fn new(plant: P, pipes: &Pipes) -> Walk<P> {
        let parts = Vec::new().into_iter();
        Walk { plant, detail: pipes.detail, finer_left: pipes.finer_parts, next_group: 0, parts }
    }
}

impl<P: std::borrow::Borrow<Plant>> Iterator for Walk<P> {
    type Item = (u32, Part);

    fn next(&mut self) -> Option<(u32, Part)> {
        loop {
            if let Some(part) = self.parts.next() {
                let finer = self.finer_left > 0;
                self.finer_left -= u64::from(finer);
                return Some((self.detail + u32::from(finer), part));
            }
            if self.next_group == self.plant.borrow().group_count() {
                return None;
            }
            let mut parts = Vec::new();
            self.plant.borrow().group(self.next_group, &mut parts);
            self.next_group += 1;
            self.parts = parts.into_iter();
        }
    }
}

impl Recipe for Pipes {
    type Task = Vec<(u32, Part)>;
    type Scratch = ();

    fn tasks(self: Arc<Self>) -> Box<dyn Iterator<Item = Self::Task> + Send> {
        let mut walk = Walk::new(self.plant.clone(), &self);
        Box::new(std::iter::from_fn(move || {
            let mut task = Vec::new();
            let mut sum = 0;
            while sum < TASK_TRIANGLES {
                let Some((detail, part)) = walk.next() else { break };
                sum += part.count(detail);
                task.push((detail, part));
            }
            (!task.is_empty()).then_some(task)
        }))
    }

    fn make(&self, task: Self::Task, (): &mut (), out: &mut TriangleBatch) {
        for (detail, part) in task {
            part.tessellate(detail, out);
        }
    }
}

/// A task holds one part more than its limit at most.
const _: () = assert!(TASK_TRIANGLES + Part::MAX_TRIANGLES <= crate::stream::MAX_CHUNK_TRIANGLES as u64);
