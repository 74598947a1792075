//! The AVX2 kernel: eight boxes or triangles at a time, f32.
//!
//! A leaf's corners are three words of eight narrow indices: one `pdep` spreads a word to eight bytes. A packed
//! vertex is one unaligned 64-bit load: two gathers of four fetch eight. Vertices of wide clusters are fetched
//! one by one and tested like the others.
//!
//! Invariants: 1. the same operations in the same order as `scalar.rs`: the same bits; 2. loads stay inside of the
//! frame: indices were checked by `install`, and eight bytes stand behind the last vertex.
#![allow(unsafe_code)]

use crate::trace::kernel::{Kernel, Lanes};
use crate::trace::lattice_ray::{LatticeFrame, LatticeRay};
use crate::trace::scalar::{Real, Scalar};
use std::arch::x86_64::*;
use std::mem::offset_of;
use trex_store::cluster::{CLUSTER_HEAD_BYTES, ClusterHead, ClusterView, LeafIndices, Node};
use trex_store::layout::{CLUSTER_LEAVES, NODE_WIDTH};

/// A ray set up for eight lanes.
pub(in crate::trace) struct Avx2 {
    cell: __m128i,
    inverse: __m128,
    /// Start of the slabs: see `Slabs`.
    start_near: __m128,
    start_far: __m128,
    /// Mask of the axes along which the direction is negative.
    negative: __m128i,
    /// Rows of planes where the ray enters and leaves, per axis: of lower planes then upper ones.
    near_row: [usize; 3],
    far_row: [usize; 3],
    /// The axes in the order of the shear: x, y, z of the sheared space.
    k: [usize; 3],
    /// The axes as places in a vector, to spread words by, and counts of 64 bits.
    axes: [__m256i; 3],
    axes_long: [__m256i; 3],
    /// Fraction and shear, in the order of `k`.
    fraction: [f32; 3],
    s: [f32; 3],
    blur: f32,
}

/// Boxes with planes `q * scale + lo` and `q * scale + hi`, lattice steps from the ray's cell; the fourth is not used.
struct Boxes {
    lo: __m128i,
    hi: __m128i,
    scale: __m128,
}

/// Boxes as the ray sees them: `t = q * step + near` or `+ far`, per axis.
struct SeenBoxes {
    step: [__m256; 3],
    near: [__m256; 3],
    far: [__m256; 3],
}

impl Avx2 {
    /// The kernel of a ray that is set up for the plain one.
    #[inline(always)]
    pub(in crate::trace) fn from_scalar(ray: &Scalar<f32>) -> Avx2 {
        let Scalar { cell, slabs, fraction, k, s, blur, .. } = *ray;
        let cell = cell.map(|cell| cell as i32);
        // SAFETY: registers only.
        unsafe {
            let three = |v: [f32; 3]| _mm_setr_ps(v[0], v[1], v[2], 0.0);
            let ones = slabs.negative.map(|negative| -i32::from(negative));
            Avx2 {
                cell: _mm_setr_epi32(cell[0], cell[1], cell[2], 0),
                inverse: three(slabs.inverse),
                start_near: three(slabs.start_near),
                start_far: three(slabs.start_far),
                negative: _mm_setr_epi32(ones[0], ones[1], ones[2], 0),
                near_row: std::array::from_fn(|a| a + 3 * usize::from(slabs.negative[a])),
                far_row: std::array::from_fn(|a| a + 3 * usize::from(!slabs.negative[a])),
                k,
                axes: [axis(k[0], k[0]), axis(k[1], k[1]), axis(k[2], k[2])],
                // The fifth number is zero.
                axes_long: [axis(k[0], 4), axis(k[1], 4), axis(k[2], 4)],
                fraction: k.map(|a| fraction[a]),
                s,
                blur,
            }
        }
    }

    /// The boxes as the ray sees them: see `Slabs::meet`.
    #[inline(always)]
    fn see(&self, boxes: &Boxes) -> SeenBoxes {
        // SAFETY: registers only; the caller runs with AVX2 and FMA.
        unsafe {
            let at_near = _mm_blendv_epi8(boxes.lo, boxes.hi, self.negative);
            let at_far = _mm_blendv_epi8(boxes.hi, boxes.lo, self.negative);
            let step = _mm_mul_ps(boxes.scale, self.inverse);
            let near = _mm_fmadd_ps(_mm_cvtepi32_ps(at_near), self.inverse, self.start_near);
            let far = _mm_fmadd_ps(_mm_cvtepi32_ps(at_far), self.inverse, self.start_far);
            SeenBoxes { step: spread(step), near: spread(near), far: spread(far) }
        }
    }

