//! `Atlas`: marked blocks of a picture side by side, and the frame that carries them as one JPEG.
//!
//! Invariants: 1. neither the atlas nor a frame takes more than it says; 2. a block that the picture's edge cuts is
//! filled up with its last pixels, which no one sees.

use crate::blocks::Layout;
use crate::bounded::BoundedWriter;
use crate::picture::Picture;
use crate::wire::{BLOCK_SIDE, FRAME_HEAD_BYTES, KIND_BLOCKS, KIND_WHOLE, PART_HEAD_BYTES};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use tungstenite::protocol::frame::FrameHeader;
use tungstenite::protocol::frame::coding::{Data, OpCode};

/// Quality of JPEG while the picture changes.
const QUALITY: u8 = 85;
/// Pixels of a picture to a byte of a frame: a picture full of noise takes more, and goes in two. Each client has a
/// frame leased, so what is added to the narrow one is taken from the pages of the model, eightfold.
const WIDE_PIXELS_PER_BYTE: usize = 3;
const NARROW_PIXELS_PER_BYTE: usize = 6;
/// Bytes of a frame beside these: tables, and pictures so small that these count.
const FRAME_FIXED_BYTES: usize = 32 << 10;
/// Most bytes of the header of a message from a server.
const HEADER_BYTES_MAX: usize = 10;

const BLOCK_PIXELS: usize = (BLOCK_SIDE * BLOCK_SIDE) as usize;

/// Blocks of a picture, copied.
#[derive(Debug, Default)]
pub(crate) struct Atlas {
    /// Their places in the picture, rising.
    pub(crate) blocks: Vec<u16>,
    /// Their pixels, a row of blocks after the other.
    rgb: Vec<u8>,
    /// Blocks in a row.
    columns: u32,
    rows: u32,
    head: FrameHead,
}

/// What a frame says of itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct FrameHead {
    pub(crate) flags: u8,
    pub(crate) scale: u32,
    pub(crate) frame: u32,
    pub(crate) seq: u32,
    /// Width and height of the whole picture, pixels.
    pub(crate) full: [u32; 2],
}

impl FrameHead {
    fn of(picture: &Picture) -> FrameHead {
        let Picture { flags, scale, frame, seq, full, .. } = *picture;
        FrameHead { flags, scale, frame, seq, full }
    }

    fn write(&self, kind: u8, columns: u32, blocks: &[u16], bytes: &mut Vec<u8>) {
        let [width, height] = self.full;
        bytes.extend_from_slice(&[kind, self.flags]);
        bytes.extend_from_slice(&(self.scale as u16).to_le_bytes());
        bytes.extend_from_slice(&self.frame.to_le_bytes());
        bytes.extend_from_slice(&self.seq.to_le_bytes());
        for number in [width, height, columns, blocks.len() as u32] {
            bytes.extend_from_slice(&(number as u16).to_le_bytes());
        }
        bytes.extend(blocks.iter().flat_map(|block| block.to_le_bytes()));
    }
}

/// How large a frame may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum FrameWidth {
    /// Of the page that drives, while it has the one room for it.
    Wide,
    /// Of all others: their frames go in more parts.
    Narrow,
}

/// Most bytes of a frame of this width, for pictures of `full` pixels.
pub(crate) fn frame_bytes(full: [u32; 2], width: FrameWidth) -> usize {
    let pixels_per_byte = match width {
        FrameWidth::Wide => WIDE_PIXELS_PER_BYTE,
        FrameWidth::Narrow => NARROW_PIXELS_PER_BYTE,
    };
    let pixels = full[0] as usize * full[1] as usize;
    let blocks = Layout::new(full, 1).count() as usize;
    pixels / pixels_per_byte + 2 * blocks + FRAME_FIXED_BYTES
}

impl Atlas {
    /// Bytes that an atlas takes for pictures of `full` pixels.
    pub(crate) fn bytes(full: [u32; 2]) -> u64 {
        let layout = Layout::new(full, Picture::least_scale(full));
        // The last row of blocks may not be full.
        (u64::from(layout.count()) + u64::from(layout.columns())) * (3 * BLOCK_PIXELS as u64 + 2)
    }

