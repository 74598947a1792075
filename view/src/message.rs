//! The messages of the protocol that are text: JSON objects told apart by their key `type`.
//!
//! Invariants: 1. what comes in has no key that is unknown, and is checked by who gets it, not here; 2. names and units
//! are those of scene files where there are such.

use crate::parts::PartsWish;
use crate::wire::LIGHTS_MAX;
use serde::{Deserialize, Deserializer, Serialize};
use trex_render::{Camera, Fov, Light, MaterialEdit, RenderEdit};
use trex_store::Error;

/// Longest message from a client, bytes.
pub(crate) const MESSAGE_BYTES_MAX: usize = 64 << 10;

/// A message from a client.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
pub(crate) enum FromClient {
    /// The first of all.
    Hello { token: String, size: [u32; 2], frame: Option<u32> },
    /// The picture of a frame is drawn.
    Ack { frame: u32 },
    /// Another camera; the latest counts.
    Camera { seq: u32, position: [f64; 3], target: [f64; 3], up: [f64; 3], fov_y: f64 },
    /// The hand has let go.
    Rest {},
    /// All lights.
    Lights {
        seq: u32,
        #[serde(deserialize_with = "few_lights")]
        lights: Vec<Light>,
    },
    /// Changes to a material.
    Material { seq: u32, index: usize, edit: MaterialEdit },
    /// Changes to the numbers of the picture.
    Settings {
        seq: u32,
        #[serde(deserialize_with = "without_size")]
        settings: RenderEdit,
    },
    /// Other parts of the model; all that is said of them.
    Parts { seq: u32, parts: PartsWish },
    /// Another size of the picture, pixels.
    Size { seq: u32, size: [u32; 2] },
    /// Another limit for the memory of pages.
    Limit { seq: u32, bytes: u64 },
    /// Pixels from one to the next while the picture moves; 0: what fits into a frame.
    Moving { scale: u32 },
    /// What is at a pixel?
    Pick { id: u32, pixel: [u32; 2] },
    /// A part of the list of materials: of those whose name holds `find`, from the `from`-th on; or the part in which
    /// `index` is.
    Materials {
        id: u32,
        #[serde(default)]
        find: String,
        #[serde(default)]
        from: usize,
        index: Option<usize>,
    },
    /// The scene's text as a file.
    Scene { id: u32 },
    /// A picture as a file.
    Screenshot { id: u32, format: Format, size: [u32; 2], spp: u32 },
    /// No picture as a file, after all.
    Cancel { id: u32 },
    /// Asks to be the one who drives.
    Drive {},
}

/// Changes to numbers; the size has a message of its own, with bounds of its own.
fn without_size<'de, D: Deserializer<'de>>(deserializer: D) -> Result<RenderEdit, D::Error> {
    let edit = RenderEdit::deserialize(deserializer)?;
    match edit.resolution {
        None => Ok(edit),
        Some(_) => Err(serde::de::Error::custom("the size is no setting")),
    }
}

/// Lights that pages can show and send.
fn few_lights<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Light>, D::Error> {
    let lights = Vec::<Light>::deserialize(deserializer)?;
    if lights.len() > LIGHTS_MAX {
        let count = lights.len();
        return Err(serde::de::Error::custom(format!("{count} lights, at most {LIGHTS_MAX} from a page")));
    }
    Ok(lights)
}

/// Format of a screenshot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Format {
    Png,
    Exr,
}

/// A camera.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct CameraText {
    pub(crate) position: [f64; 3],
    pub(crate) target: [f64; 3],
    pub(crate) up: [f64; 3],
    /// Degrees.
    pub(crate) fov_y: f64,
}

impl CameraText {
    /// A camera of pictures of `resolution`.
    pub(crate) fn of(camera: &Camera, [width, height]: [u32; 2]) -> CameraText {
        let Camera { position, target, up, fov } = *camera;
        let fov_y = match fov {
            Fov::Y(degrees) => degrees,
            Fov::X(degrees) => {
                let half = (0.5 * degrees).to_radians().tan() * f64::from(height) / f64::from(width);
                2.0 * half.atan().to_degrees()
            }
        };
        CameraText { position, target, up, fov_y }
    }

    /// The renderer's form, not checked.
    pub(crate) fn camera(&self) -> Camera {
        let CameraText { position, target, up, fov_y } = *self;
        Camera { position, target, up, fov: Fov::Y(fov_y) }
    }
}

/// The part of a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(crate) enum Role {
    Drive,
    Watch,
}

/// A word to the user.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "type", rename = "notice")]
pub(crate) struct Notice {
    level: &'static str,
    code: String,
    text: String,
    place: String,
    numbers: String,
    next: String,
}

impl Notice {
    /// What went wrong.
    pub(crate) fn error(error: &Error) -> Notice {
        Notice {
            level: "error",
            code: error.code().as_str().into(),
            text: error.what().into(),
            place: error.place().into(),
            numbers: error.numbers_text().into(),
            next: error.next_step().into(),
        }
    }

    /// The same, of a code by which the page knows what has ended.
    pub(crate) fn of(self, code: &str) -> Notice {
        Notice { code: code.into(), ..self }
    }

    /// A message that cannot be read.
    pub(crate) fn wrong(why: &str) -> Notice {
        Notice {
            level: "error",
            code: "message".into(),
            text: "this message cannot be read".into(),
            place: "a message of this page".into(),
            numbers: why.into(),
            next: "load the page again".into(),
        }
    }

    /// A screenshot that nobody wants any more.
    pub(crate) fn cancelled() -> Notice {
        Notice::info("screenshot", "the picture was cancelled", "")
    }

    /// Something to know.
    pub(crate) fn info(code: &str, text: &str, next: &str) -> Notice {
        Notice {
            level: "info",
            code: code.into(),
            text: text.into(),
            place: String::new(),
            numbers: String::new(),
            next: next.into(),
        }
    }
}

