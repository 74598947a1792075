//! Bit fields of a word, moved together and apart, and the corners of strips: BMI2's `pdep` and `pext` and a byte
//! shuffle, and the same in shifts.
//!
//! ```text
//! packed = | z | y | x |     spread ->     fields = |  z  | y   |  x |
//! ```
//!
//! With eight fields, the bytes of a word, they make and read the lanes of a strip of triangles, whose corners one
//! byte shuffle puts in order. Whoever has [`Work`] to do asks a [`Machine`], which hands it the ones that it has.
//! (AMD before Zen 3 has both in microcode: slower there, and right.)
//!
//! Why unsafe: intrinsics, and a call into a function that is compiled for them. `Bmi2` is the proof that they are
//! there, and is made in one place, which asks for them.
//!
//! Invariant: `Bmi2` and `Portable` give the same words; tests compare them, word by word and page by page.

#![allow(unsafe_code)]

use super::bits::BYTES_OF_ONE;
use super::cells::{self, Cells, LeafRange};
use super::finish::{self, Guides, Signs, Tags, VertexWords};
use super::packing::VertexPacking;

/// Places of three fields in a word.
#[derive(Clone, Copy)]
pub(super) struct Fields {
    /// Bits of each field, in place.
    masks: [u64; 3],
    /// How far each field lies above where it is packed.
    up: [u32; 3],
}

impl Fields {
    fn new(bits: [u32; 3], at: [u32; 3]) -> Fields {
        let packed = [0, bits[0], bits[0] + bits[1]];
        Fields { masks: masks(bits, at), up: std::array::from_fn(|i| at[i] - packed[i]) }
    }
}

/// Fields of `bits` bits, `at` bits above the least, in place.
#[inline(always)]
fn masks(bits: [u32; 3], at: [u32; 3]) -> [u64; 3] {
    std::array::from_fn(|i| ((1u64 << bits[i]) - 1) << at[i])
}

/// Moves fields, and bytes of strips.
pub(super) trait Mover: Copy {
    /// What it knows of the places of three fields.
    type Fields: Copy;
    /// Fields of `bits` bits, `at` bits above the least, ascending and apart.
    fn fields(self, bits: [u32; 3], at: [u32; 3]) -> Self::Fields;
    /// From packed to their places.
    fn spread(self, packed: u64, fields: &Self::Fields) -> u64;
    /// Eight bytes below 2^width in 8 * width bits; `width` is 1 to 8.
    fn narrow(self, bytes: u64, width: u32) -> u64;
    /// A byte for each bit: 1 where it is set.
    fn ones(self, bits: u8) -> u64;
    /// Numbers of `width` bits, 0 to 8, one behind the other, to the bytes that are 1 in `lanes`; others are 0.
    fn deposit(self, packed: u64, lanes: u64, width: u32) -> u64;
    /// The bytes of a word that are 1 in `lanes`, one behind the other.
    fn extract(self, word: u64, lanes: u64) -> u64;
    /// From the third corners `x` of a strip, its gate (from, to, opposite; a byte each from the lowest on) and its
    /// turns: the first two corners of each triangle, and the corner opposite of the edge on which it hangs.
    fn follow(self, x: u64, gate: u32, turns: usize) -> [u64; 3];
    /// See [`cells::range_in_bytes`].
    fn range(self, corners: [u64; 3], there: u64) -> LeafRange;
    /// See [`finish::part_guides_in_bytes`].
    fn part_guides(self, guides: &mut Guides, tags: &Tags, count: usize) -> Signs;
    /// See [`finish::finish_in_words`].
    fn finish(
        self,
        packing: &VertexPacking,
        shift: [u8; 3],
        placed: (&mut VertexWords, usize),
        cells: &mut Cells,
    ) -> [u32; 3];
    /// See [`finish::pack_in_words`]: the first so many. Eight of them may be written behind the last, all zero.
    fn pack(self, placed: (&VertexWords, usize), bits: u32, out: &mut [u8]);
}

/// Something to do with fields. `run` must be `#[inline(always)]`, as all that it calls in a loop.
pub(super) trait Work {
    /// The result.
    type Output;
    /// Does it.
    fn run<M: Mover>(self, mover: M) -> Self::Output;
}

/// What work is done with.
#[derive(Clone, Copy)]
pub(super) enum Machine {
    /// Shifts, which every machine has.
    Portable,
    /// `pdep` and `pext`, and all of AVX2, so SSSE3's `pshufb`, too.
    #[cfg(target_arch = "x86_64")]
    Bmi2(bmi2::Bmi2),
}

