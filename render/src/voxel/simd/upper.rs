//! Rays through the upper octree alone, for lanes.

use super::packet::{Packet, Queue, Tree};
use crate::trace::Ray;
use crate::voxel::traverse::{Entry, Occluders, VoxelHit, VoxelScene};
use trex_store::octree::UpperOctree;

/// Rays that wait, and where answers go.
pub(in crate::voxel) struct UpperQueue<'a, A> {
    scene: &'a VoxelScene<'a>,
    rays: &'a [Ray],
    /// Rays before this one are answered or under way.
    taken: usize,
    answer: A,
}

impl<'a, A: FnMut(usize, Option<VoxelHit>)> UpperQueue<'a, A> {
    /// The queue of all `rays`, to be answered by place.
    pub(in crate::voxel) fn new(scene: &'a VoxelScene<'a>, rays: &'a [Ray], answer: A) -> UpperQueue<'a, A> {
        UpperQueue { scene, rays, taken: 0, answer }
    }
}

impl<A: FnMut(usize, Option<VoxelHit>)> Queue for UpperQueue<'_, A> {
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

    #[inline(always)]
    fn hit<const N: usize>(&mut self, packet: &Packet<N>, lane: usize, (): &()) {
        let hit = self.scene.hit_of(packet.t_in[lane], &packet.found::<Self>(lane));
        (self.answer)(packet.ray[lane], Some(hit));
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
