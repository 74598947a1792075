//! Eight lanes with AVX2. See `packet.rs`.
//!
//! Invariants: 1. the same operations in the same order as `traverse.rs`, none fused: the same bits; 2. what is read
//! are nodes and bitmaps at which lanes stand.
#![allow(unsafe_code)]

use super::packet::{Ends, Packet, Queue, Row, Tree, UNKNOWN, fits, take_turns};
use crate::voxel::traverse::{EIGHTH, Occluders};
use bytemuck::cast;
use std::arch::x86_64::*;
use trex_store::octree::MAX_DEPTH;

/// Rays of a packet.
const LANES: usize = 8;
/// Packets under way: while one is at work, the cache lines of the others come.
const PACKETS: usize = 4;
/// Number of ones in 0 to 15.
const ONES: [i8; 16] = [0, 1, 1, 2, 1, 2, 2, 3, 1, 2, 2, 3, 2, 3, 3, 4];

/// True where the machine has what this file uses.
pub(in crate::voxel) fn is_available() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("bmi2")
}

/// Answers all rays of `queue`.
pub(in crate::voxel) fn walk_all(queue: &mut impl Queue) {
    assert!(is_available() && fits(queue.octree()));
    // SAFETY: the machine has the features.
    unsafe { walk_with_features(queue) }
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn walk_with_features<Q: Queue>(queue: &mut Q) {
    take_turns::<LANES, PACKETS, Q>(queue, |packet, tree| visit::<Q>(packet, tree), prefetch);
}

/// Asks for the cache line at `address`.
#[inline(always)]
// Rust 1.90 calls prefetches unsafe, later ones do not.
#[allow(unused_unsafe)]
fn prefetch(address: u64) {
    // SAFETY: a prefetch reads nothing.
    unsafe { _mm_prefetch::<_MM_HINT_T0>(std::ptr::with_exposed_provenance(address as usize)) };
}

/// The child of each lane's node or leaf that holds the lane's cell.
struct Child8 {
    /// Place of the child among the 64.
    place: __m256i,
    /// Twice the height: cells of the child along an axis, as a shift.
    shift: __m256i,
    /// The mask of the node or the bitmap of the leaf; see `wide`.
    bits: [__m256i; 2],
    /// Index of the child, where it is there.
    index: __m256i,
    is_there: __m256i,
    /// Nobody has asked where the children are.
    is_unknown: __m256i,
}

/// The way of each lane out of the empty cube around its cell.
struct Exit8 {
    /// Parameter where it leaves, subvoxels from the entry; not before the lane's own t.
    t: __m256,
    /// Axis of the face by which it leaves.
    axis: __m256i,
    /// The next cell as what differs from this one.
    apart: [__m256i; 3],
    /// Height of the node that holds both cells.
    above: __m256i,
    /// The ray has ended, or left the octree.
    is_out: __m256i,
}

/// One visit of each lane, of which those that end stay where they are.
#[inline]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn visit<Q: Queue>(packet: &mut Packet<LANES>, tree: &Tree) -> Ends {
    let child = look::<Q>(packet, tree);
    let exit = leave(packet, tree, &child);
    settle::<Q>(packet, tree, &child, &exit)
}