    /// The rows of planes where the ray enters and where it leaves, of six: lower and upper ones.
    #[inline(always)]
    fn rows(&self, rows: *const u8, stride: usize) -> [[*const u8; 3]; 2] {
        let ([a, b, c], [d, e, f]) = (self.near_row, self.far_row);
        let row = |row: usize| rows.wrapping_add(stride * row);
        [[row(a), row(b), row(c)], [row(d), row(e), row(f)]]
    }

    /// Tests eight boxes, by their planes, rows of which `eight` reads: a bit each, and t.
    #[inline(always)]
    fn meet(
        &self,
        seen: &SeenBoxes,
        near: [*const u8; 3],
        far: [*const u8; 3],
        t_max: f32,
        eight: impl Fn(*const u8) -> __m256,
    ) -> (u32, __m256) {
        // SAFETY: registers only; the caller runs with AVX2 and FMA.
        unsafe {
            let (mut enter, mut leave) = ([_mm256_setzero_ps(); 3], [_mm256_setzero_ps(); 3]);
            for a in 0..3 {
                enter[a] = _mm256_fmadd_ps(eight(near[a]), seen.step[a], seen.near[a]);
                leave[a] = _mm256_fmadd_ps(eight(far[a]), seen.step[a], seen.far[a]);
            }
            let near = _mm256_max_ps(
                _mm256_max_ps(enter[0], enter[1]),
                _mm256_max_ps(enter[2], _mm256_setzero_ps()),
            );
            let far = _mm256_min_ps(_mm256_min_ps(leave[0], leave[1]), leave[2]);
            let far = _mm256_mul_ps(far, _mm256_set1_ps(<f32 as Real>::FAR));
            let met = _mm256_and_ps(
                _mm256_cmp_ps::<_CMP_LE_OQ>(near, far),
                _mm256_cmp_ps::<_CMP_LE_OQ>(near, _mm256_set1_ps(t_max)),
            );
            (_mm256_movemask_ps(met) as u32, near)
        }
    }

    /// The eight vertices `indices`, relative to the ray's entry and sheared: x, y, z.
    #[inline(always)]
    fn corner(&self, cluster: &Vertices<'_>, indices: u64) -> [__m256; 3] {
        let q = if cluster.view.is_wide() { self.wide(cluster, indices) } else { compact(cluster, indices) };
        // SAFETY: registers only; the caller runs with AVX2 and FMA.
        unsafe {
            let mut p = [_mm256_setzero_ps(); 3];
            for i in 0..3 {
                let relative = _mm256_add_epi32(q[i], cluster.relative[i]);
                p[i] = _mm256_sub_ps(_mm256_cvtepi32_ps(relative), _mm256_set1_ps(self.fraction[i]));
            }
            let ([x, y, z], [sx, sy, sz]) = (p, self.s);
            [
                _mm256_fnmadd_ps(_mm256_set1_ps(sx), z, x),
                _mm256_fnmadd_ps(_mm256_set1_ps(sy), z, y),
                _mm256_mul_ps(_mm256_set1_ps(sz), z),
            ]
        }
    }

    /// The vertices of a wide cluster above its base.
    #[inline(never)]
    fn wide(&self, cluster: &Vertices<'_>, indices: u64) -> [__m256i; 3] {
        let base = cluster.view.base();
        let mut q = [[0i32; 8]; 3];
        for (lane, index) in indices.to_le_bytes().into_iter().enumerate() {
            let vertex = cluster.view.vertex(usize::from(index));
            for (q, a) in q.iter_mut().zip(self.k) {
                q[lane] = (vertex[a] - base[a]) as i32;
            }
        }
        // SAFETY: each array holds eight numbers.
        unsafe {
            [
                _mm256_loadu_si256(q[0].as_ptr().cast()),
                _mm256_loadu_si256(q[1].as_ptr().cast()),
                _mm256_loadu_si256(q[2].as_ptr().cast()),
            ]
        }
    }

