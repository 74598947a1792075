//! Closest hits of the paged tracer against the f64 oracle on the decoded mesh, leaks, and the two arithmetics
//! against each other.
//!
//! The bound, for a lattice of up to 24 bits and an extent E (the model's, since rays begin at its box): a corner seen
//! from the entry is an exact integer minus a fraction, rounded once (2^-24 E); the shear multiplies a depth of that
//! error by a slope of relative error 2^-24, and rounds the sum (two more and a half each): at most 5 x 2^-24 E
//! a coordinate, 7 x 2^-24 E in the plane across the ray. A hit may lie that far off its triangle, a ray that
//! passes an edge closer than that may miss it, and of two surfaces closer to each other either may answer.

mod input;
mod leaks;
mod packets;

use crate::command::{cannot_run, said};
use crate::fixtures::model;
use crate::oracle::mesh::{OracleMesh, cross, distance, dot, sub};
use crate::random::Random;
use crate::support::{Built, build_options, build_source, build_spec, source};
use input::check_against_the_input;
use leaks::no_leaks;
use serde_json::{Value, json};
use std::path::Path;
use trex_render::{AllResident, Answer, Arithmetic, Hit, PagedMesh, Ray, Tracer};
use trex_store::import::{self, ImportOptions};

/// The bound of the module's text, as a share of the extent, rounded up.
const F32_BOUND: f64 = 8.0 / (1 << 24) as f64;

/// What weights in f32 may be off together, rounded up.
const WEIGHT_ERROR: f64 = 4.0 / (1 << 24) as f64;

/// Rays from around the model towards it, and from inside of its box in all directions.
fn random_rays(built: &Built, count: usize, seed: u64) -> Vec<Ray> {
    let bounds = built.file.superblock().bounds;
    let (center, radius) = (bounds.center(), 0.5 * bounds.diagonal());
    let mut rng = Random::seeded(seed);
    (0..count)
        .map(|i| {
            let origin = if i % 2 == 0 {
                let d = rng.direction();
                std::array::from_fn(|a| center[a] + radius * (1.0 + 3.0 * (i % 7) as f64) * d[a])
            } else {
                rng.point(bounds.lo, bounds.hi)
            };
            let target = rng.point(bounds.lo, bounds.hi);
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
        if let Some(hit) = &ours {
            let corners = &oracle.triangles[built.decoded_index(hit.triangle)];
            let weighted = weighted_point(corners, hit.barycentric);
            let off = sub(weighted, point(ray, hit.t));
            let cosine = dot(hit.normal.map(f64::from), ray.direction).abs();
            let most = WEIGHT_ERROR * (1.0 + triangle_reach(corners)) + (bound - extent * F32_BOUND) / cosine;
            if dot(off, off).sqrt() > most {
                wrong.push(format!("{ray:?}: weights of {hit:?} are off by {off:?}, {most:e} is allowed"));
            }
        }
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

/// The point of a triangle with these weights of its corners, which are to make a whole.
fn weighted_point(corners: &[[f64; 3]; 3], weights: [f32; 3]) -> [f64; 3] {
    let weights = weights.map(f64::from);
    assert!(weights.iter().all(|weight| (0.0..=1.0).contains(weight)), "{weights:?}");
    assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-6, "{weights:?}");
    std::array::from_fn(|a| (0..3).map(|corner| weights[corner] * corners[corner][a]).sum())
}

/// The greatest coordinate of a triangle: what errors of weights are multiplied by.
fn triangle_reach(corners: &[[f64; 3]; 3]) -> f64 {
    corners.as_flattened().iter().fold(0.0, |most, x| most.max(x.abs()))
}

/// The least height of a triangle.
fn triangle_size(t: &[[f64; 3]; 3]) -> f64 {
    let area = cross(sub(t[1], t[0]), sub(t[2], t[0]));
    let edge = |i: usize| sub(t[(i + 1) % 3], t[i]);
    let longest = (0..3).map(|i| dot(edge(i), edge(i)).sqrt()).fold(0.0, f64::max);
    if longest > 0.0 { dot(area, area).sqrt() / longest } else { 0.0 }
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

/// A shadow ray that ends in front of what it would hit is free, one that ends behind is not. (It used to go on for two
/// lattice steps, so that small surfaces never saw the lamps of the model.)
#[test]
fn shadow_rays_end_where_they_should() {
    for spec in ["gen:isosurface:50k:4", "gen:pipes:50k:4"] {
        let built = model(spec);
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
#[ignore = "10^6 rays on three models and 10^7 leak rays take minutes: \
            cargo test --release --test it -- --ignored --nocapture campaign"]
fn campaign_of_a_million_rays() {
    let models = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/models/scans"));
    let mut sources = vec![source("gen:pipes:1M:1"), source("gen:scan:1M:1"), source("gen:isosurface:1M:1")];
    match import::open(&models.join("bunny.ply"), &ImportOptions::unlimited(Path::new("."))) {
        Ok(bunny) => sources.push(bunny),
        Err(error) => cannot_run(&format!("no bunny here ({error})")),
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
