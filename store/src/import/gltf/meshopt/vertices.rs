//! `RowDecoder`: rows of numbers, a block at a time.
//!
//! ```text
//! header | block | block | ... | padding, first row (and a kind per four bytes, version 1)
//! block: two bits a byte of a row (version 1) | for each byte of a row, its values in all rows of the block
//! values: two bits a group of 16 | groups: bits of each value, then whole bytes of those that do not fit
//! ```
//!
//! What is decoded are differences to the row before, by bytes, by 16 bits, or as changed bits of 32.
//!
//! Invariant: a block has at most 256 rows and 8 KiB, and takes at most [`FEED_BYTES`] compressed.

use super::feed::{DecodeResult, FEED_BYTES, Feed, Undecodable};

const HEADER: u8 = 0xa0;
/// Bytes of a block, decoded, and rows of it.
const BLOCK_BYTES: usize = 8192;
const BLOCK_ROWS: usize = 256;
/// Values of a group.
const GROUP: usize = 16;
/// Least bytes behind the last block, in versions 0 and 1.
const TAIL_BYTES: [usize; 2] = [32, 24];
/// Most bytes of a row.
const ROW_BYTES_MAX: usize = 256;

// Of each byte: the widths of its groups, and groups of 8 bytes of bits with all of their 16 values behind.
const _: () = assert!(BLOCK_BYTES * 3 / 2 + ROW_BYTES_MAX * 5 <= FEED_BYTES);

/// Decodes a view of rows.
pub(crate) struct RowDecoder {
    feed: Feed,
    version: u8,
    row_bytes: usize,
    /// How each four bytes of a row are coded; version 1 only.
    kinds: Vec<u8>,
    last: Vec<u8>,
    /// Of the block at hand: values by byte of the row, then rows.
    values: Vec<u8>,
    rows: Vec<u8>,
}

impl RowDecoder {
    /// Begins with the header and the tail. `row_bytes` is a multiple of four up to 256, which the caller has checked.
    pub(crate) fn begin(mut feed: Feed, row_bytes: usize) -> DecodeResult<RowDecoder> {
        assert!(row_bytes.is_multiple_of(4) && (4..=ROW_BYTES_MAX).contains(&row_bytes));
        // The tail comes first: once the window holds bytes, the end stands.
        let version = feed.first()?;
        if version & 0xf0 != HEADER || version & 0x0f > 1 {
            return Err(Undecodable::Wrong("it does not begin as rows of vertices do"));
        }
        let version = version & 0x0f;
        let used = if version == 0 { row_bytes } else { row_bytes + row_bytes / 4 };
        let padded = used.max(TAIL_BYTES[usize::from(version)]);
        let tail = feed.take_tail(padded)?;
        feed.byte()?;
        let first = &tail[padded - used..];
        Ok(RowDecoder {
            feed,
            version,
            row_bytes,
            kinds: first[row_bytes..].to_vec(),
            last: first[..row_bytes].to_vec(),
            values: vec![0; 4 * BLOCK_ROWS],
            rows: Vec::with_capacity(BLOCK_BYTES),
        })
    }

    /// Decodes the next block, when `left` rows are left, and gives its rows.
    pub(crate) fn block(&mut self, left: u64) -> DecodeResult<&mut [u8]> {
        let most = (BLOCK_BYTES / self.row_bytes / GROUP * GROUP).min(BLOCK_ROWS);
        let count = left.min(most as u64) as usize;
        self.rows.resize(count * self.row_bytes, 0);
        let data = self.feed.peek(FEED_BYTES)?;
        let mut cursor = BlockCursor { data, at: 0 };
        let control_bytes = if self.version == 0 { 0 } else { self.row_bytes / 4 };
        let control = cursor.take(control_bytes)?;
        for four in 0..self.row_bytes / 4 {
            let padded = count.next_multiple_of(GROUP);
            for byte in 0..4 {
                let values = &mut self.values[byte * padded..(byte + 1) * padded];
                let widths: &[u8; 4] = match control.get(four).map(|control| control >> (2 * byte) & 3) {
                    None => &[0, 2, 4, 8],
                    Some(0) => &[0, 1, 2, 4],
                    Some(1) => &[1, 2, 4, 8],
                    Some(2) => {
                        values.fill(0);
                        continue;
                    }
                    Some(_) => {
                        values[..count].copy_from_slice(cursor.take(count)?);
                        continue;
                    }
                };
                cursor.groups(values, widths)?;
            }
            let kind = self.kinds.get(four).copied().unwrap_or(0);
            let last: &mut [u8] = &mut self.last[4 * four..4 * four + 4];
            let place = RowPlace { rows: &mut self.rows, stride: self.row_bytes, offset: 4 * four };
            undo_differences(kind, &self.values, padded, last, place)?;
        }
        let used = cursor.at;
        self.feed.consume(used);
        Ok(&mut self.rows)
    }

