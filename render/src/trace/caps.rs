//! `Caps`: where a section goes through a solid, and of which material: what fills the cut.
//!
//! ```text
//! the plane in cells, each with an anchor     two lines in the plane through the anchor, all that they cross:
//!   +------+------+                             front of a surface: a solid begins    back: it ends
//!   |  o---|--x   |   x: the solids of its      -> the solids around the anchor, kept for later points
//!   |   anchor    |   cell's anchor, and what    and the short way from there to the point
//!   +------+------+
//! ```
//!
//! Of several solids around a point the one that ends first along the plane's first axis fills it: a bolt in a block is
//! seen as a bolt, and where two things overlap the border between them is a line. A cavity whose walls look inwards
//! ends the solid around it, whatever the colours of the walls.
//!
//! | what the lines of an anchor cross | rule |
//! |---|---|
//! | pairs of front and back ([`is_oriented`]) | a front begins a solid, a back ends one of its material, or the last |
//! | else, without the materials that a line crosses an odd number of times, which are *open* | the same |
//! | else (triangles that look the wrong way) | parity: each material begins and ends in turn |
//! | one line within a solid, the other not | nothing is filled |
//!
//! Open materials fill nothing; the rays that met them are counted. Lines stay within the plane, so that no page is
//! read which the plane does not touch; they cross each surface once ([`super::crossings`]), so the fill of a closed
//! surface leaks nowhere.
//!
//! Invariants: 1. an answer is a function of the point, the model and its hidden materials, not of the points before;
//! 2. a line with more than [`CROSSED_MAX`] crossings decides nothing, and counts as open; 3. of more than
//! [`SOLIDS_MAX`] solids around a point those that began first are forgotten.

use super::parts::Section;
use super::{Answer, Ray};
use glam::DVec3;

/// Cells along the greatest side of a model: so many that the way to a point is short, so few that most cells of a
/// picture are kept.
const CELLS_ACROSS: f64 = 256.0;
/// Cells that are kept, those of all planes together: others take their places.
const CELLS_KEPT: usize = 4096;
/// Place of the anchor in its cell: no share of a side that a model would have a wall at.
const ANCHOR: [f64; 2] = [0.381_966_011_3, 0.618_033_988_7];
/// Cells within which the end of a solid in another is looked for first.
const NEAR_CELLS: f64 = 16.0;
/// Most solids around a point.
const SOLIDS_MAX: usize = 8;
/// Most open materials that a cell leaves out; from one more on it leaves out all.
const OPEN_MAX: usize = 4;
/// Most crossings of a line.
pub(super) const CROSSED_MAX: usize = 1 << 14;

/// Where a line crosses a surface.
#[derive(Clone, Copy, Debug)]
pub(super) struct CrossedSurface {
    pub(super) t: f64,
    pub(super) material: u16,
    /// True where the line meets its front: a solid begins.
    pub(super) begins: bool,
}

/// Open parts that rays met on sections: of which materials, and how often.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OpenParts {
    /// Rays that came to a section where some part is open.
    pub rays: u64,
    /// Materials that are open there, the first few.
    pub materials: Vec<u32>,
}

/// The caps of all sections of a model.
pub(super) struct Caps {
    planes: Vec<CutPlane>,
    cells: Vec<CapCell>,
    /// Crossings of the two lines of an anchor, and of the way to a point.
    crossed: [Vec<CrossedSurface>; 3],
    counted: Vec<u16>,
    pub(super) open: OpenParts,
}

/// A section with axes of its own.
struct CutPlane {
    /// The middle of the model, on the plane.
    middle: DVec3,
    /// Unit axes along the plane.
    axes: [DVec3; 2],
    side: f64,
    /// From any anchor near the model a line so long ends outside of it.
    reach: f64,
}

/// What is known of a cell.
#[derive(Clone, Copy, Debug, Default)]
struct CapCell {
    /// Which cell it is; 0 for none.
    key: u64,
    solids: Solids,
    rule: CapRule,
}

