//! A reader of page files written from `docs/format.md` alone, compared with the store's. It shares no code with it:
//! only the LZ4 and XXH3 of the crates that the page names. The upper octree is read in `format_octree.rs`, units in
//! `format_units.rs`.

use crate::support::{Built, build_spec};
use std::collections::BTreeMap;
use xxhash_rust::xxh3::{xxh3_64, xxh3_64_with_seed};

/// Numbers from a place on.
pub(crate) struct Reader<'a> {
    pub(crate) bytes: &'a [u8],
    pub(crate) at: usize,
}

impl Reader<'_> {
    pub(crate) fn number(&mut self, width: usize) -> u64 {
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

/// A file, read.
pub(crate) struct Model<'a> {
    origin: [f64; 3],
    step: f64,
    /// Box of the vertices: least corner, greatest corner.
    pub(crate) lattice_box: [[u64; 3]; 2],
    /// All triangles on the lattice with their materials, in the order of their ids.
    pub(crate) triangles: Vec<([[u64; 3]; 3], u64)>,
    pub(crate) material_count: u64,
    /// Item count and bytes of section 5.
    pub(crate) upper: Option<(u64, &'a [u8])>,
    /// The same of section 6.
    pub(crate) lower: Option<(u64, &'a [u8])>,
    /// Pages of units, unpacked, by number.
    pub(crate) units: BTreeMap<u64, Vec<u8>>,
}

pub(crate) fn read(bytes: &[u8]) -> Model<'_> {
    let head = &bytes[..1024];
    assert_eq!(&head[..8], b"TREX\r\n\x1a\n");
    assert_eq!(number_at(head, 8, 4), 7);
    assert_eq!(head, &bytes[bytes.len() - 1024..]);
    assert_eq!(number_at(head, 1016, 8), xxh3_64(&head[..1016]));
    assert_eq!(number_at(head, 32, 8), bytes.len() as u64);
    assert!(number_at(head, 656, 8) <= number_at(head, 240, 8));
    assert!(head[664..1016].iter().all(|&b| b == 0));
    let file_id = number_at(head, 40, 8);
    let mut end = 1024;
    // Item count, offset, bytes.
    let section = |kind: u64| {
        let slot = (0..12).map(|i| 272 + 32 * i).find(|&at| number_at(head, at, 4) == kind)?;
        let [offset, length] = [8, 16].map(|field| number_at(head, slot + field, 8) as usize);
        let content = &bytes[offset..offset + length];
        assert_eq!(number_at(head, slot + 24, 8), xxh3_64_with_seed(content, file_id ^ kind << 32));
        Some((number_at(head, slot + 4, 4), offset, content))
    };
    let origin: [f64; 3] = std::array::from_fn(|a| f64::from_bits(number_at(head, 48 + 8 * a, 8)));
    let step = 2f64.powi(number_at(head, 72, 4) as i32);
    assert_eq!(number_at(head, 16, 8), u64::from(section(6).is_some()), "required features");
    let (mut triangles, mut units) = (Vec::new(), BTreeMap::new());
    for (page, entry) in section(1).unwrap().2.chunks(44).enumerate() {
        let [offset, hash] = [0, 8].map(|at| number_at(entry, at, 8));
        let [stored, unpacked, first, count, kind] = [16, 20, 24, 28, 32].map(|at| number_at(entry, at, 4));
        assert_eq!((offset, first), (end, triangles.len() as u64));
        end += stored;
        let stored = &bytes[offset as usize..end as usize];
        let seed = file_id ^ (page as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
        assert_eq!(hash, xxh3_64_with_seed(stored, seed));
        let content = match kind & !1 {
            0 => stored.to_vec(),
            0x100 => lz4_flex::block::decompress(stored, unpacked as usize).unwrap(),
            _ => panic!("kind and packing {kind:x}"),
        };
        assert_eq!(content.len() as u64, unpacked);
        if kind & 1 == 0 {
            assert!(units.is_empty(), "a page of the mesh behind one of units");
            triangles.extend(read_page(&content));
        } else {
            units.insert(page as u64, content);
        }
        assert_eq!(triangles.len() as u64, first + count);
    }
    assert_eq!(units.is_empty(), section(6).is_none());
    for kind in 1..=6 {
        let Some((_, offset, content)) = section(kind) else {
            assert!(kind >= 5, "a section is missing");
            continue;
        };
        assert_eq!(offset as u64, end, "a gap before section {kind}");
        end += content.len() as u64;
    }
    assert_eq!(end + 1024, bytes.len() as u64);
    let corner = |at: usize| std::array::from_fn(|a| number_at(head, at + 8 * a, 8));
    Model {
        origin,
        step,
        lattice_box: [corner(152), corner(176)],
        triangles,
        material_count: section(3).unwrap().0,
        upper: section(5).map(|(count, _, content)| (count, content)),
        lower: section(6).map(|(count, _, content)| (count, content)),
        units,
    }
}

/// Triangles of a page on the lattice.
fn read_page(content: &[u8]) -> Vec<([[u64; 3]; 3], u64)> {
    let mut r = Reader { bytes: content, at: 0 };
    let [clusters, nodes, roots] = [2, 2, 1].map(|width| r.number(width));
    let offset_widths = [0; 3].map(|_| r.number(1));
    let material_bits = r.number(1);
    let anchor = [0; 3].map(|_| r.number(5));
    let size_bits = r.number(1);
    let mut kinds: Vec<u64> = r.bits(roots as usize, 1);
    let shapes: Vec<[u64; 2]> = (0..nodes).map(|_| [r.number(1), r.number(1)]).collect();
    kinds.reverse();
    let (mut next_node, mut met) = (0, 0);
    while let Some(is_node) = kinds.pop() {
        if is_node == 0 {
            met += 1;
            continue;
        }
        let [children, nodes] = shapes[next_node];
        next_node += 1;
        kinds.extend((0..children).rev().map(|i| nodes >> i & 1));
    }
    assert_eq!((next_node as u64, met), (nodes, clusters), "the walk meets all");
    let mut bits = Bits { bytes: &content[r.at..], at: 0 };
    let entries: Vec<Entry> =
        (0..clusters).map(|_| read_entry(&mut bits, anchor, offset_widths, size_bits)).collect();
    assert_eq!(bits.take((8 - bits.at as u64 % 8) % 8), 0, "no zeros behind the entries");
    r.at += bits.at / 8;
    let mut triangles = Vec::new();
    for entry in &entries {
        let (before, first) = (r.at, triangles.len());
        triangles.extend(read_cluster(&mut r, entry, material_bits));
        assert_eq!((r.at - before) as u64, entry.bytes, "bytes of a cluster");
        let corners = || triangles[first..].iter().flat_map(|(corners, _)| corners);
        for a in 0..3 {
            let greatest = corners().map(|corner| corner[a]).max().unwrap();
            assert_eq!(corners().map(|corner| corner[a]).min().unwrap(), entry.base[a], "least corner");
            assert!((greatest..=greatest + (greatest - entry.base[a]) / 64).contains(&entry.most[a]));
        }
    }
    assert_eq!(r.at, content.len(), "bytes behind the last cluster");
    triangles
}

/// Bits of a cluster, one by one.
struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Bits<'_> {
    fn take(&mut self, count: u64) -> u64 {
        (0..count).map(|i| self.bit() << i).sum()
    }

    fn bit(&mut self) -> u64 {
        self.at += 1;
        u64::from(self.bytes[(self.at - 1) / 8] >> ((self.at - 1) % 8) & 1)
    }
}

/// What the head of a page says of a cluster.
struct Entry {
    count: usize,
    base: [u64; 3],
    widths: [u64; 3],
    /// Most that a coordinate is.
    most: [u64; 3],
    bytes: u64,
}

fn read_entry(bits: &mut Bits<'_>, anchor: [u64; 3], offset_widths: [u64; 3], size_bits: u64) -> Entry {
    let count = bits.take(7) as usize + 1;
    let offsets = offset_widths.map(|width| bits.take(width));
    let base: [u64; 3] = std::array::from_fn(|a| anchor[a] + offsets[a]);
    let widths = [6; 3].map(|width| bits.take(width));
    let extents = [6; 3].map(|width| bits.take(width));
    let most = std::array::from_fn(|a| {
        base[a]
            + match widths[a] {
                0 => 0,
                width @ 1..=7 => (1 << (width - 1)) + extents[a],
                width => ((65 + extents[a]) << (width - 7)) - 1,
            }
    });
    Entry { count, base, widths, most, bytes: bits.take(size_bits) }
}

fn read_cluster(r: &mut Reader<'_>, entry: &Entry, material_bits: u64) -> Vec<([[u64; 3]; 3], u64)> {
    let mut bits = Bits { bytes: &r.bytes[r.at..], at: 0 };
    let &Entry { count, base, widths, .. } = entry;
    let vertex_count = bits.take(7) as usize + 1;
    let [wide, has_palette, leaves_differ] = [1; 3].map(|width| bits.take(width) == 1);
    if leaves_differ {
        let leaves = bits.take(4) + 1;
        let sizes: Vec<u64> = (0..leaves).map(|_| bits.take(3) + 1).collect();
        assert_eq!(sizes.iter().sum::<u64>(), count as u64, "triangles of the leaves");
        assert!(sizes[..sizes.len() - 1].iter().any(|&size| size < 8), "leaves that do not differ");
    }
    let classes = if wide { [0; 3] } else { [5; 3].map(|width| bits.take(width)) };
    let palette_len = if has_palette { bits.take(7) + 1 } else { 1 };
    let palette: Vec<u64> = (0..palette_len).map(|_| bits.take(material_bits)).collect();
    let index_bits = match palette_len {
        1 => 0,
        2..=4 => 2,
        5..=16 => 4,
        _ => 8,
    };
    let indices: Vec<u64> = (0..count).map(|_| bits.take(index_bits)).collect();
    let (corners, guides) = read_topology(&mut bits, count);
    assert_eq!(guides.len(), vertex_count);
    let tags: Vec<u64> = (0..vertex_count).map(|_| if wide { 3 } else { bits.take(2) }).collect();
    // A vertex as packed; of a wide cluster, too, in as many bits as it takes.
    let place = |a: usize| 1u128 << widths[..a].iter().sum::<u64>();
    let modulus = place(3);
    let mut above: Vec<u128> = Vec::new();
    for (tag, guide) in tags.into_iter().zip(guides) {
        let class = classes.get(tag as usize);
        let mut vertex = match guide {
            Some([from, to, opposite]) if class.is_some() => {
                above[from] + above[to] + modulus - above[opposite]
            }
            _ => 0,
        };
        for a in 0..3 {
            let value_bits = class.map_or(widths[a], |class| *class.min(&widths[a]));
            let half = if class.is_none() || value_bits == 0 { 0 } else { 1 << (value_bits - 1) };
            vertex += u128::from(bits.take(value_bits)) * place(a) + modulus - half * place(a);
        }
        above.push(vertex % modulus);
    }
    r.at += bits.at.div_ceil(8);
    assert_eq!(bits.take((8 - bits.at as u64 % 8) % 8), 0, "no zeros behind a cluster");
    let corner =
        |v: usize| std::array::from_fn(|a| base[a] + (above[v] / place(a) % (1 << widths[a])) as u64);
    (0..count).map(|t| (corners[t].map(corner), palette[indices[t] as usize])).collect()
}

type Topology = (Vec<[usize; 3]>, Vec<Option<[usize; 3]>>);

/// Bits that a number needs.
fn bits_of(number: usize) -> u64 {
    u64::from(usize::BITS - number.leading_zeros())
}

/// Corners of the triangles, and per vertex what it is predicted from.
fn read_topology(bits: &mut Bits<'_>, count: usize) -> Topology {
    let (mut corners, mut guides) = (Vec::<[usize; 3]>::new(), Vec::<Option<[usize; 3]>>::new());
    // The edge of a turn: from, to, and the corner opposite.
    let edge = |[a, b, x]: [usize; 3], turn: u64| if turn == 0 { [x, b, a] } else { [a, x, b] };
    while corners.len() < count {
        let (t, length) = (corners.len(), bits.take(3) as usize + 1);
        let turns: Vec<u64> = (1..length).map(|_| bits.bit()).collect();
        let new: Vec<bool> = (0..length).map(|_| bits.bit() == 1).collect();
        let gate = bits.take(bits_of(2 * t)) as usize;
        let mut hangs_on = if gate < 2 * t {
            Some(edge(corners[t - 1 - gate / 2], gate as u64 % 2))
        } else {
            assert_eq!(gate, 2 * t);
            None
        };
        let [mut a, mut b] = match hangs_on {
            Some([from, to, _]) => [from, to],
            None => {
                let a = bits.take(bits_of(guides.len())) as usize;
                if a == guides.len() {
                    guides.push(a.checked_sub(1).map(|before| [before; 3]));
                }
                let b = bits.take(bits_of(guides.len())) as usize;
                if b == guides.len() {
                    guides.push(Some([a; 3]));
                }
                [a, b]
            }
        };
        let after = guides.len() + new.iter().filter(|&&new| new).count();
        for (i, new) in new.into_iter().enumerate() {
            if i > 0 {
                let next = edge(corners[t + i - 1], turns[i - 1]);
                (a, b, hangs_on) = (next[0], next[1], Some(next));
            }
            let x = if new { guides.len() } else { bits.take(bits_of(after - 1)) as usize };
            if new {
                guides.push(Some(hangs_on.unwrap_or([b; 3])));
            }
            corners.push([a, b, x]);
        }
    }
    assert_eq!(corners.len(), count, "triangles of the strips");
    (corners, guides)
}

#[test]
fn the_documented_format_is_the_one_that_is_written() {
    // Many materials and wide clusters; far from the origin; one material.
    for spec in ["gen:pipes:60k:3", "gen:soup:20k:3", "gen:isosurface:40k:3"] {
        let built: Built = build_spec(spec);
        let bytes = std::fs::read(built.file.path()).unwrap();
        let found = read(&bytes);
        let place = |q: [u64; 3]| std::array::from_fn(|a| found.origin[a] + q[a] as f64 * found.step);
        let corners: Vec<Corners> = found.triangles.iter().map(|t| t.0.map(place)).collect();
        assert!(corners == built.decode(), "{spec}: other triangles");
        let materials = built.file.materials().len() as u64;
        assert_eq!(found.material_count, materials, "{spec}");
        assert!(found.triangles.iter().all(|t| t.1 < materials), "{spec}: a material that is not there");
        assert_eq!(found.triangles.iter().any(|t| t.1 > 0), materials > 1, "{spec}");
    }
}
