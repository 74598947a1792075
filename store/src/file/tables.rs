//! The gates for the tables of a file: from the bytes of a section to what [`PageFile`](super::PageFile) keeps of it.
//!
//! Invariants: 1. each gives `None` for anything that is out of its range, and allocates by what is there; 2. pages
//! stand without gaps, those of the mesh first; 3. the top tree is a tree of bounded depth, whose references lead to
//! pages.

use crate::cluster::{Node, TopRef};
use crate::layout::*;
use crate::material::Material;

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

/// Memory while the tables are read: each section once raw and once parsed. Sections of a sparse file may be so large
/// that no sum holds them: no limit has room for that.
pub(crate) fn table_bytes(block: &Superblock) -> u64 {
    let tables = SectionKind::ALL.iter().map(|&kind| block.section(kind).bytes);
    tables.fold(0, u64::saturating_add).saturating_mul(3)
}

/// Memory that the tables keep.
pub(super) fn kept_bytes(block: &Superblock) -> u64 {
    let count = |kind| u64::from(block.section(kind).count);
    count(SectionKind::PageTable) * (size_of::<PageEntry>() as u64 + 1)
        + count(SectionKind::TopTree) * size_of::<Node>() as u64
        + count(SectionKind::Materials) * (size_of::<Material>() as u64 + 32)
        + count(SectionKind::Emitters) * size_of::<Emitter>() as u64
}

pub(super) fn parse_pages(bytes: &[u8], block: &Superblock) -> Option<Vec<PageEntry>> {
    let (records, rest) = bytes.as_chunks::<PAGE_ENTRY_BYTES>();
    let count = block.section(SectionKind::PageTable).count as usize;
    if !rest.is_empty() || records.len() != count || count > PAGES as usize {
        return None;
    }
    let mut end = SUPERBLOCK_BYTES as u64;
    let mut triangles = 0;
    let mut pages = Vec::with_capacity(count);
    for record in records {
        let entry = PageEntry::parse(record)?;
        // Without gaps, in order: so every byte belongs to a page, and ids are dense.
        if entry.offset != end || u64::from(entry.first_triangle) != triangles {
            return None;
        }
        // Those of the mesh first: so neither kind is read with the other.
        if pages.last().is_some_and(|last: &PageEntry| last.kind as u8 > entry.kind as u8) {
            return None;
        }
        end += u64::from(entry.stored_bytes);
        triangles += u64::from(entry.triangle_count);
        pages.push(entry);
    }
    let has_units = pages.last().is_some_and(|last| last.kind == PageKind::Units);
    let sound = triangles == block.triangle_count
        && end == block.section(SectionKind::PageTable).offset
        && has_units == block.find_section(SectionKind::Lower).is_some();
    sound.then_some(pages)
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
    let mut root_counts = vec![0u8; pages.partition_point(|entry| entry.kind == PageKind::Mesh)];
    let top: Vec<Node> = bytemuck::allocation::pod_collect_to_vec(bytes);
    let mut seen = vec![false; top.len()];
    let mut stack = vec![(block.root, 0)];
    while let Some((word, depth)) = stack.pop() {
        match TopRef::from_word(word) {
            TopRef::Page { page, slot } => {
                let asked = root_counts.get_mut(page as usize)?;
                *asked = (*asked).max(slot as u8 + 1);
            }
            TopRef::Node(index) if depth < TREE_DEPTH => {
                let node = top.get(index as usize)?;
                let first_visit = !std::mem::replace(&mut seen[index as usize], true);
                let sound = first_visit
                    && (1..=NODE_WIDTH).contains(&usize::from(node.child_count))
                    && node.exponent.iter().all(|&e| e <= 32);
                if !sound {
                    return None;
                }
                stack.extend(
                    node.child[..usize::from(node.child_count)].iter().map(|&word| (word, depth + 1)),
                );
            }
            _ => return None,
        }
    }
    seen.iter().all(|&s| s).then_some((top, root_counts))
}

pub(super) fn parse_materials(bytes: &[u8], block: &Superblock) -> Option<Vec<Material>> {
    let materials: Vec<Material> = serde_json::from_slice(bytes).ok()?;
    let sound = (1..=MATERIALS).contains(&materials.len())
        && materials.len() == block.section(SectionKind::Materials).count as usize;
    sound.then(|| materials.into_iter().map(Material::checked).collect())
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
