//! Sixteen lanes with AVX-512: as `avx2.rs`, with masks in registers of their own and an instruction that counts
//! ones. See `packet.rs`.
//!
//! Invariants: those of `avx2.rs`.
#![allow(unsafe_code)]

use super::packet::{Ends, Packet, Queue, Row, Tree, UNKNOWN, fits, take_turns};
use crate::voxel::traverse::{EIGHTH, Occluders};
use bytemuck::cast;
use std::arch::x86_64::*;
use trex_store::octree::MAX_DEPTH;

/// Rays of a packet.
const LANES: usize = 16;
/// Packets under way: while one is at work, the cache lines of the others come.
const PACKETS: usize = 4;

/// True where the machine has what this file uses.
pub(in crate::voxel) fn is_available() -> bool {
    is_x86_feature_detected!("avx512f")
        && is_x86_feature_detected!("avx512dq")
        && is_x86_feature_detected!("avx512cd")
        && is_x86_feature_detected!("avx512vpopcntdq")
}

/// Answers all rays of `queue`.
pub(in crate::voxel) fn walk_all(queue: &mut impl Queue) {
    assert!(is_available() && fits(queue.octree()));
    // SAFETY: the machine has the features.
    unsafe { walk_with_features(queue) }
}

#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512dq,avx512cd,avx512vpopcntdq")]
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
struct Child16 {
    /// Place of the child among the 64.
    place: __m512i,
    /// Twice the height: cells of the child along an axis, as a shift.
    shift: __m512i,
    /// The mask of the node or the bitmap of the leaf; see `wide`.
    bits: [__m512i; 2],
    /// Index of the child, where it is there.
    index: __m512i,
    is_there: __mmask16,
    /// Nobody has asked where the children are.
    is_unknown: __mmask16,
}

/// The way of each lane out of the empty cube around its cell.
struct Exit16 {
    /// Parameter where it leaves, subvoxels from the entry; not before the lane's own t.
    t: __m512,
    /// Axis of the face by which it leaves.
    axis: __m512i,
    /// The next cell.
    next: [__m512i; 3],
    /// Height of the node that holds both cells.
    above: __m512i,
    /// The ray has ended, or left the octree.
    is_out: __mmask16,
}

/// One visit of each lane, of which those that end stay where they are.
#[inline]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512dq,avx512cd,avx512vpopcntdq")]
fn visit<Q: Queue>(packet: &mut Packet<LANES>, tree: &Tree) -> Ends {
    let child = look::<Q>(packet, tree);
    let exit = leave(packet, tree, &child);
    settle::<Q>(packet, tree, &child, &exit)
}

/// Step 1: which child, and whether it is there.
#[inline]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512dq,avx512cd,avx512vpopcntdq")]
fn look<Q: Queue>(packet: &Packet<LANES>, tree: &Tree) -> Child16 {
    let (height, at): (__m512i, __m512i) = (cast(packet.height.0), cast(packet.at.0));
    let cell: [__m512i; 3] = std::array::from_fn(|a| cast(packet.cell[a].0));
    let address: [__m512i; 2] = cast(packet.address.0);
    let (zeros, is_node) = (_mm512_setzero_si512(), is_node::<Q>(height));
    let shift = _mm512_slli_epi32::<1>(height);
    let part = |cell| _mm512_and_si512(_mm512_srlv_epi32(cell, shift), _mm512_set1_epi32(3));
    let [x, y, z] = cell.map(part);
    // x | y | z, by its truth table.
    let place = _mm512_ternarylogic_epi32::<0xfe>(x, _mm512_slli_epi32::<2>(y), _mm512_slli_epi32::<4>(z));
    let place = _mm512_xor_si512(place, cast(packet.flip.0));
    let bits: [__m512i; 2] = std::array::from_fn(|half| {
        // SAFETY: addresses of masks and bitmaps, by the second invariant.
        unsafe { _mm512_i64gather_epi64::<1>(address[half], std::ptr::null()) }
    });
    let words_before = _mm512_add_epi32(at, _mm512_slli_epi32::<1>(at));
    // SAFETY: lanes at a node read its third word, others nothing. `fits` keeps the offset positive.
    let first = unsafe { _mm512_mask_i32gather_epi32::<4>(zeros, is_node, words_before, tree.first) };
    let (mut first, mut is_unknown) = (first, 0);
    for (row, level) in packet.below.iter().zip(1..=Q::FINER as i32) {
        let is_here = _mm512_cmpeq_epi32_mask(height, _mm512_set1_epi32(level));
        first = _mm512_mask_mov_epi32(first, is_here, cast(row.0));
        let unknown = _mm512_set1_epi32(UNKNOWN as i32);
        is_unknown |= _mm512_mask_cmpeq_epi32_mask(is_here, first, unknown);
    }
    // The child's bit comes to the top, and those of the children before it below.
    let up_by = wide(_mm512_xor_si512(place, _mm512_set1_epi32(63)));
    let up = [_mm512_sllv_epi64(bits[0], up_by[0]), _mm512_sllv_epi64(bits[1], up_by[1])];
    let is_there = _mm512_movepi32_mask(narrow::<0xdd>(up));
    let before = up.map(|up| _mm512_popcnt_epi64(_mm512_add_epi64(up, up)));
    let index = _mm512_add_epi32(first, narrow::<0x88>(before));
    Child16 { place, shift, bits, index, is_there, is_unknown }
}

