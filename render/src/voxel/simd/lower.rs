//! Rays through the upper octree and the units below it, for lanes: where the children of leaves are.
//!
//! ```text
//! lane at a leaf, in a subvoxel that is set, and nobody knows where its children are:
//!   linking node -> word -> page -> frame: held for all of the batch     (the last ones are remembered)
//!     no more can be held, or out of reach  -> crowded: the ray leaves the lanes, and is asked otherwise
//!     missing                               -> blocked; or the subvoxel stands in, if that is wanted
//!     damaged, or no such unit              -> the subvoxel is what is hit
//!   node of the unit -> its first leaf -> place of that one's bitmap: the lane goes down, and to siblings by itself
//! ```
//!
//! Places of bitmaps in frames are words of 8 bytes from a base. It is put `REACH` before the first frame that is held,
//! so that they are 32-bit numbers for frames up to 16 GiB before and behind that one: all of a pool, as a rule.
//!
//! Speed, where the upper octree of the same finest resolution has 1: iso-surface 0.77 (gather rays) and 0.72 to 0.84
//! (shadow rays), pipes 0.59 to 0.69 and 0.70 to 0.72; 4 to 5 times the scalar walk. 256/1024, on a busy machine.
//!
//! Tried and lost, by the speed left: asking in two turns, with the node's cache line fetched in between (0.8 to 0.95);
//! 64 pages remembered (about 0.8: look-ups went to `pages` and to heads of frames). Neither seen to win nor to lose:
//! the words of linking nodes prefetched when a lane comes to one.
//!
//! Invariants: 1. lanes stand in frames that `pages` lends for all of the walk; 2. a page is looked up only when a ray
//! meets a subvoxel above it, as in `voxel::lower`, so that the same rays are blocked by the same pages.

use super::packet::{Packet, Queue, Tree, UNKNOWN};
use crate::trace::{Page, Pages};
use crate::voxel::lower::{LowerFound, LowerLeaf, LowerScene, MissingUnits};
use crate::voxel::traverse::{Entry, Occluders};
use trex_store::octree::{MAX_FINER, UnitRef, UnitsView, UpperOctree};

/// How far from the first frame others may be, bytes.
const REACH: u64 = 1 << 34;
/// Bytes of a bitmap.
const WORD_BYTES: u64 = 8;
/// Pages whose frames are remembered: gather rays of a tile go to all of the model. 32 KiB.
const SLOTS: usize = 1024;

/// What became of a ray.
#[derive(Clone, Copy, Debug)]
pub(in crate::voxel) enum Outcome {
    /// It met a voxel.
    Hit(LowerFound),
    /// It met nothing.
    Miss,
    /// This page is missing: no answer, or a voxel in the place of those that it has.
    Missing(u32, Option<LowerFound>),
    /// A page cannot be held beside the others: no answer.
    Crowded,
}

/// What a lane knows of the leaves of units that it stands in, by their height.
#[derive(Clone, Copy, Default)]
pub(in crate::voxel) struct Note {
    /// The page.
    page: [u32; MAX_FINER],
    /// Place of the page's first bitmap.
    zero: [u32; MAX_FINER],
    /// The unit whose nodes are the leaves at height 1.
    link: Option<UnitRef>,
}

/// A page of units that is held.
#[derive(Clone, Copy)]
struct HeldPage<'a> {
    page: u32,
    view: UnitsView<'a>,
    /// Place of its first bitmap.
    zero: u32,
}

/// The rays of a batch that wait, and where answers go.
pub(in crate::voxel) struct LowerQueue<'a, E, A, const FINER: u32> {
    scene: &'a LowerScene<'a>,
    octree: &'a UpperOctree,
    /// Gives rays by index.
    entry: &'a E,
    waiting: std::slice::Iter<'a, u32>,
    pages: &'a dyn Pages,
    held: Vec<Option<HeldPage<'a>>>,
    /// Address of place 0.
    base: Option<u64>,
    /// Index of the first linking node.
    first_link: u32,
    answer: A,
}

