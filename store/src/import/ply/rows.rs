//! `Rows`: the values of a PLY body, one after the other, from text or from bytes.
//!
//! Invariants: 1. values are asked for in the order of the header; 2. a row of text is a line: too few words are an
//! error, and never taken from the next line; 3. lists of any length are stepped over without memory.

use super::super::input::{Input, WINDOW_BYTES};
use super::super::scalar::{ByteOrder, FromOrder, Scalar, head};
use super::super::text::{Mark, Text};
use super::header::Element;
use crate::error::{Code, Error, Result};
use crate::source::TriangleBatch;

/// A body, value by value.
pub(super) trait Rows: Send {
    /// A place in the file to come back to.
    type Place: Copy + Send;

    /// The file below.
    fn input(&self) -> &Input;

    /// This place.
    fn place(&self) -> Self::Place;

    /// Goes to a place.
    fn seek(&mut self, place: Self::Place);

    /// Goes to the first value of the next row.
    fn begin_row(&mut self) -> Result<()>;

    /// Leaves the row. True when it held more than was asked for.
    fn end_row(&mut self) -> Result<bool>;

    /// The next value, as a coordinate.
    fn number(&mut self, scalar: Scalar) -> Result<f64>;

    /// The next value, as an index or a count.
    fn integer(&mut self, scalar: Scalar) -> Result<i64>;

    /// Steps over `count` values.
    fn skip(&mut self, scalar: Scalar, count: u64) -> Result<()>;

    /// Steps over all rows of `element` at once, if that can be done.
    fn skip_all(&mut self, element: &Element) -> Result<bool>;

    /// Reads rows that are plain triangles, at most `most`, for as long as they come; see [`TriangleRows`].
    fn triangles(&mut self, rows: TriangleRows, most: u64, run: &mut TriangleRun) -> Result<()>;

    /// An error of `code` at this place.
    fn error(&self, code: Code, what: &str, numbers: String) -> Error;
}

/// Rows that are one list of 32-bit indices with a one-byte count, between values of fixed size: what nearly all
/// binary files hold.
#[derive(Clone, Copy, Debug)]
pub(super) struct TriangleRows {
    /// Bytes before the list.
    pub(super) before: usize,
    /// Bytes after the list.
    pub(super) after: usize,
}

impl TriangleRows {
    /// Count and three indices.
    const LIST_BYTES: usize = 13;

    /// Most bytes around the list, so that a window holds a full batch of rows or close to it.
    pub(super) const MAX_AROUND_BYTES: usize = 64;

    fn row_bytes(self) -> usize {
        self.before + Self::LIST_BYTES + self.after
    }
}

/// Corner indices of a run of triangle rows.
#[derive(Debug, Default)]
pub(super) struct TriangleRun {
    /// Three per triangle, as the bytes say them: a negative index is a large one.
    pub(super) indices: Vec<[u32; 3]>,
    /// Offset of the first row, and bytes from a row to the next.
    pub(super) offset: u64,
    /// See `offset`.
    pub(super) row_bytes: u64,
}

impl TriangleRun {
    /// Bytes that a full run takes.
    pub(super) const BYTES: u64 = (TriangleBatch::TARGET_TRIANGLES * 12) as u64;
}

/// A body of words.
pub(super) struct AsciiRows(pub(super) Text);

impl Rows for AsciiRows {
    type Place = Mark;

    fn input(&self) -> &Input {
        self.0.input()
    }

    fn place(&self) -> Mark {
        self.0.mark()
    }

    fn seek(&mut self, place: Mark) {
        self.0.seek(place);
    }

    fn begin_row(&mut self) -> Result<()> {
        if self.0.next_row()? { Ok(()) } else { Err(self.0.truncated("a row")) }
    }

    fn end_row(&mut self) -> Result<bool> {
        let more = self.0.word()?.is_some();
        if more {
            self.0.skip_row()?;
        }
        Ok(more)
    }

    fn number(&mut self, _: Scalar) -> Result<f64> {
        self.0.number()
    }

    fn integer(&mut self, _: Scalar) -> Result<i64> {
        self.0.integer()
    }

    fn skip(&mut self, _: Scalar, count: u64) -> Result<()> {
        for _ in 0..count {
            if self.0.word()?.is_none() {
                return Err(match self.0.input().left() {
                    0 => self.0.truncated("a value"),
                    _ => self.0.wrong("the line ends where a value belongs"),
                });
            }
        }
        Ok(())
    }

    fn skip_all(&mut self, element: &Element) -> Result<bool> {
        for _ in 0..element.count {
            self.begin_row()?;
            self.0.skip_row()?;
        }
        Ok(true)
    }

    fn triangles(&mut self, _: TriangleRows, _: u64, _: &mut TriangleRun) -> Result<()> {
        Ok(())
    }

    fn error(&self, code: Code, what: &str, numbers: String) -> Error {
        match code {
            Code::InputRange => self.0.out_of_range(what, numbers),
            _ => self.0.wrong(what).numbers(numbers),
        }
    }
}

/// A body of bytes.
pub(super) struct BinaryRows {
    /// The file.
    pub(super) input: Input,
    /// Order of the bytes of a value.
    pub(super) order: ByteOrder,
}

impl Rows for BinaryRows {
    type Place = u64;

    fn input(&self) -> &Input {
        &self.input
    }

    fn place(&self) -> u64 {
        self.input.offset()
    }

    fn seek(&mut self, place: u64) {
        self.input.seek(place);
    }

    fn begin_row(&mut self) -> Result<()> {
        Ok(())
    }

    fn end_row(&mut self) -> Result<bool> {
        Ok(false)
    }

    #[inline]
    fn number(&mut self, scalar: Scalar) -> Result<f64> {
        let order = self.order;
        Ok(scalar.number(self.input.take(scalar.size())?, order))
    }

    #[inline]
    fn integer(&mut self, scalar: Scalar) -> Result<i64> {
        let order = self.order;
        Ok(scalar.integer(self.input.take(scalar.size())?, order))
    }

    fn skip(&mut self, scalar: Scalar, count: u64) -> Result<()> {
        self.input.skip(count.saturating_mul(scalar.size() as u64))
    }

    fn skip_all(&mut self, element: &Element) -> Result<bool> {
        let Some(row_bytes) = element.row_bytes() else { return Ok(false) };
        self.input.skip(row_bytes.saturating_mul(element.count))?;
        Ok(true)
    }

    fn triangles(&mut self, rows: TriangleRows, most: u64, run: &mut TriangleRun) -> Result<()> {
        let row_bytes = rows.row_bytes();
        let most = most.min((WINDOW_BYTES / row_bytes).min(TriangleBatch::TARGET_TRIANGLES) as u64) as usize;
        self.input.fill(most * row_bytes)?;
        run.offset = self.input.offset();
        run.row_bytes = row_bytes as u64;
        let order = self.order;
        let plain = self.input.window().chunks_exact(row_bytes).take(most).map_while(|row| {
            let list = &row[rows.before..rows.before + TriangleRows::LIST_BYTES];
            let index = |at: usize| u32::from_order(head(&list[at..]), order);
            (list[0] == 3).then(|| [index(1), index(5), index(9)])
        });
        run.indices.clear();
        run.indices.extend(plain);
        self.input.consume(run.indices.len() * row_bytes);
        Ok(())
    }

    fn error(&self, code: Code, what: &str, numbers: String) -> Error {
        Error::new(code, what)
            .at_byte(self.input.path(), self.input.offset())
            .numbers(numbers)
            .next("export the mesh again")
    }
}
