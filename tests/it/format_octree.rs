//! The upper octree, read from `docs/format.md` alone and held against the triangles of the same file: overlap in exact
//! integers, by another way than the store's; areas, normals and materials from triangles cut at the sides of a leaf.
//!
//! Coordinates of the oracle are half lattice steps from the cube's corner: sides of voxels are even, vertices odd.

use crate::fixtures::model_with;
use crate::format::{Model, Reader, read};
use crate::format_surface::{FrontSurface, front_surface};
use crate::format_units;
use crate::oracle::overlap::{Triangle, cells, cut, ends, length, overlap};
use crate::support::Built;
use std::collections::BTreeMap;
use trex_store::Budget;
use trex_store::build::Voxels;
use trex_store::octree::Refinement;

const BLOCK_BYTES: usize = 65536;
/// Bytes of a word of each stream: masks, bitmaps, normals, areas, materials.
const WORD_BYTES: [usize; 5] = [8, 8, 2, 1, 2];

/// Section 5 as words; whether they make sense is another question.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Upper {
    pub(crate) resolution: u64,
    pub(crate) leaf_count: u64,
    pub(crate) facet_count: u64,
    pub(crate) subvoxel_steps: u64,
    pub(crate) lo: [u64; 3],
    pub(crate) node_count: u64,
    /// Masks, bitmaps, normals, areas, materials.
    pub(crate) streams: [Vec<u64>; 5],
}

impl Upper {
    pub(crate) fn read(bytes: &[u8]) -> Upper {
        let mut r = Reader { bytes, at: 0 };
        let [resolution, leaf_count, facet_count] = [4; 3].map(|width| r.number(width));
        let subvoxel_steps = r.number(8);
        let lo = [8; 3].map(|width| r.number(width));
        let node_count = r.number(8);
        let counts = [node_count, leaf_count, leaf_count, leaf_count, leaf_count];
        let streams = std::array::from_fn(|stream| {
            let (mut words, width) = (Vec::new(), WORD_BYTES[stream]);
            while words.len() < counts[stream] as usize {
                let count = (counts[stream] as usize - words.len()).min(BLOCK_BYTES / width);
                let packed = r.number(4) as usize;
                let planes = miniz_oxide::inflate::decompress_to_vec(&bytes[r.at..r.at + packed]).unwrap();
                r.at += packed;
                assert_eq!(planes.len(), count * width);
                let byte = |i: usize, p: usize| u64::from(planes[p * count + i]) << (8 * p);
                let word = |i: usize| -> u64 { (0..width).map(|p| byte(i, p)).sum() };
                words.extend((0..count).map(word));
            }
            words
        });
        assert_eq!(r.at, bytes.len(), "bytes behind the last stream");
        Upper { resolution, leaf_count, facet_count, subvoxel_steps, lo, node_count, streams }
    }

    /// The section of these words, for those who forge one.
    pub(crate) fn to_bytes(&self) -> Vec<u8> {
        let mut bytes = Vec::new();
        for number in [self.resolution, self.leaf_count, self.facet_count] {
            bytes.extend((number as u32).to_le_bytes());
        }
        for number in [self.subvoxel_steps, self.lo[0], self.lo[1], self.lo[2], self.node_count] {
            bytes.extend(number.to_le_bytes());
        }
        for (words, width) in self.streams.iter().zip(WORD_BYTES) {
            for block in words.chunks(BLOCK_BYTES / width) {
                let plane = |p: usize| block.iter().map(move |word| word.to_le_bytes()[p]);
                let planes: Vec<u8> = (0..width).flat_map(plane).collect();
                let packed = miniz_oxide::deflate::compress_to_vec(&planes, 3);
                bytes.extend((packed.len() as u32).to_le_bytes());
                bytes.extend(packed);
            }
        }
        bytes
    }

