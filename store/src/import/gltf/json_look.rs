//! The JSON of a glTF file: materials, cameras and lights, as they stand there. Nothing is checked here.
//!
//! Invariant: what is parsed takes what `json.rs` says.

use super::json_value::{JsonText, Object};
use serde::Deserialize;
use serde::de::IgnoredAny;

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct JsonMaterial<'a> {
    #[serde(borrow)]
    pub(super) name: Option<JsonText<'a>>,
    pub(super) pbr_metallic_roughness: Option<Box<Object<JsonMetallicRoughness>>>,
    pub(super) emissive_factor: Option<Box<[f64; 3]>>,
    pub(super) emissive_texture: Option<IgnoredAny>,
    pub(super) normal_texture: Option<IgnoredAny>,
    pub(super) occlusion_texture: Option<IgnoredAny>,
    #[serde(borrow)]
    pub(super) alpha_mode: Option<JsonText<'a>>,
    pub(super) extensions: Option<Box<Object<JsonMaterialExtensions>>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct JsonMetallicRoughness {
    pub(super) base_color_factor: Option<Box<[f64; 4]>>,
    pub(super) base_color_texture: Option<Box<Object<JsonTextureInfo>>>,
    pub(super) metallic_factor: Option<f64>,
    pub(super) roughness_factor: Option<f64>,
    pub(super) metallic_roughness_texture: Option<IgnoredAny>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct JsonMaterialExtensions {
    #[serde(rename = "KHR_materials_emissive_strength")]
    pub(super) emissive: Option<Object<JsonEmissiveStrength>>,
    #[serde(rename = "KHR_materials_ior")]
    pub(super) ior: Option<Object<JsonIor>>,
    #[serde(rename = "KHR_materials_transmission")]
    pub(super) transmission: Option<Object<JsonTransmission>>,
    #[serde(rename = "KHR_materials_unlit")]
    pub(super) unlit: Option<IgnoredAny>,
    #[serde(rename = "KHR_materials_pbrSpecularGlossiness")]
    pub(super) specular_glossiness: Option<Box<Object<JsonSpecularGlossiness>>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct JsonEmissiveStrength {
    pub(super) emissive_strength: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct JsonIor {
    pub(super) ior: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct JsonTransmission {
    pub(super) transmission_factor: Option<f64>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct JsonSpecularGlossiness {
    pub(super) diffuse_factor: Option<Box<[f64; 4]>>,
    pub(super) diffuse_texture: Option<Box<Object<JsonTextureInfo>>>,
    pub(super) specular_factor: Option<Box<[f64; 3]>>,
    pub(super) glossiness_factor: Option<f64>,
    pub(super) specular_glossiness_texture: Option<IgnoredAny>,
}

/// What a material says of a texture.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct JsonTextureInfo {
    pub(super) index: Option<u32>,
    #[serde(rename = "texCoord")]
    pub(super) coordinates: Option<u32>,
    pub(super) extensions: Option<Box<Object<JsonTextureExtensions>>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct JsonTextureExtensions {
    #[serde(rename = "KHR_texture_transform")]
    pub(super) transform: Option<Box<Object<JsonTextureTransform>>>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct JsonTextureTransform {
    pub(super) offset: Option<Box<[f64; 2]>>,
    pub(super) rotation: Option<f64>,
    pub(super) scale: Option<Box<[f64; 2]>>,
    #[serde(rename = "texCoord")]
    pub(super) coordinates: Option<u32>,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonTexture {
    pub(super) source: Option<u32>,
    pub(super) sampler: Option<u32>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct JsonSampler {
    pub(super) wrap_s: Option<u32>,
    pub(super) wrap_t: Option<u32>,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonCamera<'a> {
    #[serde(borrow, rename = "type")]
    pub(super) kind: Option<JsonText<'a>>,
    pub(super) perspective: Option<Object<JsonPerspective>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonPerspective {
    pub(super) yfov: f64,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct JsonExtensions<'a> {
    #[serde(borrow, rename = "KHR_lights_punctual")]
    pub(super) punctual: Option<Object<JsonLights<'a>>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonLights<'a> {
    #[serde(borrow, default)]
    pub(super) lights: Vec<Object<JsonLight<'a>>>,
}

#[derive(Debug, Deserialize)]
pub(super) struct JsonLight<'a> {
    #[serde(borrow, rename = "type")]
    pub(super) kind: JsonText<'a>,
    pub(super) color: Option<Box<[f64; 3]>>,
    pub(super) intensity: Option<f64>,
}
