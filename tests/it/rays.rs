//! Closest hits of the paged tracer against the f64 oracle on the decoded mesh, leaks, and the two arithmetics
//! against each other.
//!
//! The bound, for a lattice of up to 24 bits and an extent E (the model's, since rays begin at its box): a corner seen
//! from the entry is an exact integer minus a fraction, rounded once (2^-24 E); the shear multiplies a depth of that
//! error by a slope of relative error 2^-24, and rounds the sum (two more and a half each): at most 5 x 2^-24 E
//! a coordinate, 7 x 2^-24 E in the plane across the ray. A hit may lie that far off its triangle, a ray that
//! passes an edge closer than that may miss it, and of two surfaces closer to each other either may answer.

use crate::command::{said, skipped};
use crate::oracle::mesh::{OracleMesh, cross, distance, dot, moeller_trumbore, sub};
use crate::support::{Built, build_options, build_source, build_spec, source};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use serde_json::{Value, json};
use std::path::Path;
use trex_render::{AllResident, Answer, Arithmetic, Hit, Page, PagedMesh, Pages, Ray, Tracer};
use trex_store::import::{self, ImportOptions};
use trex_store::{TriangleBatch, TriangleSource};

/// The bound of the module's text, as a share of the extent, rounded up.
const F32_BOUND: f64 = 8.0 / (1 << 24) as f64;

fn unit(rng: &mut Pcg64) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

fn direction(rng: &mut Pcg64) -> [f64; 3] {
    loop {
        let d: [f64; 3] = std::array::from_fn(|_| 2.0 * unit(rng) - 1.0);
        let square: f64 = d.iter().map(|x| x * x).sum();
        if square > 1e-4 && square <= 1.0 {
            return d.map(|x| x / square.sqrt());
        }
    }
}

/// Rays from around the model towards it, and from inside of its box in all directions.
fn random_rays(built: &Built, count: usize, seed: u64) -> Vec<Ray> {
    let bounds = built.file.superblock().bounds;
    let (center, radius) = (bounds.center(), 0.5 * bounds.diagonal());
    let mut rng = Pcg64::seed_from_u64(seed);
    let inside = |rng: &mut Pcg64| -> [f64; 3] {
        std::array::from_fn(|a| bounds.lo[a] + unit(rng) * (bounds.hi[a] - bounds.lo[a]))
    };
    (0..count)
        .map(|i| {
            let origin = if i % 2 == 0 {
                let d = direction(&mut rng);
                std::array::from_fn(|a| center[a] + radius * (1.0 + 3.0 * (i % 7) as f64) * d[a])
            } else {
                inside(&mut rng)
            };
            let target = inside(&mut rng);
            let towards: [f64; 3] = std::array::from_fn(|a| target[a] - origin[a]);
            let length = towards.iter().map(|x| x * x).sum::<f64>().sqrt();
            Ray { origin, direction: towards.map(|x| x / length), t_max: f64::INFINITY }
        })
        .collect()
}

fn exact<T>(answer: Answer<T>) -> T {
    match answer {
        Answer::Exact(value) => value,
        Answer::Blocked => panic!("blocked with all pages resident"),
    }
}

fn point(ray: &Ray, t: f64) -> [f64; 3] {
    std::array::from_fn(|a| ray.origin[a] + t * ray.direction[a])
}