    /// Places of the leaves in their order, from the root down.
    pub(crate) fn places(&self) -> Vec<[i64; 3]> {
        let levels = match self.resolution {
            64 => 3,
            256 => 4,
            512 | 1024 => 5,
            other => panic!("a resolution of {other}"),
        };
        let mut masks = self.streams[0].iter();
        let mut level = vec![[0i64; 3]];
        for _ in 0..levels {
            let mut below = Vec::new();
            for at in level {
                let mask = *masks.next().expect("a mask for each child");
                assert_ne!(mask, 0);
                let child = |place: i64| [place & 3, place >> 2 & 3, place >> 4];
                let there = (0..64).filter(|place| mask >> place & 1 == 1).map(child);
                below.extend(there.map(|step| [0, 1, 2].map(|a| 4 * at[a] + step[a])));
            }
            level = below;
        }
        assert!(masks.next().is_none(), "masks that nobody asks for");
        assert_eq!(level.len() as u64, self.leaf_count);
        assert!(level.as_flattened().iter().all(|&v| v < self.resolution as i64), "a leaf beside the model");
        level
    }
}

/// What the direction of a normal's word is, times 62: in integers.
fn direction(word: u64) -> [f32; 3] {
    let [u, v] = [word & 63, word >> 6 & 63].map(|k| 2 * k as i32 - 62);
    let z = 62 - u.abs() - v.abs();
    let fold = |k: i32| match (z >= 0, k >= 0) {
        (true, _) => k,
        (false, true) => k + z,
        (false, false) => k - z,
    };
    [fold(u), fold(v), z].map(|k| k as f32)
}

/// Which facet of its node a leaf with this normal belongs to.
fn facet(word: u64) -> usize {
    let n = direction(word);
    let longest = n.iter().fold(0f32, |most, v| most.max(v.abs()));
    let axis = n.iter().position(|v| v.abs() == longest).unwrap();
    2 * axis + usize::from(n[axis] < 0.0)
}

fn area(word: u64) -> f64 {
    2f64.powi((word >> 4) as i32 - 10) * (1.0 + (word & 15) as f64 / 16.0)
}

/// Area of each facet that is there, in order.
fn facet_areas(upper: &Upper, places: &[[i64; 3]]) -> Vec<[f64; 2]> {
    let [_, bitmaps, normals, areas, _] = &upper.streams;
    let maps: BTreeMap<[i64; 3], u64> = places.iter().copied().zip(bitmaps.iter().copied()).collect();
    // Of each facet: the area of the surface, and what is exposed of its front and of its back.
    let mut nodes: Vec<([i64; 3], [[f64; 3]; 6])> = Vec::new();
    for (leaf, at) in places.iter().enumerate() {
        let node = at.map(|v| v / 4);
        if nodes.last().is_none_or(|last| last.0 != node) {
            nodes.push((node, [[0.0; 3]; 6]));
        }
        let least = 0.6 / 16.0 * f64::from(bitmaps[leaf].count_ones());
        let sums = &mut nodes.last_mut().unwrap().1[facet(normals[leaf])];
        let [front, back] = exposed(&maps, *at, normals[leaf]);
        let here = [area(areas[leaf]).max(least), front, back];
        sums.iter_mut().zip(here).for_each(|(sum, here)| *sum += here);
    }
    let facets = nodes.iter().flat_map(|node| node.1).filter(|sums| sums[0] > 0.0);
    facets.map(|[own, front, back]| [front, back].map(|side| side.clamp(own / 16.0, own))).collect()
}

