//! `RenderContext`: what integrators share: the world, the voxels and photons that answer for it, and the steps that
//! most of them take at a surface.

use super::c_ray::CRayHit;
use super::g_scene::GScene;
use super::path_state::{Origin, Path, ShadowQuery, Stage};
use crate::photon::irradiance::Irradiance;
use crate::photon::kd_tree::PhotonTree;
use crate::sampler::Decision;
use crate::scene::method::{Method, Near, Shadows};
use crate::scene::settings::RenderKeys;
use crate::scene::world::{Model, World};
use crate::shading::bsdf::{Bsdf, takes_shadow_rays};
use crate::shading::light::{LightSample, SkyBy};
use crate::shading::surface::SurfaceInteraction;
use crate::trace::Ray;
use crate::voxel::{MissingUnits, Occluders};
use glam::{DVec3, Vec3};
use trex_film::Layers;
use trex_store::Material;

/// The share of a light sample, one of so many, that counts beside other ways to find its light.
pub(super) type MisWeight = fn(&Bsdf<'_>, &LightSample, u32) -> f32;

/// All that the integrators of a picture read.
#[derive(Clone, Copy, Debug)]
pub(crate) struct RenderContext<'a> {
    pub(crate) world: &'a World,
    /// The voxels of the model: for G-rays, for C-rays behind the cut, and for previews; `None` for a model without.
    pub(crate) voxels: Option<GScene<'a>>,
    /// The photons of `full-gi`; without, surfaces are dark to gather rays.
    pub(crate) photon_tree: Option<&'a PhotonTree>,
    /// True when the first sample of each pixel also says what its centre shows.
    pub(crate) has_layers: bool,
    /// True when it says what its ray met, where it does not say that: a preview is to be judged by it.
    pub(crate) judges_preview: bool,
    /// Most rays of a kind that leave a surface, whatever the settings say.
    rays_most: u32,
    /// True when nothing waits for pages: where one is missing, the resident voxels answer; without any, it is empty.
    pub(super) is_preview: bool,
    /// Previews before this one whose light is carried on: each has other random numbers.
    pub(super) previews_before: u32,
}

impl<'a> RenderContext<'a> {
    /// The context of `world`, which was made from `model`, with light in the voxels as `irradiance` has it.
    pub(crate) fn new(world: &'a World, model: &'a Model, irradiance: Irradiance<'a>) -> RenderContext<'a> {
        let RenderKeys { integrator: method, occluders, near, shadows, .. } = *world.settings;
        let is_cubes = matches!(method, Method::DebugUpper | Method::DebugLower);
        let occluders = if is_cubes && !world.parts.hides_any() { Occluders::Off } else { occluders };
        let answers_g_rays = method.asks_voxels();
        let voxels = model.voxels.as_ref().map(|voxels| {
            let lower = voxels.lower_scene(occluders).filter(|_| answers_g_rays);
            let shadows = match method {
                Method::Photon => shadows,
                // Of a preview alone, whose picture will have those of the mesh.
                method if !method.asks_voxels() => Shadows::Mesh,
                _ => Shadows::Voxel,
            };
            let parts = &*world.parts;
            GScene {
                voxels: voxels.scene(occluders),
                lower,
                irradiance,
                near,
                shadows,
                answers_g_rays,
                parts,
            }
        });
        RenderContext { voxels, ..RenderContext::from_mesh(world) }
    }

    /// The context of `world` with its mesh alone.
    pub(crate) fn from_mesh(world: &'a World) -> RenderContext<'a> {
        RenderContext {
            world,
            voxels: None,
            photon_tree: None,
            has_layers: false,
            judges_preview: false,
            rays_most: u32::MAX,
            is_preview: false,
            previews_before: 0,
        }
    }

    /// This context for a picture at once: at most one G-ray of a kind leaves a surface, and nothing waits for pages:
    /// where a unit is missing, the voxel above it answers, and where a page is, the voxels.
    pub(crate) fn for_preview(self, previews_before: u32) -> RenderContext<'a> {
        let resident = |scene: GScene<'a>| {
            let lower = scene.lower.map(|lower| lower.on_missing(MissingUnits::StandIn));
            GScene { lower, near: Near::Voxel, answers_g_rays: true, ..scene }
        };
        let voxels = self.voxels.map(resident);
        RenderContext {
            voxels,
            photon_tree: None,
            has_layers: false,
            rays_most: 1,
            is_preview: true,
            previews_before,
            ..self
        }
    }