/// Counts of disagreements: settled (edge or two surfaces within the bound), and wrong ones.
fn settle(built: &Built, oracle: &OracleMesh, rays: &[Ray]) -> (usize, Vec<String>) {
    let resident = AllResident::load(&built.file);
    let mut tracer = PagedMesh::new(&built.file, &resident);
    let block = built.file.superblock();
    let extent = block.bounds.diagonal();
    let (mut settled, mut wrong) = (0, Vec::new());
    for ray in rays {
        let ours: Option<Hit> = exact(tracer.intersect(ray));
        let theirs = oracle.closest(ray.origin, ray.direction, f64::INFINITY);
        assert_eq!(exact(tracer.occluded(ray)), ours.is_some(), "occluded and intersect differ: {ray:?}");
        let bound =
            extent * F32_BOUND + 1e-14 * (extent + ray.origin.iter().fold(0.0, |m: f64, x| m.max(x.abs())));
        let same = match (&ours, &theirs) {
            (None, None) => true,
            (Some(a), Some(b)) => (a.t - b.t).abs() <= bound,
            _ => false,
        };
        if same {
            continue;
        }
        // Ours must lie on its own triangle within the bound, and must not overlook a hit that is clearly inside
        // of its triangle and clearly in front.
        let on_surface = ours.as_ref().is_none_or(|hit| {
            let triangle = &oracle.triangles[built.decoded_index(hit.triangle)];
            distance(triangle, point(ray, hit.t)) <= bound
        });
        let overlooked = theirs.is_some_and(|hit| {
            let in_front = ours.as_ref().is_none_or(|ours| hit.t < ours.t - bound);
            let size = triangle_size(&oracle.triangles[hit.triangle]);
            in_front && hit.least_weight * size > bound
        });
        if on_surface && !overlooked {
            settled += 1;
        } else {
            let off = ours.as_ref().map(|hit| {
                let triangle = &oracle.triangles[built.decoded_index(hit.triangle)];
                (distance(triangle, point(ray, hit.t)), *triangle)
            });
            let their_triangle = theirs.map(|hit| oracle.triangles[hit.triangle]);
            wrong.push(format!(
                "{ray:?}: ours {ours:?}, off by {off:?}, oracle {theirs:?} {their_triangle:?}, bound {bound:e}"
            ));
        }
    }
    (settled, wrong)
}

/// The least height of a triangle.
fn triangle_size(t: &[[f64; 3]; 3]) -> f64 {
    let area = cross(sub(t[1], t[0]), sub(t[2], t[0]));
    let edge = |i: usize| sub(t[(i + 1) % 3], t[i]);
    let longest = (0..3).map(|i| dot(edge(i), edge(i)).sqrt()).fold(0.0, f64::max);
    if longest > 0.0 { dot(area, area).sqrt() / longest } else { 0.0 }
}

/// Rays in packets against the same rays one by one, in an order where neighbours go the same way, and in one where they
/// do not; with all pages, and with some that are not there.
#[test]
fn packets_answer_as_single_rays_do() {
    for spec in ["gen:isosurface:50k:3", "gen:pipes:50k:2"] {
        let built = build_spec(spec);
        let resident = AllResident::load(&built.file);
        let mut rays = random_rays(&built, 4001, 5);
        // Bundles: nine rays around one, so that chunks of eight hold parts of two.
        let around = rays.clone().into_iter().enumerate().flat_map(|(i, ray)| {
            (0..9).map(move |k| {
                let tilt = 1e-3 * f64::from(k) * if i % 3 == 0 { 100.0 } else { 1.0 };
                let [x, y, z] = ray.direction;
                Ray { direction: [x + tilt * y, y - tilt * x, z + tilt * x], ..ray }
            })
        });
        rays.extend(around.collect::<Vec<_>>());
        // Ends before the first hit, and between two.
        for (i, ray) in rays.iter_mut().enumerate().skip(1).step_by(5) {
            ray.t_max = built.file.superblock().bounds.diagonal() * (i % 11) as f64 / 10.0;
        }
        for hidden in [u32::MAX, 3, 2] {
            let pages = || Hiding { resident: &resident, hidden };
            let [mut packets, mut singles] = [(); 2].map(|()| PagedMesh::new(&built.file, pages()));
            let (mut hits, mut occluded) = (Vec::new(), Vec::new());
            packets.intersect_coherent(&rays, &mut hits);
            packets.occluded_coherent(&rays, &mut occluded);
            let count = |answer: fn(&&Answer<Option<Hit>>) -> bool| hits.iter().filter(answer).count();
            let found = count(|hit| matches!(hit, Answer::Exact(Some(_))));
            let blocked = count(|hit| matches!(hit, Answer::Blocked));
            assert_eq!(blocked > rays.len() / 10, hidden < u32::MAX);
            // A hidden page around all others blocks every ray that meets anything.
            assert!(found > rays.len() / 2 || hidden < u32::MAX);
            for (ray, hit) in rays.iter().zip(&hits) {
                assert_eq!(*hit, singles.intersect(ray), "{spec}: {ray:?}");
            }
            for (ray, any) in rays.iter().zip(&occluded) {
                assert_eq!(*any, singles.occluded(ray), "{spec}: {ray:?}");
            }
            let wanted = [&mut packets, &mut singles].map(|mesh| {
                let mut wanted = Vec::new();
                mesh.take_wanted(&mut wanted);
                wanted.sort_unstable();
                wanted
            });
            assert_eq!(wanted[0], wanted[1], "{spec}");
        }
    }
}

