//! Rays through units: against all voxels one by one, whichever pages are there; and pictures of files with units.

use crate::command::{document_in, folder};
use crate::fixtures::{built_in, model_with};
use crate::format::read;
use crate::format_octree::Upper;
use crate::format_units::{Unit, read_links, read_units};
use crate::random::Random;
use crate::support::Built;
use std::collections::BTreeMap;
use std::fs;
use std::sync::Arc;
use trex_render::{
    AllResident, Answer, LowerHit, LowerScene, Occluders, Page, Pages, Ray, VoxelScene, Voxels,
};
use trex_store::build::Voxels as VoxelOptions;
use trex_store::layout::FRAME_BYTES;
use trex_store::octree::Refinement;
use trex_store::{Budget, PageFile};

/// Frames of some pages; what becomes of the others.
struct PageShelf {
    frames: BTreeMap<u32, Vec<u8>>,
    others: fn() -> Page<'static>,
}

impl Pages for PageShelf {
    fn page(&mut self, page: u32) -> Page<'_> {
        self.frames.get(&page).map_or((self.others)(), |frame| Page::Ready(frame.into()))
    }
}

impl PageShelf {
    /// The pages of units for which `is_there`.
    fn of(file: &PageFile, others: fn() -> Page<'static>, is_there: impl Fn(u32) -> bool) -> PageShelf {
        let mut buffers = [Vec::new(), Vec::new()];
        let mut frame = |page| {
            let mut frame = vec![0; FRAME_BYTES];
            file.read_page(page, &mut frame, &mut buffers).unwrap();
            (page, frame)
        };
        let pages = (0..file.pages().len() as u32).filter(|&page| file.has_units(page) && is_there(page));
        PageShelf { frames: pages.map(&mut frame).collect(), others }
    }
}

/// What a file holds, read by the readers of the format tests.
struct Oracle {
    upper: Upper,
    words: Vec<u64>,
    pages: BTreeMap<u64, Vec<Unit>>,
    factor: u64,
}

/// A solid cube: its place in units of its own side, and how many times 4 divides a leaf's side for that.
type Cube = ([i64; 3], i32);

impl Oracle {
    fn of(built: &Built) -> Oracle {
        let bytes = fs::read(built.file.path()).unwrap();
        let model = read(&bytes);
        let upper = Upper::read(model.upper.unwrap().1);
        let (count, section) = model.lower.unwrap();
        let (factor, _, words) = read_links(section, count as usize);
        let material_bytes = if model.material_count <= 256 { 1 } else { 2 };
        let read = |(&page, content): (&u64, &Vec<u8>)| (page, read_units(content, material_bytes));
        Oracle { upper, words, pages: model.units.iter().map(read).collect(), factor }
    }

    /// Per upper leaf the cubes in it, when these pages are there.
    fn leaves(&self, occluders: Occluders, pages: &PageShelf) -> Vec<([i64; 3], Vec<Cube>)> {
        let places = self.upper.places();
        let (mut link, mut rank) = (usize::MAX, 0);
        let mut all = Vec::new();
        for (leaf, &at) in places.iter().enumerate() {
            let is_first = leaf == 0 || places[leaf - 1].map(|v| v / 4) != at.map(|v| v / 4);
            (link, rank) = if is_first { (link.wrapping_add(1), 0) } else { (link, rank + 1) };
            let mut cubes = Vec::new();
            let leaf = (at, 0, self.upper.streams[1][leaf]);
            self.cubes(leaf, (Some(self.words[link]), rank), (occluders, pages), &mut cubes);
            all.push((at, cubes));
        }
        all
    }

    fn cubes(
        &self,
        (at, level, bitmap): ([i64; 3], i32, u64),
        (word, rank): (Option<u64>, usize),
        how: (Occluders, &PageShelf),
        out: &mut Vec<Cube>,
    ) {
        let places = (0..64).filter(|place| bitmap >> place & 1 == 1);
        let step = |place: i64| [place & 3, place >> 2 & 3, place >> 4];
        let children: Vec<[i64; 3]> = places.map(|p| [0, 1, 2].map(|a| 4 * at[a] + step(p)[a])).collect();
        let is_there = |word: &u64| how.1.frames.contains_key(&(*word as u32 & 0x1ff_ffff));
        match word.filter(is_there) {
            Some(word) => {
                let unit = &self.pages[&(word & 0x1ff_ffff)][(word >> 25) as usize];
                let (leaves, link) = &unit.nodes[rank];
                for (rank, (child, leaf)) in children.into_iter().zip(leaves).enumerate() {
                    self.cubes((child, level + 1, leaf[0]), (*link, rank), how, out);
                }
            }
            None if how.0 == Occluders::Off => out.push((at, level)),
            None => out.extend(children.into_iter().map(|child| (child, level + 1))),
        }
    }
}

