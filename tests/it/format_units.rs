//! Units of the lower octrees, read from `docs/format.md` alone: which leaves they hold follows from the bitmaps
//! above them, and each leaf is held against the triangles, as those of the upper octree are.

use crate::format::{Model, Reader};
use crate::format_octree::{Upper, check_leaf, touched_at};
use crate::support::Built;
use std::collections::BTreeMap;
use trex_store::layout::FRAME_BYTES;
use trex_store::octree::UnitsView;

/// One unit: per node its leaves, and the word of the unit below it.
pub(crate) struct Unit {
    pub(crate) nodes: Vec<(Vec<Leaf>, Option<u64>)>,
}

/// Bitmap, normal, material.
pub(crate) type Leaf = [u64; 3];

/// A leaf at its place, with the word of its node.
type LeafAt = ([i64; 3], Leaf, Option<u64>);

/// The units of an unpacked page.
pub(crate) fn read_units(page: &[u8], material_bytes: usize) -> Vec<Unit> {
    let mut r = Reader { bytes: page, at: 0 };
    let [units, nodes, leaves, linked] = [4; 4].map(|width| r.number(width) as usize);
    let unit_nodes: Vec<u64> = (0..units).map(|_| r.number(1)).collect();
    let node_leaves: Vec<u64> = (0..nodes).map(|_| r.number(1)).collect();
    let mut planes = |count: usize, width: usize| -> Vec<u64> {
        let bytes: Vec<u64> = (0..count * width).map(|_| r.number(1)).collect();
        (0..count).map(|i| (0..width).map(|plane| bytes[plane * count + i] << (8 * plane)).sum()).collect()
    };
    let words = planes(nodes * linked, 4);
    let streams =
        [(leaves, 8), (leaves, 2), (leaves, material_bytes)].map(|(count, width)| planes(count, width));
    assert_eq!(r.at, page.len(), "bytes behind the last plane");
    assert!((1..=128).contains(&units) && linked <= 1);
    let (mut next_node, mut next_leaf) = (0, 0);
    let mut read_node = || {
        let leaf = |i: usize| streams.each_ref().map(|words| words[i]);
        let own = (next_leaf..next_leaf + node_leaves[next_node] as usize).map(leaf).collect::<Vec<_>>();
        next_leaf += own.len();
        next_node += 1;
        (own, words.get(next_node - 1).copied())
    };
    let all =
        unit_nodes.iter().map(|&nodes| Unit { nodes: (0..nodes).map(|_| read_node()).collect() }).collect();
    assert_eq!((next_node, next_leaf), (nodes, leaves), "units part the nodes, nodes the leaves");
    all
}

/// Section 6: refinement, leaves, words.
pub(crate) fn read_links(bytes: &[u8], count: usize) -> (u64, u64, Vec<u64>) {
    const BLOCK_WORDS: usize = 65536 / 4;
    let mut r = Reader { bytes, at: 0 };
    let (refinement, leaf_count) = (r.number(4), r.number(8));
    let mut words = Vec::new();
    while words.len() < count {
        let part = (count - words.len()).min(BLOCK_WORDS);
        let packed = r.number(4) as usize;
        let planes = miniz_oxide::inflate::decompress_to_vec(&bytes[r.at..r.at + packed]).unwrap();
        r.at += packed;
        words.extend(
            (0..part).map(|i| (0..4).map(|p| u64::from(planes[p * part + i]) << (8 * p)).sum::<u64>()),
        );
    }
    assert_eq!(r.at, bytes.len(), "bytes behind the last word");
    (refinement, leaf_count, words)
}

/// All units of a file.
struct Lower {
    pages: BTreeMap<u64, Vec<Unit>>,
    /// Words that were followed: none twice.
    seen: BTreeMap<u64, ()>,
}

impl Lower {
    /// The leaves of the unit behind `word`, whose nodes are leaves at these places with these bitmaps; with the
    /// words of their nodes.
    fn leaves(&mut self, word: u64, above: &[([i64; 3], u64)]) -> Vec<LeafAt> {
        assert!(self.seen.insert(word, ()).is_none(), "two ways lead to one unit");
        let unit = &self.pages[&(word & 0x1ff_ffff)][(word >> 25) as usize];
        assert_eq!(unit.nodes.len(), above.len(), "nodes of a unit");
        let mut all = Vec::new();
        for ((leaves, link), &(at, bitmap)) in unit.nodes.iter().zip(above) {
            let places: Vec<i64> = (0..64).filter(|place| bitmap >> place & 1 == 1).collect();
            assert_eq!(leaves.len(), places.len(), "leaves of a node");
            for (leaf, place) in leaves.iter().zip(places) {
                let step = [place & 3, place >> 2 & 3, place >> 4];
                all.push(([0, 1, 2].map(|a| 4 * at[a] + step[a]), *leaf, *link));
            }
        }
        all
    }
}

