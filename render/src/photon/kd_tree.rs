//! `PhotonTree`: the photons of `full-gi`, each by itself, in a kd-tree; and the light that they tell of. H. W. Jensen,
//! "Realistic image synthesis using photon mapping" (2001); B. Silverman, "Density estimation" (1986), for the kernel.
//!
//! ```text
//! store: room per batch, so that workers need no order -> closed up in the order of photons -> tree
//! look-up: the k nearest; r = distance of the k-th
//!     L = sum over the k - 1 nearer ones on the same surface: bsdf * flux * 2 (1 - d^2 / r^2) / (pi r^2)
//! ```
//!
//! What is known of the estimate. Photons strewn evenly over a plane: given r, the k - 1 nearer ones lie evenly in
//! the disc, and pi r^2 has the mean of 1 / x that k - 1 photons take, so the sum is right on average (with the k-th
//! it is k / (k - 1) too bright). On a sphere too: what a chord r cuts off has the area pi r^2. Nearer than r to an
//! edge a part of the disc lies beside the surface; over a strip along the edge the kernel loses on average `r *
//! integral of x * 8 / (3 pi) (1 - x^2)^(3/2) over 0..1 = 8 / (15 pi) r = 0.17 r` of the light of its width (a flat
//! kernel: 0.21 r). So a surface of area A and edges P looks too dark by 0.17 r P / A, r^2 = k / (pi * photons per
//! area).
//!
//! Invariants: 1. the same photons give the same tree and the same light, whatever the threads; 2. all memory is
//! leased for the most photons there can be, before any is traced; 3. light is told of the surface's own side alone.

use super::mesh::{BATCH, Deposit, deposits_max};
use crate::scene::keys::TREE_PHOTONS_MAX;
use crate::shading::bsdf::takes_shadow_rays;
use crate::shading::surface::SurfaceInteraction;
use glam::{DVec3, Vec3};
use kiddo::SquaredEuclidean;
use kiddo::immutable::float::kdtree::ImmutableKdTree;
use std::f64::consts::PI;
use std::num::NonZero;
use trex_store::{Budget, Lease, Material, Result};

const _: () = assert!(TREE_PHOTONS_MAX / BATCH * deposits_max(BATCH) < 1 << 32);

/// Photons in a leaf of the tree.
const LEAF_PHOTONS: usize = 32;
/// Bytes that the tree takes for a hit while it is built, at most: its coordinates and number, stems and extents for
/// twice as many leaves as are full, a place in the order.
const BUILD_BYTES: u64 = 26;
/// Bytes of the tree for a hit when it stands.
const TREE_BYTES: u64 = 18;
/// Bytes of an almost empty tree.
const TREE_BYTES_LEAST: u64 = 4096;
/// Least cosine between the normals of a photon and of the place that is asked for: between the corners of an octagon
/// (0.71) and those of a hexagon (0.5), so that rounding decides neither.
const SAME_SURFACE_COS: f64 = 0.6;
/// A unit in the parts of a stored direction.
const DIRECTION_UNITS: f64 = 32767.0;

/// A hit, but for its place.
#[derive(Clone, Copy, Debug, Default)]
struct StoredHit {
    flux: [f32; 3],
    normal: [i16; 3],
    from: [i16; 3],
}

/// Room for hits while they come in.
#[derive(Debug)]
pub(crate) struct PhotonStore {
    /// Places of hits, model units from `center`; room for each batch.
    places: Vec<[f32; 3]>,
    stored: Vec<StoredHit>,
    /// Hits of each batch.
    counts: Vec<u32>,
    center: DVec3,
    lease: Lease,
}

/// The hits of all photons, for look-ups.
#[derive(Debug)]
pub(crate) struct PhotonTree {
    tree: ImmutableKdTree<f32, u32, 3, LEAF_PHOTONS>,
    stored: Vec<StoredHit>,
    center: DVec3,
    /// Photons sent.
    photons: u64,
    lease: Lease,
}

