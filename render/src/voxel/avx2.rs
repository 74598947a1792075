//! Eight rays side by side through the octree, and several such packets in turn.
//!
//! ```text
//! until no ray is left
//!   for each packet: all of its lanes visit the node (or the leaf) that they are at
//!     child is there    -> down to it                 down, up and on are all computed, masks choose
//!     child is missing  -> out of the empty cube, up to the node that holds the next cell too
//!     lanes that ended give their answers and get the next rays
//!     what the lanes are at now is prefetched; the other packets' visits pass until it is looked at
//! ```
//!
//! The scalar walk (`traverse.rs`) goes down in a loop of its own; here going down one level is a visit like any other, so
//! that lanes need not agree. A ray makes some 30 visits: four visits of a packet.
//!
//! Tried and lost: gathers without prefetch (60 % of the speed: two misses in flight instead of dozens); 2, 3 and 6 packets; the
//! same code for AVX-512VL (1.1 times as fast); huge pages for the octree (1.03); a visit in three parts, each for all
//! packets in turn (0.95); reciprocals instead of divisions when a ray enters (1.0).
//!
//! Invariants: 1. the same operations in the same order as `traverse.rs`, none fused: the same bits; 2. a lane stands at a
//! node or leaf of the octree at all times, also one without a ray: every address that is read is theirs.
#![allow(unsafe_code)]

use super::packet::Queue;
use super::traverse::{EIGHTH, Entry, Found, Occluders, VoxelHit};
use std::arch::x86_64::*;
use trex_store::octree::{MAX_DEPTH, OctreeNode, UpperOctree};

/// Rays of a packet.
const LANES: usize = 8;
/// Packets under way: while one is at work, the cache lines of the others come.
const PACKETS: usize = 4;
/// Where a lane is in a pair of rows of 64 bits: rows are widened and narrowed within halves of registers.
const SLOT: [usize; LANES] = [0, 1, 4, 5, 2, 3, 6, 7];
/// Number of ones in 0 to 15.
const ONES: [i8; 16] = [0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4];
const _: () = assert!(size_of::<OctreeNode>() == 12 && std::mem::offset_of!(OctreeNode, first) == 8);

/// True where the machine has what this file uses.
pub(super) fn is_available() -> bool {
    is_x86_feature_detected!("avx2")
}

/// True for an octree whose nodes and bitmaps are within 32-bit offsets of bytes.
pub(super) fn fits(octree: &UpperOctree) -> bool {
    size_of_val(octree.nodes()).max(size_of_val(octree.bitmaps())) <= u32::MAX as usize
}

