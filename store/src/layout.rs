//! Every number of the format, once: magic, version, maxima, hashes; `superblock` and `page_entry` are its records.
//! `docs/format.md` draws the same in rows.
//!
//! ```text
//! file = superblock | page 0 | page 1 | ... | section | section | ... | superblock (same bytes)
//! ```
//!
//! Invariants: 1. all numbers on disk are little-endian and of fixed width; 2. pages and sections stand without
//! gaps, so the two superblocks, the page hashes and the section hashes cover every byte; 3. both superblocks
//! hold the same bytes; 4. what is read passes `Superblock::parse` before any field is believed.

use crate::error::{Code, Error};
use xxhash_rust::xxh3::{Xxh3, xxh3_64_with_seed};

mod fields;
mod page_entry;
mod superblock;

pub use page_entry::{Packing, PageEntry, PageKind};
pub use superblock::{Section, Superblock};

/// First bytes of a file. The line ends show a transfer in text mode.
pub const MAGIC: [u8; 8] = *b"TREX\r\n\x1a\n";
/// Version of the format; another one is refused.
pub const VERSION: u32 = 7;
/// Required features that this build knows. A bit that is not known here refuses the file.
pub const REQUIRED_FEATURES: u64 = FEATURE_LOWER | FEATURE_COLOURS | FEATURE_NORMALS;
/// The file has pages of units, and the section that links them.
pub const FEATURE_LOWER: u64 = 1;
/// The file has pages of colours.
pub const FEATURE_COLOURS: u64 = 2;
/// The file has pages of normals.
pub const FEATURE_NORMALS: u64 = 4;

/// Bytes of a frame: the memory of one page, whatever its size on disk.
pub const FRAME_BYTES: usize = 64 << 10;
/// Most triangles of a cluster: 7-bit counts, and 16 leaves of 8 at most.
pub const CLUSTER_TRIANGLES: usize = 128;
/// Most vertices of a cluster: a corner is a 7-bit index.
pub const CLUSTER_VERTICES: usize = 128;
/// Most triangles of a leaf: the width of an AVX2 register in f32.
pub const LEAF_TRIANGLES: usize = 8;
/// Most leaves of a cluster.
pub const CLUSTER_LEAVES: usize = CLUSTER_TRIANGLES / LEAF_TRIANGLES;
/// Children of a node: eight 16-bit planes fill half of an AVX2 register.
pub const NODE_WIDTH: usize = 8;
/// Most bits of a packed vertex: at any bit offset within a byte it fits one unaligned 64-bit load.
pub const VERTEX_BITS: u32 = 57;
/// Most bits of one axis of a packed vertex: such a number is exact in f32.
pub const AXIS_BITS: u32 = 24;
/// Lattice bits up to which differences of lattice coordinates are exact in f32, so that rays are tested
/// in f32; finer lattices are traced in f64.
pub const NARROW_BITS: u32 = 24;
/// Most page roots of one page (a root's slot is stored in [`crate::cluster::ROOT_SLOT_BITS`] bits).
pub const PAGE_ROOTS: usize = 64;
/// Most pages of a file: page ids share a word with the slot and a flag.
pub const PAGES: u32 = 1 << 25;
/// Most materials: a palette entry is a 16-bit index.
pub const MATERIALS: usize = 1 << 16;
/// Most bytes of a material's name: longer ones are cut when they are read from an input.
pub const MATERIAL_NAME_BYTES: usize = 255;
/// Most bytes of a material in its section: six for each of the name in JSON, numbers and keys.
pub const MATERIAL_JSON_BYTES: usize = 2048;
/// Most triangles: ids are 32-bit, the last one means "none".
pub const TRIANGLES: u64 = u32::MAX as u64 - 1;
/// Deepest tree, in 8-wide nodes, of a page and of the top: traversal stacks have room for it.
pub const TREE_DEPTH: usize = 64;
/// Bytes of an emitter: nine lattice coordinates as i64, material u32, triangle id u32.
pub const EMITTER_BYTES: usize = 80;
/// Longest stored form of a page: the frame is the bound, since the disk form is smaller than the frame's.
pub const STORED_BYTES: usize = FRAME_BYTES;
/// Bytes of a superblock, zero-padded, the hash in the last eight.
pub const SUPERBLOCK_BYTES: usize = 1024;
/// Bytes of one entry of the page table.
pub const PAGE_ENTRY_BYTES: usize = 44;
/// Sections that fit the superblock.
pub const SECTIONS: usize = 12;

const _: () = assert!(CLUSTER_TRIANGLES <= 128 && CLUSTER_VERTICES <= 128);
const _: () = assert!(VERTEX_BITS + 7 <= 64);
const _: () = assert!(CLUSTER_LEAVES <= 2 * NODE_WIDTH);

/// Names of sections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum SectionKind {
    /// [`PageEntry`] of every page.
    PageTable = 1,
    /// Nodes from the root down to the page roots.
    TopTree = 2,
    /// Materials, JSON.
    Materials = 3,
    /// Emissive triangles.
    Emitters = 4,
    /// The resident voxel octree; a file may be without.
    Upper = 5,
    /// Where the units of its linking nodes are; a file may be without.
    Lower = 6,
}

impl SectionKind {
    /// Every section that a file of this version has, in file order.
    pub const ALL: [SectionKind; 4] =
        [SectionKind::PageTable, SectionKind::TopTree, SectionKind::Materials, SectionKind::Emitters];

    /// The kind of a section that a file may have.
    pub fn from_word(word: u32) -> Option<SectionKind> {
        SectionKind::ALL
            .into_iter()
            .chain([SectionKind::Upper, SectionKind::Lower])
            .find(|kind| *kind as u32 == word)
    }

    /// The name for messages.
    pub fn name(self) -> &'static str {
        match self {
            SectionKind::PageTable => "page table",
            SectionKind::TopTree => "top tree",
            SectionKind::Materials => "materials",
            SectionKind::Emitters => "emitters",
            SectionKind::Upper => "upper octree",
            SectionKind::Lower => "lower octrees",
        }
    }
}

/// The hash of a page's stored bytes: a page in another place, or of another file, does not match.
pub fn page_hash(stored: &[u8], file_id: u64, page: u32) -> u64 {
    xxh3_64_with_seed(stored, file_id ^ (u64::from(page) + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15))
}

/// The hash of a section's bytes.
pub fn section_hash(bytes: &[u8], file_id: u64, kind: u32) -> u64 {
    xxh3_64_with_seed(bytes, section_seed(file_id, kind))
}

/// Hasher of a section that comes piece by piece.
pub(crate) fn section_hasher(file_id: u64, kind: u32) -> Xxh3 {
    Xxh3::with_seed(section_seed(file_id, kind))
}

fn section_seed(file_id: u64, kind: u32) -> u64 {
    file_id ^ u64::from(kind) << 32
}

/// How far lattice coordinates are shifted in node origins, so that they fit 31 bits.
pub fn node_shift(lattice_bits: u32) -> u32 {
    lattice_bits.saturating_sub(30)
}

/// The error of a model that needs more than [`PAGES`].
pub(crate) fn too_many_pages() -> Error {
    Error::new(Code::InputRange, "the model needs more pages than a trex file can have")
        .at_place("the input")
        .numbers(format!("at most {PAGES}"))
        .next("cut the input in parts and build each")
}

#[cfg(target_endian = "big")]
compile_error!(
    "frames and tables are traced as they lie, little-endian; a big-endian host would need a swap at install"
);
