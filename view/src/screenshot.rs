//! Screenshots: a picture at leisure of the view on show, in a size of its own, as a file for the page.
//!
//! ```text
//! live session -> at leisure -> other size -> photons that lack -> samples -> file -> size as before -> live again
//! ```
//!
//! Invariants: 1. whatever becomes of the picture, the session is live again afterwards; 2. the file's memory is leased
//! while it is made and until it is sent.

use crate::atlas::{Bounded, header};
use crate::client::File;
use crate::mailbox::Shot;
use crate::message::{Format, Notice, text_of};
use crate::session_loop::SessionLoop;
use crate::shared::{png_bytes, view_bytes};
use crate::state::ShotProgress;
use crate::surroundings::Room;
use std::io::Cursor;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};
use trex_render::{Event, PagedTracer, RenderKeys, RenderSettings, Session, write_exr, write_png};
use trex_store::{Code, Error, Result};

/// The kind of message that a file goes in.
const KIND_FILE: u8 = 3;
/// Bytes in front of the file.
const HEAD_BYTES: usize = 8;
/// Bytes of a pixel of an EXR, and its tables.
const EXR_PIXEL_BYTES: u64 = 13;
const EXR_FIXED_BYTES: u64 = 1 << 20;
/// Progress is told at most so often.
const TELL_EVERY: Duration = Duration::from_millis(200);

/// Most bytes of the file.
fn file_bytes(shot: &Shot) -> u64 {
    match shot.format {
        Format::Png => png_bytes(shot.size),
        Format::Exr => shot.size.map(u64::from).iter().product::<u64>() * EXR_PIXEL_BYTES + EXR_FIXED_BYTES,
    }
}

impl<T: PagedTracer + Send> SessionLoop<'_, T> {
    /// Makes a picture, and sends it.
    ///
    /// # Errors
    /// The session cannot go on.
    pub(crate) fn take_screenshot(&mut self, shot: Shot) -> Result<()> {
        let old = self.session().view().settings;
        let keys = RenderKeys { resolution: shot.size, spp: shot.spp, ..*old };
        let settings = RenderSettings::new(keys).and_then(|settings| {
            let copies_bytes = view_bytes(old.resolution) + file_bytes(&shot);
            (self.around.make_room)(&[Room::of(old), Room { settings, copies_bytes }])?;
            Ok(settings)
        });
        let mut made = Err(Error::interrupted());
        match settings {
            Err(error) => made = Err(error),
            Ok(settings) => {
                self.at_leisure(|this, session| made = this.make_file(session, shot, settings))?
            }
        }
        // There was room for it before.
        (self.around.make_room)(&[Room::of(old)])?;
        match made {
            Ok(file) => {
                self.served.screenshots += 1;
                self.shared.send_file(shot.client, file);
            }
            Err(error) => self.shared.tell(shot.client, || text_of(&Notice::error(&error).of("screenshot"))),
        }
        Ok(())
    }

    /// Does something to the session at leisure; afterwards it is live again.
    fn at_leisure(&mut self, work: impl FnOnce(&mut Self, &mut Session<T>)) -> Result<()> {
        let old = self.session().view().settings;
        let samples = self.session().film().samples();
        let mut session = self.take_session().into_session();
        work(self, &mut session);
        if session.view().settings != old {
            session.apply(Event::Settings(old))?;
        }
        self.put_session(session.go_live(self.options.frames)?, samples);
        Ok(())
    }

    fn make_file(&self, session: &mut Session<T>, shot: Shot, settings: RenderSettings) -> Result<File> {
        let most = file_bytes(&shot);
        let pixels = settings.resolution.map(u64::from).iter().product::<u64>();
        let lease = self.around.budget.lease("the screenshot", most)?;
        session.apply(Event::Settings(settings))?;
        session.illuminate(self.around.stop, &mut |_, _| {})?;
        let mut told_at = Instant::now();
        let total = pixels * u64::from(settings.spp);
        session.render(settings.spp, self.around.stop, &mut |_, stats| {
            if told_at.elapsed() >= TELL_EVERY {
                told_at = Instant::now();
                let done = pixels * u64::from(stats.spp);
                self.shared.tell(shot.client, || text_of(&ShotProgress { id: shot.id, done, total }));
            }
            ControlFlow::Continue(())
        });
        if (self.around.stop)() {
            return Err(Error::interrupted());
        }
        session.smooth()?;
        // Room that is never written to takes none.
        let mut bytes = Vec::with_capacity(most as usize);
        let film = session.film();
        let written = match shot.format {
            Format::Png => {
                let writer = Bounded { bytes: &mut bytes, most: most as usize };
                write_png(film, settings.exposure, session.thread_pool(), writer)
            }
            Format::Exr => {
                let mut writer = Cursor::new(std::mem::take(&mut bytes));
                let written = write_exr(film, &mut writer);
                bytes = writer.into_inner();
                written
            }
        };
        written.map_err(|error| {
            Error::new(Code::Io, "the screenshot could not be encoded")
                .at_place("the screenshot")
                .numbers(error.to_string())
                .next("ask for the other format, or render the scene file")
        })?;
        let mut head = header(HEAD_BYTES + bytes.len());
        head.extend_from_slice(&[KIND_FILE, u8::from(shot.format == Format::Exr), 0, 0]);
        head.extend_from_slice(&shot.id.to_le_bytes());
        Ok(File { head, bytes, _lease: lease })
    }
}
