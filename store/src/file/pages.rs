//! Pages of a file, read, checked and installed: one by one, and as a pool asks for them.
//!
//! Invariant: the hash of a page is compared before anything of it is decoded.

use super::{PageFile, twice};
use crate::cluster::{
    ArrivingPage, Colour, FrameView, Normal, SharedFrame, UnpackError, install, install_values, unpack,
};
use crate::error::{Code, Error, Result};
use crate::io::{Backend, Extent, IoOptions};
use crate::layout::{FRAME_BYTES, Packing, PageKind, page_hash};
use crate::next_step::NextStep;
use crate::octree::{UnitsContext, install_units};
use crate::pool::{FrameRoom, PageStore};
use std::path::Path;

/// About how many bytes nodes and notes of a page take in a frame, and what is left over of a block.
const HEAD_BYTES: usize = 6 << 10;

impl PageFile {
    /// Checks the stored bytes of `page` and decodes all of them into `frame` (64 KiB). `scratch` is reused memory.
    ///
    /// # Errors
    /// [`Code::Damaged`] with the page's place; the frame's content is then not specified.
    pub fn install(&self, page: u32, stored: &[u8], frame: &mut [u8], scratch: &mut Vec<u8>) -> Result<()> {
        self.install_form(page, (stored, false), &mut FrameRoom::from(frame), scratch)
    }

    /// [`PageFile::install`], or all but the clusters of a page of the mesh, where it `is_packed`.
    fn install_form(
        &self,
        page: u32,
        (stored, is_packed): (&[u8], bool),
        room: &mut FrameRoom<'_>,
        scratch: &mut Vec<u8>,
    ) -> Result<()> {
        self.check_hash(page, stored)?;
        let entry = &self.pages[page as usize];
        let raw = match entry.packing {
            Packing::Raw => stored,
            Packing::Lz4 => {
                scratch.resize(entry.unpacked_bytes as usize, 0);
                match lz4_flex::block::decompress_into(stored, scratch) {
                    Ok(length) if length == scratch.len() => scratch.as_slice(),
                    _ => return Err(self.damaged_page(page, "a page cannot be unpacked")),
                }
            }
        };
        if raw.len() != entry.unpacked_bytes as usize {
            return Err(self.damaged_page(page, "a page has another length than its table says"));
        }
        if entry.kind == PageKind::Units {
            let is_units = &|page| self.has_units(page);
            let context = UnitsContext { material_count: self.materials.len(), is_units };
            return install_units(raw, &context, room.whole()?).map_err(|what| self.damaged_page(page, what));
        }
        let installed = match entry.kind {
            PageKind::Colours => Some(install_values::<Colour>(raw, room.whole()?)),
            PageKind::Normals => Some(install_values::<Normal>(raw, room.whole()?)),
            PageKind::Mesh | PageKind::Units => None,
        };
        if let Some(installed) = installed {
            let used_bytes = installed.map_err(|what| self.damaged_page(page, what))?;
            return room.ends(used_bytes, 0).map(drop);
        }
        let (lattice_bits, material_count) = (self.block.lattice_bits, self.materials.len());
        let damaged = |what| self.damaged_page(page, what);
        let frame = if is_packed {
            let arriving = ArrivingPage::read(raw).map_err(damaged)?;
            let [head, tail] = arriving.ends();
            let frame = room.ends(head, tail)?;
            arriving.install((lattice_bits, material_count), frame).map_err(damaged)?;
            frame
        } else {
            let frame = room.whole()?;
            install(raw, lattice_bits, frame).map_err(damaged)?;
            frame
        };
        let view = FrameView::new(&*frame);
        let sound = view.root_count() >= usize::from(self.root_counts[page as usize])
            && view.triangle_count() == entry.triangle_count as usize
            && (is_packed || usize::from(view.greatest_material()) < material_count);
        if sound { Ok(()) } else { Err(self.damaged_page(page, "a page is not what the tables say of it")) }
    }

    /// Reads and installs one page on the calling thread, without a pool.
    ///
    /// # Errors
    /// Those of [`PageFile::install`], and [`Code::Io`].
    pub fn read_page(&self, page: u32, frame: &mut [u8], buffers: &mut [Vec<u8>; 2]) -> Result<()> {
        let entry = &self.pages[page as usize];
        let [stored, scratch] = buffers;
        stored.resize(entry.stored_bytes as usize, 0);
        twice(&self.file, (entry.offset, u64::from(entry.stored_bytes)), || {
            self.read_stored(page, stored)?;
            self.install(page, stored, frame, scratch)
        })
    }

