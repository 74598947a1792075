//! `isosurface`: a turbulent mixing layer, like the Richtmyer-Meshkov surfaces of the literature: detail at all
//! scales, extracted block by block.
//!
//! ```text
//!   root blocks (Hilbert order) -> descent, skipping what cannot cross -> tasks: blocks of 32^3 finest cells
//!   task -> finest blocks of 8^3 cells -> marching cubes -> chunk
//! ```
//!
//! Invariants: 1. the surface is closed but for the domain's four walls; 2. positions are exact in f32;
//! 3. the work grows with the surface, not with the volume (see [`field::Field::may_cross`]).

mod cubes;
mod field;
mod root;
mod size;

use crate::pool::Pool;
use crate::stream::{Label, Recipe, Stream};
use crate::{GenOptions, Spec, View};
use cubes::{Cubes, Place, Table};
use field::{Block, CELLS, Field, Grid};
use root::{HALF_HEIGHT, LAYER_SIDE};
use std::sync::Arc;
use trex_store::{
    Aabb, AttributeSet, Material, MaterialList, Result, ScanHint, TriangleBatch, TriangleSource, geom,
};

/// Levels that a task descends: 4 x 4 x 4 finest blocks, some thousands of triangles.
const TASK_LEVELS: u32 = 2;
/// Level 0 has between this and twice this many cells along the layer's side: fine enough for the smallest
/// shapes of the root field.
const ROOT_CELLS: u64 = 48;
/// Part of a cell that the median edge is longer than, at every size and seed that the tests look at.
const MEDIAN_EDGE_CELLS: f64 = 0.6;

/// The stream of `spec`.
pub(crate) fn open(spec: &Spec, options: &GenOptions) -> Result<Box<dyn TriangleSource>> {
    let pool = Pool::new(spec, options.threads)?;
    let size = size::choose(spec, &pool, &options.interrupt)?;
    let layer = Layer::new(spec.seed, size.cells, &pool);
    let half = |axis: usize| 0.5 * (size.cells[axis] + 2) as f64 * f64::from(layer.field.step);
    let bounds = Aabb {
        lo: [-half(0), -half(1), -f64::from(HALF_HEIGHT)],
        hi: [half(0), half(1), f64::from(HALF_HEIGHT)],
    };
    let hint = ScanHint {
        bounds,
        median_edge: MEDIAN_EDGE_CELLS * f64::from(layer.field.step),
        triangle_count: size.triangle_count,
        attributes: AttributeSet::default(),
    };
    let interface = Material { kd: [0.74, 0.69, 0.63], ..Material::default() };
    let label = Label {
        name: spec.to_string(),
        hint,
        materials: MaterialList::from_iter([("interface", interface)]),
    };
    Ok(Box::new(Stream::new(layer, label, pool, options)?))
}

/// The layer from above one corner, and bubbles from near.
pub(crate) fn views() -> Vec<View> {
    let up = [0.0, 0.0, 1.0];
    vec![
        View {
            name: "overview",
            position: [-6.0, -50.0, 40.0],
            target: [-1.0, -9.0, 3.2],
            up,
            fov_x_deg: 44.0,
        },
        View { name: "close", position: [-9.0, -34.0, 15.0], target: [2.0, 0.0, -1.0], up, fov_x_deg: 50.0 },
    ]
}

/// A mixing layer at one resolution.
struct Layer {
    field: Field,
    table: Table,
    /// Finest cells along x, y, z.
    cells: [u64; 3],
}

/// A block of the descent.
struct Node {
    level: u32,
    /// First cell, in cells of `level`.
    first: [i64; 3],
    block: Box<Block>,
}

/// What a worker keeps: one block per level of a task, and the vertices.
#[derive(Default)]
struct Scratch {
    blocks: [Block; TASK_LEVELS as usize],
    cubes: Cubes,
}

impl Layer {
    /// `sides`: finest cells along x and y. The mean of both is the layer's side.
    fn new(seed: u64, sides: [u64; 2], pool: &Pool) -> Layer {
        let mean = 0.5 * (sides[0] + sides[1]) as f64;
        let step = (f64::from(LAYER_SIDE) / mean) as f32;
        let levels = Layer::level_of(mean as u64);
        let half_height = (HALF_HEIGHT / step).ceil() as u64;
        let cells = [sides[0], sides[1], 2 * half_height];
        let center = cells.map(|count| (count / 2) as i64);
        let root_blocks = cells.map(|cells| cells.div_ceil((CELLS as u64) << levels) as usize);
        let grid = Grid { levels, step, center, root_blocks };
        Layer { field: Field::new(seed, grid, pool), table: Table::new(), cells }
    }

    /// Index of the finest level of a layer of `side` cells a side.
    fn level_of(side: u64) -> u32 {
        (side / ROOT_CELLS).max(1).ilog2()
    }