/// Area of the front and of the back of the leaf `at` that nothing covers: subvoxel by subvoxel.
fn exposed(maps: &BTreeMap<[i64; 3], u64>, at: [i64; 3], normal: u64) -> [f64; 2] {
    let is_set = |q: [i64; 3]| {
        let bit = q[0].rem_euclid(4) + 4 * q[1].rem_euclid(4) + 16 * q[2].rem_euclid(4);
        maps.get(&q.map(|v| v.div_euclid(4))).is_some_and(|map| map >> bit & 1 == 1)
    };
    let along = direction(normal).map(f64::from);
    let flatness = (normal >> 12) as f64 / 15.0;
    let (mut projected, mut open) = ([0.0; 2], [0.0; 2]);
    for q in cells(at.map(|v| 4 * v), at.map(|v| 4 * v + 3)).filter(|&q| is_set(q)) {
        for (axis, step) in [(0, -1), (0, 1), (1, -1), (1, 1), (2, -1), (2, 1)] {
            let mut next = q;
            next[axis] += step;
            if is_set(next) {
                continue;
            }
            let cos = if flatness > 0.0 { step as f64 * along[axis] / length(along) } else { 0.0 };
            projected[usize::from(cos < 0.0)] += cos.abs() / 16.0;
            (0..2).for_each(|side| open[side] += 0.5 * (1.0 + [cos, -cos][side]) / 16.0);
        }
    }
    [0, 1].map(|side| (projected[side] / flatness.max(0.5)).max(0.73 * open[side]))
}

/// What the triangles leave in a leaf. Areas in squares of its side.
#[derive(Default)]
pub(crate) struct LeafRecord {
    bitmap: u64,
    /// Per material.
    areas: BTreeMap<u64, f64>,
    /// Sum of unit normals times area.
    normal: [f64; 3],
    /// Sum of the products of their components, times area.
    moments: [[f64; 3]; 3],
}

/// The leaves that `is_asked` for, from the triangles one by one.
fn touched(
    model: &Model<'_>,
    upper: &Upper,
    is_asked: &dyn Fn([i64; 3]) -> bool,
) -> BTreeMap<[i64; 3], LeafRecord> {
    let side = 2 * upper.subvoxel_steps as i64;
    let leaf_side = 4 * side;
    let mut leaves: BTreeMap<[i64; 3], LeafRecord> = BTreeMap::new();
    for (corners, material) in &model.triangles {
        let triangle = corners.map(|q| [0, 1, 2].map(|a| 2 * (q[a] as i64 - upper.lo[a] as i64) + 1));
        let (lo, hi) = ends(&triangle);
        for at in cells(lo.map(|v| v / leaf_side), hi.map(|v| v / leaf_side)).filter(|&at| is_asked(at)) {
            let origin = at.map(|v| v * leaf_side);
            if overlap(&triangle, origin, leaf_side) {
                leaves.entry(at).or_default().add(&triangle, *material, (origin, side));
            }
        }
    }
    leaves
}

/// What the triangles leave in the leaf at one place; nothing where they do not touch it.
pub(crate) fn touched_at(model: &Model<'_>, upper: &Upper, at: [i64; 3]) -> LeafRecord {
    let side = 2 * upper.subvoxel_steps as i64;
    let origin = at.map(|v| v * 4 * side);
    let mut leaf = LeafRecord::default();
    for (corners, material) in &model.triangles {
        let triangle = corners.map(|q| [0, 1, 2].map(|a| 2 * (q[a] as i64 - upper.lo[a] as i64) + 1));
        if overlap(&triangle, origin, 4 * side) {
            leaf.add(&triangle, *material, (origin, side));
        }
    }
    leaf
}

impl LeafRecord {
    fn surface(&self) -> Option<FrontSurface> {
        front_surface((self.areas.values().sum(), self.normal), &self.moments, self.bitmap)
    }

    /// A triangle that touches the leaf whose least corner is `origin`, of subvoxels of `side`.
    fn add(&mut self, triangle: &Triangle, material: u64, (origin, side): ([i64; 3], i64)) {
        for step in cells([0; 3], [3; 3]) {
            let corner = [0, 1, 2].map(|a| origin[a] + step[a] * side);
            let is_set = overlap(triangle, corner, side);
            self.bitmap |= u64::from(is_set) << (step[0] + 4 * step[1] + 16 * step[2]);
        }
        // Half of the cross product: as long as the area, as the triangle looks.
        let inside = cut(triangle, origin, 4 * side).map(|v| v / ((4 * side) as f64).powi(2));
        *self.areas.entry(material).or_default() += length(inside);
        (0..3).for_each(|a| self.normal[a] += inside[a]);
        let area = length(inside).max(f64::MIN_POSITIVE);
        cells([0; 3], [2, 2, 0]).for_each(|[a, b, _]| {
            let [a, b] = [a as usize, b as usize];
            self.moments[a][b] += inside[a] * inside[b] / area;
        });
    }
}