/// Where the ray is in a cube: entry and exit.
fn slab(ray: &Ray, lo: [f64; 3], side: f64) -> (f64, f64) {
    let (mut near, mut far) = (0.0f64, ray.t_max);
    for a in 0..3 {
        let (t0, t1) =
            ((lo[a] - ray.origin[a]) / ray.direction[a], (lo[a] + side - ray.origin[a]) / ray.direction[a]);
        near = near.max(t0.min(t1));
        far = far.min(t0.max(t1));
    }
    (near, far)
}

/// A ray from somewhere about the box to somewhere about it.
fn ray_about(file: &PageFile, rng: &mut Random) -> Ray {
    let bounds = file.superblock().bounds;
    let mut point = || -> [f64; 3] {
        [0, 1, 2].map(|a| bounds.lo[a] + (1.4 * rng.unit() - 0.2) * (bounds.hi[a] - bounds.lo[a]))
    };
    let (origin, target) = (point(), point());
    let way = [0, 1, 2].map(|a| target[a] - origin[a]);
    let length = way.iter().map(|v| v * v).sum::<f64>().sqrt();
    Ray { origin, direction: way.map(|v| v / length), t_max: 2.0 * length }
}

pub(crate) fn refined(spec: &str, refinement: Refinement) -> Arc<Built> {
    model_with(spec, VoxelOptions::Refined { upper: 64, refinement })
}

/// Rays against all cubes, for one set of pages.
fn check_rays(built: &Built, oracle: &Oracle, occluders: Occluders, pages: &mut PageShelf) {
    let voxels = Voxels::open(&built.file, &Budget::unlimited()).unwrap().unwrap();
    let scene = voxels.lower_scene(occluders).unwrap();
    let lattice = built.file.superblock().lattice;
    let corner = oracle.upper.lo.map(|q| q as i64);
    let corner = lattice.position(corner).map(|v| v - 0.5 * lattice.step());
    let leaf_side = voxels.scene(occluders).leaf_side();
    let side_of = |level: i32| leaf_side / 4f64.powi(level);
    let lo_of = |at: [i64; 3], side: f64| [0, 1, 2].map(|a| corner[a] + at[a] as f64 * side);
    let grazed = 4e-3 * leaf_side / (4 * oracle.factor) as f64;
    let leaves = oracle.leaves(occluders, pages);
    let mut rng = Random::seeded(7);
    let mut hit_count = 0;
    for _ in 0..150 {
        let ray = ray_about(&built.file, &mut rng);
        let Answer::Exact(found) = scene.intersect(&ray, pages) else { panic!("no page is on its way") };
        let (mut sure, mut is_near) = (f64::INFINITY, false);
        for (leaf, (at, cubes)) in leaves.iter().enumerate() {
            let (near, far) = slab(&ray, lo_of(*at, leaf_side), leaf_side);
            if far < near - grazed {
                continue;
            }
            for &(at, level) in cubes {
                let (near, far) = slab(&ray, lo_of(at, side_of(level)), side_of(level));
                if far - near > grazed {
                    sure = sure.min(near);
                }
                is_near |= found.is_some_and(|hit: LowerHit| {
                    let is_it = hit.upper.leaf as usize == leaf && (hit.upper.t - near).abs() < grazed;
                    is_it && far - near > -grazed
                });
            }
        }
        match found {
            Some(hit) => {
                assert!(is_near, "{occluders:?}: no voxel at {hit:?} of {ray:?}");
                assert!(hit.upper.t <= sure + grazed, "{occluders:?}: {hit:?} of {ray:?} overlooks {sure}");
                hit_count += 1;
            }
            None => assert!(sure == f64::INFINITY, "{occluders:?}: {ray:?} overlooks {sure}"),
        }
    }
    assert!(hit_count >= 15, "only {hit_count} rays hit");
}

