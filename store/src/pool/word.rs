//! `Word`: the whole state of a page in one atomic u64. All transitions stand here.
//!
//! ```text
//!            enqueue               begin_read              install
//!   ABSENT ----------> QUEUED ----------------> READING ------------> RESIDENT --.
//!     ^  ^   unqueue     |      (frame given)      |     (frame full)   |   ^    | try_pin, unpin, cool
//!     |  |---------------'        abandon          | damage             |   '----'
//!     |  '-----------------------------------------|                    |
//!     |                                            v                    |
//!     |                                         DAMAGED                 |
//!     '-----------------------------------------------------------------'
//!                 evict (pins = 0; frame taken back; generation + 1)
//!
//!   bits   63 .. 46     45      44 .. 21   20 .. 5   4 .. 3   2 .. 0
//!          generation   ahead   frame      pins      score    state
//! ```
//!
//! Invariants
//! 1. `pins > 0` only in RESIDENT; a page with pins is never evicted.
//! 2. The frame field means something in READING and RESIDENT only. In READING the frame belongs to the loader alone,
//!    who writes it; in RESIDENT it is read only, by those who hold a pin.
//! 3. `install` releases what was written to the frame, `try_pin` acquires it; `unpin` releases what was read,
//!    `cool` acquires that before the frame is given to another page. So a frame is never torn.
//! 4. DAMAGED is final: nothing leaves it.
//! 5. `ahead` is set in READING and RESIDENT only: the page was read before anybody waited for it, and nobody has asked
//!    for it since.

use super::sync::{AtomicU64, Ordering};

const SCORE_SHIFT: u32 = 3;
const PIN_SHIFT: u32 = 5;
const FRAME_SHIFT: u32 = 21;
const AHEAD_SHIFT: u32 = 45;
const GENERATION_SHIFT: u32 = 46;
const PIN_ONE: u64 = 1 << PIN_SHIFT;
const GENERATION_MASK: u64 = (1 << (64 - GENERATION_SHIFT)) - 1;

/// Most pins on one page. Beyond it `try_pin` says no.
pub(super) const PINS_MAX: u64 = (1 << (FRAME_SHIFT - PIN_SHIFT)) - 1;
/// Most frames of a pool: 1 TiB of 64 KiB.
pub(super) const FRAMES_MAX: usize = 1 << (AHEAD_SHIFT - FRAME_SHIFT);
/// Best clock score: the hand passes three times before it takes the page.
pub(super) const SCORE_MAX: u64 = 3;
/// Score of a page that has come, and that somebody waits for; 0 of others: they go first.
pub(super) const SCORE_FIRST: u64 = 2;

/// What a page is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum PageState {
    /// On disk only; nobody has asked for it.
    Absent = 0,
    /// Wanted, not yet read.
    Queued = 1,
    /// Being read or decoded.
    Reading = 2,
    /// In a frame.
    Resident = 3,
    /// Could not be read or decoded. Final.
    Damaged = 4,
}

/// A word, taken apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct View {
    pub(super) state: PageState,
    pub(super) score: u64,
    pub(super) pins: u64,
    pub(super) frame: u32,
    /// Read ahead, and not asked for since.
    pub(super) ahead: bool,
    /// Evictions so far, modulo 2^18 without 0: not 0 once the page was evicted.
    pub(super) generation: u64,
}

impl View {
    fn from_bits(bits: u64) -> View {
        View {
            state: match bits & 7 {
                0 => PageState::Absent,
                1 => PageState::Queued,
                2 => PageState::Reading,
                3 => PageState::Resident,
                4 => PageState::Damaged,
                other => unreachable!("page state {other}"),
            },
            score: bits >> SCORE_SHIFT & 3,
            pins: bits >> PIN_SHIFT & PINS_MAX,
            frame: (bits >> FRAME_SHIFT) as u32 & (FRAMES_MAX - 1) as u32,
            ahead: bits >> AHEAD_SHIFT & 1 == 1,
            generation: bits >> GENERATION_SHIFT,
        }
    }

    fn to_bits(self) -> u64 {
        debug_assert!(self.score <= SCORE_MAX && self.pins <= PINS_MAX && (self.frame as usize) < FRAMES_MAX);
        self.state as u64
            | self.score << SCORE_SHIFT
            | self.pins << PIN_SHIFT
            | u64::from(self.frame) << FRAME_SHIFT
            | u64::from(self.ahead) << AHEAD_SHIFT
            | self.generation << GENERATION_SHIFT
    }
}

/// What the clock hand did to a page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CoolOutcome {
    /// Evicted: the frame is the caller's.
    Evicted,
    /// Evicted, of a page that was read ahead and that nobody has asked for.
    Wasted,
    /// Its score went down by one; by [`Word::take_cold`] it stays as it is.
    Warm,
    /// Pinned, or being read: not to be touched.
    Busy,
}

/// The atomic word of one page.
pub(super) struct Word(AtomicU64);

impl Word {
    /// A page that is on disk only.
    pub(super) fn absent() -> Word {
        Word(AtomicU64::new(0))
    }

    /// The word as it is now.
    pub(super) fn view(&self) -> View {
        View::from_bits(self.0.load(Ordering::Acquire))
    }