/// Builds `spec`, reads the octree of the file and compares one of `every` leaves with the triangles, all with the
/// store.
pub(crate) fn check(spec: &str, (resolution, factor): (u32, u32), every: i64) {
    let refinement = Refinement::from_factor(factor).unwrap();
    let voxels = match factor {
        1 => Voxels::Resolution(resolution),
        _ => Voxels::Refined { upper: resolution, refinement },
    };
    let built = model_with(spec, voxels);
    let bytes = std::fs::read(built.file.path()).unwrap();
    let model = read(&bytes);
    let (item_count, section) = model.upper.expect("an octree was asked for");
    let upper = Upper::read(section);
    assert!(upper.to_bytes() == section, "{spec}: our own writer disagrees");
    assert_eq!((upper.resolution, upper.leaf_count), (u64::from(resolution), item_count), "{spec}");
    let [lo, hi] = model.lattice_box;
    let points = (0..3).map(|a| hi[a] - lo[a] + 1).max().unwrap();
    let steps = points.div_ceil(4 * upper.resolution).next_multiple_of(u64::from(factor));
    assert_eq!((upper.lo, upper.subvoxel_steps), (lo, steps), "{spec}");

    let places = upper.places();
    let is_asked = |at: [i64; 3]| (at[0] * 7919 + at[1] * 104_729 + at[2] * 1_299_709) % every == 0;
    let mut expected = touched(&model, &upper, &is_asked);
    for (leaf, at) in places.iter().enumerate().filter(|(_, at)| is_asked(**at)) {
        let found = upper.streams.each_ref().map(|words| words.get(leaf).copied().unwrap_or(0));
        let truth = expected.remove(at).unwrap_or_else(|| panic!("{spec}: no triangle is in leaf {at:?}"));
        let leaf = format!("{spec}, leaf {at:?}");
        check_area(&leaf, found[3], &truth);
        check_leaf(&leaf, &model, [found[1], found[2], found[4]], &truth);
    }
    assert!(
        expected.is_empty(),
        "{spec}: {} leaves are missing: {:?}",
        expected.len(),
        expected.keys().next()
    );

    check_store(spec, &built, &upper, &facet_areas(&upper, &places));
    format_units::check(spec, (&built, &model), &upper, every);
}

/// What the store has read of the same bytes.
fn check_store(spec: &str, built: &Built, upper: &Upper, facets: &[[f64; 2]]) {
    assert_eq!(facets.len() as u64, upper.facet_count, "{spec}");
    let (octree, _) = built.file.upper(&Budget::unlimited()).unwrap().unwrap();
    let [masks, bitmaps, normals, _, materials] = &upper.streams;
    assert!(octree.nodes().iter().map(|node| node.bits()).eq(masks.iter().copied()), "{spec}: masks");
    assert!(octree.bitmaps() == bitmaps, "{spec}: bitmaps");
    for (leaf, (&word, &material)) in normals.iter().zip(materials).enumerate() {
        let voxel = octree.leaf(leaf);
        let along = direction(word).map(f64::from);
        let mean = length(voxel.normal.map(f64::from));
        let cos: f64 = (0..3).map(|a| f64::from(voxel.normal[a]) * along[a] / length(along)).sum();
        assert_eq!(mean > 0.5, word >> 12 > 0, "{spec}: the normal of leaf {leaf}");
        assert!((cos - mean).abs() < 1e-5, "{spec}: the normal of leaf {leaf}");
        assert!((f64::from(voxel.flatness) - (word >> 12) as f64 / 15.0).abs() < 1e-6);
        assert_eq!(u64::from(voxel.material), material, "{spec}: the material of leaf {leaf}");
    }
    for (side, &area) in facets.iter().flatten().enumerate() {
        assert!(
            (f64::from(octree.facets().side_area(side)) / area - 1.0).abs() < 1e-5,
            "{spec}: side {side}"
        );
    }
}

