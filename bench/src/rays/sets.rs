//! The ray sets: primary, shadow, incoherent.
//!
//! ```text
//! camera -> primary rays, one per pixel, along a Morton curve -> visible points
//!                    visible points -> shadow rays to one light, one a point
//!                    visible points -> gather rays, cosine-distributed, one a point
//! ```
//!
//! Invariants: 1. rays are f32 in lattice units, so that every contender gets the same numbers: lattice coordinates
//! below 2^24 are exact in f32, and the way back to model space is one rounded addition in f64; 2. eight rays that
//! follow each other are neighbours in the picture; 3. secondary rays start off their surface by `LIFT_ULPS`.

use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use trex_render::{Camera, Hit, Projection, Ray, up_axis};
use trex_store::layout::Superblock;

/// A ray in lattice units.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BenchRay {
    /// Start.
    pub(crate) origin: [f32; 3],
    /// Direction, any length.
    pub(crate) direction: [f32; 3],
    /// End, in lengths of `direction`.
    pub(crate) t_max: f32,
}

/// What is asked of a ray.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Query {
    /// The closest hit.
    Closest,
    /// Whether there is any.
    Any,
}

/// Rays that are traced and timed together.
#[derive(Clone, Debug)]
pub(crate) struct RaySet {
    /// What is asked of them.
    pub(crate) query: Query,
    /// True where neighbours go the same way.
    #[cfg_attr(not(feature = "peer-embree"), expect(dead_code, reason = "a peer has modes for such sets"))]
    pub(crate) is_coherent: bool,
    /// The rays.
    pub(crate) rays: Vec<BenchRay>,
}

/// All three.
#[derive(Clone, Debug)]
pub(crate) struct RaySets {
    /// From the camera.
    pub(crate) primary: RaySet,
    /// From visible points to the light.
    pub(crate) shadow: RaySet,
    /// From visible points to where light could come from.
    pub(crate) incoherent: RaySet,
    /// The same and shadow rays, from so far off the surface that they are free of its own voxels; none where the
    /// file has no voxels. Of the upper octree, and of the finest ones.
    pub(crate) gray: [Option<GraySets>; 2],
}

/// Rays for voxels.
#[derive(Clone, Debug)]
pub(crate) struct GraySets {
    /// Directions of the incoherent rays.
    pub(crate) gather: RaySet,
    /// Directions of the shadow rays.
    pub(crate) shadow: RaySet,
    /// Where both start.
    pub(crate) points: Vec<Visible>,
}

/// How many rays each visible point asks, as the renderer asks them: shadow rays to a lamp, then gather rays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct RayMix {
    /// Shadow rays.
    pub(crate) n_shadow: u32,
    /// Gather rays.
    pub(crate) n_gather: u32,
}

impl RayMix {
    /// The paper's, and what pictures of higher quality ask.
    pub(crate) const ALL: [RayMix; 2] =
        [RayMix { n_shadow: 2, n_gather: 2 }, RayMix { n_shadow: 4, n_gather: 8 }];
}

/// How far off the surface secondary rays start, in units of the last place of the largest lattice coordinate.
const LIFT_ULPS: f64 = 4.0;
/// Where the light stands: diagonals of the model from its centre, along up and along the other two axes.
const LIGHT_UP: f64 = 0.8;
const LIGHT_ASIDE: f64 = 0.3;
/// Side of the lamp of mixed rays, diagonals of the model.
const LAMP_SIDE: f64 = 0.1;
/// Points that follow each other in the picture and are taken together: those of a tile.
const TILE_POINTS: usize = 64;

/// How lattice rays lie in model space.
#[derive(Clone, Copy, Debug)]
pub(super) struct Space {
    origin: [f64; 3],
    step: f64,
    /// See `LIFT_ULPS`, lattice steps.
    lift: f64,
}

impl Space {
    pub(super) fn new(block: &Superblock) -> Space {
        let largest = block.lattice_bounds[1].into_iter().max().unwrap_or(1).max(1) as f64;
        Space {
            origin: block.lattice.origin,
            step: block.lattice.step(),
            lift: LIFT_ULPS * largest * f64::from(f32::EPSILON),
        }
    }

