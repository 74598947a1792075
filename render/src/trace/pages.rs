//! Where traversal gets pages from. It never waits: a page is there, on its way, or damaged for good.

/// The answer of a page look-up.
pub enum Page<'a> {
    /// The frame; valid until the next look-up.
    Ready(&'a [u8]),
    /// The page is not in memory; the tracer records it.
    Missing,
    /// The page cannot be had: rays go on as if it were empty, and the damage is reported by the pool.
    Damaged,
}

/// Pages by id.
pub trait Pages {
    /// Looks `page` up. The frame stays where it is until the next call.
    fn page(&mut self, page: u32) -> Page<'_>;
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
        Page::Ready(self.frame(page))
    }
}
