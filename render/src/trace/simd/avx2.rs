//! The AVX2 kernel: eight boxes or triangles at a time, f32.
//!
//! A leaf's corners are three words of eight narrow indices: one `pdep` spreads a word to eight bytes. A packed
//! vertex is one unaligned 64-bit load: two gathers of four fetch eight. Where eight vertices in a row hold all
//! corners of a leaf (58 % of the leaves that rays test on a CAD set, 2 to 13 % elsewhere), they are read once.
//! Vertices of wide clusters are fetched one by one and tested like the others.
//!
//! Invariants: 1. the same operations in the same order as `scalar.rs`: the same bits; 2. loads stay inside of the
//! frame: indices were checked by `install`, and eight bytes stand behind the last vertex.
#![allow(unsafe_code)]

mod enter;
mod refine;
#[cfg(test)]
mod tests;

use crate::trace::Ray;
use crate::trace::kernel::{Kernel, Lanes, TrianglesMet};
use crate::trace::lattice_ray::{LatticeFrame, RefinedHit, Span};
use crate::trace::scalar::Real;
use enter::{Order, Rows};
use refine::Exact;
use std::arch::x86_64::*;
use std::mem::offset_of;
use trex_store::cluster::{CLUSTER_HEAD_BYTES, ChildBoxes, ClusterHead, ClusterView, LeafIndices};
use trex_store::layout::{CLUSTER_LEAVES, NODE_WIDTH};

/// A ray set up for eight lanes. Of four lanes the last is not used, but where it is said.
pub(in crate::trace) struct Avx2 {
    pub(super) cell: __m128i,
    pub(super) inverse: __m128,
    /// Start of the slabs: see `Slabs`.
    pub(super) start_near: __m128,
    pub(super) start_far: __m128,
    /// Mask of the axes along which the direction is negative.
    negative: __m128i,
    /// Where the ray enters and leaves.
    rows: &'static Rows,
    /// The axes in the order of the shear.
    order: &'static Order,
    /// Fraction and shear, in that order.
    fraction: [f32; 4],
    s: [f32; 4],
    blur: f32,
    /// For what is refined; the fourth lanes are zero.
    exact: Exact,
}

