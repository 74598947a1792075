//! Sections through solids: hits on what is kept and on caps, against convex bodies as planes, which share no code with
//! the tracer; what fills nested, hollow, overlapping and open parts; hidden materials.

use crate::command::{folder, said};
use crate::random::Random;
use crate::support::{Built, Mesh, build_options, build_source};
use std::fmt::Write;
use std::sync::Arc;
use trex_render::{AllResident, Answer, Hit, PagedMesh, Parts, Ray, Section, Tracer};
use trex_store::import::{self, ImportOptions};

/// Index of the first material of a solid: an OBJ has a default one before.
const FIRST: u32 = 1;

type Triangles = Vec<[[f64; 3]; 3]>;

/// A plane: what is kept has `normal . p >= offset`.
#[derive(Clone, Copy)]
struct Plane {
    normal: [f64; 3],
    offset: f64,
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

fn unit_cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    let c = [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
    c.map(|v| v / dot(c, c).sqrt())
}

fn section(point: [f64; 3], normal: [f64; 3]) -> Section {
    Section::new(point, normal).unwrap()
}

/// The box between two corners, outside counter-clockwise.
fn boxed(lo: [f64; 3], hi: [f64; 3]) -> Triangles {
    let corner = |i: usize| std::array::from_fn(|a| if i >> a & 1 == 1 { hi[a] } else { lo[a] });
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let halves = |[a, b, c, d]: [usize; 4]| [[a, b, c], [a, c, d]];
    faces.into_iter().flat_map(halves).map(|face| face.map(corner)).collect()
}

/// A sphere of `2 n^2` quads, outside counter-clockwise.
fn ball(n: usize) -> Triangles {
    let at = |i: usize, j: usize| {
        let (theta, phi) =
            ((j as f64 / n as f64 * std::f64::consts::PI), i as f64 / n as f64 * std::f64::consts::PI);
        [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()]
    };
    let mut all = vec![];
    for (i, j) in (0..2 * n).flat_map(|i| (0..n).map(move |j| (i, j))) {
        let [a, b, c, d] = [
            at(i % (2 * n), j),
            at(i % (2 * n), j + 1),
            at((i + 1) % (2 * n), j + 1),
            at((i + 1) % (2 * n), j),
        ];
        if j + 1 < n {
            all.push([a, b, c]);
        }
        if j > 0 {
            all.push([a, c, d]);
        }
    }
    all
}

/// Turned inside out.
fn hollow(triangles: Triangles) -> Triangles {
    triangles.into_iter().map(|[a, b, c]| [a, c, b]).collect()
}

/// Solids, each of a material of its own, from [`FIRST`] on.
fn build(solids: &[Triangles]) -> Built {
    let folder = folder();
    let mut text = "mtllib m.mtl\n".to_owned();
    let mut names = String::new();
    for (index, triangles) in solids.iter().enumerate() {
        writeln!(names, "newmtl m{index}\nKd 0.5 0.5 0.5").unwrap();
        writeln!(text, "usemtl m{index}").unwrap();
        for corners in triangles {
            corners.iter().for_each(|[x, y, z]| writeln!(text, "v {x:?} {y:?} {z:?}").unwrap());
            text.push_str("f -3 -2 -1\n");
        }
    }
    let path = folder.path().join("m.obj");
    std::fs::write(&path, text).unwrap();
    std::fs::write(folder.path().join("m.mtl"), names).unwrap();
    let mut source = import::open(&path, &ImportOptions::unlimited(folder.path())).unwrap();
    build_source(&mut *source, &build_options())
}

fn exact<T>(answer: Answer<T>) -> T {
    match answer {
        Answer::Exact(value) => value,
        Answer::Blocked => panic!("blocked with all pages resident"),
    }
}

/// A model on show, all of it in memory.
struct ShownTracer<'a> {
    tracer: PagedMesh<&'a AllResident>,
}

