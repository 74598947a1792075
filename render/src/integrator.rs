//! `Integrator`: a sample of a pixel, a ray at a time. What the integrators share, and where they part.
//!
//! ```text
//! primary ray -> hit --direct--> n_shadow shadow rays -> mirror? -> mirror ray -> hit -> ...
//!             |      --path----> n_shadow shadow rays -> a bounce by chance    -> hit -> ...
//!             |      --photon--> n_shadow shadow rays -> n_gather gather rays -> mirror? -> ...   (`full-gi` alike)
//!             |      --ao------> n_shadow rays by the cosine
//!             -> miss: sky
//! ```
//!
//! A sample is a [`Path`] that asks one ray at a time. Where a ray is Blocked the path stays as it is, and the
//! next [`Integrator::advance`] asks that ray again: a retry needs the pages of ONE ray, never those of the whole
//! sample (see [`crate::frame`] for why that ends).
//!
//! Invariants: 1. a path gives the same bytes however often it was blocked; 2. each ray is counted once, when it
//! was answered, and reported with the finished sample; 3. a path has at most [`BOUNCES_MAX`] bounces.

use crate::film::{LayerPixel, NO_ID};
use crate::footprint::{Closest, FarRay, behind};
use crate::full_gi::GatherRay;
use crate::g_batch::{GBatches, Place};
use crate::light::LightSample;
use crate::material::{bsdf, takes_shadow_rays};
use crate::math::{add_rgb, dot, max_rgb, mul_rgb, scale_rgb, to_f64};
use crate::path::light_share;
use crate::photon_tree::PhotonTree;
use crate::sampler::{Decision, Sampler};
use crate::surface::Surface;
use crate::trace::{Answer, Hit, Ray, Tracer};
use crate::voxel::GScene;
use crate::world::World;

/// Bounces before roulette begins: most light comes by fewer, and has no noise by it.
const BOUNCES_SURE: u32 = 4;
/// Greatest chance that a path goes on after that; ends halls of mirrors that lose no light.
const ROULETTE_MAX: f32 = 0.95;
/// Most bounces. By roulette one path in 400,000 gets so far; what it would still bring is lost.
pub const BOUNCES_MAX: u32 = 256;
/// How light is computed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Direct light and perfect mirrors: see `direct.rs`.
    #[default]
    Direct,
    /// All light, unbiased: see `path.rs`.
    Path,
    /// Ambient occlusion: see `ao.rs`.
    Ao,
    /// Photon mapping on voxels: see `photon.rs`. As `cpu-gi` with all of it on the CPU, where all of it runs.
    #[serde(alias = "cpu-gi")]
    Photon,
    /// Photon mapping on the exact mesh: see `full_gi.rs`.
    #[serde(rename = "full-gi")]
    FullGi,
    /// The leaves of the voxel octree: see `debug.rs`.
    #[serde(rename = "debug-upper")]
    DebugUpper,
    /// The finest voxels, through the units below it.
    #[serde(rename = "debug-lower")]
    DebugLower,
    /// The bitmaps of the resident octree.
    #[serde(rename = "debug-occluders")]
    DebugOccluders,
    /// The pages of the mesh.
    #[serde(rename = "debug-pages")]
    DebugPages,
}

impl Method {
    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            Method::Direct => "direct",
            Method::Path => "path",
            Method::Ao => "ao",
            Method::Photon => "photon",
            Method::FullGi => "full-gi",
            Method::DebugUpper => "debug-upper",
            Method::DebugLower => "debug-lower",
            Method::DebugOccluders => "debug-occluders",
            Method::DebugPages => "debug-pages",
        }
    }

    /// Whether nothing can be drawn without voxels.
    pub fn needs_voxels(self) -> bool {
        self == Method::Photon || self.shows_voxels()
    }

    /// Whether C-rays show voxels, not the mesh.
    pub(crate) fn shows_voxels(self) -> bool {
        matches!(self, Method::DebugUpper | Method::DebugLower | Method::DebugOccluders)
    }

    /// Whether indirect light is gathered from photons.
    pub fn gathers(self) -> bool {
        matches!(self, Method::Photon | Method::FullGi)
    }

    /// Whether voxels are asked where there are any.
    pub fn asks_voxels(self) -> bool {
        self.needs_voxels() || self == Method::Ao
    }
}