/// Count of hits of `photons` photons that there is room for.
fn room(photons: u64) -> u64 {
    photons / BATCH * deposits_max(BATCH)
        + if photons.is_multiple_of(BATCH) { 0 } else { deposits_max(photons % BATCH) }
}

impl PhotonStore {
    /// Room for the hits of `photons` photons, for their tree, and for `flight_bytes` of those under way; `center` is
    /// the middle of the model.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when `budget` has no room for [`PhotonTree::bytes`] and the flights.
    pub(crate) fn new(
        photons: u64,
        center: DVec3,
        flight_bytes: u64,
        budget: &Budget,
    ) -> Result<PhotonStore> {
        let lease = budget.lease("the photons", PhotonTree::bytes(photons) + flight_bytes)?;
        let room = room(photons) as usize;
        let counts = vec![0; photons.div_ceil(BATCH) as usize];
        Ok(PhotonStore {
            places: vec![[0.0; 3]; room],
            stored: vec![StoredHit::default(); room],
            counts,
            center,
            lease,
        })
    }

    /// Takes the hits of a batch.
    pub(crate) fn land(&mut self, batch: u64, deposits: &[Deposit]) {
        let from = (batch * deposits_max(BATCH)) as usize;
        for (index, deposit) in deposits.iter().enumerate() {
            self.places[from + index] = local(deposit.point, self.center);
            self.stored[from + index] = StoredHit {
                flux: deposit.cargo.flux.into(),
                normal: packed(deposit.normal),
                from: packed(deposit.from.as_dvec3()),
            };
        }
        self.counts[batch as usize] = deposits.len() as u32;
    }

    /// The tree of the hits of the first `photons` photons: all that were sent, or whole batches of them.
    pub(crate) fn into_tree(mut self, photons: u64) -> PhotonTree {
        let mut count = 0;
        for (batch, &hits) in self.counts.iter().take(photons.div_ceil(BATCH) as usize).enumerate() {
            let from = batch * deposits_max(BATCH) as usize;
            self.places.copy_within(from..from + hits as usize, count);
            self.stored.copy_within(from..from + hits as usize, count);
            count += hits as usize;
        }
        let tree = ImmutableKdTree::new_from_slice(&self.places[..count]);
        self.stored.truncate(count);
        self.stored.shrink_to_fit();
        drop(self.places);
        let tree = PhotonTree {
            tree,
            stored: self.stored,
            center: self.center,
            photons,
            lease: self.lease.split(0),
        };
        tree.in_lease(self.lease)
    }

    /// The lease of its memory, and of the tree's.
    pub(crate) fn lease_mut(&mut self) -> &mut Lease {
        &mut self.lease
    }
}

impl PhotonTree {
    /// This tree in `lease`, which gives back what the tree does not take.
    pub(crate) fn in_lease(self, mut lease: Lease) -> PhotonTree {
        let hits = self.stored.len() as u64;
        lease.shrink_to(hits * (size_of::<StoredHit>() as u64 + TREE_BYTES) + TREE_BYTES_LEAST);
        PhotonTree { lease, ..self }
    }

    /// The lease of its memory.
    pub(crate) fn lease_mut(&mut self) -> &mut Lease {
        &mut self.lease
    }

    /// Count of the photons that were sent for it.
    pub(crate) fn photons(&self) -> u64 {
        self.photons
    }

    /// Bytes that the photons take at most, while their tree is built.
    pub(crate) fn bytes(photons: u64) -> u64 {
        let hit = (size_of::<[f32; 3]>() + size_of::<StoredHit>()) as u64 + BUILD_BYTES;
        room(photons) * hit + photons.div_ceil(BATCH) * size_of::<u32>() as u64 + TREE_BYTES_LEAST
    }

