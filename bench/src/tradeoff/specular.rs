//! Where a view shows gloss, and where mirrors: what the ray through the middle of each pixel meets first.
//!
//! Invariant: masks have a flag a pixel, row by row; no pixel is in both.

use super::regions::Mask;
use std::path::Path;
use trex_model::{Model, OpenOptions, open_scene};
use trex_render::{CameraKeys, Exposure, LightRig};
use trex_store::Interrupt;

/// Reflectance from which a surface counts as glossy, in any channel.
const GLOSS_LEAST: f32 = 0.02;

/// What is looked at.
pub(super) struct SeenView<'a> {
    /// A page file, or a scene that names one.
    pub(super) model: &'a Path,
    /// The camera, where it is not the scene's.
    pub(super) camera: Option<CameraKeys>,
    /// Pixels across and down.
    pub(super) resolution: [u32; 2],
    /// Most memory that the look takes.
    pub(super) limit_bytes: u64,
}

/// The masks `gloss` and `mirror` of a view.
///
/// # Errors
/// Those of the scene, of the page file, and of its pages; [`trex_store::Code::Interrupted`].
pub(super) fn masks(view: &SeenView<'_>, interrupt: &Interrupt) -> anyhow::Result<[Mask; 2]> {
    let (mut scene, file) = open_scene(view.model)?;
    scene.camera = view.camera.unwrap_or(scene.camera);
    scene.render.resolution = view.resolution;
    // Rays through pixels are all that is asked for: no look that decides on light.
    (scene.render.light, scene.render.exposure) = (LightRig::Scene, Exposure::Factor(1.0));
    let mut session = Model::open(&file, &OpenOptions::with_limit(view.limit_bytes))?.session(&scene)?;
    let [width, height] = view.resolution;
    let mut masks = [("gloss", Vec::new()), ("mirror", Vec::new())];
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        interrupt.check()?;
        let seen = session.pick_until([x, y], &|| interrupt.is_raised());
        let material = seen.map(|seen| session.model().materials[seen.shaded.hit.material as usize]);
        let is_mirror = material.is_some_and(|material| material.mirror);
        let is_specular = material.is_some_and(|material| material.ks.iter().any(|ks| *ks >= GLOSS_LEAST));
        masks[0].1.push(is_specular && !is_mirror);
        masks[1].1.push(is_mirror);
    }
    Ok(masks)
}
