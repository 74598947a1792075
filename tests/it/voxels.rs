//! The voxel octree: what is in it against the triangles, what rays meet in it against all of its voxels, one by one.

use crate::command::cannot_run;
use crate::fixtures::model_with;
use crate::random::Random;
use crate::support::{Built, Mesh, build_options, build_source};
use std::sync::Arc;
use trex_render::{Occluders, PacketWidth, Ray, VoxelHit, VoxelScene};
use trex_store::Budget;
use trex_store::build::{BuildOptions, Voxels};
use trex_store::octree::UpperOctree;

fn octree_of(spec: &str, resolution: u32) -> (Arc<Built>, UpperOctree) {
    let built = model_with(spec, Voxels::Resolution(resolution));
    let (octree, _) = built.file.upper(&Budget::unlimited()).unwrap().unwrap();
    (built, octree)
}

/// Every box that is solid, in units of its own side: subvoxels, or leaves when bitmaps are off. With its leaf.
fn boxes(octree: &UpperOctree, occluders: Occluders) -> Vec<([u32; 3], u32)> {
    let depth = octree.grid().depth();
    let step = |place: u32| [place & 3, place >> 2 & 3, place >> 4];
    let below = |at: [u32; 3], place: u32| std::array::from_fn(|a| 4 * at[a] + step(place)[a]);
    let (mut all, mut stack) = (Vec::new(), vec![(0u32, [0u32; 3], 0usize)]);
    while let Some((index, at, level)) = stack.pop() {
        let is_leaf = level == depth;
        let bits =
            if is_leaf { octree.bitmaps()[index as usize] } else { octree.nodes()[index as usize].bits() };
        if is_leaf && occluders == Occluders::Off {
            all.push((at, index));
            continue;
        }
        let mut child = if is_leaf { index } else { octree.nodes()[index as usize].first };
        for place in (0..64).filter(|place| bits >> place & 1 == 1) {
            match is_leaf {
                true => all.push((below(at, place), index)),
                false => {
                    stack.push((child, below(at, place), level + 1));
                    child += 1;
                }
            }
        }
    }
    all
}

/// Entry and exit of a ray and a box of `side` at `at`.
fn slab(ray: &Ray, corner: [f64; 3], at: [u32; 3], side: f64) -> (f64, f64) {
    let (mut near, mut far) = (f64::NEG_INFINITY, f64::INFINITY);
    for a in 0..3 {
        let lo = corner[a] + f64::from(at[a]) * side - ray.origin[a];
        let (t0, t1) = (lo / ray.direction[a], (lo + side) / ray.direction[a]);
        near = near.max(t0.min(t1));
        far = far.min(t0.max(t1));
    }
    (near, far)
}

fn check_rays(spec: &str, resolution: u32, ray_count: usize) {
    let (built, octree) = octree_of(spec, resolution);
    let block = built.file.superblock();
    let lattice = block.lattice;
    let corner = lattice.position(octree.grid().lo).map(|v| v - 0.5 * lattice.step());
    let mut rng = Random::seeded(7);
    for occluders in [Occluders::On, Occluders::Off] {
        let scene = VoxelScene::new(&octree, &built.file.superblock().lattice, occluders);
        let boxes = boxes(&octree, occluders);
        let side = if occluders == Occluders::On { scene.leaf_side() / 4.0 } else { scene.leaf_side() };
        let mut hit_count = 0;
        for _ in 0..ray_count {
            let inside = |rng: &mut Random, a: usize| {
                block.bounds.lo[a] + (1.4 * rng.unit() - 0.2) * (block.bounds.hi[a] - block.bounds.lo[a])
            };
            let origin: [f64; 3] = std::array::from_fn(|a| inside(&mut rng, a));
            let target: [f64; 3] = std::array::from_fn(|a| inside(&mut rng, a));
            let way: [f64; 3] = std::array::from_fn(|a| target[a] - origin[a]);
            let length = way.iter().map(|v| v * v).sum::<f64>().sqrt();
            let ray = Ray { origin, direction: way.map(|v| v / length), t_max: 2.0 * length };
            let found = scene.intersect(&ray);
            // Boxes that the ray is in for long enough to be sure of, and those that it may graze.
            let grazed = 2e-3 * side;
            let (mut sure, mut near_found) = (f64::INFINITY, false);
            for &(at, leaf) in &boxes {
                let (near, far) = slab(&ray, corner, at, side);
                let (near, far) = (near.max(0.0), far.min(ray.t_max));
                if far - near > grazed {
                    sure = sure.min(near);
                }
                near_found |= found.is_some_and(|hit| {
                    hit.leaf == leaf && (hit.t - near).abs() < grazed && far - near > -grazed
                });
            }
            match found {
                Some(hit) => {
                    assert!(near_found, "{spec} {occluders:?}: no voxel at {hit:?} of {ray:?}");
                    assert!(
                        hit.t <= sure + grazed,
                        "{spec} {occluders:?}: {hit:?} of {ray:?} overlooks {sure}"
                    );
                    hit_count += 1;
                }
                None => assert!(sure == f64::INFINITY, "{spec} {occluders:?}: {ray:?} overlooks {sure}"),
            }
        }
        assert!(hit_count * 10 > ray_count, "{spec}: only {hit_count} of {ray_count} rays hit");
    }
}