/// Step 1: which child, and whether it is there.
#[inline]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn look<Q: Queue>(packet: &Packet<LANES>, tree: &Tree) -> Child8 {
    let (height, at): (__m256i, __m256i) = (cast(packet.height.0), cast(packet.at.0));
    let cell: [__m256i; 3] = std::array::from_fn(|a| cast(packet.cell[a].0));
    let address: [__m256i; 2] = cast(packet.address.0);
    let zeros = _mm256_setzero_si256();
    let is_node = _mm256_cmpgt_epi32(height, _mm256_set1_epi32(Q::FINER as i32));
    let shift = _mm256_slli_epi32::<1>(height);
    let part = |cell| _mm256_and_si256(_mm256_srlv_epi32(cell, shift), _mm256_set1_epi32(3));
    let [x, y, z] = cell.map(part);
    let place = _mm256_or_si256(x, _mm256_or_si256(_mm256_slli_epi32::<2>(y), _mm256_slli_epi32::<4>(z)));
    let place = _mm256_xor_si256(place, cast(packet.flip.0));
    let bits: [__m256i; 2] = std::array::from_fn(|half| {
        // SAFETY: addresses of masks and bitmaps, by the second invariant.
        unsafe { _mm256_i64gather_epi64::<1>(std::ptr::null(), address[half]) }
    });
    let words_before = _mm256_add_epi32(at, _mm256_slli_epi32::<1>(at));
    // SAFETY: lanes at a node read its third word, others nothing. `fits` keeps the offset positive.
    let first = unsafe { _mm256_mask_i32gather_epi32::<4>(zeros, tree.first, words_before, is_node) };
    let (mut first, mut is_unknown) = (first, zeros);
    for (row, level) in packet.below.iter().zip(1..=Q::FINER as i32) {
        let is_here = _mm256_cmpeq_epi32(height, _mm256_set1_epi32(level));
        first = _mm256_blendv_epi8(first, cast(row.0), is_here);
        let unknown = _mm256_cmpeq_epi32(first, _mm256_set1_epi32(UNKNOWN as i32));
        is_unknown = _mm256_or_si256(is_unknown, _mm256_and_si256(is_here, unknown));
    }
    // The child's bit comes to the top, and those of the children before it below.
    let up_by = wide(_mm256_xor_si256(place, _mm256_set1_epi32(63)));
    let up = [_mm256_sllv_epi64(bits[0], up_by[0]), _mm256_sllv_epi64(bits[1], up_by[1])];
    let is_there = _mm256_srai_epi32::<31>(narrow::<0xdd>(up));
    let before = up.map(|up| count_ones(_mm256_add_epi64(up, up)));
    let index = _mm256_add_epi32(first, narrow::<0x88>(before));
    Child8 { place, shift, bits, index, is_there, is_unknown }
}

/// Step 2: out of the empty cube, which is the child's, or the eighth of the node around it.
#[inline]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn leave(packet: &Packet<LANES>, tree: &Tree, child: &Child8) -> Exit8 {
    let floats = |row: Row<f32, LANES>| _mm256_castsi256_ps(cast(row.0));
    let cell: [__m256i; 3] = std::array::from_fn(|a| cast(packet.cell[a].0));
    let (zeros, ones, one) = (_mm256_setzero_si256(), _mm256_set1_epi32(-1), _mm256_set1_epi32(1));
    let around = wide(_mm256_and_si256(child.place, _mm256_set1_epi32(0b10_1010)));
    let around: [__m256i; 2] = std::array::from_fn(|half| {
        let eighth = _mm256_srlv_epi64(child.bits[half], around[half]);
        _mm256_cmpeq_epi64(_mm256_and_si256(eighth, _mm256_set1_epi64x(EIGHTH as i64)), zeros)
    });
    let shift = _mm256_sub_epi32(child.shift, narrow::<0x88>(around));
    let within = _mm256_sub_epi32(_mm256_sllv_epi32(one, shift), one);
    let most = cell.map(|cell| _mm256_or_si256(cell, within));
    let t_axis: [__m256; 3] = std::array::from_fn(|a| {
        let end = _mm256_cvtepi32_ps(_mm256_add_epi32(most[a], one));
        _mm256_mul_ps(_mm256_sub_ps(end, floats(packet.origin[a])), floats(packet.inverse[a]))
    });
    let is_y = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_LT_OQ>(t_axis[1], t_axis[0]));
    let t_xy = _mm256_min_ps(t_axis[1], t_axis[0]);
    let is_z = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_LT_OQ>(t_axis[2], t_xy));
    let t = _mm256_max_ps(_mm256_min_ps(t_axis[2], t_xy), floats(packet.t));
    let is_y = _mm256_andnot_si256(is_z, is_y);
    let exits = [_mm256_xor_si256(_mm256_or_si256(is_y, is_z), ones), is_y, is_z];
    let axis = _mm256_sub_epi32(_mm256_and_si256(is_z, _mm256_set1_epi32(2)), is_y);
    let apart: [__m256i; 3] = std::array::from_fn(|a| {
        let at = _mm256_cvttps_epi32(_mm256_add_ps(
            floats(packet.origin[a]),
            _mm256_mul_ps(t, floats(packet.direction[a])),
        ));
        // Kept within the cube; on the axis of exit its end, which is one more.
        let at = _mm256_max_epu32(_mm256_or_si256(at, exits[a]), cell[a]);
        let next = _mm256_sub_epi32(_mm256_min_epu32(at, most[a]), exits[a]);
        _mm256_xor_si256(next, cell[a])
    });
    let any_apart = _mm256_or_si256(_mm256_or_si256(apart[0], apart[1]), apart[2]);
    let is_late = _mm256_castps_si256(_mm256_cmp_ps::<_CMP_GT_OQ>(t, floats(packet.t_max)));
    let last = _mm256_set1_epi32(tree.last as i32);
    let is_out = _mm256_or_si256(is_late, _mm256_cmpgt_epi32(any_apart, last));
    // Half the place of the highest bit: (exponent + 1) / 2, less half of its bias and that one.
    let exponent = _mm256_castps_si256(_mm256_cvtepi32_ps(any_apart));
    let exponent = _mm256_srli_epi32::<24>(_mm256_add_epi32(exponent, _mm256_set1_epi32(1 << 23)));
    let above = _mm256_sub_epi32(exponent, _mm256_set1_epi32(64));
    Exit8 { t, axis, apart, above, is_out }
}

