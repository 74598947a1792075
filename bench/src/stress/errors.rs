//! How wrong a picture is at some times after its event: snapshots of what is shown, compared with references.
//!
//! ```text
//! references: each state of the scenario at leisure, many samples -> a file
//! a frame that may end after a time of interest: the picture before it is copied; it counts if the frame did
//! after the hold: copies against the reference -> relMSE, FLIP
//! ```
//!
//! Invariants: 1. a copy is of what was on show at its time; 2. its memory is leased: halves of 16 bits, whose rounding
//! (2^-11) is far below any error of interest; 3. nothing is compared while a view is held.

use half::f16;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;
use std::time::Duration;
use trex_image::{Constants, Picture, compare, flip, flip_bytes};
use trex_render::{Film, LiveSession, PagedTracer};
use trex_store::{Budget, Error, Lease, Result};

/// Times after an event at which errors are told, ms.
pub const ERROR_TIMES_MS: [u64; 7] = [33, 80, 100, 200, 300, 1000, 3000];

/// How wrong a picture is.
#[derive(Clone, Copy, Debug)]
pub(super) struct PictureError {
    pub(super) relmse: f64,
    /// Of the picture as it is shown.
    pub(super) flip: f64,
}

/// Bytes before the pictures in a file of references: what they are of.
const HEAD_BYTES: u64 = 16;

/// What references are of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReferencesKey {
    /// A hash of all that decides them.
    pub hash: u64,
    /// States.
    pub count: u32,
}

impl ReferencesKey {
    fn head(self) -> [u8; HEAD_BYTES as usize] {
        let mut head = *b"trexref0\0\0\0\0\0\0\0\0";
        head[4..8].copy_from_slice(&self.count.to_le_bytes());
        head[8..].copy_from_slice(&self.hash.to_le_bytes());
        head
    }
}

/// The pictures that others are measured by, one a state, in a file.
#[derive(Debug)]
pub struct References {
    file: File,
    /// The folder that the file is in, for errors.
    place: PathBuf,
    resolution: [u32; 2],
    count: u32,
}

/// The pictures of a hold that are to be compared.
#[derive(Debug)]
pub struct Snapshots {
    resolution: [u32; 2],
    /// What was on show before the frame at hand, if it is of interest.
    before: Vec<[f16; 3]>,
    is_fresh: bool,
    taken: [Option<Vec<[f16; 3]>>; ERROR_TIMES_MS.len()],
    /// Times that have passed.
    is_over: [bool; ERROR_TIMES_MS.len()],
    /// Room of those that are not taken.
    room: Vec<Vec<[f16; 3]>>,
    _lease: Lease,
}

impl PictureError {
    /// That of `picture`, shown with `exposure`; `None` where no pixel can be compared.
    fn of(picture: &Picture, reference: &Picture, exposure: f32) -> Option<PictureError> {
        let relmse = compare(picture, reference, Constants::default()).all.relmse?;
        Some(PictureError { relmse, flip: flip(picture, reference, exposure) })
    }
}

impl References {
    /// No references yet; `file` is empty and lies in `place`.
    pub fn new(file: File, place: PathBuf, resolution: [u32; 2]) -> References {
        References { file, place, resolution, count: 0 }
    }

    /// The references that [`References::finish`] left in `file`, `place`; `None` where it left none, or other ones.
    ///
    /// # Errors
    /// Those of reading the file.
    pub fn kept(
        file: File,
        place: PathBuf,
        resolution: [u32; 2],
        of: ReferencesKey,
    ) -> Result<Option<References>> {
        let pixels = u64::from(resolution[0]) * u64::from(resolution[1]);
        let needed = HEAD_BYTES + u64::from(of.count) * pixels * size_of::<[f32; 3]>() as u64;
        let length = file.metadata().map_err(|error| Error::io("read references", &place, &error))?.len();
        let mut head = [0; HEAD_BYTES as usize];
        if length < needed {
            return Ok(None);
        }
        file.read_exact_at(&mut head, 0).map_err(|error| Error::io("read references", &place, &error))?;
        let is_same = head == of.head();
        Ok(is_same.then_some(References { file, place, resolution, count: of.count }))
    }

    /// Notes that all references are there, for runs to come.
    ///
    /// # Errors
    /// Those of writing the file.
    pub fn finish(&self, of: ReferencesKey) -> Result<()> {
        assert_eq!(self.count, of.count, "a state without a reference");
        let written = self.file.write_all_at(&of.head(), 0);
        written.map_err(|error| Error::io("write references", &self.place, &error))
    }

    /// Adds the picture of the next state.
    ///
    /// # Errors
    /// Those of writing the file.
    pub fn add(&mut self, film: &Film) -> Result<()> {
        self.write(self.count, |pixel| film.radiance(pixel))?;
        self.count += 1;
        Ok(())
    }

    /// Copies what is on show, as a picture that is to be compared with that of state `index`.
    ///
    /// # Errors
    /// Those of writing the file.
    pub(super) fn copy(&self, index: u32, shown: impl Fn([u32; 2]) -> [f32; 3]) -> Result<()> {
        assert!(index < self.count, "a state without a reference");
        self.write(self.count + index, shown)
    }

