//! Install of one cluster: bits to corners and vertices, and these to a header, leaf boxes, indices and packed
//! vertices in the frame. Indices of a leaf stand in as many bytes as it needs, so that only behind the topology it is
//! known where all else goes.
//!
//! ```text
//! strips::decode -> corners, guides -> vertices::decode -> packed vertices, and per vertex its *cell*:
//! x, y, z above the base in 8 bits each; the cells of a leaf joined are its box
//! ```
//!
//! Invariants: those of `install.rs`; 5. what is written is a function of the input alone, not of what was in the
//! frame or in the installer before.

use super::bits::{BitReader, WINDOW_BYTES, Window};
use super::cells::{self, Cells};
use super::encode::Head;
use super::entry::{COUNT_BITS, ClusterEntry};
use super::fields::{Machine, Mover, Work};
use super::finish::{GROUP_BYTES, VertexWords};
use super::install_leaves::{LeafWriter, ROOM_BYTES, Room};
use super::leaves;
use super::packing::VertexPacking;
use super::strips::{self, STRIP_TRIANGLES, Topology};
use super::vertices::{self, CLASS_WIDTH_BITS, CLASSES, ClassWidths, VertexDecoder};
use super::view::ClusterHead;
use super::*;
use crate::layout::{CLUSTER_LEAVES, CLUSTER_TRIANGLES, CLUSTER_VERTICES, FRAME_BYTES};

// What a header holds in 16 bits: triangles before a cluster, and offsets in it. The indices of a triangle take 3 bits
// at least.
const LEAST_FULL_BYTES: usize =
    CLUSTER_HEAD_BYTES + CLUSTER_LEAVES * (LEAF_HEAD_BYTES + 1) + 3 * CLUSTER_TRIANGLES / 8;
const _: () = assert!(FRAME_BYTES / LEAST_FULL_BYTES * CLUSTER_TRIANGLES <= u16::MAX as usize);

/// Bytes that a cluster takes in a frame, at most.
const MOST_BYTES: usize = CLUSTER_HEAD_BYTES
    + CLUSTER_LEAVES * (LEAF_HEAD_BYTES + 1)
    + 3 * CLUSTER_TRIANGLES
    + 3 * CLUSTER_TRIANGLES
    + CLUSTER_VERTICES * WIDE_VERTEX_BYTES;
const _: () = assert!(MOST_BYTES + GROUP_BYTES + FRAME_TAIL_BYTES <= ROOM_BYTES);
// Heads have 229 bits; a strip of one triangle has 37, and the last may be longer than the cluster.
const MOST_BITS: usize = 229
    + CLUSTER_TRIANGLES * (16 + 8)
    + (CLUSTER_TRIANGLES + STRIP_TRIANGLES) * 37
    + CLUSTER_VERTICES * 8 * WIDE_VERTEX_BYTES;
const _: () = assert!(MOST_BITS <= 8 * WINDOW_BYTES);

/// Work memory for the clusters of a page.
pub(super) struct ClusterInstaller {
    machine: Machine,
    material_bits: u8,
    lattice_bits: u32,
    topology: Topology,
    placed: VertexWords,
    /// By vertex.
    cells: Cells,
    /// Vertices of a wide cluster, as the frame holds them.
    wide: [u8; CLUSTER_VERTICES * WIDE_VERTEX_BYTES],
}

/// The counts and widths of a cluster, checked.
struct ClusterPlan {
    triangle_count: usize,
    vertex_count: usize,
    leaf_count: usize,
    leaf_sizes: [u8; CLUSTER_LEAVES],
    palette_len: usize,
    widths: Widths,
    classes: ClassWidths,
    /// Leaf planes are multiples of 2^shift above the base.
    shift: [u8; 3],
    vertex_bits: u32,
}

/// Where the parts of a cluster stand in the frame.
struct PartPlaces {
    palette: usize,
    vertices: usize,
    end: usize,
}

