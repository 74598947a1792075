//! Bytes that no encoder wrote: refused, or a frame that can be traced as any other.

use super::*;

/// The head of a page with one cluster, up to its entry: anchor at 100, 200, 300, materials of three bits, bytes of
/// eight.
const HEAD: [u8; 26] = [1, 0, 0, 0, 1, 0, 0, 0, 3, 100, 0, 0, 0, 0, 200, 0, 0, 0, 0, 44, 1, 0, 0, 0, 8, 0];

/// The quad of `the_bytes_of_a_tiny_page_are_these`, field by field: value and bits.
const QUAD: [(u64, u32); 36] = [
    // Triangles and vertices, less one; wide; palette; leaves differ; axis widths; class widths.
    (1, 7),
    (3, 7),
    (0, 1),
    (1, 1),
    (0, 1),
    (4, 6),
    (3, 6),
    (1, 6),
    (0, 5),
    (0, 5),
    (2, 5),
    // Materials, less one; these; the triangles' indices.
    (1, 7),
    (2, 3),
    (5, 3),
    (1, 2),
    (0, 2),
    // A strip of two: triangles - 1, a turn, both new; it is free, a new in no bits and b in one.
    (1, 3),
    (0, 1),
    (0b11, 2),
    (1, 1),
    // Tags; values.
    (0, 2),
    (3, 2),
    (3, 2),
    (2, 2),
    (8, 4),
    (0, 3),
    (0, 1),
    (0, 4),
    (6, 3),
    (0, 1),
    (3, 2),
    (3, 2),
    (0, 1),
    // Extents: of 9 in four bits, 7 in three, 1 in one.
    (1, 6),
    (3, 6),
    (0, 6),
];
/// The fields of its entry, before its bytes, and those of its bits.
const ENTRY: [usize; 7] = [0, 5, 6, 7, 33, 34, 35];
const BITS: [usize; 29] = [
    1, 2, 3, 4, 8, 9, 10, 11, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27, 28, 29, 30, 31,
    32,
];

/// A page of `head` and the quad with some fields replaced, and bytes behind it.
fn lie(head: &[u8], fields: &[(usize, (u64, u32))], behind: &[u8]) -> Vec<u8> {
    let mut quad = QUAD;
    fields.iter().for_each(|&(index, field)| quad[index] = field);
    let bytes = |fields: &[(u64, u32)]| -> Vec<u8> {
        let bits = fields.iter().flat_map(|&(value, width)| (0..width).map(move |i| (value >> i) as u8 & 1));
        let bits: Vec<u8> = bits.collect();
        bits.chunks(8).map(|eight| eight.iter().rev().fold(0, |byte, bit| byte << 1 | bit)).collect()
    };
    let cluster = bytes(&BITS.map(|at| quad[at]));
    let size = (cluster.len() as u64, 8);
    let entry = bytes(&[&ENTRY.map(|at| quad[at])[..], &[size]].concat());
    [head, &entry, &cluster, behind].concat()
}

/// HEAD with some bytes replaced.
fn head(bytes: &[(usize, u8)]) -> Vec<u8> {
    let mut head = HEAD;
    bytes.iter().for_each(|&(at, byte)| head[at] = byte);
    head.to_vec()
}

#[track_caller]
fn refused(packed: &[u8], why: &str) {
    assert_eq!(install_twice(packed).expect_err(why), why);
}

/// The quad as two strips of one triangle, of which these are the fields of the second.
fn two_strips(second: &[(u64, u32)]) -> [(usize, (u64, u32)); 4] {
    let (bits, width) =
        second.iter().fold((0, 0), |(bits, at), (value, width)| (bits | value << at, at + width));
    // The first: one triangle, new, free, from a new vertex to a new one.
    [(16, (0b11000, 5)), (17, (bits, width)), (18, (0, 0)), (19, (0, 0))]
}

#[test]
fn the_quad_that_is_lied_about_is_sound() {
    install_twice(&lie(&HEAD, &[], &[])).unwrap();
    // The second on gate 1: from a to c.
    install_twice(&lie(&HEAD, &two_strips(&[(0, 3), (1, 1), (1, 2)]), &[])).unwrap();
}

