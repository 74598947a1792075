//! Vertices on their way in and out: the bits above their axes are cleared, cells and greatest coordinates taken of
//! them, and then they are packed one behind the other.
//!
//! ```text
//! eight vertices of w bits take w bytes: number k begins in byte k w / 8, at bit s = k w % 8 of it, and the word
//! there is v[k] << s | v[k - 1] >> (w - s)
//! ```
//!
//! So no word waits for the one before it, and four are made at once. (One behind the other, in a word of pending bits,
//! was 22 instructions a vertex; this is 4.) Before they are decoded, their guides are parted from the vertex before:
//! that one is still in a register, and its way through memory would be what each of them waits for.
//!
//! Why unsafe: AVX2, as intrinsics. Who calls has a `Bmi2`, which is the proof that it is there.
//!
//! Invariants: 1. both twins write the same bytes; 2. behind the last vertex nothing but zeros is written, 64 bytes at
//! most.

#![allow(unsafe_code)]

use super::cells::{self, Cells};
use super::packing::VertexPacking;
use crate::layout::{CLUSTER_VERTICES, LEAF_TRIANGLES};

/// Vertices of a cluster, packed, and room for numbers that no vertex has.
pub(super) type VertexWords = [u64; 256];
/// What each vertex is predicted from, `[from, to, opposite][vertex]`: the edge across which it was met. All three
/// are the same where there was none. Longer than what is in use, so that a byte needs no check.
pub(super) type Guides = [[u8; 256 + LEAF_TRIANGLES]; 3];
/// The tag of each vertex.
pub(super) type Tags = [u8; CLUSTER_VERTICES];
/// How often the vertex before is added to one.
pub(super) type Signs = [i8; CLUSTER_VERTICES];
/// The tag of a vertex without prediction.
pub(super) const PLAIN: u8 = 3;
/// A number that no vertex has.
pub(super) const NO_VERTEX: u8 = u8::MAX;
/// Vertices that are packed at a time: they begin and end with a byte.
const GROUP: usize = 8;
/// Bytes that a group is written to, at most.
pub(super) const GROUP_BYTES: usize = 64;

/// Clears the bits above the axes of the first `count` vertices, a cell for each, and the greatest number of each axis.
/// Those behind are zero.
#[inline(always)]
pub(super) fn finish_in_words(
    packing: &VertexPacking,
    shift: [u8; 3],
    vertices: &mut [u64],
    cells: &mut Cells,
) -> [u32; 3] {
    vertices.iter_mut().for_each(|v| *v &= packing.mask);
    cells::fill(packing, shift, vertices, cells);
    packing.greatest(vertices)
}

/// Writes vertices of `bits` bits, none above them, to the front of `out`.
#[inline(always)]
pub(super) fn pack_in_words(vertices: &[u64], bits: u32, out: &mut [u8]) {
    let (mut at, mut pending, mut pending_bits) = (0, 0u64, 0);
    for &v in vertices {
        pending |= v << pending_bits;
        out[at..at + 8].copy_from_slice(&pending.to_le_bytes());
        pending_bits += bits;
        // In two steps, since all eight bytes may be full.
        let full = pending_bits / 8;
        pending = pending >> (4 * full) >> (4 * full);
        at += full as usize;
        pending_bits %= 8;
    }
    out[at..at + 8].copy_from_slice(&pending.to_le_bytes());
}

/// Takes out of guides what their vertex need not wait for in memory: where one is the vertex before, or the value is
/// plain, it becomes the number of no vertex, whose place holds zero. Gives how often the vertex before is to be
/// added, by vertex: -1 to 2.
#[inline(always)]
pub(super) fn part_guides_in_bytes(guides: &mut Guides, tags: &Tags, count: usize) -> Signs {
    let mut signs = [0; CLUSTER_VERTICES];
    for (i, sign) in signs.iter_mut().enumerate().take(count) {
        let is_plain = tags[i] == PLAIN;
        for (guide, weight) in guides.iter_mut().zip([1, 1, -1]) {
            let is_before = guide[i] == (i as u8).wrapping_sub(1);
            *sign += if is_before && !is_plain { weight } else { 0 };
            guide[i] = if is_before || is_plain { NO_VERTEX } else { guide[i] };
        }
    }
    signs
}

