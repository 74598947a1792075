//! Every number of the format, once: magic, version, maxima, the superblock, the page table, sections.
//! `docs/format.md` draws the same in rows.
//!
//! ```text
//! file = superblock | page 0 | page 1 | ... | section | section | ... | superblock (same bytes)
//! ```
//!
//! Invariants: 1. all numbers on disk are little-endian and of fixed width; 2. pages and sections stand without
//! gaps, so the two superblocks, the page hashes and the section hashes cover every byte; 3. both superblocks
//! hold the same bytes; 4. what is read passes `Superblock::parse` before any field is believed.

use crate::error::{Code, Error, Result};
use crate::geom::{Aabb, Lattice};
use std::path::Path;
use xxhash_rust::xxh3::{Xxh3, xxh3_64, xxh3_64_with_seed};

/// First bytes of a file. The line ends show a transfer in text mode.
pub const MAGIC: [u8; 8] = *b"TREX\r\n\x1a\n";
/// Version of the format; another one is refused.
pub const VERSION: u32 = 1;
/// Required features that this build knows. A bit that is not known here refuses the file.
pub const REQUIRED_FEATURES: u64 = FEATURE_LOWER;
/// The file has pages of units, and the section that links them.
pub const FEATURE_LOWER: u64 = 1;

/// Bytes of a frame: the memory of one page, whatever its size on disk.
pub const FRAME_BYTES: usize = 64 << 10;
/// Most triangles of a cluster: 7-bit counts, and 16 leaves of 8.
pub const CLUSTER_TRIANGLES: usize = 128;
/// Most vertices of a cluster: a corner is a 7-bit index.
pub const CLUSTER_VERTICES: usize = 128;
/// Triangles of a leaf: the width of an AVX2 register in f32.
pub const LEAF_TRIANGLES: usize = 8;
/// Most leaves of a cluster.
pub const CLUSTER_LEAVES: usize = CLUSTER_TRIANGLES / LEAF_TRIANGLES;
/// Children of a node: eight 8-bit planes fill a 64-bit word.
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
pub const PAGE_ENTRY_BYTES: usize = 40;
/// Sections that fit the superblock.
pub const SECTIONS: usize = 12;

const _: () = assert!(CLUSTER_TRIANGLES <= 128 && CLUSTER_VERTICES <= 128);
const _: () = assert!(VERTEX_BITS + 7 <= 64);
const _: () = assert!(CLUSTER_LEAVES <= 2 * NODE_WIDTH);

/// What a page holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub enum PageKind {
    /// Clusters and the tree above them.
    Mesh = 0,
    /// Units of the lower octrees.
    Units = 1,
}

impl PageKind {
    /// The kind of a byte.
    fn of(byte: u32) -> Option<PageKind> {
        [PageKind::Mesh, PageKind::Units].into_iter().find(|kind| *kind as u32 == byte)
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
    /// Store id of its first triangle.
    pub first_triangle: u32,
    /// Triangles in it.
    pub triangle_count: u32,
    /// What it holds.
    pub kind: PageKind,
    /// How it is stored.
    pub packing: Packing,
}

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

/// Where a section stands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Section {
    /// A [`SectionKind`]; 0 = slot not used.
    pub kind: u32,
    /// Items in it.
    pub count: u32,
    /// Where it begins.
    pub offset: u64,
    /// Its length.
    pub bytes: u64,
    /// XXH3-64 of its bytes, seeded with the file id.
    pub hash: u64,
}

/// The head of the file: what it holds and where.
#[derive(Clone, Debug, PartialEq)]
pub struct Superblock {
    /// Length of the whole file.
    pub file_bytes: u64,
    /// Hash of the input's content and the options.
    pub file_id: u64,
    /// The lattice of all positions.
    pub lattice: Lattice,
    /// Most lattice steps along any axis, in bits.
    pub lattice_bits: u32,
    /// Node origins are lattice coordinates shifted right by this (0 up to 30 lattice bits).
    pub node_shift: u32,
    /// Largest distance, per axis, between an input vertex and its lattice point; model units.
    pub error_bound: f64,
    /// Box of all stored vertices, model units.
    pub bounds: Aabb,
    /// The same in lattice coordinates: least corner, greatest corner.
    pub lattice_bounds: [[i64; 3]; 2],
    /// Median edge of the input that the lattice was chosen by; model units.
    pub median_edge: f64,
    /// Triangles of the input.
    pub input_triangle_count: u64,
    /// Triangles stored.
    pub triangle_count: u64,
    /// Vertices stored, counted once per cluster.
    pub vertex_count: u64,
    /// Clusters.
    pub cluster_count: u64,
    /// Of these, wide ones.
    pub wide_cluster_count: u64,
    /// Triangles left out: two equal corners after the snap.
    pub rejected_degenerate: u64,
    /// Triangles left out: a coordinate is no finite number.
    pub rejected_non_finite: u64,
    /// Frame bytes in use, summed over the pages of the mesh.
    pub resident_bytes: u64,
    /// Bytes of in-page nodes, on disk before packing.
    pub page_tree_bytes: u64,
    /// Where the root of the top tree leads, in the encoding of [`crate::cluster::TopRef`].
    pub root: u32,
    /// The sections.
    pub sections: [Section; SECTIONS],
}

