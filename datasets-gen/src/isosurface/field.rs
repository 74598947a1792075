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

use super::root::{BUBBLE_TOP, Bubbles, LAYER_SIDE, Root, bubbles_at, squared_to_bubble};
use crate::dice::mix;
use crate::pool::Pool;
use glam::Vec3;
use rayon::iter::{IndexedParallelIterator, ParallelIterator};
use rayon::slice::ParallelSliceMut;

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
    /// Samples level 0 on the threads of `pool`.
    pub(super) fn new(seed: u64, grid: Grid, pool: &Pool) -> Field {
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
        field.root = field.sample_root(pool);
        field
    }

    /// The samples of level 0, `[z][y][x]`.
    fn sample_root(&self, pool: &Pool) -> Vec<f32> {
        let root = Root::new(self.seed);
        let [x_count, y_count, z_count] = self.root_counts;
        let mut values = vec![0f32; x_count * y_count * z_count];
        let fill = |(z, plane): (usize, &mut [f32])| {
            for (i, value) in plane.iter_mut().enumerate() {
                *value = root.value(self.place(0, [0; 3], [i % x_count, i / x_count, z]));
            }
        };
        pool.install(|| values.par_chunks_mut(x_count * y_count).enumerate().for_each(fill));
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
    fn place(&self, level: u32, first: [i64; 3], index: [usize; 3]) -> Vec3 {
        let steps = std::array::from_fn(|axis| {
            let sample = first[axis] + index[axis] as i64 - 1;
            ((sample << (self.levels - level)) - self.center[axis]) as f32
        });
        Vec3::from_array(steps) * self.step
    }

    /// Lowers what is near the centre of a bubble and raises what is far from all.
    fn add_bubbles(&self, size: &Bubbles, level: u32, first: [i64; 3], block: &mut Block) {
        for z in 0..SIDE {
            for y in 0..SIDE {
                for x in 0..SIDE {
                    let at = self.place(level, first, [x, y, z]) / size.side;
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

/// Height of a bump on a lattice of the given spacing. Falls a little faster than the spacing, so the surface
/// gets rougher at every zoom, yet its area grows slowly.
fn bump_height(spacing: f32) -> f32 {
    BUMP_SLOPE * spacing * (spacing / LAYER_SIDE).sqrt().sqrt()
}
const BUMP_SLOPE: f32 = 3.2;
