//! `IndexDecoder` and `SequenceDecoder`: indices of triangles, and indices of anything.
//!
//! ```text
//! triangles: header | a code per triangle | data | table of 16 codes
//! sequence:  header | differences, each to one of the last two     | 4 bytes
//! ```
//!
//! A code says which of the last 16 edges the triangle stands on, and which of the last 16 vertices is its third, or
//! that this one is new, or comes as a difference. `next` is the vertex that was not there before.

use super::feed::{DecodeResult, Feed, Undecodable, unzigzag};

const TRIANGLES: u8 = 0xe0;
const SEQUENCE: u8 = 0xd0;
/// Bytes of the table, and of what follows a sequence.
const TABLE_BYTES: usize = 16;
const SEQUENCE_TAIL_BYTES: usize = 4;

/// The last 16 of something; the latest is 0.
struct Recent<T> {
    items: [T; 16],
    at: usize,
}

impl<T: Copy> Recent<T> {
    fn new(item: T) -> Recent<T> {
        Recent { items: [item; 16], at: 0 }
    }

    fn push(&mut self, item: T) {
        self.items[self.at & 15] = item;
        self.at = (self.at + 1) & 15;
    }

    /// The one `back` before the latest.
    fn get(&self, back: u8) -> T {
        self.items[self.at.wrapping_sub(1 + usize::from(back)) & 15]
    }
}

/// Decodes indices of triangles, three at a time.
pub(crate) struct IndexDecoder {
    codes: Feed,
    data: Feed,
    table: Vec<u8>,
    edges: Recent<[u32; 2]>,
    vertices: Recent<u32>,
    next: u32,
    last: u32,
    /// Codes of a third vertex from here on are differences.
    first_difference: u8,
}

impl IndexDecoder {
    /// Begins with the header; the feeds are of the header with the codes, and of the data with the table.
    pub(crate) fn begin([mut codes, mut data]: [Feed; 2]) -> DecodeResult<IndexDecoder> {
        let version = codes.byte()?;
        if version & 0xf0 != TRIANGLES || version & 0x0f > 1 {
            return Err(Undecodable::Wrong("it does not begin as indices of triangles do"));
        }
        let table = data.take_tail(TABLE_BYTES)?;
        Ok(IndexDecoder {
            codes,
            data,
            table,
            edges: Recent::new([u32::MAX; 2]),
            vertices: Recent::new(u32::MAX),
            next: 0,
            last: 0,
            first_difference: if version & 0x0f >= 1 { 13 } else { 15 },
        })
    }

    /// The next triangle.
    pub(crate) fn triangle(&mut self) -> DecodeResult<[u32; 3]> {
        let code = self.codes.byte()?;
        match code {
            0..0xf0 => self.on_an_edge(code >> 4, code & 15),
            0xf0..0xfe => {
                let table = self.table[usize::from(code & 15)];
                self.apart([0, table >> 4, table & 15])
            }
            _ => {
                let parts = self.data.byte()?;
                if parts == 0 {
                    self.next = 0;
                }
                self.apart([if code == 0xfe { 0 } else { 15 }, parts >> 4, parts & 15])
            }
        }
    }

    fn on_an_edge(&mut self, edge: u8, third: u8) -> DecodeResult<[u32; 3]> {
        let [a, b] = self.edges.get(edge);
        let c = match third {
            0 => {
                let new = self.fresh();
                self.vertices.push(new);
                new
            }
            third if third < self.first_difference => self.vertices.get(third),
            third => {
                self.last = match third {
                    13 => self.last.wrapping_sub(1),
                    14 => self.last.wrapping_add(1),
                    _ => self.difference()?,
                };
                self.vertices.push(self.last);
                self.last
            }
        };
        self.edges.push([c, b]);
        self.edges.push([a, c]);
        Ok([a, b, c])
    }

    /// A triangle without a known edge: of each corner 0 for a new vertex, 15 for a difference, else a recent one.
    fn apart(&mut self, parts: [u8; 3]) -> DecodeResult<[u32; 3]> {
        // New and recent ones first, as they were before this triangle; differences follow in order.
        let mut corners = [0; 3];
        for (at, part) in parts.into_iter().enumerate() {
            corners[at] = match part {
                0 => self.fresh(),
                15 => 0,
                // Counted from the latest one as 1: new ones of this triangle are not among them.
                recent => self.vertices.get(recent - 1),
            };
        }
        for (corner, part) in corners.iter_mut().zip(parts) {
            if part == 15 {
                *corner = self.difference()?;
                self.last = *corner;
            }
        }
        let [a, b, c] = corners;
        self.vertices.push(a);
        for (corner, part) in [(b, parts[1]), (c, parts[2])] {
            if part == 0 || part == 15 {
                self.vertices.push(corner);
            }
        }
        [[b, a], [c, b], [a, c]].into_iter().for_each(|edge| self.edges.push(edge));
        Ok(corners)
    }

    fn fresh(&mut self) -> u32 {
        let new = self.next;
        self.next = new.wrapping_add(1);
        new
    }

    fn difference(&mut self) -> DecodeResult<u32> {
        Ok(self.last.wrapping_add(unzigzag(self.data.vbyte()?)))
    }

    /// Checks that nothing is left.
    pub(crate) fn finish(self) -> DecodeResult<()> {
        if self.data.left() == 0 { Ok(()) } else { Err(Undecodable::Wrong("bytes are left over")) }
    }
}

/// Decodes indices one by one.
pub(crate) struct SequenceDecoder {
    feed: Feed,
    last: [u32; 2],
}

impl SequenceDecoder {
    /// Begins with the header.
    pub(crate) fn begin(mut feed: Feed) -> DecodeResult<SequenceDecoder> {
        feed.take_tail(SEQUENCE_TAIL_BYTES)?;
        let version = feed.byte()?;
        if version & 0xf0 != SEQUENCE || version & 0x0f > 1 {
            return Err(Undecodable::Wrong("it does not begin as a sequence of indices does"));
        }
        Ok(SequenceDecoder { feed, last: [0; 2] })
    }

    /// The next index.
    pub(crate) fn index(&mut self) -> DecodeResult<u32> {
        let number = self.feed.vbyte()?;
        let last = &mut self.last[(number & 1) as usize];
        *last = last.wrapping_add(unzigzag(number >> 1));
        Ok(*last)
    }

    /// Checks that nothing is left.
    pub(crate) fn finish(self) -> DecodeResult<()> {
        if self.feed.left() == 0 { Ok(()) } else { Err(Undecodable::Wrong("bytes are left over")) }
    }
}
