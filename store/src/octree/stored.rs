//! The octree as it stands on disk: its head and blocks, and the gate through which it is read.
//!
//! ```text
//! head 52 bytes | streams, each in Deflate blocks of 64 KiB: masks, bitmaps, normals, areas, materials
//! ```
//!
//! Words of more than a byte are laid out in planes within a block, so that equal places of neighbouring words are
//! alike. Deflate, since a reader unpacks the whole section once: 7.5 bytes a leaf where LZ4, which knows no entropy
//! code, takes 10.5 (`gen:isosurface:20M`).
//!
//! Invariants: 1. what `parse` returns was checked; 2. beside the stored bytes and the octree itself it takes one
//! block, a byte per leaf and 8 per node.

use super::node::link;
use super::payload::{LeafNormal, Materials, unpack_area};
use super::upper::{Leaves, UpperOctree, UpperSize};
use super::{Facets, MAX_DEPTH, VoxelGrid, is_upper};

/// Bytes of a leaf before packing: bitmap, normal, area, material.
const STORED_LEAF_BYTES: u64 = 8 + 2 + 1 + 2;
/// Places 0 and 1 along each axis.
const FIRST_OCTANT: u64 = 0x33_0033;
/// Bytes that Deflate packs into one at most.
const PACKED_MOST: u64 = 1032;
/// Bytes of head and lengths of blocks, and what Deflate adds to blocks that it cannot make smaller, for a small model.
const PACKING_BYTES: u64 = 1024;
/// Effort of Deflate, 0 to 10.
const LEVEL: u8 = 3;
/// Bytes of a block of a stream before packing.
pub(super) const BLOCK_BYTES: usize = 64 << 10;

impl UpperOctree {
    /// Bytes before the streams.
    pub(crate) const HEAD_BYTES: usize = 52;

    /// What an octree stored in `stored_bytes` takes, by its head, for a model of so many materials; `None` for no
    /// such head.
    pub(crate) fn peek(head: &[u8], stored_bytes: u64, material_count: usize) -> Option<UpperSize> {
        let mut r = SectionReader(head);
        let (grid, leaf_count, facet_count, nodes) = r.head()?;
        let leaves = u64::from(leaf_count);
        let sound = facet_count <= leaf_count && nodes <= MAX_DEPTH as u64 * leaves;
        // In this order: leaves are a 32-bit count, nodes a small multiple of it, and so all sums below fit.
        let sound = sound && is_packed(8 * nodes + STORED_LEAF_BYTES * leaves, stored_bytes);
        sound.then(|| UpperSize {
            resolution: grid.resolution,
            leaf_steps: grid.leaf_steps(),
            leaf_count,
            facet_count,
            stored_bytes,
            resident_bytes: UpperSize::resident_bytes(nodes, leaves, u64::from(facet_count), material_count),
            // Masks and areas are kept until nodes and facets are made of them.
            reading_bytes: stored_bytes + 8 * nodes + leaves + Facets::reading_bytes(u64::from(facet_count)),
        })
    }

