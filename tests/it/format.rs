//! A reader of page files written from `docs/format.md` alone, compared with the store's. It shares no code with it: only
//! the LZ4 and XXH3 of the crates that the page names.

use crate::support::{Built, build_spec};
use xxhash_rust::xxh3::{xxh3_64, xxh3_64_with_seed};

/// Numbers from a place on.
struct Reader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Reader<'_> {
    fn number(&mut self, width: usize) -> u64 {
        let value = self.bytes[self.at..self.at + width].iter().rev().fold(0, |n, &b| n << 8 | u64::from(b));
        self.at += width;
        value
    }

    /// `count` numbers of `bits` bits, to the end of the last byte.
    fn bits(&mut self, count: usize, bits: usize) -> Vec<u64> {
        let bit = |i: usize| u64::from(self.bytes[self.at + i / 8] >> (i % 8) & 1);
        let numbers = (0..count).map(|n| (0..bits).map(|b| bit(n * bits + b) << b).sum()).collect();
        self.at += (count * bits).div_ceil(8);
        numbers
    }
}

fn number_at(bytes: &[u8], at: usize, width: usize) -> u64 {
    Reader { bytes, at }.number(width)
}

type Corners = [[f64; 3]; 3];

/// All triangles with their materials, in the order of their ids.
fn read(bytes: &[u8]) -> Vec<(Corners, u64)> {
    let head = &bytes[..1024];
    assert_eq!(&head[..8], b"TREX\r\n\x1a\n");
    assert_eq!(head, &bytes[bytes.len() - 1024..]);
    assert_eq!(number_at(head, 1016, 8), xxh3_64(&head[..1016]));
    assert_eq!(number_at(head, 32, 8), bytes.len() as u64);
    assert!(head[656..1016].iter().all(|&b| b == 0));
    let file_id = number_at(head, 40, 8);
    let mut end = 1024;
    let section = |kind: u64| {
        let slot = (0..12).map(|i| 272 + 32 * i).find(|&at| number_at(head, at, 4) == kind).unwrap();
        let [offset, length] = [8, 16].map(|field| number_at(head, slot + field, 8) as usize);
        let content = &bytes[offset..offset + length];
        assert_eq!(number_at(head, slot + 24, 8), xxh3_64_with_seed(content, file_id ^ kind << 32));
        (offset, content)
    };
    let origin: [f64; 3] = std::array::from_fn(|a| f64::from_bits(number_at(head, 48 + 8 * a, 8)));
    let step = 2f64.powi(number_at(head, 72, 4) as i32);
    let mut triangles = Vec::new();
    for (page, entry) in section(1).1.chunks(40).enumerate() {
        let [offset, hash] = [0, 8].map(|at| number_at(entry, at, 8));
        let [stored, unpacked, first, count, kind] = [16, 20, 24, 28, 32].map(|at| number_at(entry, at, 4));
        assert_eq!((offset, first), (end, triangles.len() as u64));
        end += stored;
        let stored = &bytes[offset as usize..end as usize];
        let seed = file_id ^ (page as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        assert_eq!(hash, xxh3_64_with_seed(stored, seed));
        let content = match kind {
            0 => stored.to_vec(),
            0x100 => lz4_flex::block::decompress(stored, unpacked as usize).unwrap(),
            _ => panic!("kind and packing {kind:x}"),
        };
        assert_eq!(content.len() as u64, unpacked);
        for (corners, material) in read_page(&content) {
            let place = |q: [u64; 3]| std::array::from_fn(|a| origin[a] + q[a] as f64 * step);
            triangles.push((corners.map(place), material));
        }
        assert_eq!(triangles.len() as u64, first + count);
    }
    for kind in 1..=4 {
        let (offset, content) = section(kind);
        assert_eq!(offset as u64, end, "a gap before section {kind}");
        end += content.len() as u64;
    }
    assert_eq!(end + 1024, bytes.len() as u64);
    triangles
}

/// Triangles of a page on the lattice.
fn read_page(content: &[u8]) -> Vec<([[u64; 3]; 3], u64)> {
    let mut r = Reader { bytes: content, at: 0 };
    let [roots, nodes, clusters] = [0; 3].map(|_| r.number(2));
    r.at += 2 * roots as usize;
    for _ in 0..nodes {
        r.at += 15;
        let children = r.number(1) as usize;
        r.at += 8 * children;
    }
    let mut triangles = Vec::new();
    for _ in 0..clusters {
        let wide = r.number(1) == 1;
        let [count, vertex_count, palette_len] = [0; 3].map(|_| r.number(1) as usize + 1);
        let base = [0; 3].map(|_| r.number(5));
        let widths = [0; 3].map(|_| r.number(1) as usize);
        let palette = r.bits(palette_len, 16);
        let index_bits = match palette_len {
            1 => 0,
            2..=4 => 2,
            5..=16 => 4,
            _ => 8,
        };
        let indices = r.bits(count, index_bits);
        let leaves: Vec<Vec<u64>> = (0..count.div_ceil(8)).map(|_| r.bits(24, 7)).collect();
        let vertices: Vec<[u64; 3]> = if wide {
            r.bits(3 * vertex_count, 40).chunks(3).map(|q| [q[0], q[1], q[2]]).collect()
        } else {
            let all = widths.iter().sum();
            let packed = r.bits(vertex_count, all);
            let axis = |word: u64, a: usize| {
                let below: usize = widths[..a].iter().sum();
                base[a] + (word >> below & ((1 << widths[a]) - 1))
            };
            packed.into_iter().map(|word| std::array::from_fn(|a| axis(word, a))).collect()
        };
        for i in 0..count {
            let corner = |c: usize| vertices[leaves[i / 8][8 * c + i % 8] as usize];
            triangles.push(([corner(0), corner(1), corner(2)], palette[indices[i] as usize]));
        }
    }
    assert_eq!(r.at, content.len(), "bytes behind the last cluster");
    triangles
}

#[test]
fn the_documented_format_is_the_one_that_is_written() {
    // Many materials and wide clusters; far from the origin; one material.
    for spec in ["gen:pipes:60k:3", "gen:soup:20k:3", "gen:isosurface:40k:3"] {
        let built: Built = build_spec(spec);
        let found = read(&std::fs::read(built.file.path()).unwrap());
        let corners: Vec<Corners> = found.iter().map(|t| t.0).collect();
        assert!(corners == built.decode(), "{spec}: other triangles");
        let materials = built.file.materials().len() as u64;
        assert!(found.iter().all(|t| t.1 < materials), "{spec}: a material that is not there");
        assert_eq!(found.iter().any(|t| t.1 > 0), materials > 1, "{spec}");
    }
}
