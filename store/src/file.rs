//! `PageFile`: an opened `.trex`: the superblock, the tables, and how a page is fetched and installed.
//!
//! Invariants: 1. what `open` returns was checked: hashes of superblock and sections, ranges of every entry, every
//! reference of the top tree; 2. pages are checked when they are read, hash before decode, and then against what the
//! tables say of them, so that rays and materials can be looked up without asking; 3. the file is never
//! written; 4. what does not match its hash is read again before it counts as damaged (`twice`).

use crate::budget::{Budget, Lease};
use crate::cluster::Node;
use crate::error::Result;
use crate::io::Origin;
use crate::layout::*;
use crate::material::Material;
use crate::material_list::MaterialList;
use crate::material_names::MaterialNames;
use crate::octree::{LowerLinks, LowerSize, Refinement, UpperOctree, UpperSize, VoxelGrid};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

mod pages;
mod sections;
mod sizes;
mod tables;
mod twice;

pub use sections::open_regular;
pub use sizes::FileSizes;
pub use tables::Emitter;

use sections::{HashedSection, checked_section, out_of_range};
pub(crate) use sections::{lower_size, read_superblock, streamed_section, upper_size};
pub(crate) use tables::{check_lengths, kept_bytes, section_bytes, table_bytes};
use tables::{parse_emitters, parse_materials, parse_pages, parse_top};
pub(crate) use twice::twice;

/// An open page file. See the module's invariants.
pub struct PageFile {
    path: PathBuf,
    file: Origin,
    block: Superblock,
    pages: Vec<PageEntry>,
    /// Roots that the top tree asks of each page of the mesh.
    root_counts: Vec<u8>,
    top: Vec<Node>,
    materials: MaterialList,
    emitters: Vec<Emitter>,
    _lease: Lease,
}

impl PageFile {
    /// Opens a file and its tables; no page is read. The tables' memory is leased from `budget`.
    ///
    /// # Errors
    /// [`crate::Code::InputUnreadable`], [`crate::Code::InputFormat`], [`crate::Code::Version`],
    /// [`crate::Code::Damaged`], [`crate::Code::MemoryLimit`], [`crate::Code::Io`].
    pub fn open(path: &Path, budget: &Budget) -> Result<PageFile> {
        let file = Origin::open(path)?;
        let block = read_superblock(&file, path)?;
        check_lengths(&block, path)?;
        let mut lease = budget.lease("the tables of the file", opening_bytes(&file, &block))?;
        file.fetch_parts(&parts_at_opening(&block));
        let read = |kind: SectionKind| -> Result<Vec<u8>> {
            checked_section(&file, block.section(kind), (kind, block.file_id), path)
        };
        let out_of_range = |kind| out_of_range(block.section(kind), kind, path);
        let kind = SectionKind::PageTable;
        let pages = parse_pages(&read(kind)?, &block).ok_or_else(|| out_of_range(kind))?;
        let kind = SectionKind::TopTree;
        let (top, root_counts) = parse_top(&read(kind)?, &block, &pages).ok_or_else(|| out_of_range(kind))?;
        let kind = SectionKind::Materials;
        let place = (kind, block.file_id);
        let materials = streamed_section(&file, block.section(kind), place, path, |section| {
            parse_materials(section, &block).ok_or_else(|| out_of_range(kind))
        })?;
        let kind = SectionKind::Emitters;
        let emitters =
            parse_emitters(&read(kind)?, &block, materials.len()).ok_or_else(|| out_of_range(kind))?;
        file.forget_parts();
        lease.shrink_to(kept_bytes(&block) + file.connection_bytes());
        let path = path.to_path_buf();
        Ok(PageFile { path, file, block, pages, root_counts, top, materials, emitters, _lease: lease })
    }

    /// The superblock of a file that is not opened: nothing else of it is read.
    ///
    /// # Errors
    /// Those of [`PageFile::open`] but of its tables.
    pub fn superblock_of(path: &Path) -> Result<Superblock> {
        read_superblock(&Origin::open(path)?, path)
    }

    /// The path it was opened by.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The superblock.
    pub fn superblock(&self) -> &Superblock {
        &self.block
    }

    /// The page table.
    pub fn pages(&self) -> &[PageEntry] {
        &self.pages
    }

    /// The top tree; where to enter it says `superblock().root`.
    pub fn top(&self) -> &[Node] {
        &self.top
    }

    /// Materials.
    pub fn materials(&self) -> &[Material] {
        &self.materials
    }

    /// Names of the materials, whose memory is leased for as long as the file is open.
    pub fn material_names(&self) -> &Arc<MaterialNames> {
        self.materials.names()
    }

    /// Emissive triangles.
    pub fn emitters(&self) -> &[Emitter] {
        &self.emitters
    }

    /// Sizes of the resident octree, by its head; `None` for a file without.
    ///
    /// # Errors
    /// [`crate::Code::Damaged`], [`crate::Code::Io`].
    pub fn upper_size(&self) -> Result<Option<UpperSize>> {
        upper_size(&self.file, &self.block, &self.path)
    }

    /// Reads the resident octree; `None` for a file without. Its memory is leased from `budget`.
    ///
    /// # Errors
    /// [`crate::Code::Damaged`], [`crate::Code::MemoryLimit`], [`crate::Code::Io`].
    pub fn upper(&self, budget: &Budget) -> Result<Option<(UpperOctree, Lease)>> {
        let kind = SectionKind::Upper;
        let (Some(section), Some(size)) = (self.block.find_section(kind), self.upper_size()?) else {
            return Ok(None);
        };
        let _stored = budget.lease("the stored octree", size.reading_bytes)?;
        let bytes = self.checked_section(section, kind)?;
        let lease = budget.lease("the upper octree", size.resident_bytes)?;
        let octree = UpperOctree::parse(&bytes, self.materials.len())
            .filter(|octree| Refinement::ALL.iter().any(|&refinement| self.has_grid(octree, refinement)))
            .ok_or_else(|| out_of_range(section, kind, &self.path))?;
        Ok(Some((octree, lease)))
    }

