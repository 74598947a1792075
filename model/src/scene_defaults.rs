//! What a scene means where it says nothing: for a session that is looked at while it changes, and for a file that has no
//! voxels.
//!
//! Invariant: what the scene says is never changed.

use trex_render::{Filter, Method, RenderEdit, RenderKeys, Scene};
use trex_store::layout::{SectionKind, Superblock};

/// The defaults of a session that is looked at while it changes: frames come sooner without the filter and, without a
/// scene, with the footprint rule; photons go on coming while the picture is looked at.
pub fn set_live_defaults(scene: &mut Scene) {
    let is_quality_given = scene.given.quality.is_some();
    if scene.model.is_empty() && scene.given.lod_error.is_none() {
        scene.render.lod_error = 1.0;
    }
    if scene.given.filter.is_none() && !is_quality_given {
        scene.render.filter = Filter::Off;
    }
    if scene.given.photons.is_none() && !is_quality_given {
        scene.render.photons = RenderKeys::default().photons;
    }
}

/// Sets direct light in a scene that says nothing of how light is computed, where the default needs voxels and the file
/// with this superblock has none. True when that was so.
pub fn set_direct_without_voxels(scene: &mut Scene, file: &Superblock) -> bool {
    let is_given = scene.given.says_integrator();
    let has_voxels = file.find_section(SectionKind::Upper).is_some();
    if is_given || has_voxels || !scene.render.integrator.needs_voxels() {
        return false;
    }
    let direct = RenderEdit { integrator: Some(Method::Direct), ..RenderEdit::default() };
    scene.render = direct.apply(&scene.render);
    true
}
