//! The field: a lattice of samples refined by subdivision, with fresh noise at each level.
//!
//! ```text
//!   level 0:      F0 = root field, sampled                (large bubbles and spikes, fixed in model space)
//!   level l + 1:  F(l+1) = cubic B-spline subdivision of F(l) + noise(l+1) on the new, twice finer lattice
//! ```
//!
//! A sample costs a few additions however many octaves there are, and a block with an apron of one sample is
//! all that its eight children need. Gradient noise would be evaluated per octave and sample.
//!
//! Invariants: 1. a sample depends on seed, level and global index only, computed by the same operations in
//! every block that holds it: blocks agree to the bit; 2. subdivision makes weighted means (weights >= 0, sum
//! 1), so a child lies within the least and greatest of its support, widened by the noise still to come:
//! the bound that skips empty space; 3. plain f32 operations, no fused ones: the same bits on every machine.

use crate::dice::mix;
use fastnoise_lite::{FastNoiseLite, NoiseType};

/// Cells of a block along an axis.
pub(super) const CELLS: usize = 8;
/// Samples of a block along an axis: its cells' corners and one more on either side.
pub(super) const SIDE: usize = CELLS + 3;
/// Length of a row in memory: rows are read eight at a time from the middle on.
pub(super) const STRIDE: usize = 12;
/// Samples along an axis of a parent that a child's samples depend on.
const SUPPORT: usize = 7;
/// The same as a row in memory.
const SUPPORT_ROW: usize = 8;
const _: () = assert!(CELLS / 2 + SUPPORT_ROW <= STRIDE);

/// Depth of the deepest level that still gets noise, above the finest: features of about eight cells.
const SMOOTH_LEVELS: u32 = 1;
/// Part of the lattice points that carry a bump, downward in value (that is, upward in space): 1 of 4. The
/// others are raised by a third, so that the mean stays. Sparse bumps look like bubbles; even noise does not.
const RAISE: f32 = 1.0 / 3.0;

/// Samples of one block, `[z][y][x]`; entry `(1, 1, 1)` is the block's first sample.
pub(super) struct Block {
    pub(super) values: [f32; SIDE * SIDE * STRIDE],
}

/// The field of one seed at one resolution.
pub(super) struct Field {
    seed: u64,
    /// Index of the finest level.
    pub(super) levels: u32,
    /// Length of a finest cell.
    pub(super) step: f32,
    /// Index, at the finest level, of the sample at the origin of model space.
    pub(super) center: [i64; 3],
    /// Height of a bump per level.
    bump: Vec<f32>,
    /// How far all finer levels may lower and raise a value together.
    slack: Vec<[f32; 2]>,
    seed_bubbles: u32,
    /// Samples of level 0, from index -1 on.
    root: Vec<f32>,
    root_counts: [usize; 3],
}

/// Where a field is sampled.
#[derive(Clone, Copy)]
pub(super) struct Grid {
    /// Index of the finest level.
    pub(super) levels: u32,
    /// Length of a finest cell.
    pub(super) step: f32,
    /// Index, at the finest level, of the sample at the origin of model space.
    pub(super) center: [i64; 3],
    /// Blocks of level 0 per axis.
    pub(super) root_blocks: [usize; 3],
}

impl Field {
    /// Samples level 0 on `threads` threads.
    pub(super) fn new(seed: u64, grid: Grid, threads: usize) -> Field {
        let Grid { levels, step, center, root_blocks } = grid;
        let bump: Vec<f32> = (0..=levels)
            .map(|level| {
                let spacing = step * (1u64 << (levels - level)) as f32;
                if level == 0 || level + SMOOTH_LEVELS > levels { 0.0 } else { bump_height(spacing) }
            })
            .collect();
        let mut slack = vec![[0f32; 2]; bump.len()];
        for level in (1..bump.len()).rev() {
            let height: f32 = bubbles_at(level as u32).iter().map(|size| size.height).sum();
            let [down, up] = slack[level];
            slack[level - 1] = [
                down + bump[level] + BUBBLE_TOP * height,
                up + bump[level] * RAISE + (1.0 - BUBBLE_TOP) * height,
            ];
        }
        let seed_bubbles = mix(seed ^ 0x6275_6262) as u32;
        let root_counts = root_blocks.map(|blocks| blocks * CELLS + SIDE - CELLS);
        let root = Vec::new();
        let mut field = Field { seed, levels, step, center, bump, slack, seed_bubbles, root, root_counts };
        field.root = field.sample_root(threads);
        field
    }

