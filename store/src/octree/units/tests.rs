//! Frames against what was stored, and what is not a page of units.

use super::*;
use crate::octree::LeafVoxel;
use proptest::prelude::*;

/// Units of these leaf counts per node, every leaf another one.
fn units(shape: &[Vec<u8>], linked: bool) -> Units {
    let mut units = Units::default();
    for nodes in shape {
        units.units.push(nodes.len() as u8);
        units.nodes.extend(nodes);
    }
    let leaves = units.nodes.iter().map(|&count| u64::from(count)).sum::<u64>();
    let turn = |leaf: u64| leaf.wrapping_mul(0x9e37_79b9_7f4a_7c15);
    units.bitmaps.extend((0..leaves).map(|leaf| turn(leaf) | 1));
    units.normals.extend(
        (0..leaves)
            .map(|leaf| LeafNormal::pack(glam::Vec3::new(leaf as f32 - 9.0, 2.0, -1.0).normalize(), 0.1).0),
    );
    units.materials.extend((0..leaves).map(|leaf| (turn(leaf) >> 40) as u16 % 300));
    if linked {
        units.links.extend((0..units.nodes.len()).map(|node| UnitRef::new(node as u32, node % 128).word()));
    }
    units
}

fn context(material_count: usize) -> UnitsContext<'static> {
    UnitsContext { material_count, is_units: &|page| page < 5000 }
}

fn shapes() -> impl Strategy<Value = Vec<Vec<u8>>> {
    proptest::collection::vec(proptest::collection::vec(1u8..=64, 1..=20), 1..=4)
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    /// All that is in the units is found again in the frame.
    #[test]
    fn frames_hold_what_was_stored(shape in shapes(), linked in any::<bool>()) {
        let units = units(&shape, linked);
        let raw = units.encode(2);
        let mut frame = vec![0xaa; FRAME_BYTES];
        install_units(&raw, &context(300), &mut frame).unwrap();
        let view = UnitsView::new(&frame);
        let (mut leaf, mut number) = (0, 0);
        for (unit, nodes) in (0..).zip(&shape) {
            prop_assert_eq!(view.node_count(unit) as usize, nodes.len());
            for (rank, &count) in (0..).zip(nodes) {
                let node = view.node(unit, rank).unwrap();
                prop_assert_eq!((node.first_leaf(), node.leaf_count()), (leaf, u32::from(count)));
                prop_assert_eq!(node.link.map(UnitRef::word), units.links.get(number).copied());
                // The upper bits of a word, as many as there are leaves.
                let mask = !0u64 << (64 - u32::from(count));
                prop_assert_eq!(node.leaf(mask, 63), Some(leaf + u32::from(count) - 1));
                prop_assert_eq!(node.leaf(mask.reverse_bits(), 0), Some(leaf));
                prop_assert_eq!(node.leaf(mask << 1, 63), None);
                for _ in 0..count {
                    let (normal, flatness) = LeafNormal(units.normals[leaf as usize]).unpack();
                    let material = units.materials[leaf as usize];
                    prop_assert_eq!(view.bitmap(leaf), units.bitmaps[leaf as usize]);
                    prop_assert_eq!(view.leaf(leaf), LeafVoxel { normal, flatness, material });
                    leaf += 1;
                }
                number += 1;
            }
            prop_assert_eq!(view.node(unit, nodes.len() as u32), None);
        }
        prop_assert_eq!(view.node(shape.len() as u32, 0), None);
        prop_assert_eq!(view.node_count(shape.len() as u32), 0);
    }

    /// Nothing that comes from outside panics.
    #[test]
    fn garbage_is_refused(
        shape in shapes(),
        change in proptest::collection::vec((any::<usize>(), any::<u8>()), 1..6),
        cut in 0usize..100,
    ) {
        let mut raw = units(&shape, true).encode(2);
        for (at, value) in change {
            let length = raw.len();
            raw[at % if at % 2 == 0 { length } else { 80.min(length) }] ^= value;
        }
        raw.truncate(raw.len() - cut.min(raw.len()));
        let mut frame = vec![0; FRAME_BYTES];
        if install_units(&raw, &context(300), &mut frame).is_ok() {
            let view = UnitsView::new(&frame);
            let leaves = (0..128).flat_map(|unit| (0..view.node_count(unit)).map(move |rank| (unit, rank)));
            for (unit, rank) in leaves {
                let node = view.node(unit, rank).unwrap();
                let last = node.first_leaf() + node.leaf_count() - 1;
                prop_assert!(view.bitmap(last) != 0 && view.leaf(last).material < 300);
            }
        }
    }
}

#[test]
fn the_largest_unit_fits_a_frame() {
    let raw = units(&[vec![64; 64]], true).encode(2);
    install_units(&raw, &context(300), &mut vec![0; FRAME_BYTES]).unwrap();
    let two = units(&[vec![64; 64], vec![64; 64]], true).encode(2);
    assert!(install_units(&two, &context(300), &mut vec![0; FRAME_BYTES]).is_err());
}
