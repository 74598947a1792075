//! Tests of the integrators against pictures whose radiance is known.

mod path;

use super::context::RenderContext;
use super::sample_integrator::SampleIntegrator;
use crate::g_stage::CpuStage;
use crate::scene::method::Method;
use crate::scene::settings::RenderKeys;
use crate::scene::world::{Model, World};
use crate::shading::light::{Emitter, Light};
use crate::stats::RayCounts;
use crate::testing::view;
use crate::trace::{Answer, NaiveMesh, NaiveTriangle};
use glam::DVec3;
use std::f64::consts::PI;
use trex_store::{Aabb, Material};

/// The square |x|, |y| <= `half` at height `z`, facing +z, or -z with `flip`.
fn square(half: f64, z: f64, flip: bool, material: u32) -> [NaiveTriangle; 2] {
    let corner = |x: f64, y: f64| [x * half, if flip { -y } else { y } * half, z];
    let [a, b, c, d] = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    [NaiveTriangle { corners: [a, b, c], material }, NaiveTriangle { corners: [a, c, d], material }]
}

fn grey(kd: f32) -> Material {
    Material { kd: [kd; 3], ..Material::default() }
}

fn mirror(ks: f32) -> Material {
    Material { kd: [0.0; 3], ks: [ks; 3], mirror: true, ..Material::default() }
}

/// A scene that is looked at through one narrow pixel.
struct Case {
    triangles: Vec<NaiveTriangle>,
    materials: Vec<Material>,
    lights: Vec<Light>,
    position: [f64; 3],
    target: [f64; 3],
    n_shadow: u32,
    method: Method,
    /// Angle of view across, degrees.
    fov: f64,
    seed: u64,
    ao_radius: Option<f64>,
}

impl Case {
    fn new(triangles: Vec<NaiveTriangle>, materials: Vec<Material>, lights: Vec<Light>) -> Case {
        Case {
            triangles,
            materials,
            lights,
            position: [3.0, 0.0, 4.0],
            target: [0.0; 3],
            n_shadow: 1,
            method: Method::Direct,
            fov: 0.01,
            seed: 3,
            ao_radius: None,
        }
    }

    fn world(&self) -> World {
        let mut bounds = Aabb::EMPTY;
        self.triangles.iter().flat_map(|t| t.corners).for_each(|corner| bounds.add(corner));
        let emits = |t: &&NaiveTriangle| self.materials[t.material as usize].emits();
        let emitter = |t: &NaiveTriangle| Emitter { corners: t.corners, material: t.material };
        let emitters = self.triangles.iter().filter(emits).map(emitter).collect();
        let model = Model {
            bounds,
            outline: Default::default(),
            materials: self.materials.clone(),
            names: Default::default(),
            emitters,
            voxels: None,
        };
        let keys = RenderKeys {
            integrator: self.method,
            resolution: [1, 1],
            n_shadow: self.n_shadow,
            seed: self.seed,
            ..RenderKeys::default()
        };
        let mut view = view(self.position, self.fov, self.lights.clone(), keys);
        view.camera.target = self.target;
        let mut world = World::new(&model, &view).unwrap();
        world.ao_radius = self.ao_radius.unwrap_or(world.ao_radius);
        world
    }

    /// Mean radiance of `count` samples (first channel), and their rays.
    fn render(&self, count: u32) -> (f64, RayCounts) {
        let (world, mut mesh) = (self.world(), NaiveMesh::new(self.triangles.clone()));
        let (mut sum, mut rays) = (0.0, RayCounts::default());
        let integrator = SampleIntegrator::new(RenderContext::from_mesh(&world));
        for index in 0..count {
            let mut path = integrator.start([0, 0], index);
            let Answer::Exact(sample) = integrator.advance(&mut path, &mut mesh, &CpuStage::default()) else {
                panic!("the naive mesh has all its pages");
            };
            sum += f64::from(sample.radiance[0]);
            rays.add(&sample.rays);
        }
        (sum / f64::from(count), rays)
    }

    fn check(&self, count: u32, expected: f64, tolerance: f64) {
        let (found, _) = self.render(count);
        assert!((found - expected).abs() <= tolerance * expected, "{found} for {expected}");
    }
}

#[test]
fn a_plane_under_a_point_and_a_sun() {
    let plane = square(9.0, 0.0, false, 0).to_vec();
    let point = Light::Point { position: [0.0, 3.0, 4.0], intensity: [100.0; 3] };
    let sun = Light::Directional { direction: [0.0, 0.0, -2.0], irradiance: [5.0; 3] };
    let of = |lights: &[Light]| Case::new(plane.clone(), vec![grey(0.5)], lights.to_vec());
    of(&[point]).check(4, 0.5 / PI * 100.0 * 0.8 / 25.0, 1e-3);
    of(&[sun]).check(1, 0.5 / PI * 5.0, 1e-6);
    let both = of(&[point, sun]);
    both.check(4096, 0.5 / PI * (3.2 + 5.0), 1e-2);
    assert_eq!(both.render(8).1, RayCounts { primary: 8, shadow: 8, ..RayCounts::default() });
}

