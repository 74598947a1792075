//! `MeshRays`: rays that the samples of a tile ask of the mesh, whether they meet anything: shadow rays of `direct`,
//! `path` and `full-gi`, and the beginnings of others with `near = exact`.
//!
//! ```text
//! rays -> by direction, neighbours of the tile after each other -> bundles of a packet
//!      a bundle goes much the same way -> together
//!      it is not full (sky), or its rays leave where bounces ended -> one by one, which costs less then
//! ```
//!
//! Invariant: a ray gets the answer that it would get alone.

use crate::trace::{Answer, Ray, Tracer};

/// Rays of a bundle: those of a packet of the mesh tracer. Fewer cost as much as all, and go one by one.
const BUNDLE_RAYS: usize = 8;
/// Parts of a face of the cube of directions, along an axis: each some 22 degrees wide.
const FACE_PARTS: u8 = 4;
/// The place in the order of rays that go alone, behind those of all directions.
const ALONE: u8 = 6 * FACE_PARTS * FACE_PARTS;

/// The start of a ray, beside those of its neighbours in the tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Start {
    /// Near them: at what is seen, or seen in mirrors.
    Near,
    /// Anywhere: at the end of a bounce by chance.
    Scattered,
}

/// The rays, and their answers.
#[derive(Debug, Default)]
pub(super) struct MeshRays {
    rays: Vec<Ray>,
    /// The part of the cube of directions that each ray goes through, or [`ALONE`].
    keys: Vec<u8>,
    answers: Vec<Answer<bool>>,
}

impl MeshRays {
    /// Bytes of a ray with its answer, its place in the order, and what bundles take.
    pub(super) const RAY_BYTES: usize =
        size_of::<Ray>() + size_of::<u8>() + size_of::<Answer<bool>>() + size_of::<u32>();

    /// Makes room for so many rays.
    pub(super) fn reserve_exact(&mut self, rays: usize) {
        self.rays.reserve_exact(rays);
        self.keys.reserve_exact(rays);
    }

    /// Asks `ray`. Gives its place.
    pub(super) fn push(&mut self, ray: Ray, start: Start) -> u32 {
        self.keys.push(if start == Start::Near { part_of(ray.direction) } else { ALONE });
        self.rays.push(ray);
        self.rays.len() as u32 - 1
    }

    /// Count of rays.
    pub(super) fn len(&self) -> usize {
        self.rays.len()
    }

    /// Forgets the rays from place `count` on, which were not answered yet.
    pub(super) fn truncate(&mut self, count: usize) {
        self.rays.truncate(count);
        self.keys.truncate(count);
    }

    /// Has `tracer` answer all rays.
    pub(super) fn answer<T: Tracer>(&mut self, tracer: &mut T) {
        let MeshRays { rays, keys, answers } = self;
        answers.clear();
        answers.resize(rays.len(), Answer::Blocked);
        let order = in_order(keys);
        let mut together = Vec::with_capacity(BUNDLE_RAYS);
        for alike in order.chunk_by(|&a, &b| keys[a as usize] == keys[b as usize]) {
            for places in alike.chunks(BUNDLE_RAYS) {
                if keys[places[0] as usize] == ALONE || places.len() < BUNDLE_RAYS {
                    for &place in places {
                        answers[place as usize] = tracer.occluded(&rays[place as usize]);
                    }
                    continue;
                }
                let mut bundle = [rays[places[0] as usize]; BUNDLE_RAYS];
                places.iter().zip(&mut bundle).for_each(|(&place, ray)| *ray = rays[place as usize]);
                together.clear();
                tracer.occluded_coherent(&bundle, &mut together);
                places.iter().zip(&together).for_each(|(&place, answer)| answers[place as usize] = *answer);
            }
        }
    }

    /// The answer of the ray in `place`.
    pub(super) fn occluded(&self, place: u32) -> Answer<bool> {
        self.answers[place as usize]
    }
}

/// The part of the cube of directions that `direction` goes through.
fn part_of(direction: [f64; 3]) -> u8 {
    let [x, y, z] = direction.map(f64::abs);
    let face = if x >= y && x >= z {
        0
    } else if y >= z {
        1
    } else {
        2
    };
    let longest = direction[face].abs();
    let part = |axis: usize| {
        let at = (direction[axis % 3] / longest + 1.0) * 0.5 * f64::from(FACE_PARTS);
        (at as u8).min(FACE_PARTS - 1)
    };
    let side = 2 * face as u8 + u8::from(direction[face] < 0.0);
    (side * FACE_PARTS + part(face + 1)) * FACE_PARTS + part(face + 2)
}

/// Places by their keys, those of a key in their order.
fn in_order(keys: &[u8]) -> Vec<u32> {
    let mut next = [0u32; ALONE as usize + 2];
    keys.iter().for_each(|&key| next[key as usize + 1] += 1);
    for key in 1..next.len() {
        next[key] += next[key - 1];
    }
    let mut order = vec![0; keys.len()];
    for (place, &key) in (0..).zip(keys) {
        order[next[key as usize] as usize] = place;
        next[key as usize] += 1;
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::{Hit, NaiveMesh, NaiveTriangle};
    use trex_film::mix;

    /// Counts rays that go alone and together.
    struct RayCounter {
        mesh: NaiveMesh,
        alone: usize,
        together: usize,
    }

    impl Tracer for RayCounter {
        fn intersect(&mut self, _: &Ray) -> Answer<Option<Hit>> {
            unreachable!("these rays ask whether anything is hit")
        }

        fn occluded(&mut self, ray: &Ray) -> Answer<bool> {
            self.alone += 1;
            self.mesh.occluded(ray)
        }

        fn occluded_coherent(&mut self, rays: &[Ray], answers: &mut Vec<Answer<bool>>) {
            self.together += rays.len();
            self.mesh.occluded_coherent(rays, answers);
        }
    }

    /// Every other ray goes to a sun, the others anywhere: each gets its own answer, in its place, and those to the sun
    /// go together, unless they leave where bounces ended.
    #[test]
    fn rays_are_answered_in_their_places_and_bundled_where_they_are_alike() {
        let number = |key: u64| (mix(key) >> 11) as f64 / (1u64 << 53) as f64 - 0.5;
        let corner = |key: u64| std::array::from_fn(|axis| number(3 * key + axis as u64));
        let triangle = |key| NaiveTriangle { corners: [key, key + 1, key + 2].map(corner), material: 0 };
        let mesh = NaiveMesh::new((0..12).map(|key| triangle(9 * key)).collect());
        let ray = |key: u64| {
            let direction = if key.is_multiple_of(2) { [0.6, 0.0, 0.8] } else { corner(7 * key + 5) };
            Ray { origin: corner(7 * key), direction, t_max: 1.0 }
        };
        for start in [Start::Near, Start::Scattered] {
            let mut tracer = RayCounter { mesh: mesh.clone(), alone: 0, together: 0 };
            let mut rays = MeshRays::default();
            (0..203).for_each(|key| assert_eq!(rays.push(ray(key), start), key as u32));
            rays.truncate(200);
            rays.answer(&mut tracer);
            let expected: Vec<_> = (0..200).map(|key| mesh.clone().occluded(&ray(key))).collect();
            assert!((0..200).all(|place| rays.occluded(place) == expected[place as usize]));
            let met = expected.iter().filter(|answer| **answer == Answer::Exact(true)).count();
            assert!((20..180).contains(&met) && tracer.alone + tracer.together == 200, "{met}");
            let most = if start == Start::Near { 90..=140 } else { 0..=0 };
            assert!(most.contains(&tracer.together), "{} together", tracer.together);
        }
    }
}
