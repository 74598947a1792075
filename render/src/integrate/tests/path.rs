//! Tests of `path` against pictures whose radiance is known: a closed box, a sphere, halls of mirrors, and `direct`.

use super::*;
use crate::g_stage::CpuStage;

/// The box |x|, |y|, |z| <= 1, seen from inside.
fn closed_box() -> Vec<NaiveTriangle> {
    let corners = |c: [[f64; 3]; 3]| NaiveTriangle { corners: c, material: 0 };
    let mut triangles = square(1.0, -1.0, false, 0).to_vec();
    triangles.extend(square(1.0, 1.0, true, 0));
    for turn in 1..3 {
        let turned: Vec<_> = triangles[..4]
            .iter()
            .map(|t| corners(t.corners.map(|c| std::array::from_fn(|axis| c[(axis + turn) % 3]))))
            .collect();
        triangles.extend(turned);
    }
    triangles
}

fn path_case(triangles: Vec<NaiveTriangle>, materials: Vec<Material>, lights: Vec<Light>) -> Case {
    Case { method: Method::Path, ..Case::new(triangles, materials, lights) }
}

/// Sky drawn by the cosine made sparks on cars: one sample in thousands met the lobe, a thousand times too bright.
#[test]
fn no_sample_of_the_sky_is_brighter_than_the_sky() {
    let sky = Light::Sky { radiance: [2.0; 3] };
    for mirror in [false, true] {
        let shiny = Material { kd: [0.1; 3], ks: [0.8; 3], ns: 900.0, mirror, ..grey(0.1) };
        let case = Case::new(square(9.0, 0.0, false, 0).to_vec(), vec![shiny], vec![sky]);
        let (world, mut mesh) = (case.world(), NaiveMesh::new(case.triangles.clone()));
        let integrator = SampleIntegrator::new(RenderContext::from_mesh(&world));
        for index in 0..2000 {
            let mut path = integrator.start([0, 0], index);
            let Answer::Exact(sample) = integrator.advance(&mut path, &mut mesh, &CpuStage::default()) else {
                panic!("the naive mesh has all its pages");
            };
            assert!(sample.radiance[0] < 2.0 * 1.01, "{mirror} {index}: {sample:?}");
        }
        // Nothing of the lobe lies below the horizon; modified Phong weighs it by the cosine, here 0.8.
        case.check(1 << 12, 2.0 * (0.1 + 0.8 * if mirror { 1.0 } else { 0.8 }), 1e-2);
    }
}

#[test]
fn in_a_white_furnace_all_directions_are_alike() {
    // Each wall gives Le and returns rho of what it gets: Le / (1 - rho), whatever is looked at, diffuse or glossy.
    for (rho, n_shadow) in [(0.5, 1), (0.8, 1), (0.5, 0)] {
        let wall = Material { ke: [2.0; 3], ..grey(rho) };
        let mut case = path_case(closed_box(), vec![wall], vec![]);
        (case.position, case.target, case.n_shadow) = ([0.3, -0.2, 0.1], [0.4, 0.9, -1.0], n_shadow);
        case.check(1 << 17, 2.0 / (1.0 - f64::from(rho)), 5e-3);
    }
}

#[test]
fn in_a_sphere_the_light_of_its_centre_comes_back_evenly() {
    let triangles = sphere(3);
    let area: f64 = triangles
        .iter()
        .map(|t| {
            let [a, b, c] = t.corners.map(DVec3::from);
            0.5 * (b - a).cross(c - a).length()
        })
        .sum();
    let light = Light::Point { position: [0.0; 3], intensity: [3.0; 3] };
    let mut case = path_case(triangles, vec![grey(0.6)], vec![light]);
    // All of the light falls on the area: E = 4 pi I / A on average, and L = rho / (1 - rho) E / pi.
    (case.position, case.target, case.fov) = ([0.01, 0.02, 0.0], [1.0, 0.2, 0.3], 100.0);
    case.check(1 << 14, 0.6 / 0.4 * 4.0 * 3.0 / area, 5e-3);
}

