//! How a session begins: what its scene leaves to be decided is decided by a look at the opening view, a small picture
//! that is made first.
//!
//! ```text
//! light = auto      a look in the light of the model's own lamps: most is dark -> studio, else scene
//! exposure = auto   a look in all light -> a number
//! ```
//!
//! Invariants: 1. what is decided depends on the scene alone, unless the work is to stop first: a look has a seed of
//! its own, is rendered at leisure, and by the processor; 2. a look takes no more memory than the picture that it is
//! for, so that the smallest limit stays; 3. a session has nothing left to be decided, and nothing is decided again
//! while its camera moves.

use crate::handle::{LiveSession, Model, Session};
use crate::options::{Pace, SessionOptions};
use crate::scene_defaults::set_direct_without_voxels;
use std::ops::ControlFlow;
use std::sync::Arc;
use trex_render::{
    Brightness, CpuStage, Event, Exposure, Filter, FrameOptions, Layers, LightRig, Parts, PictureNeeds,
    RenderKeys, Scene,
};
use trex_store::{Result, StopSignal};

/// Greater side of a look, pixels.
const LOOK_SIDE: u32 = 96;
/// Side of a picture over that of a look, at least: with the depth that a look keeps, its film is the smaller one.
const LOOK_RATIO: u32 = 2;
/// Numbers of a look, at most: its percentiles have an error of a hundredth or two.
const LOOK_SPP: u32 = 4;
const LOOK_RAYS: u32 = 2;
const LOOK_PHOTONS: u64 = 1 << 16;
/// Share of the opening view that may stay dark, background and all, in the light of the model's own lamps.
const DARK_SHARE_MAX: f64 = 0.5;

impl Model {
    /// A session on what `scene` describes, with an empty film, for pictures at leisure. Where the scene says nothing
    /// of how light is computed, and the file has no voxels, light is direct. `auto` in a scene is decided here: the
    /// session's view says what it came to.
    ///
    /// # Errors
    /// [`trex_store::Code::SceneFormat`] for a scene that does not go with this model;
    /// [`trex_store::Code::MemoryLimit`] with the smallest limit that works; those of opening the file's octree and of
    /// starting the pool.
    pub fn session(&self, scene: &Scene) -> Result<Session> {
        self.session_with(scene, &SessionOptions::default())
    }

    /// As [`Model::session`], with these options.
    ///
    /// # Errors
    /// Those of [`Model::session`].
    pub fn session_with(&self, scene: &Scene, options: &SessionOptions) -> Result<Session> {
        self.session_until(scene, options, &StopSignal::default())
    }

    /// As [`Model::session_with`], until `stop`: what would have been decided by a look that it ends is as nobody had
    /// asked for it, lights of the scene and an exposure of 1.
    ///
    /// # Errors
    /// Those of [`Model::session`].
    pub fn session_until(
        &self,
        scene: &Scene,
        options: &SessionOptions,
        stop: &StopSignal,
    ) -> Result<Session> {
        let mut scene = scene.clone();
        set_direct_without_voxels(&mut scene, self.file().superblock());
        if scene.render.light == LightRig::Auto || scene.render.exposure == Exposure::Auto {
            // The pool is started for the picture, which leaves fewer frames than a look; and what is refused is
            // refused with the numbers of the picture.
            self.fit_pool(&options.picture_needs(&scene, self.worker_count())?)?;
            self.decide(&mut scene, stop)?;
        }
        self.begin_session(&scene, options, None)
    }

    /// A session on what `scene` describes, for pictures in frames with a deadline. Where the scene says nothing,
    /// frames come sooner: see [`Scene::begin_live`]. Of a file without voxels nothing stands in for what is missing.
    ///
    /// # Errors
    /// Those of [`Model::session`].
    pub fn live(&self, scene: &Scene, options: FrameOptions) -> Result<LiveSession> {
        let mut scene = scene.clone();
        scene.begin_live();
        let in_frames = SessionOptions { pace: Pace::InFrames, ..SessionOptions::default() };
        self.session_with(&scene, &in_frames)?.go_live(self.planned_frames(options))
    }

