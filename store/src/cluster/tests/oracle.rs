//! The disk form of a page read bit by bit, triangle by triangle and axis by axis, as `encode.rs`, `strips.rs` and
//! `vertices.rs` draw it. It shares no code with the decoder, and believes what it reads: it is asked about pages that
//! were installed.

use super::ClusterMesh;

struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl Bits<'_> {
    fn take(&mut self, bits: usize) -> u64 {
        let mut value = 0;
        for i in 0..bits {
            value |= u64::from(self.bytes[self.at / 8] >> (self.at % 8) & 1) << i;
            self.at += 1;
        }
        value
    }

    fn number(&mut self, bits: usize) -> usize {
        self.take(bits) as usize
    }
}

/// Bits of a number: 0 for 0.
fn length(mut value: usize) -> usize {
    let mut bits = 0;
    while value > 0 {
        value /= 2;
        bits += 1;
    }
    bits
}

/// The clusters of a page.
pub(super) fn clusters(packed: &[u8]) -> Vec<ClusterMesh> {
    let mut bits = Bits { bytes: packed, at: 0 };
    let (cluster_count, node_count, root_count) = (bits.number(16), bits.number(16), bits.number(8));
    let offset_bits: [usize; 3] = std::array::from_fn(|_| bits.number(8));
    let material_bits = bits.number(8);
    let anchor: [u64; 3] = std::array::from_fn(|_| bits.take(40));
    let size_bits = bits.number(8);
    bits.at += 8 * root_count.div_ceil(8) + 16 * node_count;
    let page = Page { offset_bits, material_bits, anchor, size_bits };
    let entries: Vec<Entry> = (0..cluster_count).map(|_| page.entry(&mut bits)).collect();
    bits.at = bits.at.next_multiple_of(8);
    let mut clusters = Vec::new();
    for entry in entries {
        let before = bits.at;
        clusters.push(page.cluster(&entry, &mut bits));
        assert_eq!(bits.at - before, 8 * entry.size);
    }
    clusters
}

/// What is told of a cluster before its bits.
struct Entry {
    triangle_count: usize,
    base: [u64; 3],
    axis_bits: [usize; 3],
    size: usize,
}

struct Page {
    offset_bits: [usize; 3],
    material_bits: usize,
    anchor: [u64; 3],
    size_bits: usize,
}

impl Page {
    fn entry(&self, bits: &mut Bits<'_>) -> Entry {
        let triangle_count = bits.number(7) + 1;
        let base = std::array::from_fn(|axis| self.anchor[axis] + bits.take(self.offset_bits[axis]));
        let axis_bits = std::array::from_fn(|_| bits.number(6));
        // Three extents.
        bits.at += 18;
        Entry { triangle_count, base, axis_bits, size: bits.number(self.size_bits) }
    }

    fn cluster(&self, entry: &Entry, bits: &mut Bits<'_>) -> ClusterMesh {
        let &Entry { triangle_count, base, axis_bits, .. } = entry;
        let vertex_count = bits.number(7) + 1;
        let (wide, has_palette, leaves_differ) = (bits.take(1) == 1, bits.take(1) == 1, bits.take(1) == 1);
        let leaf_sizes: Vec<u8> = if leaves_differ {
            let leaf_count = bits.number(4) + 1;
            (0..leaf_count).map(|_| bits.take(3) as u8 + 1).collect()
        } else {
            (0..triangle_count.div_ceil(8)).map(|leaf| (triangle_count - 8 * leaf).min(8) as u8).collect()
        };
        let classes: [usize; 3] = std::array::from_fn(|_| if wide { 0 } else { bits.number(5) });
        let palette_len = if has_palette { bits.number(7) + 1 } else { 1 };
        let palette: Vec<u16> = (0..palette_len).map(|_| bits.take(self.material_bits) as u16).collect();
        let index_bits = [0, 2, 4, 8][[2, 5, 17].iter().filter(|&&least| palette_len >= least).count()];
        let materials = (0..triangle_count).map(|_| palette[bits.number(index_bits)]).collect();
        let (triangles, guides) = topology(bits, triangle_count);
        assert_eq!((triangles.len(), guides.len()), (triangle_count, vertex_count));
        let above = if wide {
            (0..vertex_count).map(|_| axis_bits.map(|width| bits.take(width))).collect()
        } else {
            vertices(bits, &guides, axis_bits, classes)
        };
        bits.at = bits.at.next_multiple_of(8);
        let placed = |v: [u64; 3]| std::array::from_fn(|axis| (base[axis] + v[axis]) as i64);
        let vertices = above.into_iter().map(placed).collect();
        ClusterMesh { vertices, triangles, leaf_sizes, materials, ..ClusterMesh::default() }
    }
}

