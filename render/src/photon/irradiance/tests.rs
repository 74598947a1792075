//! Sums of photons at their extremes, against what they are by arithmetic.

use super::*;
use crate::testing::pool;
use crate::voxel::{Occluders, Voxels};
use trex_store::PageFile;
use trex_store::build::{self, BuildOptions, Precision};
use trex_store::import::{ImportOptions, open};

/// Photons of a pass.
const PASS: u64 = 1 << 18;

/// The voxels of a floor.
fn floor() -> Voxels {
    let folder = tempfile::tempdir().unwrap();
    let (input, path) = (folder.path().join("floor.obj"), folder.path().join("floor.trex"));
    std::fs::write(&input, "v 0 0 0\nv 9 0 0\nv 9 9 0\nv 0 9 0\nf 1 2 3 4\n").unwrap();
    let budget = Budget::unlimited();
    let options = BuildOptions {
        precision: Precision::Default,
        voxels: build::Voxels::Resolution(64),
        pool: pool(1),
        budget: budget.clone(),
        temp_dir: None,
        existing: Default::default(),
        resume: None,
        interrupt: Default::default(),
    };
    let mut source = open(&input, &ImportOptions::unlimited(folder.path())).unwrap();
    build::build(&mut *source, &path, &options, &|_| {}, &|_| {}).unwrap();
    Voxels::open(&PageFile::open(&path, &budget).unwrap(), &budget).unwrap().unwrap()
}

/// A side that all of 10^8 photons meet has their flux over its area; one that a single photon has met, in whatever
/// pass, has that of one in 10^8.
#[test]
fn one_photon_and_a_hundred_million_are_both_told() {
    let (voxels, budget) = (floor(), Budget::unlimited());
    let (facets, leaf_side) = (voxels.octree().facets(), voxels.scene(Occluders::On).leaf_side());
    let form = MapForm { facets: facets.count(), caustics: false };
    let flux = Vec3::new(3e-4, 2e-4, 1e-4);
    let passes = 100_000_000u64.div_ceil(PASS);
    let mut map = PhotonMap::new(form, &budget).unwrap();
    let mut pass = PhotonPass::new(form, flux, &budget).unwrap();
    // Even sides: the fronts.
    let rare: Vec<usize> = (1..form.facets).map(|facet| 2 * facet).collect();
    assert!(rare.len() > 100, "{}", rare.len());
    for index in 0..passes {
        match index {
            0 => (0..PASS).for_each(|_| pass.add_at(0, flux)),
            // The same units at once.
            _ => pass.add_at(0, flux * PASS as f32),
        }
        for (number, &side) in rare.iter().enumerate() {
            if number as u64 % passes == index {
                pass.add_at(side, flux);
            }
        }
        map.fold(&mut pass, PASS, facets, leaf_side);
    }
    let photons = map.photons();
    assert_eq!(photons, passes * PASS);
    let per_area = |side: usize| 1.0 / (f64::from(facets.side_area(side)) * leaf_side * leaf_side);
    for (side, share) in [(0, 1.0)].into_iter().chain(rare.iter().map(|&side| (side, 1.0 / photons as f64))) {
        let found = map.irradiance[side].rgb();
        for c in 0..3 {
            let expected = f64::from(flux[c]) * share * per_area(side);
            // What is kept is right to 2^-13 of the greatest channel, rounded by chance in each pass.
            let apart =
                (f64::from(found[c]) - expected) / (f64::from(flux.max_element()) * share * per_area(side));
            assert!(apart.abs() < 0.01, "side {side}, channel {c}: {} for {expected}", found[c]);
        }
    }
    // Nobody has lit what no photon has met.
    assert!((0..form.facets).all(|facet| map.irradiance[2 * facet + 1] == PackedLight::default()));
}