    /// The samples of level 0, `[z][y][x]`.
    fn sample_root(&self, threads: usize) -> Vec<f32> {
        let root = Root::new(self.seed);
        let [x_count, y_count, z_count] = self.root_counts;
        let mut values = vec![0f32; x_count * y_count * z_count];
        let share = z_count.div_ceil(threads.clamp(1, 16)) * x_count * y_count;
        std::thread::scope(|scope| {
            for (part, values) in values.chunks_mut(share).enumerate() {
                let root = &root;
                scope.spawn(move || {
                    for (i, value) in values.iter_mut().enumerate() {
                        let i = part * share + i;
                        let index = [i % x_count, i / x_count % y_count, i / (x_count * y_count)];
                        *value = root.value(self.place(0, [0; 3], index));
                    }
                });
            }
        });
        values
    }

    /// The block whose first cell is `first` (in cells of level 0).
    pub(super) fn root_block(&self, first: [i64; 3]) -> Block {
        let mut block = Block { values: [0.0; SIDE * SIDE * STRIDE] };
        let [x, y, z] = first.map(|cell| cell as usize);
        for (dz, dy) in (0..SIDE).flat_map(|dz| (0..SIDE).map(move |dy| (dz, dy))) {
            let from = ((z + dz) * self.root_counts[1] + y + dy) * self.root_counts[0] + x;
            let at = (dz * SIDE + dy) * STRIDE;
            block.values[at..at + SIDE].copy_from_slice(&self.root[from..from + SIDE]);
        }
        block
    }

    /// True when the child at `octant` of a block at `level` may hold a part of the surface.
    pub(super) fn may_cross(&self, parent: &Block, level: u32, octant: [usize; 3]) -> bool {
        let [x, y, z] = octant.map(|half| half * CELLS / 2);
        let mut least = [f32::INFINITY; SUPPORT_ROW];
        let mut greatest = [f32::NEG_INFINITY; SUPPORT_ROW];
        for row in (z..z + SUPPORT).flat_map(|z| (y..y + SUPPORT).map(move |y| (z * SIDE + y) * STRIDE + x)) {
            let row: &[f32] = &parent.values[row..row + SUPPORT];
            for (slot, &value) in row.iter().enumerate() {
                least[slot] = least[slot].min(value);
                greatest[slot] = greatest[slot].max(value);
            }
        }
        let [down, up] = self.slack[level as usize];
        let least = least[..SUPPORT].iter().copied().fold(f32::INFINITY, f32::min);
        let greatest = greatest[..SUPPORT].iter().copied().fold(f32::NEG_INFINITY, f32::max);
        least - down < 0.0 && greatest + up >= 0.0
    }

    /// Fills `child`, at `level` with first cell `first` (in cells of that level), from its parent.
    pub(super) fn refine(
        &self,
        parent: &Block,
        octant: [usize; 3],
        level: u32,
        first: [i64; 3],
        child: &mut Block,
    ) {
        subdivide(parent, octant, child);
        let bump = self.bump[level as usize];
        if bump > 0.0 {
            self.add_noise(bump, level, first, child);
        }
        for size in bubbles_at(level) {
            self.add_bubbles(size, level, first, child);
        }
    }

    /// Where the sample `index` of a block stands, model units.
    fn place(&self, level: u32, first: [i64; 3], index: [usize; 3]) -> [f32; 3] {
        std::array::from_fn(|axis| {
            let sample = first[axis] + index[axis] as i64 - 1;
            ((sample << (self.levels - level)) - self.center[axis]) as f32 * self.step
        })
    }

