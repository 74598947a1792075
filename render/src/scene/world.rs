//! `World`: what an integrator may read. Built from a model and the edits of a scene, never changed by rendering.
//!
//! Invariant: every material is checked, every emitter has a material, the camera has rays.

use super::camera::{Camera, Projection};
use super::framing::up_axis;
use super::method::LightRig;
use super::settings::{RenderKeys, RenderSettings};
use crate::shading::light::{Emitter, Light, Lights};
use crate::trace::Parts;
use crate::voxel::{Occluders, Voxels};
use glam::Vec3;
use std::borrow::Cow;
use std::sync::Arc;
use trex_store::cluster::WHITE;
use trex_store::{Aabb, Code, Error, Material, MaterialNames, NextStep, Result, srgb};

/// Most names of materials that a message lists.
const NAMES_SHOWN: usize = 8;

/// A model, but for the answers of its rays.
#[derive(Clone, Debug)]
pub struct Model {
    /// Box around all triangles, model units.
    pub bounds: Aabb,
    /// Boxes that hold all triangles together, closer than `bounds`; empty where there are none.
    pub outline: Arc<[Aabb]>,
    /// The materials, in the order that hits name them.
    pub materials: Vec<Material>,
    /// Their names, which edits do not change: copies of a model share them. What has no name here is called nothing.
    pub names: Arc<MaterialNames>,
    /// The triangles whose material gives light.
    pub emitters: Vec<Emitter>,
    /// The second form of the model, which G-rays ask; `None` for a file without.
    pub voxels: Option<Arc<Voxels>>,
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
    /// True for a perfect mirror (with reflectance `ks`).
    pub mirror: Option<bool>,
}

/// Camera, lights, materials and the numbers that make a picture out of them.
#[derive(Clone, Debug)]
pub struct World {
    /// The camera with its film, which makes the rays of the picture.
    pub projection: Projection,
    /// The lights of the scene and of the model.
    pub lights: Lights,
    /// Checked materials, as hits name them.
    pub materials: Vec<Material>,
    /// Mean colour of the mesh on each material, linear; none where all are white.
    pub(crate) mean_colours: Vec<Vec3>,
    /// The numbers of the picture.
    pub settings: RenderSettings,
    /// What is shown of the model.
    pub parts: Arc<Parts>,
    /// Length of the rays of `ao`, model units: half of the model's diagonal.
    pub ao_radius: f64,
    /// Length of the way from the camera from which voxels answer C-rays, model units; infinite for the exact mesh.
    pub lod_distance: f64,
}

/// The part of a scene that a [`World`] is built from, beside the model.
#[derive(Clone, Debug)]
pub struct View {
    /// The camera.
    pub camera: Camera,
    /// Lights of the scene.
    pub lights: Vec<Light>,
    /// The numbers of the picture.
    pub settings: RenderSettings,
    /// What is shown of the model.
    pub parts: Arc<Parts>,
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
                .next(NextStep::ListMaterials));
        };
        let MaterialEdit { kd, ks, ns, ke, mirror } = *edit;
        let new = Material {
            kd: kd.unwrap_or(old.kd),
            ks: ks.unwrap_or(old.ks),
            ns: ns.unwrap_or(old.ns),
            ke: ke.unwrap_or(old.ke),
            d: old.d,
            mirror: mirror.unwrap_or(old.mirror),
            mean_colour: old.mean_colour,
        }
        .checked();
        let kept = || self.emitters.iter().any(|emitter| emitter.material as usize == material);
        if new.emits() && !old.emits() && !kept() {
            return Err(Error::new(Code::SceneFormat, "this material cannot be made to give light")
                .at_place(format!("material.{:?}.ke", self.names.get(material).unwrap_or_default()))
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
        self.names.index_of(name).ok_or_else(|| {
            let names: Vec<_> = self.names.iter().take(NAMES_SHOWN).collect();
            Error::new(Code::SceneFormat, "the model has no material of this name")
                .at_place(format!("material.{name:?}"))
                .numbers(format!("{} materials: {}", self.materials.len(), names.join(", ")))
                .next(NextStep::ListMaterials)
        })
    }
}

