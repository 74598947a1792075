//! Parts of a page file by themselves, each in a file that is sound but for it, and with every hash right: what a check
//! of one of them lets through is met by nothing else.
//!
//! ```text
//! tables    kind of a section (1 byte: 1 page table, 3 materials, 4 emitters), the section
//! tree      0, the top tree; or 1, of a page of the mesh, all that stands before its clusters
//! cluster   bits of the lattice, widths of its base, bits of a material and of its bytes (6 bytes), its entry, a
//!           cluster: alone in its page
//! octree    kind of a section (1 byte: 5 upper, 6 lower), the section
//! units     a page of units, unpacked
//! colours   a page of colours, unpacked
//! normals   a page of normals, unpacked
//! ```

use super::{left_over, page, read_page_file, with_page, with_section};
use std::path::Path;
use std::sync::LazyLock;
use trex_store::layout::{
    FRAME_BYTES, PAGE_ENTRY_BYTES, Packing, PageEntry, PageKind, SectionKind, Superblock,
};

/// Bytes of a page before the kinds of its roots; where its counts of nodes and roots stand, the widths of bases and
/// the bits of a material, and the bits of a cluster's bytes.
const PAGE_HEAD_BYTES: usize = 25;
const NODE_COUNT_AT: usize = 2;
const ROOT_COUNT_AT: usize = 4;
const WIDTHS_AT: usize = 5;
const SIZE_BITS_AT: usize = 24;
/// Bits of an entry beside those of its base and of its bytes.
const ENTRY_BITS: usize = 7 + 2 * 18;
/// Bytes before a cluster that say how it is packed.
const CLUSTER_SEED_BYTES: usize = 6;
/// Most emitters of a seed.
const SEED_EMITTERS_BYTES: usize = 8 * 80;

/// A file of some pages under a top tree, with emitters and voxels.
static SHEET: LazyLock<Vec<u8>> = LazyLock::new(left_over::finished);
/// A file with pages of units, one with a page of colours, and one with a page of normals.
const UNITS: &[u8] = include_bytes!("../seeds/page_file/units.trex");
const COLOURED: &[u8] = include_bytes!("../seeds/page_file/coloured.trex");
const BENT: &[u8] = include_bytes!("../seeds/page_file/bent.trex");

/// A table of a file.
pub fn tables(bytes: &[u8]) {
    section_of(bytes, &[SectionKind::PageTable, SectionKind::Materials, SectionKind::Emitters], &SHEET);
}

/// A section of the octree, of a file with units.
pub fn octree(bytes: &[u8]) {
    section_of(bytes, &[SectionKind::Upper, SectionKind::Lower], UNITS);
}

/// Reads `file` with the section that `bytes` name and hold, where it is one of `kinds`.
fn section_of(bytes: &[u8], kinds: &[SectionKind], file: &[u8]) {
    let Some((&number, content)) = bytes.split_first() else { return };
    if let Some(&kind) = kinds.iter().find(|kind| **kind as u32 == u32::from(number)) {
        read_page_file(&with_section(file, kind, content));
    }
}

/// True for a seed of `tables`, `tree` or `octree` that is the section which its file has: the file stays as it is.
pub fn is_own_section(target: &str, bytes: &[u8]) -> bool {
    let file = if target == "octree" { UNITS } else { &**SHEET };
    let kind = if target == "tree" { SectionKind::TopTree as u32 } else { u32::from(bytes[0]) };
    let kind = SectionKind::from_word(kind).expect("a kind of section");
    with_section(file, kind, &bytes[1..]) == file
}

/// The top tree, or the tree of a page.
pub fn tree(bytes: &[u8]) {
    match bytes.split_first() {
        Some((0, top)) => read_page_file(&with_section(&SHEET, SectionKind::TopTree, top)),
        Some((1, head)) => {
            let (bits, content) = mesh_page();
            page(&[&[bits][..], head, &content[clusters_at(&content)..]].concat());
        }
        _ => {}
    }
}

/// A cluster, alone in its page.
pub fn cluster(bytes: &[u8]) {
    let Some((&[bits, x, y, z, material, size], cluster)) = bytes.split_first_chunk::<CLUSTER_SEED_BYTES>()
    else {
        return;
    };
    let counts = [1, 0, 0, 0, 1];
    let widths = [x % 41, y % 41, z % 41, material % 17];
    let anchor = [0; SIZE_BITS_AT - WIDTHS_AT - 4];
    // Behind the bits of its bytes, the kind of the one root.
    page(&[&[bits][..], &counts, &widths, &anchor, &[size % 17, 0], cluster].concat());
}