#[test]
fn rays_meet_what_all_voxels_say() {
    check_rays("gen:isosurface:20k:2", 64, 150);
    check_rays("gen:pipes:30k:2", 64, 150);
}

#[test]
fn rays_meet_what_all_voxels_say_in_an_octant() {
    // 512 leaves use one octant of a cube of 1024.
    check_rays("gen:scan:10k:2", 512, 10);
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    let length = v.iter().map(|x| x * x).sum::<f64>().sqrt();
    v.map(|x| x / length)
}

/// Rays along the edges of voxels, and through their corners along diagonals: none meets a voxel that no ray beside it
/// meets, and along an edge none passes between voxels where all rays beside it meet one. What is met at a corner alone
/// may be met or not.
#[test]
fn rays_between_voxels_meet_what_is_on_one_of_their_sides() {
    let (built, octree) = octree_of("gen:isosurface:20k:2", 64);
    let block = built.file.superblock();
    let lattice = block.lattice;
    let corner = lattice.position(octree.grid().lo).map(|v| v - 0.5 * lattice.step());
    let mut rng = Random::seeded(17);
    for occluders in [Occluders::On, Occluders::Off] {
        let scene = VoxelScene::new(&octree, &lattice, occluders);
        let side = if occluders == Occluders::On { scene.leaf_side() / 4.0 } else { scene.leaf_side() };
        let boxes = boxes(&octree, occluders);
        let (mut hit_count, mut between_count) = (0, 0);
        for index in 0..240 {
            // A corner of some voxel, and a ray through it: along an axis, a diagonal of a plane, or of space.
            let &(at, _) = &boxes[rng.below(boxes.len() as i64) as usize];
            let through: [f64; 3] = std::array::from_fn(|a| corner[a] + f64::from(at[a]) * side);
            let axes = [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]][index % 3];
            let turn = index / 3 % 3;
            let sign = |a: usize| if (index / 9) >> a & 1 == 0 { 1.0 } else { -1.0 };
            let direction = unit(std::array::from_fn(|a| axes[(a + turn) % 3] * sign(a)));
            // Across it, and not along any diagonal of the grid.
            let across = unit(cross(direction, [0.3, 0.5, 0.8]));
            let other = cross(direction, across);
            // From outside of all voxels.
            let back = 600.0 * side;
            let ray_at = |off: f64, angle: f64| {
                let (sin, cos) = angle.sin_cos();
                let shift = |a: usize| off * (cos * across[a] + sin * other[a]);
                let origin = std::array::from_fn(|a| through[a] - back * direction[a] + shift(a));
                Ray { origin, direction, t_max: 2.0 * back }
            };
            // Where the boxes begin that a ray beside it is in for long enough to be sure of.
            let first = |ray: &Ray| {
                let spans = boxes.iter().map(|&(at, _)| slab(ray, corner, at, side));
                let sure = spans.filter(|(near, far)| far - near > 2e-3 * side && *near > 0.0);
                sure.map(|(near, _)| near).fold(f64::INFINITY, f64::min)
            };
            let beside: Vec<f64> =
                (0..12).map(|i| first(&ray_at(0.05 * side, f64::from(i) * 0.52))).collect();
            let [least, most] = [f64::min, f64::max].map(|of| beside.iter().copied().reduce(of).unwrap());
            let found = scene.intersect(&ray_at(0.0, 0.0)).map_or(f64::INFINITY, |hit| hit.t);
            let slack = 0.5 * side;
            let is_along_an_edge = index % 3 == 0;
            assert!(
                found >= least - slack && (found <= most + slack || !is_along_an_edge),
                "{occluders:?}: {direction:?} through {through:?}: {found}, beside it {beside:?}"
            );
            hit_count += u32::from(most.is_finite() && is_along_an_edge);
            between_count += u32::from(most.is_infinite() && least.is_finite());
        }
        assert!(
            hit_count > 20 && between_count > 0,
            "{occluders:?}: {hit_count} that have to hit, {between_count} that may"
        );
    }
}

