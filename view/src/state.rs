//! What pages are told: the state of the session, what it is doing, and what they asked for.
//!
//! Invariant: a page that has had the welcome and every `state` since knows all of the state.

use crate::materials::MaterialText;
use crate::message::{CameraText, Role, text_of};
use crate::parts::PartsText;
use crate::reports::{DeviceFigures, MemoryFigures, ModelFigures, PoolFigures};
use crate::settings::{KeyText, SettingsText};
use crate::wire::LIGHTS_MAX;
use serde::Serialize;
use trex_render::{FrameProgress, RayCounts};
use trex_store::DamageList;

/// The state of the session; in an update, what has changed of it.
#[derive(Clone, Debug, Default, Serialize)]
pub(crate) struct State {
    /// The newest event of who drives that this knows of.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) seq: Option<u32>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) name: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) size: Option<[u32; 2]>,
    /// The picture is as large as the driver's page.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) follows_page: Option<bool>,
    /// The picture is smaller than the driver's page, and why; null where it is not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) smaller: Option<Option<Smaller>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) bounds: Option<BoundsText>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) up: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) camera: Option<CameraText>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) home: Option<CameraText>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) views: Option<Vec<CameraText>>,
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub(crate) lights: Option<LightsText>,
    /// What is shown of the model.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) parts: Option<PartsText>,
    /// How many materials the model has; pages ask for parts of their list.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) material_count: Option<usize>,
    /// A material that was edited. Who comes later asks for it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) material: Option<MaterialText>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) settings: Option<SettingsText>,
    /// What is known of the keys of `settings`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) keys: Option<Vec<KeyText>>,
    /// Least and greatest side of a picture that follows a page, pixels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) sides: Option<[u32; 2]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) model: Option<ModelFigures>,
    /// Name of the device that answers rays through the voxels.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) device: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) memory: Option<LimitText>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) damage: Option<DamageList>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) t_max_ms: Option<f64>,
    #[serde(flatten, skip_serializing_if = "Option::is_none")]
    pub(crate) texts: Option<TextsText>,
}

/// All lights; the list is null where there are more than a message may hold.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct LightsText {
    light_count: usize,
    lights: Option<Vec<trex_render::Light>>,
}

/// The view as texts.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct TextsText {
    pub(crate) command: String,
    /// The scene file; null where it is long: pages ask for it as a file.
    pub(crate) scene: Option<String>,
    pub(crate) scene_bytes: usize,
}

/// The box of the model.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct BoundsText {
    pub(crate) lo: [f64; 3],
    pub(crate) hi: [f64; 3],
}

/// The limit of memory.
#[derive(Clone, Copy, Debug, Serialize)]
pub(crate) struct LimitText {
    pub(crate) limit_bytes: u64,
}

/// A size for which there is no memory, and the limit that would do.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub(crate) struct Smaller {
    pub(crate) asked: [u32; 2],
    pub(crate) limit_bytes: Option<u64>,
}

/// A state as one client gets it.
#[derive(Serialize)]
struct StateText<'a> {
    #[serde(rename = "type")]
    kind: &'static str,
    role: Role,
    clients: usize,
    #[serde(flatten)]
    state: &'a State,
}

impl State {
    /// The first message to a client.
    pub(crate) fn welcome(&self, role: Role, clients: usize) -> String {
        text_of(&StateText { kind: "welcome", role, clients, state: self })
    }

    /// A message that brings changes.
    pub(crate) fn update(&self, role: Role, clients: usize) -> String {
        text_of(&StateText { kind: "state", role, clients, state: self })
    }

    /// True when nothing has changed that events may change.
    pub(crate) fn is_empty(&self) -> bool {
        let State { size, camera, lights, parts, material, settings, .. } = self;
        let is_same_model = lights.is_none() && parts.is_none() && material.is_none();
        size.is_none() && camera.is_none() && settings.is_none() && is_same_model
    }

    /// Takes over what `update` has and who comes later is to be told.
    pub(crate) fn merge(&mut self, update: State) {
        let State { size, smaller, camera, home, .. } = update;
        let State { lights, parts, settings, memory, damage, texts, .. } = update;
        self.smaller = smaller.or(self.smaller);
        self.home = home.or(self.home);
        self.size = size.or(self.size);
        self.camera = camera.or(self.camera);
        self.lights = lights.or(self.lights.take());
        self.parts = parts.or(self.parts.take());
        self.settings = settings.or(self.settings);
        self.memory = memory.or(self.memory);
        self.damage = damage.or(self.damage.take());
        self.texts = texts.or(self.texts.take());
    }
}

/// How the picture goes on.
#[derive(Clone, Copy, Debug, Default, Serialize)]
#[serde(tag = "type", rename = "stats")]
pub(crate) struct Stats {
    pub(crate) progress: &'static str,
    pub(crate) samples: u32,
    pub(crate) spp: u32,
    pub(crate) light_share: f64,
    pub(crate) pixel_error: PixelError,
    pub(crate) times_ms: Times,
    pub(crate) rays_per_s: RaysText,
    pub(crate) memory: MemoryFigures,
    pub(crate) pool: PoolFigures,
    /// `None` where the processor is the device.
    pub(crate) gpu: Option<DeviceFigures>,
}

