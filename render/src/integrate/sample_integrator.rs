//! `SampleIntegrator`: takes samples of pixels, a ray at a time, by the integrator that the world asks for.
//!
//! A sample is a [`Path`] that asks one ray at a time. Where a ray is Blocked the path stays as it is, and the
//! next [`SampleIntegrator::advance`] asks that ray again: a retry needs the pages of ONE ray, never those of the whole
//! sample (see [`crate::trace::Retry`] for why that ends).
//!
//! Invariants: those of [`Path`].

use super::ao::AmbientOcclusion;
use super::c_ray::{CRayHit, Form};
use super::context::RenderContext;
use super::debug::{DebugPages, DebugVoxels};
use super::direct::Direct;
use super::final_gather::FullGi;
use super::g_batch::{GBatches, RayNeeds, rays_asked};
use super::g_rays::FirstRays;
use super::g_scene::GScene;
use super::lod::{Closest, behind};
use super::path::PathTracing;
use super::path_state::{Origin, Path, Sample, Stage};
use super::photon::PhotonMapping;
use super::together::Together;
use super::{CRays, Integrator};
use crate::g_stage::{GStage, GView};
use crate::sampler::{Decision, Sampler};
use crate::scene::method::Method;
use crate::stats::RayKind;
use crate::trace::{Answer, Ray, Tracer};
use glam::{DVec3, Vec3};
use trex_film::{LayerPixel, LightKey, LightPlace};
use trex_store::Material;

/// What a mirror may scatter, or give, beside what it mirrors, and show nothing but what is seen in it.
const OWN_MOST: f32 = 0.1;

/// The end of a step of a sample.
pub(crate) enum Step {
    /// The next ray waits for pages.
    Blocked,
    /// Rays are in the batch.
    Asks,
    /// The sample is what it comes to.
    Done,
}

/// The integrator that a world asks for, at work.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SampleIntegrator<'a> {
    ctx: RenderContext<'a>,
    integrator: &'static dyn Integrator,
}

/// The integrator of a method, or of its preview.
fn integrator(method: Method, is_preview: bool) -> &'static dyn Integrator {
    match method {
        method if is_preview && !method.has_own_preview() => &Direct,
        Method::Direct => &Direct,
        Method::Path => &PathTracing,
        Method::Ao => &AmbientOcclusion,
        Method::Photon => &PhotonMapping,
        Method::FullGi => &FullGi,
        Method::DebugUpper | Method::DebugOccluders => &DebugVoxels(CRays::Upper),
        Method::DebugLower => &DebugVoxels(CRays::Finest),
        Method::DebugPages => &DebugPages,
    }
}

impl<'a> SampleIntegrator<'a> {
    /// The integrator that the world of `ctx` asks for.
    pub(crate) fn new(ctx: RenderContext<'a>) -> SampleIntegrator<'a> {
        SampleIntegrator { ctx, integrator: integrator(ctx.world.settings.integrator, ctx.is_preview) }
    }

    /// A new sample of `pixel` (x, y).
    pub(crate) fn start(&self, pixel: [u32; 2], sample: u32) -> Path {
        let sampler = Sampler::new(self.ctx.world.settings.seed, pixel, sample);
        let shows_layers = self.ctx.has_layers && sample == 0;
        let stage = if shows_layers { Stage::Layers } else { Stage::CRay(self.primary_ray(pixel, &sampler)) };
        let keeps_seen = self.ctx.judges_preview && sample == 0 && !shows_layers;
        Path { keeps_seen, ..Path::new(pixel, sampler, stage) }
    }

    /// The sample of `pixel` (x, y) in a preview: together with those around it a set that is stratified, as the
    /// samples of one pixel are.
    pub(crate) fn start_preview(&self, pixel: [u32; 2]) -> Path {
        let seed = self.ctx.world.settings.seed.wrapping_add(self.ctx.previews_before.into());
        let sampler = Sampler::among(seed, pixel);
        let stage = Stage::CRay(self.primary_ray(pixel, &sampler));
        Path { keeps_seen: true, ..Path::new(pixel, sampler, stage) }
    }

    /// Traces the rays from the camera of a tile's paths together. A path whose ray is blocked stays as it is, and is
    /// told so.
    pub(crate) fn meet_together<'p, T: Tracer>(
        &self,
        paths: impl Iterator<Item = (&'p mut Path, &'p mut bool)>,
        tracer: &mut T,
        together: &mut Together,
    ) {
        if self.integrator.c_rays() == CRays::Mesh {
            self.ctx.meet_together(paths, tracer, together);
        }
    }

    /// Most rays that a sample asks for at a time.
    pub(crate) fn rays_asked(&self) -> RayNeeds {
        rays_asked(&self.ctx.world.settings)
    }

