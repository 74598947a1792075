//! Rays through the upper octree alone, for lanes.

use super::packet::{Packet, Queue, Tree};
use crate::voxel::traverse::{Entry, Occluders, VoxelFound, VoxelScene};
use trex_store::octree::UpperOctree;

/// Rays that wait, and where answers go.
pub(in crate::voxel) struct UpperQueue<'a, E, A> {
    scene: &'a VoxelScene<'a>,
    /// Count of rays, and what gives them by index.
    count: usize,
    entry: E,
    /// Rays before this one are answered or under way.
    taken: usize,
    answer: A,
}

impl<'a, E, A> UpperQueue<'a, E, A>
where
    E: Fn(usize) -> Option<Entry>,
    A: FnMut(usize, Option<(f64, VoxelFound)>),
{
    /// The queue of so many rays, to be answered by index, with their distances to the cube.
    pub(in crate::voxel) fn new(
        scene: &'a VoxelScene<'a>,
        (count, entry): (usize, E),
        answer: A,
    ) -> UpperQueue<'a, E, A> {
        UpperQueue { scene, count, entry, taken: 0, answer }
    }
}

impl<E, A> Queue for UpperQueue<'_, E, A>
where
    E: Fn(usize) -> Option<Entry>,
    A: FnMut(usize, Option<(f64, VoxelFound)>),
{
    const FINER: u32 = 0;
    type Note = ();

    fn octree(&self) -> &UpperOctree {
        self.scene.octree()
    }

    fn occluders(&self) -> Occluders {
        self.scene.occluders()
    }

    #[inline(always)]
    fn next(&mut self) -> Option<(usize, Entry)> {
        while self.taken < self.count {
            let index = self.taken;
            self.taken += 1;
            match (self.entry)(index) {
                Some(entry) => return Some((index, entry)),
                None => (self.answer)(index, None),
            }
        }
        None
    }

    #[inline(always)]
    fn hit<const N: usize>(&mut self, packet: &Packet<N>, lane: usize, (): &()) {
        (self.answer)(packet.ray[lane], Some((packet.t_in[lane], packet.found::<Self>(lane))));
    }

    #[inline(always)]
    fn miss(&mut self, ray: usize) {
        (self.answer)(ray, None);
    }

    #[inline(always)]
    fn near<const N: usize>(&self, _: &Packet<N>, _: usize) -> u64 {
        unreachable!("there is nothing below")
    }

    #[inline(always)]
    fn ask<const N: usize>(&mut self, _: &mut Packet<N>, _: usize, (): &mut (), _: &mut Tree) -> bool {
        unreachable!("there is nothing below")
    }
}
