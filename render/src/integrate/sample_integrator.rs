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
use super::g_batch::{GBatches, rays_asked};
use super::g_rays::FirstRays;
use super::lod::{Closest, behind};
use super::path::PathTracing;
use super::path_state::{Origin, Path, Sample, ShadowQuery, Stage};
use super::photon::PhotonMapping;
use super::together::Together;
use super::{CRays, Integrator};
use crate::g_stage::CpuStage;
use crate::image::film::LayerPixel;
use crate::sampler::{Decision, Sampler};
use crate::scene::method::Method;
use crate::shading::surface::SurfaceInteraction;
use crate::stats::RayKind;
use crate::trace::{Answer, Ray, Tracer};
use glam::Vec3;

/// The end of a step of a sample.
pub(crate) enum Step {
    /// The next ray waits for pages.
    Blocked,
    /// Rays are in the batch.
    Asks,
    Done(Sample),
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
        let mut path = self.path(pixel, sampler);
        if self.ctx.has_layers && sample == 0 {
            path.stage = Stage::Layers;
        }
        path
    }

    /// The sample of `pixel` (x, y) in a preview: together with those around it a set that is stratified, as the
    /// samples of one pixel are.
    pub(crate) fn start_preview(&self, pixel: [u32; 2]) -> Path {
        self.path(pixel, Sampler::among(self.ctx.world.settings.seed, pixel))
    }

    fn path(&self, pixel: [u32; 2], sampler: Sampler) -> Path {
        let mut path = Path {
            pixel,
            sampler,
            stage: Stage::Done,
            vertex: 0,
            travelled: 0.0,
            is_far: false,
            throughput: Vec3::ONE,
            origin: Origin::Camera,
            sample: Sample::default(),
        };
        path.stage = Stage::CRay(self.primary_ray(&path));
        path
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
    pub(crate) fn rays_asked(&self) -> usize {
        rays_asked(&self.ctx.world.settings)
    }

    /// True when any rays are asked in batches.
    pub(crate) fn has_batches(&self) -> bool {
        self.ctx.voxels.is_some()
    }

    /// The G-stage on the processor for what is asked here; `None` where nothing is.
    pub(crate) fn cpu_stage(&self) -> Option<CpuStage<'a>> {
        self.ctx.voxels.as_ref().map(|scene| CpuStage::new(scene.voxels, scene.lower))
    }

    /// Takes the sample as far as the answers go: to its end, or to the next ray that is blocked, or to rays that it
    /// asks of `batches`, where there are any.
    ///
    /// # Panics
    /// When the sample is finished already.
    pub(crate) fn step<T: Tracer>(
        &self,
        path: &mut Path,
        tracer: &mut T,
        mut batches: Option<&mut GBatches>,
    ) -> Step {
        let (ctx, integrator) = (&self.ctx, self.integrator);
        loop {
            let stage = std::mem::replace(&mut path.stage, Stage::Done);
            let next = match (&stage, batches.as_deref_mut()) {
                (Stage::Layers, _) => self.layers_step(path, tracer),
                (Stage::CRay(ray), all) => self.c_ray_step(path, ray, tracer, all),
                (Stage::Met { ray, cut, found }, all) => {
                    Answer::Exact(self.c_ray_met(path, ray, behind(ray, *cut, *found), all))
                }
                (Stage::Shadow { surface, index }, Some(all)) if ctx.batches_g_rays() => {
                    let first = FirstRays { surface, shadow: *index, gather: 0 };
                    Answer::Exact(ctx.ask(integrator, path, first, &mut all.asked))
                }
                (Stage::Gather { surface, index }, Some(all)) if ctx.batches_g_rays() => {
                    let shadow = ctx.n_shadow();
                    let first = FirstRays { surface, shadow, gather: *index };
                    Answer::Exact(ctx.ask(integrator, path, first, &mut all.asked))
                }
                (Stage::Shadow { surface, index }, _) => self.shadow_step(path, surface, *index, tracer),
                (Stage::Gather { surface, index }, _) => ctx.gather_step(path, surface, *index, tracer),
                (Stage::TakeFar { ray, far, place }, Some(all)) => {
                    let voxels = &ctx.voxels.as_ref().expect("batches have voxels").voxels;
                    let hit = far.hit(voxels, all.answered.far_answer(*place));
                    Answer::Exact(self.c_ray_end(path, ray, hit))
                }
                (Stage::TakeGRays(place), Some(all)) => {
                    match ctx.take(integrator.shadow_kind(), path, (place, &all.answered), tracer) {
                        Answer::Blocked => {
                            path.stage = ctx.ask_again(place);
                            return Step::Blocked;
                        }
                        stage => stage,
                    }
                }
                (Stage::GatherRay(gather), _) => ctx.gather_ray_step(path, gather, tracer),
                (Stage::Bounce(surface), _) => Answer::Exact(integrator.bounce(ctx, path, surface)),
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

    /// Takes the sample as far as the answers go, with rays asked one by one.
    ///
    /// # Panics
    /// When the sample is finished already.
    pub(crate) fn advance<T: Tracer>(&self, path: &mut Path, tracer: &mut T) -> Answer<Sample> {
        match self.step(path, tracer, None) {
            Step::Blocked => Answer::Blocked,
            Step::Done(sample) => Answer::Exact(sample),
            Step::Asks => unreachable!("there is no batch to ask"),
        }
    }

    /// The ray from the camera that the path begins with.
    fn primary_ray(&self, path: &Path) -> Ray {
        let [dx, dy, ..] = path.sampler.draw(Decision::Pixel);
        let [x, y] = path.pixel.map(f64::from);
        self.ctx.world.projection.ray(x + f64::from(dx), y + f64::from(dy))
    }

    fn layers_step<T: Tracer>(&self, path: &mut Path, tracer: &mut T) -> Answer<Stage> {
        let [x, y] = path.pixel.map(|x| f64::from(x) + 0.5);
        let ray = self.ctx.world.projection.ray(x, y);
        let Answer::Exact(hit) = self.ctx.closest_alone(&ray, path, tracer) else {
            return Answer::Blocked;
        };
        path.sample.rays.count(RayKind::Primary);
        path.sample.layers = Some(self.layer_pixel(hit));
        Answer::Exact(Stage::CRay(self.primary_ray(path)))
    }

    /// What the layers show where a ray from the camera has ended.
    fn layer_pixel(&self, hit: Option<CRayHit>) -> LayerPixel {
        let Some(hit) = hit else { return LayerPixel::NOTHING };
        let material = &self.ctx.world.materials[hit.point.material as usize];
        let albedo = (Vec3::from(material.kd) + Vec3::from(material.ks)).to_array();
        let (depth, normal) = (hit.point.t as f32, hit.point.normal.to_array());
        LayerPixel { depth, normal, albedo, id: hit.layer_id() }
    }

    fn c_ray_step<T: Tracer>(
        &self,
        path: &mut Path,
        ray: &Ray,
        tracer: &mut T,
        batches: Option<&mut GBatches>,
    ) -> Answer<Stage> {
        match self.integrator.c_rays() {
            CRays::Upper => return Answer::Exact(self.ctx.upper_shown(path, ray)),
            CRays::Finest => return self.ctx.finest_shown(path, ray, tracer),
            CRays::Mesh => {}
        }
        match self.ctx.closest(ray, path, tracer) {
            Closest::Blocked => Answer::Blocked,
            closest => Answer::Exact(self.c_ray_met(path, ray, closest, batches)),
        }
    }

    /// The stage once it is known what a C-ray meets, or where.
    fn c_ray_met(
        &self,
        path: &mut Path,
        ray: &Ray,
        closest: Closest,
        batches: Option<&mut GBatches>,
    ) -> Stage {
        match (closest, batches) {
            (Closest::Known(hit), _) => self.c_ray_end(path, ray, hit),
            (Closest::Far(far), None) => self.c_ray_end(path, ray, self.ctx.far_hit(&far)),
            (Closest::Far(far), Some(batches)) => {
                Stage::TakeFar { ray: *ray, far, place: batches.asked.push_far(&far) }
            }
            (Closest::Blocked, _) => unreachable!("a blocked ray has met nothing"),
        }
    }

    /// The stage after the end of a C-ray.
    fn c_ray_end(&self, path: &mut Path, ray: &Ray, hit: Option<CRayHit>) -> Stage {
        path.travelled += hit.map_or(0.0, |hit| hit.point.t);
        path.is_far = hit.is_some_and(|hit| hit.form == Form::Voxel);
        path.sample.rays.count(path.origin.ray_kind());
        path.sample.meets_model |= path.vertex == 0 && hit.is_some();
        if self.ctx.is_preview && path.vertex == 0 {
            path.sample.layers = Some(self.layer_pixel(hit));
        }
        self.integrator.c_ray_end(&self.ctx, path, ray, hit)
    }

    fn shadow_step<T: Tracer>(
        &self,
        path: &mut Path,
        surface: &SurfaceInteraction,
        index: u32,
        tracer: &mut T,
    ) -> Answer<Stage> {
        if let Some(query) = self.integrator.shadow_query(&self.ctx, path, surface, index) {
            let Answer::Exact(occluded) = self.occluded(surface, &query, tracer) else {
                return Answer::Blocked;
            };
            path.sample.rays.count(self.integrator.shadow_kind());
            if !occluded {
                path.gain(query.light);
            }
        }
        Answer::Exact(self.ctx.after_shadow_ray(*surface, index + 1))
    }

    /// Answers whether anything stands between a surface and the place that a query names.
    fn occluded<T: Tracer>(
        &self,
        surface: &SurfaceInteraction,
        query: &ShadowQuery,
        tracer: &mut T,
    ) -> Answer<bool> {
        let ShadowQuery { direction, distance, front, .. } = *query;
        let Some(voxels) = self.ctx.g_scene() else {
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
}