impl Machine {
    /// The best that this machine has.
    pub(super) fn best() -> Machine {
        #[cfg(target_arch = "x86_64")]
        if let Some(bmi2) = bmi2::Bmi2::find() {
            return Machine::Bmi2(bmi2);
        }
        Machine::Portable
    }

    /// Does `work`.
    #[inline(always)]
    pub(super) fn run<W: Work>(self, work: W) -> W::Output {
        match self {
            Machine::Portable => work.run(Portable),
            #[cfg(target_arch = "x86_64")]
            Machine::Bmi2(bmi2) => bmi2.run(work),
        }
    }
}

/// In shifts; the oracle.
#[derive(Clone, Copy)]
pub(super) struct Portable;

impl Mover for Portable {
    type Fields = Fields;

    #[inline(always)]
    fn fields(self, bits: [u32; 3], at: [u32; 3]) -> Fields {
        Fields::new(bits, at)
    }

    #[inline(always)]
    fn spread(self, packed: u64, fields: &Fields) -> u64 {
        let Fields { masks, up, .. } = fields;
        (packed << up[0]) & masks[0] | (packed << up[1]) & masks[1] | (packed << up[2]) & masks[2]
    }

    #[inline(always)]
    fn narrow(self, bytes: u64, width: u32) -> u64 {
        // By halves.
        let gap = 8 - width;
        let n = bytes & 0x00ff_00ff_00ff_00ff | (bytes & 0xff00_ff00_ff00_ff00) >> gap;
        let n = n & 0x0000_ffff_0000_ffff | (n & 0xffff_0000_ffff_0000) >> (2 * gap);
        n & 0xffff_ffff | (n & 0xffff_ffff_0000_0000) >> (4 * gap)
    }

    #[inline(always)]
    fn ones(self, bits: u8) -> u64 {
        (0..8).map(|i| u64::from(bits >> i & 1) << (8 * i)).sum()
    }

    #[inline(always)]
    fn deposit(self, mut packed: u64, lanes: u64, width: u32) -> u64 {
        let mut word = 0;
        for i in (0..64).step_by(8).filter(|i| lanes >> i & 1 == 1) {
            word |= (packed & ((1 << width) - 1)) << i;
            packed >>= width;
        }
        word
    }

    #[inline(always)]
    fn extract(self, word: u64, lanes: u64) -> u64 {
        let mut packed = 0;
        for i in (0..64).step_by(8).rev().filter(|i| lanes >> i & 1 == 1) {
            packed = packed << 8 | (word >> i & 0xff);
        }
        packed
    }

    #[inline(always)]
    fn follow(self, x: u64, gate: u32, turns: usize) -> [u64; 3] {
        let [mut a, mut b, mut opposite] =
            [gate, gate >> 8, gate >> 16].map(|corner| u64::from(corner & 0xff));
        let mut all = [0; 3];
        for i in 0..8 {
            for (word, corner) in all.iter_mut().zip([a, b, opposite]) {
                *word |= corner << (8 * i);
            }
            let x = x >> (8 * i) & 0xff;
            [a, b, opposite] = if turns >> i & 1 == 0 { [x, b, a] } else { [a, x, b] };
        }
        all
    }

    #[inline(always)]
    fn range(self, corners: [u64; 3], there: u64) -> LeafRange {
        cells::range_in_bytes(corners, there)
    }

    #[inline(always)]
    fn part_guides(self, guides: &mut Guides, tags: &Tags, count: usize) -> Signs {
        finish::part_guides_in_bytes(guides, tags, count)
    }

    #[inline(always)]
    fn finish(
        self,
        packing: &VertexPacking,
        shift: [u8; 3],
        (placed, count): (&mut VertexWords, usize),
        cells: &mut Cells,
    ) -> [u32; 3] {
        finish::finish_in_words(packing, shift, &mut placed[..count], cells)
    }

    #[inline(always)]
    fn pack(self, (placed, count): (&VertexWords, usize), bits: u32, out: &mut [u8]) {
        finish::pack_in_words(&placed[..count], bits, out);
    }
}

/// By the turns of a strip: where in a register of its third corners (bytes 0 to 7) and its gate (8 to 10) the first
/// two corners of each triangle are, and, in the lower half of the second register, the opposite ones.
#[cfg(target_arch = "x86_64")]
static TURNS: [[[u8; 16]; 2]; 128] = {
    let mut all = [[[0; 16]; 2]; 128];
    let mut turns = 0;
    while turns < all.len() {
        let ([mut a, mut b, mut opposite], mut i) = ([8, 9, 10], 0);
        while i < 8 {
            (all[turns][0][i], all[turns][0][8 + i], all[turns][1][i]) = (a, b, opposite);
            [a, b, opposite] = if turns >> i & 1 == 0 { [i as u8, b, a] } else { [a, i as u8, b] };
            i += 1;
        }
        turns += 1;
    }
    all
};

