//! Colours and normals come back as they were; what no encoder wrote is refused or read.

use super::super::corner_value::{Colour, CornerValue, WHITE};
use super::super::normal::Normal;
use super::super::value_codec::{ValueView, install_values};
use super::super::value_packer::{ValuePacker, ValuePage};
use super::ClusterMesh;
use crate::layout::FRAME_BYTES;
use proptest::prelude::*;

/// Clusters of strips, whose corners have the colours that `colour` gives for triangle and vertex, and normals of the
/// same bytes.
fn clusters(sizes: &[usize], colour: impl Fn(usize, usize) -> Colour) -> Vec<ClusterMesh> {
    let mut first = 0;
    let mut cluster = |&size: &usize| {
        let triangles: Vec<[u8; 3]> = (0..size as u8).map(|t| [t, t + 1, t + 2]).collect();
        let corners = |t: usize| [t, t + 1, t + 2].map(|v| colour(first + t, first + v));
        let colours: Vec<[Colour; 3]> = (0..size).map(corners).collect();
        let normals = colours.iter().map(|corners| corners.map(Normal::from_bytes)).collect();
        first += size + 2;
        ClusterMesh {
            vertices: vec![[0; 3]; size + 2],
            triangles,
            colours,
            normals,
            ..ClusterMesh::default()
        }
    };
    sizes.iter().map(&mut cluster).collect()
}

/// The values of a kind in a cluster.
trait InCluster: CornerValue + std::fmt::Debug {
    fn of(cluster: &ClusterMesh) -> &[[Self; 3]];
}

impl InCluster for Colour {
    fn of(cluster: &ClusterMesh) -> &[[Colour; 3]] {
        &cluster.colours
    }
}

impl InCluster for Normal {
    fn of(cluster: &ClusterMesh) -> &[[Normal; 3]] {
        &cluster.normals
    }
}

fn encode_values<V: InCluster>(clusters: &[ClusterMesh]) -> Vec<ValuePage> {
    let mut packer = ValuePacker::<V>::default();
    packer.add(clusters, V::of);
    packer.finish().pages
}

/// Encodes and decodes; every corner must be there. Bytes of the colours on disk.
#[track_caller]
fn check(clusters: &[ClusterMesh]) -> usize {
    check_values::<Normal>(clusters);
    check_values::<Colour>(clusters)
}

#[track_caller]
fn check_values<V: InCluster>(clusters: &[ClusterMesh]) -> usize {
    let pages = encode_values::<V>(clusters);
    let frames: Vec<_> = pages
        .iter()
        .map(|page| {
            let mut frame = vec![0xaa; FRAME_BYTES];
            install_values::<V>(&page.bytes, &mut frame).unwrap();
            (page.first_triangle as usize, frame)
        })
        .collect();
    let mut triangle = 0;
    for cluster in clusters {
        for (vertices, expected) in cluster.triangles.iter().zip(V::of(cluster)) {
            let at = frames.partition_point(|(first, _)| *first <= triangle);
            let found = match at.checked_sub(1) {
                Some(at) => {
                    let (first, frame) = &frames[at];
                    ValueView::new(frame).values(triangle - first, vertices.map(usize::from))
                }
                None => [V::NONE; 3],
            };
            assert_eq!(found, *expected, "triangle {triangle}");
            triangle += 1;
        }
    }
    pages.iter().map(|page| page.bytes.len()).sum()
}

#[test]
fn colours_come_back_by_vertex_face_and_corner() {
    let smooth = |_: usize, v: usize| [100 + (v / 4) as u8 % 50, (v / 3) as u8 % 90, 60];
    let sizes = [126, 100, 1, 126, 60];
    let by_vertex = check(&clusters(&sizes, smooth));
    let by_face = check(&clusters(&sizes, |t, _| [t as u8, 7 * (t % 5) as u8, 200]));
    let by_corner = check(&clusters(&sizes, |t, v| [(t * 31 + v * 17) as u8, (t * 7) as u8, (v * t) as u8]));
    assert!(
        by_vertex < 413 && by_face < 3 * 413 && by_corner < 10 * 413,
        "{by_vertex} {by_face} {by_corner}"
    );
    // An edge of two colours is a handful of exceptions.
    let edge = |t: usize, v: usize| if t < 40 { smooth(t, v) } else { [9, 9, 9] };
    let with_edge = check(&clusters(&[126], edge));
    assert!(with_edge < 126, "{with_edge}");
}

#[test]
fn white_takes_nothing_and_much_takes_several_pages() {
    let white = clusters(&[126; 9], |_, _| WHITE);
    assert!(encode_values::<Colour>(&white).is_empty() && encode_values::<Normal>(&white).is_empty());
    let mut none = clusters(&[5], |_, _| WHITE);
    none[0].colours.clear();
    assert!(encode_values::<Colour>(&none).is_empty());
    let many = clusters(&[126; 150], |t, v| [(t * 31 + v * 17) as u8, (t * 7) as u8, (v * t) as u8]);
    assert!(encode_values::<Colour>(&many).len() > 2);
    check(&many);
    // Half of it has no colour.
    check(&clusters(&[126; 20], |t, v| if t < 1000 { WHITE } else { [v as u8, 1, 2] }));
}

