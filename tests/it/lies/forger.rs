//! `Forger`: a page file whose tables, pages or octree are others, under hashes that match.

use crate::command::{TREX, document_in, folder, ran, run_in};
use crate::fixtures::built_in;
use crate::format_octree::Upper;
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::process::Command;
use trex_store::layout::{
    PAGE_ENTRY_BYTES, Packing, PageEntry, SUPERBLOCK_BYTES, SectionKind, Superblock, page_hash, section_hash,
};

/// A model of many materials and emitters, and its bytes.
pub(crate) struct Forger {
    pub(super) inside: tempfile::TempDir,
    pub(super) bytes: Vec<u8>,
    pub(super) block: Superblock,
}

impl Forger {
    pub(crate) fn new() -> Forger {
        let inside = folder();
        built_in(inside.path(), "gen:pipes:60k", "true.trex");
        let bytes = std::fs::read(inside.path().join("true.trex")).unwrap();
        let head = bytes.first_chunk::<SUPERBLOCK_BYTES>().unwrap();
        let block = Superblock::parse(head, Path::new("true.trex")).unwrap();
        Forger { inside, bytes, block }
    }

    /// The folder that holds `true.trex` and `lie.trex`.
    pub(crate) fn folder(&self) -> &Path {
        self.inside.path()
    }

    /// Writes `lie.trex`: a section's bytes and the superblock changed, all hashes made to match.
    pub(crate) fn seal(&self, kind: SectionKind, change: impl FnOnce(&mut [u8], &mut Superblock)) {
        let (mut bytes, mut block) = (self.bytes.clone(), self.block.clone());
        let section = block.section(kind);
        let place = section.offset as usize..(section.offset + section.bytes) as usize;
        change(&mut bytes[place], &mut block);
        for section in block.sections.iter_mut().filter(|s| s.kind == kind as u32) {
            // A length behind the end has no hash.
            let end = section.offset.saturating_add(section.bytes).min(bytes.len() as u64) as usize;
            section.hash = section_hash(&bytes[section.offset as usize..end], block.file_id, section.kind);
        }
        let head = block.to_bytes();
        let tail = bytes.len() - SUPERBLOCK_BYTES;
        bytes[..SUPERBLOCK_BYTES].copy_from_slice(&head);
        bytes[tail..].copy_from_slice(&head);
        std::fs::write(self.inside.path().join("lie.trex"), bytes).unwrap();
    }

    /// Writes `lie.trex` with other words in the octree, and the section's own count to match.
    pub(crate) fn seal_octree(&self, change: impl FnOnce(&mut Upper)) {
        let section = self.block.find_section(SectionKind::Upper).unwrap();
        let mut upper = Upper::read(&self.bytes[section.offset as usize..][..section.bytes as usize]);
        change(&mut upper);
        self.seal_octree_bytes(&upper.to_bytes(), upper.leaf_count);
    }

    /// Writes `lie.trex` with these bytes as its octree, which is the last section.
    pub(crate) fn seal_octree_bytes(&self, octree: &[u8], leaf_count: u64) {
        let mut block = self.block.clone();
        let section = block.sections.iter_mut().find(|s| s.kind == SectionKind::Upper as u32).unwrap();
        let begin = section.offset as usize;
        (section.bytes, section.count) = (octree.len() as u64, leaf_count as u32);
        section.hash = section_hash(octree, block.file_id, section.kind);
        block.file_bytes = (begin + octree.len() + SUPERBLOCK_BYTES) as u64;
        let head = block.to_bytes();
        let bytes = [&head, &self.bytes[SUPERBLOCK_BYTES..begin], octree, &head].concat();
        std::fs::write(self.inside.path().join("lie.trex"), bytes).unwrap();
    }

    /// The bytes of a section.
    pub(super) fn section(&self, kind: SectionKind) -> Vec<u8> {
        let section = self.block.section(kind);
        self.bytes[section.offset as usize..][..section.bytes as usize].to_vec()
    }

