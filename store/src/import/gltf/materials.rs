//! Materials of glTF (metallic-roughness, and the older specular-glossiness) as the Phong ones that are rendered.
//!
//! ```text
//! c = base colour (linear)   m = metallic   r = roughness    F0 = ((ior - 1) / (ior + 1))^2, 0.04 without ior
//! ks = F0 (1 - m) + c m      kd = c (1 - F0) (1 - m)        ns = (2 / r^4 - 2) / 4, at most 10^6
//! ke = emissive * strength   d = alpha where it blends, less what is transmitted
//! mirror: m >= 0.5 and r <= 0.05
//! ```
//!
//! The exponent is that of the Blinn-Phong lobe which is as wide as the GGX lobe of alpha = r^2 (Walter et al., EGSR
//! 2007, section 5.2, by the slope's variance); for the Phong lobe here, around the mirrored ray, it is a quarter of
//! that.
//!
//! The picture of a base colour gives the colours of vertices (`textures.rs`); one that cannot be read counts as half
//! of the factor. Other textures are not read, and where one says what is metal, nothing is. `docs/inputs.md` says the
//! rule for users.
//!
//! Invariant: entry 0 is what has no material, or the file's own that is called `default`; the others follow in order.

use super::json::JsonDocument;
use super::json_look::{JsonMaterial, JsonMetallicRoughness, JsonSpecularGlossiness};
use super::json_value::Object;
use super::textures::{Textures, base_texture};
use crate::budget::Lease;
use crate::error::{Code, Error, Result};
use crate::import::ImportOptions;
use crate::import::materials::{key, table_bytes};
use crate::layout::MATERIALS;
use crate::material::Material;
use crate::material_list::{DEFAULT_NAME, MaterialList};
use crate::material_names::stored_name;
use std::path::Path;

/// What a colour is times, where a texture gives it that is not read: the mean of pictures in general.
const TEXTURE_MEAN: f64 = 0.5;
/// Reflectance of plastic, glass and the like, seen straight on.
const DIELECTRIC: f64 = 0.04;
/// From so much metal and up to such a roughness, a surface is a mirror.
const MIRROR_METALLIC: f64 = 0.5;
const MIRROR_ROUGHNESS: f64 = 0.05;
/// Largest exponent.
const EXPONENT_MAX: f64 = 1e6;

/// The materials of a file.
pub(super) struct GltfMaterials {
    pub(super) entries: MaterialList,
    pub(super) transparent_count: u64,
    /// Bytes of all names, as page files hold them.
    pub(super) name_bytes: u64,
    /// Materials with a texture beside that of their colour, and those whose colour's is not read.
    pub(super) textured_count: u64,
    pub(super) unread_count: u64,
    _lease: Lease,
}

/// The first material of a file that is called as the default is: it takes its place.
pub(super) fn default_at(document: &JsonDocument<'_>) -> Option<u32> {
    let is_default = |json: &Object<JsonMaterial<'_>>| json.name.as_deref() == Some(DEFAULT_NAME);
    document.materials.iter().position(is_default).map(|at| at as u32)
}

/// The entry of a material by its index in the file, where that at `default_at` is the default.
pub(super) fn entry_of(index: u32, default_at: Option<u32>) -> u32 {
    match default_at {
        Some(at) if index == at => 0,
        Some(at) if index > at => index,
        _ => index + 1,
    }
}

impl GltfMaterials {
    /// All materials of a document.
    pub(super) fn read(
        document: &JsonDocument<'_>,
        textures: &Textures,
        path: &Path,
        options: &ImportOptions,
    ) -> Result<GltfMaterials> {
        let materials = &document.materials;
        if materials.len() >= MATERIALS {
            return Err(Error::new(Code::InputRange, "the glTF file has too many materials")
                .at(path)
                .numbers(format!("{}, and {MATERIALS} at most", materials.len()))
                .next("export the mesh with fewer materials"));
        }
        let name = |index: usize, material: &JsonMaterial<'_>| match material.name.as_deref() {
            Some(name) if !name.is_empty() => stored_name(name).into_owned(),
            _ => format!("material {index}"),
        };
        let name_bytes: usize =
            materials.iter().enumerate().map(|(index, material)| name(index, material).len()).sum();
        let name_bytes = (name_bytes + DEFAULT_NAME.len()) as u64;
        let leased = table_bytes(materials.len() as u64 + 1, name_bytes);
        let lease = options.budget.lease("materials", leased)?;
        let mut all = GltfMaterials {
            entries: MaterialList::from(Material::default()),
            transparent_count: 0,
            name_bytes,
            textured_count: 0,
            unread_count: textures.unread_count,
            _lease: lease,
        };
        let default_at = default_at(document);
        for (index, json) in materials.iter().enumerate() {
            let name = name(index, json);
            let kept = key(options.naming, &name);
            let material = phong(json, &ColourFactors::of(json, textures, index as u32));
            all.transparent_count += u64::from(material.d < 1.0);
            all.textured_count += u64::from(has_other_texture(json));
            match Some(index as u32) == default_at {
                true => all.entries.replace(0, material),
                false => all.entries.push(&kept, material),
            }
        }
        Ok(all)
    }
}

/// What a colour is times: for what reflects in all directions, whose picture vertices have, and for the rest.
struct ColourFactors {
    diffuse: [f64; 3],
    specular: [f64; 3],
}

impl ColourFactors {
    fn of(json: &JsonMaterial<'_>, textures: &Textures, index: u32) -> ColourFactors {
        let unread = if base_texture(json).is_some() { TEXTURE_MEAN } else { 1.0 };
        let (diffuse, specular) = textures.factors(index).unwrap_or(([unread; 3], [unread; 3]));
        ColourFactors { diffuse, specular }
    }
}

