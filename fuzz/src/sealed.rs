//! Page files whose hashes are right whatever is in them, as a program of ill will would write them.

use super::head_hash;
use std::path::Path;
use trex_store::cluster::Node;
use trex_store::layout::{
    PAGE_ENTRY_BYTES, Packing, PageEntry, PageKind, SUPERBLOCK_BYTES, SectionKind, Superblock, page_hash,
    section_hash,
};

/// Bytes of an emitter; of what sections are aligned to.
const EMITTER_BYTES: u64 = 80;
const WORD: usize = 8;

/// Makes the hash of a superblock right.
pub(super) fn seal_head(head: &mut [u8; SUPERBLOCK_BYTES]) {
    let hash = head_hash(head);
    head[SUPERBLOCK_BYTES - 8..].copy_from_slice(&hash.to_le_bytes());
}

/// The same bytes with hashes that match, and the length and the second superblock that the first one asks for.
pub fn sealed(mut bytes: Vec<u8>) -> Vec<u8> {
    let Some(head) = bytes.first_chunk_mut::<SUPERBLOCK_BYTES>() else { return bytes };
    seal_head(head);
    let Ok(mut block) = Superblock::parse(head, Path::new("sealed.trex")) else { return bytes };
    seal(&mut block, &mut bytes);
    bytes
}

/// Where `length` bytes from `offset` stand, if they are there.
fn within(bytes: &[u8], offset: u64, length: u64) -> Option<std::ops::Range<usize>> {
    let end = offset.checked_add(length)?;
    (end <= bytes.len() as u64).then_some(offset as usize..end as usize)
}

/// Hashes pages, the page table and the sections anew.
fn seal(block: &mut Superblock, bytes: &mut [u8]) {
    block.file_bytes = bytes.len() as u64;
    let table = block.find_section(SectionKind::PageTable);
    let table = table.and_then(|table| within(bytes, table.offset, table.bytes)).unwrap_or_default();
    for (page, at) in table.step_by(PAGE_ENTRY_BYTES).enumerate() {
        let entry = bytes[at..].first_chunk::<PAGE_ENTRY_BYTES>().and_then(PageEntry::parse);
        let Some(mut entry) = entry else { continue };
        if let Some(stored) = within(bytes, entry.offset, u64::from(entry.stored_bytes)) {
            entry.hash = page_hash(&bytes[stored], block.file_id, page as u32);
            bytes[at..at + PAGE_ENTRY_BYTES].copy_from_slice(&written(&entry));
        }
    }
    for section in block.sections.iter_mut().filter(|section| section.kind != 0) {
        if let Some(place) = within(bytes, section.offset, section.bytes) {
            section.hash = section_hash(&bytes[place], block.file_id, section.kind);
        }
    }
    let head = block.to_bytes();
    bytes[..SUPERBLOCK_BYTES].copy_from_slice(&head);
    if let Some(tail) = bytes.len().checked_sub(SUPERBLOCK_BYTES) {
        bytes[tail..].copy_from_slice(&head);
    }
}

fn written(entry: &PageEntry) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(PAGE_ENTRY_BYTES);
    entry.write(&mut bytes);
    bytes
}

/// Bytes of an item of the sections that are counted by their length.
fn item_bytes(kind: SectionKind) -> Option<u64> {
    match kind {
        SectionKind::PageTable => Some(PAGE_ENTRY_BYTES as u64),
        SectionKind::TopTree => Some(Node::BYTES as u64),
        SectionKind::Emitters => Some(EMITTER_BYTES),
        _ => None,
    }
}

/// `file`, which is sound, with another section of this kind, counted by its length where that is how it is; what
/// stands behind it moves, by whole words.
pub fn with_section(file: &[u8], kind: SectionKind, content: &[u8]) -> Vec<u8> {
    let head = file.first_chunk().expect("a superblock");
    let mut block = Superblock::parse(head, Path::new("sound.trex")).expect("a sound file");
    let old = block.section(kind);
    let (begin, end) = (old.offset as usize, (old.offset + old.bytes) as usize);
    let padding = vec![0; (old.bytes as usize).wrapping_sub(content.len()) % WORD];
    let mut bytes = [&file[..begin], content, &padding, &file[end..]].concat();
    for section in block.sections.iter_mut().filter(|section| section.kind != 0) {
        if section.kind == kind as u32 {
            section.bytes = content.len() as u64;
            section.count = item_bytes(kind).map_or(section.count, |item| (section.bytes / item) as u32);
        } else if section.offset >= end as u64 {
            section.offset = section.offset - end as u64 + (begin + content.len() + padding.len()) as u64;
        }
    }
    seal(&mut block, &mut bytes);
    bytes
}

/// `file`, which is sound, with its first page of a kind replaced; what stands behind it moves.
pub fn with_page(file: &[u8], kind: PageKind, content: &[u8]) -> Vec<u8> {
    let head = file.first_chunk().expect("a superblock");
    let mut block = Superblock::parse(head, Path::new("sound.trex")).expect("a sound file");
    let table = block.section(SectionKind::PageTable);
    let table = &file[table.offset as usize..][..table.bytes as usize];
    let mut entries: Vec<PageEntry> = table
        .chunks_exact(PAGE_ENTRY_BYTES)
        .map(|entry| PageEntry::parse(entry.first_chunk().expect("an entry")).expect("a sound entry"))
        .collect();
    let changed = entries.iter().position(|entry| entry.kind == kind).expect("a page of this kind");
    let old = entries[changed];
    let (begin, end) = (old.offset, old.offset + u64::from(old.stored_bytes));
    let mut bytes = [&file[..begin as usize], content, &file[end as usize..]].concat();
    let moved =
        |offset: u64| if offset >= end { offset - end + begin + content.len() as u64 } else { offset };
    let length = content.len() as u32;
    for (page, entry) in entries.iter_mut().enumerate() {
        match page == changed {
            true => {
                entry.packing = Packing::Raw;
                (entry.stored_bytes, entry.unpacked_bytes) = (length, length);
            }
            false => entry.offset = moved(entry.offset),
        }
    }
    block.sections.iter_mut().filter(|section| section.kind != 0).for_each(|s| s.offset = moved(s.offset));
    let at = block.section(SectionKind::PageTable).offset as usize;
    let table: Vec<u8> = entries.iter().flat_map(written).collect();
    bytes[at..at + table.len()].copy_from_slice(&table);
    seal(&mut block, &mut bytes);
    bytes
}