    /// The vertices of a cluster, ready to be read.
    #[inline(always)]
    fn vertices<'a>(&self, view: &'a ClusterView<'a>) -> Vertices<'a> {
        let head = view.head();
        let widths = u32::from_le_bytes([head.widths[0], head.widths[1], head.widths[2], 0]);
        // SAFETY: registers only; the caller runs with AVX2.
        unsafe {
            let relative = _mm256_castsi128_si256(_mm_sub_epi32(base(head), self.cell));
            let widths = _mm_cvtepu8_epi32(_mm_cvtsi32_si128(widths as i32));
            let masks = _mm_sub_epi32(_mm_sllv_epi32(_mm_set1_epi32(1), widths), _mm_set1_epi32(1));
            let before = _mm_add_epi32(_mm_slli_si128::<4>(widths), _mm_slli_si128::<8>(widths));
            let (masks, before) = (_mm256_castsi128_si256(masks), _mm256_zextsi128_si256(before));
            let mut vertices = Vertices {
                view,
                first: view.bytes().as_ptr().wrapping_add(view.vertices_offset()),
                bits: _mm256_set1_epi32(view.vertex_bits() as i32),
                relative: [_mm256_setzero_si256(); 3],
                before: [_mm256_setzero_si256(); 3],
                masks: [_mm256_setzero_si256(); 3],
            };
            for i in 0..3 {
                vertices.relative[i] = _mm256_permutevar8x32_epi32(relative, self.axes[i]);
                vertices.before[i] = _mm256_permutevar8x32_epi32(before, self.axes_long[i]);
                vertices.masks[i] = _mm256_permutevar8x32_epi32(masks, self.axes[i]);
            }
            vertices
        }
    }

    /// Lanes that are surely off the ray: see `Scalar::is_surely_off`.
    #[inline(always)]
    fn surely_off(&self, [a, b, c]: [[__m256; 3]; 3], [u, v, w]: [__m256; 3], t_max: f32) -> __m256 {
        // SAFETY: registers only; the caller runs with AVX2.
        unsafe {
            let sign = _mm256_set1_ps(-0.0);
            let sum = _mm256_add_ps(_mm256_add_ps(u, v), w);
            let two = _mm256_add_ps(_mm256_mul_ps(u, a[2]), _mm256_mul_ps(v, b[2]));
            let volume = _mm256_add_ps(two, _mm256_mul_ps(w, c[2]));
            let volume = _mm256_xor_ps(volume, _mm256_and_ps(sum, sign));
            let sum = _mm256_andnot_ps(sign, sum);
            let mut size = _mm256_setzero_ps();
            for p in [a, b, c].as_flattened() {
                size = _mm256_max_ps(size, _mm256_andnot_ps(sign, *p));
            }
            let share = _mm256_set1_ps(<f32 as Real>::VOLUME as f32);
            let error = _mm256_mul_ps(_mm256_mul_ps(_mm256_mul_ps(share, size), size), size);
            let blurred = _mm256_mul_ps(_mm256_set1_ps(self.blur), sum);
            let least = _mm256_andnot_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(error, blurred), error);
            let behind = _mm256_sub_ps(volume, _mm256_mul_ps(_mm256_set1_ps(t_max), sum));
            _mm256_or_ps(
                _mm256_cmp_ps::<_CMP_LT_OQ>(volume, _mm256_xor_ps(least, sign)),
                _mm256_cmp_ps::<_CMP_GT_OQ>(behind, least),
            )
        }
    }
}

/// The first three numbers, eight times each.
#[inline(always)]
fn spread(v: __m128) -> [__m256; 3] {
    // SAFETY: registers only; the caller runs with AVX2.
    unsafe {
        let v = _mm256_castps128_ps256(v);
        [
            _mm256_permutevar8x32_ps(v, _mm256_set1_epi32(0)),
            _mm256_permutevar8x32_ps(v, _mm256_set1_epi32(1)),
            _mm256_permutevar8x32_ps(v, _mm256_set1_epi32(2)),
        ]
    }
}

/// Two places in turn.
#[inline(always)]
fn axis(even: usize, odd: usize) -> __m256i {
    // SAFETY: registers only; the caller runs with AVX2.
    unsafe { _mm256_set1_epi64x((even | odd << 32) as i64) }
}

