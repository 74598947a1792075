//! `scan`: a dense closed statue on its plinth, in regular triangles, like a scanned sculpture.
//!
//! ```text
//!   profile (height, radius) turned around a swaying spine, shaped by angle (plinth, folds, arms, face),
//!   displaced by octaves of noise: n sectors x (m - 1) rings of quads + 2 caps = 2 n (m - 1) triangles
//! ```
//!
//! Invariants: 1. closed and orientable: each edge belongs to two triangles, in opposite directions; 2. each
//! horizontal section of a ring is star-shaped about the spine, so the surface does not leak; 3. positions are
//! exact in f32; 4. the count is exact.

use crate::dice::{Dice, mix};
use crate::pool::Pool;
use crate::stream::{Label, MAX_CHUNK_TRIANGLES, Recipe, Stream};
use crate::{GenOptions, Spec, View, median_edge};
use fastnoise_lite::{FastNoiseLite, FractalType, NoiseType};
use glam::DVec2;
use std::f64::consts::TAU;
use std::sync::Arc;
use trex_store::{
    Aabb, AttributeSet, Material, MaterialList, Result, ScanHint, TriangleBatch, TriangleSource,
};

/// Height and radius, metres, from the middle of the bottom to the crown.
const PROFILE: [[f64; 2]; 22] = [
    [0.00, 0.00],
    [0.00, 0.80],
    [0.02, 0.84],
    [0.48, 0.84],
    [0.52, 0.80],
    [0.56, 0.58],
    [0.60, 0.55],
    [0.66, 0.62],
    [1.20, 0.58],
    [1.80, 0.52],
    [2.40, 0.43],
    [2.60, 0.42],
    [3.10, 0.54],
    [3.40, 0.58],
    [3.60, 0.50],
    [3.72, 0.24],
    [3.88, 0.17],
    [4.02, 0.25],
    [4.25, 0.32],
    [4.50, 0.32],
    [4.74, 0.22],
    [4.84, 0.00],
];
/// Rounds of corner cutting that smooth the profile.
const PROFILE_ROUNDS: u32 = 3;
/// Length of a ring over length of the profile, in the mean: makes the triangles regular.
const SECTORS_PER_RING: f64 = 0.48;
/// A task is a tile of this many quads a side.
const TILE: u64 = 64;
const _: () = assert!(2 * TILE * TILE <= MAX_CHUNK_TRIANGLES as u64);
/// Tiles looked at for the median edge.
const SAMPLE_TILES: u64 = 48;
/// The hint must not exceed the median; a sample's median may by some percent.
const MEDIAN_SAFETY: f64 = 0.85;
/// Top of the plinth: what lies below has a material of its own.
const PLINTH_TOP: f64 = 0.56;

/// The statue.
struct Scan {
    sectors: u64,
    /// Steps along the profile; rings `0` and `steps` are points.
    steps: u64,
    /// `[length so far, height, radius]`.
    profile: Vec<[f64; 3]>,
    fold_phase: [f64; 3],
    skin: FastNoiseLite,
}

/// The stream of `spec`.
pub(crate) fn open(spec: &Spec, options: &GenOptions) -> Result<Box<dyn TriangleSource>> {
    let scan = Scan::new(spec);
    let hint = ScanHint {
        bounds: Aabb { lo: [-1.6, -1.6, -0.2], hi: [1.6, 1.6, 5.2] },
        median_edge: MEDIAN_SAFETY * scan.sample_median_edge(),
        triangle_count: scan.triangle_count(),
        attributes: AttributeSet::default(),
    };
    let material = |kd, ks| Material { kd, ks: [ks; 3], ns: 40.0, ..Material::default() };
    let materials = MaterialList::from_iter([
        ("marble", material([0.74, 0.71, 0.65], 0.06)),
        ("plinth", material([0.36, 0.35, 0.37], 0.02)),
    ]);
    let label = Label { name: spec.to_string(), hint, materials };
    Ok(Box::new(Stream::new(scan, label, Pool::new(spec, options.threads)?, options)?))
}

