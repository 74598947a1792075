//! Rays side by side: what a packet of `N` lanes holds, how lanes get rays and give answers, and the turns of packets.
//!
//! ```text
//! until no ray is left
//!   for each packet: all of its lanes visit the node (or the leaf) that they are at      (`avx2`, `avx512`)
//!     child is there    -> down to it                 down, up and on are all computed, masks choose
//!     child is missing  -> out of the empty cube, up to the node that holds the next cell too
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
//! Invariant: a lane stands at a node or leaf of the octree at all times, also one without a ray.

use crate::trace::Ray;
use crate::voxel::traverse::{Entry, Found, Occluders, VoxelHit, VoxelScene};
use trex_store::octree::{MAX_DEPTH, OctreeNode, UpperOctree};

const _: () = assert!(size_of::<OctreeNode>() == 12 && std::mem::offset_of!(OctreeNode, first) == 8);

/// True for an octree whose nodes and bitmaps are within 32-bit offsets of bytes.
pub(in crate::voxel) fn fits(octree: &UpperOctree) -> bool {
    size_of_val(octree.nodes()).max(size_of_val(octree.bitmaps())) <= u32::MAX as usize
}

/// The octree as lanes see it.
pub(super) struct Tree {
    /// Address of the nodes, and how far from there the bitmaps are.
    pub(super) nodes: u64,
    pub(super) bitmaps: u64,
    /// The first node's first child.
    pub(super) first: *const i32,
    /// Levels above the leaves.
    depth: u32,
    /// The last subvoxel along an axis.
    pub(super) last: u32,
    /// Leaves are whole cubes.
    pub(super) occluders: Occluders,
}

impl Tree {
    fn new(octree: &UpperOctree, occluders: Occluders) -> Tree {
        let (nodes, bitmaps) = (octree.nodes().as_ptr(), octree.bitmaps().as_ptr());
        let depth = octree.grid().depth() as u32;
        let [nodes_at, bitmaps_at] = [nodes.expose_provenance(), bitmaps.expose_provenance()];
        Tree {
            nodes: nodes_at as u64,
            bitmaps: (bitmaps_at as u64).wrapping_sub(nodes_at as u64),
            first: nodes.cast::<i32>().wrapping_add(2),
            depth,
            last: 4u32.pow(depth + 1) - 1,
            occluders,
        }
    }
}

/// A number per lane, as a register of up to 64 bytes takes it.
#[derive(Clone, Copy)]
#[repr(C, align(64))]
pub(super) struct Row<T, const N: usize>(pub(super) [T; N]);

/// Lanes whose rays ended.
pub(super) struct Ends {
    pub(super) hit: u32,
    pub(super) miss: u32,
}

/// `N` rays and where they are. See `Entry` and `VoxelScene::walk`.
#[derive(Clone, Copy)]
pub(super) struct Packet<const N: usize> {
    pub(super) origin: [Row<f32, N>; 3],
    pub(super) direction: [Row<f32, N>; 3],
    pub(super) inverse: [Row<f32, N>; 3],
    pub(super) t_max: Row<f32, N>,
    pub(super) flip: Row<u32, N>,
    pub(super) cell: [Row<u32, N>; 3],
    pub(super) t: Row<f32, N>,
    pub(super) axis: Row<u32, N>,
    /// Levels above the leaves; at 0 a lane is at a leaf.
    pub(super) height: Row<u32, N>,
    /// The node or leaf.
    pub(super) at: Row<u32, N>,
    /// Address of its mask or bitmap, in the order of [`slot`].
    pub(super) address: Row<u64, N>,
    /// Leaf and nodes on the way to it by height; above the greatest there is only the root, 0.
    pub(super) path: [Row<u32, N>; MAX_DEPTH],
    /// Lanes with a ray.
    busy: u32,
    /// Index of the lane's ray, and its distance to the cube.
    ray: [usize; N],
    t_in: [f64; N],
}

