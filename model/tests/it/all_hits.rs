//! All hits of rays, and triangles by their ids, against the generator's own triangles by brute force.

use super::{built, files, open, options, rays};
use std::collections::BTreeMap;
use trex_model::{AllHits, Model};
use trex_render::Ray;
use trex_store::{Budget, Code, Interrupt, PageFile, TriangleBatch};

type Corners = [[f64; 3]; 3];

/// The triangles of a generator.
fn generated(spec: &str) -> Vec<Corners> {
    let spec = datasets_gen::Spec::parse(spec).unwrap();
    let mut source = datasets_gen::open(&spec, &datasets_gen::GenOptions::default()).unwrap();
    let (mut all, mut batch) = (vec![], TriangleBatch::default());
    while source.next_batch(&mut batch).unwrap() {
        all.extend_from_slice(&batch.corners);
    }
    all
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|axis| a[axis] - b[axis])
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|x| {
        let (y, z) = ((x + 1) % 3, (x + 2) % 3);
        a[y] * b[z] - a[z] * b[y]
    })
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Where `ray`'s line meets a triangle, and how clearly: the least of its weights there, negative beside it.
fn met(ray: &Ray, [a, b, c]: &Corners) -> Option<(f64, f64)> {
    let (ab, ac, from_a) = (minus(*b, *a), minus(*c, *a), minus(ray.origin, *a));
    let p = cross(ray.direction, ac);
    let determinant = dot(ab, p);
    let q = cross(from_a, ab);
    let (u, v) = (dot(from_a, p) / determinant, dot(ray.direction, q) / determinant);
    (determinant != 0.0).then(|| (dot(ac, q) / determinant, u.min(v).min(1.0 - u - v)))
}

fn all_hits(model: &Model, rays: &[Ray]) -> AllHits {
    model.intersect_all(rays, &Interrupt::default()).unwrap()
}

#[test]
fn all_hits_are_those_of_brute_force() {
    let triangles = generated("gen:isosurface:20k");
    let rays = rays(400);
    let found = all_hits(&open(96), &rays);
    let (mut clear, mut several) = (0, 0);
    for (ray, range) in rays.iter().zip(found.first.windows(2)) {
        let lines: Vec<(f64, f64)> = triangles.iter().filter_map(|triangle| met(ray, triangle)).collect();
        // Corners were moved to the lattice: what is nearly beside a triangle or at an end may be either.
        if lines.iter().any(|&(t, least)| {
            least.abs() < 0.02 || (least > 0.0 && (t.abs() < 1e-3 || (t - ray.t_max).abs() < 1e-3))
        }) {
            continue;
        }
        let mut expected: Vec<f64> = lines
            .iter()
            .filter(|&&(t, least)| least > 0.0 && t > 0.0 && t < ray.t_max)
            .map(|&(t, _)| t)
            .collect();
        expected.sort_by(f64::total_cmp);
        let hits = &found.hits[range[0]..range[1]];
        assert_eq!(hits.len(), expected.len(), "{ray:?}: {hits:?}, expected {expected:?}");
        for (hit, t) in hits.iter().zip(&expected) {
            assert!((hit.t - t).abs() < 1e-3, "{ray:?}: {} for {t}", hit.t);
        }
        (clear, several) = (clear + 1, several + usize::from(expected.len() > 2));
    }
    assert!(clear > 100 && several > 20, "{clear} rays were compared, {several} with several hits");
}

/// The first of all hits is the closest one; of a tie each may name another of the triangles.
#[test]
fn the_first_of_all_hits_is_the_closest_and_room_changes_nothing() {
    let (model, rays) = (open(96), rays(10_000));
    let closest = model.intersect(&rays, &Interrupt::default()).unwrap();
    let found = all_hits(&model, &rays);
    let mut differ = 0;
    for (closest, range) in closest.iter().zip(found.first.windows(2)) {
        let hits = &found.hits[range[0]..range[1]];
        assert!(hits.is_sorted_by(|a, b| a.t <= b.t));
        differ += usize::from(closest.map(|hit| hit.t) != hits.first().map(|hit| hit.t));
    }
    // Where a ray passes within the rounding of f32 beside an outline, either is right.
    assert!(differ <= 2, "{differ} of {}", rays.len());
    let limit =
        Model::open(&files().path, &options(30)).and_then(|m| m.intersect(&rays, &Interrupt::default()));
    let smallest = limit.err().map_or(30 << 20, |error| error.smallest_limit_bytes().unwrap());
    let tight = open(smallest.div_ceil(1 << 20) + 2);
    assert_eq!(all_hits(&tight, &rays), found);
    assert!(tight.budget().peak_bytes() <= tight.budget().ledger_bytes());
}