impl Superblock {
    /// The bytes as they stand on disk.
    pub fn to_bytes(&self) -> [u8; SUPERBLOCK_BYTES] {
        let mut w = Fields(Vec::with_capacity(SUPERBLOCK_BYTES));
        w.0.extend_from_slice(&MAGIC);
        w.u32(VERSION);
        w.u32(FRAME_BYTES as u32);
        w.u64(if self.has_lower() { FEATURE_LOWER } else { 0 });
        w.u64(0); // optional features
        w.u64(self.file_bytes);
        w.u64(self.file_id);
        self.lattice.origin.iter().for_each(|&v| w.f64(v));
        w.u32(self.lattice.exponent as u32);
        w.u32(self.lattice_bits);
        w.u32(self.node_shift);
        w.u32(self.root);
        w.f64(self.error_bound);
        w.f64(self.median_edge);
        self.bounds.lo.iter().chain(&self.bounds.hi).for_each(|&v| w.f64(v));
        self.lattice_bounds.as_flattened().iter().for_each(|&v| w.u64(v as u64));
        for value in [
            self.input_triangle_count,
            self.triangle_count,
            self.vertex_count,
            self.cluster_count,
            self.wide_cluster_count,
            self.rejected_degenerate,
            self.rejected_non_finite,
            self.resident_bytes,
            self.page_tree_bytes,
        ] {
            w.u64(value);
        }
        for section in &self.sections {
            w.u32(section.kind);
            w.u32(section.count);
            w.u64(section.offset);
            w.u64(section.bytes);
            w.u64(section.hash);
        }
        let mut bytes = [0; SUPERBLOCK_BYTES];
        assert!(w.0.len() <= SUPERBLOCK_BYTES - 8, "the superblock outgrew its bytes");
        bytes[..w.0.len()].copy_from_slice(&w.0);
        let hash = xxh3_64(&bytes[..SUPERBLOCK_BYTES - 8]);
        bytes[SUPERBLOCK_BYTES - 8..].copy_from_slice(&hash.to_le_bytes());
        bytes
    }

    /// The gate for foreign bytes: magic, hash, version and features, then the fields' ranges.
    ///
    /// # Errors
    /// [`Code::InputFormat`] for another magic, [`Code::Version`], [`Code::Damaged`] for the rest.
    pub fn parse(bytes: &[u8; SUPERBLOCK_BYTES], path: &Path) -> Result<Superblock> {
        if bytes[..8] != MAGIC {
            return Err(Error::new(Code::InputFormat, "this is no trex file")
                .at_byte(path, 0)
                .numbers(format!("magic {:02x?}, expected {MAGIC:02x?}", &bytes[..8]))
                .next("make one with `trex build`"));
        }
        let stored = u64::from_le_bytes(bytes[SUPERBLOCK_BYTES - 8..].try_into().expect("eight bytes"));
        let found = xxh3_64(&bytes[..SUPERBLOCK_BYTES - 8]);
        if stored != found {
            return Err(damaged("the superblock does not match its hash", path)
                .numbers(format!("hash {found:016x}, expected {stored:016x}")));
        }
        let mut r = Cursor { bytes, at: 8 };
        let (version, frame_bytes, required) = (r.u32(), r.u32(), r.u64());
        r.u64(); // optional features: unknown ones are passed over
        if version != VERSION || required & !REQUIRED_FEATURES != 0 || frame_bytes != FRAME_BYTES as u32 {
            return Err(Error::new(Code::Version, "this trex file needs another version of trex")
                .at(path)
                .numbers(format!("version {version}, features {required:x}; this build knows {VERSION}, {REQUIRED_FEATURES:x}"))
                .next("open it with a newer trex, or build it again"));
        }
        let mut block = Superblock {
            file_bytes: r.u64(),
            file_id: r.u64(),
            lattice: Lattice { origin: [r.f64(), r.f64(), r.f64()], exponent: r.u32() as i32 },
            lattice_bits: r.u32(),
            node_shift: r.u32(),
            root: r.u32(),
            error_bound: r.f64(),
            median_edge: r.f64(),
            bounds: Aabb { lo: [r.f64(), r.f64(), r.f64()], hi: [r.f64(), r.f64(), r.f64()] },
            lattice_bounds: [[0; 3]; 2],
            input_triangle_count: 0,
            triangle_count: 0,
            vertex_count: 0,
            cluster_count: 0,
            wide_cluster_count: 0,
            rejected_degenerate: 0,
            rejected_non_finite: 0,
            resident_bytes: 0,
            page_tree_bytes: 0,
            sections: [Section::default(); SECTIONS],
        };
        block.lattice_bounds.as_flattened_mut().iter_mut().for_each(|v| *v = r.u64() as i64);
        for field in [
            &mut block.input_triangle_count,
            &mut block.triangle_count,
            &mut block.vertex_count,
            &mut block.cluster_count,
            &mut block.wide_cluster_count,
            &mut block.rejected_degenerate,
            &mut block.rejected_non_finite,
            &mut block.resident_bytes,
            &mut block.page_tree_bytes,
        ] {
            *field = r.u64();
        }
        for section in &mut block.sections {
            *section =
                Section { kind: r.u32(), count: r.u32(), offset: r.u64(), bytes: r.u64(), hash: r.u64() };
        }
        if block.has_lower() != (required & FEATURE_LOWER != 0) {
            return Err(damaged("the superblock's features are not those of its sections", path)
                .numbers(format!("features {required:x}")));
        }
        block.check(path)?;
        Ok(block)
    }