impl ClusterPlan {
    fn read(input: &mut BitReader<'_>, entry: &ClusterEntry) -> Result<ClusterPlan, &'static str> {
        let &ClusterEntry { triangle_count, base, bits, .. } = entry;
        let vertex_count = input.take(COUNT_BITS) as usize + 1;
        let (wide, has_palette) = (input.take(1) == 1, input.take(1) == 1);
        let (leaf_count, leaf_sizes) = leaves::decode_sizes(input, triangle_count)?;
        let classes: ClassWidths =
            if wide { [0; CLASSES] } else { std::array::from_fn(|_| input.take(CLASS_WIDTH_BITS) as u32) };
        let palette_len = if has_palette { input.take(COUNT_BITS) as usize + 1 } else { 1 };
        let vertex_bits: u32 = bits.iter().map(|&b| u32::from(b)).sum();
        let packs = vertex_bits <= VERTEX_BITS && bits.iter().all(|&b| u32::from(b) <= AXIS_BITS);
        if vertex_count > CLUSTER_VERTICES || palette_len > triangle_count || !(packs || wide) {
            return Err("a cluster is out of range");
        }
        let widths = Widths { base, bits, wide };
        Ok(ClusterPlan {
            triangle_count,
            vertex_count,
            leaf_count,
            leaf_sizes,
            palette_len,
            widths,
            classes,
            shift: bits.map(|b| b.saturating_sub(8)),
            vertex_bits: if wide { 8 * WIDE_VERTEX_BYTES as u32 } else { vertex_bits },
        })
    }

    /// Bits of the palette and the triangles' indices into it.
    fn bits_of_materials(&self, material_bits: u8) -> usize {
        self.palette_len * usize::from(material_bits)
            + self.triangle_count * palette_index_bits(self.palette_len)
    }
}

impl ClusterInstaller {
    pub(super) fn new(machine: Machine, head: &Head, lattice_bits: u32) -> ClusterInstaller {
        ClusterInstaller {
            machine,
            material_bits: head.material_bits,
            lattice_bits,
            topology: Topology::EMPTY,
            placed: [0; 256],
            cells: cells::NO_CELLS,
            wide: [0; CLUSTER_VERTICES * WIDE_VERTEX_BYTES],
        }
    }

    /// Installs the cluster of `entry` at the front of `window` at the start of `room`: one of a page that has
    /// `first_triangle` triangles before it. Behind it stand [`FRAME_TAIL_BYTES`] zeros. Gives the bytes that it takes.
    pub(super) fn install(
        &mut self,
        (window, entry): (&Window, &ClusterEntry),
        first_triangle: usize,
        room: &mut Room,
    ) -> Result<usize, &'static str> {
        let mut input = BitReader::new(window);
        let plan = ClusterPlan::read(&mut input, entry)?;
        let mut materials = input;
        input.skip(plan.bits_of_materials(self.material_bits));
        let counts = (plan.triangle_count, plan.vertex_count);
        let machine = self.machine;
        machine.run(Strips { input: &mut input, counts, topology: &mut self.topology })?;
        let bounds = if plan.widths.wide {
            self.wide_vertices(&mut input, &plan)
        } else {
            machine.run(Vertices { installer: self, input: &mut input, plan: &plan })
        };
        let sizes = &plan.leaf_sizes[..plan.leaf_count];
        let leaves = LeafWriter { topology: &self.topology, sizes, cells: &self.cells, room };
        let places = PartPlaces::new(&plan, machine.run(leaves));
        self.materials(&mut materials, &plan, &mut room[places.palette..places.vertices])?;
        if plan.widths.wide {
            room[places.vertices..][..self.wide.len()].copy_from_slice(&self.wide);
        } else {
            machine.run(VertexPacker {
                placed: &self.placed,
                plan: &plan,
                out: &mut room[places.vertices..],
            });
        }
        room[places.end..][..FRAME_TAIL_BYTES].fill(0);
        if !input.align() || !input.is_within(entry.size) || input.byte_count() != entry.size {
            return Err("the bits of a cluster are more or fewer than its counts say");
        }
        if bounds.hi.iter().any(|q| q >> self.lattice_bits != 0) {
            return Err("a vertex lies behind the lattice");
        }
        if entry.bounds(self.lattice_bits).join(&bounds) != entry.bounds(self.lattice_bits) {
            return Err("a cluster is larger than its box");
        }
        write_head(&plan, &places, first_triangle, room);
        Ok(places.end)
    }