/// Mesh pages share pages of colours: each is told the one that has its first triangle; a white one has none, and none
/// goes on behind it. A page is of so few triangles that their numbers have 16 bits.
#[test]
fn mesh_pages_share_pages_of_colours() {
    let page = |colour: Colour| clusters(&[126; 50], |_, v| if v % 9 == 0 { [v as u8; 3] } else { colour });
    let coloured = page([1, 2, 3]);
    let white = clusters(&[126; 50], |_, _| WHITE);
    let mut packer = ValuePacker::<Colour>::default();
    let in_order = [&coloured, &coloured, &white, &coloured, &coloured];
    in_order.iter().for_each(|page| packer.add(page, Colour::of));
    let packed = packer.finish();
    assert_eq!(packed.first_pages, [Some(0), Some(0), None, Some(1), Some(1)]);
    let firsts: Vec<u32> = packed.pages.iter().map(|page| page.first_triangle).collect();
    assert_eq!(firsts, [0, 3 * 6300]);
    let mut frame = vec![0xaa; FRAME_BYTES];
    install_values::<Colour>(&packed.pages[1].bytes, &mut frame).unwrap();
    for (page, first) in [(3, 0), (4, 6300)] {
        let of_page = in_order[page].iter().flat_map(|c| c.triangles.iter().zip(&c.colours));
        for (triangle, (vertices, expected)) in of_page.enumerate() {
            let found = ValueView::<Colour>::new(&frame).values(first + triangle, vertices.map(usize::from));
            assert_eq!(found, *expected, "{page} {triangle}");
        }
    }
    // Faces of one colour take next to no bits, but 65,535 triangles are most.
    let mut packer = ValuePacker::<Colour>::default();
    (0..12).for_each(|_| packer.add(&clusters(&[126; 50], |_, _| [7; 3]), Colour::of));
    let packed = packer.finish();
    for pages in packed.pages.windows(2) {
        assert!(pages[1].first_triangle - pages[0].first_triangle <= 65_535);
    }
    assert!(packed.pages.len() > 1 && packed.first_pages.iter().all(Option::is_some));
}

/// Bytes of the normals of a sheet in strips of 126 triangles, a triangle: `normal` of the place of a vertex, in steps.
fn normal_bytes(normal: impl Fn(f64, f64) -> [f64; 3]) -> f64 {
    let (rows, columns) = (40, 60);
    let cluster = |row: usize| {
        // Two rows of vertices, taken in turn.
        let triangles: Vec<[u8; 3]> = (0..2 * columns as u8).map(|t| [t, t + 1, t + 2]).collect();
        let at = |vertex: u8| normal(f64::from(vertex / 2), (row + usize::from(vertex % 2)) as f64);
        let normals = triangles.iter().map(|t| t.map(|v| Normal::from_vector(at(v)))).collect();
        ClusterMesh { vertices: vec![[0; 3]; 2 * columns + 2], triangles, normals, ..ClusterMesh::default() }
    };
    let clusters: Vec<ClusterMesh> = (0..rows).map(cluster).collect();
    check_values::<Normal>(&clusters) as f64 / (2 * rows * columns) as f64
}

/// Long strips have a vertex a triangle: twice as many as the clusters of a sheet.
#[test]
fn normals_of_smooth_surfaces_take_about_a_byte_a_vertex() {
    let waves = |frequency: f64| move |x: f64, y: f64| [(frequency * x).cos(), (frequency * y).sin(), 2.0];
    let [flat, slow, fast] = [0.0, 0.02, 0.2].map(|frequency| normal_bytes(waves(frequency)));
    assert!(flat < 0.35 && slow < 0.9 && fast < 1.75, "{flat} {slow} {fast}");
}

proptest! {
    #[test]
    fn any_colours_come_back(
        sizes in proptest::collection::vec(1usize..=126, 1..8), seed in any::<u32>(), mask in any::<u8>(),
    ) {
        let any = |x: usize| (x as u32 ^ seed).wrapping_mul(0x9e37_79b9).to_le_bytes().map(|v| v | mask);
        check(&clusters(&sizes, |t, v| {
            let [r, g, b, which] = any(if seed % 3 == 0 { t } else { v });
            if which % 16 == 0 { [r, b, g] } else { [r, g, b] }
        }));
        check(&clusters(&sizes, |t, v| {
            let [r, g, b, _] = any(t * 1000 + v);
            [r, g, b]
        }));
    }

    /// What is accepted is read without a panic, whatever is asked.
    #[test]
    fn garbage_is_refused_or_read(
        bytes in proptest::collection::vec(any::<u8>(), 0..400), sparse in any::<bool>(),
        triangle in 0usize..70_000, vertices in prop::array::uniform3(0usize..200),
    ) {
        let mut bytes = bytes;
        if sparse {
            bytes.iter_mut().skip(2).for_each(|byte| *byte &= 0x11);
            bytes.iter_mut().skip(1).take(1).for_each(|byte| *byte = 0);
        }
        if let Some(count) = bytes.get_mut(0) {
            *count %= 4;
        }
        let mut frame = vec![0xaa; FRAME_BYTES];
        if install_values::<Colour>(&bytes, &mut frame).is_ok() {
            ValueView::<Colour>::new(&frame).values(triangle, vertices);
        }
        if install_values::<Normal>(&bytes, &mut frame).is_ok() {
            let _ = ValueView::<Normal>::new(&frame).values(triangle, vertices).map(Normal::vector);
        }
    }
}
