//! What a machine has for bit fields and bytes, against shifts and loops.

use super::super::bits::BYTES_OF_ONE;
use super::super::cells::LeafRange;
use super::super::fields::{Machine, Mover, Portable, Work};
use super::super::finish::{GROUP_BYTES, Guides, NO_VERTEX, PLAIN, Signs, Tags, VertexWords};
use crate::layout::CLUSTER_VERTICES;
use proptest::prelude::*;

struct Spread(u64, [u32; 3], [u32; 3]);

impl Work for Spread {
    type Output = u64;
    fn run<M: Mover>(self, mover: M) -> u64 {
        mover.spread(self.0, &mover.fields(self.1, self.2))
    }
}

struct Narrow(u64, u32);

impl Work for Narrow {
    type Output = u64;
    fn run<M: Mover>(self, mover: M) -> u64 {
        mover.narrow(self.0, self.1)
    }
}

struct Range([u64; 3], u64);

impl Work for Range {
    type Output = LeafRange;
    fn run<M: Mover>(self, mover: M) -> LeafRange {
        mover.range(self.0, self.1)
    }
}

struct Lanes(u64, u8, u32);

impl Work for Lanes {
    type Output = [u64; 6];
    fn run<M: Mover>(self, mover: M) -> [u64; 6] {
        let Lanes(word, bits, width) = self;
        let lanes = mover.ones(bits);
        let [a, b, opposite] = mover.follow(word, width * 0x01_0307, usize::from(bits) % 128);
        [lanes, mover.deposit(word, lanes, width), mover.extract(word, lanes), a, b, opposite]
    }
}

/// Vertices of so many bits, packed.
struct Pack<'a>(&'a VertexWords, usize, u32);

impl Work for Pack<'_> {
    type Output = Vec<u8>;
    fn run<M: Mover>(self, mover: M) -> Vec<u8> {
        let Pack(placed, count, bits) = self;
        let mut out = vec![0; CLUSTER_VERTICES * 8 + GROUP_BYTES];
        mover.pack((placed, count), bits, &mut out);
        out
    }
}

/// Guides, parted, and their signs.
struct PartGuides(Box<Guides>, Tags, usize);

impl Work for PartGuides {
    type Output = (Box<Guides>, Signs);
    fn run<M: Mover>(self, mover: M) -> (Box<Guides>, Signs) {
        let PartGuides(mut guides, tags, count) = self;
        let mut signs = mover.part_guides(&mut guides, &tags, count);
        // Registers are longer.
        guides.iter_mut().for_each(|guide| guide[count..].fill(0));
        signs[count..].fill(0);
        (guides, signs)
    }
}

proptest! {
    #[test]
    fn both_movers_have_the_same_lanes(word in any::<u64>(), bits in any::<u8>(), width in 0u32..=8) {
        let found = Machine::best().run(Lanes(word, bits, width));
        prop_assert_eq!(found, Machine::Portable.run(Lanes(word, bits, width)));
        let [lanes, deposited, extracted, ..] = found;
        let places = (0..8).filter(|i| bits >> i & 1 == 1);
        prop_assert_eq!(lanes, places.clone().map(|i| 1u64 << (8 * i)).sum::<u64>());
        for (nth, place) in places.enumerate() {
            let name = word >> (nth as u32 * width) & ((1 << width) - 1);
            prop_assert_eq!(deposited >> (8 * place) & 0xff, name);
            prop_assert_eq!(extracted >> (8 * nth) & 0xff, word >> (8 * place) & 0xff);
        }
    }

    #[test]
    fn both_movers_have_the_same_ranges(
        words in prop::array::uniform3(any::<u64>()),
        and in any::<u64>(),
        size in 1u32..=8,
    ) {
        let (words, there) = (words.map(|word| word & and), u64::MAX >> (64 - 8 * size));
        prop_assert_eq!(Machine::best().run(Range(words, there)), Range(words, there).run(Portable));
    }

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
        let portable = Spread(word, bits, at).run(Portable);
        prop_assert_eq!(portable, Machine::best().run(Spread(word, bits, at)));
        let expected = (0..3).map(|a| {
            let field = word >> bits[..a].iter().sum::<u32>() & ((1 << bits[a]) - 1);
            field << at[a]
        });
        prop_assert_eq!(portable, expected.sum::<u64>());
    }

    #[test]
    fn packed_vertices_stand_one_behind_the_other(
        bits in 0u32..=57,
        words in prop::collection::vec(any::<u64>(), 1..=CLUSTER_VERTICES),
    ) {
        let (count, mut placed) = (words.len(), [0; 256]);
        placed.iter_mut().zip(&words).for_each(|(v, word)| *v = word & ((1 << bits) - 1));
        let found = Machine::best().run(Pack(&placed, count, bits));
        prop_assert_eq!(&found, &Machine::Portable.run(Pack(&placed, count, bits)));
        let bit = |at: usize| u64::from(found[at / 8] >> (at % 8) & 1);
        for (i, v) in placed[..count].iter().enumerate() {
            let there: u64 = (0..bits as usize).map(|k| bit(i * bits as usize + k) << k).sum();
            prop_assert_eq!(there, *v);
        }
        prop_assert!((count * bits as usize..8 * found.len()).all(|at| bit(at) == 0));
    }

    /// The sum over guides and signs is what the guides were told to sum.
    #[test]
    fn parted_guides_and_signs_make_the_same_sum(
        few in prop::collection::vec((prop::array::uniform3(0u8..4), 0u8..4), 1..=CLUSTER_VERTICES),
    ) {
        let (mut guides, mut tags, count) = (Box::new([[0; 264]; 3]), [0; CLUSTER_VERTICES], few.len());
        for (i, (backs, tag)) in few.iter().enumerate() {
            tags[i] = *tag;
            (0..3).for_each(|c| guides[c][i] = (i as u8).wrapping_sub(backs[c]) % 128);
        }
        let (parted, signs) = Machine::best().run(PartGuides(guides.clone(), tags, count));
        let portable = Machine::Portable.run(PartGuides(guides.clone(), tags, count));
        prop_assert_eq!((&parted[..], &signs[..]), (&portable.0[..], &portable.1[..]));
        // A number for each vertex, and none for no vertex.
        let value = |v: u8| if v == NO_VERTEX { 0 } else { i64::from(v) * 1000 + 7 };
        for i in 0..count {
            let sum = |guides: &Guides| value(guides[0][i]) + value(guides[1][i]) - value(guides[2][i]);
            let before = if i > 0 { value(i as u8 - 1) } else { 0 };
            let expected = if tags[i] == PLAIN { 0 } else { sum(&guides) };
            prop_assert_eq!(sum(&parted) + before * i64::from(signs[i]), expected);
        }
    }
}