    /// Writes `lie.trex` with these bytes as its materials, behind all that was there before.
    pub(super) fn seal_materials(&self, materials: &[u8], count: u64) {
        let (mut block, end) = (self.block.clone(), self.bytes.len() - SUPERBLOCK_BYTES);
        let kind = SectionKind::Materials as u32;
        let section = block.sections.iter_mut().find(|section| section.kind == kind).unwrap();
        (section.offset, section.bytes, section.count) = (end as u64, materials.len() as u64, count as u32);
        section.hash = section_hash(materials, block.file_id, kind);
        block.file_bytes = (end + materials.len() + SUPERBLOCK_BYTES) as u64;
        let head = block.to_bytes();
        let bytes = [&head, &self.bytes[SUPERBLOCK_BYTES..end], materials, &head].concat();
        std::fs::write(self.inside.path().join("lie.trex"), bytes).unwrap();
    }

    /// Writes `lie.trex` with a section of so many zeros, most of which take no room on the disk.
    pub(super) fn seal_sparse(&self, kind: SectionKind, count: u32, bytes: u64) {
        let (mut block, end) = (self.block.clone(), self.bytes.len() as u64);
        let section = block.sections.iter_mut().find(|section| section.kind == kind as u32).unwrap();
        (section.offset, section.bytes, section.count) = (end, bytes, count);
        block.triangle_count = 1 << 31;
        block.input_triangle_count =
            block.triangle_count + block.rejected_degenerate + block.rejected_non_finite;
        block.file_bytes = end + bytes + SUPERBLOCK_BYTES as u64;
        let (head, path) = (block.to_bytes(), self.inside.path().join("lie.trex"));
        std::fs::write(&path, [&head, &self.bytes[SUPERBLOCK_BYTES..]].concat()).unwrap();
        let file = std::fs::OpenOptions::new().write(true).open(path).unwrap();
        file.write_all_at(&head, end + bytes).unwrap();
    }

    /// No verb takes more than its limit, whatever it says of the file.
    #[track_caller]
    pub(super) fn takes_no_room(&self, lie: &str) {
        for line in [
            "info lie.trex",
            "verify lie.trex --quick",
            "verify lie.trex --deep",
            "render lie.trex -o out.png --resolution 8x8 --integrator direct --overwrite",
        ] {
            let line = format!("{line} --memory-limit 80MiB --json -q");
            let script = format!("ulimit -v 1000000 && exec '{TREX}' {line}");
            let mut shell = Command::new("sh");
            let refused =
                ran(&line, shell.args(["-c", &script]).current_dir(self.inside.path()).output().unwrap());
            let is_told = matches!(refused.code, Some(1 | 3 | 4)) && !refused.stderr.contains("panicked");
            assert!(is_told, "{lie}: {line}: {:?}\n{}{}", refused.code, refused.stdout, refused.stderr);
            let peak = refused.document()["memory"]["peak_rss_bytes"].as_u64();
            assert!(peak.is_none_or(|peak| peak <= 80 << 20), "{lie}: {line}: {peak:?}");
        }
    }

    /// The octree is named as damaged by `verify`, and those who read it refuse the file.
    #[track_caller]
    pub(super) fn octree_refused(&self, lie: &str) {
        let verified = run_in(self.inside.path(), "verify lie.trex --deep --json -q");
        verified.expect(1);
        let damage = &verified.document()["damage"];
        assert_eq!(damage.as_array().unwrap().len(), 1, "{lie}: {damage:#}");
        assert!(damage[0]["what"].as_str().unwrap().contains("upper octree"), "{lie}: {damage:#}");
        for integrator in ["photon", "debug-upper"] {
            let line = format!("render lie.trex -o out.png --resolution 8x8 --integrator {integrator}");
            let error = run_in(self.inside.path(), &format!("{line} --json -q")).expect_error(3, "damaged");
            assert!(error["what"].as_str().unwrap().contains("upper octree"), "{lie}: {error:#}");
        }
    }

