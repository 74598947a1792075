//! The disk form against the plain arrays that it was made from: what is encoded is installed, for meshes of any kind,
//! and the same with and without BMI2 and AVX2. `oracle.rs`: what any page holds, read bit by bit. `hostile.rs`: bytes
//! that no encoder wrote.

mod hostile;
mod movers;
mod oracle;
mod unpack;
mod values;

use super::fields::Machine;
use super::install::install_on;
use super::*;
use crate::layout::{CLUSTER_TRIANGLES, CLUSTER_VERTICES, FRAME_BYTES};
use proptest::prelude::*;
use rand_pcg::rand_core::{Rng, SeedableRng};

const LATTICE_BITS: u32 = 40;
/// Bytes of a page of one cluster before it.
const DISK_PAGE_HEAD_BYTES: usize = 25;

/// A cluster whose vertices stand in the order of first use; stops where it is full.
fn cluster(corners: &[[[i64; 3]; 3]], materials: &[u16]) -> ClusterMesh {
    let mut mesh = ClusterMesh::default();
    for (corners, &material) in corners.iter().zip(materials).take(CLUSTER_TRIANGLES) {
        let is_new = |i: usize| !mesh.vertices.contains(&corners[i]) && !corners[..i].contains(&corners[i]);
        if mesh.vertices.len() + (0..3).filter(|&i| is_new(i)).count() > CLUSTER_VERTICES {
            break;
        }
        let triangle = corners.map(|q| {
            mesh.vertices.iter().position(|&v| v == q).unwrap_or_else(|| {
                mesh.vertices.push(q);
                mesh.vertices.len() - 1
            }) as u8
        });
        mesh.triangles.push(triangle);
        mesh.materials.push(material);
    }
    let count = mesh.triangles.len();
    mesh.leaf_sizes = (0..count.div_ceil(8)).map(|leaf| (count - 8 * leaf).min(8) as u8).collect();
    mesh
}

/// The same with leaves of other sizes, as many as there may be at most.
fn with_leaves(mut mesh: ClusterMesh, seed: u64) -> ClusterMesh {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let mut left = mesh.triangles.len();
    mesh.leaf_sizes.clear();
    while left > 0 {
        let leaves_left = 16 - mesh.leaf_sizes.len();
        // What the others could not hold.
        let least = left.saturating_sub(8 * (leaves_left - 1)).max(1);
        let size = (least + rng.next_u64() as usize % (9 - least)).min(left);
        mesh.leaf_sizes.push(size as u8);
        left -= size;
    }
    mesh
}

/// Triangles over a pool of points, in a box of so many bits an axis: many shared corners and edges, folded, doubled,
/// degenerate.
fn tangle(points: usize, box_bits: [u32; 3], seed: u64) -> ClusterMesh {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(seed);
    let mut below = |n: u64| rng.next_u64() % n;
    let base = box_bits.map(|bits| below((1 << 40) - (1 << bits) + 1) as i64);
    let pool: Vec<[i64; 3]> = (0..points)
        .map(|_| std::array::from_fn(|axis| base[axis] + below(1 << box_bits[axis]) as i64))
        .collect();
    let count = 1 + below(128) as usize;
    let corners: Vec<_> =
        (0..count).map(|_| std::array::from_fn(|_| pool[below(points as u64) as usize])).collect();
    let kinds = [1, 2, 4, 5, 16, 17, 60, 60_000][below(8) as usize];
    let materials: Vec<u16> = (0..count).map(|_| below(kinds) as u16).collect();
    cluster(&corners, &materials)
}

/// A bent sheet of `2 n m` triangles.
fn sheet(n: i64, m: i64, scale: i64) -> ClusterMesh {
    let point = |i: i64, j: i64| [i * scale, j * scale + i * i, 5 + (i * j * scale) / 7];
    let mut corners = Vec::new();
    for i in 0..n {
        for j in 0..m {
            let [a, b, c, d] = [point(i, j), point(i + 1, j), point(i + 1, j + 1), point(i, j + 1)];
            corners.extend([[a, b, c], [a, c, d]]);
        }
    }
    let materials = vec![7; corners.len()];
    cluster(&corners, &materials)
}

/// A page whose clusters hang one under each node of a chain, the last node holding the rest.
fn page(clusters: Vec<ClusterMesh>) -> PageContent {
    let count = clusters.len() as u16;
    let mut page = PageContent { clusters, ..PageContent::default() };
    if count < 3 {
        page.roots = (0..count).map(PageRef::Cluster).collect();
        return page;
    }
    page.roots = vec![PageRef::Cluster(0), PageRef::Node(0)];
    page.nodes =
        vec![vec![PageRef::Cluster(1), PageRef::Node(1)], (2..count).map(PageRef::Cluster).collect()];
    page
}