/// The area of a leaf and what the triangles say.
fn check_area(leaf: &str, word: u64, truth: &LeafRecord) {
    // Four bits behind the point: at most a 32nd of it off. The sums are kept in f32.
    let covered: f64 = truth.areas.values().sum();
    let found = area(word);
    let is_near = |wanted: f64| (found / wanted.clamp(area(0), area(255)) - 1.0).abs() < 1.0 / 32.0 + 1e-3;
    match truth.surface().filter(|_| covered > 1e-6) {
        Some(shown) => {
            assert!(
                shown.areas.iter().any(|&area| is_near(area)),
                "{leaf}: area {found}, not {:?}",
                shown.areas
            );
        }
        None => assert!(is_near(found.clamp(0.5 * covered, covered)), "{leaf}: area {found} of {covered}"),
    }
}

/// One leaf, its bitmap, normal and material, and what the triangles say.
pub(crate) fn check_leaf(
    leaf: &str,
    model: &Model<'_>,
    [bitmap, normal, material]: [u64; 3],
    truth: &LeafRecord,
) {
    assert_eq!(bitmap, truth.bitmap, "{leaf}: {bitmap:016x}, not {:016x}", truth.bitmap);
    let covered: f64 = truth.areas.values().sum();
    let most = truth.areas.values().fold(0f64, |most, &area| most.max(area));
    let own =
        truth.areas.get(&material).unwrap_or_else(|| panic!("{leaf}: material {material} is not in it"));
    assert!(material < model.material_count && *own >= most * (1.0 - 1e-4), "{leaf}: material {material}");
    // What is grazed has an area of rounding errors.
    if covered < 1e-9 {
        return;
    }
    // One step at least where a normal is known.
    let Some(shown) = truth.surface() else { return };
    let flat = (normal >> 12) as f64 / 15.0;
    let is_near = (flat - shown.flatness.max(1.0 / 15.0)).abs() < 0.5 / 15.0 + 1e-3;
    assert!(is_near, "{leaf}: a mean as long as {flat}, not {}", shown.flatness);
    let along = direction(normal).map(f64::from);
    let cos: f64 = (0..3).map(|a| along[a] * shown.normal[a]).sum::<f64>() / length(along);
    // Sheets that cancel have no front.
    let front: f64 = (0..3).map(|a| shown.normal[a] * truth.normal[a]).sum();
    let cos = if front.abs() < 1e-3 * covered { cos.abs() } else { cos };
    assert!(cos > 4f64.to_radians().cos(), "{leaf}: looks along {along:?}, not {:?}", shown.normal);
}

#[test]
fn octrees_hold_what_the_triangles_touch() {
    // Smooth; plates and bolts of many materials; slivers and needles far from the origin.
    check("gen:isosurface:10k:3", (64, 1), 1);
    check("gen:pipes:10k:3", (64, 1), 1);
    check("gen:soup:10k:3", (64, 1), 10);
}

#[test]
fn octrees_of_all_depths_hold_what_the_triangles_touch() {
    check("gen:pipes:30k:3", (256, 1), 50);
    // One octant of the cube of 1024.
    check("gen:scan:10k:2", (512, 1), 400);
    check("gen:scan:10k:2", (1024, 1), 2000);
}

#[test]
fn units_hold_what_the_triangles_touch() {
    check("gen:isosurface:10k:3", (64, 4), 500);
    check("gen:pipes:10k:2", (64, 4), 500);
    // Units that nest.
    check("gen:scan:10k:2", (64, 16), 20_000);
}
