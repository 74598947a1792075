//! `CornerValue`: what corners have beside their places: colours, normals. One codec serves both.

use super::normal::{NORMAL_BITS, Normal};

/// Red, green, blue.
pub type Colour = [u8; 3];
/// The colour of what has none: a material's colour times white is the material's.
pub const WHITE: Colour = [255; 3];

/// A value of a corner, made of channels that are coded one by one.
pub trait CornerValue: Copy + PartialEq {
    /// What a corner has that has none: where all have it, nothing is stored.
    const NONE: Self;
    /// Channels, three at most.
    const CHANNELS: usize;
    /// Bits of a channel, modulo which differences are taken.
    const CHANNEL_BITS: u32;
    /// Ways to take a value apart.
    const SPLITS: u8;

    /// The channels as they are coded, taken apart in a way; of those behind the last one, 0.
    fn channels(self, split: u8) -> [u16; 3];

    /// The value of such channels, modulo their bits.
    fn from_channels(channels: [u16; 3], split: u8) -> Self;

    /// As it stands in a frame, and among exceptions.
    fn to_bytes(self) -> [u8; 3];

    /// Of these bytes, whatever they are.
    fn from_bytes(bytes: [u8; 3]) -> Self;
}

impl CornerValue for Colour {
    const NONE: Colour = WHITE;
    const CHANNELS: usize = 3;
    const CHANNEL_BITS: u32 = 8;
    const SPLITS: u8 = 2;

    /// Green, and red and blue: what they have more, or as they are.
    fn channels(self, split: u8) -> [u16; 3] {
        let [r, g, b] = self;
        let less = if split == 0 { g } else { 0 };
        [g, r.wrapping_sub(less), b.wrapping_sub(less)].map(u16::from)
    }

    fn from_channels(channels: [u16; 3], split: u8) -> Colour {
        let [g, r, b] = channels.map(|channel| channel as u8);
        let less = if split == 0 { g } else { 0 };
        [r.wrapping_add(less), g, b.wrapping_add(less)]
    }

    fn to_bytes(self) -> [u8; 3] {
        self
    }

    fn from_bytes(bytes: [u8; 3]) -> Colour {
        bytes
    }
}

impl CornerValue for Normal {
    const NONE: Normal = Normal::NONE;
    const CHANNELS: usize = 2;
    const CHANNEL_BITS: u32 = NORMAL_BITS;
    const SPLITS: u8 = 1;

    fn channels(self, _: u8) -> [u16; 3] {
        let [x, y] = self.coordinates().map(|v| v as u16);
        [x, y, 0]
    }

    fn from_channels([x, y, _]: [u16; 3], _: u8) -> Normal {
        Normal::from_coordinates([x, y].map(u32::from))
    }

    fn to_bytes(self) -> [u8; 3] {
        let [a, b, c, _] = self.code().to_le_bytes();
        [a, b, c]
    }

    fn from_bytes([a, b, c]: [u8; 3]) -> Normal {
        Normal::from_code(u32::from_le_bytes([a, b, c, 0]))
    }
}
