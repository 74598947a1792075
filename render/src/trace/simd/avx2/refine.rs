//! A triangle in f64: an axis a lane.
//!
//! Coordinates of a lattice for f32 have 24 bits, edges 25, and the sums of products that make a normal 51: exact in
//! f64 in whatever order.
//!
//! Invariant: the same bits as `LatticeRay::refine` makes, which is tested.

use super::{Avx2, base};
use crate::trace::lattice_ray::{LatticeRay, RefinedHit, Shear};
use std::arch::x86_64::*;
use trex_store::cluster::ClusterView;

/// The entry's fraction and the direction of a ray.
#[derive(Clone, Copy, Debug)]
pub(super) struct Exact {
    pub(super) fraction: __m256d,
    pub(super) direction: __m256d,
}

/// Lanes 1, 2, 0 of a vector and 2, 0, 1.
const YZX: i32 = 0b11_00_10_01;
const ZXY: i32 = 0b11_01_00_10;

impl Avx2 {
    /// [`LatticeRay::refine`] of a triangle of a leaf. Not inlined: the kernels need the registers.
    #[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
    #[inline(never)]
    pub(super) fn refine_triangle(&self, cluster: &ClusterView<'_>, leaf: usize, place: usize) -> RefinedHit {
        let q = if cluster.is_wide() { None } else { Some(self.corners(cluster, leaf, place)) };
        match q.and_then(|q| self.refine_inside(q)) {
            Some(refined) => refined,
            None => self.plain().refine(cluster.triangle(leaf, place)),
        }
    }

    /// Corners above the ray's cell.
    #[target_feature(enable = "avx2")]
    #[inline]
    fn corners(&self, cluster: &ClusterView<'_>, leaf: usize, place: usize) -> [__m256d; 3] {
        let head = cluster.head();
        let widths = u32::from_le_bytes([head.widths[0], head.widths[1], head.widths[2], 0]) as i32;
        let widths = _mm_cvtsi32_si128(widths);
        let one = _mm256_set1_epi64x(1);
        let masks = _mm256_sub_epi64(_mm256_sllv_epi64(one, _mm256_cvtepu8_epi64(widths)), one);
        let wide = _mm_cvtepu8_epi32(widths);
        let before = _mm_add_epi32(_mm_slli_si128::<4>(wide), _mm_slli_si128::<8>(wide));
        let before = _mm256_cvtepu32_epi64(before);
        let base = _mm256_cvtepi32_pd(_mm_sub_epi32(base(head), self.cell));
        // The bits of 2^52: a number of up to 52 bits is the last ones of its sum with that.
        let shifted = _mm256_set1_pd((1u64 << 52) as f64);
        let mut corners = [_mm256_setzero_pd(); 3];
        for (corner, vertex) in corners.iter_mut().zip(cluster.triangle_vertices(leaf, place)) {
            let word = _mm256_set1_epi64x(cluster.packed_vertex(vertex) as i64);
            let q = _mm256_and_si256(_mm256_srlv_epi64(word, before), masks);
            let q = _mm256_or_si256(q, _mm256_castpd_si256(shifted));
            *corner = _mm256_add_pd(_mm256_sub_pd(_mm256_castsi256_pd(q), shifted), base);
        }
        corners
    }