/// How crossings near an anchor count.
#[derive(Clone, Copy, Debug, Default)]
struct CapRule {
    open: OpenMaterials,
    by_parity: bool,
}

/// Materials that fill nothing.
#[derive(Clone, Copy, Debug, Default)]
struct OpenMaterials {
    list: [u16; OPEN_MAX],
    /// More than [`OPEN_MAX`] for all materials.
    count: u8,
}

/// What becomes of the solids around a point where a line crosses a surface.
enum CrossingEffect {
    Begins,
    /// The one at this place of the list ends.
    Ends(usize),
    Nothing,
}

/// The solids around a point, by their materials, in the order in which they began.
#[derive(Clone, Copy, Debug, Default)]
struct Solids {
    list: [u16; SOLIDS_MAX],
    count: u8,
}

impl Solids {
    fn last(&self) -> Option<u16> {
        self.count.checked_sub(1).map(|at| self.list[usize::from(at)])
    }

    fn begin(&mut self, material: u16) {
        if usize::from(self.count) == SOLIDS_MAX {
            self.end_at(0);
        }
        self.list[usize::from(self.count)] = material;
        self.count += 1;
    }

    /// The place of the solid of `material` that began last.
    fn find(&self, material: u16) -> Option<usize> {
        self.list[..usize::from(self.count)].iter().rposition(|&of| of == material)
    }

    fn end_at(&mut self, place: usize) {
        self.list.copy_within(place + 1.., place);
        self.count -= 1;
    }

    /// Begins or ends a solid where one is crossed.
    fn cross(&mut self, crossed: &CrossedSurface, by_parity: bool) {
        match self.ending(crossed, by_parity) {
            CrossingEffect::Begins => self.begin(crossed.material),
            CrossingEffect::Ends(place) => self.end_at(place),
            CrossingEffect::Nothing => {}
        }
    }

    /// What a crossing does.
    fn ending(&self, crossed: &CrossedSurface, by_parity: bool) -> CrossingEffect {
        let own = self.find(crossed.material);
        if if by_parity { own.is_none() } else { crossed.begins } {
            return CrossingEffect::Begins;
        }
        own.or(usize::from(self.count).checked_sub(1)).map_or(CrossingEffect::Nothing, CrossingEffect::Ends)
    }

    /// The one material around a point; `None` where there are several, or none.
    fn only(&self) -> Option<u16> {
        let around = &self.list[..usize::from(self.count)];
        around.first().copied().filter(|first| around.iter().all(|of| of == first))
    }

    /// Of these solids around a point, the one that ends first along a line from there that crosses this.
    fn first_to_end(mut self, crossed: &[CrossedSurface], rule: &CapRule) -> Option<u16> {
        let here = usize::from(self.count);
        for crossed in crossed.iter().filter(|crossed| !rule.open.has(crossed.material)) {
            match self.ending(crossed, rule.by_parity) {
                CrossingEffect::Ends(place) if place < here => return Some(self.list[place]),
                CrossingEffect::Begins if usize::from(self.count) == SOLIDS_MAX => return None,
                _ => self.cross(crossed, rule.by_parity),
            }
        }
        None
    }
}

impl OpenMaterials {
    const ALL: OpenMaterials = OpenMaterials { list: [0; OPEN_MAX], count: OPEN_MAX as u8 + 1 };

    fn is_all(&self) -> bool {
        usize::from(self.count) > OPEN_MAX
    }

    fn has(&self, material: u16) -> bool {
        self.is_all() || self.named().contains(&material)
    }

    fn named(&self) -> &[u16] {
        &self.list[..usize::from(self.count).min(OPEN_MAX)]
    }

    fn add(&mut self, material: u16) {
        if usize::from(self.count) < OPEN_MAX {
            self.list[usize::from(self.count)] = material;
        }
        self.count += 1;
    }
}

