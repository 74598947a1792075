//! The gates for the tables of a file: from the bytes of a section to what [`PageFile`](super::PageFile) keeps of it.
//!
//! Invariants: 1. each gives `None` for anything that is out of its range, and allocates by what is there, which was
//! compared with its count and leased before; 2. pages stand without gaps, those of units last, pages of
//! colours and those of normals in the order of triangles; 3. the top tree is a tree of bounded depth, whose references
//! lead to pages.

use super::sections::out_of_range;
use crate::cluster::{Node, TopRef};
use crate::error::Result;
use crate::layout::*;
use crate::material_json;
use crate::material_list::MaterialList;
use std::io::Read;
use std::ops::RangeInclusive;
use std::path::Path;

/// Bytes that sections which are read in pieces take while they are read.
const READING_BYTES: u64 = 256 << 10;

/// An emissive triangle of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Emitter {
    /// Corners, lattice.
    pub corners: [[i64; 3]; 3],
    /// Index into the materials.
    pub material: u32,
    /// Store id.
    pub triangle: u32,
}

/// Refuses sections whose lengths and counts cannot go together, by the superblock alone: before memory is leased for
/// them, and before a byte of them is read.
///
/// # Errors
/// [`Code::Damaged`](crate::Code::Damaged).
pub(crate) fn check_lengths(block: &Superblock, path: &Path) -> Result<()> {
    for kind in SectionKind::ALL {
        let section = block.section(kind);
        let count = u64::from(section.count);
        let (lengths, count_most) = match kind {
            SectionKind::PageTable => (exactly(count, PAGE_ENTRY_BYTES), u64::from(PAGES)),
            SectionKind::TopTree => (exactly(count, Node::BYTES), u64::from(u32::MAX)),
            SectionKind::Emitters => (exactly(count, EMITTER_BYTES), block.triangle_count),
            // Two brackets, and a material that has at least a character.
            _ => (2 + count..=2 + count * MATERIAL_JSON_BYTES as u64, MATERIALS as u64),
        };
        let is_empty = kind == SectionKind::Materials && count == 0;
        if is_empty || count > count_most || !lengths.contains(&section.bytes) {
            return Err(out_of_range(section, kind, path));
        }
    }
    Ok(())
}

/// The one length of `count` records of so many bytes.
fn exactly(count: u64, record_bytes: usize) -> RangeInclusive<u64> {
    let bytes = count * record_bytes as u64;
    bytes..=bytes
}

/// Bytes of the sections that every file has.
pub(crate) fn section_bytes(block: &Superblock) -> u64 {
    SectionKind::ALL.iter().map(|&kind| block.section(kind).bytes).fold(0, u64::saturating_add)
}

/// Memory while the tables are read, of a block whose lengths were checked: what is kept, and beside it one section as
/// it is stored, with a byte for each node of the top tree. Materials are read in pieces.
pub(crate) fn table_bytes(block: &Superblock) -> u64 {
    let stored = [SectionKind::PageTable, SectionKind::TopTree, SectionKind::Emitters];
    let longest = stored.iter().map(|&kind| block.section(kind).bytes).max().unwrap_or(0);
    let seen = u64::from(block.section(SectionKind::TopTree).count);
    [longest, seen, READING_BYTES].iter().fold(kept_bytes(block), |sum, &bytes| sum.saturating_add(bytes))
}

/// Memory that the tables keep, at most: names may be shorter than there is room for.
pub(crate) fn kept_bytes(block: &Superblock) -> u64 {
    let count = |kind| u64::from(block.section(kind).count);
    let names = count(SectionKind::Materials);
    count(SectionKind::PageTable) * (size_of::<PageEntry>() as u64 + 1)
        + count(SectionKind::TopTree) * size_of::<Node>() as u64
        + MaterialList::bytes(names, name_bytes(block))
        + count(SectionKind::Emitters) * size_of::<Emitter>() as u64
}

/// Most bytes of all names together.
fn name_bytes(block: &Superblock) -> u64 {
    let section = block.section(SectionKind::Materials);
    section.bytes.min(u64::from(section.count) * MATERIAL_NAME_BYTES as u64)
}

pub(super) fn parse_pages(bytes: &[u8], block: &Superblock) -> Option<Vec<PageEntry>> {
    let (records, rest) = bytes.as_chunks::<PAGE_ENTRY_BYTES>();
    let count = block.section(SectionKind::PageTable).count as usize;
    if !rest.is_empty() || records.len() != count || count > PAGES as usize {
        return None;
    }
    let mut end = SUPERBLOCK_BYTES as u64;
    let (mut triangles, mut values_of) = (0, [0; 2]);
    let mut pages = Vec::with_capacity(count);
    for record in records {
        let entry = PageEntry::parse(record)?;
        // Without gaps, in order: so every byte belongs to a page, and ids are dense.
        let is_next = match entry.kind {
            PageKind::Colours => value_page_follows(&mut values_of[0], &pages, &entry),
            PageKind::Normals => value_page_follows(&mut values_of[1], &pages, &entry),
            PageKind::Mesh | PageKind::Units => u64::from(entry.first_triangle) == triangles,
        };
        if entry.offset != end || !is_next {
            return None;
        }
        // Those of the mesh and of its corners first: so units are not read with others.
        let is_behind_units = pages.last().is_some_and(|last: &PageEntry| last.kind == PageKind::Units);
        if is_behind_units && entry.kind != PageKind::Units {
            return None;
        }
        end += u64::from(entry.stored_bytes);
        triangles += u64::from(entry.triangle_count);
        pages.push(entry);
    }
    if !PageKind::OF_CORNERS.iter().all(|&kind| has_values(kind, &pages, block)) {
        return None;
    }
    let has_units = pages.last().is_some_and(|last| last.kind == PageKind::Units);
    let sound = triangles == block.triangle_count
        && end == block.section(SectionKind::PageTable).offset
        && has_units == block.find_section(SectionKind::Lower).is_some();
    sound.then_some(pages)
}

