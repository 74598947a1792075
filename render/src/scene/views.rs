//! Views: a list of viewpoints as a TOML text, `[[view]]` with `position`, `target` and, if one likes, `up`.

use super::camera::Camera;
use super::text::line_of;
use serde::Deserialize;
use trex_store::{Code, Error, Result};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ViewsText {
    #[serde(default)]
    view: Vec<ViewText>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct ViewText {
    position: [f64; 3],
    target: [f64; 3],
    up: Option<[f64; 3]>,
}

/// The viewpoints of a TOML text, otherwise like `camera`. At least one.
///
/// # Errors
/// [`Code::SceneFormat`], without a place: what the parser says, with the line; no view at all.
pub fn parse_views(text: &str, camera: &Camera) -> Result<Vec<Camera>> {
    let bad = |numbers: String| {
        Error::new(Code::SceneFormat, "this is no list of views")
            .numbers(numbers)
            .next("write a [[view]] with position = [x, y, z] and target = [x, y, z] for each")
    };
    let text: ViewsText = toml::from_str(text).map_err(|error| {
        let error_line = line_of(&error, text).map_or(String::new(), |line| format!("line {line}: "));
        bad(error_line + error.message().trim())
    })?;
    if text.view.is_empty() {
        return Err(bad("there is no [[view]]".into()));
    }
    let like = |view: &ViewText| Camera {
        position: view.position,
        target: view.target,
        up: view.up.unwrap_or(camera.up),
        fov: camera.fov,
    };
    Ok(text.view.iter().map(like).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use trex_store::Aabb;

    #[test]
    fn views_are_read_and_refused() {
        let camera = Camera::framing(&Aabb { lo: [0.0; 3], hi: [1.0; 3] }, [64, 64], None, None);
        let text = "[[view]]\nposition = [1, 2, 3]\ntarget = [0, 0, 0]\n[[view]]\nposition = [1, 0, 0]\n\
                    target = [0, 0, 0]\nup = [0, 0, 1]";
        let list = parse_views(text, &camera).unwrap();
        assert_eq!((list.len(), list[0].position, list[1].up), (2, [1.0, 2.0, 3.0], [0.0, 0.0, 1.0]));
        assert!(parse_views("", &camera).is_err() && parse_views("view = 3", &camera).is_err());
        assert!(
            parse_views("[[view]]\nposition = [1, 2, 3]", &camera)
                .unwrap_err()
                .to_string()
                .contains("target")
        );
    }
}
