//! Bit fields: fixed-width numbers packed least bit first.

/// Appends numbers of 0 to 57 bits to bytes.
#[derive(Default)]
pub(super) struct BitWriter {
    pub(super) bytes: Vec<u8>,
    pending: u64,
    pending_bits: u32,
}

impl BitWriter {
    pub(super) fn put(&mut self, value: u64, bits: u32) {
        debug_assert!(bits <= 57 && (bits == 64 || value >> bits == 0));
        self.pending |= value << self.pending_bits;
        self.pending_bits += bits;
        while self.pending_bits >= 8 {
            self.bytes.push(self.pending as u8);
            self.pending >>= 8;
            self.pending_bits -= 8;
        }
    }

    /// Fills the last byte with zeros and gives the bytes.
    pub(super) fn finish(mut self) -> Vec<u8> {
        if self.pending_bits > 0 {
            self.bytes.push(self.pending as u8);
        }
        self.bytes
    }
}

/// `bits` (at most 57) from bit offset `at`; bytes behind the end read as zero.
pub(super) fn get(bytes: &[u8], at: usize, bits: u32) -> u64 {
    let first = at / 8;
    let word = match bytes.get(first..first + 8) {
        Some(eight) => u64::from_le_bytes(eight.try_into().expect("eight bytes")),
        None => {
            let mut eight = [0; 8];
            let tail = bytes.get(first..).unwrap_or(&[]);
            eight[..tail.len()].copy_from_slice(tail);
            u64::from_le_bytes(eight)
        }
    };
    word >> (at % 8) & ((1u64 << bits) - 1)
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
            let mut at = 0;
            for &(value, bits) in &items {
                prop_assert_eq!(get(&bytes, at, bits), value & ((1 << bits) - 1));
                at += bits as usize;
            }
            prop_assert_eq!(bytes.len(), at.div_ceil(8));
        }
    }
}