    /// The gate for foreign bytes. `None` when anything is out of its range.
    pub(crate) fn parse(bytes: &[u8], material_count: usize) -> Option<UpperOctree> {
        UpperOctree::peek(bytes, bytes.len() as u64, material_count)?;
        let mut r = SectionReader(bytes);
        let (grid, leaf_count, facet_count, node_count) = r.head()?;
        let (leaf_count, node_count) = (leaf_count as usize, node_count as usize);
        let mut masks = Vec::with_capacity(node_count);
        r.planes(node_count, 8, |mask| masks.push(mask))?;
        let mut bitmaps = Vec::with_capacity(leaf_count);
        r.planes(leaf_count, 8, |bitmap| bitmaps.push(bitmap))?;
        let mut normals = Vec::with_capacity(leaf_count);
        r.planes(leaf_count, 2, |normal| normals.push(LeafNormal(normal as u16)))?;
        let mut areas = Vec::with_capacity(leaf_count);
        r.planes(leaf_count, 1, |area| areas.push(area as u8))?;
        let (mut materials, mut greatest) = (Materials::new(material_count, leaf_count), 0);
        r.planes(leaf_count, 2, |material| {
            greatest = greatest.max(material as usize);
            materials.push(if (material as usize) < material_count { material as u16 } else { 0 });
        })?;
        let sound = r.0.is_empty()
            && masks.iter().chain(&bitmaps).all(|&m| m != 0)
            && normals.iter().all(|normal: &LeafNormal| normal.is_sound())
            && greatest < material_count
            // 512 leaves take one octant of the cube of 1024.
            && (grid.resolution != 512 || masks.first().is_some_and(|mask| mask & !FIRST_OCTANT == 0));
        let tree = link(&masks, grid.depth(), leaf_count).filter(|_| sound)?;
        let area = |leaf: usize| unpack_area(areas[leaf]);
        let facets = Facets::new(&tree, &normals, &bitmaps, area);
        (facets.count() == facet_count as usize)
            .then(|| UpperOctree::new(grid, tree, Leaves { bitmaps, normals, materials }, facets))
    }
}

/// The bytes before the streams.
pub(super) fn head(grid: &VoxelGrid, leaf_count: u32, facet_count: u32, node_count: usize) -> Vec<u8> {
    let mut out = Vec::with_capacity(UpperOctree::HEAD_BYTES);
    [grid.resolution, leaf_count, facet_count].iter().for_each(|n| out.extend(n.to_le_bytes()));
    out.extend(grid.subvoxel_steps.to_le_bytes());
    grid.lo.iter().for_each(|q| out.extend(q.to_le_bytes()));
    out.extend((node_count as u64).to_le_bytes());
    out
}

/// A block of words of so many bytes as it is stored: length u32, Deflate of the planes.
pub(super) fn packed_planes(words: &[u64], bytes: usize) -> Vec<u8> {
    let plane = |plane: usize| words.iter().map(move |w| (w >> (8 * plane)) as u8);
    let packed =
        miniz_oxide::deflate::compress_to_vec(&(0..bytes).flat_map(plane).collect::<Vec<u8>>(), LEVEL);
    [&(packed.len() as u32).to_le_bytes(), packed.as_slice()].concat()
}

/// Whether a section of `stored_bytes` can be what so many bytes are packed into: neither too short nor too long.
pub(super) fn is_packed(raw_bytes: u64, stored_bytes: u64) -> bool {
    let most = raw_bytes.saturating_mul(2).saturating_add(PACKING_BYTES);
    raw_bytes <= stored_bytes.saturating_mul(PACKED_MOST) && stored_bytes <= most
}

/// What is left of a section.
pub(super) struct SectionReader<'a>(pub(super) &'a [u8]);

impl SectionReader<'_> {
    /// Grid, leaves, facets, nodes.
    fn head(&mut self) -> Option<(VoxelGrid, u32, u32, u64)> {
        let (resolution, leaf_count, facet_count) = (self.u32()?, self.u32()?, self.u32()?);
        is_upper(resolution).then_some(())?;
        let subvoxel_steps = self.u64()? as i64;
        let lo = [self.u64()? as i64, self.u64()? as i64, self.u64()? as i64];
        let on_lattice = |v: i64| (0..1 << 40).contains(&v);
        let sound = lo.into_iter().all(on_lattice) && (1..1 << 40).contains(&subvoxel_steps);
        let grid = VoxelGrid { resolution, lo, subvoxel_steps };
        Some((grid, leaf_count, facet_count, self.u64()?)).filter(|_| sound)
    }

    pub(super) fn u32(&mut self) -> Option<u32> {
        let (head, tail) = self.0.split_first_chunk()?;
        self.0 = tail;
        Some(u32::from_le_bytes(*head))
    }

    pub(super) fn u64(&mut self) -> Option<u64> {
        let (head, tail) = self.0.split_first_chunk()?;
        self.0 = tail;
        Some(u64::from_le_bytes(*head))
    }

    /// A stream of `count` words of so many bytes.
    pub(super) fn planes(&mut self, count: usize, bytes: usize, mut take: impl FnMut(u64)) -> Option<()> {
        let mut block = vec![0; BLOCK_BYTES];
        let mut left = count;
        while left > 0 {
            let words = left.min(BLOCK_BYTES / bytes);
            let length = self.u32()? as usize;
            let (stored, tail) = self.0.split_at_checked(length)?;
            self.0 = tail;
            let block = &mut block[..words * bytes];
            unpack(stored, block)?;
            for i in 0..words {
                let byte = |plane: usize| u64::from(block[plane * words + i]) << (8 * plane);
                take((0..bytes).map(byte).sum());
            }
            left -= words;
        }
        Some(())
    }
}

