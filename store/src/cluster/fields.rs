//! Up to three bit fields of a word, moved together and apart.
//!
//! ```text
//! packed = | z | y | x |     spread ->     fields = |  z  | y   |  x |     gather ->     packed
//! ```
//!
//! Whoever has [`Work`] to do asks a [`Machine`], which hands it the movers that it has.

/// Places of three fields in a word.
#[derive(Clone, Copy, Default)]
pub(super) struct Fields {
    /// Bits of each field, in place.
    masks: [u64; 3],
    /// How far each field lies above where it is packed.
    up: [u32; 3],
}

impl Fields {
    /// Fields of `bits` bits, `at` bits above the least, ascending and apart.
    pub(super) fn new(bits: [u32; 3], at: [u32; 3]) -> Fields {
        let masks: [u64; 3] = std::array::from_fn(|i| ((1u64 << bits[i]) - 1) << at[i]);
        let packed = [0, bits[0], bits[0] + bits[1]];
        Fields { masks, up: std::array::from_fn(|i| at[i] - packed[i]) }
    }
}

/// Moves fields.
pub(super) trait Mover: Copy {
    /// From packed to their places.
    fn spread(self, packed: u64, fields: &Fields) -> u64;
    /// From their places to packed.
    fn gather(self, word: u64, fields: &Fields) -> u64;
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
}

impl Machine {
    /// The best that this machine has.
    pub(super) fn best() -> Machine {
        Machine::Portable
    }

    /// Does `work`.
    #[inline(always)]
    pub(super) fn run<W: Work>(self, work: W) -> W::Output {
        match self {
            Machine::Portable => work.run(Portable),
        }
    }
}

/// In shifts.
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
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn what_is_spread_is_gathered(
            word in any::<u64>(),
            bits in prop::array::uniform3(0u32..=19),
            gaps in prop::array::uniform3(0u32..=2),
        ) {
            let at = [gaps[0], gaps[0] + bits[0] + gaps[1], gaps[0] + bits[0] + gaps[1] + bits[1] + gaps[2]];
            let fields = Fields::new(bits, at);
            let all = bits.iter().sum::<u32>();
            let packed = word & ((1 << all) - 1);
            prop_assert_eq!(Portable.gather(Portable.spread(packed, &fields), &fields), packed);
        }
    }
}