    /// Error of the copy of state `index`, shown with `exposure`; `None` where nothing can be compared.
    ///
    /// # Errors
    /// Those of reading the file.
    pub(super) fn error_of_copy(&self, index: u32, exposure: f32) -> Result<Option<PictureError>> {
        Ok(PictureError::of(&self.read(self.count + index)?, &self.read(index)?, exposure))
    }

    /// Writes the picture at place `index` of the file.
    fn write(&self, index: u32, radiance: impl Fn([u32; 2]) -> [f32; 3]) -> Result<()> {
        let [width, height] = self.resolution;
        for y in 0..height {
            let row: Vec<[f32; 3]> = (0..width).map(|x| radiance([x, y])).collect();
            let bytes: &[u8] = bytemuck::cast_slice(&row);
            let row = u64::from(index) * u64::from(height) + u64::from(y);
            let at = HEAD_BYTES + row * bytes.len() as u64;
            let written = self.file.write_all_at(bytes, at);
            written.map_err(|error| Error::io("write a picture to be compared", &self.place, &error))?;
        }
        Ok(())
    }

    /// The picture at place `index` of the file: that of a state, behind them the copies.
    fn read(&self, index: u32) -> Result<Picture> {
        assert!(index < 2 * self.count, "a state without a reference");
        let [width, height] = self.resolution;
        let mut pixels = vec![[0f32; 3]; width as usize * height as usize];
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut pixels);
        let at = HEAD_BYTES + u64::from(index) * bytes.len() as u64;
        let read = self.file.read_exact_at(bytes, at);
        read.map_err(|error| Error::io("read a reference picture", &self.place, &error))?;
        Ok(Picture { width, height, pixels })
    }
}

impl Snapshots {
    /// Bytes that snapshots take at `resolution` (width, height; pixels), with the two pictures that are compared.
    pub fn bytes(resolution: [u32; 2]) -> u64 {
        let pixels = u64::from(resolution[0]) * u64::from(resolution[1]);
        let copies = (1 + ERROR_TIMES_MS.len()) * size_of::<[f16; 3]>();
        pixels * (copies + 2 * size_of::<[f32; 3]>()) as u64 + flip_bytes(resolution[0])
    }

    /// Room for the pictures of one hold.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when `budget` has no room for [`Snapshots::bytes`].
    pub fn new(resolution: [u32; 2], budget: &Budget) -> Result<Snapshots> {
        let lease = budget.lease("pictures to be compared", Snapshots::bytes(resolution))?;
        let pixels = resolution[0] as usize * resolution[1] as usize;
        let picture = || vec![[f16::ZERO; 3]; pixels];
        let room = ERROR_TIMES_MS.map(|_| picture()).into();
        Ok(Snapshots {
            resolution,
            before: picture(),
            is_fresh: false,
            taken: Default::default(),
            is_over: Default::default(),
            room,
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
            let width = self.resolution[0] as usize;
            for (y, row) in self.before.chunks_exact_mut(width).enumerate() {
                for (x, pixel) in row.iter_mut().enumerate() {
                    *pixel = session.shown([x as u32, y as u32]).map(f16::from_f32);
                }
            }
        }
    }

    /// Keeps the copy for the times of interest that have passed, `now` after the event.
    pub(super) fn after_frame(&mut self, now: Duration) {
        for (index, ms) in ERROR_TIMES_MS.iter().enumerate() {
            let has_passed = now >= Duration::from_millis(*ms) && !self.is_over[index];
            self.is_over[index] |= has_passed;
            // A frame that took longer than any should has no picture from before it.
            if has_passed && self.is_fresh {
                let mut copy = self.room.pop().expect("as many pictures as times");
                copy.copy_from_slice(&self.before);
                self.taken[index] = Some(copy);
            }
        }
    }

    /// True when every time has passed.
    pub(super) fn are_taken(&self) -> bool {
        self.is_over.iter().all(|is_over| *is_over)
    }

    /// Errors of the copies, shown with `exposure`, against state `state`, by time; `None` for times that were not
    /// reached. They are forgotten.
    ///
    /// # Errors
    /// Those of reading the reference.
    pub(super) fn errors(
        &mut self,
        references: &References,
        state: u32,
        exposure: f32,
    ) -> Result<[Option<PictureError>; ERROR_TIMES_MS.len()]> {
        let reference = references.read(state)?;
        let [width, height] = self.resolution;
        let mut errors = [None; ERROR_TIMES_MS.len()];
        self.is_over = Default::default();
        for (error, taken) in errors.iter_mut().zip(&mut self.taken) {
            let Some(copy) = taken.take() else { continue };
            let pixels = copy.iter().map(|pixel| pixel.map(f16::to_f32)).collect();
            let picture = Picture { width, height, pixels };
            *error = PictureError::of(&picture, &reference, exposure);
            self.room.push(copy);
        }
        Ok(errors)
    }
}