    /// The palette, and each triangle's index into it, to the frame bytes of both.
    fn materials(
        &self,
        input: &mut BitReader<'_>,
        plan: &ClusterPlan,
        frame: &mut [u8],
    ) -> Result<(), &'static str> {
        let (materials, indices) = frame.split_at_mut(2 * plan.palette_len);
        for material in materials.as_chunks_mut().0 {
            *material = (input.take(u32::from(self.material_bits)) as u16).to_le_bytes();
        }
        let bits = palette_index_bits(plan.palette_len);
        if bits == 0 {
            return Ok(());
        }
        indices.fill(0);
        for i in 0..plan.triangle_count {
            let index = input.take(bits as u32) as usize;
            if index >= plan.palette_len {
                return Err("a material index lies behind its palette");
            }
            indices[i * bits / 8] |= (index << (i * bits % 8)) as u8;
        }
        Ok(())
    }

    /// Vertices of a compact cluster, and their cells. Gives their box.
    #[inline(always)]
    fn vertices<M: Mover>(&mut self, mover: M, input: &mut BitReader<'_>, plan: &ClusterPlan) -> LatticeBox {
        let packing = VertexPacking::new(&plan.widths);
        let guides = &mut self.topology.guides;
        let coded = VertexDecoder { packing, classes: plan.classes, count: plan.vertex_count, guides };
        coded.decode(mover, input, &mut self.placed);
        let greatest =
            mover.finish(&packing, plan.shift, (&mut self.placed, plan.vertex_count), &mut self.cells);
        let base = plan.widths.base;
        LatticeBox { lo: base, hi: std::array::from_fn(|a| base[a] + i64::from(greatest[a])) }
    }

    /// Vertices of a wide cluster, and their cells. Gives their box.
    fn wide_vertices(&mut self, input: &mut BitReader<'_>, plan: &ClusterPlan) -> LatticeBox {
        let mut bounds = LatticeBox { lo: plan.widths.base, hi: plan.widths.base };
        let vertices = self.wide.as_chunks_mut::<WIDE_VERTEX_BYTES>().0.iter_mut().zip(&mut self.cells);
        for (bytes, cell) in vertices.take(plan.vertex_count) {
            let vertex = vertices::decode_wide(input, &plan.widths);
            let mut places = 0;
            for axis in 0..3 {
                let q = plan.widths.base[axis] + vertex[axis] as i64;
                bytes[5 * axis..5 * axis + 5].copy_from_slice(&q.to_le_bytes()[..5]);
                bounds.hi[axis] = bounds.hi[axis].max(q);
                places |= vertex[axis] >> plan.shift[axis] << (8 * axis);
            }
            *cell = cells::word(places);
        }
        bounds
    }
}

fn write_head(plan: &ClusterPlan, places: &PartPlaces, first_triangle: usize, frame: &mut [u8]) {
    let five = |q: i64| q.to_le_bytes()[..5].try_into().expect("five of eight bytes");
    let head = ClusterHead {
        base: plan.widths.base.map(five),
        widths: plan.widths.bits,
        vertex_bits: plan.vertex_bits as u8,
        triangle_count: plan.triangle_count as u8,
        vertex_count: plan.vertex_count as u8,
        palette_len: plan.palette_len as u8,
        first_triangle: (first_triangle as u16).to_le_bytes(),
        palette_at: (places.palette as u16).to_le_bytes(),
        vertices_at: (places.vertices as u16).to_le_bytes(),
        leaf_count: plan.leaf_count as u8,
    };
    frame[..CLUSTER_HEAD_BYTES].copy_from_slice(bytemuck::bytes_of(&head));
}

impl PartPlaces {
    /// Behind leaves that end at `palette`.
    fn new(plan: &ClusterPlan, palette: usize) -> PartPlaces {
        let vertices = palette + palette_bytes(plan.palette_len, plan.triangle_count);
        let bits = plan.vertex_count * plan.vertex_bits as usize;
        PartPlaces { palette, vertices, end: vertices + bits.div_ceil(8) }
    }
}

/// The loop over strips. Each loop is work of its own, so that it has the registers for itself.
struct Strips<'a, 'b> {
    input: &'a mut BitReader<'b>,
    /// Triangles and vertices.
    counts: (usize, usize),
    topology: &'a mut Topology,
}

impl Work for Strips<'_, '_> {
    type Output = Result<(), &'static str>;

    #[inline(always)]
    fn run<M: Mover>(self, mover: M) -> Self::Output {
        strips::decode(mover, self.input, self.counts, self.topology)
    }
}

/// The loop over the vertices of a compact cluster.
struct Vertices<'a, 'b> {
    installer: &'a mut ClusterInstaller,
    input: &'a mut BitReader<'b>,
    plan: &'a ClusterPlan,
}

impl Work for Vertices<'_, '_> {
    type Output = LatticeBox;

    #[inline(always)]
    fn run<M: Mover>(self, mover: M) -> LatticeBox {
        self.installer.vertices(mover, self.input, self.plan)
    }
}

/// The loop that writes them to the frame.
struct VertexPacker<'a> {
    placed: &'a VertexWords,
    plan: &'a ClusterPlan,
    out: &'a mut [u8],
}

impl Work for VertexPacker<'_> {
    type Output = ();

    #[inline(always)]
    fn run<M: Mover>(self, mover: M) {
        mover.pack((self.placed, self.plan.vertex_count), self.plan.vertex_bits, self.out);
    }
}