/// Boxes with planes `q * scale + lo` and `q * scale + hi`, lattice steps from the ray's cell; the fourth is not used.
struct PlaneRegisters {
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
    /// The boxes as the ray sees them: see `Slabs::meet`.
    #[inline(always)]
    fn see(&self, boxes: &PlaneRegisters) -> SeenBoxes {
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
        let [[a, b, c], [d, e, f]] = *self.rows;
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
    fn corner(&self, cluster: &Vertices<'_>, indices: __m128i) -> [__m256; 3] {
        let q = if cluster.view.is_wide() { self.wide(cluster, indices) } else { compact(cluster, indices) };
        // SAFETY: registers only; the caller runs with AVX2 and FMA.
        unsafe {
            let mut p = [_mm256_setzero_ps(); 3];
            for i in 0..3 {
                let relative = _mm256_add_epi32(q[i], cluster.relative[i]);
                p[i] = _mm256_sub_ps(_mm256_cvtepi32_ps(relative), _mm256_set1_ps(self.fraction[i]));
            }
            let ([x, y, z], [sx, sy, sz, _]) = (p, self.s);
            [
                _mm256_fnmadd_ps(_mm256_set1_ps(sx), z, x),
                _mm256_fnmadd_ps(_mm256_set1_ps(sy), z, y),
                _mm256_mul_ps(_mm256_set1_ps(sz), z),
            ]
        }
    }

    /// The vertices of a wide cluster above its base.
    #[inline(never)]
    fn wide(&self, cluster: &Vertices<'_>, indices: __m128i) -> [__m256i; 3] {
        let base = cluster.view.base();
        let mut q = [[0i32; 8]; 3];
        let indices: [u8; 16] = bytemuck::cast(indices);
        for (lane, &index) in indices[..8].iter().enumerate() {
            let vertex = cluster.view.vertex(usize::from(index));
            for (q, a) in q.iter_mut().zip(self.order.k) {
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
        // SAFETY: tables of eight numbers, else registers only; the caller runs with AVX2.
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
                let axis = _mm256_loadu_si256(self.order.axes[i].as_ptr().cast());
                let axis_long = _mm256_loadu_si256(self.order.axes_long[i].as_ptr().cast());
                vertices.relative[i] = _mm256_permutevar8x32_epi32(relative, axis);
                vertices.before[i] = _mm256_permutevar8x32_epi32(before, axis_long);
                vertices.masks[i] = _mm256_permutevar8x32_epi32(masks, axis);
            }
            vertices
        }
    }

    /// Lanes that are surely off `0 <= t <= t_max`, and those that are surely in `0 <= t <= t_sure`: see `Volume` of
    /// the plain kernel.
    #[inline(always)]
    fn surely(
        &self,
        [a, b, c]: [[__m256; 3]; 3],
        [u, v, w]: [__m256; 3],
        t_max: f32,
        t_sure: f32,
    ) -> [__m256; 2] {
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
            let is_sharp = _mm256_cmp_ps::<_CMP_LE_OQ>(error, blurred);
            let least = _mm256_andnot_ps(is_sharp, error);
            let behind = _mm256_sub_ps(volume, _mm256_mul_ps(_mm256_set1_ps(t_max), sum));
            let off = _mm256_or_ps(
                _mm256_cmp_ps::<_CMP_LT_OQ>(volume, _mm256_xor_ps(least, sign)),
                _mm256_cmp_ps::<_CMP_GT_OQ>(behind, least),
            );
            let left = _mm256_sub_ps(_mm256_mul_ps(_mm256_set1_ps(t_sure), sum), volume);
            let between = _mm256_and_ps(
                _mm256_cmp_ps::<_CMP_GE_OQ>(volume, blurred),
                _mm256_cmp_ps::<_CMP_GE_OQ>(left, blurred),
            );
            [off, _mm256_and_ps(is_sharp, between)]
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

/// Three numbers, and zero.
///
/// # Safety
/// The caller runs with AVX.
#[inline(always)]
unsafe fn three(v: &[f64; 3]) -> __m256d {
    // SAFETY: the fourth number is not read.
    unsafe { _mm256_maskload_pd(v.as_ptr(), _mm256_setr_epi64x(-1, -1, -1, 0)) }
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
fn compact(cluster: &Vertices<'_>, indices: __m128i) -> [__m256i; 3] {
    // SAFETY: indices are below the vertex count (checked by install), so that bit offsets lie inside of the packed
    // vertices, and eight more bytes follow these within the frame.
    unsafe {
        let order = _mm_setr_epi8(0, 1, 4, 5, 2, 3, 6, 7, -1, -1, -1, -1, -1, -1, -1, -1);
        let index = _mm256_cvtepu8_epi32(_mm_shuffle_epi8(indices, order));
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
    fn enter(frame: &LatticeFrame, ray: &Ray) -> Option<(Span, Avx2)> {
        // SAFETY: the caller runs with AVX2.
        unsafe { enter::enter(frame, ray) }
    }

    #[inline(always)]
    fn node(&self, node: &ChildBoxes, t_max: f32) -> Lanes<NODE_WIDTH> {
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
            let seen = self.see(&PlaneRegisters { lo: base, hi: base, scale });
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
            let seen = self.see(&PlaneRegisters { lo, hi, scale: _mm_cvtepi32_ps(cell) });
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
    fn triangles(&self, cluster: &ClusterView<'_>, leaf: usize, (t_max, t_sure): (f32, f32)) -> TrianglesMet {
        let vertices = self.vertices(cluster);
        let LeafIndices { at, shape } = cluster.leaf_indices(leaf);
        // SAFETY: `install` wrote the leaf's least index and three words of narrow ones, and what follows them within
        // the frame is longer than eight bytes. The caller runs with AVX2, FMA and BMI2.
        unsafe {
            let leaf = cluster.bytes().as_ptr().add(at);
            let (least, stride) = (_mm_set1_epi8(*leaf as i8), shape.corner_bytes());
            // Of triangles that are not there all corners are the least: nothing is met.
            let there = u64::MAX >> (64 - 8 * shape.triangle_count());
            let spread = (((1 << shape.width()) - 1) * BYTES_OF_ONE) & there;
            let above = |corner: usize| leaf.add(1 + corner * stride).cast::<u64>().read_unaligned();
            let above = [
                _mm_cvtsi64_si128(_pdep_u64(above(0), spread) as i64),
                _mm_cvtsi64_si128(_pdep_u64(above(1), spread) as i64),
                _mm_cvtsi64_si128(_pdep_u64(above(2), spread) as i64),
            ];
            let mut corners = [[_mm256_setzero_ps(); 3]; 3];
            let all = _mm_or_si128(_mm_or_si128(above[0], above[1]), above[2]);
            if _mm_testz_si128(all, _mm_set1_epi8(!7)) != 0 {
                // Eight vertices hold all corners: each is read once.
                let eight = _mm_setr_epi8(0, 1, 2, 3, 4, 5, 6, 7, 0, 0, 0, 0, 0, 0, 0, 0);
                let last = _mm_set1_epi8((cluster.vertex_count() - 1) as i8);
                let eight = self.corner(&vertices, _mm_min_epu8(_mm_add_epi8(eight, least), last));
                for (corner, above) in corners.iter_mut().zip(above) {
                    let lanes = _mm256_cvtepu8_epi32(above);
                    for (p, eight) in corner.iter_mut().zip(eight) {
                        *p = _mm256_permutevar8x32_ps(eight, lanes);
                    }
                }
            } else {
                for (corner, above) in corners.iter_mut().zip(above) {
                    *corner = self.corner(&vertices, _mm_add_epi8(above, least));
                }
            }
            let [a, b, c] = corners;
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
                return TrianglesMet { met: 0, sure: 0 };
            }
            let [off, before] = self.surely([a, b, c], [u, v, w], t_max, t_sure);
            let met = _mm256_andnot_ps(off, met);
            let sure = _mm256_movemask_ps(_mm256_and_ps(met, before)) as u32;
            TrianglesMet { met: _mm256_movemask_ps(met) as u32, sure }
        }
    }

    #[inline(always)]
    fn refine(&self, cluster: &ClusterView<'_>, leaf: usize, place: usize) -> RefinedHit {
        // SAFETY: the caller runs with AVX2, FMA and the others.
        unsafe { self.refine_triangle(cluster, leaf, place) }
    }
}

/// Lower planes are followed by upper ones, and both by the children; before them stand sixteen bytes.
const _: () = assert!(
    offset_of!(ChildBoxes, exponent) == 12
        && offset_of!(ChildBoxes, child_count) == 15
        && offset_of!(ChildBoxes, lo) == 16
        && offset_of!(ChildBoxes, hi) == 16 + 3 * 2 * NODE_WIDTH
);

const BYTES_OF_ONE: u64 = 0x0101_0101_0101_0101;
