//! Rays through the upper octree and the units below it, which come and go. Paper, sections 4.2 and 5.4.
//!
//! ```text
//! as `traverse`, in subvoxels of the finest leaves, and
//!   a bit of a leaf's bitmap is set  -> the leaf there, in its unit: go on down
//!                                       the page is missing        -> blocked: it is asked for, the ray comes again;
//!                                                                     or the coarser voxel stands in (`MissingUnits`)
//!                                       it can never be had        -> the coarser voxel is what there is
//!   a bit of a finest bitmap is set  -> hit
//! ```
//!
//! A unit is asked for where a ray meets a subvoxel of the leaves above it, not where it enters the linking node:
//! what the ray passes by costs no page. With `occluders` off, leaves are cubes, so it is asked for where a leaf is
//! entered.
//!
//! A ray may stand for a cone: where that is as wide as a subvoxel of coarser leaves, the ray goes on in these
//! ([`LowerScene::answer`]).
//!
//! A ray leaves its own voxels as in `traverse`, by the side of the finest ones, and a share of it that holds what
//! positions in f32 are rounded by.
//!
//! Invariants: 1. an answer that is no stand-in does not depend on which pages were there; 2. no voxel is met that is
//! no part of one of the upper octree; 3. no allocation; a page is in use until the next one is looked up.

use super::g_ray::{GAnswer, GKind, GRay};
use super::steps::Steps;
use super::traverse::{Cube, Entry, Occluders, VoxelFound, VoxelHit, VoxelScene};
use crate::trace::{Answer, Page, Pages, Ray};
use glam::DVec3;
use trex_store::octree::{LowerLinks, MAX_DEPTH, MAX_FINER, NODE_SIDE, Refinement, UnitRef, UnitsView};

/// Share of the cube's side by which a position on a ray may be off: origin, product and sum are each rounded by
/// 2^-24 of it at most.
const ROUNDING: f64 = 1.0 / (1 << 22) as f64;

/// What becomes of a ray that meets a voxel whose unit is missing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum MissingUnits {
    /// It is blocked, and is to be asked again.
    #[default]
    Block,
    /// The voxel answers in the place of the finer ones, and the answer says so; the page is recorded all the same.
    /// Paper, section 5.4.
    StandIn,
}

/// The octree of a model with its units.
#[derive(Clone, Copy, Debug)]
pub struct LowerScene<'a> {
    upper: VoxelScene<'a>,
    pub(super) links: &'a LowerLinks,
    /// The finest leaves that it reads: those of the file; for parts of rays the level above them.
    pub(super) refinement: Refinement,
    missing: MissingUnits,
}

/// The leaves of one level, for the part of a ray that reads them.
#[derive(Clone, Copy, Debug)]
pub(super) struct ScenePart<'a> {
    /// `None` for the upper octree alone.
    pub(super) lower: Option<LowerScene<'a>>,
    /// Side of its subvoxels, in the finest ones.
    pub(super) side: f32,
    /// Side of the subvoxels from which on the ray reads the next part: where its cone is as wide ([`GRay::reach`]).
    pub(super) next: f32,
}

/// The hit of a ray on the finest voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LowerHit {
    /// The voxel: where the finest one is entered, and the leaf and node of the upper octree that hold it.
    pub upper: VoxelHit,
    /// The leaf of a unit; `None` where there is none to be had.
    pub lower: Option<LowerLeaf>,
    /// True where a unit below is missing: finer voxels answer when it has come, and the ray may be asked again.
    pub is_stand_in: bool,
}

/// The voxel at which a walk through units has ended.
#[derive(Clone, Copy, Debug)]
pub(super) struct LowerFound {
    /// Distance of the ray's start to the cube, model units.
    pub(super) t_in: f64,
    pub(super) found: VoxelFound,
    pub(super) lower: Option<LowerLeaf>,
    pub(super) is_stand_in: bool,
}

