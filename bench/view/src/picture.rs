//! What a page shows: blocks put together as `view/page/picture.js` does it, a small picture smoothed over the whole.

use crate::page::Failure;
use std::io::Cursor;

const KIND_BLOCKS: u8 = 1;
const KIND_WHOLE: u8 = 2;
/// Bytes in front of the indices of blocks, and of a part of a settled picture.
const HEAD_BYTES: usize = 20;
const PART_HEAD_BYTES: usize = 28;
const BLOCK: usize = 16;

type Rgb = [u8; 3];

/// The picture that is shown.
#[derive(Clone, Default)]
pub(crate) struct Canvas {
    size: [usize; 2],
    pixels: Vec<Rgb>,
    small_size: [usize; 2],
    small: Vec<Rgb>,
    /// What has come of a settled picture.
    settled: Vec<u8>,
    /// The last event that it shows.
    pub(crate) seq: u32,
}

impl Canvas {
    /// Draws a message of the server.
    pub(crate) fn draw(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        let short = |at: usize| usize::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
        let long = |at: usize| u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]]);
        let (scale, seq, size) = (short(2), long(8), [short(12), short(14)]);
        if self.size != size {
            (self.size, self.pixels) = (size, vec![[0; 3]; size[0] * size[1]]);
        }
        match bytes[0] {
            KIND_BLOCKS => {
                let (columns, count) = (short(16), short(18));
                let blocks = bytes[HEAD_BYTES..][..2 * count].as_chunks::<2>().0;
                let blocks = blocks.iter().map(|&block| usize::from(u16::from_le_bytes(block)));
                let atlas = jpeg_decoder::Decoder::new(&bytes[HEAD_BYTES + 2 * count..]).decode()?;
                let atlas = (atlas.as_chunks::<3>().0, columns);
                if scale == 1 {
                    copy(blocks, atlas, &mut self.pixels, size);
                } else {
                    let small_size = size.map(|side| side.div_ceil(scale));
                    if self.small_size != small_size {
                        (self.small_size, self.small) =
                            (small_size, vec![[0; 3]; small_size[0] * small_size[1]]);
                    }
                    copy(blocks, atlas, &mut self.small, small_size);
                    self.smooth(scale);
                }
                self.seq = seq;
            }
            KIND_WHOLE => {
                if long(20) == 0 {
                    self.settled.clear();
                }
                self.settled.extend_from_slice(&bytes[PART_HEAD_BYTES..]);
                if self.settled.len() == long(24) as usize {
                    let mut reader = png::Decoder::new(Cursor::new(&self.settled)).read_info()?;
                    reader.next_frame(self.pixels.as_flattened_mut())?;
                    self.seq = seq;
                }
            }
            _ => {}
        }
        Ok(())
    }

    /// The small picture over the whole: its pixels are the top left ones of their squares.
    fn smooth(&mut self, scale: usize) {
        let ([width, height], [small_width, small_height]) = (self.size, self.small_size);
        for y in 0..height {
            for x in 0..width {
                let (column, row) = (x / scale, y / scale);
                let [right, below] = [(column + 1).min(small_width - 1), (row + 1).min(small_height - 1)];
                let [u, v] = [x, y].map(|at| (at % scale) as f32 / scale as f32);
                let at = |column: usize, row: usize| self.small[row * small_width + column].map(f32::from);
                let corners = [at(column, row), at(right, row), at(column, below), at(right, below)];
                let weights = [(1.0 - u) * (1.0 - v), u * (1.0 - v), (1.0 - u) * v, u * v];
                self.pixels[y * width + x] = std::array::from_fn(|channel| {
                    let sum: f32 = corners.iter().zip(weights).map(|(corner, w)| w * corner[channel]).sum();
                    sum.round() as u8
                });
            }
        }
    }

    /// Writes the picture as a PNG.
    pub(crate) fn write(&self, path: &std::path::Path) -> Result<(), Failure> {
        let mut encoder = png::Encoder::new(
            std::io::BufWriter::new(std::fs::File::create(path)?),
            self.size[0] as u32,
            self.size[1] as u32,
        );
        encoder.set_color(png::ColorType::Rgb);
        Ok(encoder.write_header()?.write_image_data(self.pixels.as_flattened())?)
    }
}

/// Copies blocks from an atlas with so many of them in a row.
fn copy(
    blocks: impl Iterator<Item = usize>,
    (atlas, atlas_columns): (&[Rgb], usize),
    picture: &mut [Rgb],
    [width, height]: [usize; 2],
) {
    let columns = width.div_ceil(BLOCK);
    for (place, block) in blocks.enumerate() {
        let [x, y] = [block % columns * BLOCK, block / columns * BLOCK];
        let [from_x, from_y] = [place % atlas_columns * BLOCK, place / atlas_columns * BLOCK];
        let line = BLOCK.min(width - x);
        for row in 0..BLOCK.min(height - y) {
            let from = (from_y + row) * atlas_columns * BLOCK + from_x;
            picture[(y + row) * width + x..][..line].copy_from_slice(&atlas[from..][..line]);
        }
    }
}