/// Whether all mesh pages with values of a kind lead to pages of it, of which there are as many as the superblock says.
fn has_values(kind: PageKind, pages: &[PageEntry], block: &Superblock) -> bool {
    let leads_to_values = |(page, entry): (usize, &PageEntry)| {
        // The one that has its first triangle: the next begins behind it.
        let begins_before = |page: Option<&PageEntry>| {
            page.is_some_and(|values| values.kind == kind && values.first_triangle <= entry.first_triangle)
        };
        let first = page.saturating_add(entry.values_behind(kind) as usize);
        begins_before(pages.get(first)) && !begins_before(pages.get(first.saturating_add(1)))
    };
    let mut with = pages.iter().enumerate().filter(|(_, entry)| entry.values_behind(kind) > 0);
    let count = pages.iter().filter(|entry| entry.kind == kind).count() as u64;
    with.all(leads_to_values) && count == block.page_count(kind)
}

/// Whether a page of values comes where it may: behind the mesh page that it is of, and in the order of triangles.
/// `values_of` is the mesh page that the page of its kind before it was of.
fn value_page_follows(values_of: &mut usize, pages: &[PageEntry], entry: &PageEntry) -> bool {
    let is_of = |page: &PageEntry| {
        page.kind == PageKind::Mesh
            && entry.first_triangle.checked_sub(page.first_triangle).is_some_and(|i| i < page.triangle_count)
    };
    let found = pages[*values_of..].iter().position(is_of);
    if let Some(further) = found {
        *values_of += further;
    }
    let ascends = pages.iter().rev().find(|page| page.kind == entry.kind);
    found.is_some() && ascends.is_none_or(|before| before.first_triangle < entry.first_triangle)
}

/// Checks every reference, and that the tree is a tree of bounded depth. The nodes, and how many roots they ask of
/// each page.
pub(super) fn parse_top(
    bytes: &[u8],
    block: &Superblock,
    pages: &[PageEntry],
) -> Option<(Vec<Node>, Vec<u8>)> {
    if bytes.len() != block.section(SectionKind::TopTree).count as usize * Node::BYTES {
        return None;
    }
    let mut root_counts = vec![0u8; pages.partition_point(|entry| entry.kind != PageKind::Units)];
    let top: Vec<Node> = bytemuck::allocation::pod_collect_to_vec(bytes);
    let mut seen = vec![false; top.len()];
    let mut stack = vec![(block.root, 0)];
    while let Some((word, depth)) = stack.pop() {
        match TopRef::from_word(word) {
            TopRef::Page { page, slot } => {
                let asked = root_counts.get_mut(page as usize)?;
                if pages[page as usize].kind != PageKind::Mesh {
                    return None;
                }
                *asked = (*asked).max(slot as u8 + 1);
            }
            TopRef::Node(index) if depth < TREE_DEPTH => {
                let node = top.get(index as usize)?;
                let first_visit = !std::mem::replace(&mut seen[index as usize], true);
                let sound = first_visit
                    && (1..=NODE_WIDTH).contains(&usize::from(node.boxes.child_count))
                    && node.boxes.exponent.iter().all(|&e| e <= 32);
                if !sound {
                    return None;
                }
                stack.extend(
                    node.child[..usize::from(node.boxes.child_count)].iter().map(|&word| (word, depth + 1)),
                );
            }
            _ => return None,
        }
    }
    seen.iter().all(|&s| s).then_some((top, root_counts))
}

/// Reads the materials, whose count was checked, in pieces.
pub(super) fn parse_materials(section: impl Read, block: &Superblock) -> Option<MaterialList> {
    let count = block.section(SectionKind::Materials).count as usize;
    material_json::read(section, count..=count, name_bytes(block) as usize)
}

pub(super) fn parse_emitters(
    bytes: &[u8],
    block: &Superblock,
    material_count: usize,
) -> Option<Vec<Emitter>> {
    let (records, rest) = bytes.as_chunks::<EMITTER_BYTES>();
    let emitter = |record: &[u8; EMITTER_BYTES]| {
        let q = |i: usize| i64::from_le_bytes(record[8 * i..8 * i + 8].try_into().expect("eight"));
        let word = |at: usize| u32::from_le_bytes(record[at..at + 4].try_into().expect("four"));
        let corners = std::array::from_fn(|c| std::array::from_fn(|a| q(3 * c + a)));
        Emitter { corners, material: word(72), triangle: word(76) }
    };
    let emitters: Vec<Emitter> = records.iter().map(emitter).collect();
    let counted = records.len() == block.section(SectionKind::Emitters).count as usize;
    let sound = counted && rest.is_empty() && emitters.iter().all(|e| (e.material as usize) < material_count);
    sound.then_some(emitters)
}
