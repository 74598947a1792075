//! How wrong a picture is at some times after its event: snapshots of what is shown, compared with references.
//!
//! ```text
//! a frame that may end after a time of interest: the picture before it is copied, and written if the frame did
//! after the hold: written pictures against the reference -> relMSE, FLIP
//! ```
//!
//! Invariants: 1. a written picture is of what was on show at its time; 2. memory is leased for one copy, of halves of
//! 16 bits, whose rounding (2^-11) is far below any error of interest, and for the two pictures that are compared;
//! 3. nothing is compared while a view is held.

use super::camera_way::WAY_VIEWS;
use super::picture_error::PictureError;
use super::picture_store::PictureStore;
use super::references::{ErrorFloor, References};
use half::f16;
use std::fs::File;
use std::path::PathBuf;
use std::time::Duration;
use trex_image::{Picture, flip_bytes};
use trex_render::{LiveSession, PagedTracer};
use trex_store::{Budget, Lease, Result};

/// Times after an event at which errors are told, ms.
pub const ERROR_TIMES_MS: [u64; 7] = [33, 80, 100, 200, 300, 1000, 3000];

/// The pictures of a hold that are to be compared, and those of a way to it.
#[derive(Debug)]
pub struct Snapshots {
    references: References,
    /// By times, then by views of a way.
    written: PictureStore,
    /// What was on show before the frame at hand, if it is of interest.
    before: Vec<[f16; 3]>,
    is_fresh: bool,
    is_written: [bool; ERROR_TIMES_MS.len()],
    /// Times that have passed.
    is_over: [bool; ERROR_TIMES_MS.len()],
    /// The state that was compared last, and the times whose pictures were.
    compared: Option<(u32, [bool; ERROR_TIMES_MS.len()])>,
    _lease: Lease,
}

impl Snapshots {
    /// Bytes that snapshots take at `resolution` (width, height; pixels), with the two pictures that are compared.
    pub fn bytes(resolution: [u32; 2]) -> u64 {
        let pixels = u64::from(resolution[0]) * u64::from(resolution[1]);
        pixels * (size_of::<[f16; 3]>() + 2 * size_of::<[f32; 3]>()) as u64 + flip_bytes(resolution[0])
    }

    /// Snapshots that are compared with `references`, and written to `file`, which is empty, until then; `place` is its
    /// folder.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when `budget` has no room for [`Snapshots::bytes`].
    pub fn new(references: References, file: File, place: PathBuf, budget: &Budget) -> Result<Snapshots> {
        let resolution = references.resolution();
        let lease = budget.lease("pictures to be compared", Snapshots::bytes(resolution))?;
        let pixels = resolution[0] as usize * resolution[1] as usize;
        Ok(Snapshots {
            references,
            written: PictureStore::new(file, place, resolution, 0),
            before: vec![[f16::ZERO; 3]; pixels],
            is_fresh: false,
            is_written: Default::default(),
            is_over: Default::default(),
            compared: None,
            _lease: lease,
        })
    }

    /// Copies what is on show, `now` after the event, if a frame of `t_max` may pass a time of interest.
    pub(super) fn before_frame<T: PagedTracer + Send>(
        &mut self,
        session: &LiveSession<T>,
        now: Duration,
        t_max: Duration,
    ) {
        // Frames go on for what is begun, so they may take longer.
        let end = now + 2 * t_max;
        let may_pass = |(ms, is_over): (&u64, &bool)| !is_over && end >= Duration::from_millis(*ms);
        self.is_fresh = ERROR_TIMES_MS.iter().zip(&self.is_over).any(may_pass);
        if self.is_fresh {
            let width = self.written.resolution()[0] as usize;
            for (y, row) in self.before.chunks_exact_mut(width).enumerate() {
                for (x, pixel) in row.iter_mut().enumerate() {
                    *pixel = session.shown([x as u32, y as u32]).map(f16::from_f32);
                }
            }
        }
    }

    /// Writes the copy for the times of interest that have passed, `now` after the event.
    ///
    /// # Errors
    /// Those of writing the file.
    pub(super) fn after_frame(&mut self, now: Duration) -> Result<()> {
        let width = self.written.resolution()[0];
        for (index, ms) in (0..).zip(ERROR_TIMES_MS) {
            let at = index as usize;
            let has_passed = now >= Duration::from_millis(ms) && !self.is_over[at];
            self.is_over[at] |= has_passed;
            // A frame that took longer than any should has no picture from before it.
            if has_passed && self.is_fresh {
                let copy = |[x, y]: [u32; 2]| self.before[(y * width + x) as usize].map(f16::to_f32);
                self.written.write(index, copy)?;
                self.is_written[at] = true;
            }
        }
        Ok(())
    }

    /// True when every time has passed.
    pub(super) fn are_taken(&self) -> bool {
        self.is_over.iter().all(|is_over| *is_over)
    }

    /// Errors of the pictures, shown with `exposure`, against state `state`, by time; `None` for times that were not
    /// reached.
    ///
    /// # Errors
    /// Those of reading both.
    pub(super) fn errors(
        &mut self,
        state: u32,
        exposure: f32,
    ) -> Result<[Option<PictureError>; ERROR_TIMES_MS.len()]> {
        let reference = self.references.picture(state)?;
        let mut errors = [None; ERROR_TIMES_MS.len()];
        for (index, error) in (0..).zip(&mut errors) {
            if self.is_written[index as usize] {
                *error = PictureError::of(&self.written.read(index)?, &reference, exposure);
            }
        }
        self.is_over = Default::default();
        self.compared = Some((state, std::mem::take(&mut self.is_written)));
        Ok(errors)
    }

    /// The pictures that were compared last, with the time that each was on show at, ms, and what they were compared
    /// with, which has none.
    ///
    /// # Errors
    /// Those of reading both.
    pub fn compared(&self) -> impl Iterator<Item = Result<(Option<u64>, Picture)>> {
        self.compared.into_iter().flat_map(move |(state, is_compared)| {
            let times = (0..).zip(ERROR_TIMES_MS).zip(is_compared).filter(|(_, is_compared)| *is_compared);
            let shown = times.map(move |((index, ms), _)| Ok((Some(ms), self.written.read(index)?)));
            shown.chain(std::iter::once_with(move || Ok((None, self.references.picture(state)?))))
        })
    }

    /// Writes what is on show at view `view` of a way.
    ///
    /// # Errors
    /// Those of writing the file.
    pub(super) fn write_on_way<T: PagedTracer + Send>(
        &self,
        view: u32,
        session: &LiveSession<T>,
    ) -> Result<()> {
        self.written.write(ERROR_TIMES_MS.len() as u32 + view, |pixel| session.shown(pixel))
    }

    /// Errors of the pictures of a way, shown with `exposure`, all but that of its end.
    ///
    /// # Errors
    /// Those of reading both.
    pub(super) fn errors_of_way(&self, exposure: f32) -> Result<Vec<PictureError>> {
        let mut errors = vec![];
        for view in 0..WAY_VIEWS - 1 {
            let shown = self.written.read(ERROR_TIMES_MS.len() as u32 + view)?;
            errors.extend(PictureError::of(&shown, &self.references.picture(view)?, exposure));
        }
        Ok(errors)
    }

    /// What the errors of references alone are, shown with `exposure`.
    ///
    /// # Errors
    /// Those of reading them.
    pub(super) fn floor(&self, exposure: f32) -> Result<Option<ErrorFloor>> {
        self.references.floor(exposure)
    }
}