impl World {
    /// The world that `view` shows of `model`.
    ///
    /// # Errors
    /// [`Code::SceneFormat`]: a camera without rays, a light that makes no sense, an integrator or a footprint rule
    /// that needs voxels which the model has not.
    ///
    /// # Panics
    /// When an emitter of the model names a material that is not there.
    pub fn new(model: &Model, view: &View) -> Result<World> {
        // A leaf that is a whole cube hides what it holds of the materials that are shown.
        let settings = match view.parts.hides_any() {
            true => RenderSettings::new(RenderKeys { occluders: Occluders::On, ..*view.settings })?,
            false => view.settings,
        };
        let method = settings.integrator;
        if method.needs_voxels() && model.voxels.is_none() {
            return Err(Error::new(Code::SceneFormat, "this file has no voxels for the integrator")
                .at_place("render.integrator")
                .numbers(format!("{} needs them", method.as_str()))
                .next(NextStep::BuildVoxels { or: "use direct or path" }));
        }
        if settings.lod_error > 0.0 && model.voxels.is_none() {
            return Err(Error::new(Code::SceneFormat, "this error of the footprint rule cannot be had")
                .at_place("render.lod_error")
                .numbers(format!("{} pixels; the file has no voxels", settings.lod_error))
                .next(NextStep::BuildVoxels { or: "give 0 for the exact mesh" }));
        }
        let projection = view.camera.project(settings.resolution)?;
        let materials: Vec<Material> = model.materials.iter().map(|material| material.checked()).collect();
        // The default sun belongs to the model, so that it stands still while the camera moves.
        let up = settings.up.direction().unwrap_or_else(|| up_axis(&model.bounds));
        let emitters = shown_emitters(&model.emitters, &view.parts);
        let lights = Lights::new(&view.lights, &emitters, &materials, up.into())?;
        let lights = match settings.light {
            LightRig::Studio => lights.with_sun_and_sky(up.into()),
            LightRig::Auto | LightRig::Scene => lights,
        };
        let mean_colours = mean_colours(&materials);
        Ok(World {
            parts: Arc::new(view.parts.with_colours(&mean_colours)),
            lod_distance: World::lod_distance(model, &projection, settings.lod_error),
            projection,
            lights,
            mean_colours,
            materials,
            settings,
            ao_radius: 0.5 * model.bounds.diagonal(),
        })
    }

    /// The material of a voxel, and what its `kd` is multiplied by there, linear.
    pub(crate) fn voxel_material(&self, index: u32) -> (&Material, Vec3) {
        let index = index as usize;
        (&self.materials[index], self.mean_colours.get(index).copied().unwrap_or(Vec3::ONE))
    }

    /// The cut of the footprint rule: where a leaf voxel covers `lod_error` pixels, model units from the camera;
    /// infinite for 0 and without voxels.
    pub(crate) fn lod_distance(model: &Model, projection: &Projection, lod_error: f64) -> f64 {
        let leaf_side = model.voxels.as_ref().map(|voxels| voxels.scene(Occluders::On).leaf_side());
        leaf_side.map_or(f64::INFINITY, |side| side / (lod_error * projection.pixel_angle()))
    }

    /// Distance from the camera, model units, up to which voxels that are seen stand in for mesh that is missing, and
    /// cover more than `pixels` each; 0 without voxels.
    pub(crate) fn stand_ins_to(&self, model: &Model, pixels: u32) -> f32 {
        let end = World::lod_distance(model, &self.projection, f64::from(pixels)).min(self.lod_distance);
        if model.voxels.is_some() { end as f32 } else { 0.0 }
    }
}

/// What is shown of these emitters: lamps that are cut away or hidden give no light.
fn shown_emitters<'a>(emitters: &'a [Emitter], parts: &Parts) -> Cow<'a, [Emitter]> {
    if parts.is_whole() {
        return Cow::Borrowed(emitters);
    }
    let shown = emitters.iter().filter(|emitter| !parts.hides(emitter.material as usize));
    let kept = shown.flat_map(|emitter| {
        let corners = parts.kept_triangle(emitter.corners);
        corners.into_iter().map(|corners| Emitter { corners, ..*emitter })
    });
    Cow::Owned(kept.collect())
}

/// The mean colours of materials, linear; none where all are white.
fn mean_colours(materials: &[Material]) -> Vec<Vec3> {
    if materials.iter().all(|material| material.mean_colour == WHITE) {
        return Vec::new();
    }
    let linear = |byte: u8| srgb::linear_of(byte) as f32;
    materials.iter().map(|material| material.mean_colour.map(linear).into()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn model() -> Model {
        let lamp = Material { ke: [1.0; 3], ..Material::default() };
        let emitter = Emitter { corners: [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], material: 1 };
        Model {
            bounds: Aabb::EMPTY,
            outline: Default::default(),
            materials: vec![Material::default(), lamp],
            names: Arc::new(["default", "lamp"].into_iter().collect()),
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
        assert!(model.materials[0].mirror);
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