/// An octahedron, each triangle in four `rounds` times, its corners on the unit sphere.
fn sphere(rounds: u32) -> Vec<NaiveTriangle> {
    let mut faces = vec![];
    for signs in 0..8 {
        let sign = |axis: u32| if signs >> axis & 1 == 0 { 1.0 } else { -1.0 };
        faces.push([[sign(0), 0.0, 0.0], [0.0, sign(1), 0.0], [0.0, 0.0, sign(2)]]);
    }
    for _ in 0..rounds {
        let middle = |a: [f64; 3], b: [f64; 3]| (DVec3::from(a) + DVec3::from(b)).normalize().to_array();
        faces = faces
            .into_iter()
            .flat_map(|[a, b, c]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    faces.into_iter().map(|corners| NaiveTriangle { corners, material: 0 }).collect()
}

#[test]
fn path_agrees_with_direct_where_all_light_is_direct() {
    let plane = square(9.0, 0.0, false, 0).to_vec();
    let sun = Light::Directional { direction: [0.6, 0.0, -0.8], irradiance: [2.0; 3] };
    path_case(plane.clone(), vec![grey(0.5)], vec![sun]).check(1, 0.5 / PI * 2.0 * 0.8, 1e-6);
    let sky = Light::Sky { radiance: [2.0; 3] };
    let rect = Light::Rect {
        corner: [-1.0, -1.0, 2.0],
        edge_u: [0.0, 2.0, 0.0],
        edge_v: [2.0, 0.0, 0.0],
        radiance: [3.0; 3],
    };
    let glossy = Material { kd: [0.3; 3], ks: [0.5; 3], ns: 30.0, ..Material::default() };
    // The sky shines through a rectangle, which shades nothing; the lamp is lit by each way of looking for it.
    for materials in [vec![grey(0.5)], vec![glossy]] {
        for lights in [vec![sky], vec![rect], vec![rect, sky, sun]] {
            let of = |method, n_shadow| Case {
                method,
                n_shadow,
                position: [6.0, 0.0, 1.0],
                ..Case::new(plane.clone(), materials.clone(), lights.clone())
            };
            let (expected, _) = of(Method::Direct, 16).render(1 << 14);
            of(Method::Path, 1).check(1 << 15, expected, 5e-3);
            of(Method::Path, 3).check(1 << 14, expected, 5e-3);
            if !lights.contains(&sun) {
                of(Method::Path, 0).check(1 << 18, expected, 5e-3);
            }
        }
    }
}

#[test]
fn a_lamp_of_the_model_counts_once_however_it_is_found() {
    let lamp = Material { ke: [3.0; 3], ..grey(0.0) };
    let mut triangles = square(9.0, 0.0, false, 0).to_vec();
    triangles.extend(square(1.0, 2.0, true, 1));
    for n_shadow in [0, 1, 2] {
        let mut case = path_case(triangles.clone(), vec![grey(0.8), lamp], vec![]);
        (case.position, case.n_shadow) = ([6.0, 0.0, 1.0], n_shadow);
        case.check(if n_shadow == 0 { 1 << 18 } else { 1 << 14 }, 0.8 * 3.0 * form_factor(1.0, 2.0), 5e-3);
    }
}

#[test]
fn path_follows_a_corridor_of_mirrors() {
    let glowing = Material { ke: [1.0; 3], ..mirror(0.9) };
    let mut triangles = square(9.0, -1.0, false, 0).to_vec();
    triangles.extend(square(9.0, 1.0, true, 0));
    let mut case = path_case(triangles, vec![glowing], vec![]);
    (case.position, case.target) = ([0.0; 3], [0.0, 1e-9, -1.0]);
    case.check(1 << 17, 10.0, 5e-3);
    // A surface that is both returns both shares.
    let both = Material { kd: [0.3; 3], ..mirror(0.5) };
    let case =
        path_case(square(9.0, 0.0, false, 0).to_vec(), vec![both], vec![Light::Sky { radiance: [2.0; 3] }]);
    case.check(1 << 14, 1.6, 5e-3);
}

#[test]
fn the_error_falls_with_the_samples() {
    let wall = Material { ke: [1.0; 3], ..grey(0.5) };
    let mut case = path_case(closed_box(), vec![wall], vec![]);
    (case.position, case.target) = ([0.3, -0.2, 0.1], [0.4, 0.9, -1.0]);
    // Root mean square over seeds: independent samples would bring it to a quarter at 16 times as many.
    let mut rms = |count| {
        let squares = (0..24).map(|seed| {
            case.seed = seed;
            (case.render(count).0 - 2.0).powi(2)
        });
        (squares.sum::<f64>() / 24.0).sqrt()
    };
    let (few, many) = (rms(64), rms(1024));
    assert!(many < 0.3 * few, "{few} at 64 samples, {many} at 1024");
}