    /// Radiance that leaves `surface` towards its viewer, by the `k` photons next to it; `materials` are the world's.
    pub(crate) fn radiance(&self, surface: &SurfaceInteraction, materials: &[Material], k: u32) -> Vec3 {
        let Some(k) = NonZero::new(k as usize).filter(|_| !self.stored.is_empty()) else { return Vec3::ZERO };
        let found = self.tree.nearest_n::<SquaredEuclidean>(&local(surface.point, self.center), k);
        let Some((farthest, nearer)) = found.split_last() else { return Vec3::ZERO };
        let (reach, bsdf) = (farthest.distance, surface.bsdf(materials));
        let material = bsdf.material;
        if reach <= 0.0 || !takes_shadow_rays(material) {
            return Vec3::ZERO;
        }
        let depends = surface.shading_normal != surface.normal || !material.mirror && material.ks != [0.0; 3];
        let diffuse = bsdf.eval(surface.normal);
        let mut sum = Vec3::ZERO;
        for near in nearer {
            let photon = &self.stored[near.item as usize];
            if unpacked(photon.normal).dot(surface.normal) < SAME_SURFACE_COS {
                continue;
            }
            let returned = if depends { bsdf.eval(unpacked(photon.from)) } else { diffuse };
            sum += (1.0 - near.distance / reach) * (returned * Vec3::from(photon.flux));
        }
        (2.0 / (PI * f64::from(reach) * self.photons as f64)) as f32 * sum
    }
}

fn local(point: DVec3, center: DVec3) -> [f32; 3] {
    (point - center).as_vec3().to_array()
}

fn packed(direction: DVec3) -> [i16; 3] {
    direction.to_array().map(|x| (x * DIRECTION_UNITS).round() as i16)
}

