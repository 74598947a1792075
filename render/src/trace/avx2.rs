//! The AVX2 kernel: eight boxes or triangles at a time, f32. The only unsafe code of the renderer.
//!
//! A leaf's corners are three words of eight narrow indices: one `pdep` spreads a word to eight bytes. A packed
//! vertex is one unaligned 64-bit load: two gathers of four fetch eight. Vertices of wide clusters are fetched
//! one by one and tested like the others.
//!
//! Invariants: 1. the same operations in the same order as `scalar.rs`: the same bits; 2. loads stay inside of the frame:
//! indices were checked by `install`, and eight bytes stand behind the last vertex.
#![allow(unsafe_code)]

use super::bvh::{Found, Goal, Missing, Scene, Stack};
use super::kernel::{Kernel, Lanes};
use super::pages::Pages;
use super::ray::{Frame, LatticeRay};
use super::scalar::{Real, Scalar};
use std::arch::x86_64::*;
use trex_store::cluster::{ClusterView, Node};

/// True where the machine has what this file uses.
pub(super) fn is_available() -> bool {
    is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") && is_x86_feature_detected!("bmi2")
}

/// [`super::bvh::trace`] with this kernel.
pub(super) fn trace<P: Pages>(
    scene: &Scene<'_>,
    pages: &mut P,
    stack: &mut Stack<f32>,
    ray: (&LatticeRay, Goal),
    missing: &mut Missing,
) -> Option<Found> {
    // SAFETY: `PagedMesh` chooses this arithmetic only where `is_available`.
    unsafe { trace_with_features(scene, pages, stack, ray, missing) }
}

#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn trace_with_features<P: Pages>(
    scene: &Scene<'_>,
    pages: &mut P,
    stack: &mut Stack<f32>,
    ray: (&LatticeRay, Goal),
    missing: &mut Missing,
) -> Option<Found> {
    super::bvh::trace::<Avx2, P>(scene, pages, stack, ray, missing)
}

/// A ray set up for eight lanes.
struct Avx2 {
    ray: Scalar<f32>,
}

/// Planes of eight boxes as bytes, per axis: lower, upper.
type Planes = [[__m128i; 3]; 2];