/// Eight bytes as numbers.
///
/// # Safety
/// There are eight bytes.
#[inline(always)]
unsafe fn eight(bytes: *const u8) -> __m256 {
    // SAFETY: by the contract; the caller runs with AVX2.
    unsafe { _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(_mm_loadl_epi64(bytes.cast()))) }
}

/// Eight numbers of two bytes.
///
/// # Safety
/// There are sixteen bytes.
#[inline(always)]
unsafe fn eight_words(bytes: *const u8) -> __m256 {
    // SAFETY: by the contract; the caller runs with AVX2.
    unsafe { _mm256_cvtepi32_ps(_mm256_cvtepu16_epi32(_mm_loadu_si128(bytes.cast()))) }
}

/// The low words of a cluster's base, and a word that means nothing: a lattice for f32 has no more than 24 bits.
#[inline(always)]
fn base(head: &ClusterHead) -> __m128i {
    // SAFETY: the head begins with three numbers of five bytes and is longer than sixteen; the caller runs with AVX2.
    unsafe {
        let low_words = _mm_setr_epi8(0, 1, 2, 3, 5, 6, 7, 8, 10, 11, 12, 13, -1, -1, -1, -1);
        _mm_shuffle_epi8(_mm_loadu_si128(std::ptr::from_ref(head).cast()), low_words)
    }
}

/// A cluster while its triangles are tested. Axes are in the order of the shear.
struct Vertices<'a> {
    view: &'a ClusterView<'a>,
    first: *const u8,
    /// Bits of a packed vertex.
    bits: __m256i,
    /// Base minus the ray's cell.
    relative: [__m256i; 3],
    /// Bits before the axis in a packed vertex, as 64-bit counts, and the mask of its own.
    before: [__m256i; 3],
    masks: [__m256i; 3],
}

/// Packed vertices above the base. Those of triangles 0, 1, 4, 5 go to the low half and come back in order.
#[inline(always)]
fn compact(cluster: &Vertices<'_>, indices: u64) -> [__m256i; 3] {
    // SAFETY: indices are below the vertex count (checked by install), so that bit offsets lie inside of the packed
    // vertices, and eight more bytes follow these within the frame.
    unsafe {
        let order = _mm_setr_epi8(0, 1, 4, 5, 2, 3, 6, 7, -1, -1, -1, -1, -1, -1, -1, -1);
        let index = _mm256_cvtepu8_epi32(_mm_shuffle_epi8(_mm_cvtsi64_si128(indices as i64), order));
        // Both factors fit 16 bits.
        let bit = _mm256_madd_epi16(index, cluster.bits);
        let byte = _mm256_srli_epi32::<3>(bit);
        let shift = _mm256_and_si256(bit, _mm256_set1_epi32(7));
        let low = _mm256_i32gather_epi64::<1>(cluster.first.cast(), _mm256_castsi256_si128(byte));
        let high = _mm256_i32gather_epi64::<1>(cluster.first.cast(), _mm256_extracti128_si256::<1>(byte));
        let low = _mm256_srlv_epi64(low, _mm256_cvtepu32_epi64(_mm256_castsi256_si128(shift)));
        let high = _mm256_srlv_epi64(high, _mm256_cvtepu32_epi64(_mm256_extracti128_si256::<1>(shift)));
        let mut out = [_mm256_setzero_si256(); 3];
        for i in 0..3 {
            let low = _mm256_castsi256_ps(_mm256_srlv_epi64(low, cluster.before[i]));
            let high = _mm256_castsi256_ps(_mm256_srlv_epi64(high, cluster.before[i]));
            let both = _mm256_castps_si256(_mm256_shuffle_ps::<0x88>(low, high));
            out[i] = _mm256_and_si256(both, cluster.masks[i]);
        }
        out
    }
}

/// `p * q - r * s`, each product rounded: a shared edge gives opposite values to its two triangles.
#[inline(always)]
fn cross(p: __m256, q: __m256, r: __m256, s: __m256) -> __m256 {
    // SAFETY: registers only; the caller runs with AVX2.
    unsafe { _mm256_sub_ps(_mm256_mul_ps(p, q), _mm256_mul_ps(r, s)) }
}