#[test]
fn clusters_that_lie_are_refused() {
    let range = "a cluster is out of range";
    for fields in [
        // Compact axes of 25 bits, 58 in all; wide ones of 41; a third material for two triangles.
        &[(5, (25, 6))][..],
        &[(5, (24, 6)), (6, (24, 6)), (7, (10, 6))],
        &[(2, (1, 1)), (5, (41, 6))],
        &[(11, (2, 7))],
    ] {
        refused(&lie(&HEAD, fields, &[]), range);
    }
    refused(&lie(&HEAD, &[(14, (2, 2))], &[]), "a material index lies behind its palette");
    let triangles = "the triangles of a cluster are not what its counts say";
    for fields in [
        // One vertex less than the triangles need, and one more.
        &[(1, (2, 7))][..],
        &[(1, (4, 7))],
        // A strip of three triangles; a strip of one, and a second one that lies.
        &[(16, (2, 3))],
        &two_strips(&[(0, 3), (1, 1), (3, 2)]), // On gate 3 of 2.
        &two_strips(&[(0, 3), (1, 1), (2, 2), (3, 2), (5, 3)]), // Free, from vertex 3 to vertex 5 of 4.
        &[&[(1, (2, 7))], &two_strips(&[(0, 3), (0, 1), (0, 2), (3, 2)])[..]].concat(), // Vertex 3 of 3 by name.
    ] {
        refused(&lie(&HEAD, fields, &[]), triangles);
    }
    // A leaf of two and one of one, and one of three, for two triangles; one for each.
    let leaves = "the leaves of a cluster are not what its counts say";
    refused(&lie(&HEAD, &[(4, (1 | (1 << 1) | (1 << 5), 11))], &[]), leaves);
    refused(&lie(&HEAD, &[(4, (1 | (2 << 5), 8))], &[]), leaves);
    install_twice(&lie(&HEAD, &[(4, (1 | (1 << 1), 11))], &[])).unwrap();
    let left_over = "the bits of a cluster are more or fewer than its counts say";
    // A plain vertex where there is no room for one.
    refused(&lie(&HEAD, &[(20, (3, 2))], &[]), left_over);
    // The last vertex plain, and then a bit that is set.
    let plain = |last| lie(&HEAD, &[(23, (3, 2)), (30, (9, 4)), (31, (7, 3)), (32, last)], &[]);
    install_twice(&plain((0b1, 1))).unwrap();
    refused(&plain((0b11, 2)), left_over);
}

#[test]
fn heads_that_lie_are_refused() {
    let counts = "the counts of a page are out of range";
    for bytes in [(0, 0), (4, 0), (4, 65)] {
        refused(&lie(&head(&[bytes]), &[], &[]), counts);
    }
    let widths = "a width of a page is out of range";
    for bytes in [(5, 41), (6, 255), (7, 41), (8, 17), (24, 17)] {
        refused(&lie(&head(&[bytes]), &[], &[]), widths);
    }
    for bytes in [(1, 16), (3, 3)] {
        refused(&lie(&head(&[bytes]), &[], &[]), "a page ends early");
    }
    refused(&lie(&head(&[(25, 2)]), &[], &[]), "bits are left over in the head of a page");
    refused(&lie(&head(&[(25, 1)]), &[], &[]), "a page has fewer nodes than its tree");
    refused(&lie(&head(&[(4, 2)]), &[], &[]), "a page has fewer clusters than its tree");
    refused(&lie(&HEAD, &[], &[0]), "the clusters of a page are more or fewer than its head says");
    // Bytes of the cluster in nine bits, of which the last is no zero; an extent that its axis has no bits for.
    let nine = |last: u8| {
        let mut page = lie(&head(&[(24, 9)]), &[], &[]);
        page[32] |= last << 3;
        page
    };
    install_twice(&nine(0)).unwrap();
    refused(&nine(1), "the clusters of a page are more or fewer than its head says");
    refused(&nine(2), "bits are left over in the head of a page");
    refused(&lie(&HEAD, &[(33, (8, 6))], &[]), "a cluster is out of range");
    refused(&lie(&HEAD, &[(33, (0, 6))], &[]), "a cluster is larger than its box");
}

/// A page of one root, a node, over `nodes` and one cluster.
fn with_nodes(nodes: &[[u8; 2]]) -> Vec<u8> {
    let mut head = head(&[(2, nodes.len() as u8), (3, (nodes.len() >> 8) as u8), (25, 1)]);
    head.extend(nodes.as_flattened());
    lie(&head, &[], &[])
}

#[test]
fn trees_that_lie_are_refused() {
    install_twice(&with_nodes(&[[1, 0]])).unwrap();
    for node in [[0, 0], [9, 0], [1, 2], [7, 0x80]] {
        refused(&with_nodes(&[node]), "a node is out of range");
    }
    refused(&with_nodes(&[[1, 1]]), "a page has fewer nodes than its tree");
    refused(&with_nodes(&[[2, 0]]), "a page has fewer clusters than its tree");
    refused(&with_nodes(&[[1, 0], [1, 0]]), "nothing leads to a part of the page");
    let chain = |depth: usize| [vec![[1, 1]; depth - 1], vec![[1, 0]]].concat();
    let deepest = crate::layout::TREE_DEPTH;
    install_twice(&with_nodes(&chain(deepest))).unwrap();
    refused(&with_nodes(&chain(deepest + 1)), "the tree of a page is too deep");
    refused(&with_nodes(&[[1, 0]; 500]), "a page does not fit its frame");
}