/// Rays answered, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct RayCounts {
    /// Rays from the camera.
    pub primary: u64,
    /// Perfect mirror bounces.
    pub mirror: u64,
    /// Rays towards lights.
    pub shadow: u64,
    /// Rays that gather light by chance: bounces of `path`, gather rays of photon mapping, rays of `ao`.
    pub gather: u64,
    /// Rays of photons; these are no part of a sample.
    pub photon: u64,
}

/// How far a step took a sample.
pub(crate) enum Step {
    /// The next ray waits for pages.
    Blocked,
    /// Rays are in the batch.
    Asks,
    Done(Sample),
}

/// What one finished sample says of its pixel.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Radiance, linear RGB.
    pub radiance: [f32; 3],
    /// Of this, what gather rays brought to the surface that is seen.
    pub indirect: [f32; 3],
    /// What the pixel's centre shows; of the first sample only, and only when layers are asked for.
    pub layers: Option<LayerPixel>,
    /// Rays that this sample took.
    pub rays: RayCounts,
    /// Look-ups of the photons next to a place; of `full-gi`.
    pub look_ups: u64,
}

/// The integrator that a world asks for.
#[derive(Clone, Copy, Debug)]
pub struct Integrator<'a> {
    pub(crate) world: &'a World,
    layers: bool,
    /// What answers G-rays; without, the mesh does.
    pub(crate) voxels: Option<GScene<'a>>,
    /// What stands for the mesh where it is far or missing.
    pub(crate) stand_in: Option<GScene<'a>>,
    /// The photons of `full-gi`; without, surfaces are dark to gather rays.
    pub(crate) photons: Option<&'a PhotonTree>,
}

/// One sample of one pixel on its way: all that a retry needs.
#[derive(Clone, Debug)]
pub struct Path {
    pixel: [u32; 2],
    pub(crate) sampler: Sampler,
    pub(crate) stage: Stage,
    /// Index of the path vertex at the end of the current C-ray.
    pub(crate) vertex: u32,
    /// Length of the C-rays before the current one, model units.
    pub(crate) travelled: f64,
    /// Whether the current C-ray leaves a place that voxels answered for.
    pub(crate) is_far: bool,
    pub(crate) throughput: [f32; 3],
    /// How the current C-ray came about.
    pub(crate) origin: Origin,
    pub(crate) sample: Sample,
}

#[derive(Clone, Debug)]
pub(crate) enum Stage {
    /// The ray through the pixel's centre, for the layers.
    Layers,
    /// A ray that asks for the closest hit.
    CRay(Ray),
    /// The mesh has answered a C-ray up to the cut of the footprint rule.
    Met {
        ray: Ray,
        cut: f64,
        found: Option<Hit>,
    },
    /// Ray `index` from a surface that asks whether anything is hit.
    Shadow {
        surface: Surface,
        index: u32,
    },
    /// Ray `index` from a surface that gathers light.
    Gather {
        surface: Surface,
        index: u32,
    },
    /// The part of a C-ray behind the cut has been asked in a batch.
    TakeFar {
        ray: Ray,
        far: FarRay,
        place: u32,
    },
    /// Shadow and gather rays have been asked in a batch.
    TakeGRays(Place),
    /// A ray that gathers light on the exact mesh, on its way.
    GatherRay(GatherRay),
    /// What comes after these.
    Bounce(Surface),
    Done,
}