/// Answers all rays of `queue`.
pub(super) fn walk_all(queue: &mut Queue<'_, impl FnMut(usize, Option<VoxelHit>)>) {
    assert!(is_available() && fits(queue.scene.octree()));
    // SAFETY: the machine has AVX2.
    unsafe { walk_with_features(queue) }
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn walk_with_features(queue: &mut Queue<'_, impl FnMut(usize, Option<VoxelHit>)>) {
    let tree = Tree::of(queue.scene.octree(), queue.scene.occluders());
    let mut packets = [Packet::idle(&tree); PACKETS];
    for lane in 0..LANES {
        for packet in &mut packets {
            packet.refill(lane, queue, &tree);
        }
    }
    loop {
        let mut busy = 0;
        for packet in &mut packets {
            let ends = packet.visit(&tree);
            let mut ended = (ends.hit | ends.miss) & packet.busy;
            while ended != 0 {
                let lane = ended.trailing_zeros() as usize;
                ended &= ended - 1;
                let found = (ends.hit >> lane & 1 == 1).then(|| packet.found(lane));
                queue.answer(packet.ray[lane], found.map(|found| (packet.t_in[lane], found)));
                packet.refill(lane, queue, &tree);
            }
            busy |= packet.busy;
            packet.prefetch();
        }
        if busy == 0 {
            return;
        }
    }
}

/// The octree as lanes see it.
struct Tree {
    /// Address of the nodes, and how far from there the bitmaps are.
    nodes: __m256i,
    bitmaps: __m256i,
    /// The first node's first child.
    first: *const i32,
    /// Levels above the leaves.
    depth: u32,
    /// The last subvoxel along an axis.
    last: u32,
    /// All ones where leaves are whole cubes.
    whole: __m256i,
}

impl Tree {
    #[inline]
    #[target_feature(enable = "avx2")]
    fn of(octree: &UpperOctree, occluders: Occluders) -> Tree {
        let (nodes, bitmaps) = (octree.nodes().as_ptr(), octree.bitmaps().as_ptr());
        let depth = octree.grid().depth() as u32;
        let nodes_at = nodes.expose_provenance() as i64;
        let bitmaps_at = bitmaps.expose_provenance() as i64;
        Tree {
            nodes: _mm256_set1_epi64x(nodes_at),
            bitmaps: _mm256_set1_epi64x(bitmaps_at.wrapping_sub(nodes_at)),
            first: nodes.cast::<i32>().wrapping_add(2),
            depth,
            last: 4u32.pow(depth + 1) - 1,
            whole: _mm256_set1_epi32(if occluders == Occluders::Off { -1 } else { 0 }),
        }
    }
}

/// Lanes whose rays ended.
struct Ends {
    hit: u32,
    miss: u32,
}

/// Eight rays and where they are. See `Entry` and `VoxelScene::walk`.
#[derive(Clone, Copy)]
struct Packet {
    origin: [__m256; 3],
    direction: [__m256; 3],
    inverse: [__m256; 3],
    t_max: __m256,
    flip: __m256i,
    cell: [__m256i; 3],
    t: __m256,
    axis: __m256i,
    /// Levels above the leaves; at 0 a lane is at a leaf.
    height: __m256i,
    /// The node or leaf.
    at: __m256i,
    /// Its address, widened.
    address: [__m256i; 2],
    /// Leaf and nodes on the way to it by height; above the greatest there is only the root, 0.
    path: [__m256i; MAX_DEPTH],
    /// Lanes with a ray.
    busy: u32,
    /// Which one it is, and its distance to the cube.
    ray: [usize; LANES],
    t_in: [f64; LANES],
}

impl Packet {
    /// Without rays, all lanes at the root.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn idle(tree: &Tree) -> Packet {
        let (zeros, zero) = (_mm256_setzero_si256(), _mm256_setzero_ps());
        Packet {
            origin: [zero; 3],
            direction: [zero; 3],
            inverse: [zero; 3],
            t_max: _mm256_set1_ps(-1.0),
            flip: zeros,
            cell: [zeros; 3],
            t: zero,
            axis: zeros,
            height: _mm256_set1_epi32(tree.depth as i32),
            at: zeros,
            address: [tree.nodes; 2],
            path: [zeros; MAX_DEPTH],
            busy: 0,
            ray: [0; LANES],
            t_in: [0.0; LANES],
        }
    }

    /// Gives the lane the next ray of `queue`. Without one it stays where it is.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn refill(
        &mut self,
        lane: usize,
        queue: &mut Queue<'_, impl FnMut(usize, Option<VoxelHit>)>,
        tree: &Tree,
    ) {
        let Some((ray, entry)) = queue.next() else {
            self.busy &= !(1 << lane);
            return;
        };
        self.enter(lane, &entry, tree);
        (self.ray[lane], self.t_in[lane]) = (ray, entry.t_in);
        self.busy |= 1 << lane;
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn enter(&mut self, lane: usize, entry: &Entry, tree: &Tree) {
        let cell = entry.first_cell(tree.last);
        for a in 0..3 {
            floats(&mut self.origin[a])[lane] = entry.origin[a];
            floats(&mut self.direction[a])[lane] = entry.direction[a];
            floats(&mut self.inverse[a])[lane] = entry.inverse[a];
            words(&mut self.cell[a])[lane] = cell[a];
        }
        floats(&mut self.t_max)[lane] = entry.t_max;
        floats(&mut self.t)[lane] = 0.0;
        words(&mut self.flip)[lane] = entry.flip;
        words(&mut self.axis)[lane] = entry.axis as u32;
        words(&mut self.height)[lane] = tree.depth;
        words(&mut self.at)[lane] = 0;
        let root: [u64; 4] = bytemuck::cast(tree.nodes);
        bytemuck::cast_mut::<[__m256i; 2], [u64; LANES]>(&mut self.address)[SLOT[lane]] = root[0];
    }

    /// Where a lane is that hit.
    fn found(&mut self, lane: usize) -> Found {
        Found {
            t: floats(&mut self.t)[lane],
            node: words(&mut self.path[1])[lane],
            leaf: words(&mut self.at)[lane],
            axis: words(&mut self.axis)[lane] as usize,
        }
    }

    /// Asks for what the lanes are at.
    #[inline]
    #[target_feature(enable = "avx2")]
    // Rust 1.90 calls prefetches unsafe, later ones do not.
    #[allow(unused_unsafe)]
    fn prefetch(&self) {
        // By way of memory: taking words out of registers costs more than loads do.
        let addresses: &[usize; LANES] = std::hint::black_box(bytemuck::cast_ref(&self.address));
        for address in addresses {
            // SAFETY: a prefetch reads nothing.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::with_exposed_provenance(*address)) };
        }
    }

    /// One visit of each lane, of which those that end stay where they are.
    #[inline]
    #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
    fn visit(&mut self, tree: &Tree) -> Ends {
        let (zeros, ones, one) = (_mm256_setzero_si256(), _mm256_set1_epi32(-1), _mm256_set1_epi32(1));
        let is_leaf = _mm256_cmpeq_epi32(self.height, zeros);
        let is_node = _mm256_xor_si256(is_leaf, ones);

        // Which child, and whether it is there.
        let shift = _mm256_slli_epi32::<1>(self.height);
        let part = |cell| _mm256_and_si256(_mm256_srlv_epi32(cell, shift), _mm256_set1_epi32(3));
        let [x, y, z] = self.cell.map(part);
        let place = _mm256_or_si256(x, _mm256_or_si256(_mm256_slli_epi32::<2>(y), _mm256_slli_epi32::<4>(z)));
        let place = _mm256_xor_si256(place, self.flip);
        let bits: [__m256i; 2] = std::array::from_fn(|half| {
            // SAFETY: addresses of masks and bitmaps, by the file's second invariant.
            unsafe { _mm256_i64gather_epi64::<1>(std::ptr::null(), self.address[half]) }
        });
        let words_before = _mm256_add_epi32(self.at, _mm256_slli_epi32::<1>(self.at));
        // SAFETY: lanes at a node read its third word, others nothing. `fits` keeps the offset positive.
        let first = unsafe { _mm256_mask_i32gather_epi32::<4>(zeros, tree.first, words_before, is_node) };
        // The child's bit comes to the top, and those of the children before it below.
        let up_by = wide(_mm256_xor_si256(place, _mm256_set1_epi32(63)));
        let up = [_mm256_sllv_epi64(bits[0], up_by[0]), _mm256_sllv_epi64(bits[1], up_by[1])];
        let is_there = _mm256_srai_epi32::<31>(narrow::<0xdd>(up));
        let before = up.map(|up| count_ones(_mm256_add_epi64(up, up)));
        let child = _mm256_add_epi32(first, narrow::<0x88>(before));

        // Out of the empty cube: the child's, or the eighth of the node around it.
        let around = wide(_mm256_and_si256(place, _mm256_set1_epi32(0b10_1010)));
        let around: [__m256i; 2] = std::array::from_fn(|half| {
            let eighth = _mm256_srlv_epi64(bits[half], around[half]);
            _mm256_cmpeq_epi64(_mm256_and_si256(eighth, _mm256_set1_epi64x(EIGHTH as i64)), zeros)
        });
        let shift = _mm256_sub_epi32(shift, narrow::<0x88>(around));
        let within = _mm256_sub_epi32(_mm256_sllv_epi32(one, shift), one);
        let most = self.cell.map(|cell| _mm256_or_si256(cell, within));
        let t_axis: [__m256; 3] = std::array::from_fn(|a| {
            let end = _mm256_cvtepi32_ps(_mm256_add_epi32(most[a], one));
            _mm256_mul_ps(_mm256_sub_ps(end, self.origin[a]), self.inverse[a])
        });
        let is_y = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_LT_OQ>(t_axis[1], t_axis[0]));
        let t_xy = _mm256_min_ps(t_axis[1], t_axis[0]);
        let is_z = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_LT_OQ>(t_axis[2], t_xy));
        let t = _mm256_max_ps(_mm256_min_ps(t_axis[2], t_xy), self.t);
        let is_y = _mm256_andnot_si256(is_z, is_y);
        let exits = [_mm256_xor_si256(_mm256_or_si256(is_y, is_z), ones), is_y, is_z];
        let axis = _mm256_sub_epi32(_mm256_and_si256(is_z, _mm256_set1_epi32(2)), is_y);
        // The next cell as what differs from this one.
        let apart: [__m256i; 3] = std::array::from_fn(|a| {
            let at = _mm256_cvttps_epi32(_mm256_add_ps(self.origin[a], _mm256_mul_ps(t, self.direction[a])));
            // Kept within the cube; on the axis of exit its end, which is one more.
            let at = _mm256_max_epu32(_mm256_or_si256(at, exits[a]), self.cell[a]);
            let next = _mm256_sub_epi32(_mm256_min_epu32(at, most[a]), exits[a]);
            _mm256_xor_si256(next, self.cell[a])
        });
        let any_apart = _mm256_or_si256(_mm256_or_si256(apart[0], apart[1]), apart[2]);
        let is_late = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_GT_OQ>(t, self.t_max));
        let last = _mm256_set1_epi32(tree.last as i32);
        let is_out = _mm256_or_si256(is_late, _mm256_cmpgt_epi32(any_apart, last));
        // Half the place of the highest bit: (exponent + 1) / 2, less half of its bias and that one.
        let exponent = _mm256_castps_si256(_mm256_cvtepi32_ps(any_apart));
        let exponent = _mm256_srli_epi32::<24>(_mm256_add_epi32(exponent, _mm256_set1_epi32(1 << 23)));
        let above = _mm256_sub_epi32(exponent, _mm256_set1_epi32(64));

        // What becomes of each lane.
        let hit = _mm256_and_si256(is_leaf, _mm256_or_si256(is_there, tree.whole));
        let stops = _mm256_or_si256(is_there, hit);
        let miss = _mm256_andnot_si256(stops, is_out);
        let goes_on = _mm256_xor_si256(_mm256_or_si256(stops, is_out), ones);
        let goes_down = _mm256_and_si256(is_node, is_there);
        let up = _mm256_and_si256(_mm256_max_epi32(self.height, above), goes_on);
        let kept = _mm256_add_epi32(_mm256_andnot_si256(goes_on, self.height), goes_down);
        self.height = _mm256_or_si256(kept, up);
        for a in 0..3 {
            self.cell[a] = _mm256_xor_si256(self.cell[a], _mm256_and_si256(apart[a], goes_on));
        }
        self.t = _mm256_max_ps(self.t, _mm256_and_ps(t, _mm256_castsi256_ps(goes_on)));
        self.axis = _mm256_blendv_epi8(self.axis, axis, goes_on);
        self.at = zeros;
        for height in 0..MAX_DEPTH {
            let is_here = _mm256_cmpeq_epi32(self.height, _mm256_set1_epi32(height as i32));
            let is_new = _mm256_and_si256(is_here, goes_down);
            self.path[height] = _mm256_blendv_epi8(self.path[height], child, is_new);
            self.at = _mm256_or_si256(self.at, _mm256_and_si256(self.path[height], is_here));
        }
        self.address = tree.addresses(self.at, self.height);
        let mask = |lanes| _mm256_movemask_ps(_mm256_castsi256_ps(lanes)) as u32;
        Ends { hit: mask(hit), miss: mask(miss) }
    }
}

