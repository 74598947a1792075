//! `ValueGuess`: what a value of a page is guessed to be by those before it, in the order of strips.
//!
//! ```text
//! strip:   c - a - value       a: the value before, across the strip; b: the one before that, on its own side
//!           \ / \ /            c: the third; what has none before it takes the first for all
//!            b - .
//! ```
//!
//! Invariant: encoder and decoder guess alike, whatever the values are: all is modulo the bits of a channel.

use super::corner_value::CornerValue;

/// How a cluster's values are guessed and taken apart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct GuessRule {
    rule: u8,
    split: u8,
}

/// Bits of a rule.
pub(super) const RULE_BITS: u32 = 3;
/// Rules of a way to take values apart.
const RULES: u8 = 4;

impl GuessRule {
    /// Of its bits: a reader takes whatever they are.
    pub(super) fn from_bits(bits: u64) -> GuessRule {
        GuessRule { rule: bits as u8 % RULES, split: bits as u8 / RULES % 2 }
    }

    pub(super) fn bits(self) -> u64 {
        u64::from(self.rule + RULES * self.split)
    }

    /// All rules for values of a kind.
    pub(super) fn all<V: CornerValue>() -> impl Iterator<Item = GuessRule> {
        (0..V::SPLITS).flat_map(|split| (0..RULES).map(move |rule| GuessRule { rule, split }))
    }

    pub(super) fn split(self) -> u8 {
        self.split
    }
}

/// The channels of the three values before, the last one first.
#[derive(Clone, Copy, Debug)]
pub(super) struct ValueGuess {
    rule: GuessRule,
    before: [[u16; 3]; 3],
    is_first: bool,
}

impl ValueGuess {
    /// Before the first value of a cluster, behind `last`, the last one of the cluster before.
    pub(super) fn new<V: CornerValue>(rule: GuessRule, last: V) -> ValueGuess {
        ValueGuess { rule, before: [last.channels(rule.split); 3], is_first: true }
    }

    /// The guess for a channel.
    #[inline(always)]
    pub(super) fn channel<V: CornerValue>(&self, channel: usize) -> u16 {
        let [a, b, c] = self.before.map(|value| value[channel]);
        match self.rule.rule {
            0 => a,
            1 => b,
            2 => a.wrapping_add((signed::<V>(b.wrapping_sub(a)) >> 1) as u16),
            _ => a.wrapping_add(b).wrapping_sub(c),
        }
    }

    /// Learns the value that was guessed.
    #[inline(always)]
    pub(super) fn learn(&mut self, value: [u16; 3]) {
        let [a, b, _] = self.before;
        self.before = if self.is_first { [value; 3] } else { [value, a, b] };
        self.is_first = false;
    }
}

/// Bits of a channel that are not those of the word that it stands in.
pub(super) const fn spare_bits<V: CornerValue>() -> u32 {
    u16::BITS - V::CHANNEL_BITS
}

/// A difference modulo the bits of a channel, as the nearest to 0.
#[inline(always)]
pub(super) fn signed<V: CornerValue>(difference: u16) -> i16 {
    ((difference << spare_bits::<V>()) as i16) >> spare_bits::<V>()
}
