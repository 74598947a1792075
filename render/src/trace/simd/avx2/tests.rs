//! Set-up and refinement against the plain kernel, bit by bit.

use super::*;
use crate::trace::lattice_ray::LatticeRay;
use crate::trace::scalar::Scalar;
use proptest::prelude::*;

#[allow(clippy::print_stderr)] // What is skipped says so.
fn is_skipped() -> bool {
    let is_available = crate::trace::simd::is_available();
    if !is_available {
        eprintln!("skipped: this machine has no AVX2");
    }
    !is_available
}

fn lanes(v: __m128) -> [f32; 4] {
    bytemuck::cast(v)
}

fn any_number() -> impl Strategy<Value = f64> {
    prop_oneof![
        Just(0.0),
        Just(-0.0),
        Just(1.0),
        Just(-1.0),
        -1.0..1.0,
        -1e-30..1e-30,
        -1e-260..1e-260,
        -1e6..1e6,
        -1e18..1e18,
        Just(f64::NAN),
        Just(f64::INFINITY)
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    #[test]
    fn a_ray_is_set_up_as_for_the_plain_kernel(
        origin in prop::array::uniform3(any_number()),
        direction in prop::array::uniform3(any_number()),
        t_max in prop_oneof![Just(f64::INFINITY), 0.0..100.0],
    ) {
        if is_skipped() {
            return Ok(());
        }
        let frame = LatticeFrame::of_box([3, 5, 7], [1 << 23, 1 << 22, 1 << 24], 24);
        let ray = Ray { origin, direction, t_max };
        let plain = Scalar::<f32>::enter(&frame, &ray);
        // SAFETY: the machine has what it takes.
        let ours = unsafe { set_up(&frame, &ray) };
        prop_assert_eq!(plain.is_some(), ours.is_some());
        let (Some((plain_span, plain)), Some((span, ours))) = (plain, ours) else { return Ok(()) };
        let bits = |s: Span| [s.t_max, s.t_end, s.t_entry, s.t_scale].map(f64::to_bits);
        prop_assert_eq!(bits(plain_span), bits(span));
        let cell: [i32; 4] = bytemuck::cast(ours.cell);
        let slabs = plain.slabs;
        for a in 0..3 {
            prop_assert_eq!(i64::from(cell[a]), plain.ray.cell[a]);
            for (ours, plain) in [
                (ours.inverse, slabs.inverse),
                (ours.start_near, slabs.start_near),
                (ours.start_far, slabs.start_far),
            ] {
                prop_assert_eq!(lanes(ours)[a].to_bits(), plain[a].to_bits());
            }
            prop_assert_eq!(ours.negative_axes()[a], slabs.negative[a]);
            prop_assert_eq!(bytemuck::cast::<_, [i32; 4]>(ours.negative)[a], -i32::from(slabs.negative[a]));
            prop_assert_eq!(ours.rows[0][a], a + 3 * usize::from(slabs.negative[a]));
            prop_assert_eq!(ours.rows[1][a], a + 3 * usize::from(!slabs.negative[a]));
            prop_assert_eq!(ours.s[a].to_bits(), plain.s[a].to_bits());
            prop_assert_eq!(ours.fraction[a].to_bits(), plain.fraction[plain.ray.shear.k[a]].to_bits());
        }
        prop_assert_eq!(ours.order.k, plain.ray.shear.k);
        prop_assert_eq!(ours.blur.to_bits(), plain.blur.to_bits());
    }

    #[test]
    fn a_triangle_is_refined_as_by_the_plain_kernel(
        corners in prop::array::uniform3(prop::array::uniform3(0i64..1 << 24)),
        shrink in 0u32..24,
        weights in prop::array::uniform2(-0.2f64..1.2),
        origin in prop::array::uniform3(0.0f64..16.0),
    ) {
        if is_skipped() {
            return Ok(());
        }
        let frame = LatticeFrame::of_box([0; 3], [(1 << 24) - 1; 3], 24);
        // Small ones, too, and those of no area.
        let first = corners[0];
        let corners = corners.map(|q| std::array::from_fn(|a| first[a] + ((q[a] - first[a]) >> shrink)));
        let point = |w: [f64; 2]| -> [f64; 3] {
            std::array::from_fn(|a| {
                let [p, q, r] = corners.map(|q: [i64; 3]| q[a] as f64);
                (p + w[0] * (q - p) + w[1] * (r - p)) * frame.step()
            })
        };
        let target = point(weights);
        let direction = std::array::from_fn(|a| target[a] - origin[a]);
        let ray = Ray { origin, direction, t_max: f64::INFINITY };
        let Some((_, plain)) = Scalar::<f32>::enter(&frame, &ray) else { return Ok(()) };
        // SAFETY: the machine has what it takes.
        let (plain, ours) = (plain.ray.refine(corners), unsafe { refined(&frame, &ray, corners) });
        let three = |vector: [f64; 3]| vector.map(f64::to_bits);
        let bits = |r: RefinedHit| (r.t.to_bits(), three(r.normal), r.size.to_bits(), three(r.weights));
        prop_assert_eq!(bits(plain), bits(ours));
    }
}

#[target_feature(enable = "avx2,fma")]
fn set_up(frame: &LatticeFrame, ray: &Ray) -> Option<(Span, Avx2)> {
    Avx2::enter(frame, ray)
}

#[target_feature(enable = "avx2,fma")]
fn refined(frame: &LatticeFrame, ray: &Ray, corners: [[i64; 3]; 3]) -> RefinedHit {
    let (_, kernel) = Avx2::enter(frame, ray).expect("the plain kernel enters");
    let cell: [i32; 4] = bytemuck::cast(kernel.cell);
    let q = corners.map(|q| {
        let [x, y, z]: [f64; 3] = std::array::from_fn(|a| (q[a] - i64::from(cell[a])) as f64);
        _mm256_setr_pd(x, y, z, 0.0)
    });
    kernel.refine_inside(q).unwrap_or_else(|| kernel.plain().refine(corners))
}

#[test]
fn the_plain_ray_comes_back() {
    if is_skipped() {
        return;
    }
    let frame = LatticeFrame::of_box([0; 3], [1 << 20; 3], 24);
    let ray = Ray { origin: [-3.0, 0.1, 0.7], direction: [0.3, -0.01, 0.02], t_max: 50.0 };
    // SAFETY: the machine has what it takes.
    let (_, ours) = unsafe { set_up(&frame, &ray) }.expect("it meets the box");
    let (_, plain) = Scalar::<f32>::enter(&frame, &ray).expect("it meets the box");
    let parts = |r: &LatticeRay| (r.cell, r.fraction, r.direction, r.shear.k, r.shear.s);
    assert_eq!(parts(&ours.plain()), parts(&plain.ray));
}