    /// `None` where the ray passes beside the triangle, or its weights there are next to nothing.
    #[target_feature(enable = "avx2")]
    #[inline]
    pub(super) fn refine_inside(&self, q: [__m256d; 3]) -> Option<RefinedHit> {
        let Exact { fraction, direction } = self.exact;
        let (e, f) = (_mm256_sub_pd(q[1], q[0]), _mm256_sub_pd(q[2], q[0]));
        let n = _mm256_sub_pd(
            _mm256_mul_pd(_mm256_permute4x64_pd::<YZX>(e), _mm256_permute4x64_pd::<ZXY>(f)),
            _mm256_mul_pd(_mm256_permute4x64_pd::<ZXY>(e), _mm256_permute4x64_pd::<YZX>(f)),
        );
        // No zero with a sign: integers have none.
        let n = _mm256_add_pd(n, _mm256_setzero_pd());
        let seen = q.map(|q| _mm256_sub_pd(q, fraction));
        let across = dot(n, direction);

        // SAFETY: eight numbers.
        let order = unsafe { _mm256_loadu_si256(self.order.double.as_ptr().cast()) };
        let turned =
            |v: __m256d| _mm256_castsi256_pd(_mm256_permutevar8x32_epi32(_mm256_castpd_si256(v), order));
        let towards = turned(direction);
        let slopes = _mm256_mul_pd(towards, _mm256_permute4x64_pd::<0b10_10_10_10>(towards));
        let sheared = seen.map(|p| {
            let p = turned(p);
            let z = _mm256_permute4x64_pd::<0b10_10_10_10>(p);
            (_mm256_sub_pd(p, _mm256_mul_pd(slopes, z)), _mm256_cvtsd_f64(z))
        });
        let [(a, az), (b, bz), (c, cz)] = sheared;
        // x of the one times y of the other, less y times x.
        let cross = |p: __m256d, q: __m256d| {
            let products = _mm256_mul_pd(p, _mm256_permute_pd::<0b0101>(q));
            let products = _mm256_castpd256_pd128(products);
            _mm_cvtsd_f64(_mm_sub_sd(products, _mm_unpackhi_pd(products, products)))
        };
        let [u, v, w] = [cross(c, b), cross(a, c), cross(b, a)];
        let is_inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
        if across == 0.0 || !is_inside || u + v + w == 0.0 {
            return None;
        }
        let forward = _mm_cvtsd_f64(_mm256_extractf128_pd::<1>(towards));
        let [az, bz, cz] = [az, bz, cz].map(|z| forward * z);
        let (near, far) = (az.min(bz).min(cz), az.max(bz).max(cz));
        let t = (dot(n, seen[0]) / across).clamp(near, far);

        let sign = _mm256_set1_pd(-0.0);
        let mut sizes = [0.0; 4];
        let size = _mm256_max_pd(_mm256_andnot_pd(sign, e), _mm256_andnot_pd(sign, f));
        // SAFETY: four numbers.
        unsafe { _mm256_storeu_pd(sizes.as_mut_ptr(), size) };
        let mut normal = [0.0; 4];
        // SAFETY: four numbers.
        unsafe { _mm256_storeu_pd(normal.as_mut_ptr(), n) };
        let [x, y, z, _] = normal;
        let size = sizes[0].max(sizes[1]).max(sizes[2]);
        Some(RefinedHit { t, normal: [x, y, z], size, weights: [u, v, w] })
    }

    /// The ray as the plain kernels have it.
    #[cold]
    pub(super) fn plain(&self) -> LatticeRay {
        let (mut cell, mut fraction, mut direction) = ([0i32; 4], [0.0; 4], [0.0; 4]);
        // SAFETY: each array holds four numbers.
        unsafe {
            _mm_storeu_si128(cell.as_mut_ptr().cast(), self.cell);
            _mm256_storeu_pd(fraction.as_mut_ptr(), self.exact.fraction);
            _mm256_storeu_pd(direction.as_mut_ptr(), self.exact.direction);
        }
        let three = |[x, y, z, _]: [f64; 4]| [x, y, z];
        let direction = three(direction);
        LatticeRay {
            cell: [cell[0], cell[1], cell[2]].map(i64::from),
            fraction: three(fraction),
            direction,
            shear: Shear::new(direction),
        }
    }
}

/// The dot product of the first three lanes, summed from the first on.
#[target_feature(enable = "avx2")]
#[inline]
fn dot(p: __m256d, q: __m256d) -> f64 {
    let products = _mm256_mul_pd(p, q);
    let low = _mm256_castpd256_pd128(products);
    let sum = _mm_add_sd(low, _mm_unpackhi_pd(low, low));
    _mm_cvtsd_f64(_mm_add_sd(sum, _mm256_extractf128_pd::<1>(products)))
}