    /// Those who read the octree refuse it, as damaged or for want of room, in an address space of 2 GB.
    #[track_caller]
    pub(super) fn octree_takes_no_room(&self, lie: &str) {
        let render = "render lie.trex -o out.png --resolution 8x8 --integrator";
        for line in ["verify lie.trex --deep", &format!("{render} photon"), &format!("{render} debug-upper")]
        {
            let line = format!("{line} --memory-limit 256MiB --json -q");
            let script = format!("ulimit -v 2000000 && exec '{TREX}' {line}");
            let mut shell = Command::new("sh");
            let refused =
                ran(&line, shell.args(["-c", &script]).current_dir(self.inside.path()).output().unwrap());
            let is_told = matches!(refused.code, Some(1 | 3 | 4)) && !refused.stderr.contains("panicked");
            assert!(is_told, "{lie}: {line}: {:?}\n{}{}", refused.code, refused.stdout, refused.stderr);
        }
    }

    /// The file is refused when it is opened.
    #[track_caller]
    pub(super) fn refused(&self) {
        for line in ["info lie.trex", "render lie.trex -o out.png --resolution 8x8"] {
            run_in(self.inside.path(), &format!("{line} --json -q")).expect_error(3, "damaged");
        }
        run_in(self.inside.path(), "verify lie.trex --deep").expect(1);
    }

    /// The file opens, its bad pages are drawn as empty and named.
    #[track_caller]
    pub(super) fn drawn_without_bad_pages(&self) {
        run_in(self.inside.path(), "verify lie.trex --deep").expect(1);
        let drawn = document_in(
            self.inside.path(),
            "render lie.trex -o out.png --integrator direct --resolution 64x64 --spp 1 --overwrite --allow-damage",
        );
        assert_eq!(drawn["exact"], false, "{drawn:#}");
        assert!(!drawn["damaged_pages"].as_array().unwrap().is_empty(), "{drawn:#}");
    }

    /// The octree with each of its blocks in turn unpacking to 64 MiB: the block's place, the bytes.
    pub(crate) fn octree_bombs(&self) -> impl Iterator<Item = (usize, Vec<u8>)> {
        let section = self.block.find_section(SectionKind::Upper).unwrap();
        let whole = &self.bytes[section.offset as usize..][..section.bytes as usize];
        let packed = miniz_oxide::deflate::compress_to_vec(&vec![0; 64 << 20], 6);
        let bomb = [&(packed.len() as u32).to_le_bytes(), packed.as_slice()].concat();
        let mut at = 52;
        std::iter::from_fn(move || {
            let length = u32::from_le_bytes(*whole.get(at..)?.first_chunk()?) as usize;
            let place = at;
            at += 4 + length;
            Some((place, [&whole[..place], &bomb, &whole[at..]].concat()))
        })
    }

    /// Writes `lie.trex` whose first page unpacks to 255 times its bytes, and says that it does to a frame's.
    pub(crate) fn seal_page_bomb(mut self) -> Forger {
        let table = self.block.section(SectionKind::PageTable).offset as usize;
        let entry = PageEntry::parse(self.bytes[table..].first_chunk().unwrap()).unwrap();
        // A zero, a match that goes on for as long as there are bytes, and five literals.
        let mut bomb = vec![0xff; entry.stored_bytes as usize];
        bomb[..4].copy_from_slice(&[0x1f, 0, 1, 0]);
        bomb[entry.stored_bytes as usize - 7..].copy_from_slice(&[0, 0x50, 0, 0, 0, 0, 0]);
        assert!(lz4_flex::block::decompress(&bomb, 16 << 20).unwrap().len() > 250 * (bomb.len() - 20));
        self.bytes[entry.offset as usize..][..bomb.len()].copy_from_slice(&bomb);
        self.seal(SectionKind::PageTable, |table, block| {
            let (hash, mut bytes) = (page_hash(&bomb, block.file_id, 0), Vec::new());
            PageEntry { hash, unpacked_bytes: 65536, packing: Packing::Lz4, ..entry }.write(&mut bytes);
            table[..PAGE_ENTRY_BYTES].copy_from_slice(&bytes);
        });
        self
    }
}