    /// The same ray in model space, with the same t: the step is a power of two.
    pub(super) fn to_model(self, ray: &BenchRay) -> Ray {
        let mut model = Ray { origin: [0.0; 3], direction: [0.0; 3], t_max: f64::from(ray.t_max) };
        for a in 0..3 {
            model.origin[a] = self.origin[a] + f64::from(ray.origin[a]) * self.step;
            model.direction[a] = f64::from(ray.direction[a]) * self.step;
        }
        model
    }

    /// The same for voxels, with a unit direction.
    pub(super) fn to_gray(self, ray: &BenchRay) -> Ray {
        let model = self.to_model(ray);
        let length = model.direction.iter().map(|d| d * d).sum::<f64>().sqrt();
        let direction = model.direction.map(|d| d / length);
        Ray { origin: model.origin, direction, t_max: model.t_max * length }
    }

    fn to_lattice(self, point: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|a| (point[a] - self.origin[a]) / self.step)
    }
}

/// A visible point: where secondary rays start, and the normal on the side that is seen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Visible {
    origin: [f32; 3],
    normal: [f32; 3],
}

/// One ray per pixel, along a Morton curve.
pub(super) fn primary(space: Space, camera: &Camera, resolution: [u32; 2]) -> anyhow::Result<RaySet> {
    let projection = camera.project(resolution)?;
    let [width, height] = resolution;
    let side = width.max(height).next_power_of_two();
    let pixels = (0..u64::from(side) * u64::from(side)).map(|at| [even_bits(at), even_bits(at >> 1)]);
    let inside = pixels.filter(|[x, y]| *x < width && *y < height);
    let rays = inside.map(|pixel| through(space, &projection, pixel)).collect();
    Ok(RaySet { query: Query::Closest, is_coherent: true, rays })
}

fn through(space: Space, projection: &Projection, [x, y]: [u32; 2]) -> BenchRay {
    let ray = projection.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
    BenchRay {
        origin: space.to_lattice(ray.origin).map(|x| x as f32),
        direction: ray.direction.map(|d| d as f32),
        t_max: f32::INFINITY,
    }
}

/// Every second bit of `word`, put together.
fn even_bits(word: u64) -> u32 {
    (0..32).map(|bit| ((word >> (2 * bit)) as u32 & 1) << bit).sum()
}

/// Where secondary rays of a hit start.
pub(super) fn visible(space: Space, ray: &BenchRay, hit: &Hit) -> Visible {
    let mut normal = hit.normal.map(f64::from);
    let along: f64 = (0..3).map(|a| normal[a] * f64::from(ray.direction[a])).sum();
    if along > 0.0 {
        normal = normal.map(|n| -n);
    }
    let lift = space.lift + hit.error / space.step;
    let origin = std::array::from_fn(|a| {
        let point = f64::from(ray.origin[a]) + hit.t * f64::from(ray.direction[a]);
        (point + lift * normal[a]) as f32
    });
    Visible { origin, normal: normal.map(|n| n as f32) }
}

/// The same point `clearance` (lattice steps along each axis of the normal) farther off its surface.
pub(super) fn lifted(point: &Visible, clearance: f64) -> Visible {
    let height = clearance * point.normal.iter().map(|n| f64::from(n.abs())).sum::<f64>();
    let origin =
        std::array::from_fn(|a| (f64::from(point.origin[a]) + height * f64::from(point.normal[a])) as f32);
    Visible { origin, normal: point.normal }
}

/// A ray from each visible point to the light.
pub(super) fn shadow(space: Space, block: &Superblock, points: &[Visible]) -> RaySet {
    let light = space.to_lattice(light(block));
    let rays = points.iter().map(|point| towards(point, light)).collect();
    RaySet { query: Query::Any, is_coherent: true, rays }
}