#[cfg(target_arch = "x86_64")]
mod bmi2 {
    use super::{
        BYTES_OF_ONE, Cells, Guides, LeafRange, Mover, Signs, TURNS, Tags, VertexPacking, VertexWords, Work,
        cells, finish, masks,
    };
    use std::arch::x86_64::*;

    /// Proof that the machine has what `run_with_features` is compiled for.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Bmi2(());

    impl Bmi2 {
        pub(super) fn find() -> Option<Bmi2> {
            let has_all = is_x86_feature_detected!("bmi1")
                && is_x86_feature_detected!("bmi2")
                && is_x86_feature_detected!("lzcnt")
                && is_x86_feature_detected!("popcnt")
                && is_x86_feature_detected!("avx2");
            has_all.then_some(Bmi2(()))
        }

        #[inline(always)]
        pub(super) fn run<W: Work>(self, work: W) -> W::Output {
            // SAFETY: `self` is the proof.
            unsafe { run_with_features(self, work) }
        }
    }

    #[target_feature(enable = "bmi1,bmi2,lzcnt,popcnt,avx2")]
    fn run_with_features<W: Work>(bmi2: Bmi2, work: W) -> W::Output {
        work.run(bmi2)
    }

    impl Mover for Bmi2 {
        /// The bits of all three.
        type Fields = u64;

        #[inline(always)]
        fn fields(self, bits: [u32; 3], at: [u32; 3]) -> u64 {
            masks(bits, at).into_iter().sum()
        }

        #[inline(always)]
        fn spread(self, packed: u64, fields: &u64) -> u64 {
            // SAFETY: `self` is the proof.
            unsafe { _pdep_u64(packed, *fields) }
        }

        #[inline(always)]
        fn narrow(self, bytes: u64, width: u32) -> u64 {
            // SAFETY: as above.
            unsafe { _pext_u64(bytes, !(u64::MAX << width) * BYTES_OF_ONE) }
        }

        #[inline(always)]
        fn ones(self, bits: u8) -> u64 {
            // SAFETY: as above.
            unsafe { _pdep_u64(u64::from(bits), BYTES_OF_ONE) }
        }

        #[inline(always)]
        fn deposit(self, packed: u64, lanes: u64, width: u32) -> u64 {
            // SAFETY: as above.
            unsafe { _pdep_u64(packed, lanes * ((1 << width) - 1)) }
        }

        #[inline(always)]
        fn extract(self, word: u64, lanes: u64) -> u64 {
            // SAFETY: as above.
            unsafe { _pext_u64(word, lanes * 0xff) }
        }

        #[inline(always)]
        fn follow(self, x: u64, gate: u32, turns: usize) -> [u64; 3] {
            let [ab, opposite] = TURNS[turns % TURNS.len()].map(bytemuck::cast::<[u8; 16], __m128i>);
            // SAFETY: as above; what AVX2 has includes SSSE3 and SSE4.1.
            unsafe {
                let from = _mm_set_epi64x(i64::from(gate), x as i64);
                let (ab, opposite) = (_mm_shuffle_epi8(from, ab), _mm_shuffle_epi8(from, opposite));
                let a = _mm_cvtsi128_si64(ab) as u64;
                [a, _mm_extract_epi64::<1>(ab) as u64, _mm_cvtsi128_si64(opposite) as u64]
            }
        }

        #[inline(always)]
        fn range(self, corners: [u64; 3], there: u64) -> LeafRange {
            // SAFETY: as above.
            unsafe { cells::range_in_lanes(corners, there) }
        }

        #[inline(always)]
        fn part_guides(self, guides: &mut Guides, tags: &Tags, count: usize) -> Signs {
            // SAFETY: as above.
            unsafe { finish::avx2::part_guides(guides, tags, count) }
        }

        #[inline(always)]
        fn finish(
            self,
            packing: &VertexPacking,
            shift: [u8; 3],
            placed: (&mut VertexWords, usize),
            cells: &mut Cells,
        ) -> [u32; 3] {
            // SAFETY: as above.
            unsafe { finish::avx2::finish(packing, shift, placed, cells) }
        }

        #[inline(always)]
        fn pack(self, (placed, count): (&VertexWords, usize), bits: u32, out: &mut [u8]) {
            if bits < finish::avx2::LEAST_BITS {
                return finish::pack_in_words(&placed[..count], bits, out);
            }
            // SAFETY: as above.
            unsafe { finish::avx2::pack(placed, count, bits, out) }
        }
    }
}