/// Step 3: what becomes of each lane.
#[inline]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
fn settle<Q: Queue>(packet: &mut Packet<LANES>, tree: &Tree, child: &Child8, exit: &Exit8) -> Ends {
    let (zeros, ones) = (_mm256_setzero_si256(), _mm256_set1_epi32(-1));
    let (height, t_before): (__m256i, __m256) =
        (cast(packet.height.0), _mm256_castsi256_ps(cast(packet.t.0)));
    let is_finest = _mm256_cmpeq_epi32(height, zeros);
    let (is_there, is_out) = (child.is_there, exit.is_out);
    let whole = if tree.occluders == Occluders::Off { ones } else { zeros };
    let may_stop = _mm256_or_si256(is_there, whole);
    let hit = _mm256_and_si256(is_finest, may_stop);
    let asks = _mm256_and_si256(child.is_unknown, may_stop);
    let stops = _mm256_or_si256(_mm256_or_si256(is_there, hit), asks);
    let miss = _mm256_andnot_si256(stops, is_out);
    let goes_on = _mm256_xor_si256(_mm256_or_si256(stops, is_out), ones);
    let goes_down = _mm256_andnot_si256(_mm256_or_si256(is_finest, asks), is_there);
    let up = _mm256_and_si256(_mm256_max_epi32(height, exit.above), goes_on);
    let kept = _mm256_add_epi32(_mm256_andnot_si256(goes_on, height), goes_down);
    let height = _mm256_or_si256(kept, up);
    packet.height.0 = cast(height);
    for a in 0..3 {
        let next = _mm256_xor_si256(cast(packet.cell[a].0), _mm256_and_si256(exit.apart[a], goes_on));
        packet.cell[a].0 = cast(next);
    }
    let t = _mm256_max_ps(t_before, _mm256_and_ps(exit.t, _mm256_castsi256_ps(goes_on)));
    packet.t.0 = cast(_mm256_castps_si256(t));
    let axis = _mm256_blendv_epi8(cast(packet.axis.0), exit.axis, goes_on);
    packet.axis.0 = cast(axis);
    let mut at = zeros;
    for level in 0..MAX_DEPTH + Q::FINER as usize {
        let is_here = _mm256_cmpeq_epi32(height, _mm256_set1_epi32(level as i32));
        let is_new = _mm256_and_si256(is_here, goes_down);
        let row = _mm256_blendv_epi8(cast(packet.path[level].0), child.index, is_new);
        packet.path[level].0 = cast(row);
        at = _mm256_or_si256(at, _mm256_and_si256(row, is_here));
    }
    for (row, level) in packet.below.iter_mut().zip(1..=Q::FINER as i32) {
        let is_new = _mm256_and_si256(_mm256_cmpeq_epi32(height, _mm256_set1_epi32(level)), goes_down);
        row.0 = cast(_mm256_blendv_epi8(cast(row.0), _mm256_set1_epi32(UNKNOWN as i32), is_new));
    }
    let mut nears = zeros;
    if Q::FINER > 0 {
        let linking = _mm256_set1_epi32(Q::FINER as i32 + 1);
        nears = _mm256_and_si256(goes_down, _mm256_cmpeq_epi32(height, linking));
    }
    packet.at.0 = cast(at);
    packet.address.0 = cast(addresses::<Q>(tree, at, height));
    let mask = |lanes| _mm256_movemask_ps(_mm256_castsi256_ps(lanes)) as u32;
    Ends { hit: mask(hit), miss: mask(miss), asks: mask(asks), nears: mask(nears) }
}

