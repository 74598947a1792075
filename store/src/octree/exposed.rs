//! The area of a leaf that can be met from outside: that of the faces of its subvoxels behind which nothing stands.
//!
//! ```text
//!   . # #        set subvoxels #, faces behind which none is set |
//!   . #|.        with normal n, per side: sum of |n . face| over the faces that look its way
//! ```
//!
//! Projected on the normal, the stairs by which a slanted sheet is set have just the area of the sheet. What is hidden,
//! the end of a pipe within a flange, counts nothing. Where a leaf is full of sheets of which only edges show, hardly
//! any face looks along the normal: there, faces count by how much of the light of all directions comes to them from
//! a side.
//!
//! Invariant: an area is finite and not negative.

use super::LEAF_SIDE;
use super::node::{OctreeNode, Tree};
use super::payload::LeafNormal;

/// Area of a subvoxel's face, in squares of a leaf's side.
const FACE_AREA: f32 = 1.0 / (LEAF_SIDE * LEAF_SIDE) as f32;
/// Least share of the normals' mean by which a projected area is divided: what has a shorter mean than a half pipe is
/// clutter.
const FLATNESS_LEAST: f32 = 0.5;
/// Share of its area that a face among others shows to light of all directions: stairs that lie across a diagonal stand
/// in each other's way by so much.
const OPEN_SHARE: f32 = 0.73;
/// Bits between subvoxels that are next to each other along an axis.
const STEPS: [u32; 3] = [1, 4, 16];
/// The first layer of subvoxels across an axis.
const FIRST_LAYERS: [u64; 3] = [0x1111_1111_1111_1111, 0x000f_000f_000f_000f, 0xffff];

/// What stands behind the six faces of a node or a leaf: `2 * axis`, plus 1 for the upper face.
type Neighbours = [Option<u32>; 6];

/// Gives `take` the area of each leaf that can be met from its front and from its back, in squares of its side, in key
/// order.
pub(super) fn exposed_areas(
    tree: &Tree,
    normals: &[LeafNormal],
    bitmaps: &[u64],
    mut take: impl FnMut([f32; 2]),
) {
    let mut leaf = |leaf: u32, neighbours: Neighbours| {
        let behind = neighbours.map(|neighbour| neighbour.map_or(0, |leaf| bitmaps[leaf as usize]));
        take(sides(normals[leaf as usize], free_faces(bitmaps[leaf as usize], behind)));
    };
    descend(&tree.nodes, (0, [None; 6]), tree.levels.len(), &mut leaf);
}

/// Gives `leaf` the leaves below a node, `levels` levels down, each with its neighbours.
fn descend(
    nodes: &[OctreeNode],
    (node, around): (u32, Neighbours),
    levels: usize,
    leaf: &mut impl FnMut(u32, Neighbours),
) {
    let child_of = |node: u32, place: u32| nodes[node as usize].child(place);
    let mut left = nodes[node as usize].bits();
    while left != 0 {
        let place = left.trailing_zeros();
        left &= left - 1;
        let child = child_of(node, place).expect("its bit is set");
        let neighbours = std::array::from_fn(|face| {
            let (step, last) = (STEPS[face / 2], 3 * STEPS[face / 2]);
            match (face % 2 == 1, place & last) {
                (true, part) if part < last => child_of(node, place + step),
                (false, part) if part > 0 => child_of(node, place - step),
                // The other end of the node next to this one.
                _ => around[face].and_then(|next| child_of(next, place ^ last)),
            }
        });
        match levels {
            1 => leaf(child, neighbours),
            _ => descend(nodes, (child, neighbours), levels - 1, leaf),
        }
    }
}

/// Counts of the faces of the subvoxels of `bitmap` behind which nothing stands, by the way that they look; `behind`
/// are the bitmaps of the leaves next to it.
fn free_faces(bitmap: u64, behind: [u64; 6]) -> [u32; 6] {
    std::array::from_fn(|face| {
        let (step, first) = (STEPS[face / 2], FIRST_LAYERS[face / 2]);
        let covered = match face % 2 {
            0 => (bitmap << step) & !first | (behind[face] >> (3 * step)) & first,
            _ => (bitmap >> step) & !(first << (3 * step)) | (behind[face] & first) << (3 * step),
        };
        (bitmap & !covered).count_ones()
    })
}

/// Area of the front and of the back, in squares of the leaf's side.
fn sides(normal: LeafNormal, faces: [u32; 6]) -> [f32; 2] {
    let (n, flatness) = normal.unpack();
    let (mut projected, mut open) = ([0.0; 2], [0.0; 2]);
    for (face, count) in faces.into_iter().enumerate() {
        let sign = if face % 2 == 1 { 1.0 } else { -1.0 };
        let (cos, area) = (sign * n[face / 2], FACE_AREA * count as f32);
        projected[usize::from(cos < 0.0)] += cos.abs() * area;
        // Of the light of all directions a face gets this share from the half space of a side.
        open[0] += 0.5 * (1.0 + cos) * area;
        open[1] += 0.5 * (1.0 - cos) * area;
    }
    std::array::from_fn(|side| (projected[side] / flatness.max(FLATNESS_LEAST)).max(OPEN_SHARE * open[side]))
}

#[cfg(test)]
mod tests {
    use super::super::node::link;
    use super::*;
    use glam::Vec3;
    use std::collections::BTreeMap;

    /// Leaves of an octree of two levels, by their places, with their normals and bitmaps.
    type Leaves = BTreeMap<[u32; 3], (LeafNormal, u64)>;

