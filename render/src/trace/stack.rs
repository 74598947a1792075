//! The stack of a traversal: what is left to visit, the nearest on top.
//!
//! Invariant: it cannot overflow: depth is checked when tables and pages are read (`layout::TREE_DEPTH`).

use super::kernel::Lanes;
use trex_store::layout::{CLUSTER_LEAVES, NODE_WIDTH, TREE_DEPTH};

/// A node replaces itself by up to eight entries, at every level of the top tree and of a page; then 16 leaves. A
/// power of two, so that places need no check.
pub(super) const STACK: usize = (2 * TREE_DEPTH * (NODE_WIDTH - 1) + 2 + CLUSTER_LEAVES).next_power_of_two();

/// An entry of the stack: where to go on, and the t where its box begins, in one number that is ordered by t.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct StackEntry(u64);

impl StackEntry {
    /// `t >= 0`: the bits of such numbers are ordered as they are.
    #[inline(always)]
    pub(super) fn new(t: f32, word: u32) -> StackEntry {
        StackEntry(u64::from(t.to_bits()) << 32 | u64::from(word))
    }

    #[inline(always)]
    pub(super) fn t(self) -> f32 {
        f32::from_bits((self.0 >> 32) as u32)
    }

    #[inline(always)]
    pub(super) fn word(self) -> u32 {
        self.0 as u32
    }
}

impl<const N: usize> Lanes<N> {
    #[inline(always)]
    pub(super) fn entry(&self, lane: usize, word: u32) -> StackEntry {
        StackEntry::new(self.t[lane % N], word)
    }
}

/// Room for the entries of one ray at a time.
pub(super) struct Stack {
    pub(super) entries: Box<[StackEntry; STACK]>,
}

impl Stack {
    /// An empty stack.
    pub(super) fn new() -> Stack {
        Stack { entries: Box::new([StackEntry(0); STACK]) }
    }
}

/// The stack of what is left to visit; the nearest of a node on top. One for top tree, page and cluster together:
/// each level works above the `floor` where it began.
pub(super) struct VisitStack<'a> {
    pub(super) entries: &'a mut [StackEntry; STACK],
    pub(super) len: usize,
}

impl VisitStack<'_> {
    /// The topmost entry that begins before `t_max`.
    #[inline(always)]
    pub(super) fn pop_above(&mut self, floor: usize, t_max: f32) -> Option<StackEntry> {
        let last = StackEntry::new(t_max, u32::MAX);
        while self.len > floor {
            self.len -= 1;
            let entry = self.entries[self.len % STACK];
            if entry <= last {
                return Some(entry);
            }
        }
        None
    }

    #[inline(always)]
    fn put(&mut self, entry: StackEntry) {
        debug_assert!(self.len < STACK, "depth was checked when the tables were read");
        self.entries[self.len % STACK] = entry;
        self.len += 1;
    }

    /// Gives the nearest of the lanes that are set and puts the others, farthest first.
    #[inline(always)]
    pub(super) fn push(&mut self, mut mask: u32, entry: impl Fn(usize) -> StackEntry) -> Option<StackEntry> {
        let count = mask.count_ones();
        let mut take = || {
            let lane = mask.trailing_zeros() as usize;
            mask &= mask.wrapping_sub(1);
            entry(lane)
        };
        match count {
            0 => None,
            1 => Some(take()),
            2 => {
                let (a, b) = (take(), take());
                self.put(a.max(b));
                Some(a.min(b))
            }
            count => {
                let first = self.len;
                for _ in 0..count {
                    let new = take();
                    let mut at = self.len;
                    self.put(new);
                    while at > first && self.entries[(at - 1) % STACK] < new {
                        self.entries[at % STACK] = self.entries[(at - 1) % STACK];
                        at -= 1;
                    }
                    self.entries[at % STACK] = new;
                }
                self.len -= 1;
                Some(self.entries[self.len % STACK])
            }
        }
    }
}