    /// How rays see the voxels; `None` for a model without.
    pub(crate) fn g_view(&self) -> Option<GView> {
        self.ctx.voxels.as_ref().map(GScene::view)
    }

    /// Takes the sample as far as the answers go: to its end, or to the next ray that is blocked, or to rays that it
    /// asks of `batches`.
    ///
    /// # Panics
    /// When the sample is finished already.
    pub(crate) fn step<T: Tracer>(&self, path: &mut Path, tracer: &mut T, batches: &mut GBatches) -> Step {
        loop {
            match self.next(path, tracer, batches) {
                Answer::Blocked => {
                    match &path.stage {
                        Stage::TakeGRays(place) => path.stage = self.ctx.ask_again(place),
                        Stage::TakeShown { ray, .. } => path.stage = Stage::CRay(*ray),
                        _ => {}
                    }
                    return Step::Blocked;
                }
                Answer::Exact(Stage::Done) => {
                    path.stage = Stage::Done;
                    return Step::Done;
                }
                Answer::Exact(stage) => {
                    path.stage = stage;
                    if path.stage.asks() {
                        return Step::Asks;
                    }
                }
            }
        }
    }

    /// The stage after that of `path`, which stays in place: of a path that was blocked it is to be asked again.
    fn next<T: Tracer>(&self, path: &mut Path, tracer: &mut T, batches: &mut GBatches) -> Answer<Stage> {
        let (ctx, integrator) = (&self.ctx, self.integrator);
        Answer::Exact(match path.stage {
            Stage::Layers => return self.layers_step(path, tracer, batches),
            Stage::CRay(ray) => return self.c_ray_step(path, &ray, tracer, batches),
            Stage::Met { ray, cut, found } => self.c_ray_met(path, &ray, behind(&ray, cut, found), batches),
            Stage::Shadow { surface, index } => {
                let first = FirstRays { surface: &surface, shadow: index, gather: 0 };
                return ctx.ask(integrator, path, first, (batches, tracer));
            }
            Stage::Gather { surface, index } if ctx.g_scene().is_some() => {
                let first = FirstRays { surface: &surface, shadow: ctx.n_shadow(), gather: index };
                return ctx.ask(integrator, path, first, (batches, tracer));
            }
            Stage::Gather { surface, index } => ctx.gather_step(path, &surface, index),
            Stage::TakeFar { ray, far } => self.c_ray_end(path, &ray, ctx.far_hit(&far, batches)),
            Stage::TakeLayer(far) => self.layers_end(path, ctx.far_hit(&far, batches)),
            Stage::TakeShown { place, .. } => {
                return ctx.take_shown(path, batches.answered.answer(place));
            }
            Stage::TakeGRays(ref place) => {
                let place = place.clone();
                return ctx.take(integrator, path, &place, batches);
            }
            Stage::GatherRay(gather) => return ctx.gather_ray_step(path, &gather, tracer),
            Stage::Bounce(surface) => integrator.bounce(ctx, path, &surface),
            Stage::Done => panic!("a finished sample was asked again"),
        })
    }

    /// Takes the sample as far as the answers go, with rays asked one by one: in batches of one, which `g_stage`
    /// answers, where there are voxels.
    ///
    /// # Panics
    /// When the sample is finished already.
    pub(crate) fn advance<T: Tracer>(
        &self,
        path: &mut Path,
        tracer: &mut T,
        g_stage: &dyn GStage,
    ) -> Answer<Sample> {
        let mut batches = GBatches::of_one();
        loop {
            match self.step(path, tracer, &mut batches) {
                Step::Blocked => return Answer::Blocked,
                Step::Done => return Answer::Exact(path.sample),
                Step::Asks => {
                    batches.turn(tracer);
                    batches.ask_stage((g_stage, self.g_view()), tracer);
                }
            }
        }
    }

    /// The ray from the camera that a sample of `pixel` begins with.
    fn primary_ray(&self, pixel: [u32; 2], sampler: &Sampler) -> Ray {
        let [dx, dy, ..] = sampler.draw(Decision::Pixel);
        let [x, y] = pixel.map(f64::from);
        self.ctx.world.projection.ray(x + f64::from(dx), y + f64::from(dy))
    }

    fn layers_step<T: Tracer>(
        &self,
        path: &mut Path,
        tracer: &mut T,
        batches: &mut GBatches,
    ) -> Answer<Stage> {
        let [x, y] = path.pixel.map(|x| f64::from(x) + 0.5);
        let ray = self.ctx.world.projection.ray(x, y);
        Answer::Exact(match self.ctx.closest(&ray, path, tracer) {
            Closest::Blocked => return Answer::Blocked,
            Closest::Known(hit) => self.layers_end(path, hit),
            Closest::Far(far) => Stage::TakeLayer(self.ctx.ask_far(far, batches)),
        })
    }