/// The same with AVX2.
#[cfg(target_arch = "x86_64")]
pub(super) mod avx2 {
    use super::*;
    use std::arch::x86_64::*;

    /// Vertices of a register.
    const LANES: usize = 4;
    /// Narrower ones have bits of more than two in a byte.
    pub(in super::super) const LEAST_BITS: u32 = 7;

    /// As [`finish_in_words`].
    ///
    /// # Safety
    /// AVX2 is there.
    #[inline(always)]
    pub(in super::super) unsafe fn finish(
        packing: &VertexPacking,
        shift: [u8; 3],
        (placed, count): (&mut VertexWords, usize),
        cells: &mut Cells,
    ) -> [u32; 3] {
        let four = placed.as_chunks_mut::<LANES>().0.iter_mut().zip(cells.as_chunks_mut::<LANES>().0);
        // SAFETY: by the contract; each load and store is of the four words that a chunk has.
        unsafe {
            let all = _mm256_set1_epi64x(packing.mask as i64);
            let axis = packing.bits.map(|bits| _mm256_set1_epi64x((1i64 << bits) - 1));
            let down = [1, 2].map(|a: usize| _mm_cvtsi32_si128(packing.shift[a] as i32));
            let to_cell = shift.map(|bits| _mm_cvtsi32_si128(i32::from(bits)));
            let low = _mm256_set1_epi64x(0xff_ffff);
            let mut most = [_mm256_setzero_si256(); 3];
            for (vertices, cells) in four.take(count.div_ceil(LANES)) {
                let v = _mm256_and_si256(_mm256_loadu_si256(vertices.as_ptr().cast()), all);
                _mm256_storeu_si256(vertices.as_mut_ptr().cast(), v);
                let x = _mm256_and_si256(v, axis[0]);
                let y = _mm256_and_si256(_mm256_srl_epi64(v, down[0]), axis[1]);
                let z = _mm256_srl_epi64(v, down[1]);
                // An axis has 24 bits at most.
                most = [
                    _mm256_max_epu32(most[0], x),
                    _mm256_max_epu32(most[1], y),
                    _mm256_max_epu32(most[2], z),
                ];
                let y = _mm256_slli_epi64::<8>(_mm256_srl_epi64(y, to_cell[1]));
                let z = _mm256_slli_epi64::<16>(_mm256_srl_epi64(z, to_cell[2]));
                let places = _mm256_or_si256(_mm256_or_si256(_mm256_srl_epi64(x, to_cell[0]), y), z);
                let rest = _mm256_slli_epi64::<24>(_mm256_xor_si256(places, low));
                _mm256_storeu_si256(cells.as_mut_ptr().cast(), _mm256_or_si256(places, rest));
            }
            most.map(|lanes| {
                let two = _mm_max_epu32(_mm256_castsi256_si128(lanes), _mm256_extracti128_si256::<1>(lanes));
                let one = _mm_max_epu32(two, _mm_unpackhi_epi64(two, two));
                _mm_cvtsi128_si32(one) as u32
            })
        }
    }