fn installed(page: &PageContent) -> Vec<u8> {
    let (packed, spent) = page.encode();
    let bits = spent.tree + spent.heads + spent.topology + spent.vertices;
    assert_eq!(bits, 8 * packed.len() as u64, "bits that nothing is spent on");
    let frame = install_twice(&packed).unwrap();
    assert_eq!(FrameView::new(&frame).used_bytes(), page.frame_bytes());
    frame
}

/// Installs with the best that this machine has and without, in frames that held different bytes before, and compares
/// with the oracle.
#[track_caller]
fn install_twice(packed: &[u8]) -> Result<Vec<u8>, &'static str> {
    let (mut frame, mut twin) = (vec![0xa5; FRAME_BYTES], vec![0x5a; FRAME_BYTES]);
    let result = install(packed, LATTICE_BITS, &mut frame);
    assert_eq!(result, install_on(Machine::Portable, packed, LATTICE_BITS, &mut twin));
    result?;
    let used = FrameView::new(&frame).used_bytes();
    assert!(frame[..used] == twin[..used], "two installs of the same bytes differ");
    let mut found = Vec::new();
    FrameView::new(&frame).for_each_cluster(|cluster| found.push(cluster.decode()));
    assert!(found == oracle::clusters(packed), "the frame holds other clusters than the page");
    Ok(frame)
}

#[track_caller]
fn check(clusters: Vec<ClusterMesh>) {
    let page = page(clusters);
    let frame = installed(&page);
    let mut found = Vec::new();
    FrameView::new(&frame).for_each_cluster(|cluster| {
        found.push(cluster.decode());
        check_boxes(&cluster);
    });
    assert_eq!(found, page.clusters);
}

/// Boxes of leaves and of the cluster hold their triangles, as tight as eight bits allow.
#[track_caller]
fn check_boxes(cluster: &ClusterView<'_>) {
    let (mesh, planes) = (cluster.decode(), cluster.leaf_planes());
    let leaves = mesh.leaf_sizes.iter().enumerate();
    let with = leaves.flat_map(|(leaf, &size)| std::iter::repeat_n(leaf, usize::from(size)));
    assert!((0..mesh.triangles.len()).map(|index| cluster.leaf_with(index)).eq(with));
    let (base, shift) = (cluster.base(), cluster.leaf_shift());
    let mut first = 0;
    for (leaf, triangles) in mesh.leaves().enumerate() {
        assert_eq!((cluster.leaf_first(leaf), cluster.leaf_corners(leaf)[0][0]), (first, triangles[0][0]));
        for (place, corners) in triangles.iter().enumerate() {
            let expected = corners.map(|v| mesh.vertices[usize::from(v)]);
            assert_eq!(cluster.triangle(leaf, place), expected);
        }
        first += triangles.len();
        let corners = triangles.as_flattened().iter().map(|&v| mesh.vertices[usize::from(v)]);
        let exact = corners.fold(LatticeBox::EMPTY, |mut all, q| {
            all.add(q);
            all
        });
        for axis in 0..3 {
            assert_eq!(i64::from(planes[axis][leaf]), (exact.lo[axis] - base[axis]) >> shift[axis]);
            assert_eq!(i64::from(planes[3 + axis][leaf]), (exact.hi[axis] - base[axis]) >> shift[axis]);
        }
    }
}

#[test]
fn sheets_survive_in_a_few_bits_a_triangle() {
    let sheets = vec![sheet(8, 8, 100), sheet(1, 1, 1), sheet(2, 9, 3), sheet(1, 30, 50_000)];
    check(sheets);
    let ordered = Orderer::default().ordered(&sheet(8, 8, 100)).mesh;
    let (_, spent) = page(vec![ordered]).encode();
    assert!(spent.topology <= 128 * 6 && spent.vertices <= 81 * 20, "{spent:?}");
}

#[test]
fn nodes_hold_what_is_below_them() {
    let clusters: Vec<_> = (0..9).map(|i| tangle(40, [18; 3], i)).collect();
    let page = page(clusters);
    let frame = installed(&page);
    let view = FrameView::new(&frame);
    assert_eq!(view.root_count(), 2);
    assert!(view.root(0).is_cluster());
    let top = view.node(view.root(1));
    let below = view.node(FrameRef(top.word(1)));
    assert_eq!((top.boxes.child_count, below.boxes.child_count), (2, 7));
    for (i, cluster) in page.clusters.iter().enumerate().skip(2) {
        let shift = crate::layout::node_shift(LATTICE_BITS);
        for holder in [top.boxes.child_box(1, shift), below.boxes.child_box(i - 2, shift)] {
            assert_eq!(holder.join(&cluster.bounds()), holder, "cluster {i}");
        }
    }
}

