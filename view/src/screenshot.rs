//! Screenshots: a picture at leisure of the view on show, in a size of its own, as a file for the page.
//!
//! ```text
//! live session -> at leisure -> a thread of its own: other size -> photons that lack -> samples -> file
//!                               meanwhile: heart beats, who comes and goes; edits wait in the mailbox
//!              <- live again <- size as before <-'
//! ```
//!
//! Invariants: 1. whatever becomes of the picture, the session is live again afterwards; 2. the file's memory is leased
//! while it is made and until it is sent; 3. it ends when its page goes or cancels it, and when the viewer ends; 4. it
//! takes at most [`SAMPLES_MAX`] samples.

use crate::bounded::BoundedWriter;
use crate::mail::Shot;
use crate::message::{Format, Notice, text_of};
use crate::outbox::{File, FileBytes, FileFormat};
use crate::session_loop::SessionLoop;
use crate::shared::{SharedState, png_bytes};
use crate::state::ShotProgress;
use crate::surroundings::Room;
use std::ops::ControlFlow;
use std::panic::resume_unwind;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::{self, Builder};
use std::time::{Duration, Instant};
use trex_render::{Event, PagedTracer, RenderKeys, RenderSettings, Session, write_exr, write_png};
use trex_store::{Budget, Code, Error, Result};

/// Bytes of a pixel of an EXR, and its tables.
const EXR_PIXEL_BYTES: u64 = 13;
const EXR_FIXED_BYTES: u64 = 1 << 20;
/// Most samples of a picture: 512 for each pixel of 3840x2160. At a million a second they take more than an hour.
const SAMPLES_MAX: u64 = 1 << 32;
/// Progress is reported at most so often.
const REPORT_EVERY: Duration = Duration::from_millis(200);
/// Pages hear so often how it stands while a screenshot is made.
const HEART_BEAT: Duration = Duration::from_millis(250);

/// Most bytes of the file.
fn file_bytes(shot: &Shot) -> u64 {
    match shot.format {
        Format::Png => png_bytes(shot.size),
        Format::Exr => shot.size.map(u64::from).iter().product::<u64>() * EXR_PIXEL_BYTES + EXR_FIXED_BYTES,
    }
}

/// The numbers of the picture, checked.
fn settings_of(shot: &Shot, on_show: &RenderSettings) -> Result<RenderSettings> {
    let settings = RenderSettings::new(RenderKeys { resolution: shot.size, spp: shot.spp, ..**on_show })?;
    let [width, height] = shot.size;
    let samples = u64::from(width) * u64::from(height) * u64::from(shot.spp);
    if samples > SAMPLES_MAX {
        return Err(Error::new(Code::Usage, "this picture takes too many samples for the viewer")
            .at_place("the screenshot")
            .numbers(format!("{width}x{height} by {} are {samples}, at most {SAMPLES_MAX}", shot.spp))
            .next("ask for a smaller one or for fewer samples a pixel, or render it outside of the viewer"));
    }
    Ok(settings)
}

impl<T: PagedTracer + Send> SessionLoop<'_, T> {
    /// Makes a picture, and sends it.
    ///
    /// # Errors
    /// The session cannot go on.
    pub(crate) fn make_screenshot(&mut self, shot: Shot) -> Result<()> {
        let old = self.session().view().settings;
        let settings = settings_of(&shot, &old).and_then(|settings| {
            // The picture that is made takes the place of the one on show, then that takes its place again: the file is
            // beside both.
            let on_show = self.room(old);
            let room = Room { copies_bytes: on_show.copies_bytes + file_bytes(&shot), ..on_show };
            self.make_room(&[room, Room { settings, ..room }])?;
            Ok(settings)
        });
        let made = match settings {
            Err(error) => Err(error),
            Ok(settings) => self.make_beside(shot, settings)?,
        };
        // There was room for it before, but for what the file takes until it is sent.
        self.make_room(&[self.room(old)])?;
        let is_wanted = self.shared.mailbox.end_shot();
        match made {
            Ok(file) if is_wanted => {
                self.served.screenshots += 1;
                self.shared.send_file(shot.client, file);
            }
            Err(error) if is_wanted => {
                self.shared.send_text(shot.client, || text_of(&Notice::error(&error).of("screenshot")));
            }
            _ => self.shared.send_text(shot.client, || text_of(&Notice::cancelled())),
        }
        Ok(())
    }

    /// Makes the file on a thread of its own, with the session at leisure; afterwards that is live again. Meanwhile
    /// pages hear how it stands.
    fn make_beside(&mut self, shot: Shot, settings: RenderSettings) -> Result<Result<File>> {
        let old = self.session().view().settings;
        let (samples, frames) = (self.session().film().samples(), *self.session().frame_options());
        let files = self.files.clone();
        let work = ShotWork {
            shot,
            settings,
            shared: self.shared,
            budget: self.around.budget,
            files: &files,
            stop: self.around.stop,
        };
        let mut session = self.take_session().into_session();
        let made = thread::scope(|scope| {
            let (sender, receiver) = sync_channel(1);
            let session = &mut session;
            let make = move || drop(sender.send(work.file(session)));
            match Builder::new().name("view-shot".into()).spawn_scoped(scope, make) {
                Ok(worker) => self.wait_beside(&receiver).unwrap_or_else(|| match worker.join() {
                    Err(panic) => resume_unwind(panic),
                    Ok(()) => unreachable!("a worker that has not panicked has sent"),
                }),
                Err(error) => Err(Error::thread_refused("the screenshot", &error)
                    .next("try again; render the scene file if it stays")),
            }
        });
        if session.view().settings != old {
            session.apply(Event::Settings(old))?;
        }
        self.put_session(session.go_live(frames)?, samples);
        Ok(made)
    }

    /// Serves pages until there is something to receive; `None` when nothing will come.
    fn wait_beside<R>(&mut self, receiver: &Receiver<R>) -> Option<R> {
        loop {
            match receiver.recv_timeout(HEART_BEAT) {
                Ok(received) => return Some(received),
                Err(RecvTimeoutError::Disconnected) => return None,
                Err(RecvTimeoutError::Timeout) => self.beat(),
            }
        }
    }
}