    /// Lowers what is near the centre of a bubble and raises what is far from all.
    fn add_bubbles(&self, size: &Bubbles, level: u32, first: [i64; 3], block: &mut Block) {
        for z in 0..SIDE {
            for y in 0..SIDE {
                for x in 0..SIDE {
                    let at = self.place(level, first, [x, y, z]).map(|value| value / size.side);
                    let apart = squared_to_bubble(self.seed_bubbles, at).min(1.0);
                    block.values[(z * SIDE + y) * STRIDE + x] += size.height * (apart - BUBBLE_TOP);
                }
            }
        }
    }

    /// Lowers one sample of four by `bump` and raises the others.
    fn add_noise(&self, bump: f32, level: u32, first: [i64; 3], block: &mut Block) {
        let level_seed = mix(self.seed ^ (u64::from(level) << 56));
        let from = first[0] - 1;
        let (group, shift) = (from >> 5, from & 31);
        for z in 0..SIDE {
            let plane_seed = mix(level_seed ^ (first[2] + z as i64) as u64);
            for y in 0..SIDE {
                let row_seed = mix(plane_seed ^ (first[1] + y as i64) as u64);
                let word = |group: i64| {
                    let bits = mix(row_seed ^ group as u64);
                    bits & bits >> 32 & 0xffff_ffff
                };
                let bits = (word(group) | word(group + 1) << 32) >> shift;
                let at = (z * SIDE + y) * STRIDE;
                for x in 0..SIDE {
                    block.values[at + x] += [bump * RAISE, -bump][(bits >> x & 1) as usize];
                }
            }
        }
    }
}

impl Default for Block {
    fn default() -> Block {
        Block { values: [0.0; SIDE * SIDE * STRIDE] }
    }
}

/// One step of cubic B-spline subdivision per axis: new samples on old ones are (1, 6, 1) / 8, new ones
/// between are (1, 1) / 2. Entry `a` of the child stands on an old sample when `a` is odd.
fn subdivide(parent: &Block, octant: [usize; 3], child: &mut Block) {
    let [x0, y0, z0] = octant.map(|half| half * CELLS / 2);
    let mut along_z = [[[0f32; SUPPORT_ROW]; SUPPORT]; SIDE];
    for (z, plane) in along_z.iter_mut().enumerate() {
        for (y, row) in plane.iter_mut().enumerate() {
            let old = |z: usize| -> &[f32; SUPPORT_ROW] {
                let at = ((z0 + z) * SIDE + y0 + y) * STRIDE + x0;
                parent.values[at..at + SUPPORT_ROW].try_into().expect("a row of eight")
            };
            *row = blend(z, old);
        }
    }
    for (z, plane) in along_z.iter().enumerate() {
        for y in 0..SIDE {
            let row = blend(y, |y| &plane[y]);
            let at = (z * SIDE + y) * STRIDE;
            let out: &mut [f32; STRIDE] = (&mut child.values[at..at + STRIDE]).try_into().expect("a row");
            for x in 0..SUPPORT - 1 {
                out[2 * x] = 0.5 * (row[x] + row[x + 1]);
            }
            for x in 0..SUPPORT - 2 {
                out[2 * x + 1] = 0.125 * (row[x] + row[x + 2]) + 0.75 * row[x + 1];
            }
        }
    }
}

/// The new row `a` from the old rows.
fn blend<'a>(a: usize, old: impl Fn(usize) -> &'a [f32; SUPPORT_ROW]) -> [f32; SUPPORT_ROW] {
    if a.is_multiple_of(2) {
        let (p, q) = (old(a / 2), old(a / 2 + 1));
        std::array::from_fn(|x| 0.5 * (p[x] + q[x]))
    } else {
        let (p, q, r) = (old(a / 2), old(a / 2 + 1), old(a / 2 + 2));
        std::array::from_fn(|x| 0.125 * (p[x] + r[x]) + 0.75 * q[x])
    }
}

/// Model units: the layer is a square of this side.
pub(super) const LAYER_SIDE: f32 = 100.0;
/// The surface stays within this distance of the plane z = 0, whatever the seed: the root field reaches 18, all
/// bumps together some 3 more.
pub(super) const HALF_HEIGHT: f32 = 24.0;
/// Within this distance of that plane lies what the root field makes.
const ROOT_REACH: f32 = 17.0;

