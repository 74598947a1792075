//! What pages want of the session, done: events, sizes, limits, picks, screenshots.
//!
//! Invariant: what is refused changes nothing; who asked is told, and what is true instead.

use crate::mail::{ClientId, Edit, Mail, Question};
use crate::materials::{list, material_text, name_of};
use crate::message::{CameraText, Notice, text_of};
use crate::outbox::{File, FileFormat};
use crate::parts::{PartsText, PartsWish};
use crate::session_loop::SessionLoop;
use crate::settings::{KeyText, SettingsText};
use crate::state::{BoundsText, HitText, LightsText, LimitText, PickAnswer, Smaller, State};
use crate::surroundings::Room;
use crate::texts;
use crate::wire::BLOCK_SIDE;
use trex_render::{
    Event, Exposure, Hit, LightRig, Model, PagedTracer, Pick, RenderKeys, RenderSettings, ShadedHit, View,
    up_axis,
};
use trex_store::{Code, Error, Result};

/// Most pixels on a side of a picture that follows a page.
pub const SIDE_MAX: u32 = 16_384;
/// Most pixels of a picture that follows a page: those whose blocks have numbers.
const PIXELS_MAX: u64 = 65_000 * (BLOCK_SIDE * BLOCK_SIDE) as u64;

/// Where there is no memory for a picture, one whose sides are so much of its is tried.
const SMALLER: [u32; 2] = [7, 8];

/// Which way is up in the model.
fn up_of(view: &View, model: &Model) -> [f64; 3] {
    view.settings.up.direction().unwrap_or_else(|| up_axis(&model.bounds))
}