/// A message as it is sent.
pub(crate) fn text_of(message: &impl Serialize) -> String {
    // Numbers that are none become `null`.
    serde_json::to_string(message).expect("messages are maps with string keys")
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_pcg::Pcg64Mcg;
    use rand_pcg::rand_core::{Rng, SeedableRng};

    /// One of each.
    const GOOD: [&str; 20] = [
        r#"{"type":"hello","token":"00","size":[1280,720]}"#,
        r#"{"type":"hello","token":"00","size":[1280,720],"frame":7}"#,
        r#"{"type":"ack","frame":3}"#,
        r#"{"type":"camera","seq":1,"position":[0,1,2.5],"target":[0,0,0],"up":[0,1,0],"fov_y":40}"#,
        r#"{"type":"rest"}"#,
        r#"{"type":"lights","seq":2,"lights":[{"type":"sky","radiance":[1,1,1]}]}"#,
        r#"{"type":"material","seq":3,"index":0,"edit":{"kd":[0.5,0.5,0.5],"mirror":false}}"#,
        r#"{"type":"settings","seq":4,"settings":{"integrator":"full-gi","near":"exact","filter":"on"}}"#,
        r#"{"type":"parts","seq":5,"parts":{"section":[[0,1,2.5,0,0,-1]],"hide":[0,7]}}"#,
        r#"{"type":"parts","seq":5,"parts":{"only":[3]}}"#,
        r#"{"type":"size","seq":5,"size":[640,360]}"#,
        r#"{"type":"limit","seq":6,"bytes":134217728}"#,
        r#"{"type":"moving","scale":4}"#,
        r#"{"type":"pick","id":9,"pixel":[3,4]}"#,
        r#"{"type":"screenshot","id":9,"format":"exr","size":[64,64],"spp":4}"#,
        r#"{"type":"cancel","id":9}"#,
        r#"{"type":"materials","id":9,"find":"bolt","from":24}"#,
        r#"{"type":"materials","id":9,"index":7}"#,
        r#"{"type":"scene","id":9}"#,
        r#"{"type":"drive"}"#,
    ];

    fn read(text: &str) -> Result<FromClient, serde_json::Error> {
        serde_json::from_str(text)
    }

    #[test]
    fn every_message_is_read() {
        for text in GOOD {
            read(text).unwrap_or_else(|error| panic!("{text}: {error}"));
        }
    }

    #[test]
    fn lights_are_bounded() {
        let lights = |count: usize| {
            let sky = r#"{"type":"sky","radiance":[1,1,1]}"#;
            format!(r#"{{"type":"lights","seq":2,"lights":[{}]}}"#, vec![sky; count].join(","))
        };
        assert!(read(&lights(LIGHTS_MAX)).is_ok());
        let error = read(&lights(LIGHTS_MAX + 1)).unwrap_err().to_string();
        assert!(error.contains("129 lights, at most 128"), "{error}");
    }

    #[test]
    fn what_is_not_known_or_out_of_place_is_refused() {
        for text in GOOD {
            let odd = text.replacen('{', r#"{"odd":1,"#, 1);
            assert!(read(&odd).is_err(), "{odd}");
        }
        for text in [
            "",
            "[]",
            "{}",
            r#"{"type":"file","path":"/etc/passwd"}"#,
            r#"{"type":"ack","frame":-1}"#,
            r#"{"type":"ack","frame":4294967296}"#,
            r#"{"type":"pick","id":1,"pixel":[1,2,3]}"#,
            r#"{"type":"camera","seq":1,"position":[0,1,null],"target":[0,0,0],"up":[0,1,0],"fov_y":40}"#,
            r#"{"type":"lights","seq":2,"lights":[{"type":"sky","radiance":[1,1,1],"power":3}]}"#,
            r#"{"type":"settings","seq":4,"settings":{"resolution":[1,1]}}"#,
        ] {
            assert!(read(text).is_err(), "{text}");
        }
        let deep = "[".repeat(MESSAGE_BYTES_MAX);
        assert!(read(&deep).is_err());
    }

    #[test]
    fn bytes_of_any_kind_are_survived() {
        let mut random = Pcg64Mcg::seed_from_u64(5);
        for turn in 0..30_000 {
            let mut bytes = GOOD[turn % GOOD.len()].as_bytes().to_vec();
            for _ in 0..1 + random.next_u32() % 4 {
                let at = random.next_u32() as usize % bytes.len();
                bytes[at] = b"0123456789-+eE.,:{}[]\"tnull\\ \xff"[random.next_u32() as usize % 30];
            }
            let _ = serde_json::from_slice::<FromClient>(&bytes);
        }
    }

    #[test]
    fn lights_come_back_as_they_went() {
        let lights = [
            Light::Point { position: [0.1, 2.0, 3.0], intensity: [1.0, 0.1, 1e-30] },
            Light::Rect { corner: [0.0; 3], edge_u: [1.0; 3], edge_v: [1e9; 3], radiance: [3.0; 3] },
        ];
        for light in lights {
            let text = text_of(&light);
            assert_eq!(serde_json::from_str::<Light>(&text).unwrap(), light, "{text}");
        }
    }

    #[test]
    fn angles_are_those_from_top_to_bottom() {
        let camera = Camera { position: [0.0; 3], target: [1.0; 3], up: [0.0, 1.0, 0.0], fov: Fov::X(90.0) };
        let text = CameraText::of(&camera, [200, 100]);
        assert!((text.fov_y - 2.0 * 0.5f64.atan().to_degrees()).abs() < 1e-12);
        assert_eq!(CameraText::of(&text.camera(), [1, 1]), text);
    }
}