impl<'a> ShownTracer<'a> {
    fn new(built: &'a Built, resident: &'a AllResident, parts: Parts) -> ShownTracer<'a> {
        let mut tracer = PagedMesh::new(&built.file, resident);
        tracer.show(&Arc::new(parts));
        ShownTracer { tracer }
    }

    fn intersect(&mut self, ray: &Ray) -> Option<Hit> {
        exact(self.tracer.intersect(ray))
    }

    /// The material and the height of what is seen from above at a place.
    fn below(&mut self, x: f64, y: f64) -> Option<(u32, f64)> {
        let ray = Ray { origin: [x, y, 50.0], direction: [0.0, 0.0, -1.0], t_max: f64::INFINITY };
        self.intersect(&ray).map(|hit| (hit.material - FIRST, 50.0 - hit.t))
    }
}

/// What a ray keeps of a convex body: from where to where, with the cosines there.
fn through(planes: &[Plane], ray: &Ray) -> Option<[(f64, f64); 2]> {
    let (mut from, mut to) = ((f64::NEG_INFINITY, 1.0), (f64::INFINITY, 1.0));
    for plane in planes {
        let (height, climb) =
            (dot(plane.normal, ray.origin) - plane.offset, dot(plane.normal, ray.direction));
        let t = -height / climb;
        if climb > 0.0 && t > from.0 {
            from = (t, climb);
        } else if climb < 0.0 && t < to.0 {
            to = (t, -climb);
        } else if climb == 0.0 && height < 0.0 {
            return None;
        }
    }
    (from.0 < to.0).then_some([from, to])
}

/// Sections of a convex body: each ray ends where the planes say, within some lattice steps across the surface.
fn check_convex(name: &str, triangles: Triangles, seed: u64) {
    let built = build_source(&mut Mesh::new(name, triangles), &build_options());
    let (resident, block) = (AllResident::load(&built.file), built.file.superblock());
    let step = block.lattice.step();
    let faces: Vec<Plane> = built
        .decode()
        .iter()
        .map(|[a, b, c]| {
            let normal = unit_cross(sub(*c, *a), sub(*b, *a));
            Plane { normal, offset: dot(normal, *a) }
        })
        .collect();
    let mut random = Random::seeded(seed);
    let (mut asked, mut met, mut caps, mut wrong) = (0, 0, 0, vec![]);
    for round in 0..40 {
        let sections: Vec<Section> = (0..1 + round % 3)
            .map(|_| section(random.point([-0.7; 3], [0.7; 3]), random.direction()))
            .collect();
        let mut planes = faces.clone();
        planes.extend(
            sections.iter().map(|cut| Plane { normal: cut.normal, offset: dot(cut.normal, cut.point) }),
        );
        let mut shown = ShownTracer::new(&built, &resident, Parts::new(sections, &[]));
        for i in 0..2500 {
            let near = if i % 3 == 0 { 1.0 } else { 4.0 };
            let origin = random.point([-near; 3], [near; 3]);
            let way = sub(random.point([-1.0; 3], [1.0; 3]), origin);
            let direction = way.map(|v| v / dot(way, way).sqrt());
            let ray = Ray { origin, direction, t_max: f64::INFINITY };
            let kept = through(&planes, &ray);
            // What a step of the lattice decides may go either way.
            let slack = |cosine: f64| 4.0 * step / cosine.max(1e-9) + 1e-12;
            let is_near = |(t, cosine): (f64, f64)| t.abs() <= slack(cosine);
            if kept.is_some_and(|[from, to]| {
                to.0 - from.0 <= slack(from.1) + slack(to.1) || is_near(from) || is_near(to)
            }) {
                continue;
            }
            let grown: Vec<Plane> =
                planes.iter().map(|plane| Plane { offset: plane.offset - 4.0 * step, ..*plane }).collect();
            if kept.is_none() && through(&grown, &ray).is_some() {
                continue;
            }
            let wanted = kept.and_then(|[from, to]| [from, to].into_iter().find(|end| end.0 > 0.0));
            let found = shown.intersect(&ray);
            asked += 1;
            met += u32::from(wanted.is_some());
            caps += u32::from(found.is_some_and(|hit| hit.triangle == u32::MAX));
            let is_right = match (wanted, &found) {
                (Some((t, cosine)), Some(hit)) => (hit.t - t).abs() <= slack(cosine),
                (None, None) => true,
                _ => false,
            };
            let occluded = |t_max: f64| exact(shown.tracer.occluded(&Ray { t_max, ..ray }));
            let t = wanted.map_or(100.0, |(t, cosine)| t + slack(cosine));
            let before = wanted.map_or(100.0, |(t, cosine)| t - slack(cosine));
            let mut occluded = occluded;
            let hides = occluded(t) == wanted.is_some() && !occluded(before.max(0.0));
            if !is_right || !hides {
                wrong.push(format!("{ray:?}: {found:?}, not {wanted:?}"));
            }
        }
        assert_eq!(shown.tracer.open_parts().rays, 0, "it is closed");
    }
    said(&format!("{name}: {asked} rays, {met} met it, {caps} on caps, {} wrong", wrong.len()));
    assert!(met > asked / 4 && caps > met / 8, "{met} of {asked}, {caps} caps");
    assert!(wrong.is_empty(), "{} wrong: {:#?}", wrong.len(), &wrong[..wrong.len().min(5)]);
}