    /// Checks that nothing is left.
    pub(crate) fn finish(self) -> DecodeResult<()> {
        if self.feed.left() == 0 { Ok(()) } else { Err(Undecodable::Wrong("bytes are left over")) }
    }
}

/// Bytes of a block.
struct BlockCursor<'a> {
    data: &'a [u8],
    at: usize,
}

impl<'a> BlockCursor<'a> {
    fn take(&mut self, count: usize) -> DecodeResult<&'a [u8]> {
        let taken = self.data.get(self.at..self.at + count);
        self.at += count;
        taken.ok_or(Undecodable::Wrong("it ends early"))
    }

    /// Values in groups, each of one of four widths.
    fn groups(&mut self, values: &mut [u8], widths: &[u8; 4]) -> DecodeResult<()> {
        let header = self.take((values.len() / GROUP).div_ceil(4))?;
        for (at, group) in values.chunks_exact_mut(GROUP).enumerate() {
            let width = widths[usize::from(header[at / 4] >> (at % 4 * 2) & 3)];
            self.group(group, width)?;
        }
        Ok(())
    }

    fn group(&mut self, group: &mut [u8], width: u8) -> DecodeResult<()> {
        match width {
            0 => group.fill(0),
            8 => group.copy_from_slice(self.take(GROUP)?),
            _ => {
                let bits = self.take(GROUP * usize::from(width) / 8)?;
                let (per_byte, escape) = (8 / usize::from(width), (1 << width) - 1);
                for (at, value) in group.iter_mut().enumerate() {
                    let (byte, place) = (bits[at / per_byte], at % per_byte);
                    // Single bits stand from the lowest on, wider values from the highest.
                    let shift = if width == 1 { place } else { 8 - usize::from(width) * (place + 1) };
                    *value = byte >> shift & escape;
                    if *value == escape {
                        *value = self.take(1)?[0];
                    }
                }
            }
        }
        Ok(())
    }
}

/// Where four bytes of each row go.
struct RowPlace<'a> {
    rows: &'a mut [u8],
    stride: usize,
    offset: usize,
}

/// Adds up four bytes of each row, whose values lie by byte, `padded` of each.
fn undo_differences(
    kind: u8,
    values: &[u8],
    padded: usize,
    last: &mut [u8],
    place: RowPlace<'_>,
) -> DecodeResult<()> {
    let mut sum = [last[0], last[1], last[2], last[3]];
    for (at, row) in place.rows.chunks_exact_mut(place.stride).enumerate() {
        let value = [0, 1, 2, 3].map(|byte| values[byte * padded + at]);
        match kind & 3 {
            0 => {
                for (sum, value) in sum.iter_mut().zip(value) {
                    *sum = sum.wrapping_add((value >> 1) ^ (value & 1).wrapping_neg());
                }
            }
            1 => {
                for half in [0, 2] {
                    let value = u16::from_le_bytes([value[half], value[half + 1]]);
                    let difference = (value >> 1) ^ (value & 1).wrapping_neg();
                    let now = u16::from_le_bytes([sum[half], sum[half + 1]]).wrapping_add(difference);
                    sum[half..half + 2].copy_from_slice(&now.to_le_bytes());
                }
            }
            2 => {
                let changed = u32::from_le_bytes(value).rotate_right(u32::from(kind >> 4));
                sum = (u32::from_le_bytes(sum) ^ changed).to_le_bytes();
            }
            _ => return Err(Undecodable::Wrong("its numbers are coded in an unknown way")),
        }
        row[place.offset..place.offset + 4].copy_from_slice(&sum);
    }
    last.copy_from_slice(&sum);
    Ok(())
}
