//! `PagePool`: the pages of a file that are in memory now, under a limit.
//!
//! ```text
//!   rays --pin--> frame | nothing -> want        scheduler --submit(origin, wants)--> Requests
//!                   ^                                                                    |
//!                   '--- decode threads <--- staging slots <--- I/O thread (loader) <----'
//! ```
//!
//! | file | what |
//! |---|---|
//! | `word` | the state of a page, all transitions |
//! | `frames`, `frame_room`, `clock` | the memory of the frames; who owns them, who is evicted |
//! | `want`, `requests` | what is wanted, merged from all origins |
//! | `loader`, `jobs` | wants to reads, arrivals to frames |
//! | `page_pool`, `shared`, `options` | what callers hold, what the threads share, how it is set up |
//! | `pin` | how callers hold pages |
//! | `signal`, `stats`, `sync` | wake-ups, counters, atomics for the model checker |
//!
//! Invariants
//! 1. Memory is leased from the budget before it is taken: tables and staging at open, frames by `set_limit`; of
//!    these it is counted by blocks of 4 KiB, so that a page takes what it uses of its frame.
//! 2. `pin` takes no lock, makes no system call and allocates nothing. `unpin` neither, unless it is the last pin of a
//!    page while the loader starves for frames; then it rings a bell.
//! 3. A pinned page keeps its frame and its bytes. Nothing is read optimistically.
//! 4. Lock order: requests, then clock. No other two locks are held at once.
//! 5. No livelock on our side: the best want is read first, and a want gets a frame as long as one
//!    resident page has no pin (after frames owed to a smaller limit). Who needs several pages at once keeps pins on
//!    those that came: the oldest blocked tile keeps its own until it has run, and the scheduler bounds active tiles
//!    so that their pins leave at least one frame. Where all is pinned nevertheless, [`PagePool::is_saturated`] says
//!    so, and the loader sleeps until an unpin.
//!    What nobody waits for (weight 0) gets what is left: it loses its place in a full queue to what somebody waits
//!    for, a few reads of it are under way, and half of the decoders at most are busy with it.
//! 6. No idling on a dead pool: a panic of one of its threads ends it, and who waits for a page is told.
//! 7. A damaged page is never the end: it is marked, its error is kept, `pin` of it is `None` for ever.

mod blocking;
mod clock;
mod failure;
mod frame_room;
mod frames;
mod jobs;
mod loader;
#[cfg(all(test, loom))]
mod loom_tests;
mod options;
mod page_pool;
mod pin;
mod requests;
mod seats;
mod shared;
mod signal;
mod stats;
mod sync;
#[cfg(all(test, not(loom)))]
mod tests;
mod want;
mod word;

pub use frame_room::FrameRoom;
pub use options::{DECODE_THREADS_MAX, FRAMES_MIN, PoolOptions, ReadRoom};
pub use page_pool::{FrameCount, PagePool};
pub use pin::{Pin, PinToken};
pub use seats::{Seat, Seats};
pub use stats::PoolStats;
pub use want::{ORIGINS_MAX, PageStore, Want};
pub use word::PageState;