/// Step 2: out of the empty cube, which is the child's, or the eighth of the node around it.
#[inline]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512dq,avx512cd,avx512vpopcntdq")]
fn leave(packet: &Packet<LANES>, tree: &Tree, child: &Child16) -> Exit16 {
    let floats = |row: Row<f32, LANES>| _mm512_castsi512_ps(cast(row.0));
    let cell: [__m512i; 3] = std::array::from_fn(|a| cast(packet.cell[a].0));
    let one = _mm512_set1_epi32(1);
    let around = wide(_mm512_and_si512(child.place, _mm512_set1_epi32(0b10_1010)));
    let around: [__m512i; 2] = std::array::from_fn(|half| {
        let eighth = _mm512_srlv_epi64(child.bits[half], around[half]);
        _mm512_and_si512(eighth, _mm512_set1_epi64(EIGHTH as i64))
    });
    // 22 bits of each.
    let around = narrow::<0x88>(around);
    let is_empty = _mm512_testn_epi32_mask(around, around);
    let shift = _mm512_mask_add_epi32(child.shift, is_empty, child.shift, one);
    let within = _mm512_sub_epi32(_mm512_sllv_epi32(one, shift), one);
    let most = cell.map(|cell| _mm512_or_si512(cell, within));
    let t_axis: [__m512; 3] = std::array::from_fn(|a| {
        let end = _mm512_cvtepi32_ps(_mm512_add_epi32(most[a], one));
        _mm512_mul_ps(_mm512_sub_ps(end, floats(packet.origin[a])), floats(packet.inverse[a]))
    });
    let is_y = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(t_axis[1], t_axis[0]);
    let t_xy = _mm512_min_ps(t_axis[1], t_axis[0]);
    let is_z = _mm512_cmp_ps_mask::<_CMP_LT_OQ>(t_axis[2], t_xy);
    let t = _mm512_max_ps(_mm512_min_ps(t_axis[2], t_xy), floats(packet.t));
    let is_y = is_y & !is_z;
    let exits = [!(is_y | is_z), is_y, is_z];
    let next: [__m512i; 3] = std::array::from_fn(|a| {
        let at = _mm512_cvttps_epi32(_mm512_add_ps(
            floats(packet.origin[a]),
            _mm512_mul_ps(t, floats(packet.direction[a])),
        ));
        // Kept within the cube; on the axis of exit its end.
        let at = _mm512_min_epu32(_mm512_max_epu32(at, cell[a]), most[a]);
        _mm512_mask_add_epi32(at, exits[a], most[a], one)
    });
    let apart: [__m512i; 3] = std::array::from_fn(|a| _mm512_xor_si512(next[a], cell[a]));
    let any_apart = _mm512_ternarylogic_epi32::<0xfe>(apart[0], apart[1], apart[2]);
    let is_late = _mm512_cmp_ps_mask::<_CMP_GT_OQ>(t, floats(packet.t_max));
    let is_out = is_late | _mm512_cmpgt_epi32_mask(any_apart, _mm512_set1_epi32(tree.last as i32));
    // Half the place of the highest bit.
    let above =
        _mm512_srli_epi32::<1>(_mm512_sub_epi32(_mm512_set1_epi32(31), _mm512_lzcnt_epi32(any_apart)));
    let axis = _mm512_maskz_mov_epi32(is_y, one);
    let axis = _mm512_mask_mov_epi32(axis, is_z, _mm512_set1_epi32(2));
    Exit16 { t, axis, next, above, is_out }
}

