//! What a scene means where it says nothing, for a file that has no voxels. What it means for a session that is looked
//! at while it changes says [`Scene::begin_live`].
//!
//! Invariant: what the scene says is never changed.

use trex_render::{Method, RenderEdit, Scene};
use trex_store::layout::{SectionKind, Superblock};

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