/// Height of a bump on a lattice of the given spacing. Falls a little faster than the spacing, so the surface
/// gets rougher at every zoom, yet its area grows slowly.
fn bump_height(spacing: f32) -> f32 {
    BUMP_SLOPE * spacing * (spacing / LAYER_SIDE).sqrt().sqrt()
}
const BUMP_SLOPE: f32 = 3.2;

/// The large shapes, in layers: spikes with rolled-up caps over ground with pits, pushed about by a warp, and
/// bubbles on every face of them.
///
/// ```text
///      .-""""-.      cap: half of an ellipsoid
///     ( ) |  | ( )   roll: a ring below its rim, what a vortex leaves
///         |  |       stem, widening
///   ___.-'    '-.__  ground
/// ```
struct Root {
    warp: FastNoiseLite,
    seed: u64,
}

/// One spike. Lengths in model units.
struct Spike {
    /// From its axis to the point asked, in the plane.
    across: f32,
    /// Height of the cap's rim.
    rim: f32,
    /// Radius of the rim.
    radius: f32,
}

/// Side of the squares with one spike each, and how high the caps rise above the ground: few large ones among many
/// small ones.
const SPIKES: [(f32, f32); 2] = [(13.5, 13.0), (7.0, 6.5)];
/// Level of the ground.
const GROUND: f32 = -8.0;
/// How far the warp moves a point at most, per octave, and its wavelength.
const WARPS: [(f32, f32); 2] = [(3.6, 13.0), (1.8, 5.5)];
/// Bubbles of one size on every face of the large shapes; one to a cube.
#[derive(Clone, Copy)]
struct Bubbles {
    /// Side of the cube.
    side: f32,
    /// From the crease between two bubbles to their tops, at most.
    height: f32,
}

/// The sizes of bubbles.
const BUBBLES: [Bubbles; 2] = [Bubbles { side: 4.4, height: 1.9 }, Bubbles { side: 2.2, height: 1.0 }];
/// The level at which they join: fine enough for the smallest (a sample has half of its side at most), so coarse
/// that they are the same at every resolution and cost next to nothing.
const BUBBLE_LEVEL: u32 = 1;
/// Part of the height that a bubble's top stands out; its creases are as much lower as is left.
const BUBBLE_TOP: f32 = 0.6;
/// Shapes nearer than this to each other grow together.
const BLEND: f32 = 1.6;
/// Distances that matter; farther ones are cut, so that what is far away cannot be felt.
const FAR: f32 = 7.0;

impl Root {
    fn new(seed: u64) -> Root {
        let mut warp = FastNoiseLite::with_seed(mix(seed ^ 0x7761_7270) as i32);
        warp.set_noise_type(Some(NoiseType::Perlin));
        warp.set_frequency(Some(1.0));
        Root { warp, seed: mix(seed ^ 0x7370_696b) }
    }

    /// Negative below the interface; about the distance from it.
    fn value(&self, at: [f32; 3]) -> f32 {
        if at[2].abs() > ROOT_REACH {
            return at[2].clamp(-FAR, FAR);
        }
        let [x, y, z] = self.warped(at);
        let swell = self.warp.get_noise_3d(x / 31.0 + 5.5, y / 31.0, 0.5);
        // Pits: the bubbles that rise the other way.
        let pit = 1.0 - squared_to_bubble(self.seed as u32, [x / 9.0, y / 9.0, 0.5]).min(1.0);
        let mut shape = z - GROUND - 5.0 * swell + 6.0 * pit - 3.0;
        for (side, height) in SPIKES {
            shape = self.near_spikes([x, y], side).into_iter().fold(shape, |shape, (across, dice)| {
                if across > 0.5 * side + FAR {
                    return shape;
                }
                let part = |i: u32| (dice >> (16 * i) & 0xffff) as f32 / 65536.0;
                let radius = side * (0.2 + 0.12 * part(0));
                let rim = GROUND + 5.0 * swell + height * (0.55 + 0.45 * part(1));
                blend_min(shape, Spike { across, rim, radius }.distance(z))
            });
        }
        let limit = (z - ROOT_REACH).max(-FAR);
        shape.clamp(-FAR, FAR).max(limit).min((z + ROOT_REACH).min(FAR))
    }