/// Pages of which every so many is missing.
struct Hiding<'a> {
    resident: &'a AllResident,
    hidden: u32,
}

impl Pages for Hiding<'_> {
    fn page(&mut self, page: u32) -> Page<'_> {
        if page % self.hidden == self.hidden - 1 {
            Page::Missing
        } else {
            Page::Ready(self.resident.frame(page))
        }
    }
}

fn check_against_oracle(spec: &str, ray_count: usize) {
    let built = build_spec(spec);
    let oracle = OracleMesh::new(built.decode());
    let (settled, wrong) = settle(&built, &oracle, &random_rays(&built, ray_count, 11));
    assert!(wrong.is_empty(), "{spec}: {} wrong, first: {}", wrong.len(), wrong[0]);
    assert!(settled * 100 < ray_count, "{spec}: {settled} of {ray_count} rays had to be settled");
}

#[test]
fn isosurface_agrees_with_the_oracle() {
    check_against_oracle("gen:isosurface:200k:3", 50_000);
}

#[test]
fn pipes_agree_with_the_oracle() {
    check_against_oracle("gen:pipes:200k:3", 50_000);
}

#[test]
fn scan_agrees_with_the_oracle() {
    check_against_oracle("gen:scan:200k:3", 50_000);
}

#[test]
fn soup_agrees_with_the_oracle() {
    check_against_oracle("gen:soup:100k:3", 30_000);
}

/// Hits against the input's own triangles: snapping moves a surface by at most the stated bound, so along a ray by
/// bound / cos(theta). Rays that come close to an edge of the input may meet another triangle, and are left out.
fn check_against_the_input(source: &mut dyn TriangleSource, ray_count: usize) {
    let mut triangles = Vec::new();
    let mut batch = TriangleBatch::default();
    while source.next_batch(&mut batch).unwrap() {
        triangles.extend(batch.corners.iter().filter(|c| triangle_size(c) > 0.0).copied());
    }
    source.rewind().unwrap();
    let name = source.name();
    let built = build_source(source, &build_options());
    let oracle = OracleMesh::new(triangles);
    let resident = AllResident::load(&built.file);
    let mut tracer = PagedMesh::new(&built.file, &resident);
    let block = built.file.superblock();
    let extent = block.bounds.diagonal();
    // A vertex moves by at most the bound on each axis.
    let moved = 3f64.sqrt() * block.error_bound;
    let (mut compared, mut worst, mut left_out) = (0, 0.0f64, 0);
    for ray in random_rays(&built, ray_count, 77) {
        let Some(theirs) = oracle.closest(ray.origin, ray.direction, f64::INFINITY) else { continue };
        let triangle = &oracle.triangles[theirs.triangle];
        let n = cross(sub(triangle[1], triangle[0]), sub(triangle[2], triangle[0]));
        let cos = (dot(n, ray.direction) / dot(n, n).sqrt()).abs();
        let bound = moved / cos + extent * F32_BOUND + 1e-14 * dot(ray.origin, ray.origin).sqrt();
        // Slivers turn when their corners move; rays at edges and in front of near surfaces have two answers.
        if theirs.least_weight * triangle_size(triangle) < 4.0 * moved / cos
            || triangle_size(triangle) < 16.0 * moved
        {
            left_out += 1;
            continue;
        }
        // A ray that begins on a surface may find itself on its other side after the snap, with nothing ahead.
        if theirs.t * cos <= moved {
            left_out += 1;
            continue;
        }
        let before = oracle.closest(point(&ray, theirs.t + 1e-9 * extent), ray.direction, 3.0 * bound);
        let Some(ours) = exact(tracer.intersect(&ray)) else {
            panic!("{name}: {ray:?} hits {theirs:?} and ours misses")
        };
        let apart = (ours.t - theirs.t).abs();
        let ours_cos = dot(ours.normal.map(f64::from), ray.direction).abs();
        if ours.t * ours_cos <= moved {
            left_out += 1;
            continue;
        }
        // An edge of something in front, just missed by the input's ray, may answer.
        if apart > bound && ours.t < theirs.t && near_an_edge(&oracle, &ray, ours.t, moved / cos)
            || before.is_some()
        {
            left_out += 1;
            continue;
        }
        assert!(apart <= bound, "{name}: {apart:e} apart, bound {bound:e}: {ray:?}, {ours:?}, {theirs:?}");
        worst = worst.max(apart / bound);
        compared += 1;
    }
    said(&format!(
        "{name}: {compared} rays compared, {left_out} at edges left out, worst {worst:.3} of bound / cos"
    ));
    assert!(compared * 10 > ray_count, "{name}: only {compared} rays could be compared, {left_out} left out");
}

