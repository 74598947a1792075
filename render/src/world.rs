//! `World`: what an integrator may read. Built from a model and the edits of a scene, never changed by rendering.
//!
//! Invariant: every material is checked, every emitter has a material, the camera has rays.

use crate::camera::{Camera, Projection, up_axis};
use crate::emitter::Emitter;
use crate::integrator::Method;
use crate::light::{Light, Lights, SkyBy};
use crate::photon_tree::TREE_PHOTONS_MAX;
use crate::voxel::{Near, Occluders, Voxels};
use std::sync::Arc;
use trex_store::{Aabb, Code, Error, Material, Result};

/// Most shadow rays at one path vertex.
pub const N_SHADOW_MAX: u32 = 4096;
/// Most gather rays at one surface point.
pub const N_GATHER_MAX: u32 = 4096;
/// Greatest error of the footprint rule.
pub const LOD_ERROR_MAX_PIXELS: f64 = 1024.0;
/// Most photons.
pub const PHOTONS_MAX: u64 = 1 << 40;
/// Most names of materials that a message lists.
const NAMES_SHOWN: usize = 8;

/// What the renderer is told of a model beside the rays' answers.
#[derive(Clone, Debug)]
pub struct Model {
    /// Box around all triangles, model units.
    pub bounds: Aabb,
    /// The materials, in the order that hits name them.
    pub materials: Vec<Material>,
    /// The triangles whose material gives light.
    pub emitters: Vec<Emitter>,
    /// The second form of the model, which G-rays ask; `None` for a file without.
    pub voxels: Option<Arc<Voxels>>,
}

/// How G-rays work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GRays {
    /// Gather rays at a surface point, 0 (no indirect light) to [`N_GATHER_MAX`].
    pub n_gather: u32,
    /// Photons in all, 1 to [`PHOTONS_MAX`].
    pub photons: u64,
    /// How rays leave a surface.
    pub near: Near,
    /// Whether bitmaps count.
    pub occluders: Occluders,
    /// Photons of a look-up of `full-gi`, [`crate::photon_tree::K_NEAREST_MIN`] to
    /// [`crate::photon_tree::K_NEAREST_MAX`].
    pub k_nearest: u32,
    /// Whether the photons of `photon` go through the exact mesh.
    pub bake: bool,
}

impl Default for GRays {
    fn default() -> GRays {
        GRays {
            n_gather: 2,
            photons: 1 << 21,
            near: Near::Voxel,
            occluders: Occluders::On,
            // H. W. Jensen's own number for pictures with final gathering.
            k_nearest: 50,
            bake: false,
        }
    }
}

/// Changes to one material; what is `None` stays.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MaterialEdit {
    /// Diffuse reflectance, linear RGB.
    pub kd: Option<[f32; 3]>,
    /// Specular reflectance, linear RGB.
    pub ks: Option<[f32; 3]>,
    /// Phong exponent.
    pub ns: Option<f32>,
    /// Radiance that leaves the counter-clockwise side.
    pub ke: Option<[f32; 3]>,
    /// Whether the surface is a perfect mirror (with reflectance `ks`).
    pub mirror: Option<bool>,
}

/// Camera, lights, materials and the numbers that make a picture out of them.
#[derive(Clone, Debug)]
pub struct World {
    /// Makes the rays of the picture.
    pub projection: Projection,
    /// All that gives light.
    pub lights: Lights,
    /// Checked materials, as hits name them.
    pub materials: Vec<Material>,
    /// Shadow rays at a path vertex.
    pub n_shadow: u32,
    /// Gather rays at a surface point.
    pub n_gather: u32,
    /// Photons of a look-up of `full-gi`.
    pub k_nearest: u32,
    /// Names the random numbers.
    pub seed: u64,
    /// How light is computed.
    pub method: Method,
    /// Length of the rays of `ao`, model units: half of the model's diagonal.
    pub ao_radius: f64,
    /// Length of the way from the camera from which voxels answer C-rays, model units; infinite for the exact mesh.
    pub voxels_from: f64,
}

