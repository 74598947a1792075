//! Integrator `direct`: what is seen, lit by the lights; perfect mirrors carry the view on.
//!
//! ```text
//! primary ray -> hit -> n_shadow shadow rays -> mirror? -> mirror ray -> hit -> ...
//!             -> miss: sky
//! ```
//!
//! A sample is a [`Path`] that asks one ray at a time. Where a ray is Blocked the path stays as it is, and the
//! next [`Direct::advance`] asks that ray again: a retry needs the pages of ONE ray, never those of the whole
//! sample (see [`crate::frame`] for why that ends).
//!
//! Invariants: 1. a path gives the same bytes however often it was blocked; 2. each ray is counted once, when it
//! was answered, and reported with the finished sample; 3. a path has at most [`BOUNCES_MAX`] mirror bounces.

use crate::film::{LayerPixel, NO_ID};
use crate::light::Receiver;
use crate::material::{bsdf, takes_shadow_rays};
use crate::math::{
    add_rgb, along, dot, length, max_rgb, mul_rgb, reflect, scale, scale_rgb, sub, to_f64, unit,
};
use crate::sampler::{Decision, Sampler};
use crate::trace::{Answer, Hit, Ray, Tracer};
use crate::world::World;

/// Mirror bounces before roulette begins: most pictures need no more, and have no noise by it.
const BOUNCES_SURE: u32 = 4;
/// Greatest chance that a path goes on after that; ends halls of mirrors that lose no light.
const ROULETTE_MAX: f32 = 0.95;
/// Most mirror bounces. By roulette one path in 400,000 gets so far; what it would still bring is lost.
pub const BOUNCES_MAX: u32 = 256;
/// Secondary rays start off the surface by this many bounds on the error of the hit: one for the point itself, one
/// for the rounding of the next ray's test against the same plane, doubled since neither bound is along the normal.
const OFFSET_ERRORS: f64 = 4.0;
/// A shadow ray ends before the light by this share of its length: some f32 ulps, the rounding of a tracer that
/// works in f32 relative to the ray, whose error at the far end no hit has told.
const END_SHARE: f64 = 1.0 / (1 << 20) as f64;

/// Rays answered, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct RayCounts {
    /// Rays from the camera.
    pub primary: u64,
    /// Perfect mirror bounces.
    pub mirror: u64,
    /// Rays towards lights.
    pub shadow: u64,
}

/// What one finished sample says of its pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Radiance, linear RGB.
    pub radiance: [f32; 3],
    /// What the pixel's centre shows; of the first sample only, and only when layers are asked for.
    pub layers: Option<LayerPixel>,
    /// Rays that this sample took.
    pub rays: RayCounts,
}

/// The integrator.
#[derive(Clone, Copy, Debug)]
pub struct Direct<'a> {
    world: &'a World,
    layers: bool,
}

/// One sample of one pixel on its way: all that a retry needs.
#[derive(Clone, Debug)]
pub struct Path {
    pixel: [u32; 2],
    sampler: Sampler,
    stage: Stage,
    /// Index of the path vertex at the end of the current C-ray.
    vertex: u32,
    throughput: [f32; 3],
    sample: Sample,
}

#[derive(Clone, Copy, Debug)]
enum Stage {
    /// The ray through the pixel's centre, for the layers.
    Layers,
    /// A primary or mirror ray.
    CRay(Ray),
    /// Shadow ray `index` from a surface.
    Shadow {
        surface: Surface,
        index: u32,
    },
    /// What comes after the shadow rays.
    Bounce(Surface),
    Done,
}

/// A hit, seen from the side that the ray came from.
#[derive(Clone, Copy, Debug)]
struct Surface {
    point: [f64; 3],
    normal: [f64; 3],
    to_viewer: [f64; 3],
    error: f64,
    material: u32,
}

impl RayCounts {
    /// Adds another count.
    pub fn add(&mut self, other: &RayCounts) {
        self.primary += other.primary;
        self.mirror += other.mirror;
        self.shadow += other.shadow;
    }

