//! `Scene`: what a `scene.toml` says; every key stands in docs/scene.md.
//!
//! Invariants: 1. unknown keys are refused by name; 2. what is out of range is refused with its key, before any
//! work; 3. parsing opens nothing: the model's path is a string for the command to resolve.

use super::camera::{Camera, Fov};
use super::edit::{Quality, RenderEdit};
use super::exposure::Exposure;
use super::framing::FramedView;
use super::key::{Key, KeyValue, out_of_range};
use super::method::{Filter, LightRig};
use super::part_keys::{PartKeys, SECTION_STEP};
use super::settings::{RenderKeys, RenderSettings};
use super::world::{MaterialEdit, Model, View};
use crate::shading::light::Light;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use trex_store::{Code, Error, Result};

/// A parsed and checked scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Path of the model, as written.
    pub model: String,
    /// Keys of the camera.
    pub camera: CameraKeys,
    /// The lights.
    pub lights: Vec<Light>,
    /// Changes to materials, by name.
    pub materials: BTreeMap<String, MaterialEdit>,
    /// What is shown of the model.
    pub parts: PartKeys,
    /// Keys of the picture: integrator and numbers.
    pub render: RenderKeys,
    /// Those of them that were given: a default is no wish.
    pub given: RenderEdit,
}

/// A scene that says nothing: framed, in [`Quality::Normal`].
impl Default for Scene {
    fn default() -> Scene {
        Scene {
            model: String::new(),
            camera: CameraKeys::default(),
            lights: vec![],
            materials: BTreeMap::new(),
            parts: PartKeys::default(),
            render: Quality::default().apply(&RenderKeys::default()),
            given: RenderEdit::default(),
        }
    }
}

/// Camera keys; what is `None` is framed from the model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraKeys {
    /// The pinhole, model units; with `target` or not at all.
    pub position: Option<[f64; 3]>,
    /// Point in the middle of the picture, model units.
    pub target: Option<[f64; 3]>,
    /// Upward direction of the picture; any length, not along the view.
    pub up: Option<[f64; 3]>,
    /// The direction in which a camera looks that frames the model; any length. Not with `position` and `target`.
    pub direction: Option<[f64; 3]>,
    /// Angle across, degrees.
    pub fov_x: Option<f64>,
    /// Angle from top to bottom, degrees.
    pub fov_y: Option<f64>,
}

impl Scene {
    /// The scene of a file that has none: lit and shown so that all of it can be seen.
    pub fn of_file() -> Scene {
        let mut scene = Scene::default();
        (scene.render.light, scene.render.exposure) = (LightRig::Auto, Exposure::Auto);
        scene
    }

    /// Parses and checks the text of a scene file; `path` is for messages alone.
    ///
    /// # Errors
    /// [`Code::SceneFormat`] with path and line: text that is no TOML, an unknown key, a value of the wrong kind;
    /// with the key: a value out of range.
    pub fn parse(text: &str, path: &Path) -> Result<Scene> {
        let no_scene = |error| toml_error(&error, text, path);
        let parsed: SceneText = toml::from_str(text).map_err(no_scene)?;
        let SceneText { model, camera, light: lights, material: materials, parts, render: given } = parsed;
        let render = given.apply(&Scene::default().render);
        let scene = Scene { model, camera, lights, materials, parts, render, given };
        scene.check(path)?;
        Ok(scene)
    }

    /// Suits what was not asked for to a picture that changes while it is looked at: it begins without the filter and,
    /// without a scene, with the footprint rule, so that frames come sooner.
    pub fn begin_live(&mut self) {
        if self.model.is_empty() && self.given.lod_error.is_none() {
            self.render.lod_error = 1.0;
        }
        if self.given.filter.is_none() && self.given.quality.is_none() {
            self.render.filter = Filter::Off;
        }
        // Photons go on coming while the picture is looked at.
        if self.given.photons.is_none() && self.given.quality.is_none() {
            self.render.photons = RenderKeys::default().photons;
        }
    }

    /// Applies the material edits to `model` and gives the view of it that this scene describes.
    ///
    /// # Errors
    /// [`Code::SceneFormat`]: a material that the model has not, or that cannot be edited so; settings that do not go
    /// together ([`RenderSettings::new`]).
    pub fn view(&self, model: &mut Model) -> Result<View> {
        let settings = RenderSettings::new(self.render)?;
        for (name, edit) in &self.materials {
            model.edit(model.material_index(name)?, edit)?;
        }
        let camera = self.camera.camera(model, &settings);
        let parts = Arc::new(self.parts.parts(model)?);
        Ok(View { camera, lights: self.lights.clone(), settings, parts })
    }