#[test]
fn a_cut_box_ends_rays_where_its_planes_do() {
    check_convex("box", boxed([-1.0, -0.8, -0.9], [1.0, 0.7, 0.8]), 1);
}

#[test]
fn a_cut_ball_ends_rays_where_its_planes_do() {
    check_convex("ball", ball(24), 2);
}

/// Looks down on a section at z = 0 through these solids: which materials may fill the cut at each place; none where
/// the cut is to be empty.
fn check_fill(solids: &[Triangles], wanted: impl Fn(f64, f64) -> Option<Vec<u32>>) {
    let built = build(solids);
    let resident = AllResident::load(&built.file);
    let cut = section([0.0; 3], [0.0, 0.0, -1.0]);
    let mut shown = ShownTracer::new(&built, &resident, Parts::new(vec![cut], &[]));
    let mut random = Random::seeded(3);
    for _ in 0..4000 {
        let [x, y, _] = random.point([-2.5; 3], [2.5; 3]);
        let Some(wanted) = wanted(x, y) else { continue };
        let found = shown.below(x, y).filter(|(_, z)| z.abs() < 1e-3).map(|(material, _)| material);
        let is_right = found.map_or(wanted.is_empty(), |material| wanted.contains(&material));
        assert!(is_right, "{found:?}, not {wanted:?}, at {x}, {y}");
    }
}

/// True for a place that is nearer to the border of a square than a test can decide.
fn is_at_border(half: f64, [cx, cy]: [f64; 2], x: f64, y: f64) -> bool {
    ((x - cx).abs().max((y - cy).abs()) - half).abs() < 1e-3
}

fn is_within(half: f64, [cx, cy]: [f64; 2], x: f64, y: f64) -> bool {
    (x - cx).abs().max((y - cy).abs()) < half
}

#[test]
fn of_nested_solids_the_inner_one_fills_the_cut() {
    let solids = [boxed([-0.5; 3], [0.5; 3]), boxed([-1.0; 3], [1.0; 3]), boxed([-2.0; 3], [2.0; 3])];
    check_fill(&solids, |x, y| {
        let halves = [0.5, 1.0, 2.0];
        if halves.iter().any(|half| is_at_border(*half, [0.0; 2], x, y)) {
            return None;
        }
        let inner = halves.iter().position(|half| is_within(*half, [0.0; 2], x, y));
        Some(inner.map(|index| index as u32).into_iter().collect())
    });
}

/// A cavity is a surface that looks inwards, of the material of its walls or of another.
#[test]
fn a_cavity_is_not_filled() {
    for walls in 0..2 {
        let (outer, inner) = (boxed([-2.0; 3], [2.0; 3]), hollow(boxed([-1.0; 3], [1.0; 3])));
        let solids = if walls == 0 { vec![[outer, inner].concat()] } else { vec![outer, inner] };
        check_fill(&solids, |x, y| {
            if is_at_border(1.0, [0.0; 2], x, y) || is_at_border(2.0, [0.0; 2], x, y) {
                return None;
            }
            let is_filled = is_within(2.0, [0.0; 2], x, y) && !is_within(1.0, [0.0; 2], x, y);
            Some(if is_filled { (0..=walls).collect() } else { vec![] })
        });
    }
}