impl CutPlane {
    fn new(section: &Section, [lo, hi]: [DVec3; 2]) -> CutPlane {
        let normal = DVec3::from(section.normal);
        let middle = 0.5 * (lo + hi);
        // Along the axes of the model where the plane is: models have their walls there, and their openings.
        let least = (0..3).fold(0, |least, a| if normal[a].abs() < normal[least].abs() { a } else { least });
        let u = normal.cross(DVec3::AXES[least]).normalize();
        let size = (hi - lo).max_element().max(f64::MIN_POSITIVE);
        CutPlane {
            middle: middle - section.distance(middle) * normal,
            axes: [u, normal.cross(u)],
            side: size / CELLS_ACROSS,
            reach: 4.0 * size,
        }
    }

    /// The point at these places along the axes, in cells.
    fn at(&self, [a, b]: [f64; 2]) -> DVec3 {
        self.middle + self.side * (a * self.axes[0] + b * self.axes[1])
    }
}

impl Caps {
    /// Bytes of the caps of one tracer, at most.
    pub(super) const BYTES: usize =
        CELLS_KEPT * size_of::<CapCell>() + (3 * size_of::<CrossedSurface>() + 2) * (CROSSED_MAX + 1);

    /// The caps of these sections of a model in this box.
    pub(super) fn new(sections: &[Section], bounds: [DVec3; 2]) -> Caps {
        Caps {
            planes: sections.iter().map(|section| CutPlane::new(section, bounds)).collect(),
            cells: vec![CapCell::default(); CELLS_KEPT],
            crossed: std::array::from_fn(|_| Vec::with_capacity(CROSSED_MAX + 1)),
            counted: Vec::with_capacity(CROSSED_MAX + 1),
            open: OpenParts::default(),
        }
    }

