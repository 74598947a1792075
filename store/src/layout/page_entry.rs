//! `PageEntry`: one page in the page table.
//!
//! Invariant: an entry that was parsed has lengths that a frame can hold, and a kind and a packing that are known.

use super::fields::{Cursor, FieldWriter};
use super::{FRAME_BYTES, PAGE_ENTRY_BYTES, STORED_BYTES};

/// Kinds of pages.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
#[repr(u8)]
pub enum PageKind {
    /// Clusters and the tree above them.
    Mesh = 0,
    /// Units of the lower octrees.
    Units = 1,
    /// Colours of the triangles of a mesh page.
    Colours = 2,
    /// Normals of the triangles of a mesh page.
    Normals = 3,
}

impl PageKind {
    /// Every kind.
    const ALL: [PageKind; 4] = [PageKind::Mesh, PageKind::Units, PageKind::Colours, PageKind::Normals];
    /// Kinds whose pages hold values of the corners of mesh pages.
    pub const OF_CORNERS: [PageKind; 2] = [PageKind::Colours, PageKind::Normals];

    /// The kind of a byte.
    fn from_byte(byte: u32) -> Option<PageKind> {
        PageKind::ALL.into_iter().find(|kind| *kind as u32 == byte)
    }
}

/// How a page or section is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum Packing {
    /// As it is.
    Raw = 0,
    /// One LZ4 block.
    Lz4 = 1,
}

/// One page in the page table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PageEntry {
    /// Where its stored bytes begin.
    pub offset: u64,
    /// XXH3-64 of the stored bytes, seeded with file id and page id.
    pub hash: u64,
    /// Length on disk.
    pub stored_bytes: u32,
    /// Length of the disk form after unpacking.
    pub unpacked_bytes: u32,
    /// Store id of its first triangle; of a page of colours or normals, of the first triangle that
    /// it is of.
    pub first_triangle: u32,
    /// Triangles in it.
    pub triangle_count: u32,
    /// Kind of the page's content.
    pub kind: PageKind,
    /// How it is stored.
    pub packing: Packing,
    /// Of a mesh page with colours: how many pages behind it the first page of these stands. Else 0.
    pub colours_behind: u32,
    /// Of a mesh page with normals: the same for these.
    pub normals_behind: u32,
}

impl PageEntry {
    /// Appends the entry as it stands on disk.
    pub fn write(&self, out: &mut Vec<u8>) {
        let mut w = FieldWriter(std::mem::take(out));
        w.u64(self.offset);
        w.u64(self.hash);
        w.u32(self.stored_bytes);
        w.u32(self.unpacked_bytes);
        w.u32(self.first_triangle);
        w.u32(self.triangle_count);
        w.u32(u32::from(self.kind as u8) | u32::from(self.packing as u8) << 8);
        w.u32(self.colours_behind);
        w.u32(self.normals_behind);
        *out = w.0;
    }

    /// Of a mesh page with values of one of [`PageKind::OF_CORNERS`]: how many pages behind it the first page of these
    /// stands. Else 0.
    pub fn values_behind(&self, kind: PageKind) -> u32 {
        match kind {
            PageKind::Colours => self.colours_behind,
            PageKind::Normals => self.normals_behind,
            PageKind::Mesh | PageKind::Units => 0,
        }
    }

    /// Sets [`Self::values_behind`].
    pub(crate) fn set_values_behind(&mut self, kind: PageKind, behind: u32) {
        match kind {
            PageKind::Colours => self.colours_behind = behind,
            PageKind::Normals => self.normals_behind = behind,
            PageKind::Mesh | PageKind::Units => {}
        }
    }

    /// Reads one entry; `None` when a field is out of its range.
    pub fn parse(bytes: &[u8; PAGE_ENTRY_BYTES]) -> Option<PageEntry> {
        let mut r = Cursor { bytes, at: 0 };
        let (offset, hash, stored_bytes, unpacked_bytes) = (r.u64(), r.u64(), r.u32(), r.u32());
        let (first_triangle, triangle_count) = (r.u32(), r.u32());
        let (kind, colours_behind, normals_behind) = (r.u32(), r.u32(), r.u32());
        let packing = match kind >> 8 {
            0 => Packing::Raw,
            1 => Packing::Lz4,
            _ => return None,
        };
        let page_kind = PageKind::from_byte(kind & 0xff)?;
        let sound = (page_kind == PageKind::Mesh
            || [colours_behind, normals_behind, triangle_count] == [0; 3])
            && (1..=STORED_BYTES as u32).contains(&stored_bytes)
            && (1..=FRAME_BYTES as u32).contains(&unpacked_bytes);
        sound.then_some(PageEntry {
            offset,
            hash,
            stored_bytes,
            unpacked_bytes,
            first_triangle,
            triangle_count,
            kind: page_kind,
            packing,
            colours_behind,
            normals_behind,
        })
    }
}
