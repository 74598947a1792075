//! What callers ask for: `Want`; and what the pool asks of a file: `PageStore`.

use super::frame_room::FrameRoom;
use crate::cluster::SharedFrame;
use crate::error::Result;
use crate::io::{Backend, Extent, IoOptions};
use std::path::Path;

/// Origins (callers with want-lists of their own) are `0 .. ORIGINS_MAX`: one bit each.
pub const ORIGINS_MAX: usize = 64;

/// One entry of a want-list.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Want {
    /// The page.
    pub page: u32,
    /// How badly, greater first: blocked rays, saliency, projected error. 0: ahead, nobody waits for it; such pages get
    /// what others leave of reads and of decoders, and frames that nobody wants.
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
    /// When `stored` is damaged: the page counts as damaged from then on. That of [`FrameRoom`]: the page is read again
    /// when it is wanted again.
    fn install(
        &self,
        page: u32,
        stored: &[u8],
        frame: &mut FrameRoom<'_>,
        scratch: &mut Vec<u8>,
    ) -> Result<()>;

    /// About how many bytes of its frame `page` takes when it has been installed.
    fn expected_bytes(&self, _page: u32) -> usize {
        self.frame_bytes()
    }

    /// True where `install` leaves parts of the frame of `page` packed, for [`PageStore::unpack`].
    fn is_unpacked_later(&self, _page: u32) -> bool {
        false
    }

    /// Unpacks a cluster of `page`, unless it is there. Others read the frame, and may unpack as well. `grow` is told
    /// how many bytes at the begin of the frame are needed, and says whether there is memory for them.
    ///
    /// # Errors
    /// When it is damaged: it is lost then, and the page counts as damaged. When there is no memory.
    fn unpack(
        &self,
        _page: u32,
        _frame: SharedFrame<'_>,
        _cluster: usize,
        _grow: &dyn Fn(usize) -> bool,
    ) -> Result<()> {
        Ok(())
    }

    /// Reads the stored bytes of `page` into `stored` once more, by another way than the pool's: what it read was
    /// damaged, and may have been so on its way only. False where there is no other way.
    ///
    /// # Errors
    /// When it cannot be read.
    fn read_again(&self, _page: u32, _stored: &mut [u8]) -> Result<bool> {
        Ok(false)
    }

    /// True where pages come from afar, and most of the time of a read is the way.
    fn is_far(&self) -> bool {
        false
    }

    /// Bytes of a frame, the same for all pages. A multiple of 4096.
    fn frame_bytes(&self) -> usize;

    /// A backend that reads the bytes of `extent`s; `path` is where they are.
    ///
    /// # Errors
    /// Those of [`crate::io::open`].
    fn backend(&self, path: &Path, options: &IoOptions) -> Result<Box<dyn Backend>> {
        crate::io::open(path, options)
    }
}
