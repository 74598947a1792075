//! The scene that a file is, or is of, and what it means where it says nothing, for a file that has no voxels. What it
//! means for a session that is looked at while it changes says [`Scene::begin_live`].
//!
//! Invariant: what the scene says is never changed.

use std::path::{Path, PathBuf};
use trex_render::{Method, RenderEdit, Scene};
use trex_store::layout::{SectionKind, Superblock};
use trex_store::{Error, Result, is_url, open_regular};

/// A `.toml` is a scene that names a page file; anything else is a page file, which is lit and shown so that all of it
/// can be seen. Gives the scene, and where the page file is.
///
/// # Errors
/// Those of reading the file, and of [`Scene::parse`].
pub fn open_scene(file: &Path) -> Result<(Scene, PathBuf)> {
    if !file.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("toml")) {
        return Ok((Scene::of_file(), file.to_path_buf()));
    }
    let text = std::io::read_to_string(open_regular(file)?)
        .map_err(|error| Error::io("read the scene", file, &error))?;
    let scene = Scene::parse(&text, file)?;
    // An address stands for itself.
    let is_whole = is_url(Path::new(&scene.model));
    let model = if is_whole {
        PathBuf::from(&scene.model)
    } else {
        file.parent().unwrap_or(Path::new("")).join(&scene.model)
    };
    Ok((scene, model))
}

/// Sets direct light in a scene that says nothing of how light is computed, where the default needs voxels and the file
/// with this superblock has none. True when that was so. The footprint rule, which needs them as well, is off where
/// nobody has asked for it.
pub fn set_direct_without_voxels(scene: &mut Scene, file: &Superblock) -> bool {
    if file.find_section(SectionKind::Upper).is_some() {
        return false;
    }
    if scene.given.lod_error.is_none() {
        scene.render.lod_error = 0.0;
    }
    if scene.given.says_integrator() || !scene.render.integrator.needs_voxels() {
        return false;
    }
    let direct = RenderEdit { integrator: Some(Method::Direct), ..RenderEdit::default() };
    scene.render = direct.apply(&scene.render);
    true
}
