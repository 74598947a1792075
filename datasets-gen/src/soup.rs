//! `soup`: what breaks a mesh program. Slivers, needles, duplicates, degenerates, tiny next to huge, a million
//! units from the origin.
//!
//! Of each 100 triangles in a row, by place: 0 to 39 slivers, 40 to 59 needles, 60 to 69 exact duplicates of
//! the triangle before, 70 and 71 degenerate (two equal corners, three equal corners), 72 to 85 tiny (edges
//! near 1e-4), 86 to 99 huge (edges near 1e4).
//!
//! Invariants: 1. the count is what was asked; 2. exactly [`degenerate_count`] triangles have two equal
//! corners; 3. every coordinate is finite, near 1e6 in magnitude, and needs f64.

use crate::dice::Dice;
use crate::pool::Pool;
use crate::stream::{Label, MAX_CHUNK_TRIANGLES, Recipe, Stream};
use crate::{GenOptions, Spec, View, median_edge};
use glam::DVec3;
use std::sync::Arc;
use trex_store::{Aabb, AttributeSet, Material, Result, ScanHint, TriangleBatch, TriangleSource};

/// Triangles of a cycle.
const CYCLE: u64 = 100;
/// Places of the degenerate triangles in a cycle.
const DEGENERATE: [u64; 2] = [70, 71];
/// Triangles of a task: whole cycles, so that a duplicate's original is in the same task.
const CHUNK: u64 = 8_000;
const _: () = assert!(CHUNK.is_multiple_of(CYCLE) && CHUNK <= MAX_CHUNK_TRIANGLES as u64);
/// Where the soup is.
const CENTER: [f64; 3] = [1.0e6, -1.0e6, 1.0e6];
/// Triangles start within this distance of the center, per axis.
const HALF_EXTENT: f64 = 2.0e4;
/// Longest edge, along an axis.
const LONGEST: f64 = 1.2e4;
/// The hint must not exceed the median; a sample's median may by some percent.
const MEDIAN_SAFETY: f64 = 0.85;

/// Count of triangles with two or three equal corners among the first `triangles` of a soup.
pub fn degenerate_count(triangles: u64) -> u64 {
    let rest = triangles % CYCLE;
    let in_rest = DEGENERATE.iter().filter(|&&place| place < rest).count() as u64;
    triangles / CYCLE * DEGENERATE.len() as u64 + in_rest
}

struct Soup {
    seed: u64,
    triangles: u64,
}

/// The stream of `spec`.
pub(crate) fn open(spec: &Spec, options: &GenOptions) -> Result<Box<dyn TriangleSource>> {
    let soup = Soup { seed: spec.seed, triangles: spec.triangles };
    let mut sample = TriangleBatch::default();
    soup.make(0, &mut (), &mut sample);
    let reach = HALF_EXTENT + LONGEST;
    let hint = ScanHint {
        bounds: Aabb { lo: CENTER.map(|c| c - reach), hi: CENTER.map(|c| c + reach) },
        median_edge: MEDIAN_SAFETY * median_edge(&sample.corners),
        triangle_count: spec.triangles,
        attributes: AttributeSet::default(),
    };
    let materials = [[0.7, 0.3, 0.2], [0.2, 0.5, 0.7], [0.6, 0.6, 0.3], [0.5; 3]]
        .iter()
        .enumerate()
        .map(|(index, &kd)| (format!("soup-{index}"), Material { kd, ..Material::default() }))
        .collect();
    let label = Label { name: spec.to_string(), hint, materials };
    Ok(Box::new(Stream::new(soup, label, Pool::new(spec, options.threads)?, options)?))
}

/// The cloud of triangles from outside.
pub(crate) fn views() -> Vec<View> {
    let [x, y, z] = CENTER;
    let position = [x - 4.0e4, y - 5.0e4, z + 3.0e4];
    vec![View { name: "overview", position, target: CENTER, up: [0.0, 0.0, 1.0], fov_x_deg: 60.0 }]
}

impl Soup {
    /// The triangle at `place` of a cycle.
    fn triangle(place: u64, dice: &mut Dice, last: [[f64; 3]; 3]) -> [[f64; 3]; 3] {
        let mut around = |reach: f64| DVec3::from_array([0; 3].map(|_| dice.range(-reach, reach)));
        let start = DVec3::from(CENTER) + around(HALF_EXTENT);
        // From the start, an edge near `length` and a corner that lies `off` beside it at `part` of its way.
        let mut corners = |length: f64, part: f64, off: f64| {
            let (edge, aside) = (around(length), around(off));
            [start, start + edge, start + part * edge + aside].map(|corner| corner.to_array())
        };
        match place {
            0..40 => corners(10.0, 0.5, 0.01),
            40..60 => corners(100.0, 1.0, 0.05),
            60..70 => last,
            70 => corners(10.0, 1.0, 0.0),
            71 => [start.to_array(); 3],
            72..86 => corners(1.0e-4, 0.3, 1.0e-4),
            _ => corners(0.6 * LONGEST, 0.4, 0.6 * LONGEST),
        }
    }
}

impl Recipe for Soup {
    type Task = u64;
    type Scratch = ();

    fn tasks(self: Arc<Self>) -> Box<dyn Iterator<Item = u64> + Send> {
        Box::new(0..self.triangles.div_ceil(CHUNK))
    }

    fn make(&self, chunk: u64, (): &mut (), out: &mut TriangleBatch) {
        let mut dice = Dice::new(self.seed, chunk);
        let mut last = [[0.0; 3]; 3];
        for index in chunk * CHUNK..((chunk + 1) * CHUNK).min(self.triangles) {
            let place = index % CYCLE;
            last = Soup::triangle(place, &mut dice, last);
            out.push(last, (dice.bits() & 3) as u32);
        }
    }
}
