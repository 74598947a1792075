//! The geometry path at the extremes of numbers: far coordinates, tiny and huge models, needles, mixed scales, rays
//! along axes and in planes. The oracle decides in integers (`oracle/exact.rs`), so what fails here is the tracer.
//!
//! The bound on a hit, across the ray (`TraceCase::bound`): 8 u E for the kernel, where u is 2^-24, or 2^-53 on
//! lattices of more than 24 bits, and E the model's extent (derived in `rays.rs`); and 2^-49 of the largest
//! coordinate on the way for what is done in f64 before and after. A hit may lie that far beside its triangle;
//! along the ray that makes bound / cos, cos being that between ray and normal. What a ray meets with more than
//! that to the next edge, and that much in front of its answer, it must not overlook. A hit on a triangle that is
//! met exactly lies within `Hit::error`.
//!
//! Invariants: 1. each case is data through one `check`; 2. every check says its worst error over the bound, and
//! fails where too few rays were decided.

mod aims;
mod boxes;
mod cameras;
mod closed;
mod leaving;
mod shapes;

use crate::command::said;
use crate::oracle::exact::{self, ExactHit, Q, met};
use crate::oracle::mesh::distance;
use crate::random::Random;
use crate::support::{Built, Mesh, build_options, build_source};
use aims::{Aim, WAYS, aim};
use shapes::{graded_box, needles, placed, star};
use std::collections::HashMap;
use trex_render::{AllResident, Answer, Arithmetic, Hit, PagedMesh, Ray, Tracer};
use trex_store::TriangleSource;
use trex_store::build::{BuildOptions, Precision};
use trex_store::layout::NARROW_BITS;

fn exact<T>(answer: Answer<T>) -> T {
    match answer {
        Answer::Exact(value) => value,
        Answer::Blocked => panic!("blocked with all pages resident"),
    }
}