/// Where two overlap, the one that ends first along an axis of the plane fills it: the border is a line.
#[test]
fn overlapping_solids_fill_each_point_with_one_of_them() {
    let (left, right) = ([-0.7, -0.2], [0.6, 0.3]);
    let solid = |[x, y]: [f64; 2]| boxed([x - 1.0, y - 1.0, -1.0], [x + 1.0, y + 1.0, 1.0]);
    let built = build(&[solid(left), solid(right)]);
    let resident = AllResident::load(&built.file);
    let cut = section([0.0; 3], [0.0, 0.0, -1.0]);
    let mut shown = ShownTracer::new(&built, &resident, Parts::new(vec![cut], &[]));
    let mut random = Random::seeded(4);
    let mut both = [0; 2];
    for _ in 0..4000 {
        let [x, y, _] = random.point([-2.0; 3], [2.0; 3]);
        if is_at_border(1.0, left, x, y) || is_at_border(1.0, right, x, y) {
            continue;
        }
        let found = shown.below(x, y).filter(|(_, z)| z.abs() < 1e-3).map(|(material, _)| material as usize);
        match [is_within(1.0, left, x, y), is_within(1.0, right, x, y)] {
            [true, true] => both[found.unwrap()] += 1,
            [false, false] => assert_eq!(found, None),
            [is_left, _] => assert_eq!(found, Some(usize::from(!is_left))),
        }
    }
    assert!(
        both.iter().sum::<i32>() > 200 && both.contains(&0),
        "the right one ends first everywhere: {both:?}"
    );
}

/// A box without its lid is open, the one beside it is not.
#[test]
fn open_parts_are_not_filled_and_are_told() {
    let mut open = boxed([-2.0, -1.0, -1.0], [-0.5, 1.0, 1.0]);
    // The two triangles at the greatest x.
    open.retain(|corners| corners.iter().any(|corner| corner[0] < -1.0));
    assert_eq!(open.len(), 10);
    let built = build(&[open, boxed([0.5, -1.0, -1.0], [2.0, 1.0, 1.0])]);
    let resident = AllResident::load(&built.file);
    let cut = section([0.0; 3], [0.0, 0.0, -1.0]);
    let mut shown = ShownTracer::new(&built, &resident, Parts::new(vec![cut], &[]));
    for (x, y) in [(-1.3, 0.1), (-0.7, -0.6), (-1.9, 0.9)] {
        let (material, z) = shown.below(x, y).unwrap();
        assert!(material == 0 && (z + 1.0).abs() < 1e-3, "its floor is seen at {x}, {y}, not {z}");
        let (material, z) = shown.below(-x, y).unwrap();
        assert!(material == 1 && z.abs() < 1e-3, "a cap is seen at {}, {y}, not {z}", -x);
    }
    let open = shown.tracer.open_parts();
    assert!(open.rays >= 3 && open.materials == [FIRST], "{open:?}");
}

/// Hits of a model with a hidden material are those of a model without it; caps as well.
#[test]
fn what_is_hidden_is_met_by_no_ray() {
    let (shell, core) = (boxed([-2.0; 3], [2.0; 3]), ball(12));
    let (both, only) = (build(&[shell.clone(), core]), build(&[shell]));
    let residents = [&both, &only].map(|built| AllResident::load(&built.file));
    let cut = section([0.1, 0.2, 0.05], [0.3, -0.2, -1.0]);
    for sections in [vec![], vec![cut]] {
        let mut hiding =
            ShownTracer::new(&both, &residents[0], Parts::new(sections.clone(), &[FIRST as usize + 1]));
        let mut without = ShownTracer::new(&only, &residents[1], Parts::new(sections, &[]));
        let mut random = Random::seeded(5);
        let mut inside = 0;
        for _ in 0..4000 {
            let (origin, direction) = (random.point([-3.0; 3], [3.0; 3]), random.direction());
            let ray = Ray { origin, direction, t_max: 0.1 + 4.0 * random.unit() };
            let (found, wanted) = (hiding.intersect(&ray), without.intersect(&ray));
            let place = |hit: &Hit| (hit.material, (hit.t * 1e3).round());
            assert_eq!(found.as_ref().map(place), wanted.as_ref().map(place), "{ray:?}");
            let occluded = |of: &mut ShownTracer<'_>| exact(of.tracer.occluded(&ray));
            assert_eq!(occluded(&mut hiding), occluded(&mut without), "{ray:?}");
            inside += u32::from(found.is_some());
        }
        assert!(inside > 500, "{inside}");
    }
}