/// True when the ray passes a triangle of the input within `reach` around `t`.
fn near_an_edge(oracle: &OracleMesh, ray: &Ray, t: f64, reach: f64) -> bool {
    let p = point(ray, t);
    oracle.triangles.iter().any(|triangle| distance(triangle, p) <= 4.0 * reach)
}

/// A shadow ray that ends in front of what it would hit is free, one that ends behind is not. (It used to go on for two
/// lattice steps, so that small surfaces never saw the lamps of the model.)
#[test]
fn shadow_rays_end_where_they_should() {
    for spec in ["gen:isosurface:50k:4", "gen:pipes:50k:4"] {
        let built = build_spec(spec);
        let reach = F32_BOUND * built.file.superblock().bounds.diagonal();
        let resident = AllResident::load(&built.file);
        let mut compared = 0;
        for arithmetic in [Arithmetic::for_file(&built.file), Arithmetic::Scalar, Arithmetic::Deep] {
            let mut tracer = PagedMesh::with_arithmetic(&built.file, &resident, arithmetic);
            for ray in random_rays(&built, 5_000, 11) {
                let Some(hit) = exact(tracer.intersect(&ray)) else { continue };
                let cos = dot(hit.normal.map(f64::from), ray.direction).abs();
                for (t_max, expected) in [(hit.t - reach / cos, false), (hit.t + reach / cos, true)] {
                    let found = exact(tracer.occluded(&Ray { t_max, ..ray }));
                    assert_eq!(found, expected, "{spec} {arithmetic:?} {t_max}: {ray:?} {hit:?}");
                    compared += usize::from(t_max > 0.0);
                }
            }
        }
        assert!(compared > 5_000, "{spec}: {compared}");
    }
}

#[test]
fn hits_lie_within_the_bound_of_the_input() {
    for spec in ["gen:isosurface:50k:9", "gen:pipes:50k:9", "gen:scan:50k:9"] {
        check_against_the_input(&mut *source(spec), 20_000);
    }
}

#[test]
#[ignore = "10^6 rays on three models and 10^7 leak rays take minutes: cargo test --release --test it -- --ignored --nocapture campaign"]
fn campaign_of_a_million_rays() {
    let models = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/models/scans"));
    let mut sources = vec![source("gen:pipes:1M:1"), source("gen:scan:1M:1"), source("gen:isosurface:1M:1")];
    match import::open(&models.join("bunny.ply"), &ImportOptions::unlimited(Path::new("."))) {
        Ok(bunny) => sources.push(bunny),
        Err(error) => skipped(&format!("no bunny here ({error})")),
    }
    for source in &mut sources {
        let built = build_source(&mut **source, &build_options());
        let oracle = OracleMesh::new(built.decode());
        let (settled, wrong) = settle(&built, &oracle, &random_rays(&built, 1_000_000, 1));
        said(&format!(
            "{}: 10^6 rays, {settled} settled by the oracle, {} wrong",
            source.name(),
            wrong.len()
        ));
        assert!(wrong.is_empty(), "{}", wrong[0]);
        source.rewind().unwrap();
        check_against_the_input(&mut **source, 1_000_000);
        document(
            &source.name(),
            &json!({ "ray_count": 1_000_000, "settled": settled, "disagreements": wrong.len() }),
        );
    }
    no_leaks("gen:scan:1M:1", 10_000_000);
    document("gen:scan:1M:1 from inside", &json!({ "ray_count": 10_000_000, "leaks": 0 }));
    said("gen:scan:1M:1: 10^7 rays from inside, no leak");
}