fn norm(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// A built model as the lattice has it.
struct TraceCase {
    built: Built,
    pages: AllResident,
    /// By store id.
    triangles: Vec<[Q; 3]>,
    lo: Q,
    hi: Q,
}

impl TraceCase {
    fn of(source: &mut dyn TriangleSource, precision: Precision) -> TraceCase {
        let built = build_source(source, &BuildOptions { precision, ..build_options() });
        let lattice = built.file.superblock().lattice;
        let point = |p: [f64; 3]| -> Q {
            let q = std::array::from_fn(|a| ((p[a] - lattice.origin[a]) / lattice.step()) as i64);
            assert_eq!(lattice.position(q), p, "a vertex off the lattice");
            q
        };
        let triangles: Vec<[Q; 3]> = built.decode().iter().map(|corners| corners.map(point)).collect();
        let along = |axis: usize| triangles.as_flattened().iter().map(move |q| q[axis]);
        let lo = std::array::from_fn(|axis| along(axis).min().unwrap());
        let hi = std::array::from_fn(|axis| along(axis).max().unwrap());
        TraceCase { pages: AllResident::load(&built.file), built, triangles, lo, hi }
    }

    fn step(&self) -> f64 {
        self.built.file.superblock().lattice.step()
    }

    /// All that can trace this lattice.
    fn arithmetics(&self) -> Vec<Arithmetic> {
        let mut all = vec![Arithmetic::for_file(&self.built.file), Arithmetic::Scalar, Arithmetic::Deep];
        all.retain(|&a| a == Arithmetic::Deep || self.built.file.superblock().lattice_bits <= NARROW_BITS);
        all.dedup();
        all
    }

    fn tracer(&self, arithmetic: Arithmetic) -> PagedMesh<&AllResident> {
        PagedMesh::with_arithmetic(&self.built.file, &self.pages, arithmetic)
    }

    /// The ray from a lattice point; its t = 1 is a way of `direction` on.
    fn ray(&self, origin: Q, direction: Q) -> Ray {
        let lattice = self.built.file.superblock().lattice;
        let at = lattice.position(origin);
        let back: [f64; 3] = std::array::from_fn(|a| (at[a] - lattice.origin[a]) / lattice.step());
        assert_eq!(back, origin.map(|x| x as f64), "the origin is no model coordinate");
        Ray { origin: at, direction: direction.map(|x| x as f64 * lattice.step()), t_max: f64::INFINITY }
    }

    fn extent(&self) -> f64 {
        norm(std::array::from_fn(|a| (self.hi[a] - self.lo[a]) as f64))
    }

    /// The bound of the module's text for a ray that goes to `t`, lattice steps.
    fn bound(&self, arithmetic: Arithmetic, ray: &Ray, t: f64) -> f64 {
        let kernel = if arithmetic == Arithmetic::Deep { 2f64.powi(-53) } else { 2f64.powi(-24) };
        let reach = (0..3).map(|a| ray.origin[a].abs() + (t * ray.direction[a]).abs()).fold(0.0, f64::max);
        8.0 * kernel * self.extent() + 2f64.powi(-49) * (reach / self.step() + self.extent())
    }
}

/// What a comparison saw: rays with an answer that is due, and the worst errors over their bounds.
#[derive(Default)]
struct Worst {
    decided: usize,
    across: f64,
    along: f64,
}

/// Every arithmetic against the exact oracle.
fn compare(name: &str, model: &TraceCase, aims: &[Aim]) -> Worst {
    let mut worst = Worst::default();
    let mut tracers: Vec<_> = model.arithmetics().into_iter().map(|a| (a, model.tracer(a))).collect();
    for aim in aims {
        let mut ray = model.ray(aim.origin, aim.direction);
        let longest = ray.direction.iter().fold(0.0f64, |m, d| m.max(d.abs()));
        (0..3).for_each(|a| ray.direction[a] += longest * aim.tiny[a]);
        let truth = met(&model.triangles, aim.origin, aim.direction);
        let mut bits = None;
        for (arithmetic, tracer) in &mut tracers {
            let ours = exact(tracer.intersect(&ray));
            let context = || format!("{name}, {arithmetic:?}: {aim:?}, ours {ours:?}");
            assert_eq!(exact(tracer.occluded(&ray)), ours.is_some(), "occluded differs, {}", context());
            if *arithmetic != Arithmetic::Deep {
                assert_eq!(*bits.get_or_insert(ours), ours, "other bits than its twin, {}", context());
            }
            let due = judge(model, (aim, &ray), &truth, ours.as_ref(), *arithmetic, &mut worst);
            worst.decided += usize::from(due.unwrap_or_else(|wrong| panic!("{wrong}, {}", context())));
        }
    }
    worst
}

/// Whether the ray has an answer that is due, or what is wrong with ours.
fn judge(
    model: &TraceCase,
    (aim, ray): (&Aim, &Ray),
    truth: &[ExactHit],
    ours: Option<&Hit>,
    arithmetic: Arithmetic,
    worst: &mut Worst,
) -> Result<bool, String> {
    let length = norm(aim.direction.map(|x| x as f64));
    let bound = model.bound(arithmetic, ray, ours.map_or(0.0, |hit| hit.t));
    let mut begins = f64::INFINITY;
    if let Some(hit) = ours {
        let corners = &model.triangles[model.built.decoded_index(hit.triangle)];
        let cosine = exact::cosine(corners, aim.direction);
        let same = truth.iter().find(|m| m.triangle == hit.triangle as usize);
        let along = same.map_or(0.0, |m| (m.t - hit.t).abs() * length);
        // Off its plane, or beside the nearest of its edges.
        let across = if same.is_some() { along * cosine } else { beside(corners, aim, hit.t) } / bound;
        let along = along * model.step() / hit.error;
        worst.across = worst.across.max(across);
        worst.along = worst.along.max(along);
        if across > 1.0 || along > 1.0 {
            return Err(format!(
                "{across} of the bound off its triangle, {along} of its error along the ray"
            ));
        }
        begins = hit.t * length - bound / cosine;
    }
    let due = |m: &&ExactHit| m.clearance > bound && m.t * length > bound / m.cosine;
    match truth.iter().filter(due).find(|m| m.t * length + bound / m.cosine < begins) {
        Some(overlooked) => Err(format!("{overlooked:?} overlooked, bound {bound:e}")),
        None => Ok(truth.iter().any(|m| due(&m))),
    }
}

/// Distance of the point at `t` from the edges of a triangle.
fn beside(corners: &[Q; 3], aim: &Aim, t: f64) -> f64 {
    let seen = corners.map(|q| exact::sub(q, aim.origin).map(|x| x as f64));
    let point = aim.direction.map(|d| d as f64 * t);
    (0..3).map(|i| distance(&[seen[i], seen[i], seen[(i + 1) % 3]], point)).fold(f64::INFINITY, f64::min)
}

/// A model and how fine its lattice is.
struct Case {
    name: &'static str,
    triangles: Vec<[[f64; 3]; 3]>,
    precision: Precision,
    /// All vertices lie on the lattice that is chosen: they come back bit for bit.
    is_exact: bool,
    /// Least share of rays with an answer that is due; needles thinner than the bound have none.
    decided: f64,
}

/// Decoded corners against the input within the stated bound, then rays of all ways.
fn check(case: Case, ray_count: usize) {
    let mut shape = Mesh::new(case.name, case.triangles);
    let model = TraceCase::of(&mut shape, case.precision);
    let snapped = compare_corners(case.name, &shape.triangles, &model.built);
    assert!(!case.is_exact || model.built.file.superblock().error_bound == 0.0, "{}: not exact", case.name);
    let mut rng = Random::seeded(31);
    let mut aims = Vec::new();
    for way in WAYS {
        let all = (0..ray_count).map(|i| aim(&model, way, i, &mut rng));
        aims.extend(
            all.filter(|aim| aim.direction != [0; 3] && aim.origin.iter().all(|q| q.abs() < 3 << 39)),
        );
    }
    let worst = compare(case.name, &model, &aims);
    let traced = aims.len() * model.arithmetics().len();
    said(&format!(
        "{}: {} bits, corners {snapped:.3} of their bound, {} of {traced} rays decided, {:.3} of the bound across, \
         {:.3} of the hit's error along",
        case.name,
        model.built.file.superblock().lattice_bits,
        worst.decided,
        worst.across,
        worst.along
    ));
    let share = worst.decided as f64 / traced as f64;
    assert!(share >= case.decided, "{}: only {share} of the rays decided", case.name);
}

/// The input's triangles against the decoded ones: each there, its corners within the file's bound. Gives the worst
/// share of the bound.
fn compare_corners(name: &str, input: &[[[f64; 3]; 3]], built: &Built) -> f64 {
    let block = built.file.superblock();
    let (origin, step) = (block.lattice.origin, block.lattice.step());
    let key = |corners: &[[f64; 3]; 3]| {
        let q =
            corners.map(|p| std::array::from_fn(|a| ((p[a] - origin[a]) / step).round_ties_even() as i64));
        let turned: [[Q; 3]; 3] = [[q[0], q[1], q[2]], [q[1], q[2], q[0]], [q[2], q[0], q[1]]];
        let first = (0..3).min_by_key(|&i| turned[i]).unwrap();
        (turned[first], [corners[first], corners[(first + 1) % 3], corners[(first + 2) % 3]])
    };
    let mut stored: HashMap<[Q; 3], Vec<[[f64; 3]; 3]>> = HashMap::new();
    for corners in &built.decode() {
        let (key, corners) = key(corners);
        stored.entry(key).or_default().push(corners);
    }
    let mut worst = 0.0f64;
    for corners in input {
        let (key, corners) = key(corners);
        let found =
            stored.get_mut(&key).and_then(Vec::pop).unwrap_or_else(|| panic!("{name}: {corners:?} is lost"));
        let off = corners.as_flattened().iter().zip(found.as_flattened()).map(|(a, b)| (a - b).abs());
        let off = off.fold(0.0, f64::max);
        assert!(
            off <= block.error_bound,
            "{name}: {corners:?} became {found:?}, bound {:e}",
            block.error_bound
        );
        worst = worst.max(if off > 0.0 { off / block.error_bound } else { 0.0 });
    }
    assert!(stored.values().all(Vec::is_empty), "{name}: triangles that the input has not");
    worst
}

/// A bumpy sphere in model units, not on any lattice.
fn bumpy(n: i64, center: [f64; 3], radius: f64) -> Vec<[[f64; 3]; 3]> {
    let fine = (1i64 << 30) as f64;
    placed("star", &star(n, fine), center, radius / fine * 1.000_000_1).triangles
}

#[test]
fn coordinates_of_ten_million_keep_millimetres() {
    let triangles = bumpy(20, [1e7, -1.00001e7, 0.99999e7], 0.04);
    check(
        Case {
            name: "1e7, edges of 3 mm",
            triangles,
            precision: Precision::Default,
            is_exact: false,
            decided: 0.5,
        },
        300,
    );
}

#[test]
fn models_of_any_size_are_alike() {
    for (name, radius) in [("size 1e-6", 0.5e-6), ("size 1e9", 0.5e9)] {
        let triangles = bumpy(16, [0.0; 3], radius);
        check(Case { name, triangles, precision: Precision::Default, is_exact: false, decided: 0.5 }, 200);
    }
}

/// A needle's hit used to be weighed from its corners, whose weights, by f64 or f32, are wrong by any share; so it
/// lay off its plane, and in f32 a needle in front could lose to one behind it. Now its plane tells where it is.
#[test]
fn needles_are_hit_where_they_are() {
    let mut rng = Random::seeded(5);
    for (name, decided, needle) in [
        ("needles of 1:10^4, f32", 0.05, [1 << 21, 210, 1 << 10]),
        ("needles of 1:10^6, f32", 0.0, [1 << 21, 2, 1 << 10]),
        ("needles of 1:10^6, f64", 0.05, [1 << 37, 137_439, 1 << 20]),
        ("needles of 1:10^9, f64", 0.05, [1 << 37, 137, 1 << 10]),
    ] {
        let triangles = needles(300, needle, &mut rng);
        let unit = 2f64.powi(-20);
        let triangles = placed(name, &triangles, [-1.0; 3], unit).triangles;
        check(
            Case { name, triangles, precision: Precision::Error(unit / 2.0), is_exact: true, decided },
            400,
        );
    }
}

#[test]
fn triangles_of_all_sizes_share_a_scene() {
    let mut triangles = bumpy(10, [0.5e4, -0.5e4, 1e-3], 3e-4);
    let plate = |z: f64| [[-1e4, -1e4, z], [1e4, -1e4, z], [0.0, 1e4, z]];
    triangles.extend([
        plate(0.0),
        plate(0.5),
        plate(2e-3),
        [[0.0, 0.0, -3.0], [1e4, 1e4, 5e3], [1e4, -1e4, 7e3]],
    ]);
    for (name, precision) in
        [("1e-4 beside 1e4", Precision::Default), ("1e-4 beside 1e4, 40 bits", Precision::GridBits(40))]
    {
        check(Case { name, triangles: triangles.clone(), precision, is_exact: false, decided: 0.4 }, 300);
    }
}

#[test]
fn what_lies_on_a_lattice_comes_back_bit_for_bit() {
    for (name, origin, exponent, doublings) in [
        ("lattice at 0, f32", [0.0; 3], -10, 23),
        ("lattice at 1e7, f32", [1e7, -1e7, 1e7], -20, 23),
        ("lattice of 1e9", [3.0 * 2f64.powi(29); 3], 10, 20),
        ("lattice of 1e-9", [0.0; 3], -50, 20),
        ("lattice at 0, f64", [0.0; 3], -38, 39),
    ] {
        let unit = 2f64.powi(exponent);
        let triangles = placed(name, &graded_box(doublings), origin, unit).triangles;
        check(
            Case { name, triangles, precision: Precision::Error(unit / 2.0), is_exact: true, decided: 0.2 },
            40,
        );
    }
}