    const SIDE: u32 = 16;

    /// The subvoxels that `is_set` names, in leaves of this normal.
    fn leaves_of(normal: LeafNormal, is_set: impl Fn([u32; 3]) -> bool) -> Leaves {
        let mut leaves = Leaves::new();
        for bit in 0..(4 * SIDE).pow(3) {
            let at = [bit, bit / (4 * SIDE), bit / (4 * SIDE).pow(2)].map(|v| v % (4 * SIDE));
            if is_set(at) {
                let [x, y, z] = at.map(|v| v % 4);
                leaves.entry(at.map(|v| v / 4)).or_insert((normal, 0)).1 |= 1 << (x + 4 * y + 16 * z);
            }
        }
        leaves
    }

    fn key(at: [u32; 3]) -> u32 {
        let part = |shift: u32| (0..3).map(|a| (at[a] >> shift & 3) << (2 * a)).sum::<u32>();
        part(2) << 6 | part(0)
    }

    /// Areas by the places of leaves.
    fn areas(leaves: &Leaves) -> BTreeMap<[u32; 3], [f32; 2]> {
        let mut order: Vec<_> = leaves.iter().collect();
        order.sort_by_key(|(at, _)| key(**at));
        let mut masks = vec![0u64];
        let mut last = None;
        for (at, _) in &order {
            let (node, place) = (key(**at) >> 6, key(**at) & 63);
            if last.replace(node) != Some(node) {
                masks[0] |= 1 << node;
                masks.push(0);
            }
            *masks.last_mut().unwrap() |= 1 << place;
        }
        let tree = link(&masks, 2, order.len()).unwrap();
        let normals: Vec<_> = order.iter().map(|(_, leaf)| leaf.0).collect();
        let bitmaps: Vec<_> = order.iter().map(|(_, leaf)| leaf.1).collect();
        let mut found = vec![];
        exposed_areas(&tree, &normals, &bitmaps, |areas| found.push(areas));
        order.iter().map(|(at, _)| **at).zip(found).collect()
    }

    fn sum(leaves: &Leaves) -> [f32; 2] {
        areas(leaves).values().fold([0.0; 2], |sum, found| [sum[0] + found[0], sum[1] + found[1]])
    }

    /// Stairs through all leaves, at any slant and one or two subvoxels thick, have their plane's area, or some more.
    #[test]
    fn a_slanted_sheet_has_the_area_of_its_plane() {
        for slant in [[0.0, 0.0], [0.25, 0.0], [0.5, 0.0], [0.3, 0.3], [-0.4, 0.2]] {
            let normal = Vec3::new(-slant[0], -slant[1], 1.0).normalize();
            let wanted = (SIDE * SIDE) as f32 / normal.z;
            for thick in [1, 2] {
                let leaves = leaves_of(LeafNormal::pack(normal, 1.0), |[x, y, z]| {
                    let height = 30.0 + slant[0] * (x as f32 - 32.0) + slant[1] * (y as f32 - 32.0);
                    (height as u32..height as u32 + thick).contains(&z)
                });
                for found in sum(&leaves) {
                    // Normals are packed to a degree; leaves of few bits show some more: the surface bounds them.
                    assert!(
                        (0.98..1.15).contains(&(found / wanted)),
                        "{slant:?} {thick}: {found}, not {wanted}"
                    );
                }
            }
        }
    }

    /// What stands within something else is met by nobody; what it stands in is met all round.
    #[test]
    fn hidden_faces_have_no_area() {
        let up = LeafNormal::pack(Vec3::Z, 1.0);
        let block = leaves_of(up, |at| at.iter().all(|v| (8..24).contains(v)));
        let found = areas(&block);
        assert_eq!(found[&[3, 3, 3]], [0.0; 2], "in the middle");
        assert_eq!(found[&[3, 3, 5]], [1.0, 0.0], "on top");
        assert_eq!(found[&[3, 3, 2]], [0.0, 1.0], "below");
        // Light of all directions comes in equal parts to either side of an edge of the block.
        let edge = found[&[2, 3, 3]];
        assert!((edge[0] - 0.5 * OPEN_SHARE).abs() < 1e-6 && edge[0] == edge[1], "{edge:?}");
    }

    /// A leaf that only its own subvoxels cover, against its faces counted one by one.
    #[test]
    fn free_faces_are_those_with_nothing_behind() {
        let mut state = 1u64;
        for _ in 0..200 {
            let mut draw = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                state ^ state >> 29
            };
            let (bitmap, behind) = (draw(), [(); 6].map(|()| draw()));
            let is_set = |at: [i32; 3]| {
                let outside = (0..3).find(|&a| !(0..4).contains(&at[a]));
                let map = outside.map_or(bitmap, |a| behind[2 * a + usize::from(at[a] == 4)]);
                map >> (0..3).map(|a| at[a].rem_euclid(4) << (2 * a)).sum::<i32>() & 1 == 1
            };
            let mut wanted = [0; 6];
            for bit in 0..64 {
                let at = [bit & 3, bit >> 2 & 3, bit >> 4];
                for (face, wanted) in wanted.iter_mut().enumerate().filter(|_| is_set(at)) {
                    let mut next = at;
                    next[face / 2] += if face % 2 == 1 { 1 } else { -1 };
                    *wanted += u32::from(!is_set(next));
                }
            }
            assert_eq!(free_faces(bitmap, behind), wanted);
        }
    }
}