    /// Copies the blocks that are listed in `blocks` from `picture`.
    pub(crate) fn copy(&mut self, picture: &Picture) {
        let layout = picture.layout;
        self.head = FrameHead::of(picture);
        let count = self.blocks.len() as u32;
        self.columns = layout.columns().min(count);
        self.rows = count.div_ceil(self.columns.max(1));
        let line = (self.columns * BLOCK_SIDE) as usize;
        // What is left from the last time shows in places without a block, where nobody looks.
        self.rgb.resize(line * (self.rows * BLOCK_SIDE) as usize * 3, 0);
        for (place, &block) in (0..).zip(&self.blocks) {
            let ([x, y], [width, height]) = layout.rect(u32::from(block));
            let [column, row] =
                [place % self.columns, place / self.columns].map(|n| (n * BLOCK_SIDE) as usize);
            for step in 0..BLOCK_SIDE {
                let from = (y + step.min(height - 1)) as usize * layout.size[0] as usize + x as usize;
                let source = picture.rgb[from..][..width as usize].as_flattened();
                let to = ((row + step as usize) * line + column) * 3;
                let target = &mut self.rgb[to..][..BLOCK_SIDE as usize * 3];
                let (inside, past) = target.split_at_mut(source.len());
                inside.copy_from_slice(source);
                past.chunks_exact_mut(3).for_each(|pixel| pixel.copy_from_slice(&source[source.len() - 3..]));
            }
        }
    }

    /// Makes the message of these blocks in `bytes`, of at most `most` bytes. Gives where it begins; `None` when it
    /// does not fit.
    pub(crate) fn encode(&self, most: usize, bytes: &mut Vec<u8>) -> Option<usize> {
        let [width, height] = [self.columns, self.rows].map(|count| (count * BLOCK_SIDE) as u16);
        bytes.clear();
        bytes.resize(HEADER_BYTES_MAX, 0);
        self.head.write(KIND_BLOCKS, self.columns, &self.blocks, bytes);
        let mut encoder = Encoder::new(BoundedWriter::new(bytes, most, &|| false), QUALITY);
        encoder.set_sampling_factor(SamplingFactor::F_1_1);
        encoder.encode(&self.rgb, width, height, ColorType::Rgb).ok()?;
        Some(finish(bytes))
    }

    /// The frame that was copied last.
    pub(crate) fn head(&self) -> FrameHead {
        self.head
    }
}

/// What goes before `length` bytes, from byte `from` on, of a settled picture of `total` bytes.
pub(crate) fn part_head(head: FrameHead, from: usize, length: usize, total: usize) -> Vec<u8> {
    let head = FrameHead { scale: 1, ..head };
    let mut bytes = header(FRAME_HEAD_BYTES + PART_HEAD_BYTES + length);
    head.write(KIND_WHOLE, 0, &[], &mut bytes);
    bytes.extend([from, total].into_iter().flat_map(|number| (number as u32).to_le_bytes()));
    bytes
}

impl FrameHead {
    /// The head of what a picture shows.
    pub(crate) fn new(picture: &Picture) -> FrameHead {
        FrameHead::of(picture)
    }
}

/// The header of a binary message of so many bytes.
pub(crate) fn header(length: usize) -> Vec<u8> {
    let header = FrameHeader { opcode: OpCode::Data(Data::Binary), ..FrameHeader::default() };
    let mut bytes = Vec::with_capacity(HEADER_BYTES_MAX + FRAME_HEAD_BYTES + PART_HEAD_BYTES);
    header.format(length as u64, &mut bytes).expect("a vector takes what is written");
    bytes
}