/// Step 3: what becomes of each lane.
#[inline]
#[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512dq,avx512cd,avx512vpopcntdq")]
fn settle<Q: Queue>(packet: &mut Packet<LANES>, tree: &Tree, child: &Child16, exit: &Exit16) -> Ends {
    let (height, t_before): (__m512i, __m512) =
        (cast(packet.height.0), _mm512_castsi512_ps(cast(packet.t.0)));
    let (zeros, one) = (_mm512_setzero_si512(), _mm512_set1_epi32(1));
    let is_finest = _mm512_testn_epi32_mask(height, height);
    let (is_there, is_out) = (child.is_there, exit.is_out);
    let whole = if tree.occluders == Occluders::Off { 0xffff } else { 0 };
    let (hit, asks) = (is_finest & (is_there | whole), child.is_unknown & (is_there | whole));
    let stops = is_there | hit | asks;
    let miss = is_out & !stops;
    let goes_on = !(stops | is_out);
    let goes_down = is_there & !(is_finest | asks);
    let lower = _mm512_mask_sub_epi32(height, goes_down, height, one);
    let height = _mm512_mask_max_epi32(lower, goes_on, height, exit.above);
    packet.height.0 = cast(height);
    for a in 0..3 {
        packet.cell[a].0 = cast(_mm512_mask_mov_epi32(cast(packet.cell[a].0), goes_on, exit.next[a]));
    }
    let t = _mm512_mask_mov_ps(t_before, goes_on, exit.t);
    packet.t.0 = cast(_mm512_castps_si512(t));
    let axis = _mm512_mask_mov_epi32(cast(packet.axis.0), goes_on, exit.axis);
    packet.axis.0 = cast(axis);
    let mut at = zeros;
    for level in 0..MAX_DEPTH + Q::FINER as usize {
        let is_here = _mm512_cmpeq_epi32_mask(height, _mm512_set1_epi32(level as i32));
        let row = _mm512_mask_mov_epi32(cast(packet.path[level].0), is_here & goes_down, child.index);
        packet.path[level].0 = cast(row);
        at = _mm512_mask_mov_epi32(at, is_here, row);
    }
    for (row, level) in packet.below.iter_mut().zip(1..=Q::FINER as i32) {
        let is_new = _mm512_mask_cmpeq_epi32_mask(goes_down, height, _mm512_set1_epi32(level));
        let unknown = _mm512_set1_epi32(UNKNOWN as i32);
        row.0 = cast(_mm512_mask_mov_epi32(cast(row.0), is_new, unknown));
    }
    let mut nears = 0;
    if Q::FINER > 0 {
        let linking = _mm512_set1_epi32(Q::FINER as i32 + 1);
        nears = _mm512_mask_cmpeq_epi32_mask(goes_down, height, linking);
    }
    packet.at.0 = cast(at);
    packet.address.0 = cast(addresses::<Q>(tree, at, height));
    Ends { hit: u32::from(hit), miss: u32::from(miss), asks: u32::from(asks), nears: u32::from(nears) }
}

/// Lanes at a node.
#[inline]
#[target_feature(enable = "avx512f")]
fn is_node<Q: Queue>(height: __m512i) -> __mmask16 {
    match Q::FINER {
        0 => _mm512_test_epi32_mask(height, height),
        finer => _mm512_cmpgt_epi32_mask(height, _mm512_set1_epi32(finer as i32)),
    }
}

/// Addresses of masks and of bitmaps.
#[inline]
#[target_feature(enable = "avx512f,avx512dq")]
fn addresses<Q: Queue>(tree: &Tree, at: __m512i, height: __m512i) -> [__m512i; 2] {
    let is_node = is_node::<Q>(height);
    let mut offset = _mm512_slli_epi32::<3>(at);
    offset = _mm512_mask_add_epi32(offset, is_node, offset, _mm512_slli_epi32::<2>(at));
    let mut offset = wide(offset);
    if Q::FINER > 0 {
        // Bytes to units may be more than 32 bits.
        let size = wide(_mm512_mask_mov_epi32(_mm512_set1_epi32(8), is_node, _mm512_set1_epi32(12)));
        let at = wide(at);
        offset = std::array::from_fn(|half| _mm512_mul_epu32(at[half], size[half]));
    }
    let (nodes, bitmaps) = (_mm512_set1_epi64(tree.nodes as i64), _mm512_set1_epi64(tree.bitmaps as i64));
    let is_leaf = twice(!is_node);
    let mut base: [__m512i; 2] =
        std::array::from_fn(|half| _mm512_add_epi64(nodes, _mm512_and_si512(is_leaf[half], bitmaps)));
    if Q::FINER > 0 {
        let is_unit = twice(_mm512_cmplt_epi32_mask(height, _mm512_set1_epi32(Q::FINER as i32)));
        let units = _mm512_set1_epi64(tree.units() as i64);
        base =
            std::array::from_fn(|half| _mm512_add_epi64(base[half], _mm512_and_si512(is_unit[half], units)));
    }
    std::array::from_fn(|half| _mm512_add_epi64(base[half], offset[half]))
}

/// All ones in each 64 bits whose lane is set.
#[inline]
#[target_feature(enable = "avx512f,avx512dq")]
fn twice(lanes: __mmask16) -> [__m512i; 2] {
    let ones = _mm512_movm_epi32(lanes);
    [_mm512_unpacklo_epi32(ones, ones), _mm512_unpackhi_epi32(ones, ones)]
}

#[inline]
#[target_feature(enable = "avx512f")]
fn wide(words: __m512i) -> [__m512i; 2] {
    let zeros = _mm512_setzero_si512();
    [_mm512_unpacklo_epi32(words, zeros), _mm512_unpackhi_epi32(words, zeros)]
}

#[inline]
#[target_feature(enable = "avx512f")]
fn narrow<const WORDS: i32>([low, high]: [__m512i; 2]) -> __m512i {
    _mm512_castps_si512(_mm512_shuffle_ps::<WORDS>(_mm512_castsi512_ps(low), _mm512_castsi512_ps(high)))
}
