//! `SliceMask`: which samples of a slice are inside of a surface, a bit each.
//!
//! Invariant: bits behind the last sample of a row are 0.

use super::samples::Sample;

/// Samples of a word.
pub(super) const WORD_BITS: usize = u64::BITS as usize;

/// Bit x of a row's words: sample x is inside.
#[derive(Default)]
pub(super) struct SliceMask {
    words: Vec<u64>,
    row_words: usize,
}

/// Whether samples of a face of the volume are inside, and whether some are outside.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct FaceSides {
    pub(super) has_inside: bool,
    pub(super) has_outside: bool,
}

impl FaceSides {
    /// Whether the surface meets the face.
    pub(super) fn is_cut(self) -> bool {
        self.has_inside && self.has_outside
    }

    fn add(&mut self, is_inside: bool) {
        self.has_inside |= is_inside;
        self.has_outside |= !is_inside;
    }
}

impl SliceMask {
    /// Words of a row of so many samples.
    pub(super) fn row_words(side: usize) -> usize {
        side.div_ceil(WORD_BITS)
    }

    /// Bytes of the mask of a slice.
    pub(super) fn bytes([x, y]: [usize; 2]) -> u64 {
        (SliceMask::row_words(x) * y * size_of::<u64>()) as u64
    }

    /// The words of a row.
    #[inline]
    pub(super) fn row(&self, y: usize) -> &[u64] {
        &self.words[y * self.row_words..(y + 1) * self.row_words]
    }

    /// Takes the samples of a slice whose rows have `side` samples; those from `least` on are inside.
    pub(super) fn fill<T: Sample>(&mut self, samples: &[T], side: usize, least: Option<T>) {
        self.row_words = SliceMask::row_words(side);
        let rows = samples.len() / side;
        self.words.clear();
        self.words.resize(rows * self.row_words, 0);
        let Some(least) = least else { return };
        for (words, row) in self.words.chunks_exact_mut(self.row_words).zip(samples.chunks_exact(side)) {
            for (word, samples) in words.iter_mut().zip(row.chunks(WORD_BITS)) {
                // Bytes first: compilers compare many samples at once then.
                let mut flags = [0u8; WORD_BITS];
                flags.iter_mut().zip(samples).for_each(|(flag, sample)| *flag = u8::from(*sample >= least));
                *word = packed(&flags);
            }
        }
    }

    /// Looks at the whole slice: its first or last face of the volume.
    pub(super) fn add_to_face(&self, side: usize, face: &mut FaceSides) {
        for row in self.words.chunks_exact(self.row_words) {
            add_row(row, side, face);
        }
    }

    /// Looks at the border of the slice: the sides of the first x, of the last, of the first y, of the last.
    pub(super) fn add_to_sides(&self, side: usize, faces: &mut [FaceSides; 4]) {
        let rows = self.words.len() / self.row_words;
        let last = side - 1;
        for row in self.words.chunks_exact(self.row_words) {
            faces[0].add(row[0] & 1 == 1);
            faces[1].add(row[last / WORD_BITS] >> (last % WORD_BITS) & 1 == 1);
        }
        add_row(self.row(0), side, &mut faces[2]);
        add_row(self.row(rows - 1), side, &mut faces[3]);
    }
}

fn add_row(row: &[u64], side: usize, face: &mut FaceSides) {
    for (at, &word) in row.iter().enumerate() {
        face.has_inside |= word != 0;
        face.has_outside |= word != bits_below(side - at * WORD_BITS);
    }
}

/// A word whose lowest `count` bits are set; all of them where there are fewer.
#[inline]
pub(super) fn bits_below(count: usize) -> u64 {
    if count >= WORD_BITS { u64::MAX } else { (1 << count) - 1 }
}

/// Word `at` of a row, moved so that bit x is that of the next sample.
#[inline]
pub(super) fn next_samples(row: &[u64], at: usize) -> u64 {
    row[at] >> 1 | row.get(at + 1).map_or(0, |next| next << (WORD_BITS - 1))
}

/// Bit i is byte i, which is 0 or 1.
#[inline]
fn packed(flags: &[u8; WORD_BITS]) -> u64 {
    // The product moves bit 0 of byte i to bit 56 + i, and no two of its terms meet.
    const GATHER: u64 = 0x0102_0408_1020_4080;
    let (bytes, _) = flags.as_chunks::<8>();
    let eights = bytes.iter().map(|&eight| u64::from_le_bytes(eight).wrapping_mul(GATHER) >> 56);
    eights.enumerate().fold(0, |word, (at, eight)| word | eight << (8 * at))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mask_has_a_bit_for_each_sample_inside() {
        for side in [2, 63, 64, 65, 130] {
            let samples: Vec<u8> = (0..side * 3).map(|i| (i * i * 31 % 251) as u8).collect();
            let mut mask = SliceMask::default();
            mask.fill(&samples, side, Some(100));
            for (y, row) in samples.chunks(side).enumerate() {
                for x in 0..SliceMask::row_words(side) * WORD_BITS {
                    let bit = mask.row(y)[x / WORD_BITS] >> (x % WORD_BITS) & 1 == 1;
                    assert_eq!(bit, row.get(x).is_some_and(|&sample| sample >= 100), "{side}: {x}, {y}");
                    let next = next_samples(mask.row(y), x / WORD_BITS) >> (x % WORD_BITS) & 1 == 1;
                    assert_eq!(next, row.get(x + 1).is_some_and(|&sample| sample >= 100), "{side}: {x}, {y}");
                }
            }
        }
    }

    #[test]
    fn faces_know_what_is_on_them() {
        let sides = |samples: &[u8]| {
            let (mut mask, mut faces, mut face) =
                (SliceMask::default(), [FaceSides::default(); 4], FaceSides::default());
            mask.fill(samples, 3, Some(1));
            mask.add_to_sides(3, &mut faces);
            mask.add_to_face(3, &mut face);
            (faces.map(FaceSides::is_cut), face.is_cut())
        };
        assert_eq!(sides(&[0, 0, 0, 0, 1, 0, 0, 0, 0]), ([false; 4], true));
        assert_eq!(sides(&[0, 0, 0, 1, 1, 0, 0, 0, 0]), ([true, false, false, false], true));
        assert_eq!(sides(&[0, 0, 0, 0, 0, 0, 0, 0, 1]), ([false, true, false, true], true));
        assert_eq!(sides(&[1; 9]), ([false; 4], false));
    }
}