impl Avx2 {
    /// See `Scalar::slabs`.
    #[inline(always)]
    fn slabs(
        &self,
        planes: Planes,
        lo_base: [f32; 3],
        hi_base: [f32; 3],
        scale: [f32; 3],
        t_max: f32,
    ) -> Lanes<f32> {
        // SAFETY: registers only; the caller runs with AVX2 and FMA.
        unsafe {
            let mut near = _mm256_setzero_ps();
            let mut far = _mm256_set1_ps(f32::INFINITY);
            for a in 0..3 {
                let inverse = self.ray.inverse[a];
                let step = _mm256_set1_ps(scale[a] * inverse);
                let lo = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(planes[0][a]));
                let hi = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(planes[1][a]));
                let t_lo = _mm256_fmadd_ps(lo, step, _mm256_set1_ps(lo_base[a] * inverse));
                let t_hi = _mm256_fmadd_ps(hi, step, _mm256_set1_ps(hi_base[a] * inverse));
                let (t_near, t_far) = if self.ray.negative[a] { (t_hi, t_lo) } else { (t_lo, t_hi) };
                near = _mm256_max_ps(t_near, near);
                far = _mm256_min_ps(t_far, far);
            }
            far = _mm256_mul_ps(far, _mm256_set1_ps(1.0 + 8.0 * f32::EPSILON));
            let met = _mm256_and_ps(
                _mm256_cmp_ps::<_CMP_LE_OQ>(near, far),
                _mm256_cmp_ps::<_CMP_LE_OQ>(near, _mm256_set1_ps(t_max)),
            );
            let mut lanes = Lanes { mask: _mm256_movemask_ps(met) as u32, t: [0.0; 8] };
            _mm256_storeu_ps(lanes.t.as_mut_ptr(), near);
            lanes
        }
    }

    /// The eight vertices `indices`, relative to the ray's entry and sheared: x, y, z.
    #[inline(always)]
    fn corner(&self, cluster: &Fetch<'_>, indices: u64) -> [__m256; 3] {
        let q =
            if cluster.is_wide { self.fetch_wide(cluster, indices) } else { fetch_compact(cluster, indices) };
        // SAFETY: registers only; the caller runs with AVX2 and FMA.
        unsafe {
            let mut p = [_mm256_setzero_ps(); 3];
            for a in 0..3 {
                let relative = _mm256_add_epi32(q[a], _mm256_set1_epi32(cluster.relative[a]));
                p[a] = _mm256_sub_ps(_mm256_cvtepi32_ps(relative), _mm256_set1_ps(self.ray.fraction[a]));
            }
            let ([kx, ky, kz], [sx, sy, sz]) = (self.ray.k, self.ray.s);
            let z = p[kz];
            [
                _mm256_fmadd_ps(_mm256_set1_ps(0.0 - sx), z, p[kx]),
                _mm256_fmadd_ps(_mm256_set1_ps(0.0 - sy), z, p[ky]),
                _mm256_mul_ps(_mm256_set1_ps(sz), z),
            ]
        }
    }

    /// See `Scalar::is_surely_off`.
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
            let blurred = _mm256_mul_ps(_mm256_set1_ps(self.ray.blur), sum);
            let least = _mm256_andnot_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(error, blurred), error);
            let behind = _mm256_sub_ps(volume, _mm256_mul_ps(_mm256_set1_ps(t_max), sum));
            _mm256_or_ps(
                _mm256_cmp_ps::<_CMP_LT_OQ>(volume, _mm256_xor_ps(least, sign)),
                _mm256_cmp_ps::<_CMP_GT_OQ>(behind, least),
            )
        }
    }

    #[inline(never)]
    fn fetch_wide(&self, cluster: &Fetch<'_>, indices: u64) -> [__m256i; 3] {
        let base = cluster.view.base();
        let mut q = [[0i32; 8]; 3];
        for (lane, index) in indices.to_le_bytes().into_iter().enumerate() {
            let vertex = cluster.view.vertex(usize::from(index));
            for a in 0..3 {
                q[a][lane] = (vertex[a] - base[a]) as i32;
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
}

/// A cluster while its triangles are tested.
struct Fetch<'a> {
    view: &'a ClusterView<'a>,
    is_wide: bool,
    /// Base minus the ray's cell.
    relative: [i32; 3],
    widths: [u32; 3],
    vertex_bits: u32,
}

#[inline(always)]
fn fetch_compact(cluster: &Fetch<'_>, indices: u64) -> [__m256i; 3] {
    let view = cluster.view;
    let vertices = view.bytes()[view.vertices_offset()..].as_ptr();
    // SAFETY: indices are below the vertex count (checked by install), so that bit offsets lie inside of the packed
    // vertices, and eight more bytes follow these within the frame.
    unsafe {
        let index = _mm256_cvtepu8_epi32(_mm_cvtsi64_si128(indices as i64));
        let bit = _mm256_mullo_epi32(index, _mm256_set1_epi32(cluster.vertex_bits as i32));
        let byte = _mm256_srli_epi32::<3>(bit);
        let shift = _mm256_and_si256(bit, _mm256_set1_epi32(7));
        let low = _mm256_i32gather_epi64::<1>(vertices.cast(), _mm256_castsi256_si128(byte));
        let high = _mm256_i32gather_epi64::<1>(vertices.cast(), _mm256_extracti128_si256::<1>(byte));
        let mut low = _mm256_srlv_epi64(low, _mm256_cvtepu32_epi64(_mm256_castsi256_si128(shift)));
        let mut high = _mm256_srlv_epi64(high, _mm256_cvtepu32_epi64(_mm256_extracti128_si256::<1>(shift)));
        let mut out = [_mm256_setzero_si256(); 3];
        for a in 0..3 {
            let both = _mm256_shuffle_ps::<0x88>(_mm256_castsi256_ps(low), _mm256_castsi256_ps(high));
            let both = _mm256_permute4x64_epi64::<0xd8>(_mm256_castps_si256(both));
            out[a] = _mm256_and_si256(both, _mm256_set1_epi32((1i32 << cluster.widths[a]) - 1));
            let count = _mm_cvtsi32_si128(cluster.widths[a] as i32);
            low = _mm256_srl_epi64(low, count);
            high = _mm256_srl_epi64(high, count);
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

/// Lanes where all three compare with zero as `ORDER` says.
#[inline(always)]
fn all_three<const ORDER: i32>(u: __m256, v: __m256, w: __m256) -> __m256 {
    // SAFETY: registers only; the caller runs with AVX2.
    unsafe {
        let zero = _mm256_setzero_ps();
        let (u, v) = (_mm256_cmp_ps::<ORDER>(u, zero), _mm256_cmp_ps::<ORDER>(v, zero));
        _mm256_and_ps(_mm256_and_ps(u, v), _mm256_cmp_ps::<ORDER>(w, zero))
    }
}

/// `2^exponent`, below 2^127.
#[inline(always)]
fn power_of_two(exponent: u32) -> f32 {
    f32::from_bits((exponent + 127) << 23)
}

/// Eight bytes as a vector.
#[inline(always)]
fn eight(bytes: [u8; 8]) -> __m128i {
    // SAFETY: registers only.
    unsafe { _mm_cvtsi64_si128(i64::from_le_bytes(bytes)) }
}

impl Kernel for Avx2 {
    type T = f32;

    #[inline(always)]
    fn new(frame: &Frame, ray: &LatticeRay) -> Avx2 {
        Avx2 { ray: Scalar::new(frame, ray) }
    }

    #[inline(always)]
    fn t_end(t: f64) -> f32 {
        (t as f32).next_up()
    }

    #[inline(always)]
    fn node(&self, node: &Node, t_max: f32) -> Lanes<f32> {
        let (mut lo_base, mut hi_base, mut scale) = ([0.0; 3], [0.0; 3], [0.0; 3]);
        for a in 0..3 {
            let relative = (node.origin[a] - self.ray.cell[a] as i32) as f32;
            lo_base[a] = relative - self.ray.fraction_lo[a];
            hi_base[a] = relative - self.ray.fraction_hi[a];
            scale[a] = power_of_two(u32::from(node.exponent[a]));
        }
        let [lo, hi] = [&node.lo, &node.hi];
        let planes = [[eight(lo[0]), eight(lo[1]), eight(lo[2])], [eight(hi[0]), eight(hi[1]), eight(hi[2])]];
        let mut lanes = self.slabs(planes, lo_base, hi_base, scale, t_max);
        lanes.mask &= (1u32 << node.child_count) - 1;
        lanes
    }

    #[inline(always)]
    fn leaf_boxes(&self, cluster: &ClusterView<'_>, half: usize, t_max: f32) -> Lanes<f32> {
        let (base, shift, boxes) = (cluster.base(), cluster.leaf_shift(), cluster.leaf_boxes());
        let (mut lo_base, mut hi_base, mut scale) = ([0.0; 3], [0.0; 3], [0.0; 3]);
        for a in 0..3 {
            let relative = (base[a] - self.ray.cell[a]) as i32;
            lo_base[a] = relative as f32 - self.ray.fraction_lo[a];
            // Upper planes are cells: their far side is one cell on.
            hi_base[a] = (relative + (1 << shift[a])) as f32 - self.ray.fraction_hi[a];
            scale[a] = power_of_two(shift[a]);
        }
        let row = |row: usize| word(&boxes[row], 8 * half).to_le_bytes();
        let planes =
            [[eight(row(0)), eight(row(1)), eight(row(2))], [eight(row(3)), eight(row(4)), eight(row(5))]];
        let mut lanes = self.slabs(planes, lo_base, hi_base, scale, t_max);
        let count = cluster.leaf_count().saturating_sub(8 * half).min(8);
        lanes.mask &= (1u32 << count) - 1;
        lanes
    }

    #[inline(always)]
    fn triangles(&self, cluster: &ClusterView<'_>, leaf: usize, t_max: f32) -> u32 {
        let (base, cell) = (cluster.base(), self.ray.cell);
        let fetch = Fetch {
            view: cluster,
            is_wide: cluster.is_wide(),
            relative: [(base[0] - cell[0]) as i32, (base[1] - cell[1]) as i32, (base[2] - cell[2]) as i32],
            widths: cluster.widths(),
            vertex_bits: cluster.vertex_bits(),
        };
        let (at, width) = cluster.leaf_indices(leaf);
        let leaf = &cluster.bytes()[at..];
        let (least, spread) = (u64::from(leaf[0]) * BYTES_OF_ONE, ((1 << width) - 1) * BYTES_OF_ONE);
        let corner = |corner: usize| word(leaf, 1 + corner * width as usize);
        // SAFETY: registers only; the caller runs with AVX2, FMA and BMI2.
        unsafe {
            let a = self.corner(&fetch, _pdep_u64(corner(0), spread) + least);
            let b = self.corner(&fetch, _pdep_u64(corner(1), spread) + least);
            let c = self.corner(&fetch, _pdep_u64(corner(2), spread) + least);
            let mut u = cross(c[0], b[1], c[1], b[0]);
            let mut v = cross(a[0], c[1], a[1], c[0]);
            let mut w = cross(b[0], a[1], b[1], a[0]);
            let mut flat = all_three::<_CMP_EQ_OQ>(u, v, w);
            if _mm256_movemask_ps(flat) != 0 {
                u = _mm256_blendv_ps(u, cross_of_lost(c[0], b[1], c[1], b[0]), flat);
                v = _mm256_blendv_ps(v, cross_of_lost(a[0], c[1], a[1], c[0]), flat);
                w = _mm256_blendv_ps(w, cross_of_lost(b[0], a[1], b[1], a[0]), flat);
                flat = all_three::<_CMP_EQ_OQ>(u, v, w);
            }
            let inside = _mm256_or_ps(all_three::<_CMP_GE_OQ>(u, v, w), all_three::<_CMP_LE_OQ>(u, v, w));
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

const BYTES_OF_ONE: u64 = 0x0101_0101_0101_0101;

/// The eight bytes at `at`.
#[inline(always)]
fn word(bytes: &[u8], at: usize) -> u64 {
    u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight"))
}
