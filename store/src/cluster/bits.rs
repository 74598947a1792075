//! Bit fields: numbers packed least bit first.
//!
//! Invariants: 1. a field has at most 57 bits, so that one unaligned 64-bit load holds it at any bit offset; 2. no read
//! leaves the bytes: behind their end stand zeros, and the reader knows that it went there; 3. a cluster is read from a
//! window of fixed length, so that a mask of the place is all that a field costs to stay inside.

/// Eight bytes, each 1.
pub(super) const BYTES_OF_ONE: u64 = 0x0101_0101_0101_0101;

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

/// Bytes that no cluster on disk is longer than, and the power of two that the reader masks its place with.
pub(super) const WINDOW_BYTES: usize = 4096;
/// What a cluster is read from: its bytes, what stands behind them, and zeros behind the end of the page.
pub(super) type Window = [u8; WINDOW_BYTES + size_of::<u64>()];

/// Reads what a [`BitWriter`] wrote. Nothing tells it where the bytes end: ask [`BitReader::is_within`] when all is
/// read.
#[derive(Clone, Copy)]
pub(super) struct BitReader<'a> {
    window: &'a Window,
    at: usize,
}

impl<'a> BitReader<'a> {
    pub(super) fn new(window: &'a Window) -> BitReader<'a> {
        BitReader { window, at: 0 }
    }

    /// The next 57 bits, and up to seven more that are not to be believed.
    #[inline(always)]
    pub(super) fn peek(&self) -> u64 {
        // The mask takes the place of a check: what lies behind the window is refused in the end.
        let first = self.at / 8 % WINDOW_BYTES;
        let eight = self.window[first..first + 8].try_into().expect("eight bytes");
        u64::from_le_bytes(eight) >> (self.at % 8)
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

    /// True when nothing was read from behind the first `bytes`.
    pub(super) fn is_within(&self, bytes: usize) -> bool {
        self.at <= 8 * bytes.min(WINDOW_BYTES)
    }
}

/// Reads what a [`BitWriter`] wrote, of any length, with a check at each field. Behind the end stand zeros: ask
/// [`BitStream::is_sound`] when all is read.
#[derive(Clone, Copy)]
pub(super) struct BitStream<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> BitStream<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> BitStream<'a> {
        BitStream { bytes, at: 0 }
    }

    /// The next 57 bits, and up to seven more that are not to be believed.
    #[inline(always)]
    pub(super) fn peek(&self) -> u64 {
        word_at(self.bytes, self.at / 8) >> (self.at % 8)
    }

    #[inline(always)]
    pub(super) fn skip(&mut self, bits: u32) {
        self.at += bits as usize;
    }

    /// The next `bits`, at most 57.
    #[inline(always)]
    pub(super) fn take(&mut self, bits: u32) -> u64 {
        let value = self.peek() & ((1u64 << bits) - 1);
        self.skip(bits);
        value
    }

    /// True when all bytes were read and no more, with zeros in the rest of the last.
    pub(super) fn is_whole(&self) -> bool {
        let rest = (8 - self.at as u32 % 8) % 8;
        get(self.bytes, self.at, rest) == 0 && self.at.div_ceil(8) == self.bytes.len()
    }

    /// True when nothing was read from behind the end.
    pub(super) fn is_sound(&self) -> bool {
        self.at <= 8 * self.bytes.len()
    }
}

/// The window on `bytes`, which is copied to `tail` where it ends behind them.
pub(super) fn window<'a>(bytes: &'a [u8], tail: &'a mut Window) -> &'a Window {
    match bytes.first_chunk() {
        Some(window) => window,
        None => {
            let (there, behind) = tail.split_at_mut(bytes.len());
            there.copy_from_slice(bytes);
            behind.fill(0);
            tail
        }
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
            let mut tail = [0xff; size_of::<Window>()];
            let mut reader = BitReader::new(window(&bytes, &mut tail));
            let mut at = 0;
            for &(value, bits) in &items {
                prop_assert_eq!(get(&bytes, at, bits), value & ((1 << bits) - 1));
                prop_assert_eq!(reader.take(bits), value & ((1 << bits) - 1));
                at += bits as usize;
            }
            prop_assert_eq!(bytes.len(), at.div_ceil(8));
            prop_assert!(reader.align() && reader.is_within(bytes.len()) && reader.byte_count() == bytes.len());
            reader.skip(1);
            prop_assert!(!reader.is_within(bytes.len()));
        }

        /// A window of bytes of any length, against the bytes and zeros behind them.
        #[test]
        fn a_window_holds_bytes_and_then_zeros(length in 0usize..2 * WINDOW_BYTES) {
            let bytes: Vec<u8> = (0..length).map(|i| (i * i + i / 251) as u8 | 1).collect();
            let mut tail = [0xff; size_of::<Window>()];
            let window = window(&bytes, &mut tail);
            let there = length.min(window.len());
            prop_assert!(window[..there] == bytes[..there] && window[there..].iter().all(|&b| b == 0));
        }
    }
}