/// With all pages, with none, and with half of them.
#[test]
fn rays_meet_what_all_voxels_of_units_say() {
    for refinement in [Refinement::By4, Refinement::By16] {
        let built = refined("gen:scan:10k:2", refinement);
        let oracle = Oracle::of(&built);
        for share in [0, 1, 2] {
            let is_there = |page: u32| page.wrapping_mul(0x9e37_79b9) >> 31 < share;
            let mut pages = PageShelf::of(&built.file, || Page::Damaged, is_there);
            for occluders in [Occluders::On, Occluders::Off] {
                check_rays(&built, &oracle, occluders, &mut pages);
            }
        }
    }
}

/// Without any unit a ray meets what it meets in the upper octree.
#[test]
fn without_units_there_is_the_upper_octree() {
    let built = refined("gen:pipes:10k:2", Refinement::By4);
    let voxels = Voxels::open(&built.file, &Budget::unlimited()).unwrap().unwrap();
    let mut rng = Random::seeded(5);
    let mut none = PageShelf { frames: BTreeMap::new(), others: || Page::Damaged };
    for occluders in [Occluders::On, Occluders::Off] {
        let (upper, lower) = (voxels.scene(occluders), voxels.lower_scene(occluders).unwrap());
        for _ in 0..5000 {
            let ray = ray_about(&built.file, &mut rng);
            let expected = upper.intersect(&ray);
            let Answer::Exact(found) = lower.intersect(&ray, &mut none) else { panic!("blocked by nothing") };
            // They go by other numbers, since cells are others: rays that graze a voxel may part.
            match (found, expected) {
                (Some(found), Some(expected)) if found.upper.leaf == expected.leaf => {
                    assert!(
                        (found.upper.t - expected.t).abs() < 0.02 * upper.leaf_side()
                            && found.lower.is_none()
                    );
                }
                (None, None) => {}
                _ => grazes(&upper, &ray),
            }
        }
    }
}

/// A ray that meets another voxel when it is moved aside by a hundredth of a subvoxel's side.
#[track_caller]
fn grazes(scene: &VoxelScene<'_>, ray: &Ray) {
    let step = 0.0025 * scene.leaf_side();
    let moved = (0..6).map(|i| {
        let mut origin = ray.origin;
        origin[i / 2] += if i % 2 == 0 { step } else { -step };
        scene.intersect(&Ray { origin, ..*ray }).map(|hit| hit.leaf)
    });
    let mut answers: Vec<_> = moved.chain([scene.intersect(ray).map(|hit| hit.leaf)]).collect();
    answers.dedup();
    assert!(answers.len() > 1, "{ray:?} does not graze anything");
}

/// An answer is that of all pages, or the ray is blocked.
#[test]
fn missing_pages_block_and_change_nothing() {
    let built = refined("gen:pipes:10k:2", Refinement::By4);
    let voxels = Voxels::open(&built.file, &Budget::unlimited()).unwrap().unwrap();
    let scene = voxels.lower_scene(Occluders::On).unwrap();
    let all = AllResident::load(&built.file);
    let mut some = PageShelf::of(&built.file, || Page::Missing, |page| page % 2 == 0);
    let mut rng = Random::seeded(6);
    let mut counts = [0; 3];
    for _ in 0..5000 {
        let ray = ray_about(&built.file, &mut rng);
        let whole = scene.intersect(&ray, &mut &all);
        let part = scene.intersect(&ray, &mut some);
        assert!(part == Answer::Blocked || part == whole, "{part:?}, not {whole:?}");
        let kind = match part {
            Answer::Blocked => 0,
            Answer::Exact(None) => 1,
            Answer::Exact(_) => 2,
        };
        counts[kind] += 1;
    }
    assert!(counts.iter().all(|&count| count > 50), "{counts:?}");
}

