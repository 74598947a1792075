//! Where the parts of the plant stand: a hall around a grid of bays, each with a rack of pipes, a tank, pumps.
//!
//! ```text
//!   a bay from above (12 m x 12 m):   y 12  tank and vessel
//!                                        7  pumps
//!                                      3-6  rack: four decks of pipes along x, drops to tank and pumps
//!                                      0-3  aisle, free up to the first deck
//! ```
//!
//! Invariants: 1. a bay's parts depend on the seed and its place only; 2. the hall has a floor, a roof, three
//! walls and is open at y = 0; 3. no bay part stands in the aisle below [`AISLE_HEIGHT`].

use super::palette::*;
use super::parts::{Part, Shape};
use crate::dice::Dice;
use trex_store::Aabb;

/// Side of a bay, metres.
pub(super) const BAY: f64 = 12.0;
/// Free height of the aisles.
pub(super) const AISLE_HEIGHT: f64 = 2.8;
/// Ceiling lamps of the hall, whatever its size.
pub(super) const LAMPS: u64 = 11;
/// Part of the floor's area that the lamps have in all.
const LAMP_SHARE: f64 = 0.05;
/// Heights of the rack's decks.
const DECKS: [f64; 4] = [3.2, 4.4, 5.6, 6.8];

/// A plant of `bays` columns and rows.
#[derive(Clone, Debug)]
pub(super) struct Plant {
    pub(super) seed: u64,
    pub(super) bays: [u64; 2],
}

impl Plant {
    /// Extent of the floor along x and y.
    pub(super) fn floor(&self) -> [f64; 2] {
        self.bays.map(|count| count as f64 * BAY)
    }

    /// Height of the ceiling: large halls are higher, so that their lamps reach far and a view from below the
    /// roof sees into the distance.
    pub(super) fn height(&self) -> f64 {
        let [width, depth] = self.floor();
        (0.22 * (width * depth).sqrt()).max(11.0)
    }

    /// Holds all parts: walls stand 1 m off the floor's edge, flanges reach a little further, and columns of large
    /// halls further still; a whole number of metres, which f32 corners do not round past.
    pub(super) fn bounds(&self) -> Aabb {
        let ([w, d], h, aside) = (self.floor(), self.height(), self.beam().ceil().max(2.0));
        Aabb { lo: [-aside, -aside, -1.0], hi: [w + aside, d + aside, h + 1.0] }
    }

    /// Width of the beams that carry the roof; columns are twice as wide.
    pub(super) fn beam(&self) -> f64 {
        (0.02 * self.height()).max(0.2)
    }

    /// Count of groups of parts: the hall and each bay.
    pub(super) fn group_count(&self) -> u64 {
        1 + self.bays[0] * self.bays[1]
    }

    /// Replaces `parts` with those of one group. Group 0 is the hall.
    pub(super) fn group(&self, index: u64, parts: &mut Vec<Part>) {
        parts.clear();
        if index == 0 {
            self.hall(parts);
            return;
        }
        // Back and forth, so that neighbours in the stream are neighbours in space.
        let (row, along) = ((index - 1) / self.bays[0], (index - 1) % self.bays[0]);
        let column = if row % 2 == 0 { along } else { self.bays[0] - 1 - along };
        let mut bay =
            Bay { at: [column as f64 * BAY, row as f64 * BAY], dice: Dice::new(self.seed, index), parts };
        bay.rack();
        bay.pipes();
        bay.tank();
        bay.pumps();
        bay.ladder();
    }