/// [`cross`] of what the roundings of its products have lost.
#[inline(always)]
fn cross_of_lost(p: __m256, q: __m256, r: __m256, s: __m256) -> __m256 {
    // SAFETY: registers only; the caller runs with AVX2 and FMA.
    unsafe {
        let (pq, rs) = (_mm256_mul_ps(p, q), _mm256_mul_ps(r, s));
        _mm256_sub_ps(_mm256_fmsub_ps(p, q, pq), _mm256_fmsub_ps(r, s, rs))
    }
}

/// Lanes where all three are zero.
#[inline(always)]
fn are_zero(u: __m256, v: __m256, w: __m256) -> __m256 {
    // SAFETY: registers only; the caller runs with AVX2.
    unsafe {
        let all = _mm256_or_ps(_mm256_or_ps(u, v), w);
        _mm256_cmp_ps::<_CMP_EQ_OQ>(all, _mm256_setzero_ps())
    }
}

impl Kernel for Avx2 {
    #[inline(always)]
    fn new(frame: &LatticeFrame, ray: &LatticeRay) -> Avx2 {
        Avx2::from_scalar(&Scalar::new(frame, ray))
    }

    #[inline(always)]
    fn node(&self, node: &Node, t_max: f32) -> Lanes<NODE_WIDTH> {
        let mut lanes = Lanes { mask: 0, t: [0.0; 8] };
        let rows = std::ptr::from_ref(&node.lo).cast::<u8>();
        // SAFETY: a node begins with its origin, exponents and count, 16 bytes; its lower planes are followed by the
        // upper ones, six rows of eight numbers of two bytes, as asserted below. The caller runs with AVX2 and FMA.
        unsafe {
            let head = _mm_loadu_si128(std::ptr::from_ref(node).cast());
            let exponents = _mm_setr_epi8(-1, -1, -1, 12, -1, -1, -1, 13, -1, -1, -1, 14, -1, -1, -1, -1);
            let exponents = _mm_srli_epi32::<1>(_mm_shuffle_epi8(head, exponents));
            let scale = _mm_castsi128_ps(_mm_add_epi32(exponents, _mm_castps_si128(_mm_set1_ps(1.0))));
            let base = _mm_sub_epi32(head, self.cell);
            let seen = self.see(&Boxes { lo: base, hi: base, scale });
            let [near, far] = self.rows(rows, 2 * NODE_WIDTH);
            let (mask, t) = self.meet(&seen, near, far, t_max, |row| eight_words(row));
            _mm256_storeu_ps(lanes.t.as_mut_ptr(), t);
            lanes.mask = mask & ((1 << node.child_count) - 1);
        }
        lanes
    }

    #[inline(always)]
    fn leaf_boxes(&self, cluster: &ClusterView<'_>, t_max: f32) -> Lanes<CLUSTER_LEAVES> {
        let mut lanes = Lanes { mask: 0, t: [0.0; 16] };
        let (head, leaf_count) = (cluster.head(), cluster.leaf_count());
        let rows = cluster.bytes()[CLUSTER_HEAD_BYTES..].as_ptr();
        let widths = u32::from_le_bytes([head.widths[0], head.widths[1], head.widths[2], 0]);
        // SAFETY: six rows of a byte a leaf; behind them the frame holds more than the eight or sixteen bytes that are
        // read of each: shapes, indices, a palette, and its tail. The caller runs with AVX2 and FMA.
        unsafe {
            let shift = _mm_subs_epu8(_mm_cvtsi32_si128(widths as i32), _mm_set1_epi8(8));
            let cell = _mm_sllv_epi32(_mm_set1_epi32(1), _mm_cvtepu8_epi32(shift));
            let lo = _mm_sub_epi32(base(head), self.cell);
            // Upper planes are cells: no vertex lies beyond the last step of one.
            let hi = _mm_add_epi32(lo, _mm_sub_epi32(cell, _mm_set1_epi32(1)));
            let seen = self.see(&Boxes { lo, hi, scale: _mm_cvtepi32_ps(cell) });
            let [near, far] = self.rows(rows, leaf_count);
            let (mask, t) = self.meet(&seen, near, far, t_max, |row| eight(row));
            _mm256_storeu_ps(lanes.t.as_mut_ptr(), t);
            lanes.mask = mask;
            if leaf_count > 8 {
                let [near, far] = self.rows(rows.add(8), leaf_count);
                let (mask, t) = self.meet(&seen, near, far, t_max, |row| eight(row));
                _mm256_storeu_ps(lanes.t.as_mut_ptr().add(8), t);
                lanes.mask |= mask << 8;
            }
        }
        lanes.mask &= (1 << leaf_count) - 1;
        lanes
    }

