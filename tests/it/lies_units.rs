//! Files whose hashes are right and whose units lie: pages of units and their links, sealed by hand. The gate refuses
//! what would lead out of a page; what it cannot know, `verify` does; nothing panics.

use crate::command::{document_in, folder, run_in};
use crate::fixtures::built_in;
use serde_json::Value;
use std::path::Path;
use trex_store::layout::{
    PAGE_ENTRY_BYTES, Packing, PageEntry, PageKind, SUPERBLOCK_BYTES, SectionKind, Superblock, page_hash,
    section_hash,
};
use trex_store::{Budget, PageFile};

/// A model with units, in parts.
struct UnitForger {
    inside: tempfile::TempDir,
    bytes: Vec<u8>,
    block: Superblock,
    entries: Vec<PageEntry>,
}

impl UnitForger {
    fn new(voxels: &str) -> UnitForger {
        let inside = folder();
        // Many materials; where there are very many leaves, little surface.
        let spec = if voxels == "64/1024" { "gen:scan:10k" } else { "gen:pipes:10k" };
        built_in(inside.path(), &format!("{spec} --voxels {voxels}"), "true.trex");
        let path = inside.path().join("true.trex");
        let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
        let (block, entries) = (file.superblock().clone(), file.pages().to_vec());
        UnitForger { bytes: std::fs::read(path).unwrap(), inside, block, entries }
    }

    fn path(&self) -> &Path {
        self.inside.path()
    }

    /// The number of the first or last page of units.
    fn first(&self) -> usize {
        self.entries.iter().position(|entry| entry.kind == PageKind::Units).unwrap()
    }

    /// A page, unpacked.
    fn page(&self, page: usize) -> Vec<u8> {
        let entry = &self.entries[page];
        let stored = &self.bytes[entry.offset as usize..][..entry.stored_bytes as usize];
        match entry.packing {
            Packing::Raw => stored.to_vec(),
            Packing::Lz4 => lz4_flex::block::decompress(stored, entry.unpacked_bytes as usize).unwrap(),
        }
    }

    /// Writes `lie.trex`, with other bytes in a page and in the links; all else moves on, all hashes match.
    fn seal(&self, page: Option<(usize, Vec<u8>)>, links: impl FnOnce(&mut Vec<u8>, &mut u32)) {
        let mut block = self.block.clone();
        let mut out = vec![0; SUPERBLOCK_BYTES];
        let mut table = Vec::with_capacity(self.entries.len() * PAGE_ENTRY_BYTES);
        for (number, entry) in self.entries.iter().enumerate() {
            let mut entry = PageEntry { offset: out.len() as u64, ..*entry };
            let old = &self.entries[number];
            let mut stored = self.bytes[old.offset as usize..][..old.stored_bytes as usize].to_vec();
            if let Some((_, raw)) = page.as_ref().filter(|(changed, _)| *changed == number) {
                stored = lz4_flex::block::compress(raw);
                (entry.packing, entry.unpacked_bytes) = (Packing::Lz4, raw.len() as u32);
            }
            entry.stored_bytes = stored.len() as u32;
            entry.hash = page_hash(&stored, block.file_id, number as u32);
            entry.write(&mut table);
            out.extend(stored);
        }
        let mut links = Some(links);
        for section in block.sections.iter_mut().filter(|section| section.kind != 0) {
            let mut bytes = self.bytes[section.offset as usize..][..section.bytes as usize].to_vec();
            if section.kind == SectionKind::PageTable as u32 {
                bytes = std::mem::take(&mut table);
            }
            if section.kind == SectionKind::Lower as u32 {
                links.take().unwrap()(&mut bytes, &mut section.count);
            }
            (section.offset, section.bytes) = (out.len() as u64, bytes.len() as u64);
            section.hash = section_hash(&bytes, block.file_id, section.kind);
            out.extend(bytes);
        }
        block.file_bytes = (out.len() + SUPERBLOCK_BYTES) as u64;
        let head = block.to_bytes();
        out[..SUPERBLOCK_BYTES].copy_from_slice(&head);
        out.extend(head);
        std::fs::write(self.path().join("lie.trex"), out).unwrap();
    }