    /// Sizes of the links to units, by the head of their section; `None` for a file whose upper leaves are the finest.
    ///
    /// # Errors
    /// [`crate::Code::Damaged`], [`crate::Code::Io`].
    pub fn lower_size(&self) -> Result<Option<LowerSize>> {
        lower_size(&self.file, &self.block, &self.path)
    }

    /// Reads the links to the units below `upper`, which is this file's; `None` for a file whose upper leaves are the
    /// finest. Their memory is leased from `budget`. The units themselves are pages.
    ///
    /// # Errors
    /// [`crate::Code::Damaged`], [`crate::Code::MemoryLimit`], [`crate::Code::Io`].
    pub fn lower(&self, upper: &UpperOctree, budget: &Budget) -> Result<Option<(LowerLinks, Lease)>> {
        let kind = SectionKind::Lower;
        let (Some(section), Some(size)) = (self.block.find_section(kind), self.lower_size()?) else {
            return Ok(None);
        };
        let _stored = budget.lease("the stored links to units", size.reading_bytes)?;
        let bytes = self.checked_section(section, kind)?;
        let lease = budget.lease("the links to units", size.resident_bytes)?;
        let link_count = upper.last_nodes().len();
        let links = (link_count == size.link_count as usize && self.has_grid(upper, size.refinement))
            .then(|| LowerLinks::parse(&bytes, link_count, |page| self.has_units(page)))
            .flatten()
            .ok_or_else(|| out_of_range(section, kind, &self.path))?;
        Ok(Some((links, lease)))
    }

    /// Where the cube stands follows from the model's box.
    fn has_grid(&self, octree: &UpperOctree, refinement: Refinement) -> bool {
        let [lo, hi] = self.block.lattice_bounds;
        *octree.grid() == VoxelGrid::from_bounds(lo, hi, octree.grid().resolution, refinement)
    }

    /// The bytes of a section, which match its hash.
    fn checked_section(&self, section: Section, kind: SectionKind) -> Result<Vec<u8>> {
        checked_section(&self.file, section, (kind, self.block.file_id), &self.path)
    }

    /// Compares the bytes of a section with its hash, piece by piece.
    /// Lengths of the pieces go to `on_read`, those of a second look too.
    pub(crate) fn check_section(
        &self,
        section: Section,
        kind: SectionKind,
        on_read: &mut dyn FnMut(u64) -> Result<()>,
    ) -> Result<()> {
        let mut piece = vec![0; FRAME_BYTES];
        let mut read_all = |reader: &mut HashedSection<'_>| -> Result<()> {
            // What cannot be read is told by the reader.
            while let Some(length) = reader.read(&mut piece).ok().filter(|&length| length > 0) {
                on_read(length as u64)?;
            }
            Ok(())
        };
        streamed_section(&self.file, section, (kind, self.block.file_id), &self.path, &mut read_all)
    }

    /// Whether `page` is a page of the mesh.
    pub fn has_mesh(&self, page: u32) -> bool {
        self.pages.get(page as usize).is_some_and(|entry| entry.kind == PageKind::Mesh)
    }

    /// Whether `page` is a page of units.
    pub fn has_units(&self, page: u32) -> bool {
        self.pages.get(page as usize).is_some_and(|entry| entry.kind == PageKind::Units)
    }

    /// The page of one of [`PageKind::OF_CORNERS`] with the values of a triangle of mesh page `page`, by its store id;
    /// `None` where it has none. The values of a page may take several pages, and several may share one.
    pub fn value_page(&self, kind: PageKind, page: u32, triangle: u32) -> Option<u32> {
        let behind = self.pages[page as usize].values_behind(kind);
        if behind == 0 {
            return None;
        }
        let is_before = |values: &PageEntry| values.kind == kind && values.first_triangle <= triangle;
        let first = page + behind;
        let behind = self.pages[first as usize + 1..].iter().take_while(|&values| is_before(values)).count();
        Some(first + behind as u32)
    }

    /// Bytes of memory that the tables keep.
    pub fn resident_table_bytes(&self) -> u64 {
        kept_bytes(&self.block)
    }
}

/// Sections that opening reads one after the other, each a way to the server and back where the file is behind one.
const OPENING_SECTIONS: [SectionKind; 4] =
    [SectionKind::PageTable, SectionKind::TopTree, SectionKind::Materials, SectionKind::Emitters];

/// All that opening reads, and the heads of the octree's sections: offset and bytes.
fn parts_at_opening(block: &Superblock) -> Vec<(u64, u64)> {
    let tables =
        OPENING_SECTIONS.map(|kind| block.section(kind)).map(|section| (section.offset, section.bytes));
    let octree =
        [(SectionKind::Upper, UpperOctree::HEAD_BYTES), (SectionKind::Lower, LowerLinks::HEAD_BYTES)];
    let head = |(kind, bytes): (SectionKind, usize)| {
        block.find_section(kind).map(|section| (section.offset, section.bytes.min(bytes as u64)))
    };
    tables.into_iter().chain(octree.into_iter().filter_map(head)).collect()
}

/// Memory while the tables are read.
fn opening_bytes(file: &Origin, block: &Superblock) -> u64 {
    let ahead: u64 = parts_at_opening(block).iter().map(|&(_, bytes)| bytes).sum();
    let ahead = if file.is_far() { ahead } else { 0 };
    table_bytes(block).saturating_add(ahead).saturating_add(file.connection_bytes())
}