    #[inline(always)]
    fn prefetch(frame: &[u8], at: usize, lines: usize) {
        for line in 0..lines {
            // SAFETY: a hint; nothing is read.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(frame.as_ptr().wrapping_add(at + 64 * line).cast()) };
        }
    }

    #[inline(always)]
    fn triangles(&self, cluster: &ClusterView<'_>, leaf: usize, t_max: f32) -> u32 {
        let vertices = self.vertices(cluster);
        let LeafIndices { at, shape } = cluster.leaf_indices(leaf);
        // SAFETY: `install` wrote the leaf's least index and three words of narrow ones, and what follows them within
        // the frame is longer than eight bytes. The caller runs with AVX2, FMA and BMI2.
        unsafe {
            let leaf = cluster.bytes().as_ptr().add(at);
            let (least, stride) = (u64::from(*leaf) * BYTES_OF_ONE, shape.corner_bytes());
            // Of triangles that are not there all corners are the least: nothing is met.
            let there = u64::MAX >> (64 - 8 * shape.triangle_count());
            let spread = (((1 << shape.width()) - 1) * BYTES_OF_ONE) & there;
            let above = |corner: usize| leaf.add(1 + corner * stride).cast::<u64>().read_unaligned();
            let a = self.corner(&vertices, _pdep_u64(above(0), spread) + least);
            let b = self.corner(&vertices, _pdep_u64(above(1), spread) + least);
            let c = self.corner(&vertices, _pdep_u64(above(2), spread) + least);
            let mut u = cross(c[0], b[1], c[1], b[0]);
            let mut v = cross(a[0], c[1], a[1], c[0]);
            let mut w = cross(b[0], a[1], b[1], a[0]);
            let mut flat = are_zero(u, v, w);
            if _mm256_movemask_ps(flat) != 0 {
                u = _mm256_blendv_ps(u, cross_of_lost(c[0], b[1], c[1], b[0]), flat);
                v = _mm256_blendv_ps(v, cross_of_lost(a[0], c[1], a[1], c[0]), flat);
                w = _mm256_blendv_ps(w, cross_of_lost(b[0], a[1], b[1], a[0]), flat);
                flat = are_zero(u, v, w);
            }
            let (least, most) =
                (_mm256_min_ps(_mm256_min_ps(u, v), w), _mm256_max_ps(_mm256_max_ps(u, v), w));
            let zero = _mm256_setzero_ps();
            let inside = _mm256_or_ps(
                _mm256_cmp_ps::<_CMP_GE_OQ>(least, zero),
                _mm256_cmp_ps::<_CMP_LE_OQ>(most, zero),
            );
            let near = _mm256_min_ps(_mm256_min_ps(a[2], b[2]), c[2]);
            let far = _mm256_max_ps(_mm256_max_ps(a[2], b[2]), c[2]);
            let in_range = _mm256_and_ps(
                _mm256_cmp_ps::<_CMP_GE_OQ>(far, _mm256_setzero_ps()),
                _mm256_cmp_ps::<_CMP_LE_OQ>(near, _mm256_set1_ps(t_max)),
            );
            let met = _mm256_andnot_ps(flat, _mm256_and_ps(inside, in_range));
            if _mm256_movemask_ps(met) == 0 {
                return 0;
            }
            _mm256_movemask_ps(_mm256_andnot_ps(self.surely_off([a, b, c], [u, v, w], t_max), met)) as u32
        }
    }
}

/// Lower planes are followed by upper ones, and both by the children; before them stand sixteen bytes.
const _: () = assert!(
    offset_of!(Node, exponent) == 12
        && offset_of!(Node, child_count) == 15
        && offset_of!(Node, lo) == 16
        && offset_of!(Node, hi) == 16 + 3 * 2 * NODE_WIDTH
);

const BYTES_OF_ONE: u64 = 0x0101_0101_0101_0101;
