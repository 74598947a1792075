//! Rays side by side: what a packet of `N` lanes holds, how lanes get rays and give answers, and the turns of packets.
//!
//! ```text
//! until no ray is left
//!   for each packet: all of its lanes visit the node (or the leaf) that they are at      (`avx2`, `avx512`)
//!     child is there    -> down to it                 down, up and on are all computed, masks choose
//!     child is missing  -> out of the empty cube, up to the node that holds the next cell too
//!     a leaf above units that nobody has looked below yet -> its lane asks where its children are       (`lower`)
//!     lanes that ended give their answers and get the next rays
//!     what the lanes are at now is prefetched; the other packets' visits pass until it is looked at
//! ```
//!
//! The scalar walk (`traverse.rs`) goes down in a loop of its own; here going down one level is a visit like any
//! other, so that lanes need not agree. A ray makes 30 to 40 visits. Speed of single rays, eight lanes, sixteen: 1,
//! 5, 7.5.
//!
//! Tried and lost, by the speed left: gathers without prefetch (0.6: misses of two packets are under way, not of
//! all); 2 packets (0.8), 3 (0.95), 6 (1.0, but more lanes idle at the end of a batch); the code for eight lanes
//! compiled for AVX-512VL (1.1 where sixteen gain 1.5); huge pages for the octree (1.03); a visit in three parts,
//! each for all packets in turn (0.95); reciprocals instead of divisions when a ray enters (1.0).
//!
//! Addresses: nodes, bitmaps of the upper octree and bitmaps of units are three arrays with bases of their own, and a
//! lane keeps 32-bit places in them: of nodes, or of words of 8 bytes. Its height says in which it is: levels above the
//! finest leaves, so leaves of the upper octree are at [`Queue::FINER`], those of units below that, nodes above.
//!
//! Invariant: a lane stands at a node or leaf of the octree at all times, also one without a ray.

use crate::voxel::traverse::{Entry, Occluders, VoxelFound};
use trex_store::octree::{MAX_DEPTH, MAX_FINER, OctreeNode, UpperOctree};

const _: () = assert!(size_of::<OctreeNode>() == 12 && std::mem::offset_of!(OctreeNode, first) == 8);

/// True for an octree whose nodes and bitmaps are within 32-bit offsets of bytes.
pub(in crate::voxel) fn fits(octree: &UpperOctree) -> bool {
    size_of_val(octree.nodes()).max(size_of_val(octree.bitmaps())) <= u32::MAX as usize
}

/// The octree as lanes see it.
pub(in crate::voxel) struct Tree {
    /// Address of the nodes, and how far from there the bitmaps are.
    pub(super) nodes: u64,
    pub(super) bitmaps: u64,
    /// How far from these the bitmaps of units are.
    units: u64,
    /// The first node's first child.
    pub(super) first: *const i32,
    /// Height of the root.
    levels: u32,
    /// The last subvoxel along an axis.
    pub(super) last: u32,
    /// Leaves are whole cubes.
    pub(super) occluders: Occluders,
}

impl Tree {
    fn new<Q: Queue>(queue: &Q) -> Tree {
        let octree = queue.octree();
        let (nodes, bitmaps) = (octree.nodes().as_ptr(), octree.bitmaps().as_ptr());
        let levels = octree.grid().depth() as u32 + Q::FINER;
        let [nodes_at, bitmaps_at] = [nodes.expose_provenance(), bitmaps.expose_provenance()];
        Tree {
            nodes: nodes_at as u64,
            bitmaps: (bitmaps_at as u64).wrapping_sub(nodes_at as u64),
            units: 0,
            first: nodes.cast::<i32>().wrapping_add(2),
            levels,
            last: 4u32.pow(levels + 1) - 1,
            occluders: queue.occluders(),
        }
    }

    /// How far from the bitmaps of the upper octree those of units are.
    pub(super) fn units(&self) -> u64 {
        self.units
    }

    /// Address of a bitmap of a unit.
    #[inline(always)]
    fn unit_bitmap(&self, place: u32) -> u64 {
        self.nodes.wrapping_add(self.bitmaps).wrapping_add(self.units).wrapping_add(8 * u64::from(place))
    }

    /// The base of the bitmaps of units is at an address from now on.
    pub(super) fn set_units(&mut self, address: u64) {
        self.units = address.wrapping_sub(self.nodes.wrapping_add(self.bitmaps));
    }
}

/// Place of the children of a leaf that nobody has looked below.
pub(super) const UNKNOWN: u32 = u32::MAX;