/// Rays of all kinds: between points in and around the box, along axes, on boundaries of voxels, and such as are none.
pub(crate) fn rays_of_all_kinds(built: &Built, octree: &UpperOctree, count: usize) -> Vec<Ray> {
    let block = built.file.superblock();
    let (bounds, lattice) = (block.bounds, block.lattice);
    let corner = lattice.position(octree.grid().lo).map(|v| v - 0.5 * lattice.step());
    let subvoxel = octree.grid().subvoxel_steps as f64 * lattice.step();
    let size = bounds.diagonal();
    let mut rng = Random::seeded(11);
    let mut rays: Vec<Ray> = (0..count)
        .map(|index| {
            let mut point = || -> [f64; 3] {
                std::array::from_fn(|a| {
                    bounds.lo[a] + (1.4 * rng.unit() - 0.2) * (bounds.hi[a] - bounds.lo[a])
                })
            };
            let (mut origin, target) = (point(), point());
            let mut way: [f64; 3] = std::array::from_fn(|a| target[a] - origin[a]);
            if index % 8 == 1 {
                way[index / 8 % 3] = 0.0;
            }
            if index % 8 == 2 {
                (way[index / 8 % 3], way[(index / 8 + 1) % 3]) = (0.0, -0.0);
            }
            if index % 8 == 3 {
                origin = std::array::from_fn(|a| {
                    corner[a] + ((origin[a] - corner[a]) / subvoxel).round() * subvoxel
                });
                way = way.map(f64::signum);
            }
            let length = way.iter().map(|v| v * v).sum::<f64>().sqrt();
            let t_max = [f64::INFINITY, 2.0 * length, 0.5 * length, 1e-3 * size, 0.0][index % 5];
            Ray { origin, direction: way.map(|v| v / length), t_max }
        })
        .collect();
    let center = bounds.center();
    for odd in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0, 1e-300, 1e300, f64::MAX] {
        rays.push(Ray { origin: [center[0], odd, center[2]], direction: [0.6, 0.8, 0.0], t_max: size });
        rays.push(Ray { origin: center, direction: [0.6, 0.8, odd], t_max: f64::INFINITY });
        rays.push(Ray { origin: center, direction: [odd; 3], t_max: size });
        rays.push(Ray { origin: center, direction: [0.6, -0.8, 0.0], t_max: odd });
    }
    rays
}