/// A ray that starts a clearance above a plane, on either side of it, meets none of the plane's voxels, however it
/// leaves.
#[test]
fn rays_leave_their_own_finest_voxels() {
    let folder = folder();
    let mut rng = Random::seeded(8);
    for round in 0..6 {
        let corners: Vec<[f64; 3]> = (0..3).map(|_| [0; 3].map(|_| rng.unit())).collect();
        let mut text = String::from("s off\n");
        corners.iter().for_each(|[x, y, z]| text += &format!("v {x} {y} {z}\n"));
        fs::write(folder.path().join("one.obj"), text + "f 1 2 3\n").unwrap();
        let voxels = if round % 2 == 0 { "64/256" } else { "64/1024" };
        document_in(folder.path(), &format!("build one.obj -o one.trex --overwrite --voxels {voxels}"));
        let file = PageFile::open(&folder.path().join("one.trex"), &Budget::unlimited()).unwrap();
        let all = AllResident::load(&file);
        let voxels = Voxels::open(&file, &Budget::unlimited()).unwrap().unwrap();
        // As it is on the lattice.
        let lattice = file.superblock().lattice;
        let [a, b, c] = [0, 1, 2].map(|i| lattice.position(lattice.snap(corners[i])));
        let [e, f] = [b, c].map(|p| [0, 1, 2].map(|i| p[i] - a[i]));
        let normal = [e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2], e[0] * f[1] - e[1] * f[0]];
        let length = normal.iter().map(|v| v * v).sum::<f64>().sqrt();
        for occluders in [Occluders::On, Occluders::Off] {
            let scene = voxels.lower_scene(occluders).unwrap();
            let coarse = voxels.scene(occluders);
            assert!(scene.clearance([0.6, 0.8, 0.0]) < 0.3 * coarse.clearance([0.6, 0.8, 0.0]));
            leave_all(&scene, &mut &all, ([a, e, f], normal.map(|v| v / length)), &mut rng);
        }
    }
}

fn leave_all(
    scene: &LowerScene<'_>,
    pages: &mut impl Pages,
    ([a, e, f], normal): ([[f64; 3]; 3], [f64; 3]),
    rng: &mut Random,
) {
    let mut met = 0;
    for index in 0..4000 {
        let side = if index % 2 == 0 { 1.0 } else { -1.0 };
        let (u, v) = (rng.unit(), rng.unit());
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        let mut way = [0; 3].map(|_| 2.0 * rng.unit() - 1.0);
        let height: f64 = (0..3).map(|i| way[i] * normal[i]).sum();
        // Some graze, and none goes back.
        let lift = if index % 3 == 0 { 1e-9 - height * side } else { (-2.0 * height * side).max(0.0) };
        (0..3).for_each(|i| way[i] += lift * side * normal[i]);
        let length = way.iter().map(|v| v * v).sum::<f64>().sqrt();
        let clearance = scene.clearance(normal);
        let from = |height: f64| [0, 1, 2].map(|i| a[i] + u * e[i] + v * f[i] + side * height * normal[i]);
        let ray = Ray { origin: from(clearance), direction: way.map(|v| v / length), t_max: f64::INFINITY };
        assert_eq!(
            scene.intersect(&ray, pages),
            Answer::Exact(None),
            "{ray:?} meets the plane that it leaves"
        );
        // Nor does one that ends there.
        let far = [0, 1, 2].map(|i| ray.origin[i] + 3.0 * ray.direction[i]);
        let back = Ray { origin: far, direction: ray.direction.map(|v| -v), t_max: 3.0 };
        assert_eq!(
            scene.intersect(&back, pages),
            Answer::Exact(None),
            "{back:?} meets the plane that it ends at"
        );
        let within = Ray { origin: from(0.0), ..ray };
        met += u32::from(matches!(scene.intersect(&within, pages), Answer::Exact(Some(_))));
    }
    assert!(met > 3900, "the plane has voxels: {met}");
}

/// The picture depends on the file, the camera, the samples and the seed alone.
#[test]
fn units_give_the_same_picture_whatever_threads_and_limit() {
    let folder = folder();
    built_in(folder.path(), "gen:pipes:10k --voxels 64/256", "p.trex");
    for integrator in ["photon", "photon --near exact", "photon --occluders off", "ao", "debug-lower"] {
        let mut first = None;
        for options in ["--threads 1", "--threads 2", "--threads 1 --memory-limit 34MiB"] {
            let line = format!(
                "render p.trex -o p.exr --overwrite --resolution 48x48 --spp 2 --photons 10k \
                 --integrator {integrator} {options}"
            );
            let document = document_in(folder.path(), &line);
            let is_tight = options.contains("limit");
            assert!(!is_tight || document["pool"]["evictions"].as_u64().unwrap() > 0, "{}", document["pool"]);
            let bytes = fs::read(folder.path().join("p.exr")).unwrap();
            assert!(first.get_or_insert(bytes.clone()) == &bytes, "{integrator} {options}");
        }
    }
}