/// Place of a lane's 64 bits: registers are unpacked within parts of four words, their lower pairs first.
fn slot<const N: usize>(lane: usize) -> usize {
    let (part, place) = (lane / 4, lane % 4);
    place / 2 * (N / 2) + 2 * part + place % 2
}

/// Answers all rays of `queue` with `PACKETS` packets of `N`, which `visit` moves.
#[inline(always)]
pub(super) fn take_turns<const N: usize, const PACKETS: usize>(
    queue: &mut Queue<'_, impl FnMut(usize, Option<VoxelHit>)>,
    visit: impl Fn(&mut Packet<N>, &Tree) -> Ends,
    prefetch: impl Fn(u64),
) {
    let tree = Tree::new(queue.scene.octree(), queue.scene.occluders());
    let mut packets = [Packet::<N>::idle(&tree); PACKETS];
    for lane in 0..N {
        for packet in &mut packets {
            packet.refill(lane, queue, &tree);
        }
    }
    loop {
        let mut busy = 0;
        for packet in &mut packets {
            let ends = visit(packet, &tree);
            let mut ended = (ends.hit | ends.miss) & packet.busy;
            while ended != 0 {
                let lane = ended.trailing_zeros() as usize;
                ended &= ended - 1;
                let found = (ends.hit >> lane & 1 == 1).then(|| (packet.t_in[lane], packet.found(lane)));
                queue.answer(packet.ray[lane], found);
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

/// Rays that wait, and where answers go.
pub(in crate::voxel) struct Queue<'a, A> {
    pub(in crate::voxel) scene: &'a VoxelScene<'a>,
    rays: &'a [Ray],
    /// Rays before this one are answered or under way.
    taken: usize,
    answer: A,
}

impl<'a, A: FnMut(usize, Option<VoxelHit>)> Queue<'a, A> {
    /// The queue of all `rays`, to be answered by place.
    pub(in crate::voxel) fn new(scene: &'a VoxelScene<'a>, rays: &'a [Ray], answer: A) -> Queue<'a, A> {
        Queue { scene, rays, taken: 0, answer }
    }

    /// The next ray that enters the cube; those before it that do not are answered.
    #[inline(always)]
    pub(in crate::voxel) fn next(&mut self) -> Option<(usize, Entry)> {
        while let Some(ray) = self.rays.get(self.taken) {
            let index = self.taken;
            self.taken += 1;
            match self.scene.enter(ray) {
                Some(entry) => return Some((index, entry)),
                None => (self.answer)(index, None),
            }
        }
        None
    }

    /// Answers `ray` with what its walk found, and its distance to the cube.
    #[inline(always)]
    pub(in crate::voxel) fn answer(&mut self, ray: usize, found: Option<(f64, Found)>) {
        (self.answer)(ray, found.map(|(t_in, found)| self.scene.hit_of(t_in, &found)));
    }
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
            height: Row([tree.depth; N]),
            at: zeros,
            address: Row([tree.nodes; N]),
            path: [zeros; MAX_DEPTH],
            busy: 0,
            ray: [0; N],
            t_in: [0.0; N],
        }
    }

    /// Gives the lane the next ray of `queue`. Without one it stays where it is.
    #[inline(always)]
    fn refill(
        &mut self,
        lane: usize,
        queue: &mut Queue<'_, impl FnMut(usize, Option<VoxelHit>)>,
        tree: &Tree,
    ) {
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
        self.height.0[lane] = tree.depth;
        self.at.0[lane] = 0;
        self.address.0[slot::<N>(lane)] = tree.nodes;
    }

    /// The voxel at which a lane stands that hit.
    fn found(&self, lane: usize) -> Found {
        Found {
            t: self.t.0[lane],
            node: self.path[1].0[lane],
            leaf: self.at.0[lane],
            axis: self.axis.0[lane] as usize,
        }
    }
}