/// Rays that wait, what is below the upper octree's leaves, and where answers go.
pub(in crate::voxel) trait Queue {
    /// Levels of leaves below those of the upper octree.
    const FINER: u32;
    /// What a lane remembers of what it asked.
    type Note: Copy + Default;

    fn octree(&self) -> &UpperOctree;

    fn occluders(&self) -> Occluders;

    /// The next ray that enters the cube; those before it that do not are answered.
    fn next(&mut self) -> Option<(usize, Entry)>;

    /// The ray of a lane has met the voxel at which the lane stands.
    fn hit<const N: usize>(&mut self, packet: &Packet<N>, lane: usize, note: &Self::Note);

    /// A ray has met nothing.
    fn miss(&mut self, ray: usize);

    /// Address of what a lane that has come to a linking node may ask for.
    fn near<const N: usize>(&self, packet: &Packet<N>, lane: usize) -> u64;

    /// Looks where the children are of the leaf at which a lane stands, and moves the lane there; false when the ray
    /// is answered instead.
    fn ask<const N: usize>(
        &mut self,
        packet: &mut Packet<N>,
        lane: usize,
        note: &mut Self::Note,
        tree: &mut Tree,
    ) -> bool;
}

/// A number per lane, as a register of up to 64 bytes takes it.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(in crate::voxel) struct Row<T, const N: usize>(pub(super) [T; N]);

/// Lanes that cannot go on by themselves: whose rays ended, and which are at a leaf whose children are unknown.
pub(super) struct Ends {
    pub(super) hit: u32,
    pub(super) miss: u32,
    pub(super) asks: u32,
    /// Those that have come to a linking node.
    pub(super) nears: u32,
}

/// `N` rays and where they are. See `Entry` and `VoxelScene::walk`.
#[derive(Clone, Copy)]
pub(in crate::voxel) struct Packet<const N: usize> {
    pub(super) origin: [Row<f32, N>; 3],
    pub(super) direction: [Row<f32, N>; 3],
    pub(super) inverse: [Row<f32, N>; 3],
    pub(super) t_max: Row<f32, N>,
    pub(super) flip: Row<u32, N>,
    pub(super) cell: [Row<u32, N>; 3],
    pub(super) t: Row<f32, N>,
    pub(super) axis: Row<u32, N>,
    /// Levels above the finest leaves.
    pub(super) height: Row<u32, N>,
    /// The node or leaf.
    pub(super) at: Row<u32, N>,
    /// Address of its mask or bitmap, in the order of [`slot`].
    pub(super) address: Row<u64, N>,
    /// Leaf and nodes on the way to it by height; above the greatest there is only the root, 0.
    pub(super) path: [Row<u32, N>; MAX_DEPTH + MAX_FINER],
    /// The first child of the leaf on the way, by its height less one; or `UNKNOWN`.
    pub(super) below: [Row<u32, N>; MAX_FINER],
    /// Lanes with a ray.
    busy: u32,
    /// Index of the lane's ray, and its distance to the cube.
    pub(super) ray: [usize; N],
    pub(super) t_in: [f64; N],
}

/// Place of a lane's 64 bits: registers are unpacked within parts of four words, their lower pairs first.
fn slot<const N: usize>(lane: usize) -> usize {
    let (part, place) = (lane / 4, lane % 4);
    place / 2 * (N / 2) + 2 * part + place % 2
}

/// Answers all rays of `queue` with `PACKETS` packets of `N`, which `visit` moves.
#[inline(always)]
pub(super) fn take_turns<const N: usize, const PACKETS: usize, Q: Queue>(
    queue: &mut Q,
    visit: impl Fn(&mut Packet<N>, &Tree) -> Ends,
    prefetch: impl Fn(u64),
) {
    let mut tree = Tree::new(queue);
    let mut packets = [Packet::<N>::idle(&tree); PACKETS];
    let mut notes = [[Q::Note::default(); N]; PACKETS];
    for lane in 0..N {
        for packet in &mut packets {
            packet.refill(lane, queue, &tree);
        }
    }
    loop {
        let mut busy = 0;
        for (packet, notes) in packets.iter_mut().zip(&mut notes) {
            let ends = visit(packet, &tree);
            let mut ended = (ends.hit | ends.miss) & packet.busy;
            for lane in lanes(ended) {
                if ends.hit >> lane & 1 == 1 {
                    queue.hit(packet, lane, &notes[lane]);
                } else {
                    queue.miss(packet.ray[lane]);
                }
            }
            for lane in lanes(ends.asks & packet.busy) {
                let goes_on = queue.ask(packet, lane, &mut notes[lane], &mut tree);
                ended |= u32::from(!goes_on) << lane;
            }
            for lane in lanes(ends.nears) {
                prefetch(queue.near(packet, lane));
            }
            for lane in lanes(ended) {
                packet.refill(lane, queue, &tree);
            }
            busy |= packet.busy;
            // By way of memory: taking words out of registers costs more than loads do.
            for address in &std::hint::black_box(&packet.address).0 {
                prefetch(*address);
            }
        }
        if busy == 0 {
            return;
        }
    }
}