    fn check(&self, path: &Path) -> Result<()> {
        let in_file = |error: Error| {
            let place = format!("{}, key {}", path.display(), error.place());
            error.at_place(place)
        };
        let bad = |key: &str, numbers: String, next: &str| Err(in_file(out_of_range(key, numbers, next)));
        let CameraKeys { position, target, up, direction, fov_x, fov_y } = self.camera;
        if position.is_some() != target.is_some() {
            let numbers = format!("position {position:?}, target {target:?}");
            return bad("camera.position", numbers, "give both position and target, or neither");
        }
        if direction.is_some() && position.is_some() {
            let numbers = format!("direction {direction:?}, position {position:?}");
            return bad("camera.direction", numbers, "give a direction, or position and target");
        }
        for (key, way) in [("camera.direction", direction), ("camera.up", up)] {
            if way.is_some_and(|way| way == [0.0; 3] || way.iter().any(|part| !part.is_finite())) {
                return bad(key, format!("{way:?}"), "give three finite numbers, not all of them 0");
            }
        }
        if fov_x.is_some() && fov_y.is_some() {
            return bad(
                "camera.fov_x",
                format!("{fov_x:?} beside fov_y {fov_y:?}"),
                "give one angle of view",
            );
        }
        self.render.check_ranges().map_err(in_file)?;
        self.parts.check().or_else(|numbers| bad("parts.section", numbers, SECTION_STEP))?;
        for (index, light) in self.lights.iter().enumerate() {
            light.check(&format!("{}, key light[{index}]", path.display()))?;
        }
        for (name, edit) in &self.materials {
            check_material(edit).or_else(|(key, numbers)| {
                bad(&format!("material.{name:?}.{key}"), numbers, "give finite numbers >= 0, ns at most 10^6")
            })?;
        }
        Ok(())
    }
}

impl Key {
    /// The value in a scene that says nothing, where the picture changes while it is looked at.
    pub fn live_value(&self) -> KeyValue {
        let mut scene = Scene::default();
        scene.begin_live();
        scene.render.value(self).unwrap_or(self.default_value())
    }
}

impl CameraKeys {
    /// The camera that these keys, the picture's, and the model's box make.
    pub fn camera(&self, model: &Model, picture: &RenderKeys) -> Camera {
        let fov = self.fov_x.map(Fov::X).or(self.fov_y.map(Fov::Y));
        let up = self.up.or(picture.up.direction());
        let framing = FramedView { up, direction: self.direction, fov };
        let framed = Camera::framing_along(&model.bounds, &model.outline, picture.resolution, framing);
        Camera {
            position: self.position.unwrap_or(framed.position),
            target: self.target.unwrap_or(framed.target),
            // Straight from above it cannot be the one that was asked for.
            up: up.filter(|_| self.position.is_some()).unwrap_or(framed.up),
            fov: framed.fov,
        }
    }
}

fn check_material(edit: &MaterialEdit) -> Result<(), (&'static str, String)> {
    let bad = |value: f32| !value.is_finite() || value < 0.0;
    for (key, rgb) in [("kd", edit.kd), ("ks", edit.ks), ("ke", edit.ke)] {
        if let Some(rgb) = rgb.filter(|rgb| rgb.iter().any(|&x| bad(x))) {
            return Err((key, format!("{rgb:?}")));
        }
    }
    edit.ns.filter(|&ns| bad(ns) || ns > 1e6).map_or(Ok(()), |ns| Err(("ns", ns.to_string())))
}

/// The file as TOML has it.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneText {
    model: String,
    #[serde(default)]
    camera: CameraKeys,
    #[serde(default)]
    light: Vec<Light>,
    #[serde(default)]
    material: BTreeMap<String, MaterialEdit>,
    #[serde(default)]
    parts: PartKeys,
    #[serde(default)]
    render: RenderEdit,
}

/// The line of `text` that an error is about.
pub(super) fn line_of(error: &toml::de::Error, text: &str) -> Option<u64> {
    let before = &text.as_bytes()[..error.span()?.start.min(text.len())];
    Some(1 + before.iter().filter(|&&byte| byte == b'\n').count() as u64)
}