/// Error of the footprint rule, pixels.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct PixelError {
    pub(crate) asked: f64,
    pub(crate) in_force: f64,
}

/// When the picture was what, from the last event on, ms.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct Times {
    pub(crate) first: Option<f64>,
    pub(crate) whole: Option<f64>,
    pub(crate) response: Option<f64>,
    pub(crate) complete: Option<f64>,
}

/// Rays a second by kind.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub(crate) struct RaysText {
    pub(crate) primary: f64,
    pub(crate) shadow: f64,
    pub(crate) gather: f64,
    pub(crate) far: f64,
    pub(crate) photon: f64,
}

impl RaysText {
    /// Rates over `seconds`, `far`: C-rays behind the cut of the footprint rule.
    pub(crate) fn new(rays: &RayCounts, far: u64, seconds: f64) -> RaysText {
        let RayCounts { primary, mirror, shadow, gather, photon } = *rays;
        let [primary, shadow, gather, far, photon] =
            [primary + mirror, shadow, gather, far, photon].map(|count| count as f64 / seconds);
        RaysText { primary, shadow, gather, far, photon }
    }
}

impl Stats {
    /// The message, with what is of one client: bytes that went to it, and bytes and frames a second.
    pub(crate) fn text(&self, sent_bytes: u64, [bytes_per_s, fps]: [f64; 2]) -> String {
        #[derive(Serialize)]
        struct StatsText<'a> {
            #[serde(flatten)]
            stats: &'a Stats,
            sent_bytes: u64,
            bytes_per_s: f64,
            fps: f64,
        }
        text_of(&StatsText { stats: self, sent_bytes, bytes_per_s, fps })
    }
}

/// The name of a progress.
pub(crate) fn progress_name(progress: FrameProgress) -> &'static str {
    match progress {
        FrameProgress::PreviewPart | FrameProgress::Preview => "preview",
        FrameProgress::Part => "part",
        FrameProgress::Block => "block",
        FrameProgress::Complete => "complete",
        FrameProgress::Done => "done",
    }
}

/// The answer to a pick.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "type", rename = "picked")]
pub(crate) struct PickAnswer {
    pub(crate) id: u32,
    pub(crate) hit: Option<HitText>,
}

/// What is at a pixel.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct HitText {
    /// None on the cap of a section, and so with the page.
    pub(crate) triangle: Option<u32>,
    pub(crate) material: u32,
    pub(crate) name: String,
    pub(crate) position: [f64; 3],
    /// Diffuse reflectance there, linear: the material's by the colour of the mesh.
    pub(crate) colour: [f32; 3],
    pub(crate) normal: [f32; 3],
    /// `normal` where there is no other.
    pub(crate) shading_normal: [f32; 3],
    pub(crate) distance: f64,
    pub(crate) page: Option<u32>,
}

/// How far a screenshot is.
#[derive(Clone, Copy, Debug, Serialize)]
#[serde(tag = "type", rename = "progress")]
pub(crate) struct ShotProgress {
    pub(crate) id: u32,
    pub(crate) done: u64,
    pub(crate) total: u64,
}

impl TextsText {
    /// The message.
    pub(crate) fn message(&self) -> String {
        #[derive(Serialize)]
        struct Message<'a> {
            #[serde(rename = "type")]
            kind: &'static str,
            #[serde(flatten)]
            texts: &'a TextsText,
        }
        text_of(&Message { kind: "texts", texts: self })
    }
}

impl LightsText {
    /// As pages are told of these.
    pub(crate) fn of(lights: &[trex_render::Light]) -> LightsText {
        let light_count = lights.len();
        LightsText { light_count, lights: (light_count <= LIGHTS_MAX).then(|| lights.to_vec()) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_update_says_what_has_changed_and_no_more() {
        let camera = CameraText { position: [1.0; 3], target: [0.0; 3], up: [0.0, 1.0, 0.0], fov_y: 40.0 };
        let update = State { camera: Some(camera), ..State::default() };
        let text: serde_json::Value = serde_json::from_str(&update.update(Role::Watch, 2)).unwrap();
        let keys: Vec<&str> = text.as_object().unwrap().keys().map(String::as_str).collect();
        assert_eq!(keys.len(), 4);
        assert_eq!(
            (&text["type"], &text["role"], &text["clients"]),
            (&"state".into(), &"watch".into(), &2.into())
        );
        let mut state = State { name: Some("a".into()), size: Some([1, 2]), ..State::default() };
        state.merge(update);
        assert_eq!(
            (state.name.as_deref(), state.size, state.camera),
            (Some("a"), Some([1, 2]), Some(camera))
        );
    }
}
