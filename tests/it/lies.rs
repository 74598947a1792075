//! Page files whose hashes are right and whose tables lie, as a program of ill will would write them. Damage by chance
//! never gets past the hashes, so these are sealed by hand. Nothing may panic, hang or be drawn wrongly in silence.

mod forger;

pub(crate) use forger::Forger;

use crate::command::{document_in, run_in};
use crate::format_octree::Upper;
use trex_store::PageFile;
use trex_store::cluster::{Node, TopRef};
use trex_store::layout::{Section, SectionKind, Superblock, section_hash};

/// Calls `change` for the words of the top tree that lead to pages.
fn page_words(bytes: &mut [u8], mut change: impl FnMut(u32, u32) -> TopRef) {
    let mut nodes: Vec<Node> = bytemuck::pod_collect_to_vec(bytes);
    for node in &mut nodes {
        for word in &mut node.child[..usize::from(node.boxes.child_count)] {
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
        let all: Vec<serde_json::Value> = serde_json::from_slice(bytes).unwrap();
        let one = serde_json::to_vec(&all[..1]).unwrap();
        bytes[..one.len()].copy_from_slice(&one);
        for section in block.sections.iter_mut().filter(|s| s.kind == SectionKind::Materials as u32) {
            (section.count, section.bytes) = (1, one.len() as u64);
        }
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

/// A section of 162 MB, of 4.26 million entries where the count said 28, was read and parsed before the two were
/// compared: the kernel ended every verb that opened the file, at 512 MiB.
#[test]
fn materials_beyond_their_count_take_no_room() {
    let forger = Forger::new();
    let whole = forger.section(SectionKind::Materials);
    let count = u64::from(forger.block.section(SectionKind::Materials).count);
    let entry = &whole[1..whole.windows(2).position(|pair| pair == b"},").unwrap()];
    let entries = |count: usize| {
        let all = [entry, b"},"].concat().repeat(count);
        [b"[", &all[..all.len() - 1], b"]"].concat()
    };
    let named = |name: &str| {
        let mut all: Vec<serde_json::Value> = serde_json::from_slice(&whole).unwrap();
        all[3]["name"] = name.into();
        serde_json::to_vec(&all).unwrap()
    };
    forger.seal_materials(&named(&"n".repeat(255)), count);
    document_in(forger.inside.path(), "info lie.trex --memory-limit 128MiB");
    let lies = [
        ("an entry more", entries(count as usize + 1), count),
        ("an entry less", entries(count as usize - 1), count),
        ("entries without end", entries(1_400_000), count),
        ("entries without end, and a count for them", entries(1_400_000), 1_400_000),
        ("none", b"[]".to_vec(), 0),
        ("a name too long", named(&"n".repeat(256)), count),
        ("a name of 34 MB", named(&"n".repeat(34 << 20)), count),
        ("a name of 34 MB, and a count for its length", named(&"n".repeat(34 << 20)), 65_536),
        ("brackets without end", vec![b'['; 100 << 10], 65_536),
        ("blanks without end", vec![b' '; 100 << 10], 65_536),
        ("another key", [b"[{\"other\":0,", &entry[1..], b"}]"].concat(), 1),
        ("a number that is none", [b"[", entry, b",\"d\":null}]"].concat(), 1),
    ];
    for (lie, bytes, count) in lies {
        forger.seal_materials(&bytes, count);
        forger.refused();
        forger.takes_no_room(lie);
    }
}

/// Sections that every file has, as long as a sparse file makes them, with counts that go with it and that do not.
#[test]
fn tables_of_a_sparse_file_take_no_room() {
    let forger = Forger::new();
    for (kind, entry_bytes) in
        [(SectionKind::PageTable, 40), (SectionKind::TopTree, 144), (SectionKind::Emitters, 80)]
    {
        for (count, bytes) in [(3 << 20, entry_bytes * (3 << 20)), (3, 1 << 28), (u32::MAX, 1 << 28)] {
            forger.seal_sparse(kind, count, bytes);
            forger.takes_no_room(&format!("{kind:?} of {bytes} bytes, {count} entries"));
        }
    }
}

#[test]
fn the_forger_seals_octrees_well() {
    let forger = Forger::new();
    forger.seal_octree(|_| {});
    assert_eq!(std::fs::read(forger.inside.path().join("lie.trex")).unwrap(), forger.bytes);
}

/// What is told, and how.
type Lie<'a> = (&'a str, &'a dyn Fn(&mut Upper));

#[test]
fn octrees_that_are_none() {
    let forger = Forger::new();
    let material_count = u64::from(forger.block.section(SectionKind::Materials).count);
    let lies: [Lie<'_>; 22] = [
        ("no such resolution", &|upper| upper.resolution = 128),
        ("no resolution at all", &|upper| upper.resolution = 0),
        ("a resolution beyond all", &|upper| upper.resolution = u64::from(u32::MAX)),
        ("another depth", &|upper| upper.resolution = if upper.resolution == 64 { 256 } else { 64 }),
        ("no steps", &|upper| upper.subvoxel_steps = 0),
        ("steps beyond the lattice", &|upper| upper.subvoxel_steps = 1 << 40),
        ("steps backwards", &|upper| upper.subvoxel_steps = u64::MAX),
        ("a cube beyond the lattice", &|upper| upper.lo[1] = 1 << 40),
        ("a cube before the lattice", &|upper| upper.lo[2] = u64::MAX),
        ("a leaf more", &|upper| upper.leaf_count += 1),
        ("a leaf less", &|upper| upper.leaf_count -= 1),
        ("a facet more", &|upper| upper.facet_count += 1),
        ("facets for all", &|upper| upper.facet_count = upper.leaf_count),
        ("a node more", &|upper| upper.node_count += 1),
        ("a node less", &|upper| upper.node_count -= 1),
        ("a mask of zero", &|upper| *upper.streams[0].last_mut().unwrap() = 0),
        ("a root of zero", &|upper| upper.streams[0][0] = 0),
        ("a full root", &|upper| upper.streams[0][0] = u64::MAX),
        ("a bitmap of zero", &|upper| upper.streams[1][7] = 0),
        ("a material too many", &|upper| upper.streams[4][3] = material_count),
        ("the greatest material", &|upper| upper.streams[4][3] = 0xffff),
        // All leaves look down z: fewer facets.
        ("normals of zero", &|upper| upper.streams[2].fill(0)),
    ];
    for (lie, change) in lies {
        forger.seal_octree(change);
        forger.octree_refused(lie);
    }
}

/// Streams that end early, go on, or whose blocks are of another length than they must be.
#[test]
fn octrees_whose_bytes_lie() {
    let forger = Forger::new();
    let section = forger.block.find_section(SectionKind::Upper).unwrap();
    let whole = &forger.bytes[section.offset as usize..][..section.bytes as usize];
    let count = u64::from(section.count);
    for left in [0, 1, 51, 52, 55, 56, 1000, whole.len() - 1] {
        forger.seal_octree_bytes(&whole[..left], count);
        forger.octree_refused(&format!("cut to {left} bytes"));
    }
    forger.seal_octree_bytes(&[whole, &[0]].concat(), count);
    forger.octree_refused("a byte more");
    for length in [0, 1, u32::MAX, whole.len() as u32] {
        let mut bytes = whole.to_vec();
        bytes[52..56].copy_from_slice(&length.to_le_bytes());
        forger.seal_octree_bytes(&bytes, count);
        forger.octree_refused(&format!("a block of {length} bytes"));
    }
    // The section's count and the head's.
    forger.seal_octree_bytes(whole, count + 1);
    forger.octree_refused("another count of items");
}

/// Counts far above what is there: nothing of their size is allocated. The wall is an address space without room for
/// it.
#[test]
fn octrees_that_claim_to_be_huge() {
    let forger = Forger::new();
    let beyond = u64::from(u32::MAX);
    let lies: [Lie<'_>; 5] = [
        ("nodes beyond all", &|upper| upper.node_count = u64::MAX),
        ("nodes beyond memory", &|upper| upper.node_count = 1 << 40),
        ("leaves beyond all", &|upper| upper.leaf_count = beyond),
        ("facets beyond all", &|upper| upper.facet_count = beyond),
        ("all beyond all", &|upper| {
            (upper.leaf_count, upper.facet_count, upper.node_count) = (beyond, beyond, u64::MAX);
        }),
    ];
    for (lie, change) in lies {
        forger.seal_octree(change);
        forger.octree_refused(lie);
        forger.octree_takes_no_room(lie);
    }
    // Leaves for which so many bytes would do, if they were zeros and packed well, but not with all their nodes.
    forger.seal_octree(|upper| {
        upper.leaf_count = 250 * upper.to_bytes().len() as u64;
        (upper.facet_count, upper.node_count) = (upper.leaf_count, 5 * upper.leaf_count);
    });
    forger.octree_refused("what would fit zeros");
    forger.octree_takes_no_room("what would fit zeros");
}

/// Every block of the octree in turn, unpacking to 64 MiB.
#[test]
fn octrees_that_are_bombs() {
    let forger = Forger::new();
    let leaf_count = u64::from(forger.block.find_section(SectionKind::Upper).unwrap().count);
    let mut block_count = 0;
    for (at, octree) in forger.octree_bombs() {
        forger.seal_octree_bytes(&octree, leaf_count);
        let lie = format!("the block at byte {at} is a bomb");
        forger.octree_refused(&lie);
        forger.octree_takes_no_room(&lie);
        block_count += 1;
    }
    assert!(block_count >= 5, "{block_count} blocks: not even one a stream");
}

#[test]
fn pages_that_are_bombs() {
    Forger::new().seal_page_bomb().drawn_without_bad_pages();
}

/// A slot that is not used had no rules: its length was added to what the tables take, until the sum came round to a
/// small one, and 312 MB were taken under a limit of 64.
#[test]
fn slots_that_are_not_used_hold_nothing() {
    let forger = Forger::new();
    let unused = forger.block.sections.iter().position(|section| section.kind == 0).unwrap();
    let tables: u64 = SectionKind::ALL.iter().map(|&kind| forger.block.section(kind).bytes).sum();
    let lie = |what: &str, change: &dyn Fn(&mut Section)| {
        forger.seal(SectionKind::TopTree, |_, block| change(&mut block.sections[unused]));
        forger.refused();
        let line = "verify lie.trex --deep --memory-limit 64MiB --json -q";
        let verified = run_in(forger.inside.path(), line);
        verified.expect(1);
        let peak = verified.document()["memory"]["peak_rss_bytes"].as_u64().unwrap();
        assert!(peak < 64 << 20, "{what}: {peak} bytes of 64 MiB");
    };
    lie("a length", &|section| section.bytes = 1);
    lie("a length that brings the sum round", &|section| section.bytes = u64::MAX - tables + 1);
    lie("a third of that", &|section| section.bytes = (u64::MAX - 3 * tables) / 3 + 1);
    lie("an offset", &|section| section.offset = 4096);
    lie("a count", &|section| section.count = 1);
    lie("a hash", &|section| section.hash = 1);
    lie("a kind alone, behind the end", &|section| (section.kind, section.bytes) = (7, u64::MAX));
    let twice = forger.block.section(SectionKind::Emitters);
    lie("a section that is there already", &|section| *section = twice);
}

/// Counts whose sums or products would not fit: refused one by one, before anything is computed of them.
#[test]
fn superblocks_whose_counts_disagree() {
    let forger = Forger::new();
    let lies: [&dyn Fn(&mut Superblock); 9] = [
        &|block| block.input_triangle_count += 1,
        &|block| block.rejected_degenerate = u64::MAX,
        &|block| {
            block.rejected_degenerate = u64::MAX;
            block.rejected_non_finite = 1 + block.input_triangle_count - block.triangle_count;
        },
        &|block| block.rejected_collapsed = 1 + block.rejected_degenerate,
        &|block| block.vertex_count = u64::MAX,
        &|block| block.cluster_count = u64::MAX,
        &|block| block.wide_cluster_count = u64::MAX,
        &|block| block.resident_bytes = u64::MAX,
        &|block| block.page_tree_bytes = u64::MAX,
    ];
    for lie in lies {
        forger.seal(SectionKind::TopTree, |_, block| lie(block));
        forger.refused();
    }
}