    /// The first page of units that the default camera looks at.
    fn seen(&self) -> usize {
        let seen = |page: &usize| {
            let mut raw = self.page(*page);
            raw.truncate(20);
            self.seal(Some((*page, raw)), |_, _| {});
            let drawn = document_in(self.path(), &render("lie.trex", "debug-lower"));
            drawn["damaged_pages"] == Value::from(vec![*page])
        };
        (self.first()..self.entries.len()).find(seen).expect("a page that is looked at")
    }

    /// `verify` names the page; those who look at it draw the upper octree, and say so.
    #[track_caller]
    fn page_is_refused(&self, lie: &str, page: usize) {
        // Every hash is right.
        run_in(self.path(), "verify lie.trex -q").expect(0);
        let verified = run_in(self.path(), "verify lie.trex --deep --json -q");
        verified.expect(1);
        let damage = &verified.document()["damage"][0];
        assert_eq!(damage["page"], page, "{lie}: {damage:#}");
        assert!(damage["bounds"]["lo"][0].is_number(), "{lie}: {damage:#}");
        let drawn = document_in(self.path(), &render("lie.trex", "debug-lower"));
        assert_eq!(drawn["damaged_pages"], Value::from(vec![page]), "{lie}: {drawn:#}");
        document_in(self.path(), &render("lie.trex", "photon"));
    }

    /// The links are named as damaged, and those who read them refuse the file.
    #[track_caller]
    fn links_are_refused(&self, lie: &str) {
        let verified = run_in(self.path(), "verify lie.trex --deep --json -q");
        verified.expect(1);
        let damage = &verified.document()["damage"][0];
        assert!(damage["what"].as_str().unwrap().contains("lower octrees"), "{lie}: {damage:#}");
        for integrator in ["photon", "debug-lower"] {
            let line = format!("{} --json -q", render("lie.trex", integrator));
            let error = run_in(self.path(), &line).expect_error(3, "damaged");
            assert!(error["what"].as_str().unwrap().contains("lower octrees"), "{lie}: {error:#}");
        }
    }
}

fn render(file: &str, integrator: &str) -> String {
    format!(
        "render {file} -o out.png --overwrite --allow-damage --resolution 48x48 --spp 1 --photons 1k \
         --integrator {integrator}"
    )
}

/// Where the arrays of an unpacked page begin: nodes of units, leaves of nodes, words, bitmaps, normals, materials.
fn arrays(raw: &[u8]) -> [usize; 6] {
    let word = |i: usize| u32::from_le_bytes(raw[4 * i..4 * i + 4].try_into().unwrap()) as usize;
    let [units, nodes, leaves, linked] = [0, 1, 2, 3].map(word);
    let bitmaps = 16 + units + nodes + 4 * nodes * linked;
    [16, 16 + units, 16 + units + nodes, bitmaps, bitmaps + 8 * leaves, bitmaps + 10 * leaves]
}

/// What is told, and how.
type UnitLie<'a> = (&'a str, &'a dyn Fn(&mut Vec<u8>));

#[test]
fn the_forger_seals_units_well() {
    for voxels in ["64/256", "64/1024"] {
        let forger = UnitForger::new(voxels);
        forger.seal(None, |_, _| {});
        assert_eq!(std::fs::read(forger.path().join("lie.trex")).unwrap(), forger.bytes, "{voxels}");
    }
}

#[test]
fn units_that_are_none() {
    let forger = UnitForger::new("64/256");
    let page = forger.seen();
    let lies: [UnitLie<'_>; 12] = [
        ("no units", &|raw| raw[0] = 0),
        ("a unit more", &|raw| raw[0] += 1),
        ("units beyond all", &|raw| raw[..4].fill(0xff)),
        ("nodes beyond all", &|raw| raw[4..8].fill(0xff)),
        ("leaves beyond all", &|raw| raw[8..12].fill(0xff)),
        ("words that are not there", &|raw| raw[12] = 1),
        ("no nodes in a unit", &|raw| raw[16] = 0),
        ("leaves that are another node's", &|raw| {
            let at = arrays(raw)[1];
            (raw[at], raw[at + 1]) = (65, raw[at + 1].wrapping_add(raw[at]).wrapping_sub(65));
        }),
        ("an empty bitmap", &|raw| {
            let [bitmaps, normals] = [3, 4].map(|array| arrays(raw)[array]);
            let leaves = (normals - bitmaps) / 8;
            (0..8).for_each(|plane| raw[bitmaps + plane * leaves] = 0);
        }),
        ("a normal of no direction", &|raw| {
            let at = arrays(raw)[4];
            raw[at] = 0xff;
        }),
        ("a material too many", &|raw| *raw.last_mut().unwrap() = 0xff),
        ("a byte less", &|raw| raw.truncate(raw.len() - 1)),
    ];
    for (lie, change) in lies {
        let mut raw = forger.page(page);
        change(&mut raw);
        forger.seal(Some((page, raw)), |_, _| {});
        forger.page_is_refused(lie, page);
    }
}