/// What a [`World`] is built from, beside the model.
#[derive(Clone, Debug)]
pub struct View {
    /// The camera.
    pub camera: Camera,
    /// Width and height, pixels.
    pub resolution: [u32; 2],
    /// Lights of the scene.
    pub lights: Vec<Light>,
    /// Shadow rays at a path vertex, 0 (no direct light) to [`N_SHADOW_MAX`].
    pub n_shadow: u32,
    /// Names the random numbers.
    pub seed: u64,
    /// How light is computed.
    pub method: Method,
    /// How G-rays work; for methods that have any.
    pub g_rays: GRays,
    /// The footprint rule: pixels that a leaf voxel may cover where it stands for the mesh; 0 for the exact mesh, 0 to
    /// [`LOD_ERROR_MAX_PIXELS`].
    pub lod_error_pixels: f64,
}

impl Model {
    /// Changes the material with index `material`.
    ///
    /// # Errors
    /// [`Code::SceneFormat`], at the material's name: no such index; light from a material whose triangles the
    /// store does not keep as emitters.
    pub fn edit(&mut self, material: usize, edit: &MaterialEdit) -> Result<()> {
        let count = self.materials.len();
        let Some(old) = self.materials.get(material) else {
            return Err(Error::new(Code::SceneFormat, "no such material")
                .at_place(format!("material {material}"))
                .numbers(format!("the model has {count}"))
                .next("ask `trex info` for the materials of the model"));
        };
        let MaterialEdit { kd, ks, ns, ke, mirror } = *edit;
        let new = Material {
            name: old.name.clone(),
            kd: kd.unwrap_or(old.kd),
            ks: ks.unwrap_or(old.ks),
            ns: ns.unwrap_or(old.ns),
            ke: ke.unwrap_or(old.ke),
            d: old.d,
            mirror: mirror.unwrap_or(old.mirror),
        }
        .checked();
        let kept = || self.emitters.iter().any(|emitter| emitter.material as usize == material);
        if new.emits() && !old.emits() && !kept() {
            return Err(Error::new(Code::SceneFormat, "this material cannot be made to give light")
                .at_place(format!("material.{:?}.ke", old.name))
                .numbers("the store keeps no emitters of it, since its Ke was 0 when it was built")
                .next("give it a Ke in the MTL file and build again, or add a [[light]]"));
        }
        self.materials[material] = new;
        Ok(())
    }

    /// Index of the material called `name`.
    ///
    /// # Errors
    /// [`Code::SceneFormat`], with names that exist.
    pub fn material_index(&self, name: &str) -> Result<usize> {
        self.materials.iter().position(|material| material.name == name).ok_or_else(|| {
            let names: Vec<_> = self.materials.iter().take(NAMES_SHOWN).map(|m| m.name.as_str()).collect();
            Error::new(Code::SceneFormat, "the model has no material of this name")
                .at_place(format!("material.{name:?}"))
                .numbers(format!("{} materials: {}", self.materials.len(), names.join(", ")))
                .next("use one of these names, or `trex info` for all of them")
        })
    }
}