/// Triangles, and for each vertex in which edge, opposite of which vertex, it was met.
fn topology(bits: &mut Bits<'_>, triangle_count: usize) -> (Vec<[u8; 3]>, Vec<[usize; 3]>) {
    let (mut triangles, mut guides) = (Vec::<[u8; 3]>::new(), Vec::<[usize; 3]>::new());
    // The edge that a triangle opens by its turn, and the corner opposite of it.
    let opened = |[a, b, x]: [u8; 3], turn: usize| if turn == 0 { [x, b, a] } else { [a, x, b] };
    while triangles.len() < triangle_count {
        let count = bits.number(3) + 1;
        let turns: Vec<usize> = (1..count).map(|_| bits.number(1)).collect();
        let new: Vec<bool> = (0..count).map(|_| bits.take(1) == 1).collect();
        let before = triangles.len();
        let gate = bits.number(length(2 * before));
        let mut hang = if gate == 2 * before {
            let mut edge = [0; 2];
            let mut near = guides.len().saturating_sub(1);
            for end in &mut edge {
                *end = bits.number(length(guides.len()));
                if *end == guides.len() {
                    guides.push([near; 3]);
                }
                near = *end;
            }
            [edge[0] as u8, edge[1] as u8, edge[0] as u8]
        } else {
            opened(triangles[before - 1 - gate / 2], gate % 2)
        };
        let after = guides.len() + new.iter().filter(|&&is_new| is_new).count();
        for i in 0..count {
            if i > 0 {
                hang = opened(triangles[before + i - 1], turns[i - 1]);
            }
            let x = if new[i] {
                guides.push(hang.map(usize::from));
                guides.len() - 1
            } else {
                bits.number(length(after - 1))
            };
            triangles.push([hang[0], hang[1], x as u8]);
        }
    }
    (triangles, guides)
}

/// Vertices of a compact cluster above its base.
fn vertices(
    bits: &mut Bits<'_>,
    guides: &[[usize; 3]],
    axis_bits: [usize; 3],
    classes: [usize; 3],
) -> Vec<[u64; 3]> {
    let place = [0, axis_bits[0], axis_bits[0] + axis_bits[1]].map(|bits| 1i128 << bits);
    let all = place[2] << axis_bits[2];
    let tags: Vec<usize> = guides.iter().map(|_| bits.number(2)).collect();
    // As one number each; those that are not there yet are zero.
    let mut packed = vec![0i128; 256];
    for (i, &tag) in tags.iter().enumerate() {
        let is_plain = tag == 3;
        let [from, to, opposite] = guides[i].map(|guide| packed[guide]);
        let mut number = if is_plain { 0 } else { from + to - opposite };
        for axis in 0..3 {
            let width = if is_plain { axis_bits[axis] } else { axis_bits[axis].min(classes[tag]) };
            let half = if is_plain { 0 } else { (1i128 << width) / 2 };
            number += (i128::from(bits.take(width)) - half) * place[axis];
        }
        packed[i] = number.rem_euclid(all);
    }
    let axes =
        |number: &i128| std::array::from_fn(|axis| (number / place[axis] % (1 << axis_bits[axis])) as u64);
    packed[..guides.len()].iter().map(axes).collect()
}