#[test]
fn vertices_behind_the_lattice_are_refused() {
    // The quad is one step high in z. Compact, then wide, where a vertex takes eight bits without tags.
    let wide: Vec<_> = [(2, (1, 1))]
        .into_iter()
        .chain((8..11).chain(20..33).map(|i| (i, (0, 0))))
        .chain([(24, (8, 8)), (25, (0, 8)), (26, (0, 8)), (27, (0x80, 8))])
        .collect();
    let at = |z: u64| {
        let z = z.to_le_bytes();
        head(&std::array::from_fn::<_, 5, _>(|i| (19 + i, z[i])))
    };
    let end = 1 << LATTICE_BITS;
    for fields in [&[][..], &wide] {
        install_twice(&lie(&at(end - 2), fields, &[])).unwrap();
        refused(&lie(&at(end - 1), fields, &[]), "a vertex lies behind the lattice");
        let mut frame = vec![0; FRAME_BYTES];
        let narrow = |bits| install(&lie(&HEAD, fields, &[]), bits, &mut frame);
        assert_eq!([9, 8].map(narrow), [Ok(()), Err("a cluster is out of range")]);
    }
}

#[test]
fn a_page_that_is_cut_or_grows_is_refused() {
    let clusters = (0..8).map(|i| tangle(20, [10, 3, 14 + 3 * i as u32], i)).collect();
    let (packed, _) = page(clusters).encode();
    for length in 0..packed.len() {
        assert!(install_twice(&packed[..length]).is_err(), "{length} of {} bytes", packed.len());
    }
    for byte in [0, 1, 0xff] {
        assert!(install_twice(&[&packed[..], &[byte]].concat()).is_err());
    }
}

proptest! {
    /// Any bits at all: refused, or a frame whose corners, boxes and references are sound.
    #[test]
    fn garbage_is_refused_or_harmless(
        seed in any::<u64>(),
        flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
        keep in 0.9f64..1.1,
    ) {
        let clusters = (0..6).map(|i| match i % 3 {
            0 => sheet(7, 8, 90 + i),
            _ => tangle(60, [14 + 20 * (i as u32 % 2); 3], seed ^ i as u64),
        });
        let (mut packed, _) = page(clusters.collect()).encode();
        for (at, byte) in flips {
            let at = at.index(packed.len());
            packed[at] = byte;
        }
        packed.resize((packed.len() as f64 * keep) as usize, 0x77);
        walk_if_installed(&packed);
    }

    /// One flipped bit of one cluster: most of these are believed, so this is where boxes and corners are tried.
    #[test]
    fn a_flipped_bit_is_refused_or_harmless(
        seed in any::<u64>(),
        bits in any_box_bits(),
        at in any::<prop::sample::Index>(),
    ) {
        let (mut packed, _) = page(vec![tangle(50, bits, seed)]).encode();
        let at = at.index(8 * packed.len());
        packed[at / 8] ^= 1 << (at % 8);
        walk_if_installed(&packed);
    }

    #[test]
    fn noise_is_refused_or_harmless(noise in prop::collection::vec(any::<u8>(), 0..3000)) {
        walk_if_installed(&noise);
        walk_if_installed(&[&HEAD[..], &noise].concat());
    }
}

fn walk_if_installed(packed: &[u8]) {
    let Ok(frame) = install_twice(packed) else { return };
    let view = FrameView::new(&frame);
    let mut clusters = 0;
    view.for_each_cluster(|cluster| {
        clusters += 1;
        let mesh = cluster.decode();
        assert!(mesh.triangles.as_flattened().iter().all(|&v| usize::from(v) < mesh.vertices.len()));
        assert!(mesh.vertices.as_flattened().iter().all(|&q| q >> LATTICE_BITS == 0));
        check_boxes(&cluster);
    });
    let (mut met, mut nodes) = (0, 0);
    let mut stack: Vec<FrameRef> = (0..view.root_count()).map(|slot| view.root(slot)).collect();
    while let Some(at) = stack.pop() {
        if at.is_cluster() {
            met += 1;
            continue;
        }
        nodes += 1;
        assert!(nodes <= FRAME_BYTES / Node::BYTES, "a walk goes in circles");
        let node = view.node(at);
        stack.extend(node.words().map(FrameRef));
    }
    assert_eq!(met, clusters, "a walk meets each cluster once");
}