/// Places of the bits that are set.
#[inline(always)]
fn lanes(mut bits: u32) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let lane = (bits != 0).then(|| bits.trailing_zeros() as usize);
        bits &= bits.wrapping_sub(1);
        lane
    })
}

impl<const N: usize> Packet<N> {
    /// A packet without rays, all lanes at the root.
    fn idle(tree: &Tree) -> Packet<N> {
        let (zeros, zero) = (Row([0; N]), Row([0.0; N]));
        Packet {
            origin: [zero; 3],
            direction: [zero; 3],
            inverse: [zero; 3],
            t_max: Row([-1.0; N]),
            flip: zeros,
            cell: [zeros; 3],
            t: zero,
            axis: zeros,
            height: Row([tree.levels; N]),
            at: zeros,
            address: Row([tree.nodes; N]),
            path: [zeros; MAX_DEPTH + MAX_FINER],
            below: [Row([UNKNOWN; N]); MAX_FINER],
            busy: 0,
            ray: [0; N],
            t_in: [0.0; N],
        }
    }

    /// Gives the lane the next ray of `queue`. Without one it stays where it is.
    #[inline(always)]
    fn refill(&mut self, lane: usize, queue: &mut impl Queue, tree: &Tree) {
        let Some((ray, entry)) = queue.next() else {
            self.busy &= !(1 << lane);
            return;
        };
        self.enter(lane, &entry, tree);
        (self.ray[lane], self.t_in[lane]) = (ray, entry.t_in);
        self.busy |= 1 << lane;
    }

    #[inline(always)]
    fn enter(&mut self, lane: usize, entry: &Entry, tree: &Tree) {
        let cell = entry.first_cell(tree.last);
        for a in 0..3 {
            self.origin[a].0[lane] = entry.origin[a];
            self.direction[a].0[lane] = entry.direction[a];
            self.inverse[a].0[lane] = entry.inverse[a];
            self.cell[a].0[lane] = cell[a];
        }
        self.t_max.0[lane] = entry.t_max;
        self.t.0[lane] = 0.0;
        self.flip.0[lane] = entry.flip;
        self.axis.0[lane] = entry.axis as u32;
        self.height.0[lane] = tree.levels;
        self.at.0[lane] = 0;
        self.address.0[slot::<N>(lane)] = tree.nodes;
    }

    /// Puts a lane at the child of its leaf that holds its cell, if that is there; the first child is in place `first`.
    #[inline(always)]
    pub(super) fn descend(&mut self, lane: usize, first: u32, bits: u64, tree: &Tree) {
        let height = self.height.0[lane] as usize;
        self.below[height - 1].0[lane] = first;
        let cell: [u32; 3] = std::array::from_fn(|a| self.cell[a].0[lane] >> (2 * height) & 3);
        let place = (cell[0] | cell[1] << 2 | cell[2] << 4) ^ self.flip.0[lane];
        if bits >> place & 1 == 0 {
            return;
        }
        let at = first + (bits & ((1 << place) - 1)).count_ones();
        self.height.0[lane] = height as u32 - 1;
        self.at.0[lane] = at;
        self.path[height - 1].0[lane] = at;
        if height > 1 {
            self.below[height - 2].0[lane] = UNKNOWN;
        }
        self.address.0[slot::<N>(lane)] = tree.unit_bitmap(at);
    }

    /// The voxel at which a lane stands, by the leaf of the upper octree that it is in or is.
    #[inline(always)]
    pub(super) fn found<Q: Queue>(&self, lane: usize) -> VoxelFound {
        let leaf = Q::FINER as usize;
        VoxelFound {
            t: self.t.0[lane],
            node: self.path[leaf + 1].0[lane],
            leaf: self.path[leaf].0[lane],
            axis: self.axis.0[lane] as usize,
        }
    }
}