/// The whole statue, and its head.
pub(crate) fn views() -> Vec<View> {
    let up = [0.0, 0.0, 1.0];
    vec![
        View { name: "overview", position: [3.2, -7.2, 3.6], target: [0.0, 0.0, 2.35], up, fov_x_deg: 56.0 },
        View { name: "close", position: [0.9, -1.9, 4.5], target: [0.0, 0.0, 4.1], up, fov_x_deg: 50.0 },
    ]
}

impl Scan {
    fn new(spec: &Spec) -> Scan {
        let sectors = (SECTORS_PER_RING * spec.triangles as f64 / 2.0).sqrt().round() as u64;
        let steps = (spec.triangles as f64 / (2 * sectors) as f64).round() as u64 + 1;
        let mut dice = Dice::new(spec.seed, 0);
        let mut skin = FastNoiseLite::with_seed(mix(spec.seed) as i32);
        skin.set_noise_type(Some(NoiseType::Perlin));
        skin.set_fractal_type(Some(FractalType::FBm));
        skin.set_fractal_octaves(Some(6));
        skin.set_fractal_gain(Some(0.48));
        skin.set_frequency(Some(2.3));
        let fold_phase = [0; 3].map(|_| dice.range(0.0, TAU));
        Scan { sectors, steps, profile: smooth_profile(), fold_phase, skin }
    }

    fn triangle_count(&self) -> u64 {
        2 * self.sectors * (self.steps - 1)
    }

    fn tile_counts(&self) -> [u64; 2] {
        [self.sectors.div_ceil(TILE), self.steps.div_ceil(TILE)]
    }

    /// Height and radius of ring `step`.
    fn ring(&self, step: u64) -> [f64; 2] {
        let length = self.profile[self.profile.len() - 1][0];
        let at = length * step as f64 / self.steps as f64;
        let next = self.profile.partition_point(|point| point[0] <= at).clamp(1, self.profile.len() - 1);
        let [from, to] = [self.profile[next - 1], self.profile[next]];
        let part = ((at - from[0]) / (to[0] - from[0])).clamp(0.0, 1.0);
        // The ends are points whatever the rounding says.
        let radius = if step == 0 || step == self.steps { 0.0 } else { from[2] + (to[2] - from[2]) * part };
        [from[1] + (to[1] - from[1]) * part, radius]
    }

    /// The vertex at angle `[cos, sin]` and `theta` of a ring; exact in f32.
    fn vertex(&self, [height, radius]: [f64; 2], theta: f64, [cos, sin]: [f64; 2]) -> [f64; 3] {
        let statue = smooth(0.5, 0.7, height);
        let (robe, head) = (statue * (1.0 - smooth(3.3, 3.7, height)), smooth(3.9, 4.05, height));
        // A rounded square below, the figure above.
        let square = 1.0 / (cos.powi(8) + sin.powi(8)).powf(0.125);
        let sway = self.fold_phase[1] + 1.9 * (1.3 * height + self.fold_phase[2]).sin();
        let folds =
            (9.0 * theta + sway + 1.2 * (2.0 * theta).sin()).cos() + 0.5 * (17.0 * theta - 2.0 * sway).cos();
        let near = |angle: f64, width: f64| {
            let away = (theta - angle + TAU * 1.5).rem_euclid(TAU) - TAU / 2.0;
            (-(away / width).powi(2)).exp()
        };
        let at_height = |center: f64, width: f64| (-((height - center) / width).powi(2)).exp();
        let front = 0.75 * TAU;
        let arms =
            (near(0.0, 0.30) + near(0.5 * TAU, 0.30)) * (at_height(3.0, 0.35) + 0.8 * at_height(2.4, 0.3));
        let nose = near(front, 0.16) * at_height(4.27, 0.06);
        let eyes = (near(front - 0.36, 0.14) + near(front + 0.36, 0.14)) * at_height(4.37, 0.035);
        let mouth = near(front, 0.3) * at_height(4.13, 0.018);
        let shape = (1.0 - statue) * square + statue;
        let grown = radius * shape * (1.0 + 0.075 * robe * folds)
            + robe * 0.17 * arms * (radius / 0.4).min(1.0)
            + head * (0.085 * nose - 0.03 * eyes - 0.02 * mouth) * (radius / 0.2).min(1.0);
        let deep = 1.0 - 0.30 * robe * smooth(1.5, 3.0, height);
        let base = [grown * cos, grown * sin * deep, height];
        let [nx, ny, nz] = base.map(|value| value as f32);
        let rough = f64::from(self.skin.get_noise_3d(nx, ny, nz)) * (0.035 + 0.03 * statue * (1.0 - head));
        let bumped = 1.0 + rough * (radius / 0.1).min(1.0) / grown.max(0.1);
        let lean = 0.10 * statue * (1.25 * height + self.fold_phase[0]).sin();
        [base[0] * bumped + lean, base[1] * bumped, height].map(|value| f64::from(value as f32))
    }