/// A ray from a surface that asks whether anything is hit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ShadowQuery {
    pub(crate) direction: [f64; 3],
    pub(crate) distance: f64,
    /// Normal of the surface at the other end, if there is one.
    pub(crate) front: Option<[f64; 3]>,
    /// What is gained when nothing is.
    pub(crate) light: [f32; 3],
}

/// How a C-ray came about: what it sees has another weight where light samples could have found it too.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Origin {
    Camera,
    Mirror,
    /// Drawn at a surface, with this density per solid angle.
    Scattered {
        from: Surface,
        density: f64,
    },
}

/// Rays per second, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct RayRates {
    /// From the camera.
    pub primary: f64,
    /// From perfect mirrors.
    pub mirror: f64,
    /// Towards lights.
    pub shadow: f64,
    /// That gather light.
    pub gather: f64,
    /// Of photons.
    pub photon: f64,
}

impl RayCounts {
    /// Adds another count.
    pub fn add(&mut self, other: &RayCounts) {
        self.primary += other.primary;
        self.mirror += other.mirror;
        self.shadow += other.shadow;
        self.gather += other.gather;
        self.photon += other.photon;
    }

    /// All kinds together.
    pub fn total(&self) -> u64 {
        self.primary + self.mirror + self.shadow + self.gather + self.photon
    }

    /// Each kind over a time.
    pub fn per_s(&self, seconds: f64) -> RayRates {
        let rate = |count: u64| count as f64 / seconds.max(1e-9);
        RayRates {
            primary: rate(self.primary),
            mirror: rate(self.mirror),
            shadow: rate(self.shadow),
            gather: rate(self.gather),
            photon: rate(self.photon),
        }
    }
}

impl Path {
    /// Rays answered up to now: grows with every step forward.
    pub fn answered(&self) -> u64 {
        self.sample.rays.total()
    }

    /// Adds radiance that arrives at the current vertex.
    pub(crate) fn gain(&mut self, radiance: [f32; 3]) {
        self.sample.radiance = add_rgb(self.sample.radiance, mul_rgb(self.throughput, radiance));
    }

    /// The same for radiance that gather rays brought: what the filter may smooth, unless a mirror shows it.
    pub(crate) fn gain_indirect(&mut self, radiance: [f32; 3]) {
        self.gain(radiance);
        if self.vertex == 0 {
            self.sample.indirect = add_rgb(self.sample.indirect, mul_rgb(self.throughput, radiance));
        }
    }

    /// Whether the path goes on after its vertex: roulette, by what it can still bring.
    pub(crate) fn survives(&mut self) -> bool {
        if self.vertex < BOUNCES_SURE {
            return true;
        }
        let chance = max_rgb(self.throughput).min(ROULETTE_MAX);
        if self.vertex == BOUNCES_MAX || self.sampler.draw(Decision::Roulette(self.vertex))[0] >= chance {
            return false;
        }
        self.throughput = scale_rgb(1.0 / chance, self.throughput);
        true
    }
}