    /// The level whose blocks are tasks.
    fn task_level(&self) -> u32 {
        self.field.levels.saturating_sub(TASK_LEVELS)
    }

    /// True when a block at `level` has a cell of the domain.
    fn in_domain(&self, level: u32, first: [i64; 3]) -> bool {
        let shift = self.field.levels - level;
        (0..3).all(|axis| (first[axis] << shift) < self.cells[axis] as i64)
    }

    /// Calls `visit` for each child of a block that may hold surface, in Morton order.
    fn for_each_child(
        &self,
        level: u32,
        first: [i64; 3],
        block: &Block,
        mut visit: impl FnMut([usize; 3], [i64; 3]),
    ) {
        for index in 0..8 {
            let octant = [index & 1, index >> 1 & 1, index >> 2];
            let child = std::array::from_fn(|axis| 2 * first[axis] + (octant[axis] * CELLS) as i64);
            if self.in_domain(level + 1, child) && self.field.may_cross(block, level, octant) {
                visit(octant, child);
            }
        }
    }

    /// Calls `visit` with the finest blocks below `block`, and with the cubes.
    fn descend(
        &self,
        node: (u32, [i64; 3], &Block),
        scratch: &mut [Block],
        visit: &mut impl FnMut(&Block, &Place),
    ) {
        let (level, first, block) = node;
        if level == self.field.levels {
            visit(block, &self.place(first));
            return;
        }
        let (own, deeper) = scratch.split_first_mut().expect("a block per level");
        self.for_each_child(level, first, block, |octant, child| {
            self.field.refine(block, octant, level + 1, child, own);
            self.descend((level + 1, child, own), deeper, visit);
        });
    }

    fn place(&self, first: [i64; 3]) -> Place {
        let inside = std::array::from_fn(|axis| (self.cells[axis] as i64 - first[axis]).clamp(0, 8) as usize);
        Place { first, center: self.field.center, inside, step: self.field.step }
    }

    /// Root blocks in Hilbert order.
    fn roots(&self) -> Vec<[i64; 3]> {
        let block_cells = (CELLS as u64) << self.field.levels;
        let counts = self.cells.map(|cells| cells.div_ceil(block_cells) as u32);
        let bits = counts.iter().max().map_or(1, |&most| most.next_power_of_two().trailing_zeros().max(1));
        let mut roots: Vec<(u64, [i64; 3])> = Vec::new();
        for z in 0..counts[2] {
            for y in 0..counts[1] {
                for x in 0..counts[0] {
                    let first = [x, y, z].map(|block| i64::from(block) * CELLS as i64);
                    roots.push((geom::hilbert_key([x, y, z], bits), first));
                }
            }
        }
        roots.sort_unstable();
        roots.into_iter().map(|(_, first)| first).collect()
    }

    /// Triangles of one task.
    fn count(&self, node: &Node, scratch: &mut Scratch) -> u64 {
        let mut sum = 0;
        self.descend((node.level, node.first, &node.block), &mut scratch.blocks, &mut |block, place| {
            sum += cubes::count(&self.table, block, place);
        });
        sum
    }
}

impl Recipe for Layer {
    type Task = Node;
    type Scratch = Scratch;

    fn tasks(self: Arc<Self>) -> Box<dyn Iterator<Item = Node> + Send> {
        Box::new(Descent { roots: self.roots().into_iter(), stack: Vec::new(), layer: self })
    }

    fn make(&self, task: Node, scratch: &mut Scratch, out: &mut TriangleBatch) {
        let Scratch { blocks, cubes } = scratch;
        self.descend((task.level, task.first, &task.block), blocks, &mut |block, place| {
            cubes.extract(&self.table, block, place, out);
        });
    }
}

/// The blocks at the level of tasks that may hold surface, depth first.
struct Descent {
    layer: Arc<Layer>,
    roots: std::vec::IntoIter<[i64; 3]>,
    /// At most seven blocks per level wait here.
    stack: Vec<Node>,
}

impl Iterator for Descent {
    type Item = Node;

    fn next(&mut self) -> Option<Node> {
        loop {
            let node = match self.stack.pop() {
                Some(node) => node,
                None => {
                    let first = self.roots.next()?;
                    Node { level: 0, first, block: Box::new(self.layer.field.root_block(first)) }
                }
            };
            if node.level == self.layer.task_level() {
                return Some(node);
            }
            let from = self.stack.len();
            let (layer, stack) = (&self.layer, &mut self.stack);
            layer.for_each_child(node.level, node.first, &node.block, |octant, first| {
                let mut block = Box::<Block>::default();
                layer.field.refine(&node.block, octant, node.level + 1, first, &mut block);
                stack.push(Node { level: node.level + 1, first, block });
            });
            self.stack[from..].reverse();
        }
    }
}
