//! `LowerLinks`: where the unit of each linking node is. Resident beside the upper octree; a section of the file.
//!
//! ```text
//! section  refinement u32 | leaves of all units u64
//!          | words u32, one per linking node, in Deflate blocks as the octree's streams
//! word     page in bits 0 to 24, unit within it in bits 25 to 31
//! ```
//!
//! Linking nodes are the last nodes of the upper octree, in its order: one word each, so that a page is linked by
//! looking it up, and nothing is written when it comes or goes. Paper, section 4.2.
//!
//! Invariants: 1. every word leads to a page of units; whether the page has such a unit is known when it is read.

use super::Refinement;
use super::stored::{BLOCK_BYTES, SectionReader, is_packed, packed_planes};
use crate::layout::PAGES;

/// Bits of a page's number in a word.
const PAGE_BITS: u32 = PAGES.ilog2();
/// Most units of a page.
pub(super) const PAGE_UNITS: usize = 1 << (u32::BITS - PAGE_BITS);
const _: () = assert!(PAGES.is_power_of_two());
/// Bytes of a word.
const WORD_BYTES: usize = size_of::<u32>();

/// A unit, by page and number within it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct UnitRef(u32);

impl UnitRef {
    /// The word that leads to `unit` of `page`.
    pub(super) fn new(page: u32, unit: usize) -> UnitRef {
        assert!(page < PAGES && unit < PAGE_UNITS, "unit {unit} of page {page}");
        UnitRef(page | (unit as u32) << PAGE_BITS)
    }

    /// Of its word.
    pub(super) fn from_word(word: u32) -> UnitRef {
        UnitRef(word)
    }

    /// The word.
    pub(super) fn word(self) -> u32 {
        self.0
    }

    /// The page.
    #[inline]
    pub fn page(self) -> u32 {
        self.0 & (PAGES - 1)
    }

    /// Number within the page.
    #[inline]
    pub fn unit(self) -> u32 {
        self.0 >> PAGE_BITS
    }
}

/// Sizes of the lower octrees of a file, by the head of their section.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LowerSize {
    /// How much finer their leaves are.
    pub refinement: Refinement,
    /// Leaves of all units.
    pub leaf_count: u64,
    /// Linking nodes.
    pub link_count: u32,
    /// Bytes of the section.
    pub stored_bytes: u64,
    /// Bytes of memory for the words; units are pages.
    pub resident_bytes: u64,
    /// Bytes of memory beside these while they are read.
    pub reading_bytes: u64,
}

/// The words of all linking nodes.
#[derive(Clone, Debug, PartialEq)]
pub struct LowerLinks {
    refinement: Refinement,
    words: Vec<u32>,
}

impl LowerLinks {
    /// Bytes before the words.
    pub(crate) const HEAD_BYTES: usize = 12;

    /// What a section of `stored_bytes` with `link_count` words takes, by its head; `None` for no such head.
    pub(crate) fn peek(head: &[u8], link_count: u32, stored_bytes: u64) -> Option<LowerSize> {
        let mut r = SectionReader(head);
        let (refinement, leaf_count) = (Refinement::from_factor(r.u32()?)?, r.u64()?);
        let resident_bytes = u64::from(link_count) * WORD_BYTES as u64;
        let sound = refinement != Refinement::None && is_packed(resident_bytes, stored_bytes);
        let size = LowerSize {
            refinement,
            leaf_count,
            link_count,
            stored_bytes,
            resident_bytes,
            reading_bytes: stored_bytes,
        };
        sound.then_some(size)
    }

    /// The gate for foreign bytes: `link_count` words, all of which lead to pages for which `is_units` holds.
    pub(crate) fn parse(
        bytes: &[u8],
        link_count: usize,
        is_units: impl Fn(u32) -> bool,
    ) -> Option<LowerLinks> {
        let size = LowerLinks::peek(bytes, u32::try_from(link_count).ok()?, bytes.len() as u64)?;
        let mut r = SectionReader(&bytes[LowerLinks::HEAD_BYTES..]);
        let mut words = Vec::with_capacity(link_count);
        r.planes(link_count, WORD_BYTES, |word| words.push(word as u32))?;
        let sound = r.0.is_empty() && words.iter().all(|&word| is_units(UnitRef::from_word(word).page()));
        sound.then_some(LowerLinks { refinement: size.refinement, words })
    }

    /// The section of these words.
    pub(super) fn to_bytes(refinement: Refinement, leaf_count: u64, words: &[u32]) -> Vec<u8> {
        let mut out = Vec::with_capacity(LowerLinks::HEAD_BYTES);
        out.extend(refinement.factor().to_le_bytes());
        out.extend(leaf_count.to_le_bytes());
        for block in words.chunks(BLOCK_BYTES / WORD_BYTES) {
            let block: Vec<u64> = block.iter().map(|&word| u64::from(word)).collect();
            out.extend(packed_planes(&block, WORD_BYTES));
        }
        out
    }

    /// How much finer the leaves of units are.
    pub fn refinement(&self) -> Refinement {
        self.refinement
    }

    /// Count of linking nodes.
    pub fn count(&self) -> usize {
        self.words.len()
    }

    /// The unit of linking node `number`, counted from the first of the last nodes.
    #[inline]
    pub fn unit(&self, number: usize) -> UnitRef {
        UnitRef(self.words[number])
    }

    /// The words of all linking nodes, where they lie.
    pub fn words(&self) -> &[u32] {
        &self.words
    }
}