/// Lanes walk as single rays do: the same bits, whatever else is in the batch.
fn check_batches(spec: &str, resolution: u32) {
    let (built, octree) = octree_of(spec, resolution);
    let rays = rays_of_all_kinds(&built, &octree, 6000);
    for occluders in [Occluders::On, Occluders::Off] {
        let scene = VoxelScene::new(&octree, &built.file.superblock().lattice, occluders);
        let bits = |hit: Option<VoxelHit>| hit.map(|hit| (hit.t.to_bits(), hit.leaf, hit.node, hit.axis));
        let single: Vec<_> = rays.iter().map(|ray| bits(scene.intersect(ray))).collect();
        let hit_count = single.iter().flatten().count();
        assert!(hit_count * 10 > rays.len() && hit_count < rays.len(), "{spec}: {hit_count} hits");
        for width in PacketWidth::ALL.into_iter().filter(|width| width.is_available()) {
            let mut hits = vec![None; rays.len()];
            scene.intersect_batch_with(width, &rays, &mut hits);
            for (at, ray) in rays.iter().enumerate() {
                assert_eq!(bits(hits[at]), single[at], "{spec} {occluders:?} {width:?}: {ray:?}");
            }
        }
        for batch in [1, 5, 32, 65, 128, rays.len()] {
            let mut hits = vec![None; rays.len()];
            for at in (0..rays.len()).step_by(batch) {
                let part = at..rays.len().min(at + batch);
                scene.intersect_batch(&rays[part.clone()], &mut hits[part]);
            }
            for (at, ray) in rays.iter().enumerate() {
                assert_eq!(bits(hits[at]), single[at], "{spec} {occluders:?}, {batch} at once: {ray:?}");
            }
        }
        scene.intersect_batch(&[], &mut []);
    }
}

#[test]
fn batches_meet_what_single_rays_meet() {
    for width in PacketWidth::ALL.into_iter().filter(|width| !width.is_available()) {
        cannot_run(&format!("the machine has no such lanes: {width:?}"));
    }
    check_batches("gen:isosurface:20k:2", 64);
    check_batches("gen:pipes:30k:3", 256);
    check_batches("gen:scan:10k:2", 512);
    check_batches("gen:soup:10k:3", 64);
}

/// Every triangle's corners and centre lie in voxels that are set.
#[test]
fn surfaces_are_in_their_voxels() {
    // A cube of each depth; at 1024 what has little surface.
    for (spec, resolution) in [("gen:pipes:30k:3", 256), ("gen:soup:10k:3", 64), ("gen:scan:10k:2", 1024)] {
        let (built, octree) = octree_of(spec, resolution);
        let scene = VoxelScene::new(&octree, &built.file.superblock().lattice, Occluders::On);
        let side = scene.leaf_side() / 4.0;
        for triangle in built.decode() {
            let center = std::array::from_fn(|a| (triangle[0][a] + triangle[1][a] + triangle[2][a]) / 3.0);
            for point in [triangle[0], triangle[1], triangle[2], center] {
                // A ray that begins in a voxel that is set hits at once.
                let ray = Ray { origin: point, direction: [0.0, 0.0, 1.0], t_max: 1e-3 * side };
                let near = [[0.0; 3], [1e-4; 3], [-1e-4; 3]].iter().any(|d| {
                    let origin = std::array::from_fn(|a| point[a] + d[a] * side);
                    scene.intersect(&Ray { origin, ..ray }).is_some()
                });
                assert!(near, "{spec}: {point:?} lies in an empty voxel");
            }
        }
    }
}

/// Leaves of a plane across an axis are alike and take little of the file, so that there may be more of them for as
/// many triangles: light leaks round the thin walls of a CAD model.
#[test]
fn what_lies_across_an_axis_gets_finer_voxels() {
    let resolution_of = |slant: f64| {
        let corner = |x: u32, y: u32| {
            let [x, y] = [x, y].map(|v| f64::from(v) / 330.0);
            [x, y * slant.cos(), y * slant.sin()]
        };
        let places = (0..33).flat_map(|y| (0..330).map(move |x| (x, y)));
        let quads = places.map(|(x, y)| [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(a, b)| corner(x + a, y + b)));
        let triangles = quads.flat_map(|[a, b, c, d]| [[a, b, c], [a, c, d]]).collect();
        let options = BuildOptions { voxels: Voxels::Within { upper_bytes: 64 << 20 }, ..build_options() };
        let built = build_source(&mut Mesh::new("strip", triangles), &options);
        built.file.upper_size().unwrap().unwrap().resolution
    };
    assert_eq!([0.0, 0.7].map(resolution_of), [512, 256]);
}
