//! `Edges`: which triangles of a cluster have an edge, looked up by its ends.
//!
//! A triangle has an edge from each corner to the next, in its own direction: a neighbour has it the other way round.
//!
//! Invariant: several triangles may have the same one.

use crate::layout::CLUSTER_TRIANGLES;

/// Lists of ways.
const SLOT_BITS: u32 = 10;
/// The end of a list.
const END: u16 = u16::MAX;

/// Way `3 t + e` is triangle `t` from its corner `e` on.
pub(super) struct Edges {
    /// The last way in each list.
    heads: [u16; 1 << SLOT_BITS],
    /// By way: the edge, and the way before it in the list.
    ways: [(u16, u16); 3 * CLUSTER_TRIANGLES],
}

impl Default for Edges {
    fn default() -> Edges {
        Edges { heads: [END; 1 << SLOT_BITS], ways: [(0, END); 3 * CLUSTER_TRIANGLES] }
    }
}

impl Edges {
    /// Takes the edges of these triangles, and forgets others.
    pub(super) fn fill(&mut self, triangles: &[[u8; 3]]) {
        self.heads.fill(END);
        for (t, &[a, b, c]) in triangles.iter().enumerate() {
            for (e, (from, to)) in [(a, b), (b, c), (c, a)].into_iter().enumerate() {
                let edge = edge(from, to);
                let head = &mut self.heads[slot(edge)];
                self.ways[3 * t + e] = (edge, *head);
                *head = (3 * t + e) as u16;
            }
        }
    }

    /// The ways whose first edge leads from one vertex to the other.
    pub(super) fn ways(&self, from: u8, to: u8) -> impl Iterator<Item = usize> {
        let wanted = edge(from, to);
        let mut at = self.heads[slot(wanted)];
        std::iter::from_fn(move || {
            while at != END {
                let way = usize::from(at);
                let (edge, before) = self.ways[way];
                at = before;
                if edge == wanted {
                    return Some(way);
                }
            }
            None
        })
    }
}

fn edge(from: u8, to: u8) -> u16 {
    u16::from(from) << 8 | u16::from(to)
}

fn slot(edge: u16) -> usize {
    usize::from(edge.wrapping_mul(0x9e37) >> (u16::BITS - SLOT_BITS))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Against a look at every triangle, also after other triangles.
        #[test]
        fn all_ways_of_an_edge_are_found(
            triangles in proptest::collection::vec(proptest::array::uniform3(0u8..12), 0..=CLUSTER_TRIANGLES),
            others in proptest::collection::vec(any::<[u8; 3]>(), 0..=CLUSTER_TRIANGLES),
        ) {
            let mut edges = Edges::default();
            edges.fill(&others);
            edges.fill(&triangles);
            for (from, to) in (0..12).flat_map(|from| (0..12).map(move |to| (from, to))) {
                let has = |way: &usize| {
                    let corners = triangles[way / 3];
                    (corners[way % 3], corners[(way + 1) % 3]) == (from, to)
                };
                let mut found: Vec<_> = edges.ways(from, to).collect();
                found.sort_unstable();
                prop_assert_eq!(found, (0..3 * triangles.len()).filter(has).collect::<Vec<_>>());
            }
        }
    }
}