    /// The section of `kind`, if the file has it.
    pub fn find_section(&self, kind: SectionKind) -> Option<Section> {
        self.sections.iter().find(|s| s.kind == kind as u32).copied()
    }

    fn has_lower(&self) -> bool {
        self.find_section(SectionKind::Lower).is_some()
    }

    /// The section of `kind`, one of [`SectionKind::ALL`].
    pub fn section(&self, kind: SectionKind) -> Section {
        self.find_section(kind).expect("checked by parse")
    }

    fn check(&self, path: &Path) -> Result<()> {
        let finite = self.lattice.origin.iter().chain(&self.bounds.lo).chain(&self.bounds.hi);
        let sound = finite.chain([&self.error_bound, &self.median_edge]).all(|v| v.is_finite())
            && (-900..=900).contains(&self.lattice.exponent)
            && self.lattice_bits <= Lattice::MAX_BITS
            && self.node_shift == node_shift(self.lattice_bits)
            && self.lattice_bounds.as_flattened().iter().all(|&q| (0..=1 << Lattice::MAX_BITS).contains(&q))
            && self.triangle_count <= TRIANGLES
            && SectionKind::ALL.iter().all(|&k| self.sections.iter().any(|s| s.kind == k as u32));
        if !sound {
            return Err(damaged("a field of the superblock is out of its range", path));
        }
        for section in self.sections.iter().filter(|s| s.kind != 0) {
            let end = section.offset.checked_add(section.bytes);
            if end.is_none_or(|end| end > self.file_bytes) {
                return Err(damaged("a section ends behind the end of the file", path).numbers(format!(
                    "offset {} + {} bytes, file of {}",
                    section.offset, section.bytes, self.file_bytes
                )));
            }
        }
        Ok(())
    }
}

impl PageEntry {
    /// Appends the entry as it stands on disk.
    pub fn write(&self, out: &mut Vec<u8>) {
        let mut w = Fields(std::mem::take(out));
        w.u64(self.offset);
        w.u64(self.hash);
        w.u32(self.stored_bytes);
        w.u32(self.unpacked_bytes);
        w.u32(self.first_triangle);
        w.u32(self.triangle_count);
        w.u32(u32::from(self.kind as u8) | u32::from(self.packing as u8) << 8);
        w.u32(0);
        *out = w.0;
    }

    /// Reads one entry; `None` when a field is out of its range.
    pub fn parse(bytes: &[u8; PAGE_ENTRY_BYTES]) -> Option<PageEntry> {
        let mut r = Cursor { bytes, at: 0 };
        let (offset, hash, stored_bytes, unpacked_bytes) = (r.u64(), r.u64(), r.u32(), r.u32());
        let (first_triangle, triangle_count) = (r.u32(), r.u32());
        let (kind, reserved) = (r.u32(), r.u32());
        let packing = match kind >> 8 {
            0 => Packing::Raw,
            1 => Packing::Lz4,
            _ => return None,
        };
        let page_kind = PageKind::of(kind & 0xff)?;
        let sound = reserved == 0
            && (page_kind == PageKind::Mesh || triangle_count == 0)
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
        })
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

/// The same, piece by piece.
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

fn damaged(what: &str, path: &Path) -> Error {
    Error::new(Code::Damaged, what).at(path).next("run `trex verify` on it, or build it again")
}

/// Appends little-endian numbers.
struct Fields(Vec<u8>);

impl Fields {
    fn u32(&mut self, value: u32) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }
    fn u64(&mut self, value: u64) {
        self.0.extend_from_slice(&value.to_le_bytes());
    }
    fn f64(&mut self, value: f64) {
        self.u64(value.to_bits());
    }
}

/// Reads little-endian numbers from a record of known length.
struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Cursor<'_> {
    fn u32(&mut self) -> u32 {
        self.at += 4;
        u32::from_le_bytes(self.bytes[self.at - 4..self.at].try_into().expect("four bytes"))
    }
    fn u64(&mut self) -> u64 {
        self.at += 8;
        u64::from_le_bytes(self.bytes[self.at - 8..self.at].try_into().expect("eight bytes"))
    }
    fn f64(&mut self) -> f64 {
        f64::from_bits(self.u64())
    }
}

#[cfg(target_endian = "big")]
compile_error!(
    "frames and tables are traced as they lie, little-endian; a big-endian host would need a swap at install"
);