    /// The stage after the ray through the pixel's centre.
    fn layers_end(&self, path: &mut Path, hit: Option<CRayHit>) -> Stage {
        path.sample.rays.count(RayKind::Primary);
        let [x, y] = path.pixel.map(|x| f64::from(x) + 0.5);
        path.sample.layers = Some(self.layer_pixel(&self.ctx.world.projection.ray(x, y), hit, 0.0));
        Stage::CRay(self.primary_ray(path.pixel, &path.sampler))
    }

    /// What the layers show where a `ray` has ended, which begins so far from the camera.
    fn layer_pixel(&self, ray: &Ray, hit: Option<CRayHit>, before: f64) -> LayerPixel {
        let Some(hit) = hit else { return LayerPixel::NOTHING };
        let material = &self.ctx.world.materials[hit.point.material as usize];
        let own = Vec3::from(material.ks) + Vec3::from(material.ke);
        // A lamp is a surface of its own, whose light is smoothed with no other's.
        let albedo = (hit.point.colour * Vec3::from(material.kd) + own).min(Vec3::ONE).to_array();
        let distance = before + hit.point.t;
        let (depth, normal) = (distance as f32, hit.point.shading_normal.to_array());
        let light_key = LightKey::new(&self.light_place(ray, &hit, material, distance));
        LayerPixel { depth, normal, albedo, id: hit.layer_id(), light_key }
    }

    /// Keeps what is seen where a `ray` of a path from the camera, over mirrors or not, has ended: a mirror that
    /// hardly scatters shows what is seen in it, as far away as light has come.
    fn keep_seen(&self, path: &mut Path, ray: &Ray, hit: Option<CRayHit>) {
        let seen = self.layer_pixel(ray, hit, path.travelled - hit.map_or(0.0, |hit| hit.point.t));
        let albedo = (path.throughput * Vec3::from(seen.albedo)).to_array();
        path.sample.layers = Some(LayerPixel { albedo, ..seen });
        path.keeps_seen = hit.is_some_and(|hit| {
            let Material { kd, ke, ks, mirror, .. } = self.ctx.world.materials[hit.point.material as usize];
            let own = Vec3::from(kd).max_element() + Vec3::from(ke).max_element();
            mirror && own <= OWN_MOST * Vec3::from(ks).min_element()
        });
    }

    /// What light is kept of where a `ray` has met `material`, at a distance from the camera: of the side that it sees.
    fn light_place(&self, ray: &Ray, hit: &CRayHit, material: &Material, distance: f64) -> LightPlace {
        let direction = DVec3::from(ray.direction);
        let normal = hit.point.shading_normal.as_dvec3();
        let is_outside = direction.dot(hit.point.normal.as_dvec3()) <= 0.0;
        LightPlace {
            place: (DVec3::from(ray.origin) + hit.point.t * direction).to_array(),
            normal: if is_outside { normal } else { -normal }.to_array(),
            pixel_width: distance * self.ctx.world.projection.pixel_angle(),
            is_voxel: hit.form == Form::Voxel,
            seen_from: material.is_glossy().then(|| (-direction).to_array()),
        }
    }

    fn c_ray_step<T: Tracer>(
        &self,
        path: &mut Path,
        ray: &Ray,
        tracer: &mut T,
        batches: &mut GBatches,
    ) -> Answer<Stage> {
        let c_rays = self.integrator.c_rays();
        if c_rays != CRays::Mesh {
            return Answer::Exact(self.ctx.ask_shown(ray, c_rays, &mut batches.asked));
        }
        match self.ctx.closest(ray, path, tracer) {
            Closest::Blocked => Answer::Blocked,
            closest => Answer::Exact(self.c_ray_met(path, ray, closest, batches)),
        }
    }

    /// The stage once it is known what a C-ray meets, or where.
    fn c_ray_met(&self, path: &mut Path, ray: &Ray, closest: Closest, batches: &mut GBatches) -> Stage {
        match closest {
            Closest::Known(hit) => self.c_ray_end(path, ray, hit),
            Closest::Far(far) => Stage::TakeFar { ray: *ray, far: self.ctx.ask_far(far, batches) },
            Closest::Blocked => unreachable!("a blocked ray has met nothing"),
        }
    }

    /// The stage after the end of a C-ray.
    fn c_ray_end(&self, path: &mut Path, ray: &Ray, hit: Option<CRayHit>) -> Stage {
        path.travelled += hit.map_or(0.0, |hit| hit.point.t);
        path.is_far = hit.is_some_and(|hit| hit.form == Form::Voxel);
        path.sample.rays.count(path.origin.ray_kind());
        path.sample.meets_model |= path.vertex == 0 && hit.is_some();
        if path.keeps_seen && !matches!(path.origin, Origin::Scattered { .. }) {
            self.keep_seen(path, ray, hit);
        }
        self.integrator.c_ray_end(&self.ctx, path, ray, hit)
    }
}
