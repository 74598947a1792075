//! The scene that `build` writes beside its output, of what the inputs say of cameras and lights.
//!
//! Invariant: no file is replaced, and the file is there when it is whole.

use std::fmt::Write as _;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use trex_store::output::draft;
use trex_store::{SourceLight, SourceScene};

/// Path of the scene beside an output.
fn path_beside(output: &Path) -> PathBuf {
    output.with_extension("toml")
}

/// Writes the scene of a model at `output`, where there is something to write. Gives a line to tell of it.
pub fn write(scene: &SourceScene, output: &Path) -> Option<String> {
    if scene.is_empty() {
        return None;
    }
    let path = path_beside(output);
    let counted = match (scene.camera.is_some(), scene.lights.len()) {
        (true, 0) => "the camera".to_owned(),
        (true, lights) => format!("the camera and {lights} lights"),
        (false, lights) => format!("{lights} lights"),
    };
    let written = text(scene, output).map(|text| persist(&path, output, &text));
    Some(match written {
        Some(Ok(())) => format!("{counted} of the input: {}", path.display()),
        Some(Err(error)) if error.kind() == io::ErrorKind::AlreadyExists => {
            format!("note: {counted} of the input are not written: {} is there", path.display())
        }
        Some(Err(error)) => {
            format!("note: {counted} of the input cannot be written to {}: {error}", path.display())
        }
        None => format!("note: {counted} of the input are not written: no scene can name the output"),
    })
}

fn persist(path: &Path, output: &Path, text: &str) -> io::Result<()> {
    // Asked first, so that nothing is written in vain; the last word has the rename, which replaces nothing.
    if path.symlink_metadata().is_ok() || path == output {
        return Err(io::ErrorKind::AlreadyExists.into());
    }
    let mut file = draft(path)?;
    file.write_all(text.as_bytes())?;
    file.as_file().sync_all()?;
    file.persist_noclobber(path).map_err(|error| error.error)?;
    Ok(())
}

/// The scene as text; `None` where no text can name the output.
fn text(scene: &SourceScene, output: &Path) -> Option<String> {
    let name = output.file_name()?.to_str().filter(|name| !name.contains(|c: char| c.is_control()))?;
    let mut text = String::from("# Camera and lights of the input. Candela count as W/sr, lux as W/m^2.\n");
    let mut line = |line: String| {
        let _ = writeln!(text, "{line}");
    };
    // What JSON writes between quotes TOML reads.
    line(format!("model = {}", serde_json::Value::from(name)));
    if let Some(camera) = &scene.camera {
        let target: [f64; 3] = std::array::from_fn(|axis| camera.position[axis] + camera.direction[axis]);
        line(format!("\n[camera]\nposition = {:?}\ntarget = {target:?}", camera.position));
        line(format!("up = {:?}\nfov_y = {:?}", camera.up, camera.fov_y_degrees));
    }
    for light in &scene.lights {
        match light {
            SourceLight::Point { position, intensity, is_spot } => {
                let what = if *is_spot { " # a spot in the input, which shines into a cone" } else { "" };
                line(format!("\n[[light]]\ntype = \"point\"{what}"));
                line(format!("position = {position:?}\nintensity = {intensity:?}"));
            }
            SourceLight::Directional { direction, irradiance } => {
                line(format!("\n[[light]]\ntype = \"directional\"\ndirection = {direction:?}"));
                line(format!("irradiance = {irradiance:?}"));
            }
        }
    }
    Some(text)
}
