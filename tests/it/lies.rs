//! Page files whose hashes are right and whose tables lie, as a program of ill will would write them. Damage by chance
//! never gets past the hashes, so these are sealed by hand. Nothing may panic, hang or be drawn wrongly in silence.

use crate::command::{document_in, folder, run_in};
use std::path::Path;
use trex_store::PageFile;
use trex_store::cluster::{Node, TopRef};
use trex_store::layout::{SUPERBLOCK_BYTES, SectionKind, Superblock, section_hash};

/// A model of many materials and emitters, and its bytes.
struct Forger {
    inside: tempfile::TempDir,
    bytes: Vec<u8>,
    block: Superblock,
}

impl Forger {
    fn new() -> Forger {
        let inside = folder();
        document_in(inside.path(), "build gen:pipes:60k -o true.trex");
        let bytes = std::fs::read(inside.path().join("true.trex")).unwrap();
        let head = bytes.first_chunk::<SUPERBLOCK_BYTES>().unwrap();
        let block = Superblock::parse(head, Path::new("true.trex")).unwrap();
        Forger { inside, bytes, block }
    }

    /// Writes `lie.trex`: a section's bytes and the superblock changed, all hashes made to match.
    fn seal(&self, kind: SectionKind, change: impl FnOnce(&mut [u8], &mut Superblock)) {
        let (mut bytes, mut block) = (self.bytes.clone(), self.block.clone());
        let section = block.section(kind);
        let place = section.offset as usize..(section.offset + section.bytes) as usize;
        change(&mut bytes[place.clone()], &mut block);
        for section in block.sections.iter_mut().filter(|s| s.kind == kind as u32) {
            section.hash = section_hash(&bytes[place.clone()], block.file_id, section.kind);
        }
        let head = block.to_bytes();
        let tail = bytes.len() - SUPERBLOCK_BYTES;
        bytes[..SUPERBLOCK_BYTES].copy_from_slice(&head);
        bytes[tail..].copy_from_slice(&head);
        std::fs::write(self.inside.path().join("lie.trex"), bytes).unwrap();
    }

    /// The file is refused when it is opened.
    #[track_caller]
    fn refused(&self) {
        for line in ["info lie.trex", "render lie.trex -o out.png --resolution 8x8"] {
            run_in(self.inside.path(), &format!("{line} --json -q")).expect_error(3, "damaged");
        }
        run_in(self.inside.path(), "verify lie.trex").expect(1);
    }

    /// The file opens, its bad pages are drawn as empty and named.
    #[track_caller]
    fn drawn_without_bad_pages(&self) {
        run_in(self.inside.path(), "verify lie.trex").expect(1);
        let drawn = document_in(
            self.inside.path(),
            "render lie.trex -o out.png --resolution 64x64 --spp 1 --overwrite",
        );
        assert_eq!(drawn["exact"], false, "{drawn:#}");
        assert!(!drawn["damaged_pages"].as_array().unwrap().is_empty(), "{drawn:#}");
    }
}

/// Calls `change` for the words of the top tree that lead to pages.
fn page_words(bytes: &mut [u8], mut change: impl FnMut(u32, u32) -> TopRef) {
    let mut nodes: Vec<Node> = bytemuck::pod_collect_to_vec(bytes);
    for node in &mut nodes {
        for word in &mut node.child[..usize::from(node.child_count)] {
            if let TopRef::Page { page, slot } = TopRef::from_word(*word) {
                *word = change(page, slot).to_word();
            }
        }
    }
    bytes.copy_from_slice(bytemuck::cast_slice(&nodes));
}

#[test]
fn the_forger_seals_well() {
    let forger = Forger::new();
    forger.seal(SectionKind::TopTree, |bytes, _| page_words(bytes, |page, slot| TopRef::Page { page, slot }));
    let path = forger.inside.path();
    assert_eq!(std::fs::read(path.join("lie.trex")).unwrap(), forger.bytes);
    assert!(
        PageFile::open(&path.join("lie.trex"), &trex_store::Budget::unlimited()).unwrap().top().len() > 1
    );
}

#[test]
fn roots_that_a_page_does_not_have() {
    let forger = Forger::new();
    forger
        .seal(SectionKind::TopTree, |bytes, _| page_words(bytes, |page, _| TopRef::Page { page, slot: 63 }));
    forger.drawn_without_bad_pages();
}

#[test]
fn trees_that_are_none() {
    let forger = Forger::new();
    // All children lead to the root.
    forger.seal(SectionKind::TopTree, |bytes, block| page_words(bytes, |_, _| TopRef::from_word(block.root)));
    forger.refused();
    forger.seal(SectionKind::TopTree, |bytes, _| {
        page_words(bytes, |_, _| TopRef::Page { page: 1 << 24, slot: 0 })
    });
    forger.refused();
}

#[test]
fn fewer_materials_than_the_pages_name() {
    let forger = Forger::new();
    let keep_one = |bytes: &mut [u8], block: &mut Superblock| {
        let all: Vec<trex_store::Material> = serde_json::from_slice(bytes).unwrap();
        let one = serde_json::to_vec(&all[..1]).unwrap();
        bytes.fill(b' ');
        bytes[..one.len()].copy_from_slice(&one);
        block
            .sections
            .iter_mut()
            .filter(|s| s.kind == SectionKind::Materials as u32)
            .for_each(|s| s.count = 1);
    };
    // The lamps name materials that are gone.
    forger.seal(SectionKind::Materials, keep_one);
    forger.refused();
    // Without lamps, the pages do.
    forger.seal(SectionKind::Materials, |bytes, block| {
        keep_one(bytes, block);
        for section in block.sections.iter_mut().filter(|s| s.kind == SectionKind::Emitters as u32) {
            (section.count, section.bytes) = (0, 0);
            section.hash = section_hash(&[], block.file_id, section.kind);
        }
    });
    forger.drawn_without_bad_pages();
}

#[test]
fn counts_that_lie() {
    let forger = Forger::new();
    for kind in SectionKind::ALL {
        for count in [0, 1, u32::MAX] {
            forger.seal(kind, |_, block| {
                block.sections.iter_mut().filter(|s| s.kind == kind as u32).for_each(|s| s.count = count);
            });
            if count != forger.block.section(kind).count {
                forger.refused();
            }
        }
    }
    forger.seal(SectionKind::PageTable, |_, block| block.triangle_count += 1);
    forger.refused();
}
