//! The session's thread: takes what pages want, goes on with the picture, puts it where clients' threads find it.
//!
//! ```text
//! mailbox -> edits.rs -> frame, stopped by the next event -> the picture's bytes -> marks -> clients' threads
//!    ^                                                                                        |
//!    '------------------------- nothing to do: sleep --------------------------- done: one PNG '
//! ```
//!
//! While the hand moves only whole pictures go out, small ones: every so many pixels as there are samples. At rest all
//! of the picture goes out, in blocks, and less and less often once every pixel has a sample.
//!
//! Invariants: 1. nothing here waits for a client; 2. the first frame after an event is not stopped by the next one,
//! or a picture would never be whole while events come fast; 3. a settled picture takes no processor, sends nothing.

use crate::bounded::BoundedWriter;
use crate::figures::Figures;
use crate::mail::ClientId;
use crate::materials::fingerprint;
use crate::motion::Motion;
use crate::outbox::FileBytes;
use crate::picture::{BlockChanges, Picture, SettledPng};
use crate::renderer::Stamps;
use crate::shared::{SharedState, png_bytes};
use crate::state::{RaysText, Smaller, State, Stats, progress_name};
use crate::surroundings::{ServeOptions, ServeReport, Surroundings};
use crate::tone::Tone;
use crate::wire::{FLAG_COMPLETE, FLAG_DONE, FLAG_MOVING, FLAG_PREVIEW};
use std::sync::Arc;
use std::time::Duration;
use trex_render::{FrameProgress, FrameReport, Light, LiveSession, PagedTracer, write_png};
use trex_store::Result;

/// Longest sleep: after so long it is asked whether the viewer is to end.
const SLEEP: Duration = Duration::from_millis(200);
/// Finest grid of a preview, pixels: after it come tiles.
const PREVIEW_STEP_LEAST: u32 = 2;
/// The progress of a picture that has all its samples, and lacks what damaged pages hold.
const DAMAGED: &str = "damaged";
/// The progress while a screenshot is made.
const SCREENSHOT: &str = "screenshot";

/// A session on show.
pub(crate) struct SessionLoop<'a, T> {
    /// Always there, but while a screenshot is made of it.
    session: Option<LiveSession<T>>,
    pub(crate) shared: &'a SharedState,
    pub(crate) around: &'a Surroundings<'a>,
    pub(crate) options: &'a ServeOptions,
    pub(crate) tone: Tone,
    pub(crate) motion: Motion,
    pub(crate) figures: Figures,
    pub(crate) served: ServeReport,
    /// The driver's last event.
    pub(crate) seq: u32,
    /// Who has sent what is being done; `None` where nobody or several have.
    pub(crate) author: Option<ClientId>,
    /// Lights of the file that was opened, and what its materials come to.
    pub(crate) input_lights: Vec<Light>,
    pub(crate) input_fingerprint: u64,
    /// All of the model was shown when it was opened.
    pub(crate) was_whole: bool,
    /// Sections or hidden materials were changed since.
    pub(crate) are_parts_edited: bool,
    /// No frame has been made since the last event.
    is_fresh: bool,
    /// Pixels between samples of the last frame.
    step: Option<u32>,
    stage: PictureStage,
    /// Samples that the picture on show has, while a session that begins anew makes them again.
    shown_samples: u32,
    stamps: Stamps,
    png: Arc<Vec<u8>>,
    /// A size that was asked for, and does not fit.
    pub(crate) smaller: Option<Smaller>,
    /// Damaged pages that the browser pages know of.
    damaged: u64,
    /// The last statistics of the picture on show.
    stats: Stats,
    pub(crate) files: FileBytes,
    /// Bytes of files when room was made last.
    file_bytes: u64,
}

/// How far the end of a picture is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum PictureStage {
    /// Frames are being made.
    Sampling,
    /// All is sampled; the settled picture is still to be made.
    Sampled,
    /// All is sent.
    Settled,
}