    /// This context, with what the layers of a film take.
    pub(crate) fn with_layers(self, layers: Layers) -> RenderContext<'a> {
        RenderContext { has_layers: layers.any() || layers.filter, ..self }
    }

    /// This context, beside a preview on show.
    pub(crate) fn beside_preview(self) -> RenderContext<'a> {
        RenderContext { judges_preview: true, ..self }
    }

    /// This context, with the photons of `full-gi`.
    pub(crate) fn with_photon_tree(self, photon_tree: Option<&'a PhotonTree>) -> RenderContext<'a> {
        RenderContext { photon_tree, ..self }
    }

    /// Material of `surface`.
    pub(super) fn material(&self, surface: &SurfaceInteraction) -> &'a Material {
        &self.world.materials[surface.material as usize]
    }

    /// The voxels, where they answer G-rays; without, the mesh does.
    pub(super) fn g_scene(&self) -> Option<&GScene<'a>> {
        self.voxels.as_ref().filter(|scene| scene.answers_g_rays)
    }

    /// Count of shadow rays at a surface.
    pub(super) fn n_shadow(&self) -> u32 {
        self.world.settings.n_shadow.min(self.rays_most)
    }

    /// Count of gather rays at a surface.
    pub(super) fn n_gather(&self) -> u32 {
        let settings = &self.world.settings;
        // A preview gathers from voxels alone, where light is only kept for `photon`.
        let finds_light = |scene: &GScene<'_>| !scene.irradiance.is_none();
        let gathers = !self.is_preview || self.voxels.as_ref().is_some_and(finds_light);
        if gathers && settings.integrator.gathers() { settings.n_gather.min(self.rays_most) } else { 0 }
    }

    /// The stage after a ray that no light sample could have been: all that it sees counts.
    pub(super) fn seen(&self, path: &mut Path, ray: &Ray, hit: Option<CRayHit>) -> Stage {
        let lights = &self.world.lights;
        let seen = lights.seen(ray, hit.map_or(f64::INFINITY, |hit| hit.point.t));
        let Some(hit) = hit.filter(|_| seen.is_none()) else {
            path.gain(seen.unwrap_or(lights.sky()));
            return Stage::Done;
        };
        let material = &self.world.materials[hit.point.material as usize];
        if hit.point.normal.as_dvec3().dot(DVec3::from(ray.direction)) < 0.0 {
            path.gain(Vec3::from(material.ke));
        }
        self.lit(SurfaceInteraction::new(ray, &hit.point))
    }

    /// The stage after a surface is met: shadow rays, where they can bring anything.
    pub(super) fn lit(&self, surface: SurfaceInteraction) -> Stage {
        match takes_shadow_rays(self.material(&surface)) {
            true => self.after_shadow_ray(surface, 0),
            false => Stage::Bounce(surface),
        }
    }

    /// The stage after the shadow rays before number `index`.
    pub(super) fn after_shadow_ray(&self, surface: SurfaceInteraction, index: u32) -> Stage {
        if index < self.n_shadow() {
            return Stage::Shadow { surface, index };
        }
        self.after_gather_ray(surface, 0)
    }

    /// The stage after the gather rays before number `index`.
    pub(super) fn after_gather_ray(&self, surface: SurfaceInteraction, index: u32) -> Stage {
        if index < self.n_gather() { Stage::Gather { surface, index } } else { Stage::Bounce(surface) }
    }

    /// Shadow ray `index` towards a light; `None` where it could bring nothing.
    pub(super) fn light_query(
        &self,
        path: &Path,
        surface: &SurfaceInteraction,
        index: u32,
        mis_weight: MisWeight,
    ) -> Option<ShadowQuery> {
        let count = self.n_shadow();
        let u = path.sampler.draw(Decision::Light { vertex: path.vertex, index, count });
        let point = surface.shading_point(&self.world.materials);
        let sky_by = if self.n_gather() > 0 { SkyBy::GatherRays } else { SkyBy::LightSamples };
        let sample = self.world.lights.sample(&point, sky_by, u)?;
        let cos = surface.normal.dot(sample.wi) as f32;
        let weight = cos * mis_weight(&point.bsdf, &sample, count);
        let returned = weight * (point.bsdf.eval(sample.wi) * sample.weight);
        let light = 1.0 / count as f32 * returned;
        let LightSample { wi, distance, front, .. } = sample;
        (light.max_element() > 0.0).then_some(ShadowQuery { direction: wi, distance, front, light })
    }

    /// The mirror ray, if the surface is a mirror. All of its reflectance goes with it, so that without roulette a
    /// picture of mirrors has no noise.
    pub(super) fn mirror_bounce(&self, path: &mut Path, surface: &SurfaceInteraction) -> Stage {
        let material = self.material(surface);
        if !material.mirror {
            return Stage::Done;
        }
        path.throughput *= Vec3::from(material.ks);
        if !path.survives(true) {
            return Stage::Done;
        }
        path.vertex += 1;
        path.origin = Origin::Mirror;
        Stage::CRay(surface.ray_to(surface.mirrored(), f64::INFINITY, None))
    }
}