impl<'a> Integrator<'a> {
    /// The integrator of `world`; with `layers` the first sample of each pixel also says what its centre shows.
    pub fn new(world: &'a World, layers: bool) -> Integrator<'a> {
        Integrator { world, layers, voxels: None, stand_in: None, photons: None }
    }

    /// The same, with G-rays answered by voxels.
    pub(crate) fn with_voxels(self, voxels: Option<GScene<'a>>) -> Integrator<'a> {
        Integrator { voxels, ..self }
    }

    /// The same, with voxels for what is beyond the cut of [`World::voxels_from`], and for stand-ins.
    pub(crate) fn with_stand_in(self, stand_in: Option<GScene<'a>>) -> Integrator<'a> {
        Integrator { stand_in, ..self }
    }

    /// The same, with these photons for `full-gi`.
    pub(crate) fn with_photons(self, photons: Option<&'a PhotonTree>) -> Integrator<'a> {
        Integrator { photons, ..self }
    }

    /// A new sample of `pixel` (x, y).
    pub fn start(&self, pixel: [u32; 2], sample: u32) -> Path {
        let mut path = Path {
            pixel,
            sampler: Sampler::new(self.world.seed, pixel, sample),
            stage: Stage::Layers,
            vertex: 0,
            travelled: 0.0,
            is_far: false,
            throughput: [1.0; 3],
            origin: Origin::Camera,
            sample: Sample::default(),
        };
        if !(self.layers && sample == 0) {
            path.stage = self.primary(&path);
        }
        path
    }

    /// Takes the sample as far as the answers go: to its end, or to the next ray that is blocked, or to rays that it asks
    /// of `batches`, where there are any.
    ///
    /// # Panics
    /// When the sample is finished already.
    pub(crate) fn step<T: Tracer>(
        &self,
        path: &mut Path,
        tracer: &mut T,
        mut batches: Option<&mut GBatches>,
    ) -> Step {
        loop {
            let stage = std::mem::replace(&mut path.stage, Stage::Done);
            let next = match (&stage, batches.as_deref_mut()) {
                (Stage::Layers, _) => self.layers_step(path, tracer),
                (Stage::CRay(ray), all) => self.c_ray_step(path, ray, tracer, all),
                (Stage::Met { ray, cut, found }, all) => {
                    Answer::Exact(self.c_ray_met(path, ray, behind(ray, *cut, *found), all))
                }
                (Stage::Shadow { surface, index }, Some(all)) if self.batches_g_rays() => {
                    Answer::Exact(self.ask(path, surface, [*index, 0], &mut all.asked))
                }
                (Stage::Gather { surface, index }, Some(all)) if self.batches_g_rays() => {
                    Answer::Exact(self.ask(path, surface, [self.world.n_shadow, *index], &mut all.asked))
                }
                (Stage::Shadow { surface, index }, _) => self.shadow_step(path, surface, *index, tracer),
                (Stage::Gather { surface, index }, _) => self.gather_step(path, surface, *index, tracer),
                (Stage::TakeFar { ray, far, place }, Some(all)) => {
                    let hit = self.take_far(far, *place, &all.answered);
                    Answer::Exact(self.c_ray_end(path, ray, hit))
                }
                (Stage::TakeGRays(place), Some(all)) => Answer::Exact(self.take(path, place, &all.answered)),
                (Stage::GatherRay(gather), _) => self.gather_ray_step(path, gather, tracer),
                (Stage::Bounce(surface), _) => Answer::Exact(self.bounce(path, surface)),
                (Stage::TakeFar { .. } | Stage::TakeGRays(_), None) => panic!("answers without a batch"),
                (Stage::Done, _) => panic!("a finished sample was asked again"),
            };
            match next {
                Answer::Blocked => {
                    path.stage = stage;
                    return Step::Blocked;
                }
                Answer::Exact(Stage::Done) => return Step::Done(path.sample),
                Answer::Exact(stage) => {
                    let asks = matches!(stage, Stage::TakeFar { .. } | Stage::TakeGRays(_));
                    path.stage = stage;
                    if asks {
                        return Step::Asks;
                    }
                }
            }
        }
    }

    /// The same with rays asked one by one.
    ///
    /// # Panics
    /// When the sample is finished already.
    pub fn advance<T: Tracer>(&self, path: &mut Path, tracer: &mut T) -> Answer<Sample> {
        match self.step(path, tracer, None) {
            Step::Blocked => Answer::Blocked,
            Step::Done(sample) => Answer::Exact(sample),
            Step::Asks => unreachable!("there is no batch to ask"),
        }
    }

    fn primary(&self, path: &Path) -> Stage {
        Stage::CRay(self.primary_ray(path))
    }

    /// The ray from the camera that the path begins with.
    pub(crate) fn primary_ray(&self, path: &Path) -> Ray {
        let [dx, dy, ..] = path.sampler.draw(Decision::Pixel);
        let [x, y] = path.pixel.map(f64::from);
        self.world.projection.ray(x + f64::from(dx), y + f64::from(dy))
    }

    fn layers_step<T: Tracer>(&self, path: &mut Path, tracer: &mut T) -> Answer<Stage> {
        let [x, y] = path.pixel.map(|x| f64::from(x) + 0.5);
        let ray = self.world.projection.ray(x, y);
        let Answer::Exact(hit) = self.closest_alone(&ray, path, tracer) else {
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

    fn c_ray_step<T: Tracer>(
        &self,
        path: &mut Path,
        ray: &Ray,
        tracer: &mut T,
        batches: Option<&mut GBatches>,
    ) -> Answer<Stage> {
        match self.world.method {
            Method::DebugUpper | Method::DebugOccluders => return Answer::Exact(self.voxel_shown(path, ray)),
            Method::DebugLower => return self.finest_shown(path, ray, tracer),
            _ => {}
        }
        match self.closest(ray, path, tracer) {
            Closest::Blocked => Answer::Blocked,
            closest => Answer::Exact(self.c_ray_met(path, ray, closest, batches)),
        }
    }

    /// What follows when it is known what a C-ray meets, or where.
    fn c_ray_met(
        &self,
        path: &mut Path,
        ray: &Ray,
        closest: Closest,
        batches: Option<&mut GBatches>,
    ) -> Stage {
        match (closest, batches) {
            (Closest::Known(hit), _) => self.c_ray_end(path, ray, hit),
            (Closest::Far(far), None) => self.c_ray_end(path, ray, self.far_hit(&far)),
            (Closest::Far(far), Some(batches)) => {
                Stage::TakeFar { ray: *ray, far, place: batches.asked.push_far(&far) }
            }
            (Closest::Blocked, _) => unreachable!("a blocked ray has met nothing"),
        }
    }

    /// What follows the end of a C-ray.
    fn c_ray_end(&self, path: &mut Path, ray: &Ray, hit: Option<Hit>) -> Stage {
        path.travelled += hit.map_or(0.0, |hit| hit.t);
        path.is_far = hit.is_some_and(|hit| hit.triangle == NO_ID);
        let rays = &mut path.sample.rays;
        *match path.origin {
            Origin::Camera => &mut rays.primary,
            Origin::Mirror => &mut rays.mirror,
            Origin::Scattered { .. } => &mut rays.gather,
        } += 1;
        match (self.world.method, path.origin) {
            (Method::Ao, _) => self.unlit(path, ray, hit),
            (Method::DebugPages, _) => self.page_shown(path, ray, hit),
            (_, Origin::Scattered { from, density }) => self.gathered(path, ray, hit, &from, density),
            _ => self.seen(path, ray, hit),
        }
    }

    /// The end of a ray that no light sample could have been: all that it sees counts.
    fn seen(&self, path: &mut Path, ray: &Ray, hit: Option<Hit>) -> Stage {
        let lights = &self.world.lights;
        let seen = lights.seen(ray, hit.map_or(f64::INFINITY, |hit| hit.t));
        let Some(hit) = hit.filter(|_| seen.is_none()) else {
            path.gain(seen.unwrap_or(lights.sky()));
            return Stage::Done;
        };
        let material = &self.world.materials[hit.material as usize];
        if dot(to_f64(hit.normal), ray.direction) < 0.0 {
            path.gain(material.ke);
        }
        self.lit(Surface::new(ray, &hit))
    }

    /// What follows at a surface: shadow rays, where they can bring anything.
    pub(crate) fn lit(&self, surface: Surface) -> Stage {
        let material = &self.world.materials[surface.material as usize];
        match takes_shadow_rays(material) {
            true => self.after_shadow_ray(surface, 0),
            false => Stage::Bounce(surface),
        }
    }

    /// What follows the shadow rays before number `index`.
    pub(crate) fn after_shadow_ray(&self, surface: Surface, index: u32) -> Stage {
        if index < self.world.n_shadow {
            return Stage::Shadow { surface, index };
        }
        self.after_gather_ray(surface, 0)
    }

    /// Gather rays at a surface.
    pub(crate) fn n_gather(&self) -> u32 {
        if self.world.method.gathers() { self.world.n_gather } else { 0 }
    }

    fn shadow_step<T: Tracer>(
        &self,
        path: &mut Path,
        surface: &Surface,
        index: u32,
        tracer: &mut T,
    ) -> Answer<Stage> {
        if let Some(query) = self.shadow_query(path, surface, index) {
            let Answer::Exact(occluded) = self.occluded(surface, &query, tracer) else {
                return Answer::Blocked;
            };
            self.count_shadow_ray(path);
            if !occluded {
                path.gain(query.light);
            }
        }
        Answer::Exact(self.after_shadow_ray(*surface, index + 1))
    }

    /// What shadow ray `index` asks; `None` where it could bring nothing.
    pub(crate) fn shadow_query(&self, path: &Path, surface: &Surface, index: u32) -> Option<ShadowQuery> {
        if self.world.method == Method::Ao {
            return Some(self.openness_query(path, surface, index));
        }
        let count = self.world.n_shadow;
        let u = path.sampler.draw(Decision::Light { vertex: path.vertex, index, count });
        let sample = self.world.lights.sample(&surface.receiver(&self.world.materials), u)?;
        let light = scale_rgb(1.0 / count as f32, self.scattered(surface, &sample));
        let LightSample { direction, distance, front, .. } = sample;
        (max_rgb(light) > 0.0).then_some(ShadowQuery { direction, distance, front, light })
    }

    /// Counts a shadow ray that was answered.
    pub(crate) fn count_shadow_ray(&self, path: &mut Path) {
        let rays = &mut path.sample.rays;
        *if self.world.method == Method::Ao { &mut rays.gather } else { &mut rays.shadow } += 1;
    }

    /// Whether anything stands between a surface and the place that a query names.
    fn occluded<T: Tracer>(&self, surface: &Surface, query: &ShadowQuery, tracer: &mut T) -> Answer<bool> {
        let ShadowQuery { direction, distance, front, .. } = *query;
        let Some(voxels) = &self.voxels else {
            return tracer.occluded(&surface.ray_to(direction, distance, front));
        };
        if let Some(near) = voxels.near_length(surface, direction) {
            let (end, front) = if near < distance { (near, None) } else { (distance, front) };
            match tracer.occluded(&surface.ray_to(direction, end, front)) {
                Answer::Exact(false) => {}
                answer => return answer,
            }
        }
        let on = voxels.leave(surface, direction, distance, front);
        on.map_or(Answer::Exact(false), |ray| voxels.occluded(&ray, tracer))
    }

    /// What a surface returns of a light sample that nothing stops.
    fn scattered(&self, surface: &Surface, sample: &LightSample) -> [f32; 3] {
        let material = &self.world.materials[surface.material as usize];
        let (normal, to_viewer) = (surface.normal, surface.to_viewer);
        let returned = bsdf(material, normal, to_viewer, sample.direction);
        let cos = dot(normal, sample.direction) as f32;
        let share = match self.world.method {
            Method::Path => light_share(material, surface, sample, self.world.n_shadow),
            _ => 1.0,
        };
        scale_rgb(cos * share, mul_rgb(returned, sample.weight))
    }

    fn bounce(&self, path: &mut Path, surface: &Surface) -> Stage {
        match self.world.method {
            Method::Direct | Method::Photon | Method::FullGi => self.mirror_bounce(path, surface),
            Method::Path => self.chance_bounce(path, surface),
            _ => Stage::Done,
        }
    }
}

#[cfg(test)]
#[path = "integrator_tests.rs"]
mod tests;