#[test]
fn surfaces_reflect_on_both_sides_and_only_to_the_side_of_the_light() {
    let sun = Light::Directional { direction: [0.0, 0.0, -1.0], irradiance: [PI as f32; 3] };
    for flip in [false, true] {
        let mut case = Case::new(square(9.0, 0.0, flip, 0).to_vec(), vec![grey(0.5)], vec![sun]);
        case.check(1, 0.5, 1e-6);
        case.position = [3.0, 0.0, -4.0];
        case.check(1, 0.0, 0.0);
    }
}

#[test]
fn a_shadow_is_black_and_a_lit_glossy_plane_is_phong() {
    let sun = Light::Directional { direction: [0.6, 0.0, -0.8], irradiance: [2.0; 3] };
    let glossy = Material { kd: [0.0; 3], ks: [0.3; 3], ns: 9.0, ..Material::default() };
    let mut case = Case::new(square(9.0, 0.0, false, 0).to_vec(), vec![glossy], vec![sun]);
    // The camera stands where the sun's mirror image shines: cos^n = 1.
    case.check(1, 0.3 * 11.0 / (2.0 * PI) * 2.0 * 0.8, 1e-3);
    let small = square(0.5, 2.0, true, 0)
        .map(|t| NaiveTriangle { corners: t.corners.map(|[x, y, z]| [x - 1.5, y, z]), material: 0 });
    case.triangles.extend(small);
    case.check(1, 0.0, 0.0);
}

/// Form factor from a point to the centred parallel square of half side `half` at `height`.
fn form_factor(half: f64, height: f64) -> f64 {
    let x = half / height;
    let root = (1.0 + x * x).sqrt();
    4.0 * 2.0 * (x / root * (x / root).atan()) / (2.0 * PI)
}

#[test]
fn a_lamp_of_the_model_lights_by_its_form_factor_on_one_side() {
    let lamp = Material { ke: [3.0; 3], ..grey(0.0) };
    for (flip, share) in [(true, form_factor(1.0, 2.0)), (false, 0.0)] {
        let lamp_triangles = square(1.0, 2.0, flip, 1);
        let mut triangles = square(9.0, 0.0, false, 0).to_vec();
        triangles.extend(lamp_triangles);
        let materials = vec![grey(0.8), lamp];
        let mut case = Case::new(triangles, materials.clone(), vec![]);
        case.position = [6.0, 0.0, 1.0];
        case.check(4096, 0.8 * 3.0 * share, 5e-3);
        // The lamp itself, from below and from above.
        for (z, seen) in [(-2.0, flip), (6.0, !flip)] {
            let mut alone = Case::new(lamp_triangles.to_vec(), materials.clone(), vec![]);
            (alone.position, alone.target) = ([0.5, 0.1, z], [0.5, 0.1, 2.0]);
            alone.check(1, if seen { 3.0 } else { 0.0 }, 1e-6);
        }
    }
}

#[test]
fn a_rectangle_lights_like_the_same_lamp() {
    let rect = Light::Rect {
        corner: [-1.0, -1.0, 2.0],
        edge_u: [0.0, 2.0, 0.0],
        edge_v: [2.0, 0.0, 0.0],
        radiance: [3.0; 3],
    };
    // A ceiling in the very plane of the lamp does not shade it.
    let mut triangles = square(9.0, 0.0, false, 0).to_vec();
    triangles.extend(square(9.0, 2.0, true, 0));
    let mut case = Case::new(triangles, vec![grey(0.8)], vec![rect]);
    case.position = [6.0, 0.0, 1.0];
    case.check(4096, 0.8 * 3.0 * form_factor(1.0, 2.0), 5e-3);
}

#[test]
fn an_open_plane_under_the_sky_returns_its_albedo() {
    let sky = Light::Sky { radiance: [2.0; 3] };
    let mut case = Case::new(square(9.0, 0.0, false, 0).to_vec(), vec![grey(0.25)], vec![sky]);
    case.n_shadow = 4;
    // Cosine-drawn, so without noise.
    case.check(3, 0.5, 1e-5);
    case.target = [3.0, 0.0, 9.0];
    case.check(1, 2.0, 1e-6);
}

