//! The prefix code of a triangle: across which edge it hangs, and what its third corner is.
//!
//! ```text
//! symbol = 4 * gate + apex, or FREE
//! gate   0 to 7: the edge pushed so many pushes ago; 8: 8 more than the next 3 bits say; 9: the next 9 bits
//! apex   0: the next new vertex; 1: the one behind the edge on the rim; 2: the one before it; 3: the next 7 bits
//! FREE   three flags, bit c: corner c is known and follows in 7 bits; else it is the next new vertex
//! ```
//!
//! The code is canonical: shorter words first, words of one length by symbol, and the first bit of a word is its
//! highest. Lengths are Huffman's over `gen:isosurface`, `gen:scan`, `gen:pipes`, two scans and a CAD model, each
//! weighed alike, bounded by nine bits; one fixed code for all, since 128 triangles do not pay for a code of their own.
//!
//! Invariants: 1. every word of nine bits begins with exactly one code word; 2. two triangles
//! that hang on gates take at most 50 bits, and a free one takes 28: one 57-bit load holds either.

use crate::layout::CLUSTER_VERTICES;

/// Gates that a symbol tells apart.
pub(super) const GATES: usize = 10;
/// What the third corner of a triangle is.
pub(super) mod apex {
    /// The next new vertex.
    pub(in super::super) const NEW: u8 = 0;
    /// The vertex behind the gate on the rim.
    pub(in super::super) const BEHIND: u8 = 1;
    /// The vertex before the gate on the rim.
    pub(in super::super) const BEFORE: u8 = 2;
    /// Any vertex, by number.
    pub(in super::super) const NAMED: u8 = 3;
}
/// The symbol of a triangle that hangs on no edge.
pub(super) const FREE: usize = 4 * GATES;
const SYMBOLS: usize = FREE + 1;
/// Longest code word, bits.
const LONGEST: usize = 9;
/// Bits of a vertex that is named.
pub(super) const NAME_BITS: u32 = 7;
/// Bits of a gate of class 8: as many more gates as the symbols tell apart.
const NEAR_GATE_BITS: u32 = 3;
/// Bits of any gate: there are up to 512.
const ANY_GATE_BITS: u32 = 9;
const _: () = assert!(2 * (LONGEST as u32 + ANY_GATE_BITS + NAME_BITS) <= 57);

/// Code lengths by symbol.
pub(super) const LENGTHS: [u8; SYMBOLS] = [
    2, 5, 4, 5, 2, 4, 6, 5, 6, 9, 7, 7, 6, 7, 9, 7, 7, 9, 7, 9, 7, 7, 9, 9, 7, 9, 8, 9, 8, 8, 9, 9, 6, 7, 7,
    8, 6, 6, 9, 9, 4,
];

/// A code word, its first bit lowest, and its length.
#[derive(Clone, Copy)]
pub(super) struct Word {
    pub(super) bits: u64,
    pub(super) length: u32,
}

/// What a decoder needs to know of a symbol: eight bytes, each read on its own.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Entry {
    /// The bits of the gate that follow the code word, set.
    pub(super) gate_mask: u16,
    /// Added to these.
    pub(super) gate: u8,
    /// Eight times one of [`apex`], or [`Entry::FREE`].
    pub(super) shift: u8,
    /// All bits where the apex is what is behind the gate; it keeps its own place on the rim then.
    pub(super) behind: u8,
    /// The same before the gate.
    pub(super) before: u8,
    /// Bits of the code word.
    pub(super) length: u8,
    /// All bits of the triangle, a name last; but of a free one.
    pub(super) bits: u8,
}

const _: () = assert!(size_of::<Entry>() == 8);

impl Entry {
    /// The `shift` of a free triangle.
    pub(super) const FREE: u8 = 32;

    const fn new(symbol: usize) -> Entry {
        let (gate, gate_bits) = match symbol / 4 {
            GATES => (0, 0),
            9 => (0, ANY_GATE_BITS as u8),
            8 => (8, NEAR_GATE_BITS as u8),
            near => (near as u8, 0),
        };
        let (length, apex) = (LENGTHS[symbol], (symbol % 4) as u8);
        let is_free = symbol == FREE;
        let name_bits = if apex == apex::NAMED { NAME_BITS as u8 } else { 0 };
        Entry {
            gate,
            gate_mask: (1 << gate_bits) - 1,
            shift: if is_free { Entry::FREE } else { 8 * apex },
            behind: if apex == apex::BEHIND { ASIDE } else { 0 },
            before: if apex == apex::BEFORE { ASIDE } else { 0 },
            length,
            bits: length + gate_bits + name_bits,
        }
    }

    /// What to do with the rim where the third corner is told as `apex`.
    pub(super) fn of_apex(apex: u8) -> &'static Entry {
        &BY_APEX[usize::from(apex)]
    }

    /// The symbol that begins the bits of `word`.
    #[inline(always)]
    pub(super) fn at(word: u64) -> &'static Entry {
        &TABLE[word as usize % TABLE.len()]
    }
}

/// The gate symbol class of an edge pushed `ago` pushes ago, and the bits that follow it.
pub(super) fn gate_class(ago: usize) -> (usize, Word) {
    match ago {
        0..8 => (ago, Word { bits: 0, length: 0 }),
        8..16 => (8, Word { bits: ago as u64 - 8, length: NEAR_GATE_BITS }),
        _ => (9, Word { bits: ago as u64, length: ANY_GATE_BITS }),
    }
}

/// Set in the number of a vertex to write beside the part of a table that is read.
pub(super) const ASIDE: u8 = 0xff;
/// Bits of the number of a vertex.
pub(super) const NAME_MASK: u8 = (1 << NAME_BITS) - 1;
const _: () = assert!(CLUSTER_VERTICES == NAME_MASK as usize + 1);

static BY_APEX: [Entry; 4] = [Entry::new(0), Entry::new(1), Entry::new(2), Entry::new(3)];

/// Code words by symbol.
pub(super) const WORDS: [Word; SYMBOLS] = words();

/// By the next nine bits.
static TABLE: [Entry; 1 << LONGEST] = table();

const fn words() -> [Word; SYMBOLS] {
    let mut words = [Word { bits: 0, length: 0 }; SYMBOLS];
    let (mut next, mut length) = (0u64, 1u32);
    while length <= LONGEST as u32 {
        let mut symbol = 0;
        while symbol < SYMBOLS {
            if LENGTHS[symbol] as u32 == length {
                words[symbol] = Word { bits: next.reverse_bits() >> (64 - length), length };
                next += 1;
            }
            symbol += 1;
        }
        next <<= 1;
        length += 1;
    }
    assert!(next == 2 << LONGEST, "the lengths make no complete code");
    words
}

const fn table() -> [Entry; 1 << LONGEST] {
    let mut table = [Entry::new(0); 1 << LONGEST];
    let mut symbol = 0;
    while symbol < SYMBOLS {
        let word = WORDS[symbol];
        let mut at = word.bits as usize;
        while at < table.len() {
            table[at] = Entry::new(symbol);
            at += 1 << word.length;
        }
        symbol += 1;
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_finds_each_word_whatever_follows_it() {
        for (symbol, word) in WORDS.iter().enumerate() {
            for behind in [0, 1, 0x155, !0] {
                assert_eq!(
                    *Entry::at(word.bits | behind << word.length),
                    Entry::new(symbol),
                    "symbol {symbol}"
                );
            }
        }
    }
}