    /// The material of the solid around `point`, which lies on section `plane`, within the model's box. `cross` appends
    /// all that a ray crosses of what is shown, in any order, [`CROSSED_MAX`] and one more at most.
    pub(super) fn fill(
        &mut self,
        plane: usize,
        point: DVec3,
        mut cross: impl FnMut(&Ray, &mut Vec<CrossedSurface>) -> Answer<()>,
    ) -> Answer<Option<u16>> {
        let cut = &self.planes[plane];
        let place = cut.axes.map(|axis| axis.dot(point - cut.middle) / cut.side);
        let [i, j] = place.map(f64::floor);
        let key =
            [i, j].iter().fold(1 + plane as u64, |key, at| key << 24 | ((*at as i64) & 0xff_ffff) as u64);
        let slot = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 48) as usize % CELLS_KEPT;
        let anchor = [i + ANCHOR[0], j + ANCHOR[1]];
        if self.cells[slot].key != key {
            let Answer::Exact((solids, rule)) = self.around(plane, anchor, &mut cross) else {
                return Answer::Blocked;
            };
            self.cells[slot] = CapCell { key, solids, rule };
        }
        let (cut, CapCell { mut solids, rule, .. }) = (&self.planes[plane], self.cells[slot]);
        let from = cut.at(anchor);
        // Along the plane, whatever the point is off it.
        let way = cut.at(place) - from;
        let length = way.length();
        if length > 0.0 && !rule.open.is_all() {
            let ray = Ray::new(from, way / length, length);
            let crossed = &mut self.crossed[2];
            crossed.clear();
            if cross(&ray, crossed) == Answer::Blocked {
                return Answer::Blocked;
            }
            crossed.sort_by(|a, b| a.t.total_cmp(&b.t));
            follow(crossed, &rule, length, &mut solids);
        }
        let (start, axis, lengths) = (cut.at(place), cut.axes[0], [NEAR_CELLS * cut.side, cut.reach]);
        self.note(&rule.open);
        if solids.count == 0 || solids.only().is_some() {
            return Answer::Exact(solids.last());
        }
        for length in lengths {
            let crossed = &mut self.crossed[2];
            crossed.clear();
            if cross(&Ray::new(start, axis, length), crossed) == Answer::Blocked {
                return Answer::Blocked;
            }
            crossed.sort_by(|a, b| a.t.total_cmp(&b.t));
            if let Some(material) = solids.first_to_end(crossed, &rule) {
                return Answer::Exact(Some(material));
            }
        }
        Answer::Exact(solids.last())
    }

    /// The solids around an anchor, and how what is crossed near it counts.
    fn around(
        &mut self,
        plane: usize,
        anchor: [f64; 2],
        cross: &mut impl FnMut(&Ray, &mut Vec<CrossedSurface>) -> Answer<()>,
    ) -> Answer<(Solids, CapRule)> {
        let Caps { planes, crossed: [u, v, _], counted, .. } = self;
        let cut = &planes[plane];
        let from = cut.at(anchor);
        for (line, axis) in [&mut *u, &mut *v].into_iter().zip(cut.axes) {
            line.clear();
            let ray = Ray::new(from - cut.reach * axis, axis, 2.0 * cut.reach);
            if cross(&ray, line) == Answer::Blocked {
                return Answer::Blocked;
            }
            line.sort_by(|a, b| a.t.total_cmp(&b.t));
        }
        let rule = if u.len().max(v.len()) > CROSSED_MAX {
            CapRule { open: OpenMaterials::ALL, by_parity: false }
        } else {
            rule_of([u, v], counted)
        };
        let [by_u, by_v] = [u, v].map(|line| {
            let mut solids = Solids::default();
            follow(line, &rule, cut.reach, &mut solids);
            solids
        });
        if by_u.last().is_some() != by_v.last().is_some() {
            let nothing = CapRule { open: OpenMaterials::ALL, by_parity: false };
            return Answer::Exact((Solids::default(), nothing));
        }
        Answer::Exact((by_u, rule))
    }

    /// Counts a ray that met open parts.
    fn note(&mut self, open: &OpenMaterials) {
        if open.count == 0 {
            return;
        }
        self.open.rays += 1;
        for &material in open.named() {
            let list = &mut self.open.materials;
            if list.len() < 2 * OPEN_MAX && !list.contains(&material.into()) {
                list.push(material.into());
            }
        }
    }
}

/// Follows what is crossed before `end`.
fn follow(crossed: &[CrossedSurface], rule: &CapRule, end: f64, solids: &mut Solids) {
    for crossed in crossed.iter().take_while(|crossed| crossed.t < end) {
        if !rule.open.has(crossed.material) {
            solids.cross(crossed, rule.by_parity);
        }
    }
}

/// How the crossings of these lines count.
fn rule_of(lines: [&[CrossedSurface]; 2], counted: &mut Vec<u16>) -> CapRule {
    let mut rule = CapRule::default();
    loop {
        let before = rule.open.count;
        rule.by_parity = false;
        for line in lines {
            if is_oriented(line, &rule.open) {
                continue;
            }
            rule.by_parity = true;
            counted.clear();
            let materials = line.iter().map(|crossed| crossed.material);
            counted.extend(materials.filter(|&material| !rule.open.has(material)));
            counted.sort_unstable();
            for same in counted.chunk_by(|a, b| a == b).filter(|same| same.len() % 2 == 1) {
                if !rule.open.is_all() {
                    rule.open.add(same[0]);
                }
            }
        }
        if rule.open.count == before || rule.open.is_all() {
            return rule;
        }
    }
}

/// True when all solids that a line begins end, and none ends before it begins.
fn is_oriented(line: &[CrossedSurface], open: &OpenMaterials) -> bool {
    let mut depth = 0i64;
    let counted = line.iter().filter(|crossed| !open.has(crossed.material));
    let never_below = counted.map(|crossed| if crossed.begins { 1 } else { -1 }).all(|step| {
        depth += step;
        depth >= 0
    });
    never_below && depth == 0
}
