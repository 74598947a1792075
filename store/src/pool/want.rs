//! What callers ask for: `Want`, its `Class`; and what the pool asks of a file: `PageStore`.

use crate::error::Result;
use crate::io::Extent;
use serde::Serialize;

/// How badly a page is needed. The order is the order of reading.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(rename_all = "lowercase")]
#[repr(u8)]
pub enum Class {
    /// Rays are blocked on it now.
    Urgent = 0,
    /// It will be used in this frame.
    Normal = 1,
    /// A predictor thinks that it will be used. Read in vain, it counts as wasted.
    Prefetch = 2,
    /// Of use some day; never at the cost of others.
    Background = 3,
}

impl Class {
    /// Prefetch and background: they enter with score 0, and may age the frames of others only slowly.
    pub fn is_low(self) -> bool {
        matches!(self, Class::Prefetch | Class::Background)
    }

    /// The class of the lowest two bits.
    pub(super) fn from_bits(bits: u64) -> Class {
        match bits & 3 {
            0 => Class::Urgent,
            1 => Class::Normal,
            2 => Class::Prefetch,
            _ => Class::Background,
        }
    }
}

/// Origins (callers with want-lists of their own) are `0 .. ORIGINS_MAX`: one bit each.
pub const ORIGINS_MAX: usize = 64;
/// Predictors whose guesses are counted apart.
pub const PREDICTORS: usize = 3;
/// Want-lists of these predictors: what they ask for as [`Class::Prefetch`] is counted as theirs.
pub const PREDICTOR_ORIGINS: std::ops::Range<usize> = ORIGINS_MAX - PREDICTORS..ORIGINS_MAX;

/// The predictor behind an origin; [`PREDICTORS`] for all others.
pub(super) fn predictor_of(origin: usize) -> u8 {
    origin.checked_sub(PREDICTOR_ORIGINS.start).unwrap_or(PREDICTORS) as u8
}

/// One entry of a want-list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Want {
    /// The page.
    pub page: u32,
    /// How badly.
    pub class: Class,
    /// Order within the class, greater first: blocked rays, saliency, projected error.
    pub weight: u32,
}

/// What the pool needs to know of a file. Implemented by the page file; by synthetic ones in tests.
pub trait PageStore: Send + Sync {
    /// Pages are `0 .. page_count`.
    fn page_count(&self) -> u32;

    /// Where `page` lies. Pages near in number should be near on disk: only those are read together.
    fn extent(&self, page: u32) -> Extent;

    /// Checks the hash of `stored`, then decodes it into `frame`, whose content is unspecified before. `scratch` is
    /// the calling thread's, kept between calls.
    ///
    /// # Errors
    /// When `stored` is damaged; the page counts as damaged from then on.
    fn install(&self, page: u32, stored: &[u8], frame: &mut [u8], scratch: &mut Vec<u8>) -> Result<()>;

    /// Bytes of a frame, the same for all pages. A multiple of 4096.
    fn frame_bytes(&self) -> usize;
}