    /// Tells that pages are read one by one from `page` on: behind HTTP they come in runs then.
    pub(crate) fn fetch_run(&self, page: u32) {
        let entry = &self.pages[page as usize];
        let end = self.pages.last().map_or(0, |last| last.offset + u64::from(last.stored_bytes));
        self.file.fetch_run((entry.offset, u64::from(entry.stored_bytes)), end);
    }

    /// Reads one page and compares it with its hash; nothing is decoded.
    pub(crate) fn check_page(&self, page: u32, stored: &mut Vec<u8>) -> Result<()> {
        let entry = &self.pages[page as usize];
        stored.resize(entry.stored_bytes as usize, 0);
        twice(&self.file, (entry.offset, u64::from(entry.stored_bytes)), || {
            self.read_stored(page, stored)?;
            self.check_hash(page, stored)
        })
    }

    fn check_hash(&self, page: u32, stored: &[u8]) -> Result<()> {
        let expected = self.pages[page as usize].hash;
        let found = page_hash(stored, self.block.file_id, page);
        if found == expected {
            return Ok(());
        }
        let numbers = format!("page {page}: hash {found:016x}, expected {expected:016x}");
        Err(self.damaged_page(page, "a page does not match its hash").numbers(numbers))
    }

    /// The bytes of a page as they lie in the file, unchecked.
    fn read_stored(&self, page: u32, stored: &mut [u8]) -> Result<()> {
        let offset = self.pages[page as usize].offset;
        self.file.read_exact_at(stored, offset).map_err(|e| Error::io("read", &self.path, &e))
    }

    fn damaged_page(&self, page: u32, what: &str) -> Error {
        Error::new(Code::Damaged, what)
            .at_byte(&self.path, self.pages[page as usize].offset)
            .numbers(format!("page {page}, {} bytes", self.pages[page as usize].stored_bytes))
            .next(NextStep::Verify)
    }
}

impl PageStore for PageFile {
    fn page_count(&self) -> u32 {
        self.pages.len() as u32
    }

    fn extent(&self, page: u32) -> Extent {
        let entry = &self.pages[page as usize];
        Extent { offset: entry.offset, stored_bytes: entry.stored_bytes }
    }

    fn install(
        &self,
        page: u32,
        stored: &[u8],
        frame: &mut FrameRoom<'_>,
        scratch: &mut Vec<u8>,
    ) -> Result<()> {
        self.install_form(page, (stored, true), frame, scratch)
    }

    fn expected_bytes(&self, page: u32) -> usize {
        let entry = &self.pages[page as usize];
        match entry.kind {
            PageKind::Mesh => (entry.unpacked_bytes as usize + HEAD_BYTES).min(FRAME_BYTES),
            _ => FRAME_BYTES,
        }
    }

    fn is_unpacked_later(&self, page: u32) -> bool {
        self.has_mesh(page)
    }

    fn unpack(
        &self,
        page: u32,
        frame: SharedFrame<'_>,
        cluster: usize,
        grow: &dyn Fn(usize) -> bool,
    ) -> Result<()> {
        unpack(frame, cluster, self.materials.len(), grow).map_err(|error| match error {
            UnpackError::Damaged(what) => self.damaged_page(page, what),
            UnpackError::NoRoom => {
                Error::new(Code::MemoryLimit, "no room for a cluster beside what is in use")
                    .at_byte(&self.path, self.pages[page as usize].offset)
                    .numbers(format!("page {page}, cluster {cluster}"))
                    .next(NextStep::RaiseLimitOrCheckDevice)
            }
        })
    }

    fn read_again(&self, page: u32, stored: &mut [u8]) -> Result<bool> {
        self.file.drop_cached(self.pages[page as usize].offset, stored.len() as u64);
        self.read_stored(page, stored).map(|()| true)
    }

    fn is_far(&self) -> bool {
        self.file.is_far()
    }

    fn frame_bytes(&self) -> usize {
        FRAME_BYTES
    }

    fn backend(&self, path: &Path, options: &IoOptions) -> Result<Box<dyn Backend>> {
        self.file.backend(path, options)
    }
}
