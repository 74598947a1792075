//! Setting a ray up in registers: an axis a lane, in f64 and then in f32.
//!
//! Invariant: the same bits as `LatticeFrame::enter` and `Scalar<f32>` make, which is tested.

use super::{Avx2, Exact, three};
use crate::trace::Ray;
use crate::trace::lattice_ray::{LatticeFrame, STILL, Span};
use crate::trace::scalar::Real;
use std::arch::x86_64::*;

/// What follows from the longest axis of a direction and its sign: the axes in the order of the shear, as places in
/// vectors.
#[derive(Debug)]
pub(super) struct Order {
    /// x, y, z of the sheared space.
    pub(super) k: [usize; 3],
    /// 1 or -1: the longest component.
    longest: f64,
    /// Each axis eight times, and with the fifth place, which is zero, between.
    pub(super) axes: [[i32; 8]; 3],
    pub(super) axes_long: [[i32; 8]; 3],
    /// The axes in order: numbers of 32 and of 64 bits.
    pub(super) single: [i32; 4],
    pub(super) double: [i32; 8],
}

impl Order {
    const fn new(longest: usize, is_negative: bool) -> Order {
        let (mut x, mut y, z) = ((longest + 1) % 3, (longest + 2) % 3, longest);
        if is_negative {
            (x, y) = (y, x);
        }
        const fn turns(even: usize, odd: usize) -> [i32; 8] {
            let (even, odd) = (even as i32, odd as i32);
            [even, odd, even, odd, even, odd, even, odd]
        }
        let (a, b, c) = (x as i32, y as i32, z as i32);
        Order {
            k: [x, y, z],
            longest: if is_negative { -1.0 } else { 1.0 },
            axes: [turns(x, x), turns(y, y), turns(z, z)],
            axes_long: [turns(x, 4), turns(y, 4), turns(z, 4)],
            single: [a, b, c, 3],
            double: [2 * a, 2 * a + 1, 2 * b, 2 * b + 1, 2 * c, 2 * c + 1, 6, 7],
        }
    }
}

/// By the longest axis, and whether the direction is negative there.
static ORDERS: [[Order; 2]; 3] = [
    [Order::new(0, false), Order::new(0, true)],
    [Order::new(1, false), Order::new(1, true)],
    [Order::new(2, false), Order::new(2, true)],
];

/// Rows of planes where a ray enters, per axis, and where it leaves: of lower planes then upper ones.
pub(super) type Rows = [[usize; 3]; 2];

/// By the axes along which the direction is negative, a bit each.
static ROWS: [Rows; 8] = {
    let mut rows = [[[0; 3]; 2]; 8];
    let mut negative = 0;
    while negative < 8 {
        let mut a = 0;
        while a < 3 {
            let is_negative = negative >> a & 1;
            rows[negative][0][a] = a + 3 * is_negative;
            rows[negative][1][a] = a + 3 * (1 - is_negative);
            a += 1;
        }
        negative += 1;
    }
    rows
};

/// [`crate::trace::kernel::Kernel::enter`].
///
/// # Safety
/// The caller runs with AVX2.
#[inline(always)]
pub(super) unsafe fn enter(frame: &LatticeFrame, ray: &Ray) -> Option<(Span, Avx2)> {
    // SAFETY: arrays of three numbers are read with a mask of three; else registers only.
    unsafe {
        let sign = _mm256_set1_pd(-0.0);
        let size = |v: __m256d| _mm256_andnot_pd(sign, v);
        // One by one: they were mostly written just now, and one by one.
        let fresh = |[x, y, z]: [f64; 3]| _mm256_setr_pd(x, y, z, 0.0);
        let (direction, origin) = (fresh(ray.direction), fresh(ray.origin));
        let from = _mm256_mul_pd(
            _mm256_sub_pd(origin, three(frame.origin.as_ref())),
            _mm256_set1_pd(frame.inverse_step),
        );
        let most = _mm256_set1_pd(f64::MAX);
        let are_finite = _mm256_and_pd(
            _mm256_cmp_pd::<_CMP_LE_OQ>(size(direction), most),
            _mm256_cmp_pd::<_CMP_LE_OQ>(size(from), most),
        );
        let longest = greatest(size(direction));
        if _mm256_movemask_pd(are_finite) != 0xf || longest <= 0.0 {
            return None;
        }
        let inverse = _mm256_div_pd(_mm256_set1_pd(longest), direction);
        let direction = _mm256_div_pd(direction, _mm256_set1_pd(longest));
        let margin = frame.margin(greatest(size(from)))?;
        let t_end = ray.t_max * frame.inverse_step * longest;

        let wide = _mm256_set1_pd(margin);
        let lo = _mm256_sub_pd(_mm256_sub_pd(three(frame.lo.as_ref()), wide), from);
        let hi = _mm256_sub_pd(_mm256_add_pd(three(frame.hi.as_ref()), wide), from);
        let (a, b) = (_mm256_mul_pd(lo, inverse), _mm256_mul_pd(hi, inverse));
        // The fourth lane is still, and neither before its box nor behind it.
        let still = _mm256_cmp_pd::<_CMP_LT_OQ>(size(direction), _mm256_set1_pd(STILL));
        let outside = _mm256_or_pd(
            _mm256_cmp_pd::<_CMP_GT_OQ>(lo, _mm256_setzero_pd()),
            _mm256_cmp_pd::<_CMP_LT_OQ>(hi, _mm256_setzero_pd()),
        );
        if _mm256_movemask_pd(_mm256_and_pd(still, outside)) != 0 {
            return None;
        }
        let no_end = _mm256_set1_pd(f64::INFINITY);
        let near = _mm256_blendv_pd(_mm256_min_pd(a, b), _mm256_xor_pd(no_end, sign), still);
        let far = _mm256_blendv_pd(_mm256_max_pd(a, b), no_end, still);
        let (t_in, t_out) = (greatest(near).max(0.0), t_end.min(-greatest(_mm256_xor_pd(far, sign))));
        if t_in > t_out + margin / 2.0 {
            return None;
        }
        // A branch that is mostly foreseen, so that what follows need not wait.
        let entry = if t_in > 0.0 {
            _mm256_add_pd(from, _mm256_mul_pd(_mm256_set1_pd(t_in), direction))
        } else {
            from
        };
        let cell = _mm256_floor_pd(entry);
        let exact = Exact { fraction: _mm256_sub_pd(entry, cell), direction };
        let kernel = Avx2::new(frame, _mm256_cvttpd_epi32(cell), exact, inverse);
        Some((frame.span(t_in..t_out, t_end, longest), kernel))
    }
}

