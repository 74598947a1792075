//! What a worker takes for a full chunk, by the allocator's count, against what is leased for it.

use super::super::clusters::packed_page::PackContext;
use super::super::clusters::workspace::{Workspace, worker_bytes};
use super::super::partition::chunk::{CHUNK_TRIANGLES, Chunk, Piece};
use super::super::scratch::{Encoder, LatticeTriangle, RUN_TRIANGLES, Scratch, TriangleList};
use super::*;
use crate::attributes::{AttributeSet, CornerAttributes};
use crate::cluster::{CornerValue, LatticeBox, Normal};
use crate::scratch::Place;

/// Steps along a side of a sheet of a chunk's triangles: two triangles a square.
const SIDE: i64 = 256;

/// Bytes at most for a chunk of `triangles`, and pages of it.
fn taken(triangles: &[LatticeTriangle], material_count: usize, attributes: AttributeSet) -> (u64, usize) {
    let folder = tempfile::tempdir().unwrap();
    let scratch = Scratch::create(Place::Unnamed(folder.path().to_path_buf())).unwrap();
    let (mut encoder, mut chunk) = (Encoder::default(), Chunk::default());
    let mut rng = rand_pcg::Pcg64::seed_from_u64(2);
    for run in triangles.chunks(RUN_TRIANGLES) {
        let mut list = TriangleList::default();
        // Noise: every corner of every triangle has a colour and a normal of its own.
        let mut bytes = || rng.next_u32().to_le_bytes()[..3].try_into().unwrap();
        for &triangle in run {
            let mut of = CornerAttributes::NONE;
            if attributes.colours {
                of.colours = [0; 3].map(|_| bytes());
            }
            if attributes.normals {
                of.normals = [0; 3].map(|_| Normal::from_bytes(bytes()));
            }
            list.push(triangle, &of);
        }
        let run = scratch.append(encoder.encode(&list), list.len()).unwrap();
        chunk.pieces.push(Piece { run, skip: 0, take: run.triangle_count });
        chunk.triangle_count += u64::from(run.triangle_count);
    }
    let mut bounds = LatticeBox::EMPTY;
    triangles.iter().for_each(|t| t.q.iter().for_each(|&q| bounds.add(q)));
    let emissive = vec![false; material_count];
    let context = PackContext { emissive: &emissive, bounds, attributes };
    let mut page_count = 0;
    let counted = allocation_counter::measure(|| {
        let mut workspace = Workspace::default();
        let pages = workspace.build(&chunk, &scratch, context).unwrap();
        page_count = pages.pages.len();
    });
    (counted.bytes_max, page_count)
}

#[test]
fn a_full_chunk_takes_no_more_than_is_leased() {
    let mut rng = rand_pcg::Pcg64::seed_from_u64(1);
    let mut below = |most: i64| i64::from(rng.next_u32()) % most;
    let mut soup = |spread: i64, material_count: i64| {
        let triangle = |_| {
            let at = [0; 3].map(|_| below(1 << 36));
            let corner = |_| at.map(|v: i64| v + below(spread));
            LatticeTriangle { q: [0; 3].map(corner), material: below(material_count) as u16 }
        };
        (0..CHUNK_TRIANGLES).map(triangle).collect::<Vec<_>>()
    };
    let point = |x: i64, y: i64| [x * 100, y * 100, (x * 37 % 91) * (y * 53 % 89)];
    let sheet: Vec<LatticeTriangle> = (0..SIDE * SIDE)
        .flat_map(|at| {
            let (x, y) = (at % SIDE, at / SIDE);
            let [a, b, c, d] = [point(x, y), point(x + 1, y), point(x + 1, y + 1), point(x, y + 1)];
            [[a, b, c], [a, c, d]].map(|q| LatticeTriangle { q, material: 0 })
        })
        .collect();
    let one_place = vec![sheet[0]; CHUNK_TRIANGLES as usize];
    for (name, triangles, material_count) in [
        ("sheet", sheet, 1),
        ("soup", soup(1 << 12, 1), 1),
        ("soup of all materials", soup(1 << 30, 1 << 16), 1 << 16),
        ("one triangle again and again", one_place, 1),
    ] {
        let normals = AttributeSet { normals: true, ..AttributeSet::default() };
        for attributes in [AttributeSet::default(), normals, AttributeSet::ALL] {
            let leased = worker_bytes(attributes);
            let (bytes, page_count) = taken(&triangles, material_count, attributes);
            let told = format!("{name}, {attributes:?}: {bytes} bytes of {leased}");
            assert!(page_count > 0 || name.starts_with("one"), "{told}");
            assert!(bytes <= leased, "{told}");
            // A lease that is far too large would hold builds up.
            assert!(name != "soup of all materials" || bytes > leased * 9 / 10, "{told}");
        }
    }
}
