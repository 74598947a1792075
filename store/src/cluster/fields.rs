//! Up to three bit fields of a word, moved together and apart: BMI2's `pdep` and `pext`, and the same in shifts.
//!
//! ```text
//! packed = | z | y | x |     spread ->     fields = |  z  | y   |  x |     gather ->     packed
//! ```
//!
//! With eight fields, the bytes of a word are narrowed (`pext` again). Install is bound by instructions: 196 a
//! triangle with spread and gather in BMI2, 224 in shifts (`gen:isosurface:5M`, before leaves had widths of their
//! own), and 0.82 of the time. Whoever has [`Work`] to do asks a [`Machine`], which hands it the ones that it has.
//! (AMD before Zen 3 has both in microcode: slower there, and right.)
//!
//! Why unsafe: intrinsics, and a call into a function that is compiled for them. `Bmi2` is the proof that they are
//! there, and is made in one place, which asks for them.
//!
//! Invariant: `Bmi2` and `Portable` give the same words; tests compare them, word by word and page by page.

#![allow(unsafe_code)]

/// Eight bytes, each 1.
pub(super) const BYTES_OF_ONE: u64 = 0x0101_0101_0101_0101;

/// Places of three fields in a word.
#[derive(Clone, Copy, Default)]
pub(super) struct Fields {
    /// Bits of each field, in place.
    masks: [u64; 3],
    /// How far each field lies above where it is packed.
    up: [u32; 3],
    /// All three.
    #[cfg(target_arch = "x86_64")]
    mask: u64,
}

impl Fields {
    /// Fields of `bits` bits, `at` bits above the least, ascending and apart.
    pub(super) fn new(bits: [u32; 3], at: [u32; 3]) -> Fields {
        let masks: [u64; 3] = std::array::from_fn(|i| ((1u64 << bits[i]) - 1) << at[i]);
        let packed = [0, bits[0], bits[0] + bits[1]];
        Fields {
            masks,
            up: std::array::from_fn(|i| at[i] - packed[i]),
            #[cfg(target_arch = "x86_64")]
            mask: masks[0] | masks[1] | masks[2],
        }
    }
}

/// Moves fields.
pub(super) trait Mover: Copy {
    /// From packed to their places.
    fn spread(self, packed: u64, fields: &Fields) -> u64;
    /// From their places to packed.
    fn gather(self, word: u64, fields: &Fields) -> u64;
    /// Eight bytes below 2^width in 8 * width bits; `width` is 1 to 8.
    fn narrow(self, bytes: u64, width: u32) -> u64;
}

/// Something to do with fields. `run` must be `#[inline(always)]`, as all that it calls in a loop.
pub(super) trait Work {
    /// What comes of it.
    type Output;
    /// Does it.
    fn run<M: Mover>(self, mover: M) -> Self::Output;
}

/// What work is done with.
#[derive(Clone, Copy)]
pub(super) enum Machine {
    /// Shifts, which every machine has.
    Portable,
    /// `pdep` and `pext`.
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
    #[inline(always)]
    fn spread(self, packed: u64, fields: &Fields) -> u64 {
        let Fields { masks, up, .. } = fields;
        (packed << up[0]) & masks[0] | (packed << up[1]) & masks[1] | (packed << up[2]) & masks[2]
    }

    #[inline(always)]
    fn gather(self, word: u64, fields: &Fields) -> u64 {
        let Fields { masks, up, .. } = fields;
        (word & masks[0]) >> up[0] | (word & masks[1]) >> up[1] | (word & masks[2]) >> up[2]
    }

    #[inline(always)]
    fn narrow(self, bytes: u64, width: u32) -> u64 {
        // By halves.
        let gap = 8 - width;
        let n = bytes & 0x00ff_00ff_00ff_00ff | (bytes & 0xff00_ff00_ff00_ff00) >> gap;
        let n = n & 0x0000_ffff_0000_ffff | (n & 0xffff_0000_ffff_0000) >> (2 * gap);
        n & 0xffff_ffff | (n & 0xffff_ffff_0000_0000) >> (4 * gap)
    }
}

#[cfg(target_arch = "x86_64")]
mod bmi2 {
    use super::{BYTES_OF_ONE, Fields, Mover, Work};
    use std::arch::x86_64::{_pdep_u64, _pext_u64};

    /// Proof that the machine has what `run_with_features` is compiled for.
    #[derive(Clone, Copy)]
    pub(in super::super) struct Bmi2(());

    impl Bmi2 {
        pub(super) fn find() -> Option<Bmi2> {
            let has_all = is_x86_feature_detected!("bmi1")
                && is_x86_feature_detected!("bmi2")
                && is_x86_feature_detected!("avx2");
            has_all.then_some(Bmi2(()))
        }

        #[inline(always)]
        pub(super) fn run<W: Work>(self, work: W) -> W::Output {
            // SAFETY: `self` is the proof.
            unsafe { run_with_features(self, work) }
        }
    }

    #[target_feature(enable = "bmi1,bmi2,avx2")]
    fn run_with_features<W: Work>(bmi2: Bmi2, work: W) -> W::Output {
        work.run(bmi2)
    }

    impl Mover for Bmi2 {
        #[inline(always)]
        fn spread(self, packed: u64, fields: &Fields) -> u64 {
            // SAFETY: `self` is the proof.
            unsafe { _pdep_u64(packed, fields.mask) }
        }

        #[inline(always)]
        fn gather(self, word: u64, fields: &Fields) -> u64 {
            // SAFETY: as above.
            unsafe { _pext_u64(word, fields.mask) }
        }

        #[inline(always)]
        fn narrow(self, bytes: u64, width: u32) -> u64 {
            // SAFETY: as above.
            unsafe { _pext_u64(bytes, (u64::MAX >> (64 - width)) * BYTES_OF_ONE) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    struct Both(u64, Fields);

    impl Work for Both {
        type Output = (u64, u64);
        fn run<M: Mover>(self, mover: M) -> (u64, u64) {
            (mover.spread(self.0, &self.1), mover.gather(self.0, &self.1))
        }
    }

    struct Narrow(u64, u32);

    impl Work for Narrow {
        type Output = u64;
        fn run<M: Mover>(self, mover: M) -> u64 {
            mover.narrow(self.0, self.1)
        }
    }

    proptest! {
        #[test]
        fn both_movers_narrow_bytes_to_their_bits(word in any::<u64>(), width in 1u32..=8) {
            let bytes = word & (u64::from(u8::MAX >> (8 - width)) * BYTES_OF_ONE);
            let narrow = Machine::best().run(Narrow(bytes, width));
            prop_assert_eq!(narrow, Machine::Portable.run(Narrow(bytes, width)));
            for (i, byte) in bytes.to_le_bytes().into_iter().enumerate() {
                prop_assert_eq!((narrow >> (width * i as u32) & 0xff) as u8 & (0xff >> (8 - width)), byte);
            }
        }

        #[test]
        fn both_movers_agree(
            word in any::<u64>(),
            bits in prop::array::uniform3(0u32..=19),
            gaps in prop::array::uniform3(0u32..=2),
        ) {
            let at = [gaps[0], gaps[0] + bits[0] + gaps[1], gaps[0] + bits[0] + gaps[1] + bits[1] + gaps[2]];
            let fields = Fields::new(bits, at);
            let portable = Both(word, fields).run(Portable);
            prop_assert_eq!(portable, Machine::best().run(Both(word, fields)));
            let all = bits.iter().sum::<u32>();
            let packed = word & ((1 << all) - 1);
            prop_assert_eq!(Portable.gather(Portable.spread(packed, &fields), &fields), packed);
        }
    }
}
