//! `Atlas`: marked blocks of a picture side by side, and the frame that carries them as one JPEG.
//!
//! Invariants: 1. neither the atlas nor a frame takes more than it says; 2. a block that the picture's edge cuts is
//! filled up with its last pixels, which no one sees.

use crate::blocks::{BLOCK_SIDE, Layout};
use crate::picture::{Picture, Settled};
use jpeg_encoder::{ColorType, Encoder, SamplingFactor};
use std::io::{self, Write};
use tungstenite::protocol::frame::FrameHeader;
use tungstenite::protocol::frame::coding::{Data, OpCode};

/// Quality of JPEG while the picture changes, and what it falls to where that does not fit.
const QUALITIES: [u8; 3] = [85, 60, 25];
/// Bytes of a frame beside a byte for each pixel: tables, and pictures so small that these count.
const FRAME_FIXED_BYTES: usize = 64 << 10;
/// Most bytes of the header of a message from a server.
const HEADER_BYTES_MAX: usize = 10;
/// Kinds of binary messages.
const KIND_BLOCKS: u8 = 1;
const KIND_WHOLE: u8 = 2;
/// Bytes in front of the indices of blocks.
const HEAD_BYTES: usize = 20;

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

/// Most bytes of the frames of a client, for pictures of `full` pixels.
pub(crate) fn frame_bytes(full: [u32; 2]) -> usize {
    let pixels = full[0] as usize * full[1] as usize;
    let blocks = Layout::new(full, 1).count() as usize;
    pixels + 2 * blocks + FRAME_FIXED_BYTES
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

    /// Makes the message of these blocks in `bytes`, of at most `most` bytes. Gives where it begins; `None` when it does
    /// not fit.
    pub(crate) fn encode(&self, most: usize, bytes: &mut Vec<u8>) -> Option<usize> {
        let [width, height] = [self.columns, self.rows].map(|count| (count * BLOCK_SIDE) as u16);
        for quality in QUALITIES {
            bytes.clear();
            bytes.resize(HEADER_BYTES_MAX, 0);
            self.head.write(KIND_BLOCKS, self.columns, &self.blocks, bytes);
            let mut encoder = Encoder::new(Bounded { bytes, most }, quality);
            encoder.set_sampling_factor(SamplingFactor::F_1_1);
            if encoder.encode(&self.rgb, width, height, ColorType::Rgb).is_ok() {
                return Some(finish(bytes));
            }
        }
        None
    }

    /// The frame that was copied last.
    pub(crate) fn head(&self) -> FrameHead {
        self.head
    }
}

/// The message that goes before the bytes of a settled picture.
pub(crate) fn whole_head(settled: &Settled, head: FrameHead) -> Vec<u8> {
    let head = FrameHead { frame: settled.frame, scale: 1, ..head };
    let mut bytes = header(HEAD_BYTES + settled.png.len());
    head.write(KIND_WHOLE, 0, &[], &mut bytes);
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
    let mut bytes = Vec::with_capacity(HEADER_BYTES_MAX + HEAD_BYTES);
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

/// A vector that takes so much and no more.
pub(crate) struct Bounded<'a> {
    pub(crate) bytes: &'a mut Vec<u8>,
    pub(crate) most: usize,
}

impl Write for Bounded<'_> {
    fn write(&mut self, more: &[u8]) -> io::Result<usize> {
        let wanted = self.bytes.len() + more.len();
        if wanted > self.most {
            return Err(io::ErrorKind::StorageFull.into());
        }
        // Doubling would take up to twice the bound.
        if wanted > self.bytes.capacity() {
            let room = (2 * self.bytes.capacity()).clamp(wanted, self.most.max(wanted));
            self.bytes.reserve_exact(room - self.bytes.len());
        }
        self.bytes.extend_from_slice(more);
        Ok(more.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}