fn has_other_texture(json: &JsonMaterial<'_>) -> bool {
    let pbr = json.pbr_metallic_roughness.as_deref();
    let older = json.extensions.as_deref().and_then(|extensions| extensions.specular_glossiness.as_deref());
    let in_pbr = pbr.is_some_and(|pbr| pbr.metallic_roughness_texture.is_some());
    let in_older = older.is_some_and(|older| older.specular_glossiness_texture.is_some());
    let of_all = [&json.emissive_texture, &json.normal_texture, &json.occlusion_texture];
    in_pbr || in_older || of_all.iter().any(|texture| texture.is_some())
}

/// A material by the rule of the module.
fn phong(json: &JsonMaterial<'_>, factors: &ColourFactors) -> Material {
    let extensions = json.extensions.as_deref();
    let default = JsonMetallicRoughness::default();
    let pbr = json.pbr_metallic_roughness.as_deref().map_or(&default, |pbr| pbr);
    let older = extensions.and_then(|extensions| extensions.specular_glossiness.as_deref());
    let (mut material, alpha) = match older {
        Some(older) => specular_glossiness(older, factors),
        None => metallic_roughness(pbr, factors, reflectance(json)),
    };
    if extensions.is_some_and(|extensions| extensions.unlit.is_some()) {
        // A picture of light that is there already: drawn as what reflects that colour.
        (material.ks, material.mirror) = ([0.0; 3], false);
        material.kd = colour(pbr.base_color_factor.as_deref(), &factors.diffuse);
    }
    let strength = extensions.and_then(|extensions| extensions.emissive.as_ref()?.emissive_strength);
    let textured = if json.emissive_texture.is_some() { TEXTURE_MEAN } else { 1.0 };
    let emissive = json.emissive_factor.as_deref().copied().unwrap_or([0.0; 3]);
    material.ke = emissive.map(|part| (part * strength.unwrap_or(1.0) * textured) as f32);
    let transmitted = extensions.and_then(|extensions| extensions.transmission.as_ref()?.transmission_factor);
    let alpha = if json.alpha_mode.as_deref() == Some("BLEND") { alpha } else { 1.0 };
    material.d = (alpha * (1.0 - transmitted.unwrap_or(0.0).clamp(0.0, 1.0))) as f32;
    material.checked()
}

fn reflectance(json: &JsonMaterial<'_>) -> f64 {
    let ior = json.extensions.as_deref().and_then(|extensions| extensions.ior.as_ref()?.ior);
    match ior {
        Some(ior) if ior >= 1.0 => ((ior - 1.0) / (ior + 1.0)).powi(2),
        _ => DIELECTRIC,
    }
}

fn metallic_roughness(pbr: &JsonMetallicRoughness, factors: &ColourFactors, f0: f64) -> (Material, f64) {
    let base = pbr.base_color_factor.as_deref();
    let diffuse = colour(base, &factors.diffuse);
    let specular = colour(base, &factors.specular);
    // Exporters leave the factor at 1 where a texture says which parts are metal: mostly few are.
    let is_unknown = pbr.metallic_roughness_texture.is_some();
    let metallic = if is_unknown { 0.0 } else { pbr.metallic_factor.unwrap_or(1.0).clamp(0.0, 1.0) };
    let roughness = pbr.roughness_factor.unwrap_or(1.0).clamp(0.0, 1.0);
    let (m, f0) = (metallic as f32, f0 as f32);
    let material = Material {
        kd: diffuse.map(|c| c * (1.0 - f0) * (1.0 - m)),
        ks: specular.map(|c| f0 * (1.0 - m) + c * m),
        ns: exponent(roughness),
        mirror: metallic >= MIRROR_METALLIC && roughness <= MIRROR_ROUGHNESS,
        ..Material::default()
    };
    (material, base.map_or(1.0, |base| base[3]))
}

fn specular_glossiness(older: &JsonSpecularGlossiness, factors: &ColourFactors) -> (Material, f64) {
    let diffuse = older.diffuse_factor.as_deref();
    let specular = older.specular_factor.as_deref().copied().unwrap_or([1.0; 3]);
    let is_unknown = older.specular_glossiness_texture.is_some();
    let roughness = 1.0 - older.glossiness_factor.unwrap_or(1.0).clamp(0.0, 1.0);
    let ks = if is_unknown { [DIELECTRIC as f32; 3] } else { specular.map(|part| part as f32) };
    let most = ks.iter().copied().fold(0.0, f32::max).clamp(0.0, 1.0);
    let material = Material {
        kd: colour(diffuse, &factors.diffuse).map(|c| c * (1.0 - most)),
        ks,
        ns: exponent(if is_unknown { 1.0 } else { roughness }),
        mirror: f64::from(most) >= MIRROR_METALLIC && !is_unknown && roughness <= MIRROR_ROUGHNESS,
        ..Material::default()
    };
    (material, diffuse.map_or(1.0, |diffuse| diffuse[3]))
}

fn colour(factor: Option<&[f64; 4]>, times: &[f64; 3]) -> [f32; 3] {
    let factor = factor.copied().unwrap_or([1.0; 4]);
    [0, 1, 2].map(|channel| (factor[channel].clamp(0.0, 1.0) * times[channel]) as f32)
}

/// The exponent of a Phong lobe around the mirrored ray.
fn exponent(roughness: f64) -> f32 {
    let alpha = roughness * roughness;
    ((2.0 / (alpha * alpha) - 2.0) / 4.0).clamp(0.0, EXPONENT_MAX) as f32
}