    /// Where the fluid at `at` came from: two octaves, the second at the place that the first gives.
    fn warped(&self, at: [f32; 3]) -> [f32; 3] {
        WARPS.iter().fold(at, |at, &(reach, wave)| {
            let [x, y, z] = at.map(|value| value / wave);
            let shift = |salt: f32| reach * self.warp.get_noise_3d(x + salt, y - salt, z + 0.7 * salt);
            [at[0] + shift(0.0), at[1] + shift(17.3), at[2] + 0.6 * shift(31.9)]
        })
    }

    /// Distance across from the nine spikes about `at`, and a random number for each.
    fn near_spikes(&self, at: [f32; 2], side: f32) -> [(f32, u64); 9] {
        let square = at.map(|value| (value / side).floor());
        std::array::from_fn(|i| {
            let cell = [square[0] + (i % 3) as f32 - 1.0, square[1] + (i / 3) as f32 - 1.0];
            let place = (cell[0] as i64 as u64) << 32 ^ (cell[1] as i64 as u64 & 0xffff_ffff);
            let dice = mix(self.seed ^ place ^ u64::from(side.to_bits()).rotate_left(24));
            let part = |shift: u32| (dice >> shift & 0xffff) as f32 / 65536.0;
            let axis = [(cell[0] + 0.2 + 0.6 * part(32)) * side, (cell[1] + 0.2 + 0.6 * part(48)) * side];
            (length(at[0] - axis[0], at[1] - axis[1]), dice)
        })
    }
}

impl Spike {
    /// About the distance from the spike at height `z`; negative inside.
    fn distance(&self, z: f32) -> f32 {
        let (radius, up) = (self.radius, z - self.rim);
        let dome = length(self.across, 1.5 * up.max(0.0)) - radius;
        let cap = dome.max(-up - 0.25 * radius);
        let roll = length(self.across - 0.95 * radius, up + 0.3 * radius) - 0.42 * radius;
        let below = (-up).max(0.0);
        let stem = (self.across - 0.3 * radius - 0.06 * below).max(up);
        cap.min(roll).min(stem)
    }
}

/// The bubbles that join at `level`.
fn bubbles_at(level: u32) -> &'static [Bubbles] {
    if level == BUBBLE_LEVEL { &BUBBLES } else { &[] }
}

/// Squared distance from `at` to the nearest bubble's centre: one centre to a unit cube, in its middle half, so
/// that the eight cubes about a point decide.
fn squared_to_bubble(seed: u32, at: [f32; 3]) -> f32 {
    let corner = at.map(|value| (value - 0.5).floor());
    let cell = corner.map(|value| value as i32 as u32);
    let mut least = f32::INFINITY;
    for i in 0..8u32 {
        let step = [i & 1, i >> 1 & 1, i >> 2];
        let mut dice = seed;
        for axis in 0..3 {
            dice = (dice ^ cell[axis].wrapping_add(step[axis])).wrapping_mul(0x9e37_79b1);
            dice ^= dice >> 15;
        }
        dice = dice.wrapping_mul(0x85eb_ca77);
        let mut squared = 0.0;
        for axis in 0..3 {
            let part = (dice >> (10 * axis) & 1023) as f32 * (0.5 / 1024.0) + 0.25;
            let apart = corner[axis] + step[axis] as f32 + part - at[axis];
            squared += apart * apart;
        }
        least = least.min(squared);
    }
    least
}

/// By square root, which is the same to the bit everywhere.
fn length(x: f32, y: f32) -> f32 {
    (x * x + y * y).sqrt()
}

/// The lesser of two distances, rounded where both are about the same.
fn blend_min(a: f32, b: f32) -> f32 {
    let near = (1.0 - (a - b).abs() / BLEND).max(0.0);
    a.min(b) - 0.25 * BLEND * near * near
}