    /// Pins the page if it is resident and raises its score by one. What it was before. Who looks ahead does not ask
    /// for it.
    pub(super) fn try_pin(&self, looks_ahead: bool) -> Option<View> {
        let before = self.change(|view| {
            if view.state != PageState::Resident || view.pins == PINS_MAX {
                return None;
            }
            let (pins, score) = (view.pins + 1, (view.score + 1).min(SCORE_MAX));
            Some(View { pins, score, ahead: view.ahead && looks_ahead, ..view })
        });
        before.ok()
    }

    /// Somebody asks for a page that is being read. True when it is read ahead: it no longer is.
    pub(super) fn ask(&self) -> bool {
        let asked = self.change(|view| {
            (view.state == PageState::Reading && view.ahead).then_some(View { ahead: false, ..view })
        });
        asked.is_ok()
    }

    /// Takes one pin back. True when it was the last.
    ///
    /// # Panics
    /// When there is no pin to take back.
    pub(super) fn unpin(&self) -> bool {
        // SeqCst: the loader that starves raises its flag and then looks at pins; we drop the pin and then look at its
        // flag. In one total order one of the two sees the other.
        let before = View::from_bits(self.0.fetch_sub(PIN_ONE, Ordering::SeqCst));
        assert!(before.pins > 0 && before.state == PageState::Resident, "unpin of {before:?}");
        before.pins == 1
    }

    /// ABSENT to QUEUED. The page's state before, when it was another.
    pub(super) fn enqueue(&self) -> Result<(), PageState> {
        self.advance(PageState::Absent, |view| View { state: PageState::Queued, ..view })
    }

    /// QUEUED to ABSENT: nobody wants it any more.
    pub(super) fn unqueue(&self) {
        let moved = self.advance(PageState::Queued, |view| View { state: PageState::Absent, ..view });
        assert!(moved.is_ok(), "unqueue of a page that is {moved:?}");
    }

    /// QUEUED to READING, into `frame`; ahead, where nobody waits for it.
    pub(super) fn begin_read(&self, frame: u32, ahead: bool) {
        let moved = self.advance(PageState::Queued, |view| View {
            state: PageState::Reading,
            frame,
            score: 0,
            ahead,
            ..view
        });
        assert!(moved.is_ok(), "begin_read of a page that is {moved:?}");
    }

    /// READING to RESIDENT: the frame is full.
    pub(super) fn install(&self) {
        let moved = self.advance(PageState::Reading, |view| View {
            state: PageState::Resident,
            score: if view.ahead { 0 } else { SCORE_FIRST },
            ..view
        });
        assert!(moved.is_ok(), "install of a page that is {moved:?}");
    }

    /// READING to ABSENT: there was no room for the page. The frame is the caller's.
    pub(super) fn abandon(&self) {
        let moved = self.advance(PageState::Reading, |view| View {
            state: PageState::Absent,
            frame: 0,
            ahead: false,
            ..view
        });
        assert!(moved.is_ok(), "abandon of a page that is {moved:?}");
    }

    /// READING to DAMAGED. The frame is the caller's.
    pub(super) fn damage(&self) {
        let moved = self.advance(PageState::Reading, |view| View {
            state: PageState::Damaged,
            frame: 0,
            ahead: false,
            ..view
        });
        assert!(moved.is_ok(), "damage of a page that is {moved:?}");
    }

    /// The clock hand passes: RESIDENT without pins loses one score, or at score 0 goes to ABSENT.
    pub(super) fn cool(&self) -> CoolOutcome {
        self.pass(true)
    }

    /// A hand passes that leaves scores as they are: RESIDENT without pins at score 0 goes to ABSENT.
    pub(super) fn take_cold(&self) -> CoolOutcome {
        self.pass(false)
    }

    fn pass(&self, cools: bool) -> CoolOutcome {
        let before = self.change(|view| {
            if view.state != PageState::Resident || view.pins > 0 {
                return None;
            }
            if view.score > 0 {
                return Some(View { score: view.score - u64::from(cools), ..view });
            }
            Some(View {
                state: PageState::Absent,
                frame: 0,
                ahead: false,
                generation: next_generation(view.generation),
                ..view
            })
        });
        match before {
            Ok(view) if view.score == 0 && view.ahead => CoolOutcome::Wasted,
            Ok(view) if view.score == 0 => CoolOutcome::Evicted,
            Ok(_) => CoolOutcome::Warm,
            Err(_) => CoolOutcome::Busy,
        }
    }

    fn advance(&self, from: PageState, to: impl Fn(View) -> View) -> Result<(), PageState> {
        self.change(|view| (view.state == from).then(|| to(view))).map(drop).map_err(|view| view.state)
    }

    /// Replaces the word by what `next` makes of it. The view before; `Err` with it where `next` says no.
    fn change(&self, mut next: impl FnMut(View) -> Option<View>) -> Result<View, View> {
        let mut bits = self.0.load(Ordering::Acquire);
        loop {
            let view = View::from_bits(bits);
            let Some(after) = next(view) else { return Err(view) };
            match self.0.compare_exchange(bits, after.to_bits(), Ordering::AcqRel, Ordering::Acquire) {
                Ok(_) => return Ok(view),
                Err(now) => bits = now,
            }
        }
    }
}

/// Counts on, past 0.
fn next_generation(generation: u64) -> u64 {
    if generation == GENERATION_MASK { 1 } else { generation + 1 }
}

const _: () = assert!(GENERATION_SHIFT + 18 == 64 && FRAMES_MAX == 1 << 24 && PINS_MAX == 65_535);

#[cfg(all(test, not(loom)))]
mod tests;