/// The box of a cluster below a node: it begins where its vertices do, to the units of nodes, and ends at most a 64th
/// of its side behind them.
#[test]
fn boxes_of_clusters_are_tight() {
    let shift = crate::layout::node_shift(LATTICE_BITS);
    for (bits, seed) in [([18; 3], 1), ([24, 3, 20], 2), ([0, 17, 18], 3), ([25, 24, 25], 4)] {
        let cluster = tangle(50, bits, seed);
        let (roots, nodes) = (vec![PageRef::Node(0)], vec![vec![PageRef::Cluster(0)]]);
        let exact = cluster.bounds();
        let frame = installed(&PageContent { roots, nodes, clusters: vec![cluster] });
        let view = FrameView::new(&frame);
        let up = |q: i64| -(-q >> shift) << shift;
        let found = view.node(view.root(0)).boxes.child_box(0, shift);
        assert_eq!(found.lo, exact.lo.map(|q| q >> shift << shift), "{bits:?}");
        for axis in 0..3 {
            let side = exact.hi[axis] - exact.lo[axis];
            let range = up(exact.hi[axis])..=up(exact.hi[axis] + side / 64);
            assert!(range.contains(&found.hi[axis]), "{bits:?}: {found:?}, {exact:?}");
        }
    }
}

/// Told in coding order, a cluster keeps its leaves, triangles, orientation and materials.
#[test]
fn order_changes_nothing_but_order() {
    let canonical = |mesh: &ClusterMesh| {
        let mut leaves: Vec<Vec<_>> = Vec::new();
        let mut materials = mesh.materials.iter();
        for leaf in mesh.leaves() {
            let materials = materials.by_ref().take(leaf.len());
            let placed = leaf.iter().map(|t| t.map(|v| mesh.vertices[usize::from(v)]));
            let turned = placed.map(|[a, b, c]| [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap());
            let mut leaf: Vec<_> = turned.zip(materials.copied()).collect();
            leaf.sort_unstable();
            leaves.push(leaf);
        }
        leaves.sort_unstable();
        leaves
    };
    let mut orderer = Orderer::default();
    for seed in 0..200 {
        let mut mesh = tangle(3 + seed as usize % 120, [12; 3], seed);
        if seed % 3 == 0 {
            mesh = sheet(1 + seed as i64 % 7, 1 + seed as i64 % 9, 10);
        }
        if seed % 2 == 0 {
            mesh = with_leaves(mesh, seed);
        }
        let ordered = orderer.ordered(&mesh);
        let (disk, _) = page(vec![ordered.mesh.clone()]).encode();
        assert!(
            disk.len() <= DISK_PAGE_HEAD_BYTES + ordered.page_bytes(),
            "seed {seed}: {} bytes",
            disk.len()
        );
        let ordered = ordered.mesh;
        assert_eq!(canonical(&mesh), canonical(&ordered), "seed {seed}");
        assert_eq!(ordered, orderer.ordered(&mesh).mesh, "seed {seed}: another order the second time");
        check(vec![ordered]);
    }
}

/// Each shape at a bound of the codec, alone and behind others.
#[test]
fn shapes_at_the_bounds_survive() {
    let line = |n: i64| [n * n % 97, n * 3, n];
    let of = |triangles: Vec<[[i64; 3]; 3]>| cluster(&triangles, &vec![3; triangles.len()]);
    let strip = (0..126).map(|n| [line(n), line(n + 1), line(n + 2)]);
    let full = of(strip.chain([[line(0), line(127), line(64)], [line(9), line(64), line(0)]]).collect());
    assert_eq!((full.triangles.len(), full.vertices.len()), (128, 128));
    let apart = of((0..42).map(|n| [line(3 * n), line(3 * n + 1), line(3 * n + 2)]).collect());
    assert_eq!((apart.triangles.len(), apart.vertices.len()), (42, 126));
    // As wide as a compact cluster may be, and one step more; the whole lattice.
    let span = |side: [i64; 3]| of(vec![[[5; 3], [5 + side[0], 5, 5 + side[2]], [5, 5 + side[1], 6]]; 2]);
    let compact = span([(1 << 24) - 1, (1 << 24) - 1, (1 << 9) - 1]);
    let wide = span([(1 << 24) - 1, (1 << 24) - 1, 1 << 9]);
    assert_eq!((compact.widths().wide, wide.widths().wide), (false, true));
    let end = (1 << LATTICE_BITS) - 1;
    let shapes = [
        of(vec![[line(0), line(1), line(2)]]),
        full,
        apart,
        compact,
        wide,
        span([1 << 24, 1, 1]),
        of(vec![[[0; 3], [end; 3], [0, end, 0]]]),
        of(vec![[[end; 3], [end - 1, end, end], [end, end - 9, end]]]),
        // No axis has any extent; two corners are one; all three are.
        of(vec![[[7; 3]; 3]]),
        of(vec![[line(1), line(1), line(2)], [line(1), line(2), line(1)], [line(2), line(1), line(1)]]),
        // An edge with 100 triangles, of both orientations; one triangle 128 times; a vertex with 60 fans.
        of((2..102).map(|n| [line(n % 2), line(1 - n % 2), line(n)]).collect()),
        of(vec![[line(4), line(5), line(6)]; 128]),
        of((0..60).map(|n| [line(0), line(2 * n + 1), line(2 * n + 2)]).collect()),
    ];
    shapes.iter().for_each(|shape| check(vec![shape.clone()]));
    shapes.chunks(8).for_each(|some| check(some.to_vec()));
}

#[test]
fn palettes_of_all_lengths_survive() {
    let corners = vec![[[0; 3], [9, 0, 4], [0, 7, 2]]; 128];
    for len in [1, 2, 3, 4, 5, 15, 16, 17, 127, 128u16] {
        // Up to the last material, and in an order that is not the palette's.
        let materials: Vec<u16> = (0..128).map(|i| u16::MAX - (i * 7 % len) * 512).collect();
        let mesh = cluster(&corners, &materials);
        assert_eq!(mesh.palette().len(), usize::from(len));
        check(vec![mesh, cluster(&corners[..1], &[0])]);
    }
}

/// A quad that was packed with pencil and paper from `docs/format.md`: the bytes of version 3 stay what they are.
#[test]
fn the_bytes_of_a_tiny_page_are_these() {
    let [a, b, c, d] = [[100, 200, 300], [108, 200, 300], [100, 206, 300], [109, 207, 301]];
    let page = page(vec![cluster(&[[a, b, c], [c, b, d]], &[5, 2])]);
    let (packed, spent) = page.encode();
    assert_eq!(
        packed,
        [
            1, 0, 0, 0, 1, 0, 0, 0,
            3, // One cluster, no node, one root; no offsets; materials of three bits.
            100, 0, 0, 0, 0, 200, 0, 0, 0, 0, 44, 1, 0, 0, 0, // The anchor.
            4, // Bytes of a cluster in four bits.
            0, // The root is a cluster.
            0x01, 0x62, 0x08, 0x82, 0x01, 0x50, // Its entry: ten bytes.
            0x03, 0x01, 0x20, 0x02, 0x6a, 0xc4, 0x79, 0x11, 0xc0, 0x1e,
        ]
    );
    assert_eq!(spent, DiskBits { tree: 8, heads: 25 * 8 + 48 + 42, topology: 7, vertices: 31 });
    check(page.clusters);
}

/// Bits of the axes of a box: mostly such that a cluster is compact.
fn any_box_bits() -> impl Strategy<Value = [u32; 3]> {
    prop_oneof![
        3 => prop::array::uniform3(0u32..=19),
        1 => (0u32..=24, 0u32..=9, 0u32..=24).prop_map(|(x, y, z)| [x, y, z]),
        1 => prop::array::uniform3(0u32..=40),
    ]
}

proptest! {
    #[test]
    fn what_is_encoded_is_installed(
        seeds in prop::collection::vec((any::<u64>(), 1usize..200, any_box_bits()), 1..6),
    ) {
        check(seeds.iter().map(|&(seed, points, bits)| tangle(points, bits, seed)).collect());
        check(seeds.iter().map(|&(seed, points, bits)| with_leaves(tangle(points, bits, seed), seed)).collect());
    }

    /// Bits of a cluster turn, and it is installed behind another one than before: that does not show in it.
    #[test]
    fn a_cluster_shows_nothing_of_those_before_it(
        scale in 3i64..90_000,
        turned in prop::collection::vec(0usize..400, 1..4),
    ) {
        let first = sheet(8, 8, 100);
        let corners = first.triangles.iter().map(|t| t.map(|v| first.vertices[usize::from(v)]));
        // The same triangles the other way round: the same box, so that heads agree.
        let other: Vec<_> = corners.rev().map(|[a, b, c]| [c, a, b]).collect();
        let other = cluster(&other, &first.materials);
        let lasts = [first, other].map(|first| {
            let (mut packed, _) = page(vec![first, sheet(5, 9, scale)]).encode();
            let end = 8 * packed.len() - 1;
            turned.iter().map(|back| end - back).for_each(|at| packed[at / 8] ^= 1 << (at % 8));
            let frame = install_twice(&packed)?;
            let mut last = Vec::new();
            FrameView::new(&frame).for_each_cluster(|cluster| {
                last = cluster.bytes()[..cluster.frame_bytes()].to_vec();
            });
            Ok::<_, &str>(last)
        });
        prop_assert_eq!(&lasts[0], &lasts[1]);
    }
}