/// A page of units, unpacked.
pub fn units(bytes: &[u8]) {
    page_of(UNITS, PageKind::Units, bytes);
}

/// A page of colours, unpacked.
pub fn colours(bytes: &[u8]) {
    page_of(COLOURED, PageKind::Colours, bytes);
}

/// A page of normals, unpacked.
pub fn normals(bytes: &[u8]) {
    page_of(BENT, PageKind::Normals, bytes);
}

fn page_of(file: &[u8], kind: PageKind, content: &[u8]) {
    if content.len() <= FRAME_BYTES {
        read_page_file(&with_page(file, kind, content));
    }
}

/// Where the entries of a page begin.
fn entries_at(page: &[u8]) -> usize {
    let nodes = u16::from_le_bytes([page[NODE_COUNT_AT], page[NODE_COUNT_AT + 1]]);
    PAGE_HEAD_BYTES + usize::from(page[ROOT_COUNT_AT]).div_ceil(8) + 2 * usize::from(nodes)
}

/// Where its clusters begin.
fn clusters_at(page: &[u8]) -> usize {
    let count = usize::from(u16::from_le_bytes([page[0], page[1]]));
    let widths = page[WIDTHS_AT..][..3].iter().chain(&page[SIZE_BITS_AT..][..1]);
    let bits = ENTRY_BITS + widths.map(|&bits| usize::from(bits)).sum::<usize>();
    entries_at(page) + (count * bits).div_ceil(8)
}

/// The content of the first page of a kind, unpacked.
fn unpacked(file: &[u8], kind: PageKind) -> Vec<u8> {
    let block = block_of(file);
    let table = block.section(SectionKind::PageTable);
    let table = &file[table.offset as usize..][..table.bytes as usize];
    let mut entries = table
        .chunks_exact(PAGE_ENTRY_BYTES)
        .map(|entry| PageEntry::parse(entry.first_chunk().expect("an entry")).expect("a sound entry"));
    let entry = entries.find(|entry| entry.kind == kind).expect("a page of this kind");
    let stored = &file[entry.offset as usize..][..entry.stored_bytes as usize];
    match entry.packing {
        Packing::Raw => stored.to_vec(),
        Packing::Lz4 => lz4_flex::block::decompress(stored, entry.unpacked_bytes as usize).expect("sound"),
    }
}

fn block_of(file: &[u8]) -> Superblock {
    Superblock::parse(file.first_chunk().expect("a superblock"), Path::new("sound.trex")).expect("sound")
}

/// A page of the mesh of the sheet, behind the bits of its lattice.
fn mesh_page() -> (u8, Vec<u8>) {
    static PAGE: LazyLock<(u8, Vec<u8>)> =
        LazyLock::new(|| (block_of(&SHEET).lattice_bits as u8, unpacked(&SHEET, PageKind::Mesh)));
    PAGE.clone()
}

/// What the targets change, as it is: target, name of the seed, and its bytes. `small` is a file whose only page has
/// one cluster.
pub fn sound(small: &[u8]) -> Vec<(&'static str, &'static str, Vec<u8>)> {
    let section = |file: &[u8], kind: SectionKind| {
        let section = block_of(file).section(kind);
        [&[kind as u8][..], &file[section.offset as usize..][..section.bytes as usize]].concat()
    };
    let (_, page) = mesh_page();
    let top = section(&SHEET, SectionKind::TopTree);
    let mut emitters = section(&SHEET, SectionKind::Emitters);
    emitters.truncate(1 + SEED_EMITTERS_BYTES);
    let one = unpacked(small, PageKind::Mesh);
    let packing =
        [&[block_of(small).lattice_bits as u8][..], &one[WIDTHS_AT..][..4], &one[SIZE_BITS_AT..][..1]]
            .concat();
    vec![
        ("tables", "pages", section(&SHEET, SectionKind::PageTable)),
        ("tables", "materials", section(&SHEET, SectionKind::Materials)),
        ("tables", "emitters", emitters),
        ("tree", "top", [&[0][..], &top[1..]].concat()),
        ("tree", "page", [&[1][..], &page[..clusters_at(&page)]].concat()),
        ("cluster", "small", [packing, one[entries_at(&one)..].to_vec()].concat()),
        ("octree", "upper", section(UNITS, SectionKind::Upper)),
        ("octree", "lower", section(UNITS, SectionKind::Lower)),
        ("colours", "coloured", unpacked(COLOURED, PageKind::Colours)),
        ("normals", "bent", unpacked(BENT, PageKind::Normals)),
    ]
}