/// Compares one of `every` leaves of the units with the triangles, and all pages with what the store makes of them.
pub(crate) fn check(spec: &str, (built, model): (&Built, &Model<'_>), upper: &Upper, every: i64) {
    let Some((count, section)) = model.lower else { return };
    let material_bytes = if model.material_count <= 256 { 1 } else { 2 };
    let pages: BTreeMap<u64, Vec<Unit>> =
        model.units.iter().map(|(&page, content)| (page, read_units(content, material_bytes))).collect();
    let (refinement, leaf_count, words) = read_links(section, count as usize);
    let unit_count: usize = pages.values().map(Vec::len).sum();
    check_store(spec, built, &pages);
    let mut lower = Lower { pages, seen: BTreeMap::new() };

    // The leaves of each linking node, in the order of its words.
    let (places, bitmaps) = (upper.places(), &upper.streams[1]);
    let mut linking: Vec<Vec<([i64; 3], u64)>> = Vec::new();
    for (leaf, &at) in places.iter().enumerate() {
        let is_first = leaf == 0 || places[leaf - 1].map(|v| v / 4) != at.map(|v| v / 4);
        if is_first {
            linking.push(vec![]);
        }
        linking.last_mut().unwrap().push((at, bitmaps[leaf]));
    }
    assert_eq!(linking.len(), words.len(), "{spec}: a word for each linking node");
    let mut found = 0;
    for (above, word) in linking.iter().zip(words) {
        let leaves = lower.leaves(word, above);
        let middle = Upper { subvoxel_steps: upper.subvoxel_steps / 4, ..upper.clone() };
        check_leaves(spec, model, &middle, (&leaves, every));
        found += leaves.len() as u64;
        assert!(leaves.iter().all(|leaf| leaf.2.is_some() == (refinement == 16)), "{spec}: words of nodes");
        if refinement == 16 {
            let finest = Upper { subvoxel_steps: upper.subvoxel_steps / 16, ..upper.clone() };
            for node in leaves.chunk_by(|a, b| a.2 == b.2) {
                let above: Vec<_> = node.iter().map(|(at, leaf, _)| (*at, leaf[0])).collect();
                let leaves = lower.leaves(node[0].2.unwrap(), &above);
                check_leaves(spec, model, &finest, (&leaves, every));
                found += leaves.len() as u64;
            }
        }
    }
    assert_eq!((found, lower.seen.len()), (leaf_count, unit_count), "{spec}: leaves and units");
}

/// One of `every` of these leaves.
fn check_leaves(spec: &str, model: &Model<'_>, grid: &Upper, (leaves, every): (&[LeafAt], i64)) {
    let is_asked = |at: [i64; 3]| (at[0] * 7919 + at[1] * 104_729 + at[2] * 1_299_709) % every == 0;
    for (at, leaf, _) in leaves.iter().filter(|leaf| is_asked(leaf.0)) {
        check_leaf(&format!("{spec}, leaf {at:?} of a unit"), model, *leaf, &touched_at(model, grid, *at));
    }
}

/// What the store has read of the same pages.
fn check_store(spec: &str, built: &Built, pages: &BTreeMap<u64, Vec<Unit>>) {
    let (mut frame, mut buffers) = (vec![0; FRAME_BYTES], [Vec::new(), Vec::new()]);
    for (&page, units) in pages {
        built.file.read_page(page as u32, &mut frame, &mut buffers).unwrap();
        let view = UnitsView::new(&frame);
        for (number, unit) in units.iter().enumerate() {
            let number = number as u32;
            assert_eq!(view.node_count(number) as usize, unit.nodes.len(), "{spec}: nodes");
            for (rank, (leaves, link)) in unit.nodes.iter().enumerate() {
                let node = view.node(number, rank as u32).unwrap();
                assert_eq!(node.leaf_count() as usize, leaves.len(), "{spec}: leaves of a node");
                let word = node.link.map(|link| u64::from(link.page()) | u64::from(link.unit()) << 25);
                assert_eq!(word, *link, "{spec}: the word of a node");
                for (leaf, at) in leaves.iter().zip(node.first_leaf()..) {
                    assert_eq!(view.bitmap(at), leaf[0], "{spec}: a bitmap");
                    assert_eq!(u64::from(view.leaf(at).material), leaf[2], "{spec}: a material");
                }
            }
            assert!(view.node(number, unit.nodes.len() as u32).is_none());
        }
        assert!(view.node(units.len() as u32, 0).is_none());
    }
}