impl<'a, E: Fn(usize) -> Option<Entry>, A: FnMut(u32, Outcome), const FINER: u32>
    LowerQueue<'a, E, A, FINER>
{
    /// The queue of the rays whose indices wait, through pages that are held from now on.
    pub(in crate::voxel) fn new(
        scene: &'a LowerScene<'a>,
        (waiting, entry): (&'a [u32], &'a E),
        pages: &'a dyn Pages,
        answer: A,
    ) -> LowerQueue<'a, E, A, FINER> {
        let octree = scene.upper().octree();
        LowerQueue {
            scene,
            octree,
            entry,
            waiting: waiting.iter(),
            pages,
            held: vec![None; SLOTS],
            base: None,
            first_link: (octree.nodes().len() - octree.last_nodes().len()) as u32,
            answer,
        }
    }

    /// The frame of a page, held, or what becomes of the ray without.
    #[inline(always)]
    fn hold(&mut self, page: u32, tree: &mut Tree) -> Result<&HeldPage<'a>, Without> {
        let slot = page as usize % SLOTS;
        if !matches!(&self.held[slot], Some(held) if held.page == page) {
            self.held[slot] = Some(self.look_up(page, tree)?);
        }
        Ok(self.held[slot].as_ref().expect("it is held"))
    }

    #[inline(never)]
    fn look_up(&mut self, page: u32, tree: &mut Tree) -> Result<HeldPage<'a>, Without> {
        let frame = match self.pages.hold(page) {
            None => return Err(Without::Room),
            Some(Page::Missing) => return Err(Without::Page(page)),
            Some(Page::Damaged) => return Err(Without::Unit),
            Some(Page::Ready(frame)) => frame.bytes(),
        };
        let view = UnitsView::new(frame);
        let bitmaps = view.bitmaps();
        let address = bitmaps.as_ptr().expose_provenance() as u64;
        let base = *self.base.get_or_insert_with(|| {
            let base = address.saturating_sub(REACH) / WORD_BYTES * WORD_BYTES;
            tree.set_units(base);
            base
        });
        let offset = address.checked_sub(base).filter(|offset| offset.is_multiple_of(WORD_BYTES));
        let place = offset.map(|offset| offset / WORD_BYTES);
        // All of its bitmaps are below the place that says nothing.
        let end = place.map(|place| place + bitmaps.len() as u64 / WORD_BYTES);
        match (place, end) {
            (Some(place), Some(end)) if end < u64::from(UNKNOWN) => {
                Ok(HeldPage { page, view, zero: place as u32 })
            }
            _ => Err(Without::Room),
        }
    }

    /// Moves a lane down from the leaf at which it stands.
    #[inline(always)]
    fn go_down<const N: usize>(
        &mut self,
        packet: &mut Packet<N>,
        lane: usize,
        note: &mut Note,
        tree: &mut Tree,
    ) -> Result<(), Without> {
        let (height, at) = (packet.height.0[lane] as usize, packet.at.0[lane]);
        let (unit, rank, bits) = if height == FINER as usize {
            let node = packet.path[height + 1].0[lane];
            let unit = self.scene.links.unit((node - self.first_link) as usize);
            let rank = at - self.octree.nodes()[node as usize].first;
            (unit, rank, self.octree.bitmaps()[at as usize])
        } else {
            let unit = note.link.ok_or(Without::Unit)?;
            let outer = self.hold(note.page[height], tree)?;
            (unit, at - packet.below[height].0[lane], outer.view.bitmap(at - outer.zero))
        };
        let HeldPage { view, zero, .. } = *self.hold(unit.page(), tree)?;
        // A unit that is not what the leaf says is none.
        let node = view.node(unit.unit(), rank).filter(|node| node.leaf_count() == bits.count_ones());
        let node = node.ok_or(Without::Unit)?;
        (note.page[height - 1], note.zero[height - 1]) = (unit.page(), zero);
        if height > 1 {
            note.link = node.link;
        }
        packet.descend(lane, zero + node.first_leaf(), bits, tree);
        Ok(())
    }

    /// The voxel at which a lane stands.
    fn found<const N: usize>(&self, packet: &Packet<N>, lane: usize, note: &Note) -> LowerFound {
        let height = packet.height.0[lane] as usize;
        let lower = (height < FINER as usize)
            .then(|| LowerLeaf { page: note.page[height], leaf: packet.at.0[lane] - note.zero[height] });
        LowerFound { t_in: packet.t_in[lane], found: packet.found::<Self>(lane), lower, is_stand_in: false }
    }
}

/// Why nothing is known of the children of a leaf.
#[derive(Clone, Copy)]
enum Without {
    /// The page is missing.
    Page(u32),
    /// It cannot be held.
    Room,
    /// There is no such unit to be had.
    Unit,
}

impl<E: Fn(usize) -> Option<Entry>, A: FnMut(u32, Outcome), const FINER: u32> Queue
    for LowerQueue<'_, E, A, FINER>
{
    const FINER: u32 = FINER;
    type Note = Note;

    fn octree(&self) -> &UpperOctree {
        self.octree
    }

    fn occluders(&self) -> Occluders {
        self.scene.upper().occluders()
    }

    #[inline(always)]
    fn next(&mut self) -> Option<(usize, Entry)> {
        for &index in &mut self.waiting {
            match (self.entry)(index as usize) {
                Some(entry) => return Some((index as usize, entry)),
                None => (self.answer)(index, Outcome::Miss),
            }
        }
        None
    }

    #[inline(always)]
    fn hit<const N: usize>(&mut self, packet: &Packet<N>, lane: usize, note: &Note) {
        let found = self.found(packet, lane, note);
        (self.answer)(packet.ray[lane] as u32, Outcome::Hit(found));
    }

    #[inline(always)]
    fn miss(&mut self, ray: usize) {
        (self.answer)(ray as u32, Outcome::Miss);
    }

    #[inline(always)]
    fn near<const N: usize>(&self, packet: &Packet<N>, lane: usize) -> u64 {
        let number = packet.at.0[lane].wrapping_sub(self.first_link) as usize;
        self.scene.links.words().as_ptr().wrapping_add(number).addr() as u64
    }

    #[inline(always)]
    fn ask<const N: usize>(
        &mut self,
        packet: &mut Packet<N>,
        lane: usize,
        note: &mut Note,
        tree: &mut Tree,
    ) -> bool {
        let outcome = match self.go_down(packet, lane, note, tree) {
            Ok(()) => return true,
            Err(Without::Room) => Outcome::Crowded,
            Err(Without::Unit) => Outcome::Hit(self.found(packet, lane, note)),
            Err(Without::Page(page)) => {
                let found = (self.scene.missing() == MissingUnits::StandIn)
                    .then(|| LowerFound { is_stand_in: true, ..self.found(packet, lane, note) });
                Outcome::Missing(page, found)
            }
        };
        (self.answer)(packet.ray[lane] as u32, outcome);
        false
    }
}