impl Tree {
    /// Of masks, or at height 0 of bitmaps.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn addresses(&self, at: __m256i, height: __m256i) -> [__m256i; 2] {
        let is_leaf = _mm256_cmpeq_epi32(height, _mm256_setzero_si256());
        // 12 bytes a node, 8 a bitmap.
        let four = _mm256_andnot_si256(is_leaf, _mm256_slli_epi32::<2>(at));
        let offset = wide(_mm256_add_epi32(_mm256_slli_epi32::<3>(at), four));
        let is_leaf = [_mm256_unpacklo_epi32(is_leaf, is_leaf), _mm256_unpackhi_epi32(is_leaf, is_leaf)];
        std::array::from_fn(|half| {
            let base = _mm256_add_epi64(self.nodes, _mm256_and_si256(is_leaf[half], self.bitmaps));
            _mm256_add_epi64(base, offset[half])
        })
    }
}

/// Words to 64 bits; see `SLOT`.
#[inline]
#[target_feature(enable = "avx2")]
fn wide(words: __m256i) -> [__m256i; 2] {
    let zeros = _mm256_setzero_si256();
    [_mm256_unpacklo_epi32(words, zeros), _mm256_unpackhi_epi32(words, zeros)]
}

/// Back, the upper words (`0xdd`) or the lower ones (`0x88`).
#[inline]
#[target_feature(enable = "avx2")]
fn narrow<const WORDS: i32>([low, high]: [__m256i; 2]) -> __m256i {
    _mm256_castps_si256(_mm256_shuffle_ps::<WORDS>(_mm256_castsi256_ps(low), _mm256_castsi256_ps(high)))
}

/// Ones in each 64 bits.
#[inline]
#[target_feature(enable = "avx2")]
fn count_ones(bits: __m256i) -> __m256i {
    let table = _mm256_broadcastsi128_si256(bytemuck::cast(ONES));
    let nibble = _mm256_set1_epi8(15);
    let low = _mm256_shuffle_epi8(table, _mm256_and_si256(bits, nibble));
    let high = _mm256_shuffle_epi8(table, _mm256_and_si256(_mm256_srli_epi16::<4>(bits), nibble));
    _mm256_sad_epu8(_mm256_add_epi8(low, high), _mm256_setzero_si256())
}

fn floats(row: &mut __m256) -> &mut [f32; LANES] {
    bytemuck::cast_mut(row)
}

fn words(row: &mut __m256i) -> &mut [u32; LANES] {
    bytemuck::cast_mut(row)
}