/// What makes a file of a session at leisure, on any thread.
#[derive(Clone, Copy)]
struct ShotWork<'a> {
    shot: Shot,
    settings: RenderSettings,
    shared: &'a SharedState,
    budget: &'a Budget,
    files: &'a FileBytes,
    stop: &'a (dyn Fn() -> bool + Sync),
}

impl ShotWork<'_> {
    fn is_over(&self) -> bool {
        (self.stop)() || !self.shared.mailbox.wants_shot()
    }

    fn file<T: PagedTracer + Send>(&self, session: &mut Session<T>) -> Result<File> {
        let ShotWork { shot, settings, .. } = *self;
        let most = file_bytes(&shot);
        let room = self.files.lease(self.budget, "the screenshot", most)?;
        let stop = || self.is_over();
        session.apply(Event::Settings(settings))?;
        session.illuminate(&stop, &mut |_, _| {})?;
        self.render(session, &stop);
        session.smooth_until(&stop)?;
        if stop() {
            return Err(Error::interrupted());
        }
        // Room that is never written to takes none.
        let mut bytes = Vec::with_capacity(most as usize);
        let mut writer = BoundedWriter::new(&mut bytes, most as usize, &stop);
        let film = session.film();
        let written = match shot.format {
            Format::Png => write_png(film, settings.exposure.factor(), session.thread_pool(), writer),
            Format::Exr => write_exr(film, &mut writer),
        };
        written.map_err(|error| {
            Error::new(Code::Io, "the screenshot could not be encoded")
                .at_place("the screenshot")
                .numbers(error.to_string())
                .next("ask for the other format, or render the scene file")
        })?;
        let format = match shot.format {
            Format::Png => FileFormat::Png,
            Format::Exr => FileFormat::Exr,
        };
        Ok(File::new(format, shot.id, bytes, room))
    }

    fn render<T: PagedTracer + Send>(&self, session: &mut Session<T>, stop: &(dyn Fn() -> bool + Sync)) {
        let (id, spp) = (self.shot.id, self.settings.spp);
        let pixels = self.settings.resolution.map(u64::from).iter().product::<u64>();
        let mut reported_at = Instant::now();
        session.render(spp, stop, &mut |_, stats| {
            if reported_at.elapsed() >= REPORT_EVERY {
                reported_at = Instant::now();
                let (done, total) = (pixels * u64::from(stats.spp), pixels * u64::from(spp));
                self.shared.send_text(self.shot.client, || text_of(&ShotProgress { id, done, total }));
            }
            ControlFlow::Continue(())
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A picture of 16,384 x 16,384 with 65,536 samples a pixel was begun, and nothing ended it but the viewer's end.
    #[test]
    fn samples_are_bounded() {
        let on_show = RenderSettings::default();
        let shot = |size, spp| Shot { client: 1, id: 1, format: Format::Png, size, spp };
        for (size, spp) in [([3840, 2160], 512), ([64, 64], 65_536)] {
            assert_eq!(settings_of(&shot(size, spp), &on_show).unwrap().spp, spp);
        }
        for (size, spp) in [([16_384, 16_384], 65_536), ([3840, 2160], 1024)] {
            let error = settings_of(&shot(size, spp), &on_show).unwrap_err();
            assert_eq!((error.code(), error.place()), (Code::Usage, "the screenshot"));
        }
        assert!(settings_of(&shot([u32::MAX; 2], 1), &on_show).is_err());
    }
}
