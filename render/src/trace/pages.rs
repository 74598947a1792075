//! Where traversal gets pages from. It never waits: a page is there, on its way, or damaged for good.
//!
//! ```text
//! one ray after the other   page: looks one up; it may let go of all others
//! many rays at once         hold, hold, hold ..: frames stay where they are as long as any is borrowed
//!                           None: no more can be held -> what needs more ends, lets go, and begins again
//! ```
//!
//! Invariant: that nothing is let go of while rays read it is what borrows say: `hold` shares, `page` and `let_go` do
//! not.

use trex_store::cluster::Frame;

/// The answer of a page look-up.
pub enum Page<'a> {
    /// The frame; valid until the next look-up.
    Ready(Frame<'a>),
    /// The page is not in memory: a ray that is blocked by it says so by [`Pages::want`].
    Missing,
    /// The page cannot be had: rays go on as if it were empty, and the damage is reported by the pool.
    Damaged,
}

/// Pages by id: those of one worker, lent to whatever traces its rays, on the mesh or in the units.
pub trait Pages {
    /// Looks `page` up. The frame stays where it is until the next call.
    fn page(&mut self, page: u32) -> Page<'_>;

    /// Looks `page` up and holds it beside all that are held: its frame stays where it is as long as it is borrowed.
    /// `None` when no more can be held until [`Pages::let_go`], which is no answer: whoever needs the page is to ask
    /// [`Pages::page`] in the end, which always has room for one. So there is no way to wait for room that never comes.
    fn hold(&self, _page: u32) -> Option<Page<'_>> {
        None
    }

    /// Lets go of all pages.
    fn let_go(&mut self) {}

    /// Learns that `page` was missing and blocked a ray, or made a coarser form stand in: once for each such ray.
    fn want(&mut self, _page: u32) {}
}

/// The pages of a tracer that has none, and of rays that ask for none.
pub(crate) struct NoPages;

impl Pages for NoPages {
    fn page(&mut self, _page: u32) -> Page<'_> {
        Page::Damaged
    }

    fn hold(&self, _page: u32) -> Option<Page<'_>> {
        Some(Page::Damaged)
    }
}

impl Pages for &mut dyn Pages {
    fn page(&mut self, page: u32) -> Page<'_> {
        (**self).page(page)
    }

    fn hold(&self, page: u32) -> Option<Page<'_>> {
        (**self).hold(page)
    }

    fn let_go(&mut self) {
        (**self).let_go();
    }

    fn want(&mut self, page: u32) {
        (**self).want(page);
    }
}

/// The pages of a file, all in memory: for models that fit, and for tests.
pub struct AllResident {
    words: Vec<u64>,
}

impl AllResident {
    /// Reads all pages of a file.
    ///
    /// # Panics
    /// When a page is damaged or cannot be read: for whole files only.
    pub fn load(file: &trex_store::PageFile) -> AllResident {
        let per_frame = trex_store::layout::FRAME_BYTES / 8;
        let mut words = vec![0u64; file.pages().len() * per_frame];
        let mut buffers = [Vec::new(), Vec::new()];
        for (page, frame) in (0..).zip(words.chunks_mut(per_frame)) {
            file.read_page(page, bytemuck::cast_slice_mut(frame), &mut buffers).expect("a whole file");
        }
        AllResident { words }
    }
}

impl AllResident {
    /// The frame of `page`.
    ///
    /// # Panics
    /// When the file has no such page.
    pub fn frame(&self, page: u32) -> &[u8] {
        let bytes: &[u8] = bytemuck::cast_slice(&self.words);
        let frame_bytes = trex_store::layout::FRAME_BYTES;
        &bytes[page as usize * frame_bytes..][..frame_bytes]
    }
}

impl Pages for &AllResident {
    fn page(&mut self, page: u32) -> Page<'_> {
        Page::Ready(self.frame(page).into())
    }

    fn hold(&self, page: u32) -> Option<Page<'_>> {
        Some(Page::Ready(self.frame(page).into()))
    }
}
