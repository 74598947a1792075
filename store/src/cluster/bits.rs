//! Bit fields: numbers packed least bit first.
//!
//! Invariants: 1. a field has at most 57 bits, so that one unaligned 64-bit load holds it at any bit offset; 2. no read
//! leaves the bytes: behind their end stand zeros, and the reader knows that it went there.

/// Appends numbers of 0 to 57 bits to bytes.
#[derive(Default)]
pub(super) struct BitWriter {
    pub(super) bytes: Vec<u8>,
    pending: u64,
    pending_bits: u32,
}

impl BitWriter {
    pub(super) fn put(&mut self, value: u64, bits: u32) {
        debug_assert!(bits <= 57 && value >> bits == 0);
        self.pending |= value << self.pending_bits;
        self.pending_bits += bits;
        while self.pending_bits >= 8 {
            self.bytes.push(self.pending as u8);
            self.pending >>= 8;
            self.pending_bits -= 8;
        }
    }

    /// Bits so far.
    pub(super) fn bit_count(&self) -> usize {
        8 * self.bytes.len() + self.pending_bits as usize
    }

    /// Appends all that `other` holds.
    pub(super) fn append(&mut self, other: BitWriter) {
        other.bytes.iter().for_each(|&byte| self.put(u64::from(byte), 8));
        self.put(other.pending, other.pending_bits);
    }

    /// Fills the last byte with zeros.
    pub(super) fn align(&mut self) {
        if self.pending_bits > 0 {
            self.bytes.push(self.pending as u8);
        }
        (self.pending, self.pending_bits) = (0, 0);
    }

    /// Fills the last byte with zeros and gives the bytes.
    pub(super) fn finish(mut self) -> Vec<u8> {
        self.align();
        self.bytes
    }
}

/// Reads what a [`BitWriter`] wrote. Behind the end stand zeros: ask [`BitReader::is_sound`] when all is read.
#[derive(Clone, Copy)]
pub(super) struct BitReader<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> BitReader<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> BitReader<'a> {
        BitReader { bytes, at: 0 }
    }

    /// The next 57 bits, and up to seven more that are not to be believed.
    #[inline(always)]
    pub(super) fn peek(&self) -> u64 {
        word_at(self.bytes, self.at / 8) >> (self.at % 8)
    }

    #[inline(always)]
    pub(super) fn skip(&mut self, bits: usize) {
        self.at += bits;
    }

    /// The next `bits`, at most 57.
    #[inline(always)]
    pub(super) fn take(&mut self, bits: u32) -> u64 {
        let value = self.peek() & ((1u64 << bits) - 1);
        self.at += bits as usize;
        value
    }

    /// Passes over the rest of the byte. False when it is not zero.
    pub(super) fn align(&mut self) -> bool {
        self.take((8 - self.at as u32 % 8) % 8) == 0
    }

    /// Bytes that were begun.
    pub(super) fn byte_count(&self) -> usize {
        self.at.div_ceil(8)
    }

    /// True when nothing was read from behind the end.
    pub(super) fn is_sound(&self) -> bool {
        self.at <= 8 * self.bytes.len()
    }
}

/// Bits that a number needs: 0 for 0.
#[inline(always)]
pub(super) fn bits_of(value: u64) -> u8 {
    (64 - value.leading_zeros()) as u8
}

/// `bits` (at most 57) from bit offset `at`; bytes behind the end read as zero.
#[inline(always)]
pub(super) fn get(bytes: &[u8], at: usize, bits: u32) -> u64 {
    word_at(bytes, at / 8) >> (at % 8) & ((1u64 << bits) - 1)
}

/// Eight bytes from `first` on; those behind the end are zero.
#[inline(always)]
fn word_at(bytes: &[u8], first: usize) -> u64 {
    match bytes.get(first..first + 8) {
        Some(eight) => u64::from_le_bytes(eight.try_into().expect("eight bytes")),
        None => last_word(bytes, first),
    }
}

#[cold]
fn last_word(bytes: &[u8], first: usize) -> u64 {
    let mut eight = [0; 8];
    let tail = bytes.get(first..).unwrap_or(&[]);
    eight[..tail.len()].copy_from_slice(tail);
    u64::from_le_bytes(eight)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_put_is_got(items in proptest::collection::vec((any::<u64>(), 0u32..=57), 0..200)) {
            let mut writer = BitWriter::default();
            for &(value, bits) in &items {
                writer.put(value & ((1 << bits) - 1), bits);
            }
            let bytes = writer.finish();
            let mut reader = BitReader::new(&bytes);
            let mut at = 0;
            for &(value, bits) in &items {
                prop_assert_eq!(get(&bytes, at, bits), value & ((1 << bits) - 1));
                prop_assert_eq!(reader.take(bits), value & ((1 << bits) - 1));
                at += bits as usize;
            }
            prop_assert_eq!(bytes.len(), at.div_ceil(8));
            prop_assert!(reader.align() && reader.is_sound() && reader.byte_count() == bytes.len());
            reader.skip(1);
            prop_assert!(!reader.is_sound());
        }
    }
}