/// Addresses of masks and of bitmaps.
#[inline]
#[target_feature(enable = "avx2")]
fn addresses<Q: Queue>(tree: &Tree, at: __m256i, height: __m256i) -> [__m256i; 2] {
    let finer = Q::FINER as i32;
    let is_leaf = match finer {
        0 => _mm256_cmpeq_epi32(height, _mm256_setzero_si256()),
        _ => _mm256_cmpgt_epi32(_mm256_set1_epi32(finer + 1), height),
    };
    // 12 bytes a node, 8 a bitmap.
    let four = _mm256_andnot_si256(is_leaf, _mm256_slli_epi32::<2>(at));
    let mut offset = wide(_mm256_add_epi32(_mm256_slli_epi32::<3>(at), four));
    if finer > 0 {
        // Bytes to units may be more than 32 bits.
        let size = wide(_mm256_blendv_epi8(_mm256_set1_epi32(12), _mm256_set1_epi32(8), is_leaf));
        let at = wide(at);
        offset = std::array::from_fn(|half| _mm256_mul_epu32(at[half], size[half]));
    }
    let (nodes, bitmaps) = (_mm256_set1_epi64x(tree.nodes as i64), _mm256_set1_epi64x(tree.bitmaps as i64));
    let is_leaf = twice(is_leaf);
    let mut base: [__m256i; 2] =
        std::array::from_fn(|half| _mm256_add_epi64(nodes, _mm256_and_si256(is_leaf[half], bitmaps)));
    if finer > 0 {
        let is_unit = twice(_mm256_cmpgt_epi32(_mm256_set1_epi32(finer), height));
        let units = _mm256_set1_epi64x(tree.units() as i64);
        base =
            std::array::from_fn(|half| _mm256_add_epi64(base[half], _mm256_and_si256(is_unit[half], units)));
    }
    std::array::from_fn(|half| _mm256_add_epi64(base[half], offset[half]))
}

/// Words twice.
#[inline]
#[target_feature(enable = "avx2")]
fn twice(words: __m256i) -> [__m256i; 2] {
    [_mm256_unpacklo_epi32(words, words), _mm256_unpackhi_epi32(words, words)]
}

/// Words to 64 bits; for their order see `slot`.
#[inline]
#[target_feature(enable = "avx2")]
fn wide(words: __m256i) -> [__m256i; 2] {
    let zeros = _mm256_setzero_si256();
    [_mm256_unpacklo_epi32(words, zeros), _mm256_unpackhi_epi32(words, zeros)]
}

/// Words from 64 bits, the upper ones (`0xdd`) or the lower ones (`0x88`).
#[inline]
#[target_feature(enable = "avx2")]
fn narrow<const WORDS: i32>([low, high]: [__m256i; 2]) -> __m256i {
    _mm256_castps_si256(_mm256_shuffle_ps::<WORDS>(_mm256_castsi256_ps(low), _mm256_castsi256_ps(high)))
}

/// Ones in each 64 bits.
#[inline]
#[target_feature(enable = "avx2")]
fn count_ones(bits: __m256i) -> __m256i {
    let table = _mm256_broadcastsi128_si256(cast(ONES));
    let nibble = _mm256_set1_epi8(15);
    let low = _mm256_shuffle_epi8(table, _mm256_and_si256(bits, nibble));
    let high = _mm256_shuffle_epi8(table, _mm256_and_si256(_mm256_srli_epi16::<4>(bits), nibble));
    _mm256_sad_epu8(_mm256_add_epi8(low, high), _mm256_setzero_si256())
}