    /// All kinds together.
    pub fn total(&self) -> u64 {
        self.primary + self.mirror + self.shadow
    }
}

impl Path {
    /// Rays answered up to now: grows with every step forward.
    pub fn answered(&self) -> u64 {
        self.sample.rays.total()
    }
}

impl<'a> Direct<'a> {
    /// An integrator for `world`; with `layers` the first sample of each pixel also says what its centre shows.
    pub fn new(world: &'a World, layers: bool) -> Direct<'a> {
        Direct { world, layers }
    }

    /// A new sample of `pixel` (x, y).
    pub fn start(&self, pixel: [u32; 2], sample: u32) -> Path {
        let mut path = Path {
            pixel,
            sampler: Sampler::new(self.world.seed, pixel, sample),
            stage: Stage::Layers,
            vertex: 0,
            throughput: [1.0; 3],
            sample: Sample::default(),
        };
        if !(self.layers && sample == 0) {
            path.stage = self.primary(&path);
        }
        path
    }

    /// Takes the sample as far as the answers go: to its end, or to the next ray that is blocked.
    ///
    /// # Panics
    /// When the sample is finished already.
    pub fn advance<T: Tracer>(&self, path: &mut Path, tracer: &mut T) -> Answer<Sample> {
        loop {
            let next = match path.stage {
                Stage::Layers => self.layers_step(path, tracer),
                Stage::CRay(ray) => self.c_ray_step(path, &ray, tracer),
                Stage::Shadow { surface, index } => self.shadow_step(path, &surface, index, tracer),
                Stage::Bounce(surface) => Answer::Exact(self.bounce(path, &surface)),
                Stage::Done => panic!("a finished sample was asked again"),
            };
            match next {
                Answer::Blocked => return Answer::Blocked,
                Answer::Exact(stage) => path.stage = stage,
            }
            if matches!(path.stage, Stage::Done) {
                return Answer::Exact(path.sample);
            }
        }
    }

    fn primary(&self, path: &Path) -> Stage {
        let [dx, dy, ..] = path.sampler.draw(Decision::Pixel);
        let [x, y] = path.pixel.map(f64::from);
        Stage::CRay(self.world.projection.ray(x + f64::from(dx), y + f64::from(dy)))
    }

    fn layers_step<T: Tracer>(&self, path: &mut Path, tracer: &mut T) -> Answer<Stage> {
        let [x, y] = path.pixel.map(|x| f64::from(x) + 0.5);
        let Answer::Exact(hit) = tracer.intersect(&self.world.projection.ray(x, y)) else {
            return Answer::Blocked;
        };
        path.sample.rays.primary += 1;
        path.sample.layers = Some(match hit {
            None => LayerPixel { depth: f32::INFINITY, normal: [0.0; 3], albedo: [0.0; 3], id: NO_ID },
            Some(hit) => {
                let material = &self.world.materials[hit.material as usize];
                let albedo = add_rgb(material.kd, material.ks);
                LayerPixel { depth: hit.t as f32, normal: hit.normal, albedo, id: hit.triangle }
            }
        });
        Answer::Exact(self.primary(path))
    }

    fn c_ray_step<T: Tracer>(&self, path: &mut Path, ray: &Ray, tracer: &mut T) -> Answer<Stage> {
        let Answer::Exact(hit) = tracer.intersect(ray) else { return Answer::Blocked };
        let rays = &mut path.sample.rays;
        *(if path.vertex == 0 { &mut rays.primary } else { &mut rays.mirror }) += 1;

        let lights = &self.world.lights;
        let seen = lights.seen(ray, hit.map_or(f64::INFINITY, |hit| hit.t));
        let Some(hit) = hit.filter(|_| seen.is_none()) else {
            path.gain(seen.unwrap_or(lights.sky()));
            return Answer::Exact(Stage::Done);
        };
        let material = &self.world.materials[hit.material as usize];
        if dot(to_f64(hit.normal), ray.direction) < 0.0 {
            path.gain(material.ke);
        }
        let surface = Surface::new(ray, &hit);
        let lit = self.world.n_shadow > 0 && takes_shadow_rays(material);
        Answer::Exact(if lit { Stage::Shadow { surface, index: 0 } } else { Stage::Bounce(surface) })
    }

    fn shadow_step<T: Tracer>(
        &self,
        path: &mut Path,
        surface: &Surface,
        index: u32,
        tracer: &mut T,
    ) -> Answer<Stage> {
        let count = self.world.n_shadow;
        let u = path.sampler.draw(Decision::Light { vertex: path.vertex, index, count });
        let receiver = Receiver { point: surface.point, normal: surface.normal };
        if let Some(sample) = self.world.lights.sample(&receiver, u) {
            let material = &self.world.materials[surface.material as usize];
            let scattered = bsdf(material, surface.normal, surface.to_viewer, sample.direction);
            let cos = dot(surface.normal, sample.direction) as f32;
            let light = scale_rgb(cos / count as f32, mul_rgb(scattered, sample.weight));
            if max_rgb(light) > 0.0 {
                let shadow_ray = surface.ray_to(sample.direction, sample.distance, sample.front);
                let Answer::Exact(occluded) = tracer.occluded(&shadow_ray) else { return Answer::Blocked };
                path.sample.rays.shadow += 1;
                if !occluded {
                    path.gain(light);
                }
            }
        }
        let index = index + 1;
        let surface = *surface;
        Answer::Exact(if index < count { Stage::Shadow { surface, index } } else { Stage::Bounce(surface) })
    }

    fn bounce(&self, path: &mut Path, surface: &Surface) -> Stage {
        let material = &self.world.materials[surface.material as usize];
        if !material.mirror || path.vertex == BOUNCES_MAX {
            return Stage::Done;
        }
        path.throughput = mul_rgb(path.throughput, material.ks);
        if path.vertex >= BOUNCES_SURE {
            let chance = max_rgb(path.throughput).min(ROULETTE_MAX);
            if path.sampler.draw(Decision::Roulette(path.vertex))[0] >= chance {
                return Stage::Done;
            }
            path.throughput = scale_rgb(1.0 / chance, path.throughput);
        }
        path.vertex += 1;
        let direction = reflect(scale(-1.0, surface.to_viewer), surface.normal);
        Stage::CRay(surface.ray_to(direction, f64::INFINITY, None))
    }
}

impl Path {
    /// Adds radiance that arrives at the current vertex.
    fn gain(&mut self, radiance: [f32; 3]) {
        self.sample.radiance = add_rgb(self.sample.radiance, mul_rgb(self.throughput, radiance));
    }
}

impl Surface {
    fn new(ray: &Ray, hit: &Hit) -> Surface {
        // A needle whose corners lie on one line has no normal, but rays do hit it: it faces them.
        let normal = unit(to_f64(hit.normal)).unwrap_or(scale(-1.0, ray.direction));
        let side = if dot(normal, ray.direction) > 0.0 { -1.0 } else { 1.0 };
        Surface {
            point: along(ray.origin, hit.t, ray.direction),
            normal: scale(side, normal),
            to_viewer: scale(-1.0, ray.direction),
            error: hit.error,
            material: hit.material,
        }
    }

    /// A ray off this surface in unit `direction`; where the other end, `distance` away, lies on a surface with
    /// normal `front`, it leaves that one too.
    fn ray_to(&self, direction: [f64; 3], distance: f64, front: Option<[f64; 3]>) -> Ray {
        let offset = OFFSET_ERRORS * self.error;
        let origin = along(self.point, offset, self.normal);
        if distance == f64::INFINITY {
            return Ray { origin, direction, t_max: distance };
        }
        let mut end = along(self.point, distance, direction);
        if let Some(front) = front {
            end = along(end, offset + END_SHARE * distance, front);
        }
        let way = sub(end, origin);
        match unit(way) {
            Some(direction) => Ray { origin, direction, t_max: length(way) },
            // The light touches the surface to within the error of the hit: nothing fits between.
            None => Ray { origin, direction, t_max: 0.0 },
        }
    }
}

#[cfg(test)]
#[path = "direct_tests.rs"]
mod tests;