/// What passes the gate but is not what the octree above says.
#[test]
fn units_that_are_others() {
    for (voxels, is_last) in [("64/256", false), ("64/1024", false), ("64/1024", true)] {
        let forger = UnitForger::new(voxels);
        let page = if is_last { forger.entries.len() - 1 } else { forger.first() };
        // Two nodes with other counts of leaves change places.
        let mut raw = forger.page(page);
        let [_, nodes, links, ..] = arrays(&raw);
        let other = (nodes + 1..links).find(|&at| raw[at] != raw[nodes]).unwrap();
        raw.swap(nodes, other);
        forger.seal(Some((page, raw)), |_, _| {});
        let verified = run_in(forger.path(), "verify lie.trex --deep --json -q");
        verified.expect(1);
        // Where units nest, the page that leads to it is as good a culprit.
        assert!(verified.document()["damage"][0]["page"].as_u64().unwrap() as usize >= page, "{voxels}");
        for integrator in ["photon", "debug-lower"] {
            document_in(forger.path(), &render("lie.trex", integrator));
        }
    }
}

#[test]
fn links_that_lead_astray() {
    let forger = UnitForger::new("64/256");
    let head = |bytes: &mut Vec<u8>, factor: u32| bytes[..4].copy_from_slice(&factor.to_le_bytes());
    for factor in [0, 1, 2, 16, 64, u32::MAX] {
        forger.seal(None, |bytes, _| head(bytes, factor));
        // A grid for 16 may be one for 4, too: then pages tell.
        if factor != 16 {
            forger.links_are_refused(&format!("a refinement of {factor}"));
        } else {
            run_in(forger.path(), "verify lie.trex --deep -q").expect(1);
        }
    }
    for step in [-1i64, 1] {
        forger.seal(None, |_, count| *count = count.wrapping_add_signed(step as i32));
        forger.links_are_refused("another count");
    }
    for left in [0, 5, 12, 15] {
        forger.seal(None, |bytes, _| bytes.truncate(left));
        forger.links_are_refused("cut");
    }
    forger.seal(None, |bytes, _| bytes.push(0));
    forger.links_are_refused("a byte more");
    // All words alike: a page of the mesh, a page beyond the file, a unit that its page does not have.
    let first = forger.first() as u32;
    for (lie, word, is_refused) in
        [("the mesh", 0, true), ("no page", 1 << 24, true), ("no such unit", first | 127 << 25, false)]
    {
        forger.seal(None, |bytes, count| {
            let planes: Vec<u8> =
                (0..4).flat_map(|p| vec![(word >> (8 * p)) as u8; *count as usize]).collect();
            let packed = miniz_oxide::deflate::compress_to_vec(&planes, 3);
            bytes.truncate(12);
            bytes.extend((packed.len() as u32).to_le_bytes());
            bytes.extend(packed);
        });
        if is_refused {
            forger.links_are_refused(lie);
        } else {
            run_in(forger.path(), "verify lie.trex --deep -q").expect(1);
            document_in(forger.path(), &render("lie.trex", "debug-lower"));
        }
    }
    forger.seal(None, |bytes, _| bytes[4] ^= 1);
    let verified = run_in(forger.path(), "verify lie.trex --deep --json -q");
    verified.expect(1);
    assert!(verified.document()["damage"][0]["what"].as_str().unwrap().contains("leaves"));
}