/// Writes the header of a message in front of it, into the room that was left for it. Gives where it begins.
fn finish(bytes: &mut [u8]) -> usize {
    let header = header(bytes.len() - HEADER_BYTES_MAX);
    let start = HEADER_BYTES_MAX - header.len();
    bytes[start..HEADER_BYTES_MAX].copy_from_slice(&header);
    start
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::picture::{BlockChanges, TileSource};
    use crate::tone::Tone;
    use rand_pcg::Pcg64Mcg;
    use rand_pcg::rand_core::{Rng, SeedableRng};
    use std::cell::RefCell;

    fn picture(size: [u32; 2], value: &dyn Fn([u32; 2]) -> f32) -> Picture {
        let mut picture = Picture::new(size);
        let show = |[x, y]: [u32; 2], radiances: &mut [[f32; 3]]| {
            (x..).zip(radiances).for_each(|(x, radiance)| *radiance = [value([x, y]); 3]);
        };
        let changed =
            picture.refresh(1, &Tone::new(1.0), &mut TileSource { has_changed: &mut |_| true, show: &show });
        assert_eq!(changed, BlockChanges::All);
        picture
    }

    #[test]
    fn blocks_stand_side_by_side_and_edges_are_filled_up() {
        let size = [40, 20];
        let picture = picture(size, &|[x, y]| (x + 40 * y) as f32 / 1000.0);
        let mut atlas = Atlas { blocks: vec![0, 2, 3, 5], ..Atlas::default() };
        atlas.copy(&picture);
        assert_eq!((atlas.columns, atlas.rows), (3, 2));
        let at = |x: usize, y: usize| atlas.rgb[(y * 48 + x) * 3];
        let there = |x: usize, y: usize| picture.rgb[y * 40 + x][0];
        assert_eq!((at(0, 0), at(15, 15)), (there(0, 0), there(15, 15)));
        // Block 2 is 8 wide, block 3 is 4 high, block 5 both.
        assert_eq!((at(16, 3), at(23, 3), at(31, 3)), (there(32, 3), there(39, 3), there(39, 3)));
        assert_eq!((at(33, 2), at(33, 15)), (there(1, 18), there(1, 19)));
        assert_eq!(at(15, 31), there(39, 19));
    }

    #[test]
    fn a_frame_says_what_it_holds() {
        let mut picture = picture([640, 320], &|[x, _]| (x % 16) as f32 / 16.0);
        (picture.frame, picture.seq, picture.flags) = (0x0102_0304, 7, 5);
        let mut atlas = Atlas { blocks: vec![1, 39, 40, 799], ..Atlas::default() };
        atlas.copy(&picture);
        let mut bytes = vec![];
        let start = atlas.encode(frame_bytes([640, 320], FrameWidth::Wide), &mut bytes).unwrap();
        let message = &bytes[start..];
        // Final, binary, 16 bits of length.
        assert_eq!((message[0], message[1]), (0x82, 126));
        assert_eq!(usize::from(u16::from_be_bytes([message[2], message[3]])), message.len() - 4);
        let head = &message[4..];
        assert_eq!(head[..12], [1, 5, 1, 0, 4, 3, 2, 1, 7, 0, 0, 0]);
        assert_eq!(head[12..20], [128, 2, 64, 1, 4, 0, 4, 0]);
        assert_eq!(head[20..28], [1, 0, 39, 0, 40, 0, 31, 3]);
        assert_eq!(head[28..30], [0xff, 0xd8]);
    }

    /// Noise takes more than a third of a byte a pixel.
    #[test]
    fn what_does_not_fit_is_not_made() {
        let random = RefCell::new(Pcg64Mcg::seed_from_u64(3));
        let picture = picture([256, 256], &|_| random.borrow_mut().next_u32() as f32 / u32::MAX as f32);
        let mut atlas = Atlas { blocks: (0..256).collect(), ..Atlas::default() };
        atlas.copy(&picture);
        let (mut bytes, most) = (vec![], 40_000);
        assert_eq!(atlas.encode(most, &mut bytes), None);
        assert!(bytes.capacity() <= most);
        // One block always does.
        atlas.blocks.truncate(1);
        atlas.copy(&picture);
        assert!(atlas.encode(frame_bytes([1, 1], FrameWidth::Narrow), &mut bytes).is_some());
    }
}