impl<'a, T: PagedTracer + Send> SessionLoop<'a, T> {
    /// A loop that shows `session`.
    pub(crate) fn new(
        session: LiveSession<T>,
        shared: &'a SharedState,
        options: &'a ServeOptions,
        around: &'a Surroundings<'a>,
    ) -> SessionLoop<'a, T> {
        let view = session.view();
        let mut this = SessionLoop {
            tone: Tone::new(view.settings.exposure.factor()),
            input_lights: view.lights.clone(),
            input_fingerprint: fingerprint(&session.model().materials),
            was_whole: view.parts.is_whole(),
            are_parts_edited: false,
            session: Some(session),
            shared,
            around,
            options,
            motion: Motion::new(),
            figures: Figures::new(),
            served: ServeReport::default(),
            seq: 0,
            author: None,
            is_fresh: true,
            step: None,
            stage: PictureStage::Sampling,
            shown_samples: 0,
            stamps: Stamps::default(),
            png: Arc::default(),
            smaller: None,
            damaged: 0,
            stats: Stats::default(),
            files: FileBytes::default(),
            file_bytes: 0,
        };
        this.greet();
        this
    }

    /// The session.
    pub(crate) fn session(&self) -> &LiveSession<T> {
        self.session.as_ref().expect("a screenshot gives the session back")
    }

    /// The session, to be changed.
    pub(crate) fn session_mut(&mut self) -> &mut LiveSession<T> {
        self.session.as_mut().expect("a screenshot gives the session back")
    }

    /// The session, to be made something else; [`SessionLoop::put_session`] brings it back.
    pub(crate) fn take_session(&mut self) -> LiveSession<T> {
        self.session.take().expect("a screenshot gives the session back")
    }

    /// A session of the view that is on show, to be shown from now on: not before it has what is there.
    pub(crate) fn put_session(&mut self, session: LiveSession<T>, samples: u32) {
        self.session = Some(session);
        self.shared.picture().forget();
        self.restart_picture();
        self.shown_samples = samples;
    }

    /// Shows the session until it is told to stop.
    ///
    /// # Errors
    /// The session cannot go on; what pages ask for in vain is told to them alone.
    pub(crate) fn run(mut self) -> Result<ServeReport> {
        while !(self.around.stop)() {
            let mail = self.shared.mailbox.collect();
            self.apply_mail(mail)?;
            if (self.around.stop)() {
                break;
            }
            self.remake_room();
            match self.rests_for() {
                Some(time) => self.shared.mailbox.wait(time),
                None if self.stage == PictureStage::Sampled => self.finish_picture(),
                None => self.advance(),
            }
        }
        Ok(self.report())
    }

    /// How long there is nothing to do, if there is not.
    fn rests_for(&self) -> Option<Duration> {
        let has_preview = self.step.is_some_and(|step| step <= PREVIEW_STEP_LEAST);
        match self.stage {
            PictureStage::Settled => Some(SLEEP),
            // A page is still being sent the picture before.
            PictureStage::Sampled if self.is_still_sending() => Some(SLEEP / 10),
            PictureStage::Sampled => None,
            // What is finer than that would be late, and stand in the way of the next event.
            PictureStage::Sampling if self.is_fresh || !has_preview => None,
            PictureStage::Sampling => self.motion.moves_for().map(|time| time.min(SLEEP)),
        }
    }

    /// True while the settled picture before this one is on its way to some page.
    fn is_still_sending(&self) -> bool {
        Arc::strong_count(&self.png) > 1 && self.shared.picture().settled.is_none()
    }

    /// Another picture begins.
    pub(crate) fn restart_picture(&mut self) {
        (self.is_fresh, self.step, self.stage, self.shown_samples) = (true, None, PictureStage::Sampling, 0);
    }

    /// Makes a frame, and shows it.
    fn advance(&mut self) {
        let is_first = std::mem::take(&mut self.is_fresh);
        let (stop, mailbox) = (self.around.stop, &self.shared.mailbox);
        let session = self.session.as_mut().expect("a screenshot gives the session back");
        let keys = *session.view().settings;
        let report = session.frame(keys.spp, &|| stop() || !is_first && mailbox.has_event());
        self.served.frames += 1;
        self.step = report.sample_step;
        self.figures.learn(&report, keys.lod_error);
        if report.progress == FrameProgress::Done {
            self.stage = PictureStage::Sampled;
        }
        self.publish(&report);
        if self.figures.is_due() {
            self.send_stats();
        }
    }

    /// Shows what a frame has made, if that is worth it.
    fn publish(&mut self, report: &FrameReport) {
        if report.progress == FrameProgress::PreviewPart
            || self.session().film().samples() < self.shown_samples
        {
            return;
        }
        let is_preview = report.progress == FrameProgress::Preview;
        let mut flags = if report.preview_tiles > 0 { FLAG_PREVIEW } else { 0 };
        let step = report.sample_step;
        let scale = if self.motion.moves_for().is_some() {
            // A picture that is not whole is none.
            let Some(step) = step.filter(|_| is_preview || report.progress >= FrameProgress::Complete) else {
                return;
            };
            flags |= FLAG_MOVING;
            self.motion.scale(step)
        } else if is_preview {
            let Some(step) = step else { return };
            self.motion.scale(step)
        } else {
            if report.progress == FrameProgress::Complete && !self.motion.is_due() {
                return;
            }
            1
        };
        if report.progress >= FrameProgress::Complete {
            flags |= FLAG_COMPLETE;
        }
        self.refresh(scale, flags, step.is_some());
    }

    /// Takes over into the picture what the session shows, and has it sent.
    fn refresh(&mut self, scale: u32, flags: u8, is_whole: bool) {
        let mut picture = self.shared.picture();
        let scale = scale.max(Picture::least_scale(picture.full));
        if self.step.is_none_or(|step| !scale.is_multiple_of(step)) {
            self.session.as_mut().expect("a screenshot gives the session back").fill_preview();
        }
        let session = self.session.as_ref().expect("a screenshot gives the session back");
        let mut changed = self.stamps.with_shown(session, |shown| picture.refresh(scale, &self.tone, shown));
        let seq = if is_whole { self.seq } else { picture.seq };
        if let BlockChanges::Some(marks) = &mut changed
            && marks.is_empty()
        {
            if (seq, flags) == (picture.seq, picture.flags) {
                return;
            }
            // A page learns of it by a frame.
            marks.set(0);
        }
        if scale > 1 {
            // Small pictures go whole: pages smooth them over the place of the large one.
            changed = BlockChanges::All;
        }
        picture.frame = picture.frame.wrapping_add(1);
        (picture.seq, picture.flags, picture.settled) = (seq, flags, None);
        self.shared.mark(&picture, &changed);
        drop(picture);
        self.motion.refreshed();
    }

    /// The last step of a picture: all of it, and once more without loss.
    fn finish_picture(&mut self) {
        self.stage = PictureStage::Settled;
        self.refresh(1, FLAG_COMPLETE | FLAG_DONE, true);
        if self.shared.picture().settled.is_none() {
            self.png = Arc::new(self.write_png());
        }
        if self.shared.picture().settled.is_none() && !self.png.is_empty() {
            let frame = {
                let mut picture = self.shared.picture();
                picture.frame = picture.frame.wrapping_add(1);
                picture.frame
            };
            self.shared.settle(SettledPng { frame, png: self.png.clone() });
        }
        self.send_texts();
        self.send_stats();
    }

    /// The film as PNG; nothing where it does not fit.
    fn write_png(&mut self) -> Vec<u8> {
        self.png = Arc::default();
        let session = self.session();
        let most = png_bytes(session.view().settings.resolution) as usize;
        let mut bytes = Vec::new();
        let writer = BoundedWriter::new(&mut bytes, most, &self.around.stop);
        match write_png(session.film(), self.tone.exposure(), session.thread_pool(), writer) {
            Ok(()) => bytes,
            Err(_) => Vec::new(),
        }
    }

    /// Sends every page statistics.
    pub(crate) fn send_stats(&mut self) {
        let keys = *self.session().view().settings;
        let rays_per_s = self.figures.rays_per_s();
        let pool = (self.around.pool)();
        let is_damaged = pool.damaged > 0 && self.figures.progress == FrameProgress::Done;
        let stats = Stats {
            progress: if is_damaged { DAMAGED } else { progress_name(self.figures.progress) },
            samples: self.session().film().samples(),
            spp: keys.spp,
            light_share: self.figures.light_share,
            pixel_error: self.figures.error,
            times_ms: self.figures.times,
            rays_per_s,
            memory: (self.around.memory)(),
            pool,
            gpu: (self.around.device)(),
        };
        self.stats = stats;
        self.send_damage(pool.damaged);
        self.shared.send_stats(stats);
    }

    /// What pages hear while a screenshot is made: who comes and goes, memory and pool as they are now.
    pub(crate) fn beat(&mut self) {
        if self.shared.mailbox.collect_roles() {
            self.shared.send_state(State::default(), None);
        }
        let (memory, pool) = ((self.around.memory)(), (self.around.pool)());
        self.send_damage(pool.damaged);
        let (rays_per_s, gpu) = (RaysText::default(), (self.around.device)());
        self.shared.send_stats(Stats { progress: SCREENSHOT, rays_per_s, memory, pool, gpu, ..self.stats });
    }

    /// Sends every page the list of damaged pages of the file, when it has grown.
    fn send_damage(&mut self, damaged: u64) {
        if damaged != self.damaged {
            self.damaged = damaged;
            let damage = (self.around.damage)();
            self.shared.send_state(State { damage: Some(damage), ..State::default() }, None);
        }
    }

    /// Sends every page the view as texts.
    fn send_texts(&mut self) {
        let texts = self.texts();
        let text = texts.message();
        self.shared.clients().iter().for_each(|client| client.send_text(text.clone()));
        self.shared.keep_texts(texts);
    }

    /// Gives the room of files that have been sent back to the frames of pages.
    fn remake_room(&mut self) {
        let bytes = self.files.now();
        if bytes != self.file_bytes && self.make_room(&[self.room(self.session().view().settings)]).is_ok() {
            self.file_bytes = bytes;
        }
    }
}