/// Where the light stands, model units.
fn light(block: &Superblock) -> [f64; 3] {
    let (up, center, size) = (up_axis(&block.bounds), block.bounds.center(), block.bounds.diagonal());
    std::array::from_fn(|a| center[a] + size * if up[a] != 0.0 { LIGHT_UP * up[a] } else { LIGHT_ASIDE })
}

fn towards(point: &Visible, light: [f64; 3]) -> BenchRay {
    BenchRay {
        origin: point.origin,
        direction: std::array::from_fn(|a| (light[a] - f64::from(point.origin[a])) as f32),
        t_max: 1.0,
    }
}

/// The rays of points in tiles that are spread over the picture, point by point, at most as many as there are points.
pub(super) fn mixed(
    space: Space,
    block: &Superblock,
    (points, mix): (&[Visible], RayMix),
    seed: u64,
) -> Vec<(BenchRay, Query)> {
    let mut rng = Pcg64::seed_from_u64(seed);
    let (light, side) = (light(block), LAMP_SIDE * block.bounds.diagonal());
    let rays_a_point = (mix.n_shadow + mix.n_gather) as usize;
    let mut rays = Vec::with_capacity(points.len());
    for point in points.chunks(TILE_POINTS).step_by(rays_a_point).flatten() {
        for _ in 0..mix.n_shadow {
            let lamp = light.map(|at| at + side * (unit(&mut rng) - 0.5));
            rays.push((towards(point, space.to_lattice(lamp)), Query::Any));
        }
        for _ in 0..mix.n_gather {
            let direction = cosine_direction(point.normal, &mut rng);
            rays.push((BenchRay { origin: point.origin, direction, t_max: f32::INFINITY }, Query::Closest));
        }
    }
    rays
}

/// A cosine-distributed ray from each visible point.
pub(super) fn incoherent(points: &[Visible], seed: u64) -> RaySet {
    let mut rng = Pcg64::seed_from_u64(seed);
    let gather = |point: &Visible| BenchRay {
        origin: point.origin,
        direction: cosine_direction(point.normal, &mut rng),
        t_max: f32::INFINITY,
    };
    RaySet { query: Query::Closest, is_coherent: false, rays: points.iter().map(gather).collect() }
}

/// A number from 0 to 1.
fn unit(rng: &mut Pcg64) -> f64 {
    (rng.next_u64() >> 11) as f64 / (1u64 << 53) as f64
}

/// The normal plus a point of the unit sphere has a cosine-distributed direction.
fn cosine_direction(normal: [f32; 3], rng: &mut Pcg64) -> [f32; 3] {
    let (z, turn) = (2.0 * unit(rng) - 1.0, std::f64::consts::TAU * unit(rng));
    let radius = (1.0 - z * z).max(0.0).sqrt();
    let point = [radius * turn.cos(), radius * turn.sin(), z];
    let sum: [f64; 3] = std::array::from_fn(|a| f64::from(normal[a]) + point[a]);
    let length = sum.iter().map(|x| x * x).sum::<f64>().sqrt();
    if length > 1e-6 { sum.map(|x| (x / length) as f32) } else { normal }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_visits_neighbours() {
        let first: Vec<[u32; 2]> = (0..8).map(|at| [even_bits(at), even_bits(at >> 1)]).collect();
        assert_eq!(first, [[0, 0], [1, 0], [0, 1], [1, 1], [2, 0], [3, 0], [2, 1], [3, 1]]);
    }

    #[test]
    fn gather_rays_leave_on_the_side_of_the_normal_with_mean_cosine_two_thirds() {
        let mut rng = Pcg64::seed_from_u64(1);
        let cosines: Vec<f32> = (0..10_000).map(|_| cosine_direction([0.0, 0.0, 1.0], &mut rng)[2]).collect();
        assert!(cosines.iter().all(|cosine| *cosine >= 0.0));
        let mean = cosines.iter().sum::<f32>() / 10_000.0;
        assert!((mean - 2.0 / 3.0).abs() < 0.01, "{mean}");
    }
}