fn unpacked(direction: [i16; 3]) -> DVec3 {
    DVec3::from(direction.map(f64::from)) / DIRECTION_UNITS
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shading::bsdf::Bsdf;
    use crate::shading::surface::HitPoint;
    use crate::trace::Ray;
    use trex_film::mix;

    fn number(key: u64) -> f64 {
        (mix(key) >> 11) as f64 / (1u64 << 53) as f64
    }

    /// The surface that a ray from above sees at (x, y) of a plane with normal `normal`.
    fn surface([x, y]: [f64; 2], normal: [f32; 3]) -> SurfaceInteraction {
        let ray = Ray { origin: [x, y, 2.0], direction: [0.0, 0.6, -0.8], t_max: 9.0 };
        let hit = HitPoint {
            t: 2.5,
            material: 0,
            normal: normal.into(),
            shading_normal: normal.into(),
            colour: Vec3::ONE,
            error: 0.0,
        };
        let mut seen = SurfaceInteraction::new(&ray, &hit);
        seen.point = DVec3::new(x, y, 0.0);
        seen
    }

    /// Photons strewn over |x|, |y| <= 1 of the plane z = 0, every fourth on its other side; the oracle gets the same.
    fn strewn(count: u64) -> (PhotonTree, Vec<(DVec3, Deposit)>) {
        let mut store = PhotonStore::new(count, DVec3::ZERO, 0, &Budget::unlimited()).unwrap();
        let deposit = |index: u64| {
            let at = [0, 1].map(|axis| 2.0 * number(7 * index + axis) - 1.0);
            let side = if index % 4 == 3 { -1.0 } else { 1.0 };
            let from = side as f32 * Vec3::new(0.6, 0.0, 0.8);
            let flux = Vec3::new(1.0, 0.5, number(7 * index + 2) as f32);
            Deposit::new(DVec3::new(at[0], at[1], 0.0), side * DVec3::Z, from, flux)
        };
        let all: Vec<Deposit> = (0..count).map(deposit).collect();
        for (batch, deposits) in (0..).zip(all.chunks(BATCH as usize)) {
            store.land(batch, deposits);
        }
        (store.into_tree(count), all.into_iter().map(|deposit| (deposit.point, deposit)).collect())
    }

    #[test]
    fn the_light_is_that_of_the_formula_over_all_photons() {
        let (tree, mut all) = strewn(10_000);
        let glossy = Material { kd: [0.3; 3], ks: [0.5; 3], ns: 5.0, ..Material::default() };
        for (k, material) in [(2, Material::default()), (50, Material::default()), (50, glossy)] {
            for index in 0..20 {
                let at = surface([0, 1].map(|axis| number(index + 99 * axis) - 0.5), [0.0, 0.0, 1.0]);
                let squared = |p: DVec3| p.distance_squared(at.point);
                all.sort_by(|a, b| squared(a.0).total_cmp(&squared(b.0)));
                let reach = squared(all[k - 1].0);
                let expected: f64 = all[..k - 1]
                    .iter()
                    .filter(|(_, deposit)| deposit.normal[2] > 0.0)
                    .map(|(point, deposit)| {
                        let bsdf = Bsdf {
                            material: &material,
                            colour: Vec3::ONE,
                            normal: at.normal,
                            shading_normal: at.normal,
                            wo: at.wo,
                        };
                        let f = bsdf.eval(deposit.from.as_dvec3());
                        let kernel = 2.0 / PI * (1.0 - squared(*point) / reach) / reach;
                        f64::from(f[2] * deposit.cargo.flux[2]) * kernel / 10_000.0
                    })
                    .sum();
                let found = f64::from(tree.radiance(&at, std::slice::from_ref(&material), k as u32)[2]);
                assert!((found - expected).abs() <= 1e-3 * expected + 1e-9, "{k}: {found} for {expected}");
            }
        }
    }

    #[test]
    fn evenly_strewn_light_is_right_on_average_and_its_sides_are_told_apart() {
        let (tree, _) = strewn(40_000);
        let white = Material { kd: [1.0; 3], ..Material::default() };
        // Flux 1 over an area of 4, a quarter of it on the other side.
        for (normal, share) in [([0.0, 0.0, 1.0], 0.75), ([0.0, 0.8, 0.6], 0.75), ([1.0, 0.0, 0.1], 0.0)] {
            let mean = |channel: usize| {
                let sum: f64 = (0..4000)
                    .map(|index| surface([0, 1].map(|axis| 1.6 * number(3 * index + axis) - 0.8), normal))
                    .map(|at| f64::from(tree.radiance(&at, std::slice::from_ref(&white), 50)[channel]))
                    .sum();
                sum / 4000.0 * PI
            };
            assert!((mean(0) - 0.25 * share).abs() < 0.005, "{normal:?}: {}", mean(0));
            assert!((mean(1) - 0.125 * share).abs() < 0.003);
        }
    }

    #[test]
    fn few_photons_and_photons_at_one_place_are_no_trouble() {
        for count in [0, 1, 2, 40] {
            let (tree, _) = strewn(count);
            let light = tree.radiance(&surface([0.1, 0.2], [0.0, 0.0, 1.0]), &[Material::default()], 50);
            assert!(light[0].is_finite() && (light[0] > 0.0) == (count > 1), "{count}: {light:?}");
        }
        let mut store = PhotonStore::new(5000, DVec3::ZERO, 0, &Budget::unlimited()).unwrap();
        let one = Deposit::new(DVec3::new(0.5, 0.5, 0.0), DVec3::Z, Vec3::Z, Vec3::ONE);
        store.land(0, &vec![one; 4096]);
        let tree = store.into_tree(5000);
        for at in [[0.5, 0.5], [0.25, 0.5]] {
            let light = tree.radiance(&surface(at, [0.0, 0.0, 1.0]), &[Material::default()], 50);
            assert_eq!(light, Vec3::ZERO);
        }
    }

    #[test]
    fn memory_is_leased_for_the_most_and_shrinks() {
        let budget = Budget::unlimited();
        let store = PhotonStore::new(3 * BATCH, DVec3::ZERO, 0, &budget).unwrap();
        assert_eq!(budget.used_bytes(), PhotonTree::bytes(3 * BATCH));
        assert!(store.places.len() as u64 >= 9 * BATCH);
        let tree = store.into_tree(3 * BATCH);
        assert_eq!(budget.used_bytes(), TREE_BYTES_LEAST);
        drop(tree);
        assert_eq!(budget.used_bytes(), 0);
        let tight = Budget::new(trex_store::RESERVE_BYTES + PhotonTree::bytes(100) - 1);
        assert!(PhotonStore::new(100, DVec3::ZERO, 0, &tight).is_err());
    }
}