/// Leaves what a campaign found where `bench/campaign.sh` looks for it.
pub(crate) fn document(scene: &str, found: &Value) {
    let name: String = scene.chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect();
    let name = format!("hits-{}.json", name.trim_start_matches('-').rsplit("scans-").next().unwrap());
    // Wherever the checkout lies.
    let scene = scene.rsplit("../").next().unwrap();
    let mut document = json!({ "schema": "trex.hits/1", "scene": scene });
    document.as_object_mut().unwrap().extend(found.as_object().unwrap().clone());
    std::fs::write(Path::new(env!("CARGO_TARGET_TMPDIR")).join(name.to_lowercase()), document.to_string())
        .unwrap();
}

/// Both arithmetics must give the same bits, or the scalar one is no oracle.
#[test]
fn avx2_and_scalar_give_the_same_bits() {
    for spec in ["gen:isosurface:100k:5", "gen:pipes:100k:5", "gen:soup:50k:5"] {
        let built = build_spec(spec);
        let fast = Arithmetic::for_file(&built.file);
        let resident = AllResident::load(&built.file);
        if fast == Arithmetic::Deep {
            continue;
        }
        let mut fast = PagedMesh::with_arithmetic(&built.file, &resident, fast);
        let mut plain = PagedMesh::with_arithmetic(&built.file, &resident, Arithmetic::Scalar);
        let mut deep = PagedMesh::with_arithmetic(&built.file, &resident, Arithmetic::Deep);
        let mut deep_differs = 0;
        for ray in random_rays(&built, 20_000, 4) {
            let hit = exact(fast.intersect(&ray));
            assert_eq!(hit, exact(plain.intersect(&ray)), "{spec} {ray:?}");
            deep_differs +=
                usize::from(exact(deep.intersect(&ray)).map(|h| h.triangle) != hit.map(|h| h.triangle));
        }
        assert!(deep_differs < 200, "{spec}: f64 answers with another triangle {deep_differs} times");
    }
}

/// No ray from inside of a closed mesh gets out, aimed anywhere or exactly at vertices and edges.
#[test]
fn no_ray_leaks_out_of_a_closed_mesh() {
    no_leaks("gen:scan:100k:2", 300_000);
}

fn no_leaks(spec: &str, ray_count: usize) {
    let built = build_spec(spec);
    let triangles = built.decode();
    let oracle = OracleMesh::new(triangles);
    let resident = AllResident::load(&built.file);
    let mut tracer = PagedMesh::new(&built.file, &resident);
    let bounds = built.file.superblock().bounds;
    let mut rng = Pcg64::seed_from_u64(5);
    // A point is inside when a ray crosses the surface an odd number of times, counted by the oracle.
    let inside = |p: [f64; 3]| {
        let d = [0.5773, 0.5774, 0.5772];
        oracle.triangles.iter().filter(|t| moeller_trumbore(t, p, d).is_some_and(|(t, _)| t > 0.0)).count()
            % 2
            == 1
    };
    let mut origins = Vec::new();
    while origins.len() < 10 {
        let p = std::array::from_fn(|a| bounds.lo[a] + unit(&mut rng) * (bounds.hi[a] - bounds.lo[a]));
        if inside(p) {
            origins.push(p);
        }
    }
    for i in 0..ray_count {
        let origin = origins[i % origins.len()];
        let t = &oracle.triangles[rng.next_u64() as usize % oracle.triangles.len()];
        let target = match i % 3 {
            0 => t[0],
            1 => std::array::from_fn(|a| 0.5 * (t[0][a] + t[1][a])),
            _ => std::array::from_fn(|a| origin[a] + [1.0, 0.3, -0.2][(a + i) % 3] * (unit(&mut rng) - 0.5)),
        };
        let direction: [f64; 3] = std::array::from_fn(|a| target[a] - origin[a]);
        let ray = Ray { origin, direction, t_max: f64::INFINITY };
        assert!(exact(tracer.intersect(&ray)).is_some(), "a leak: {ray:?}");
    }
}