    /// As [`pack_in_words`], for at least [`LEAST_BITS`] bits. Those behind `count` are zero.
    ///
    /// # Safety
    /// AVX2 is there.
    #[inline(always)]
    pub(in super::super) unsafe fn pack(placed: &VertexWords, count: usize, bits: u32, out: &mut [u8]) {
        debug_assert!((LEAST_BITS..=57).contains(&bits));
        let begins: [usize; GROUP] = std::array::from_fn(|k| k * bits as usize);
        let up = begins.map(|bit| (bit % 8) as i64);
        let bytes = begins.map(|bit| bit / 8);
        let mut at = 0;
        // SAFETY: by the contract; loads are of registers that lie in an array of as many words; stores are of eight
        // bytes at `bytes`, at most 7 * 57 / 8 = 49, in a slice of 64.
        unsafe {
            let up: [__m256i; 2] = bytemuck::cast(up);
            let down = up.map(|up| _mm256_sub_epi64(_mm256_set1_epi64x(i64::from(bits)), up));
            let mut before = _mm256_setzero_si256();
            for group in placed.as_chunks::<GROUP>().0.iter().take(count.div_ceil(GROUP)) {
                let out = out[at..at + GROUP_BYTES].as_mut_ptr();
                for half in 0..2 {
                    let v = _mm256_loadu_si256(group.as_ptr().add(LANES * half).cast());
                    // Each one place on, and the last of the four before in front.
                    let turned = _mm256_permute4x64_epi64::<0b10_01_00_11>(v);
                    let last = _mm256_blend_epi32::<0b11>(turned, before);
                    before = turned;
                    let words =
                        _mm256_or_si256(_mm256_sllv_epi64(v, up[half]), _mm256_srlv_epi64(last, down[half]));
                    let (low, high) = (_mm256_castsi256_si128(words), _mm256_extracti128_si256::<1>(words));
                    let to = |k: usize| out.add(bytes[LANES * half + k]);
                    _mm_storel_pd(to(0).cast(), _mm_castsi128_pd(low));
                    _mm_storeh_pd(to(1).cast(), _mm_castsi128_pd(low));
                    _mm_storel_pd(to(2).cast(), _mm_castsi128_pd(high));
                    _mm_storeh_pd(to(3).cast(), _mm_castsi128_pd(high));
                }
                at += bits as usize;
            }
        }
    }

    /// As [`part_guides_in_bytes`].
    ///
    /// # Safety
    /// AVX2 is there.
    #[inline(always)]
    pub(in super::super) unsafe fn part_guides(guides: &mut Guides, tags: &Tags, count: usize) -> Signs {
        const BYTES: usize = size_of::<__m256i>();
        const BEFORE: [u8; BYTES] = {
            let mut before = [u8::MAX; BYTES];
            let mut i = 1;
            while i < BYTES {
                before[i] = i as u8 - 1;
                i += 1;
            }
            before
        };
        let mut signs = [0; CLUSTER_VERTICES];
        let [from, to, opposite] = guides.each_mut().map(|guide| guide.as_chunks_mut::<BYTES>().0.iter_mut());
        let all =
            from.zip(to).zip(opposite).zip(tags.as_chunks::<BYTES>().0).zip(signs.as_chunks_mut::<BYTES>().0);
        // SAFETY: by the contract; each load and store is of the 32 bytes that a chunk has.
        unsafe {
            let mut before: __m256i = bytemuck::cast(BEFORE);
            for ((((from, to), opposite), tags), signs) in all.take(count.div_ceil(BYTES)) {
                let plain = _mm256_cmpeq_epi8(
                    _mm256_loadu_si256(tags.as_ptr().cast()),
                    _mm256_set1_epi8(PLAIN as i8),
                );
                let (a, b) = (part(from, before, plain), part(to, before, plain));
                let c = part(opposite, before, plain);
                // What is true is -1.
                let sign = _mm256_andnot_si256(plain, _mm256_sub_epi8(_mm256_sub_epi8(c, a), b));
                _mm256_storeu_si256(signs.as_mut_ptr().cast(), sign);
                before = _mm256_add_epi8(before, _mm256_set1_epi8(BYTES as i8));
            }
        }
        signs
    }

    /// Where guides are `before` or of plain vertices they become [`NO_VERTEX`]. Gives where they were `before`.
    #[inline(always)]
    unsafe fn part(guides: &mut [u8; size_of::<__m256i>()], before: __m256i, plain: __m256i) -> __m256i {
        // SAFETY: AVX2 is there, by the contract of who calls; a register is as long as the array.
        unsafe {
            let there = _mm256_loadu_si256(guides.as_ptr().cast());
            let is_before = _mm256_cmpeq_epi8(there, before);
            let parted = _mm256_or_si256(_mm256_or_si256(there, is_before), plain);
            _mm256_storeu_si256(guides.as_mut_ptr().cast(), parted);
            is_before
        }
    }
}