/// Unpacks all of `stored` to all of `block`.
fn unpack(stored: &[u8], block: &mut [u8]) -> Option<()> {
    use miniz_oxide::inflate::TINFLStatus;
    use miniz_oxide::inflate::core::{DecompressorOxide, decompress, inflate_flags};
    let whole = inflate_flags::TINFL_FLAG_USING_NON_WRAPPING_OUTPUT_BUF;
    let (status, taken, given) = decompress(&mut DecompressorOxide::new(), stored, block, 0, whole);
    ((status, taken, given) == (TINFLStatus::Done, stored.len(), block.len())).then_some(())
}

#[cfg(test)]
mod tests {
    use super::super::emit::UpperBuilder;
    use super::super::record::Record;
    use super::super::{Refinement, leaf_key};
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    fn built(leaves: &BTreeMap<u64, u64>, grid: VoxelGrid) -> (UpperOctree, Vec<u8>) {
        let folder = tempfile::tempdir().unwrap();
        let mut builder = UpperBuilder::new(grid, folder.path()).unwrap();
        for (&key, &bitmap) in leaves {
            // Each leaf another normal and area, or streams that are read in another way than written pass.
            let turn = key as f32;
            let (area, normal) = (1.0 + 0.1 * turn.sin(), [turn.cos(), 0.6 * turn.sin(), 0.8 * turn.sin()]);
            builder.push(Record { bitmap, area, normal, ..Record::at(key, (key % 3) as u16) }).unwrap();
        }
        let mut bytes = Vec::new();
        let mut put = |piece: &[u8]| {
            bytes.extend_from_slice(piece);
            Ok(())
        };
        assert_eq!(builder.finish(&mut put).unwrap() as usize, leaves.len());
        (UpperOctree::parse(&bytes, 3).unwrap(), bytes)
    }

    fn places() -> impl Strategy<Value = (u32, Vec<([u32; 3], u64)>)> {
        (prop_oneof![Just(64u32), Just(256), Just(512), Just(1024)]).prop_flat_map(|side| {
            let leaf = (proptest::array::uniform3(0..side), 1u64..);
            (Just(side), proptest::collection::vec(leaf, 1..300))
        })
    }