impl LowerFound {
    /// A voxel of the upper octree.
    pub(super) fn of_upper(found: VoxelFound) -> LowerFound {
        LowerFound { t_in: 0.0, found, lower: None, is_stand_in: false }
    }
}

/// A leaf of a unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LowerLeaf {
    /// Index of its page.
    pub page: u32,
    /// Index within the page.
    pub leaf: u32,
}

/// A leaf that the ray is in.
#[derive(Clone, Copy, Default)]
struct Open {
    bitmap: u64,
    /// The unit of its children, and which of that one's nodes it is.
    unit: Option<UnitRef>,
    rank: u32,
    at: Option<LowerLeaf>,
}

/// The answer of a look below a leaf.
enum Below {
    /// This page is not there yet.
    Missing(u32),
    /// Nothing is to be had.
    Never,
    /// The child asked for, if it is there.
    Child(Option<Open>),
}

impl<'a> LowerScene<'a> {
    /// `upper` with the units to which `links`, of the same file, lead.
    pub fn new(upper: VoxelScene<'a>, links: &'a LowerLinks) -> LowerScene<'a> {
        LowerScene { upper, links, refinement: links.refinement(), missing: MissingUnits::Block }
    }

    /// The same scene, in which this becomes of rays that meet missing units.
    pub fn on_missing(self, missing: MissingUnits) -> LowerScene<'a> {
        LowerScene { missing, ..self }
    }

    /// What becomes of rays that meet missing units.
    pub(crate) fn missing(&self) -> MissingUnits {
        self.missing
    }

    pub(super) fn upper(&self) -> &VoxelScene<'a> {
        &self.upper
    }

    /// The parts of rays, from their start on: where the cone of a ray is as wide as a subvoxel of the next coarser
    /// leaves, it goes on in these.
    pub(super) fn parts(&self) -> impl Iterator<Item = ScenePart<'a>> + use<'a> {
        let (whole, finest) = (*self, self.refinement.factor());
        let levels = Refinement::ALL.into_iter().rev().filter(move |level| level.factor() <= finest);
        levels.map(move |refinement| {
            let side = (finest / refinement.factor()) as f32;
            let is_upper = refinement == Refinement::None;
            let lower = (!is_upper).then_some(LowerScene { refinement, ..whole });
            ScenePart { lower, side, next: if is_upper { f32::INFINITY } else { NODE_SIDE as f32 * side } }
        })
    }

    /// Side of a finest leaf, model units.
    pub fn leaf_side(&self) -> f64 {
        self.upper.leaf_side() / f64::from(self.refinement.factor())
    }

    /// Distance off a surface of unit `normal` at which a ray starts or ends free of that surface's own finest
    /// voxels, model units.
    pub fn clearance(&self, normal: [f64; 3]) -> f64 {
        let cube = self.cube();
        let side = match self.upper.occluders() {
            Occluders::On => cube.cell,
            Occluders::Off => self.leaf_side(),
        };
        (side + ROUNDING * cube.side()) * DVec3::from(normal).abs().element_sum()
    }

    /// The cube in subvoxels of the finest leaves.
    pub(super) fn cube(&self) -> Cube {
        let (upper, refinement) = (self.upper.cube(), self.refinement);
        let cell = upper.cell / f64::from(refinement.factor());
        Cube { cell, levels: upper.levels + refinement.levels() as u32, ..upper }
    }

    /// Side of a subvoxel of the finest leaves, model units.
    pub fn subvoxel_side(&self) -> f64 {
        self.cube().cell
    }

    /// The ray as batches take it, and its distance to the cube, model units: in subvoxels of the finest leaves for
    /// kinds that ask units, else in those of the upper octree.
    pub fn g_ray(&self, ray: &Ray, kind: GKind) -> (GRay, f64) {
        let cube = if kind.asks_units() { self.cube() } else { self.upper.cube() };
        cube.g_ray(ray, kind)
    }

    /// The first voxel that the ray meets; blocked where that depends on a page that is missing.
    pub fn intersect(&self, ray: &Ray, pages: &mut impl Pages) -> Answer<Option<LowerHit>> {
        let Some(entry) = self.cube().enter(ray) else { return Answer::Exact(None) };
        self.hit_of(self.walk(&entry, pages, &mut ()))
    }

    /// The hit of a walk.
    pub(super) fn hit_of(&self, found: Answer<Option<LowerFound>>) -> Answer<Option<LowerHit>> {
        let cell = self.cube().cell;
        let hit = |LowerFound { t_in, found, lower, is_stand_in }| {
            let VoxelFound { t, node, leaf, axis } = found;
            let t = t_in + f64::from(t) * cell;
            LowerHit { upper: VoxelHit { t, leaf, node, axis }, lower, is_stand_in }
        };
        found.map(|found| found.map(hit))
    }

    /// The answer of one ray of [`LowerScene::g_ray`]: what batches and devices are compared with.
    ///
    /// # Panics
    /// When the bits of the ray name no kind.
    pub fn answer(&self, ray: &GRay, pages: &mut impl Pages) -> GAnswer {
        if !ray.kind().asks_units() {
            return self.upper.answer(ray);
        }
        let found = self.find(ray, pages, &mut ());
        self.answer_of(ray, &found, pages)
    }

    /// Steps that [`LowerScene::answer`] takes for a ray, with the same pages.
    pub fn steps(&self, ray: &GRay, pages: &mut impl Pages) -> u64 {
        if !ray.kind().asks_units() {
            return self.upper.steps(ray);
        }
        let mut steps = 0u64;
        self.find(ray, pages, &mut steps);
        steps
    }

    /// What a ray that asks units finds, through the leaves of each level that its cone lets it read, finest first.
    fn find(&self, ray: &GRay, pages: &mut impl Pages, steps: &mut impl Steps) -> Answer<Option<LowerFound>> {
        let (mut from, mut found) = (0.0, Answer::Exact(None));
        for part in self.parts() {
            let to = ray.reach(part.next);
            if from >= to || from > ray.t_max {
                continue;
            }
            let entry = Entry::of(&ray.part(from, to, part.side));
            found = match (entry, part.lower) {
                (None, _) => Answer::Exact(None),
                (Some(entry), Some(lower)) => lower.walk(&entry, pages, steps),
                (Some(entry), None) => {
                    Answer::Exact(self.upper.walk(&entry, steps).map(LowerFound::of_upper))
                }
            };
            match &mut found {
                Answer::Blocked => break,
                Answer::Exact(Some(found)) => {
                    found.found.t = from + part.side * found.found.t;
                    break;
                }
                Answer::Exact(None) => from = to,
            }
        }
        found
    }

    /// The answer of a ray that asks units and has `found` something, or nothing; where the page of that has gone in
    /// between blocked, or what the voxel above it says.
    pub(super) fn answer_of(
        &self,
        ray: &GRay,
        found: &Answer<Option<LowerFound>>,
        pages: &mut impl Pages,
    ) -> GAnswer {
        let LowerFound { found, lower, .. } = match found {
            Answer::Blocked => return GAnswer::bare(GAnswer::BLOCKED),
            Answer::Exact(None) => return GAnswer::bare(GAnswer::NOTHING),
            Answer::Exact(Some(found)) => found,
        };
        let above = || self.upper.answer_of(ray, Some(found));
        let Some(at) = lower.filter(|_| ray.kind() != GKind::Shadow) else { return above() };
        let is_missing = match pages.page(at.page) {
            Page::Ready(frame) => {
                let leaf = UnitsView::new(frame.bytes()).leaf(at.leaf);
                let normal = ray.facing(&leaf, found.axis);
                return self.upper.answer_with(ray, found, normal, leaf.material);
            }
            Page::Missing => true,
            Page::Damaged => false,
        };
        if is_missing {
            pages.want(at.page);
        }
        let is_blocked = is_missing && self.missing == MissingUnits::Block;
        if is_blocked { GAnswer::bare(GAnswer::BLOCKED) } else { above() }
    }

    /// Walks from the cube's side on.
    pub(super) fn walk(
        &self,
        ray: &Entry,
        pages: &mut impl Pages,
        steps: &mut impl Steps,
    ) -> Answer<Option<LowerFound>> {
        let octree = self.upper.octree();
        let (nodes, bitmaps) = (octree.nodes(), octree.bitmaps());
        let first_link = nodes.len() - octree.last_nodes().len();
        let depth = octree.grid().depth();
        let finest = depth + self.refinement.levels();
        let is_whole = self.upper.occluders() == Occluders::Off;
        let last = 4u32.pow(finest as u32 + 1) - 1;
        let mut cell = ray.first_cell(last);
        let (mut t, mut axis) = (0.0f32, ray.axis);
        // Node of each level over the cell; from `depth` on leaves.
        let mut path = [0u32; MAX_DEPTH + 1];
        let mut open = [Open::default(); MAX_FINER + 1];
        let mut level = 0;
        loop {
            // Down to a child that is missing, or to a voxel below which there is none.
            let (shift, bits) = loop {
                let shift = 2 * (finest - level) as u32;
                let place = ray.place(cell, shift);
                if level < depth {
                    let node = &nodes[path[level] as usize];
                    let Some(child) = node.child(place) else { break (shift, node.bits()) };
                    level += 1;
                    path[level] = child;
                    if level == depth {
                        let above = path[depth - 1] as usize;
                        let unit = Some(self.links.unit(above - first_link));
                        let rank = child - nodes[above].first;
                        open[0] = Open { bitmap: bitmaps[child as usize], unit, rank, at: None };
                    }
                    continue;
                }
                let leaf = &open[level - depth];
                let is_set = leaf.bitmap >> place & 1 == 1;
                if !is_set && !is_whole {
                    break (shift, leaf.bitmap);
                }
                let below = if level == finest { Below::Never } else { leaf.below(place, pages) };
                if let Below::Missing(page) = below {
                    pages.want(page);
                }
                match below {
                    Below::Missing(_) if self.missing == MissingUnits::Block => return Answer::Blocked,
                    Below::Missing(_) | Below::Never => {
                        let found = VoxelFound { t, node: path[depth - 1], leaf: path[depth], axis };
                        let (lower, is_stand_in) = (leaf.at, matches!(below, Below::Missing(_)));
                        return Answer::Exact(Some(LowerFound { t_in: ray.t_in, found, lower, is_stand_in }));
                    }
                    Below::Child(None) => break (shift, leaf.bitmap),
                    Below::Child(Some(child)) => {
                        level += 1;
                        open[level - depth] = child;
                    }
                }
            };
            steps.step();
            let Some((next, apart)) = ray.leave(cell, ray.within(cell, shift, bits), &mut t, &mut axis)
            else {
                return Answer::Exact(None);
            };
            if next[axis] > last {
                return Answer::Exact(None);
            }
            // Up to the node that holds both.
            level = level.min(finest - (apart as usize).min(finest));
            cell = next;
        }
    }
}

impl Open {
    /// The child in `place`.
    #[inline]
    fn below(&self, place: u32, pages: &mut impl Pages) -> Below {
        let Some(unit) = self.unit else { return Below::Never };
        let view = match pages.page(unit.page()) {
            Page::Missing => return Below::Missing(unit.page()),
            Page::Damaged => return Below::Never,
            Page::Ready(frame) => UnitsView::new(frame.bytes()),
        };
        // A unit that is not what the leaf says is none.
        let node = view.node(unit.unit(), self.rank);
        let Some((node, leaf)) = node.and_then(|node| Some((node, node.leaf(self.bitmap, place)?))) else {
            return Below::Never;
        };
        if self.bitmap >> place & 1 == 0 {
            return Below::Child(None);
        }
        let at = Some(LowerLeaf { page: unit.page(), leaf });
        let rank = leaf - node.first_leaf();
        Below::Child(Some(Open { bitmap: view.bitmap(leaf), unit: node.link, rank, at }))
    }
}