    fn hall(&self, parts: &mut Vec<Part>) {
        let ([w, d], h) = (self.floor(), self.height());
        let thick = 0.3;
        let mut block = |lo, hi, material| parts.push(Part { shape: Shape::Block { lo, hi }, material });
        block([-1.0, -1.0, -thick], [w + 1.0, d + 1.0, 0.0], CONCRETE);
        block([-1.0, -1.0, h], [w + 1.0, d + 1.0, h + thick], ROOF);
        block([-1.0, -1.0, 0.0], [-1.0 + thick, d + 1.0, h], WALL);
        block([w + 1.0 - thick, -1.0, 0.0], [w + 1.0, d + 1.0, h], WALL);
        block([-1.0, d + 1.0 - thick, 0.0], [w + 1.0, d + 1.0, h], WALL);
        // Trusses below the roof: chords along y and x.
        let beam = self.beam();
        for i in 0..=self.bays[0].min(40) {
            let x = w * i as f64 / self.bays[0].min(40) as f64;
            block([x - 0.5 * beam, 0.0, h - 3.0 * beam], [x + 0.5 * beam, d, h - 2.0 * beam], STEEL);
            for y in [0.0, d] {
                block([x - beam, y - 0.5 * beam, 0.0], [x + beam, y + 0.5 * beam, h - 3.0 * beam], STEEL);
            }
        }
        for i in 0..=2 * self.bays[1].min(40) {
            let y = d * i as f64 / (2 * self.bays[1].min(40)) as f64;
            block([0.0, y - 0.3 * beam, h - 2.0 * beam], [w, y + 0.3 * beam, h - 1.5 * beam], STEEL);
        }
        self.lamps(parts, h - 4.0 * beam);
    }

    /// Four, three and four lamps in three rows.
    fn lamps(&self, parts: &mut Vec<Part>, z: f64) {
        let [w, d] = self.floor();
        let area = LAMP_SHARE * w * d / LAMPS as f64;
        let half = [0.5 * (2.0 * area).sqrt(), 0.5 * (0.5 * area).sqrt()];
        for (row, count) in [4, 3, 4].into_iter().enumerate() {
            for i in 0..count {
                let center = [w * (f64::from(i) + 0.5) / f64::from(count), d * (row as f64 + 0.5) / 3.0];
                let lo = [center[0] - half[0], center[1] - half[1]];
                let hi = [center[0] + half[0], center[1] + half[1]];
                parts.push(Part { shape: Shape::Lamp { lo, hi, z }, material: LAMP });
            }
        }
    }
}

/// One bay while its parts are laid.
struct Bay<'a> {
    at: [f64; 2],
    dice: Dice,
    parts: &'a mut Vec<Part>,
}