    proptest! {
        /// Every leaf is found from the root, and nothing else; and all of it comes back from disk.
        #[test]
        fn leaves_are_found_from_the_root((side, places) in places()) {
            let grid = VoxelGrid::from_bounds([0; 3], [100_000; 3], side, Refinement::None);
            let depth = grid.depth();
            let leaves: BTreeMap<u64, u64> =
                places.iter().map(|&(at, bitmap)| (leaf_key(at, depth), bitmap)).collect();
            let (octree, bytes) = built(&leaves, grid);
            let mut found = BTreeMap::new();
            let mut stack = vec![(0usize, 0u64, 0usize)];
            while let Some((index, key, level)) = stack.pop() {
                if level == depth {
                    found.insert(key, octree.bitmaps()[index]);
                    prop_assert_eq!(u64::from(octree.material(index)), key % 3);
                    continue;
                }
                let node = octree.nodes()[index];
                let mut next = node.first as usize;
                for child in 0..64u32 {
                    if node.bits() >> child & 1 == 1 {
                        prop_assert_eq!(node.child(child), Some(next as u32));
                        stack.push((next, key << 6 | u64::from(child), level + 1));
                        next += 1;
                    } else {
                        prop_assert_eq!(node.child(child), None);
                    }
                }
            }
            prop_assert_eq!(&found, &leaves);
            let size = UpperOctree::peek(&bytes[..UpperOctree::HEAD_BYTES], bytes.len() as u64, 3).unwrap();
            prop_assert_eq!(size.leaf_count as usize, leaves.len());
            prop_assert_eq!(size.facet_count as usize, octree.facets().count());
            prop_assert_eq!(UpperOctree::parse(&bytes, 2).is_some(), leaves.keys().all(|key| key % 3 < 2));
        }

        /// Nothing that comes from outside panics.
        #[test]
        fn garbage_is_refused(
            change in proptest::collection::vec((any::<usize>(), any::<u8>()), 1..6),
            cut in 0usize..200,
        ) {
            let grid = VoxelGrid::from_bounds([0; 3], [100_000; 3], 256, Refinement::None);
            let leaves = (0..50u64).map(|i| (i * 7919 % (1 << 24), i + 1)).collect();
            let (_, mut bytes) = built(&leaves, grid);
            for (at, value) in change {
                let length = bytes.len();
                bytes[at % length] ^= value;
            }
            bytes.truncate(bytes.len() - cut.min(bytes.len()));
            let _ = UpperOctree::parse(&bytes, 3);
        }
    }

    /// The facets against sums over all leaves of a node.
    #[test]
    fn facets_part_the_leaves_of_a_node() {
        let grid = VoxelGrid::from_bounds([0; 3], [100_000; 3], 64, Refinement::None);
        let leaves = (0..900u64).map(|i| (i * 31 % (1 << 12), !0)).collect();
        let (octree, _) = built(&leaves, grid);
        let mut area = vec![0.0f32; octree.facets().count()];
        for (number, node) in octree.last_nodes().iter().enumerate() {
            for leaf in node.first..node.first + node.bits().count_ones() {
                let index = octree.nodes().len() - octree.last_nodes().len() + number;
                area[octree.facet(index as u32, leaf) as usize] += 1.0;
                let normal = octree.leaf(leaf as usize).normal;
                let same = (node.first..node.first + node.bits().count_ones())
                    .filter(|&other| octree.facet(index as u32, other) == octree.facet(index as u32, leaf))
                    .all(|other| {
                        let n = octree.leaf(other as usize).normal;
                        (0..3).map(|a| n[a] * normal[a]).sum::<f32>() > -0.4
                    });
                assert!(same, "leaves of one facet look the same way");
            }
        }
        // All 64 bits, 0.6 of a square each, whatever of it is hidden: no more than that, and no less than a 16th.
        for (facet, leaves) in area.iter().enumerate() {
            let sides = [0, 1].map(|side| octree.facets().side_area(2 * facet + side) / leaves);
            assert!(sides.iter().all(|side| (2.4 / 16.0 - 1e-4..2.4 + 1e-4).contains(side)), "{sides:?}");
        }
        // Leaves of which none is beside another hide nothing, and have no more than their surface.
        let apart = (0..64u64).map(|node| (node << 6, !0)).collect();
        let (octree, _) = built(&apart, grid);
        for facet in 0..octree.facets().count() {
            let (n, flatness) = {
                let leaf = octree.leaf(facet);
                (leaf.normal, leaf.flatness)
            };
            // A cube: a square a face, each side of it by its projection or by what is open to that side.
            let projected = n.iter().map(|v| v.abs()).sum::<f32>() / flatness.max(0.5);
            let wanted = projected.clamp(0.73 * 3.0, 2.4);
            for side in [2 * facet, 2 * facet + 1] {
                let found = octree.facets().side_area(side);
                assert!((found - wanted).abs() < 1e-4, "{found}, not {wanted}");
            }
        }
    }
}