impl<T: PagedTracer + Send> SessionLoop<'_, T> {
    /// Says all there is to say to who comes.
    pub(crate) fn greet(&mut self) {
        let session = self.session();
        let (view, model) = (session.view(), session.model());
        let resolution = view.settings.resolution;
        let camera = CameraText::of(&view.camera, resolution);
        let views = self.around.views.iter().map(|camera| CameraText::of(camera, resolution)).collect();
        let state = State {
            name: Some(self.around.name.to_owned()),
            smaller: Some(None),
            follows_page: Some(self.options.follows_page),
            bounds: Some(BoundsText { lo: model.bounds.lo, hi: model.bounds.hi }),
            home: Some(camera),
            views: Some(views),
            keys: Some(KeyText::all()),
            sides: Some([BLOCK_SIDE, SIDE_MAX]),
            model: Some(self.around.model),
            device: Some(self.around.device_name.to_owned()),
            t_max_ms: Some(self.options.frames.t_max.as_secs_f64() * 1e3),
            memory: Some(LimitText { limit_bytes: self.around.budget.limit_bytes() }),
            material_count: Some(model.materials.len()),
            damage: Some((self.around.damage)()),
            texts: Some(self.texts()),
            ..self.whole_state()
        };
        self.shared.set_greeting(state);
    }

    /// All that events may change, but materials: who asks for a part of their list gets them as they are.
    fn whole_state(&self) -> State {
        let session = self.session();
        let view = session.view();
        State {
            up: Some(up_of(view, session.model())),
            size: Some(view.settings.resolution),
            camera: Some(CameraText::of(&view.camera, view.settings.resolution)),
            lights: Some(LightsText::of(&view.lights)),
            parts: Some(PartsText::of(&view.parts, session.model().materials.len())),
            settings: Some(SettingsText::from(&*view.settings)),
            ..State::default()
        }
    }

    /// Does what `mail` asks for.
    ///
    /// # Errors
    /// The session cannot go on.
    pub(crate) fn apply_mail(&mut self, mail: Mail) -> Result<()> {
        let Mail { camera, size, limit_bytes, edits, questions, shot, seq, author, rest, roles, since } =
            mail;
        self.seq = seq.unwrap_or(self.seq);
        self.author = author;
        if let Some(bytes) = limit_bytes {
            self.set_limit(bytes);
        }
        // What was asked for may fit under another limit.
        let asked = self.smaller.filter(|_| limit_bytes.is_some()).map(|smaller| smaller.asked);
        // Before what tells the camera with other things: it would be the one of before.
        if let Some(camera) = camera {
            let changed = self
                .session_mut()
                .apply(Event::Camera(camera.camera()))
                .map(|()| State { camera: Some(camera), ..State::default() });
            self.motion.event();
            self.publish_change(changed, since);
        }
        if let Some(size) = size.or(asked).filter(|_| self.options.follows_page) {
            let changed = self.set_size(fitting(size));
            self.publish_change(changed, since);
        }
        for edit in edits {
            let material = if let Edit::Material(index, _) = edit { Some(index) } else { None };
            let changed = self.edit(edit);
            if let (Err(_), Some(index)) = (&changed, material) {
                let material = material_text(self.session().model(), index);
                self.shared.send_state(State { material, ..State::default() }, None);
            }
            self.publish_change(changed, since);
        }
        self.author = None;
        if rest {
            self.motion.rest();
        }
        for (client, question) in questions {
            self.answer(client, question);
        }
        if roles {
            self.shared.send_state(State::default(), None);
        }
        if let Some(shot) = shot {
            self.make_screenshot(shot)?;
        }
        Ok(())
    }

    /// Does an edit. Gives what has changed of the state.
    fn edit(&mut self, edit: Edit) -> Result<State> {
        match edit {
            Edit::Moving(scale) => {
                self.motion.set_scale(scale);
                Ok(State::default())
            }
            Edit::Lights(lights) => {
                self.motion.event();
                let told = LightsText::of(&lights);
                self.session_mut().apply(Event::Lights(lights))?;
                Ok(State { lights: Some(told), ..State::default() })
            }
            Edit::Material(index, edit) => {
                self.motion.event();
                self.session_mut().apply(Event::Material { index, edit })?;
                let material = material_text(self.session().model(), index);
                Ok(State { material, ..State::default() })
            }
            Edit::Parts(wish) => {
                self.motion.event();
                self.show_parts(&wish)
            }
            Edit::Settings(edit) => {
                let keys = self.decided(edit.apply(&self.session().view().settings));
                self.set_settings(RenderSettings::new(keys)?)
            }
        }
    }

    /// Shows other parts of the model.
    fn show_parts(&mut self, wish: &PartsWish) -> Result<State> {
        let view = self.session().view();
        let (settings, before) = (view.settings, view.parts.clone());
        let material_count = self.session().model().materials.len();
        let parts = wish.parts(&before, material_count)?;
        if parts == before {
            return Ok(State::default());
        }
        let (now, exchange) = (self.room(settings), self.around.exchange);
        let after = Room { parts: parts.needs(), ..now };
        let leaves = self.session().model().voxels.as_ref().map_or(0, |voxels| voxels.octree().leaf_count());
        let meanwhile = Room {
            parts: parts.needs().beside(before.needs()),
            copies_bytes: now.copies_bytes + parts.exchange_bytes(&before, leaves),
            ..now
        };
        self.fit_light(&[meanwhile], None);
        let shown = exchange(meanwhile, &mut || self.session_mut().apply(Event::Parts(parts.clone())));
        self.fit_light_on_show();
        shown?;
        self.are_parts_edited = true;
        // What was for the change alone is for frames of pages again.
        self.make_room(&[after])?;
        Ok(State { parts: Some(PartsText::of(&parts, material_count)), ..State::default() })
    }

    /// `keys` without what is to be decided: the exposure is, by what is on show. It stays until it is asked for again,
    /// as lamps stay what they are.
    fn decided(&self, keys: RenderKeys) -> RenderKeys {
        let old = self.session().view().settings;
        let exposure = match keys.exposure {
            Exposure::Auto => {
                let factor = self.session().brightness().exposure();
                factor.map_or(old.exposure, Exposure::Factor)
            }
            given => given,
        };
        let light = if keys.light == LightRig::Auto { old.light } else { keys.light };
        RenderKeys { exposure, light, ..keys }
    }

    /// Sets the size of the picture, or the largest below it that memory allows: that is told once a size.
    fn set_size(&mut self, size: [u32; 2]) -> Result<State> {
        let (mut resolution, mut refused) = (size, None);
        let changed = loop {
            let keys = RenderKeys { resolution, ..*self.session().view().settings };
            let changed = RenderSettings::new(keys).and_then(|settings| self.set_settings(settings));
            let smaller = resolution.map(|side| (side * SMALLER[0] / SMALLER[1]).max(BLOCK_SIDE));
            match changed {
                Err(error) if error.code() == Code::MemoryLimit && smaller != resolution => {
                    refused.get_or_insert(Smaller { asked: size, limit_bytes: error.smallest_limit_bytes() });
                    resolution = smaller;
                }
                changed => break changed?,
            }
        };
        if refused != self.smaller {
            self.smaller = refused;
            self.shared.send_state(State { smaller: Some(refused), ..State::default() }, None);
        }
        Ok(changed)
    }

    /// Sets the numbers of the picture.
    fn set_settings(&mut self, settings: RenderSettings) -> Result<State> {
        let old = self.session().view().settings;
        if settings == old {
            return Ok(State::default());
        }
        let (room, exchange) = (self.room(settings), self.around.exchange);
        self.fit_light(&[room], None);
        let changed = exchange(room, &mut || self.change_settings(settings));
        self.fit_light_on_show();
        changed?;
        self.frame_again(&old, &settings)?;
        self.tone.set_exposure(settings.exposure.factor());
        self.shared.picture().forget();
        let (session, size) = (self.session(), settings.resolution);
        let (view, home) = (session.view(), self.around.camera.camera(session.model(), &settings));
        Ok(State {
            up: Some(up_of(view, session.model())),
            size: Some(size),
            home: Some(CameraText::of(&home, size)),
            settings: Some(SettingsText::from(&*settings)),
            camera: Some(CameraText::of(&view.camera, settings.resolution)),
            ..State::default()
        })
    }

    /// Frames the model anew in a picture of another shape, or with another way up, where it is seen as it was at
    /// first.
    fn frame_again(&mut self, old: &RenderSettings, new: &RenderSettings) -> Result<()> {
        let keys = &self.around.camera;
        let framed = |settings| keys.camera(self.session().model(), settings);
        let (before, camera) = (framed(old), framed(new));
        if camera != before && self.session().view().camera == before {
            self.session_mut().apply(Event::Camera(camera))?;
        }
        Ok(())
    }

    fn change_settings(&mut self, new: RenderSettings) -> Result<()> {
        self.shared.make_room(new.resolution)?;
        let changed = self.session_mut().apply(Event::Settings(new));
        // The one that is on show then.
        self.shared.resize(self.session().view().settings.resolution);
        changed
    }

    /// Tells all but its author what has changed; or the author that it has not.
    fn publish_change(&mut self, changed: Result<State>, since: Option<std::time::Instant>) {
        match changed {
            Ok(update) => {
                if !update.is_empty() {
                    self.figures.event(since);
                    self.restart_picture();
                    // The author knows, but not what the renderer makes of it.
                    let knows = update.camera.is_some() && update.size.is_none();
                    let author = self.author.filter(|_| knows || update.lights.is_some());
                    self.shared.send_state(State { seq: Some(self.seq), ..update }, author);
                }
            }
            Err(error) => {
                self.send_error(&error);
                let update = State { seq: Some(self.seq), ..self.whole_state() };
                self.shared.send_state(update, None);
                // What comes of the same mail is newer than that.
                self.author = None;
            }
        }
    }

    /// Tells who asked for it what went wrong, or else who drives.
    pub(crate) fn send_error(&self, error: &Error) {
        if let Some(client) = self.author.or_else(|| self.shared.mailbox.driver()) {
            self.shared.send_text(client, || text_of(&Notice::error(error)));
        }
    }

    /// Answers what a page asks.
    fn answer(&mut self, client: ClientId, question: Question) {
        match question {
            Question::Pick { id, pixel } => self.pick(client, id, pixel),
            Question::Materials(wish) => {
                let model = self.session().model();
                self.shared.send_text(client, || text_of(&list(model, &wish)));
            }
            Question::Scene(id) => match self.scene_file(id) {
                Ok(file) => self.shared.send_file(client, file),
                Err(error) => self.shared.send_text(client, || text_of(&Notice::error(&error).of("scene"))),
            },
        }
    }

    /// The scene's text as a file.
    fn scene_file(&mut self, id: u32) -> Result<File> {
        let bytes = texts::scene_bytes(&self.text_sources());
        let on_show = self.room(self.session().view().settings);
        let copies_bytes = on_show.copies_bytes + bytes as u64;
        self.make_room(&[Room { copies_bytes, ..on_show }])?;
        let room = self.files.lease(self.around.budget, "the scene's text", bytes as u64)?;
        Ok(File::new(FileFormat::Scene, id, texts::scene(&self.text_sources(), bytes).into_bytes(), room))
    }

    /// Says what is at a pixel.
    fn pick(&mut self, client: ClientId, id: u32, pixel: [u32; 2]) {
        let [width, height] = self.session().view().settings.resolution;
        let is_inside = pixel[0] < width && pixel[1] < height;
        let stop = self.around.stop;
        let hit = if is_inside { self.session_mut().pick_until(pixel, &stop) } else { None };
        let model = self.session().model();
        let hit = hit.map(|Pick { shaded: ShadedHit { hit, colour, shading_normal }, position }| HitText {
            triangle: (hit.triangle != Hit::OF_CAP).then_some(hit.triangle),
            material: hit.material,
            name: name_of(model, hit.material as usize).to_owned(),
            position,
            colour: [0, 1, 2].map(|c| model.materials[hit.material as usize].kd[c] * colour[c]),
            normal: hit.normal,
            shading_normal,
            distance: hit.t,
            page: (hit.page != Hit::OF_CAP).then_some(hit.page),
        });
        self.shared.send_text(client, || text_of(&PickAnswer { id, hit }));
    }
}

/// The size of a picture for a page of `size` pixels: each side in its range, and no more blocks than have numbers.
fn fitting(size: [u32; 2]) -> [u32; 2] {
    let [width, height] = size.map(|side| side.clamp(BLOCK_SIDE, SIDE_MAX));
    let pixels = u64::from(width) * u64::from(height);
    if pixels <= PIXELS_MAX {
        return [width, height];
    }
    let factor = (PIXELS_MAX as f64 / pixels as f64).sqrt();
    [width, height].map(|side| ((f64::from(side) * factor) as u32).max(BLOCK_SIDE))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blocks::{BLOCKS_MAX, Layout};

    #[test]
    fn sizes_are_brought_into_their_range() {
        assert_eq!(fitting([1280, 720]), [1280, 720]);
        assert_eq!(fitting([0, 5]), [BLOCK_SIDE; 2]);
        for size in [[u32::MAX; 2], [16_384, 16_384], [8192, 4320], [u32::MAX, 1]] {
            let fitting = fitting(size);
            assert!(Layout::new(fitting, 1).count() <= BLOCKS_MAX, "{size:?}: {fitting:?}");
            assert!(fitting.iter().all(|side| (BLOCK_SIDE..=SIDE_MAX).contains(side)));
        }
    }
}