    /// Has `session`, one of [`Model::live`], show other parts; frames of pages make room for what these take.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] with the smallest limit that works; nothing has changed then.
    pub fn show_parts(&self, session: &mut LiveSession, parts: &Arc<Parts>) -> Result<()> {
        let in_frames = SessionOptions { pace: Pace::InFrames, ..SessionOptions::default() };
        let after = in_frames.needs_of(session.view().settings, self.worker_count());
        let after = PictureNeeds { parts: parts.needs(), ..after };
        let before = &session.view().parts;
        let leaves = session.model().voxels.as_ref().map_or(0, |voxels| voxels.octree().leaf_count());
        let meanwhile = PictureNeeds {
            parts: parts.needs().beside(before.needs()),
            copies_bytes: after.copies_bytes + parts.exchange_bytes(before, leaves),
            ..after
        };
        let fit_light = |session: &mut LiveSession, picture| {
            // What cannot be planned is refused by who makes room for it.
            if let Ok(bytes) = self.kept_light_bytes(&[picture], None) {
                session.keep_light_within(bytes);
            }
        };
        let on_show = PictureNeeds { parts: before.needs(), ..after };
        fit_light(session, meanwhile);
        let shown = self.exchange(&meanwhile, || session.apply(Event::Parts(parts.clone())));
        if shown.is_err() {
            fit_light(session, on_show);
        }
        shown?;
        // What was for the change alone is for frames of pages again.
        self.make_room(&[after])?;
        fit_light(session, after);
        Ok(())
    }

    /// Decides what `scene` leaves open.
    fn decide(&self, scene: &mut Scene, stop: &StopSignal) -> Result<()> {
        let method = scene.render.integrator;
        let mut seen = None;
        if scene.render.light == LightRig::Auto {
            scene.render.light = LightRig::Scene;
            let has_own_lamps = scene.lights.is_empty() && !self.file().emitters().is_empty();
            if has_own_lamps && method.has_exposure() {
                seen = self.look(scene, stop)?;
                if seen.take_if(|look| look.dark_share() > DARK_SHARE_MAX).is_some() {
                    scene.render.light = LightRig::Studio;
                }
            }
        }
        if scene.render.exposure == Exposure::Auto {
            let factor = match seen {
                _ if !method.has_exposure() => None,
                Some(look) => look.exposure(),
                None => self.look(scene, stop)?.and_then(|look| look.exposure()),
            };
            scene.render.exposure = Exposure::Factor(factor.unwrap_or(1.0));
        }
        Ok(())
    }

    /// What the opening view of `scene` shows; `None` where the work stopped before all of it was seen.
    fn look(&self, scene: &Scene, stop: &StopSignal) -> Result<Option<Brightness>> {
        let keys = scene.render;
        let mut small = scene.clone();
        small.render = RenderKeys {
            resolution: look_resolution(keys.resolution),
            spp: LOOK_SPP,
            n_shadow: keys.n_shadow.min(LOOK_RAYS),
            n_gather: keys.n_gather.min(LOOK_RAYS),
            photons: keys.photons.min(LOOK_PHOTONS),
            filter: Filter::Off,
            seed: RenderKeys::default().seed,
            ..keys
        };
        let options = SessionOptions {
            layers: Layers { depth: true, ..Layers::default() },
            ..SessionOptions::default()
        };
        let mut session = self.begin_session(&small, &options, Some(Box::new(CpuStage::default())))?;
        session.stop_by(stop);
        session.illuminate(&|| stop.is_due(), &mut |_, _| {})?;
        let seen = session.render(LOOK_SPP, &|| stop.is_due(), &mut |_, _| ControlFlow::Continue(()));
        Ok((seen.spp > 0).then(|| Brightness::of_film(session.film())))
    }
}

/// The size of a look at a picture of `resolution`, of its shape.
fn look_resolution(resolution: [u32; 2]) -> [u32; 2] {
    let greater = resolution[0].max(resolution[1]);
    let side = LOOK_SIDE.min(greater / LOOK_RATIO).max(1);
    resolution.map(|of| (u64::from(of) * u64::from(side) / u64::from(greater)).max(1) as u32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_look_is_small_and_of_the_shape_of_its_picture() {
        for (resolution, expected) in [
            ([1280, 720], [96, 54]),
            ([720, 1280], [54, 96]),
            ([64, 48], [32, 24]),
            ([1, 1], [1, 1]),
            ([65_536, 1], [96, 1]),
        ] {
            assert_eq!(look_resolution(resolution), expected);
        }
    }
}