    /// Appends the triangles of a tile of quads.
    fn tile(&self, [column, row]: [u64; 2], grid: &mut Vec<[f64; 3]>, out: &mut TriangleBatch) {
        let (s0, s1) = (column * TILE, ((column + 1) * TILE).min(self.sectors));
        let (r0, r1) = (row * TILE, ((row + 1) * TILE).min(self.steps));
        let angles: Vec<(f64, [f64; 2])> = (s0..=s1)
            .map(|sector| TAU * (sector % self.sectors) as f64 / self.sectors as f64)
            .map(|theta| (theta, [theta.cos(), theta.sin()]))
            .collect();
        grid.clear();
        for step in r0..=r1 {
            let ring = self.ring(step);
            grid.extend(angles.iter().map(|&(theta, direction)| self.vertex(ring, theta, direction)));
        }
        for step in r0..r1 {
            let material = u32::from(self.ring(step)[0] < PLINTH_TOP);
            for sector in s0..s1 {
                let at = |step: u64, sector: u64| grid[((step - r0) * (s1 - s0 + 1) + sector - s0) as usize];
                let [a, b] = [at(step, sector), at(step, sector + 1)];
                let [d, c] = [at(step + 1, sector), at(step + 1, sector + 1)];
                // At the ends one side of the quad is a point.
                if step > 0 {
                    out.push([a, b, c], material);
                }
                if step + 1 < self.steps {
                    out.push([a, c, d], material);
                }
            }
        }
    }

    fn sample_median_edge(&self) -> f64 {
        let [columns, rows] = self.tile_counts();
        let stride = (columns * rows / SAMPLE_TILES).max(1) as usize;
        let mut batch = TriangleBatch::default();
        for index in (0..columns * rows).step_by(stride) {
            self.tile([index % columns, index / columns], &mut Vec::new(), &mut batch);
        }
        median_edge(&batch.corners)
    }
}

impl Recipe for Scan {
    type Task = [u64; 2];
    type Scratch = Vec<[f64; 3]>;

    fn tasks(self: Arc<Self>) -> Box<dyn Iterator<Item = [u64; 2]> + Send> {
        let [columns, rows] = self.tile_counts();
        Box::new((0..columns * rows).map(move |index| {
            // Back and forth, so that neighbours in the stream are neighbours in space.
            let (row, along) = (index / columns, index % columns);
            [if row % 2 == 0 { along } else { columns - 1 - along }, row]
        }))
    }

    fn make(&self, tile: [u64; 2], grid: &mut Vec<[f64; 3]>, out: &mut TriangleBatch) {
        self.tile(tile, grid, out);
    }
}

/// The profile with its corners cut (Chaikin), and its length.
fn smooth_profile() -> Vec<[f64; 3]> {
    let mut points: Vec<DVec2> = PROFILE.map(DVec2::from).to_vec();
    for _ in 0..PROFILE_ROUNDS {
        let mut next = vec![points[0]];
        for pair in points.windows(2) {
            // Not `lerp`, which weighs both ends and rounds otherwise.
            next.extend([0.25, 0.75].map(|part| pair[0] + part * (pair[1] - pair[0])));
        }
        next.push(points[points.len() - 1]);
        points = next;
    }
    let mut length = 0.0;
    let mut last = points[0];
    points
        .into_iter()
        .map(|point| {
            length += point.distance(last);
            last = point;
            [length, point.x, point.y]
        })
        .collect()
}

/// 0 below `lo`, 1 above `hi`, smooth between.
fn smooth(lo: f64, hi: f64, value: f64) -> f64 {
    let part = ((value - lo) / (hi - lo)).clamp(0.0, 1.0);
    part * part * (3.0 - 2.0 * part)
}
