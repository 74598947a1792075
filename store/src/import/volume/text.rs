//! The text of a header: its lines, and the lists of numbers in them.
//!
//! Invariants: 1. a header ends within the window of its file; 2. what is shown of it in a message is short.

use crate::error::{Code, Error, Result};
use crate::import::input::{Input, WINDOW_BYTES};
use crate::import::text::printable;
use std::ffi::OsStr;
use std::os::unix::ffi::OsStrExt;
use std::path::{Path, PathBuf};

/// Most bytes of a path, as of all calls of the system.
const PATH_BYTES_MAX: usize = 4096;

/// Lines of a header, from the beginning of its file.
pub(super) struct HeaderLines<'a> {
    path: &'a Path,
    text: &'a [u8],
    /// Of the text, in its file.
    first: u64,
    /// Whether the window holds the whole file.
    is_whole: bool,
    /// The next line.
    at: usize,
    /// Of the line before it, from 1.
    number: u64,
}

impl<'a> HeaderLines<'a> {
    /// Stands before the first line.
    pub(super) fn new(input: &'a mut Input) -> Result<HeaderLines<'a>> {
        input.fill(WINDOW_BYTES)?;
        let input: &'a Input = input;
        let (text, first) = (input.window(), input.offset());
        let is_whole = input.left() <= text.len() as u64;
        Ok(HeaderLines { path: input.path(), text, first, is_whole, at: 0, number: 0 })
    }

    /// The next line, without its end; `None` at the end of the file.
    pub(super) fn next_line(&mut self) -> Result<Option<&'a [u8]>> {
        let left = &self.text[self.at..];
        let (line, used) = match memchr::memchr(b'\n', left) {
            Some(end) => (&left[..end], end + 1),
            None if left.is_empty() && self.is_whole => return Ok(None),
            None if self.is_whole => (left, left.len()),
            None => {
                return Err(Error::new(Code::InputFormat, "the header of the volume does not end")
                    .at_byte(self.path, self.offset())
                    .numbers(format!("{WINDOW_BYTES} bytes are looked at"))
                    .next("check the file's name and content"));
            }
        };
        self.at += used;
        self.number += 1;
        Ok(Some(line.strip_suffix(b"\r").unwrap_or(line)))
    }

    /// The byte behind the last line.
    pub(super) fn offset(&self) -> u64 {
        self.first + self.at as u64
    }

    /// The header's file.
    pub(super) fn path(&self) -> &'a Path {
        self.path
    }

    /// The error of the last line: what is wrong, and its value.
    pub(super) fn wrong(&self, what: impl Into<String>, value: &[u8]) -> Error {
        Error::new(Code::InputFormat, what)
            .at_line(self.path, self.number)
            .numbers(format!("it says `{}`", printable(value)))
            .next("correct the header, or write the volume again")
    }

    /// The error of a header without a field that it must have.
    pub(super) fn missing(&self, field: &str) -> Error {
        Error::new(Code::InputFormat, format!("the header of the volume does not say its `{field}`"))
            .at(self.path)
            .numbers(format!("{} lines were read", self.number))
            .next("correct the header, or write the volume again")
    }

    /// Three numbers of the last line.
    pub(super) fn three<T: std::str::FromStr>(&self, field: &str, value: &[u8]) -> Result<[T; 3]> {
        self.numbers(value)
            .and_then(|list| list.try_into().ok())
            .ok_or_else(|| self.wrong(format!("`{field}` has three numbers"), value))
    }

    /// One number of the last line.
    pub(super) fn one<T: std::str::FromStr>(&self, field: &str, value: &[u8]) -> Result<T> {
        let number = self.numbers(value).and_then(|list| <[T; 1]>::try_from(list).ok());
        number.map(|[number]| number).ok_or_else(|| self.wrong(format!("`{field}` is a number"), value))
    }

    /// All numbers of a list, which blanks part; `None` where something else is in it.
    pub(super) fn numbers<T: std::str::FromStr>(&self, value: &[u8]) -> Option<Vec<T>> {
        // No list of a volume is longer than a matrix; what is, is none.
        let words = std::str::from_utf8(value).ok()?.split_whitespace().take(64);
        words.map(|word| word.parse().ok()).collect()
    }

    /// The path of a file that the last line names, from the header's folder on.
    pub(super) fn file(&self, name: &[u8]) -> Result<PathBuf> {
        if name.is_empty() || name.len() > PATH_BYTES_MAX || name.contains(&0) {
            return Err(self.wrong("the header does not name a file", name));
        }
        Ok(self.path.parent().unwrap_or(Path::new("")).join(OsStr::from_bytes(name)))
    }
}

/// A line in two at the first `mark`, both without blanks around them.
pub(super) fn split<'a>(line: &'a [u8], mark: &[u8]) -> Option<(String, &'a [u8])> {
    let at = memchr::memmem::find(line, mark)?;
    let key = String::from_utf8_lossy(line[..at].trim_ascii()).into_owned();
    Some((key, line[at + mark.len()..].trim_ascii()))
}