impl World {
    /// # Errors
    /// [`Code::SceneFormat`]: a camera without rays, a light that makes no sense, `n_shadow` out of range.
    ///
    /// # Panics
    /// When an emitter of the model names a material that is not there.
    pub fn new(model: &Model, view: &View) -> Result<World> {
        if view.n_shadow > N_SHADOW_MAX {
            return Err(Error::new(Code::SceneFormat, "too many shadow rays")
                .at_place("render.n_shadow")
                .numbers(format!("{} asked, {N_SHADOW_MAX} at most", view.n_shadow))
                .next("raise spp instead"));
        }
        if view.method.needs_voxels() && model.voxels.is_none() {
            return Err(Error::new(Code::SceneFormat, "this file has no voxels for the integrator")
                .at_place("render.integrator")
                .numbers(format!("{} needs them", view.method.as_str()))
                .next("build the file without --no-asvo, or use direct or path"));
        }
        if view.method == Method::FullGi && view.g_rays.photons > TREE_PHOTONS_MAX {
            return Err(Error::new(Code::SceneFormat, "too many photons to keep each by itself")
                .at_place("render.photons")
                .numbers(format!("{} asked, {TREE_PHOTONS_MAX} at most", view.g_rays.photons))
                .next("send fewer, or use photon, which sums them up"));
        }
        let lod_error = view.lod_error_pixels;
        if !(0.0..=LOD_ERROR_MAX_PIXELS).contains(&lod_error) || lod_error > 0.0 && model.voxels.is_none() {
            return Err(Error::new(Code::SceneFormat, "this error of the footprint rule cannot be had")
                .at_place("render.lod_error")
                .numbers(format!(
                    "{lod_error} pixels of 0 to {LOD_ERROR_MAX_PIXELS}; the file {} voxels",
                    if model.voxels.is_some() { "has" } else { "has no" }
                ))
                .next("give 0 for the exact mesh, or build the file without --no-asvo"));
        }
        let projection = view.camera.project(view.resolution)?;
        let materials: Vec<Material> =
            model.materials.iter().map(|material| material.clone().checked()).collect();
        // The default sun belongs to the model, so that it stands still while the camera moves.
        let up = up_axis(&model.bounds);
        let sky_by = if view.method.gathers() { SkyBy::GatherRays } else { SkyBy::LightSamples };
        Ok(World {
            voxels_from: World::voxels_from(model, &projection, lod_error),
            projection,
            lights: Lights::new(&view.lights, &model.emitters, &materials, up)?.with_sky_by(sky_by),
            materials,
            n_shadow: view.n_shadow,
            n_gather: view.g_rays.n_gather,
            k_nearest: view.g_rays.k_nearest,
            seed: view.seed,
            method: view.method,
            ao_radius: 0.5 * model.bounds.diagonal(),
        })
    }

    /// The cut of the footprint rule: where a leaf voxel covers `error_pixels`; infinite for 0 and without voxels.
    pub(crate) fn voxels_from(model: &Model, projection: &Projection, error_pixels: f64) -> f64 {
        let leaf_side = model.voxels.as_ref().map(|voxels| voxels.scene(Occluders::On).leaf_side());
        leaf_side.map_or(f64::INFINITY, |side| side / (error_pixels * projection.pixel_angle()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> Model {
        let lamp = Material { name: "lamp".into(), ke: [1.0; 3], ..Material::default() };
        let emitter = Emitter { corners: [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], material: 1 };
        Model {
            bounds: Aabb::EMPTY,
            materials: vec![Material::default(), lamp],
            emitters: vec![emitter],
            voxels: None,
        }
    }

    #[test]
    fn edits_change_what_they_name_and_stay_physical() {
        let mut model = model();
        let edit = MaterialEdit { ks: Some([0.7; 3]), mirror: Some(true), ..MaterialEdit::default() };
        model.edit(0, &edit).unwrap();
        assert_eq!((model.materials[0].kd, model.materials[0].ks), ([0.5; 3], [0.5; 3]));
        assert!(model.materials[0].mirror && model.materials[0].name == "default");
    }

    #[test]
    fn light_needs_triangles_that_the_store_kept() {
        let mut model = model();
        let on = MaterialEdit { ke: Some([2.0; 3]), ..MaterialEdit::default() };
        let off = MaterialEdit { ke: Some([0.0; 3]), ..MaterialEdit::default() };
        assert_eq!(model.edit(0, &on).unwrap_err().place(), "material.\"default\".ke");
        for edit in [off, on] {
            model.edit(1, &edit).unwrap();
        }
        assert_eq!(model.edit(2, &on).unwrap_err().numbers_text(), "the model has 2");
        assert_eq!(model.material_index("lamp").unwrap(), 1);
        assert!(model.material_index("lump").unwrap_err().numbers_text().contains("default, lamp"));
    }
}
