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

use super::bits::BitReader;
use super::cells::{self, Cells};
use super::encode::{AXIS_WIDTH_BITS, COUNT_BITS, Head};
use super::fields::{Machine, Mover, Work};
use super::install_leaves::{Boxes, Indices, InstalledLeaf, LeafIndexer};
use super::leaves;
use super::packing::VertexPacking;
use super::strips::{self, Topology};
use super::vertices::{self, CLASS_WIDTH_BITS, CLASSES, ClassWidths, VertexDecoder};
use super::view::ClusterHead;
use super::*;
use crate::layout::{CLUSTER_LEAVES, CLUSTER_TRIANGLES, CLUSTER_VERTICES, FRAME_BYTES};

// What a header holds in 16 bits: triangles before a cluster, and offsets in it. The indices of a triangle take 3 bits
// at least.
const LEAST_FULL_BYTES: usize =
    CLUSTER_HEAD_BYTES + CLUSTER_LEAVES * (LEAF_HEAD_BYTES + 1) + 3 * CLUSTER_TRIANGLES / 8;
const _: () = assert!(FRAME_BYTES / LEAST_FULL_BYTES * CLUSTER_TRIANGLES <= u16::MAX as usize);

/// Work memory for the clusters of a page.
pub(super) struct ClusterInstaller {
    machine: Machine,
    head: Head,
    lattice_bits: u32,
    first_triangle: usize,
    topology: Topology,
    placed: [u64; 256],
    /// By vertex.
    cells: Cells,
    /// Those of the cluster under way.
    leaves: [InstalledLeaf; CLUSTER_LEAVES],
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
    fn read(input: &mut BitReader<'_>, head: &Head, lattice_bits: u32) -> Result<ClusterPlan, &'static str> {
        let triangle_count = input.take(COUNT_BITS) as usize + 1;
        let vertex_count = input.take(COUNT_BITS) as usize + 1;
        let (wide, has_palette) = (input.take(1) == 1, input.take(1) == 1);
        let (leaf_count, leaf_sizes) = leaves::decode_sizes(input, triangle_count)?;
        let offset = head.offset_bits.map(|bits| input.take(u32::from(bits)) as i64);
        let base = std::array::from_fn(|a| head.anchor[a] + offset[a]);
        let bits: [u8; 3] = std::array::from_fn(|_| input.take(AXIS_WIDTH_BITS) as u8);
        let classes: ClassWidths =
            if wide { [0; CLASSES] } else { std::array::from_fn(|_| input.take(CLASS_WIDTH_BITS) as u32) };
        let palette_len = if has_palette { input.take(COUNT_BITS) as usize + 1 } else { 1 };
        let vertex_bits: u32 = bits.iter().map(|&b| u32::from(b)).sum();
        let packs = vertex_bits <= VERTEX_BITS && bits.iter().all(|&b| u32::from(b) <= AXIS_BITS);
        if triangle_count > CLUSTER_TRIANGLES
            || vertex_count > CLUSTER_VERTICES
            || palette_len > triangle_count
            || bits.iter().any(|&b| u32::from(b) > lattice_bits)
            || !(packs || wide)
            || base.iter().any(|&q: &i64| q >> lattice_bits != 0)
        {
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
    fn material_bits(&self, head: &Head) -> usize {
        self.palette_len * usize::from(head.material_bits)
            + self.triangle_count * palette_index_bits(self.palette_len)
    }
}

impl ClusterInstaller {
    pub(super) fn new(machine: Machine, head: Head, lattice_bits: u32) -> ClusterInstaller {
        ClusterInstaller {
            machine,
            head,
            lattice_bits,
            first_triangle: 0,
            topology: Topology::EMPTY,
            placed: [0; 256],
            cells: [0; 257],
            leaves: [InstalledLeaf::default(); CLUSTER_LEAVES],
        }
    }

    /// Triangles installed so far.
    pub(super) fn triangle_count(&self) -> usize {
        self.first_triangle
    }

    /// Installs the cluster at the front of `packed` at the start of `frame`; gives the bytes it takes there, and the
    /// box of its vertices. Behind them stand [`FRAME_TAIL_BYTES`] zeros.
    pub(super) fn install(
        &mut self,
        packed: &mut &[u8],
        frame: &mut [u8],
    ) -> Result<(usize, LatticeBox), &'static str> {
        let mut input = BitReader::new(packed);
        let plan = ClusterPlan::read(&mut input, &self.head, self.lattice_bits)?;
        let mut materials = input;
        input.skip(plan.material_bits(&self.head));
        let counts = (plan.triangle_count, plan.vertex_count);
        let machine = self.machine;
        machine.run(Strips { input: &mut input, counts, topology: &mut self.topology })?;
        let leaves = &mut self.leaves[..plan.leaf_count];
        machine.run(LeafIndexer { corners: &self.topology.corners, sizes: &plan.leaf_sizes, leaves });
        let places = PartPlaces::new(&plan, leaves);
        let Some(frame) = frame.get_mut(..places.end + FRAME_TAIL_BYTES) else {
            return Err("a page does not fit its frame");
        };
        machine.run(Indices { leaves, frame });
        self.materials(&mut materials, &plan, &mut frame[places.palette..places.vertices])?;
        let vertices = &mut frame[places.vertices..];
        let bounds = if plan.widths.wide {
            self.wide_vertices(&mut input, &plan, vertices)
        } else {
            machine.run(Vertices { installer: self, input: &mut input, plan: &plan, frame: vertices })
        };
        if !input.align() || !input.is_sound() {
            return Err("the bits of a cluster are more or fewer than its counts say");
        }
        if bounds.hi.iter().any(|q| q >> self.lattice_bits != 0) {
            return Err("a vertex lies behind the lattice");
        }
        self.write_head(&plan, &places, frame);
        let leaves = &self.leaves[..plan.leaf_count];
        machine.run(Boxes { leaves, starts: self.topology.starts, cells: &self.cells, frame });
        self.first_triangle += plan.triangle_count;
        *packed = &packed[input.byte_count()..];
        Ok((places.end, bounds))
    }

    fn write_head(&self, plan: &ClusterPlan, places: &PartPlaces, frame: &mut [u8]) {
        let five = |q: i64| q.to_le_bytes()[..5].try_into().expect("five of eight bytes");
        let head = ClusterHead {
            base: plan.widths.base.map(five),
            widths: plan.widths.bits,
            vertex_bits: plan.vertex_bits as u8,
            triangle_count: plan.triangle_count as u8,
            vertex_count: plan.vertex_count as u8,
            palette_len: plan.palette_len as u8,
            first_triangle: (self.first_triangle as u16).to_le_bytes(),
            palette_at: (places.palette as u16).to_le_bytes(),
            vertices_at: (places.vertices as u16).to_le_bytes(),
            leaf_count: plan.leaf_count as u8,
        };
        frame[..CLUSTER_HEAD_BYTES].copy_from_slice(bytemuck::bytes_of(&head));
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
            *material = (input.take(u32::from(self.head.material_bits)) as u16).to_le_bytes();
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

    /// Vertices of a compact cluster, to the end of its frame bytes. Gives their box.
    #[inline(always)]
    fn vertices<M: Mover>(
        &mut self,
        mover: M,
        input: &mut BitReader<'_>,
        plan: &ClusterPlan,
        frame: &mut [u8],
    ) -> LatticeBox {
        let packing = VertexPacking::new(&plan.widths);
        let guides = &self.topology.guides;
        let coded = VertexDecoder { packing, classes: plan.classes, count: plan.vertex_count, guides };
        coded.decode(mover, input, &mut self.placed);
        let vertices = &self.placed[..plan.vertex_count];
        cells::fill(&packing, plan.shift, vertices, &mut self.cells);
        let (mut at, mut pending, mut pending_bits) = (0, 0u64, 0);
        for &v in vertices {
            pending |= v << pending_bits;
            frame[at..at + 8].copy_from_slice(&pending.to_le_bytes());
            pending_bits += plan.vertex_bits;
            // In two steps, since all eight bytes may be full.
            let full = pending_bits / 8;
            pending = pending >> (4 * full) >> (4 * full);
            at += full as usize;
            pending_bits %= 8;
        }
        frame[at..at + 8].copy_from_slice(&pending.to_le_bytes());
        frame[at + 8..].fill(0);
        let base = plan.widths.base;
        let greatest = packing.greatest(&self.placed[..plan.vertex_count]);
        LatticeBox { lo: base, hi: std::array::from_fn(|a| base[a] + greatest[a] as i64) }
    }

    /// Vertices of a wide cluster. Gives their box.
    fn wide_vertices(
        &mut self,
        input: &mut BitReader<'_>,
        plan: &ClusterPlan,
        frame: &mut [u8],
    ) -> LatticeBox {
        let mut bounds = LatticeBox { lo: plan.widths.base, hi: plan.widths.base };
        let (vertices, tail) = frame.split_at_mut(plan.vertex_count * WIDE_VERTEX_BYTES);
        for (bytes, cell) in vertices.as_chunks_mut::<WIDE_VERTEX_BYTES>().0.iter_mut().zip(&mut self.cells) {
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
        tail.fill(0);
        bounds
    }
}

impl PartPlaces {
    fn new(plan: &ClusterPlan, leaves: &[InstalledLeaf]) -> PartPlaces {
        let indices: usize = leaves.iter().map(|leaf| leaf.shape.bytes()).sum();
        let palette = CLUSTER_HEAD_BYTES + leaves.len() * LEAF_HEAD_BYTES + indices;
        let vertices = palette + palette_bytes(plan.palette_len, plan.triangle_count);
        PartPlaces { palette, vertices, end: vertices + vertex_bytes(&plan.widths, plan.vertex_count) }
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
    frame: &'a mut [u8],
}

impl Work for Vertices<'_, '_> {
    type Output = LatticeBox;

    #[inline(always)]
    fn run<M: Mover>(self, mover: M) -> LatticeBox {
        self.installer.vertices(mover, self.input, self.plan, self.frame)
    }
}