/// Lines through the corners and the middles of edges of a closed mesh come out as often as they went in.
#[test]
fn lines_cross_a_closed_surface_an_even_number_of_times() {
    let path = files().folder.path().join("closed.trex");
    built::build_with(&path, "gen:scan:20k:2", trex_store::build::Voxels::None);
    let model = Model::open(&path, &options(96)).unwrap();
    let count = model.info().unwrap().triangle_count as u32;
    let ids: Vec<u32> = (0..count).step_by(7).collect();
    let triangles = model.read_triangles(&ids, &Interrupt::default()).unwrap();
    let bounds = model.info().unwrap().bounds;
    let reach = 3.0 * bounds.diagonal();
    let aim = |(place, triangle): (usize, &trex_render::MeshTriangle)| {
        let [a, b, _] = triangle.corners;
        let target = if place % 2 == 0 { a } else { std::array::from_fn(|axis| 0.5 * (a[axis] + b[axis])) };
        // Along the axes, where corners line up, and across them.
        let mut direction =
            [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.25, 0.5, -1.0], [0.3, -0.7, 0.1]][place % 4];
        direction = direction.map(|x: f64| x * reach);
        Ray { origin: minus(target, direction), direction, t_max: f64::INFINITY }
    };
    let rays: Vec<Ray> = triangles.iter().enumerate().map(aim).collect();
    let found = all_hits(&model, &rays);
    let odd = found.first.windows(2).filter(|range| (range[1] - range[0]) % 2 == 1).count();
    assert!(found.hits.len() > rays.len() && odd == 0, "{odd} of {} lines", rays.len());
}

/// The triangles of the file are those of the generator, each as often, moved to the lattice.
#[test]
fn triangles_are_read_as_they_were_built() {
    let model = open(64);
    let file = PageFile::open(&files().path, &Budget::unlimited()).unwrap();
    let lattice = file.superblock().lattice;
    let snapped = |corners: Corners| {
        let mut steps = corners.map(|corner| {
            minus(corner, lattice.origin).map(|x| (x / lattice.step()).round_ties_even() as i64)
        });
        steps.sort_unstable();
        steps
    };
    let mut counts: BTreeMap<_, i64> = BTreeMap::new();
    for corners in generated("gen:isosurface:20k") {
        *counts.entry(snapped(corners)).or_default() += 1;
    }
    // Backwards, and each twice: ids may come in any order.
    let count = file.superblock().triangle_count as u32;
    let ids: Vec<u32> = (0..count).rev().chain(0..count).collect();
    let read = model.read_triangles(&ids, &Interrupt::default()).unwrap();
    let (backwards, forwards) = read.split_at(count as usize);
    assert!(backwards.iter().rev().eq(forwards));
    for triangle in forwards {
        *counts.entry(snapped(triangle.corners)).or_default() -= 1;
    }
    // What has no area on the lattice was left out.
    counts.retain(|[a, b, c], _| a != b && b != c);
    assert!(count > 10_000 && counts.values().all(|&count| count == 0));
    let error = model.read_triangles(&[3, count], &Interrupt::default()).unwrap_err();
    assert_eq!((error.code(), error.place()), (Code::Usage, "id 1 of 2"));
    assert!(model.read_triangles(&[], &Interrupt::default()).unwrap().is_empty());
}

/// Weights, corners and t say the same point.
#[test]
fn hits_lie_where_their_weights_say() {
    let (model, rays) = (open(96), rays(3000));
    let hits: Vec<_> = model.intersect(&rays, &Interrupt::default()).unwrap();
    let ids: Vec<u32> = hits.iter().flatten().map(|hit| hit.triangle).collect();
    let triangles = model.read_triangles(&ids, &Interrupt::default()).unwrap();
    let size = model.info().unwrap().bounds.diagonal();
    assert!(ids.len() > 500);
    let met = rays.iter().zip(&hits).filter_map(|(ray, hit)| hit.map(|hit| (ray, hit)));
    for ((ray, hit), triangle) in met.zip(&triangles) {
        assert_eq!(hit.material, triangle.material);
        for axis in 0..3 {
            let on_ray = ray.origin[axis] + hit.t * ray.direction[axis];
            let corners = hit.barycentric.iter().zip(&triangle.corners);
            let weighted: f64 = corners.map(|(&weight, corner)| f64::from(weight) * corner[axis]).sum();
            assert!((on_ray - weighted).abs() < 1e-6 * size, "{hit:?}: {on_ray} {weighted}");
        }
    }
}
