//! From records to leaves, and from the records of leaves to those of the leaves that are four times as large.
//!
//! ```text
//! records of a leaf, one per material -> OpenLeaf -> the leaf: all of them, its material of most area
//! records of 64 leaves                -> Coarser  -> records of their parent, one per material
//! ```
//!
//! Invariants: 1. a bit of a parent is set when and only when that child is there: a triangle touches a cube when and
//! only when it touches a part of it; 2. sums are made in the order of keys; 3. memory is a record per material.

use super::record::Record;
use super::{KEY_BITS, NODE_SIDE};

/// The leaf at hand: all of it so far, and the area of the material that has most.
#[derive(Default)]
pub(super) struct OpenLeaf(Option<(Record, f32)>);

impl OpenLeaf {
    /// Adds what one material brings to a leaf. Gives the leaf before it, when this is another's.
    pub(super) fn push(&mut self, record: Record) -> Option<Record> {
        match &mut self.0 {
            Some((open, most)) if open.key() == record.key() => {
                open.add(&record);
                if record.area > *most {
                    (open.order, *most) = (record.order, record.area);
                }
                None
            }
            _ => self.0.replace((record, record.area)).map(|(leaf, _)| leaf),
        }
    }

    /// Gives the leaf at hand.
    pub(super) fn close(&mut self) -> Option<Record> {
        self.0.take().map(|(leaf, _)| leaf)
    }
}

/// The parent at hand: a record for each material, in order.
#[derive(Default)]
pub(super) struct Coarser(Vec<Record>);

impl Coarser {
    /// Adds a record of a child. Gives the records of the parent before it, when this is another's child.
    pub(super) fn push(&mut self, child: &Record) -> Vec<Record> {
        let key = child.key() >> KEY_BITS;
        let before = if self.0.first().is_some_and(|open| open.key() != key) { self.close() } else { vec![] };
        // Areas are counted in squares of the leaf's own side.
        let share = 1.0 / (NODE_SIDE * NODE_SIDE) as f32;
        let record = Record {
            order: Record::at(key, child.material()).order,
            bitmap: 1 << (child.key() & 63),
            ..child.scaled(share)
        };
        match self.0.binary_search_by_key(&record.order, |open| open.order) {
            Ok(at) => self.0[at].add(&record),
            Err(at) => self.0.insert(at, record),
        }
        before
    }

    /// Gives the records of the parent at hand.
    pub(super) fn close(&mut self) -> Vec<Record> {
        std::mem::take(&mut self.0)
    }
}