impl Bay<'_> {
    /// Adds a part given in the bay's own coordinates.
    fn add(&mut self, shape: Shape, material: u32) {
        let moved = |p: [f64; 3]| [p[0] + self.at[0], p[1] + self.at[1], p[2]];
        let shape = match shape {
            Shape::Block { lo, hi } => Shape::Block { lo: moved(lo), hi: moved(hi) },
            Shape::Pipe { from, axis, length, radius } => {
                Shape::Pipe { from: moved(from), axis, length, radius }
            }
            Shape::Disc { from, axis, length, radius } => {
                Shape::Disc { from: moved(from), axis, length, radius }
            }
            Shape::Tank { from, axis, length, radius } => {
                Shape::Tank { from: moved(from), axis, length, radius }
            }
            Shape::Bolt { from, axis, size } => Shape::Bolt { from: moved(from), axis, size },
            Shape::Elbow { center, axes, bend, radius } => {
                Shape::Elbow { center: moved(center), axes, bend, radius }
            }
            lamp @ Shape::Lamp { .. } => lamp,
        };
        self.parts.push(Part { shape, material });
    }

    fn block(&mut self, lo: [f64; 3], hi: [f64; 3], material: u32) {
        self.add(Shape::Block { lo, hi }, material);
    }

    fn paint(&mut self) -> u32 {
        PAINTS + self.dice.below(u64::from(PAINT_COUNT)) as u32
    }

    /// Legs, beams and a grating walk on the second deck.
    fn rack(&mut self) {
        for x in [0.15, 6.0] {
            for y in [3.2, 5.8] {
                self.block([x - 0.1, y - 0.1, 0.0], [x + 0.1, y + 0.1, DECKS[3] + 0.6], STEEL);
                self.block([x - 0.25, y - 0.25, 0.0], [x + 0.25, y + 0.25, 0.03], STEEL);
                for corner in [[-0.2, -0.2], [0.2, -0.2], [-0.2, 0.2], [0.2, 0.2]] {
                    let from = [x + corner[0], y + corner[1], 0.03];
                    self.add(Shape::Bolt { from, axis: 2, size: 0.025 }, BOLT);
                }
            }
            for z in DECKS {
                self.block([x - 0.08, 2.9, z - 0.35], [x + 0.08, 6.1, z - 0.2], STEEL);
            }
        }
        for z in DECKS {
            for y in [3.2, 5.8] {
                self.block([0.0, y - 0.06, z - 0.2], [BAY, y + 0.06, z - 0.1], STEEL);
            }
        }
        for step in 0..12 {
            let x = f64::from(step);
            self.block([x + 0.05, 6.2, DECKS[1] - 0.05], [x + 0.95, 7.0, DECKS[1]], GRATING);
        }
        for z in [0.5, 1.0] {
            let from = [0.0, 7.0, DECKS[1] + z];
            self.add(Shape::Pipe { from, axis: 0, length: BAY, radius: 0.025 }, RAIL);
        }
    }

    /// Runs along x on each deck, with flanges; some leave the deck through elbows to the ground.
    fn pipes(&mut self) {
        for deck in DECKS {
            let mut y = 3.45;
            while y < 5.6 {
                let radius = self.dice.range(0.04, 0.17);
                let paint = self.paint();
                y += radius;
                if self.dice.below(5) == 0 {
                    self.dropped_run([y, deck], radius, paint);
                } else {
                    self.add(Shape::Pipe { from: [0.0, y, deck], axis: 0, length: BAY, radius }, paint);
                    let x = self.dice.range(1.0, 11.0);
                    self.flange([x, y, deck], 0, radius);
                }
                y += radius + self.dice.range(0.08, 0.2);
            }
        }
    }

    /// A run that ends in a drop: pipe, elbow, pipe down, elbow, pipe to the pumps.
    fn dropped_run(&mut self, [y, deck]: [f64; 2], radius: f64, paint: u32) {
        let (bend, x) = (3.0 * radius, self.dice.range(2.0, 10.0));
        let [turn, low] = [x - bend, 0.4 + self.dice.range(0.0, 0.6)];
        self.add(Shape::Pipe { from: [0.0, y, deck], axis: 0, length: turn, radius }, paint);
        let [px, pz] = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]];
        self.add(Shape::Elbow { center: [turn, y, deck - bend], axes: [pz, px], bend, radius }, paint);
        let from = [x, y, low + bend];
        self.add(Shape::Pipe { from, axis: 2, length: deck - bend - low - bend, radius }, paint);
        self.flange([x, y, 0.5 * (low + deck)], 2, radius);
        let back = [[0.0, -1.0, 0.0], [0.0, 0.0, -1.0]];
        self.add(Shape::Elbow { center: [x, y + bend, low + bend], axes: back, bend, radius }, paint);
        self.add(Shape::Pipe { from: [x, y + bend, low], axis: 1, length: 7.0 - y - bend, radius }, paint);
        self.flange([x, 6.6, low], 1, radius);
    }

    /// Two discs with a ring of bolts, around a pipe.
    fn flange(&mut self, at: [f64; 3], axis: usize, radius: f64) {
        let (outer, thick) = (1.5 * radius + 0.03, 0.2 * radius + 0.015);
        for side in [-1.0, 1.0] {
            let mut from = at;
            from[axis] += if side < 0.0 { -1.1 * thick } else { 0.1 * thick };
            self.add(Shape::Disc { from, axis, length: thick, radius: outer }, FLANGE);
        }
        let count = if radius > 0.1 { 8 } else { 6 };
        let size = 0.09 * radius + 0.004;
        for i in 0..count {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(count);
            let mut from = at;
            let ring = 0.5 * (outer + radius);
            from[axis] += 1.1 * thick;
            from[(axis + 1) % 3] += ring * angle.cos();
            from[(axis + 2) % 3] += ring * angle.sin();
            self.add(Shape::Bolt { from, axis, size }, BOLT);
        }
    }

    /// A standing tank or a lying vessel on saddles, with a nozzle.
    fn tank(&mut self) {
        let radius = self.dice.range(1.1, 1.7);
        let coat = match self.dice.below(6) {
            0 => CHROME,
            1 => BRASS_MIRROR,
            _ => TANKS + self.dice.below(u64::from(TANK_COUNT)) as u32,
        };
        let (x, y) = (self.dice.range(2.5, 9.0), 9.6);
        if self.dice.below(3) == 0 {
            let z = radius + 0.8;
            self.add(Shape::Tank { from: [1.0, y, z], axis: 0, length: 10.0, radius }, coat);
            for x in [2.6, 9.4] {
                self.block([x - 0.15, y - 0.8 * radius, 0.0], [x + 0.15, y + 0.8 * radius, 1.4], CONCRETE);
            }
            self.nozzle([6.0, y, z + 0.97 * radius]);
        } else {
            let length = self.dice.range(4.5, 7.5);
            self.add(Shape::Tank { from: [x, y, 0.6], axis: 2, length, radius }, coat);
            for [dx, dy] in [[-0.6, -0.6], [0.6, -0.6], [-0.6, 0.6], [0.6, 0.6]] {
                let [lx, ly] = [x + dx * radius, y + dy * radius];
                self.block([lx - 0.08, ly - 0.08, 0.0], [lx + 0.08, ly + 0.08, 1.0], STEEL);
            }
            self.nozzle([x, y, 0.57 + length]);
        }
    }

    fn nozzle(&mut self, at: [f64; 3]) {
        let paint = self.paint();
        self.add(Shape::Pipe { from: at, axis: 2, length: 0.6, radius: 0.16 }, paint);
        self.flange([at[0], at[1], at[2] + 0.4], 2, 0.16);
        let center = [at[0], at[1] - 0.45, at[2] + 0.6];
        let axes = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        self.add(Shape::Elbow { center, axes, bend: 0.45, radius: 0.16 }, paint);
        let length = center[1] - 5.9;
        let from = [at[0], 5.9, center[2] + 0.45];
        self.add(Shape::Pipe { from, axis: 1, length, radius: 0.16 }, paint);
    }

    fn pumps(&mut self) {
        for x in [1.8, 5.8, 9.8] {
            let x = x + self.dice.range(-0.6, 0.6);
            self.block([x - 0.4, 6.9, 0.0], [x + 1.1, 7.7, 0.18], CONCRETE);
            self.block([x - 0.3, 7.0, 0.18], [x + 1.0, 7.6, 0.26], STEEL);
            self.add(Shape::Disc { from: [x - 0.2, 7.3, 0.6], axis: 0, length: 0.7, radius: 0.26 }, MOTOR);
            self.add(Shape::Disc { from: [x + 0.5, 7.3, 0.6], axis: 0, length: 0.15, radius: 0.08 }, STEEL);
            self.add(Shape::Disc { from: [x + 0.65, 7.3, 0.6], axis: 0, length: 0.25, radius: 0.3 }, FLANGE);
            for corner in [[-0.25, 7.05], [0.95, 7.05], [-0.25, 7.55], [0.95, 7.55]] {
                self.add(Shape::Bolt { from: [x + corner[0], corner[1], 0.26], axis: 2, size: 0.018 }, BOLT);
            }
        }
    }

    /// From the ground to the walk.
    fn ladder(&mut self) {
        let x = self.dice.range(3.0, 9.0);
        for side in [x, x + 0.45] {
            self.add(Shape::Pipe { from: [side, 7.1, 0.0], axis: 2, length: 5.4, radius: 0.025 }, RAIL);
        }
        for rung in 1..18 {
            let from = [x, 7.1, 0.3 * f64::from(rung)];
            self.add(Shape::Pipe { from, axis: 0, length: 0.45, radius: 0.012 }, RAIL);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trex_store::TriangleBatch;

    #[test]
    fn halls_of_all_sizes_are_within_bounds() {
        for bays in [[1, 1], [5, 4], [49, 32], [400, 300]] {
            let plant = Plant { seed: 1, bays };
            let (mut parts, mut out) = (Vec::new(), TriangleBatch::default());
            plant.group(0, &mut parts);
            parts.iter().for_each(|part| part.tessellate(0, &mut out));
            let Aabb { lo, hi } = plant.bounds();
            for corner in out.corners.as_flattened() {
                assert!((0..3).all(|a| (lo[a]..=hi[a]).contains(&corner[a])), "{bays:?}: {corner:?}");
            }
        }
    }

    #[test]
    fn aisles_are_free() {
        let plant = Plant { seed: 1, bays: [5, 4] };
        let (mut parts, mut out) = (Vec::new(), TriangleBatch::default());
        for group in 1..plant.group_count() {
            plant.group(group, &mut parts);
            out.clear();
            for part in &parts {
                part.tessellate(3, &mut out);
            }
            for corner in out.corners.as_flattened() {
                let y = corner[1] % BAY;
                assert!(corner[2] >= AISLE_HEIGHT || (2.8..BAY).contains(&y), "{corner:?}");
            }
        }
    }
}