impl Avx2 {
    /// True where the direction of both is negative along the same axes.
    pub(in crate::trace::simd) fn goes_with(&self, other: &Avx2) -> bool {
        std::ptr::eq(self.rows, other.rows)
    }

    /// The axes along which the direction is negative.
    pub(in crate::trace::simd) fn negative_axes(&self) -> [bool; 3] {
        self.rows[0].map(|row| row >= 3)
    }

    /// The kernel of a ray whose longest component is 1 or -1.
    ///
    /// # Safety
    /// The caller runs with AVX2.
    #[inline(always)]
    unsafe fn new(frame: &LatticeFrame, cell: __m128i, exact: Exact, inverse: __m256d) -> Avx2 {
        // SAFETY: registers only; tables of four and eight numbers.
        unsafe {
            let (sign, one) = (_mm256_set1_pd(-0.0), _mm256_set1_pd(1.0));
            let Exact { fraction, direction } = exact;
            let size = _mm256_andnot_pd(sign, direction);
            let negative = _mm256_movemask_pd(direction) as usize % 8;
            let longest =
                _mm256_movemask_pd(_mm256_cmp_pd::<_CMP_EQ_OQ>(size, one)).trailing_zeros() as usize;
            let order = &ORDERS[longest % 4 % 3][negative >> (longest % 4 % 3) & 1];

            let tiny = <f32 as Real>::TINY;
            let is_tiny = _mm256_cmp_pd::<_CMP_LT_OQ>(size, _mm256_set1_pd(tiny));
            let signs = _mm256_and_pd(direction, sign);
            let large = _mm256_or_pd(_mm256_set1_pd(1.0 / tiny), signs);
            let inverse = _mm256_cvtpd_ps(_mm256_blendv_pd(inverse, large, is_tiny));
            let slack = _mm256_xor_pd(_mm256_set1_pd(frame.slack), signs);
            let start =
                |moved: __m256d| _mm_mul_ps(_mm_sub_ps(_mm_setzero_ps(), _mm256_cvtpd_ps(moved)), inverse);
            let double = _mm256_loadu_si256(order.double.as_ptr().cast());
            let turned =
                _mm256_castsi256_pd(_mm256_permutevar8x32_epi32(_mm256_castpd_si256(direction), double));
            let mut s = [0.0; 4];
            let slopes = _mm256_cvtpd_ps(_mm256_mul_pd(turned, _mm256_set1_pd(order.longest)));
            _mm_storeu_ps(s.as_mut_ptr(), slopes);
            s[2] = order.longest as f32;
            let mut turned = [0.0; 4];
            let single = _mm_loadu_si128(order.single.as_ptr().cast());
            _mm_storeu_ps(turned.as_mut_ptr(), _mm_permutevar_ps(_mm256_cvtpd_ps(fraction), single));
            Avx2 {
                cell,
                inverse,
                start_near: start(_mm256_add_pd(fraction, slack)),
                start_far: start(_mm256_sub_pd(fraction, slack)),
                negative: _mm_srai_epi32::<31>(_mm_castps_si128(_mm256_cvtpd_ps(direction))),
                rows: &ROWS[negative],
                order,
                fraction: turned,
                s,
                blur: frame.blur as f32,
                exact,
            }
        }
    }
}

/// The greatest of four numbers, none of them NaN.
///
/// # Safety
/// The caller runs with AVX.
#[inline(always)]
unsafe fn greatest(v: __m256d) -> f64 {
    // SAFETY: registers only.
    unsafe {
        let two = _mm_max_pd(_mm256_castpd256_pd128(v), _mm256_extractf128_pd::<1>(v));
        _mm_cvtsd_f64(_mm_max_pd(two, _mm_unpackhi_pd(two, two)))
    }
}