#[test]
fn a_mirror_shows_what_is_behind_the_viewer() {
    let lamp = Material { ke: [6.0; 3], ..grey(0.0) };
    let mut triangles = square(9.0, 0.0, false, 0).to_vec();
    triangles.extend(
        square(1.0, 4.0, true, 1)
            .map(|t| NaiveTriangle { corners: t.corners.map(|[x, y, z]| [x - 3.0, y, z]), material: 1 }),
    );
    let mut case = Case::new(triangles, vec![mirror(0.5), lamp], vec![Light::Sky { radiance: [0.1; 3] }]);
    case.check(1, 3.0, 1e-6);
    assert_eq!(case.render(1).1, RayCounts { primary: 1, mirror: 1, ..RayCounts::default() });
    // Past the lamp it shows the sky.
    case.position = [0.5, 0.0, 4.0];
    case.check(1, 0.05, 1e-6);
}

/// In a preview a mirror is what is seen in it, as far away as light has come, in the mirror's colour; but not one that
/// scatters, nor what stands before the mirror.
#[test]
fn a_preview_sees_what_a_mirror_shows() {
    let mut triangles = square(9.0, 0.0, false, 0).to_vec();
    triangles.extend(
        square(1.0, 4.0, true, 1)
            .map(|t| NaiveTriangle { corners: t.corners.map(|[x, y, z]| [x - 3.0, y, z]), material: 1 }),
    );
    let seen = |of: Material, position: [f64; 3]| {
        let case = Case::new(triangles.clone(), vec![of, grey(0.4)], vec![]);
        let (world, mut mesh) = (Case { position, ..case }.world(), NaiveMesh::new(triangles.clone()));
        let integrator = SampleIntegrator::new(RenderContext::from_mesh(&world).for_preview(0));
        let mut path = integrator.start_preview([0, 0]);
        let answer = integrator.advance(&mut path, &mut mesh, &CpuStage::default());
        let Answer::Exact(sample) = answer else { panic!("the naive mesh has all its pages") };
        let seen = sample.layers.unwrap();
        (seen.depth, seen.normal[2].abs(), seen.albedo[0])
    };
    let near = |(depth, normal, albedo): (f32, f32, f32), expected: [f32; 3]| {
        let off = [depth - expected[0], normal - expected[1], albedo - expected[2]];
        assert!(off.iter().all(|off| off.abs() < 1e-3), "{depth} {normal} {albedo}, not {expected:?}");
    };
    near(seen(mirror(0.5), [3.0, 0.0, 4.0]), [10.0, 1.0, 0.2]);
    near(seen(Material { kd: [0.2; 3], ..mirror(0.5) }, [3.0, 0.0, 4.0]), [5.0, 1.0, 0.7]);
    near(seen(grey(0.6), [3.0, 0.0, 4.0]), [5.0, 1.0, 0.6]);
    // Past the square nothing is seen in it.
    assert_eq!(seen(mirror(0.5), [0.5, 0.0, 4.0]).0, f32::INFINITY);
}

#[test]
fn between_two_mirrors_roulette_keeps_the_mean() {
    // Each bounce keeps 0.9, and the mirrors give light 1: 1 / (1 - 0.9) = 10.
    let glowing = Material { ke: [1.0; 3], ..mirror(0.9) };
    let mut triangles = square(9.0, -1.0, false, 0).to_vec();
    triangles.extend(square(9.0, 1.0, true, 0));
    let mut case = Case::new(triangles, vec![glowing], vec![]);
    (case.position, case.target) = ([0.0; 3], [0.0, 1e-9, -1.0]);
    case.check(20_000, 10.0, 0.02);
}

#[test]
fn no_shadow_rays_where_none_are_asked_for() {
    let mut case = Case::new(square(9.0, 0.0, false, 0).to_vec(), vec![grey(0.5)], vec![]);
    case.n_shadow = 0;
    assert_eq!(case.render(2), (0.0, RayCounts { primary: 2, ..RayCounts::default() }));
}

#[test]
fn openness_is_one_less_the_form_factor_within_the_radius() {
    let mut triangles = square(9.0, 0.0, false, 0).to_vec();
    triangles.extend(square(1.0, 2.0, true, 0));
    let mut case = Case { method: Method::Ao, ..Case::new(triangles, vec![mirror(0.9)], vec![]) };
    (case.position, case.n_shadow) = ([6.0, 0.0, 1.0], 4);
    case.check(1 << 12, 1.0 - form_factor(1.0, 2.0), 5e-3);
    assert_eq!(case.render(2).1, RayCounts { primary: 2, gather: 8, ..RayCounts::default() });
    // The same above a model so small that the square is out of reach, and past all of it.
    case.ao_radius = Some(1.9);
    case.check(1, 1.0, 1e-6);
    case.target = [6.0, 0.0, 9.0];
    case.check(1, 1.0, 1e-6);
}