fn toml_error(error: &toml::de::Error, text: &str, path: &Path) -> Error {
    let message = error.message().trim().to_string();
    let made = Error::new(Code::SceneFormat, "this is no scene").numbers(message);
    let made = match line_of(error, text) {
        Some(line) => made.at_line(path, line),
        None => made.at(path),
    };
    made.next("docs/scene.md lists every key with its range")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shading::light::Lights;
    use trex_store::{Aabb, Material};

    fn parse(text: &str) -> Result<Scene> {
        Scene::parse(text, Path::new("a.toml"))
    }

    #[test]
    fn the_example_of_the_manual_is_a_scene() {
        let manual = include_str!("../../../docs/scene.md");
        let text = manual.split("```toml\n").nth(1).unwrap().split("```").next().unwrap();
        let scene = parse(text).unwrap();
        assert_eq!((scene.model.as_str(), scene.lights.len()), ("bunny.trex", 4));
        let bounds = Aabb { lo: [-1.0; 3], hi: [1.0; 3] };
        let mut model = Model {
            bounds,
            outline: Default::default(),
            materials: vec![Material::default()],
            names: Arc::new(["default"].into_iter().collect()),
            emitters: vec![],
            voxels: None,
        };
        let view = scene.view(&mut model).unwrap();
        assert_eq!(model.materials[0].ns, 40.0);
        assert_eq!((view.settings.resolution, view.camera.fov), ([1280, 720], Fov::Y(35.0)));
        // "it shines downwards"
        let lights = Lights::new(&scene.lights[2..3], &[], &[], glam::DVec3::Y).unwrap();
        let up = |y| crate::trace::Ray { origin: [0.0, y, 0.0], direction: [0.0, 1.0, 0.0], t_max: 9.0 };
        assert!(lights.seen(&up(0.0), 9.0).is_some() && lights.seen(&up(3.0), 9.0).is_none());
    }

    #[test]
    fn every_key_is_in_the_manual() {
        let manual = include_str!("../../../docs/scene.md");
        let keys = "model camera position target up fov_x fov_y light type point directional rect sky intensity \
                    direction irradiance corner edge_u edge_v radiance material kd ks ns ke mirror render \
                    quality integrator resolution spp n_shadow n_gather photons near occluders k_nearest studio auto \
                    lod_error bake caustics filter exposure seed";
        for key in keys.split_whitespace() {
            assert!(manual.contains(key), "{key}");
        }
    }

    #[test]
    fn a_model_alone_is_enough() {
        let scene = parse("model = 'x.ply'").unwrap();
        assert_eq!(scene, Scene { model: "x.ply".into(), ..Scene::default() });
        let bounds = Aabb { lo: [0.0; 3], hi: [9.0, 9.0, 1.0] };
        let view = scene
            .view(&mut Model {
                bounds,
                outline: Default::default(),
                materials: vec![],
                names: Default::default(),
                emitters: vec![],
                voxels: None,
            })
            .unwrap();
        assert_eq!(view.camera.up, [0.0, 0.0, 1.0]);
        assert!(view.camera.project(view.settings.resolution).is_ok());
    }

    #[test]
    fn a_resolution_is_given_where_its_key_is() {
        for (text, expected) in [
            ("", false),
            ("[render]\nspp = 3 # resolution = [3, 4]", false),
            ("[material.resolution]\nns = 3", false),
            ("[render]\nresolution = [1024, 1024]", true),
            ("render = { spp = 4, \"resolution\" = [3, 4] }", true),
            ("render.resolution = [3, 4]", true),
        ] {
            let scene = parse(&format!("model = 'x'\n{text}")).unwrap();
            assert_eq!(scene.given.resolution.is_some(), expected, "{text}");
        }
    }

    fn check_error(text: &str, place: &str, word: &str) {
        let error = parse(text).unwrap_err();
        assert_eq!(error.code(), Code::SceneFormat, "{text}");
        assert_eq!(error.place(), place, "{error}");
        assert!(error.to_string().contains(word), "{error}");
        assert!(!error.numbers_text().is_empty() && !error.next_step().is_empty());
    }

    #[test]
    fn mistakes_are_named() {
        check_error("modle = 'x'", "a.toml:1", "modle");
        check_error("model = 'x'\n[camera]\nfow_x = 3", "a.toml:3", "fow_x");
        check_error("model = 'x'\n[render]\nspp = -3", "a.toml:3", "-3");
        check_error("model = 'x'\n\n[[light]]\ntype = 'lava'", "a.toml:4", "lava");
        check_error(
            "model = 'x'\n[[light]]\ntype = 'sky'\nradiance = [1,1,1]\npower = 3",
            "a.toml:2",
            "power",
        );
        check_error("model = 'x'\n[material.a]\nkd = [1, 2]", "a.toml:3", "length");
        check_error("model = 'x'\n[material.a]\nroughness = 1", "a.toml:3", "roughness");
        check_error("[camera]", "a.toml:1", "model");
        check_error("model = 3 3", "a.toml:1", "");
        check_error("model = 'x'\n[render]\nspp = 0", "a.toml, key render.spp", "0");
        check_error("model = 'x'\n[render]\nresolution = [0, 5]", "a.toml, key render.resolution", "65536");
        check_error("model = 'x'\n[render]\nexposure = nan", "a.toml, key render.exposure", "NaN");
        check_error("model = 'x'\n[camera]\ntarget = [1,1,1]", "a.toml, key camera.position", "both");
        let turned = "model = 'x'\n[camera]\ndirection = [0, 0, 0]";
        check_error(turned, "a.toml, key camera.direction", "finite");
        check_error("model = 'x'\n[camera]\nup = [0, 0, 0]", "a.toml, key camera.up", "finite");
        check_error("model = 'x'\n[material.a]\nns = 1e9", "a.toml, key material.\"a\".ns", "10^6");
        check_error("model = 'x'\n[camera]\nfov_x = 3\nfov_y = 4", "a.toml, key camera.fov_x", "one angle");
        check_error("model = 'x'\n[material.a]\nkd = [1,-2,1]", "a.toml, key material.\"a\".kd", "-2");
        let light = "model = 'x'\n[[light]]\ntype = 'sky'\nradiance = [1,1,-1]";
        check_error(light, "a.toml, key light[0]", "-1");
    }
}
