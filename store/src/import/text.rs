//! `Text`: words and numbers of a text file, row by row, in bounded memory.
//!
//! A row is a line, and the line after it when it ends in a backslash (OBJ). Lines end in LF, CR LF or CR.
//!
//! Invariants: 1. rows have no longest length, words have: [`MAX_WORD_BYTES`]; 2. `word` never leaves its row;
//! 3. `line` counts from 1 and is the line of the next byte.

use super::input::{Input, WINDOW_BYTES};
use crate::error::{Code, Error, Result};

/// Most bytes of a word. Numbers take 25 and index triples 62; what is longer is no mesh.
pub(super) const MAX_WORD_BYTES: usize = 1024;

/// Most bytes of a name that fills the rest of a row (a material, a file).
pub(super) const MAX_REST_BYTES: usize = 4096;

const _: () = assert!(MAX_REST_BYTES + 2 < WINDOW_BYTES);

/// Words of a text file.
pub(super) struct Text {
    input: Input,
    line: u64,
}

/// A place to come back to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Mark {
    offset: u64,
    line: u64,
}

impl Text {
    /// Reads from where `input` stands, which is in line `line`.
    pub(super) fn new(input: Input, line: u64) -> Text {
        Text { input, line }
    }

    /// The file below.
    pub(super) fn input(&self) -> &Input {
        &self.input
    }

    /// This place.
    pub(super) fn mark(&self) -> Mark {
        Mark { offset: self.input.offset(), line: self.line }
    }

    /// Goes back (or on) to a place.
    pub(super) fn seek(&mut self, mark: Mark) {
        self.input.seek(mark.offset);
        self.line = mark.line;
    }

    /// Steps over white space and line ends to the next word of any row; `false` at the end of the file.
    pub(super) fn next_row(&mut self) -> Result<bool> {
        loop {
            self.input.fill(2)?;
            match *self.input.window() {
                [] => return Ok(false),
                [b'\r', b'\n', ..] => self.end_line(2),
                [b'\r' | b'\n', ..] => self.end_line(1),
                [byte, ..] if is_blank(byte) => self.input.consume(1),
                _ => return Ok(true),
            }
        }
    }

    /// The next word of this row, or `None` at its end.
    #[inline]
    pub(super) fn word(&mut self) -> Result<Option<&[u8]>> {
        let (from, to) = loop {
            self.input.fill(MAX_WORD_BYTES + 3)?;
            let window = self.input.window();
            let Some(from) = window.iter().position(|&byte| !is_blank(byte)) else {
                let blanks = window.len();
                if blanks == 0 {
                    return Ok(None);
                }
                self.input.consume(blanks);
                continue;
            };
            let rest = &window[from..];
            if rest.len() <= MAX_WORD_BYTES + 2 && from > 0 {
                // The word may be cut by the window's end: bring it to the front first.
                self.input.consume(from);
                continue;
            }
            if let Some(length) = continuation(rest) {
                self.end_line(from + length);
                continue;
            }
            let length = rest.iter().position(|&byte| ends_word(byte)).unwrap_or(rest.len());
            if length == 0 {
                return Ok(None);
            }
            if length > MAX_WORD_BYTES {
                return Err(self.wrong("a word is too long for a mesh file").numbers(format!(
                    "more than {MAX_WORD_BYTES} bytes without a space; it begins `{}`",
                    printable(&rest[..16])
                )));
            }
            let glued = rest[length - 1] == b'\\' && continuation(&rest[length - 1..]).is_some();
            break (from, from + length - usize::from(glued));
        };
        Ok(Some(self.input.split(from, to)))
    }

    /// The next number of this row.
    #[inline]
    pub(super) fn number(&mut self) -> Result<f64> {
        let wrong = match self.word()? {
            None => None,
            Some(word) => match parse_number(word) {
                Some(value) => return Ok(value),
                None => Some(printable(word)),
            },
        };
        Err(self.not_what_belongs_here("a number", wrong))
    }

    /// The next integer of this row.
    #[inline]
    pub(super) fn integer(&mut self) -> Result<i64> {
        let wrong = match self.word()? {
            None => None,
            Some(word) => match parse_integer(word) {
                Some(value) => return Ok(value),
                None => Some(printable(word)),
            },
        };
        Err(self.not_what_belongs_here("an integer", wrong))
    }

    /// Whether these words come next, behind one blank at most.
    pub(super) fn starts_with(&mut self, words: &str) -> Result<bool> {
        self.input.fill(words.len() + 1)?;
        let window = self.input.window();
        Ok(window.strip_prefix(b" ").unwrap_or(window).starts_with(words.as_bytes()))
    }

    /// The rest of this row, trimmed, as text; the row is left.
    pub(super) fn rest(&mut self) -> Result<String> {
        self.input.fill(MAX_REST_BYTES + 2)?;
        let window = self.input.window();
        let length = memchr::memchr2(b'\n', b'\r', window).unwrap_or(window.len());
        if length > MAX_REST_BYTES {
            return Err(self
                .wrong("a name is too long")
                .numbers(format!("more than {MAX_REST_BYTES} bytes")));
        }
        let rest = String::from_utf8_lossy(&window[..length]).trim().to_owned();
        self.input.consume(length);
        Ok(rest)
    }

    /// Leaves this row, with the lines that continue it.
    pub(super) fn skip_row(&mut self) -> Result<()> {
        while self.skip_line()? {}
        Ok(())
    }

    /// Leaves this line, and tells whether it ended in a backslash.
    pub(super) fn skip_line(&mut self) -> Result<bool> {
        let mut last = 0;
        loop {
            self.input.fill(2)?;
            let window = self.input.window();
            if window.is_empty() {
                return Ok(false);
            }
            match memchr::memchr2(b'\n', b'\r', window) {
                None => {
                    last = window[window.len() - 1];
                    self.input.consume(window.len());
                }
                Some(length) => {
                    last = if length > 0 { window[length - 1] } else { last };
                    self.input.consume(length);
                    self.input.fill(2)?;
                    let both = self.input.window().starts_with(b"\r\n");
                    self.end_line(1 + usize::from(both));
                    return Ok(last == b'\\');
                }
            }
        }
    }

    /// A format error at this line.
    pub(super) fn wrong(&self, what: impl Into<String>) -> Error {
        Error::new(Code::InputFormat, what)
            .at_line(self.input.path(), self.line)
            .next("correct this line, or export the mesh again")
    }

    /// An error about an index or a count at this line.
    pub(super) fn out_of_range(&self, what: impl Into<String>, numbers: impl Into<String>) -> Error {
        Error::new(Code::InputRange, what)
            .at_line(self.input.path(), self.line)
            .numbers(numbers)
            .next("correct this line, or export the mesh again")
    }

    /// The file ends at this line though `missing` should come.
    pub(super) fn truncated(&self, missing: &str) -> Error {
        Error::new(Code::InputTruncated, "the file ends early")
            .at_line(self.input.path(), self.line)
            .numbers(format!("{missing} is missing after {} bytes", self.input.length()))
            .next("copy or download the file again")
    }

    #[cold]
    fn not_what_belongs_here(&self, belongs: &str, found: Option<String>) -> Error {
        match found {
            Some(word) => {
                self.wrong(format!("text where {belongs} belongs")).numbers(format!("found `{word}`"))
            }
            None if self.input.left() == 0 => self.truncated(belongs),
            None => self
                .wrong(format!("the line ends where {belongs} belongs"))
                .numbers(format!("byte {} of the file", self.input.offset())),
        }
    }

    fn end_line(&mut self, bytes: usize) {
        self.input.consume(bytes);
        self.line += 1;
    }
}

/// A number as programs print it: decimal, with exponent, `nan`, `inf`, and the forms of old MSVC libraries.
pub(super) fn parse_number(word: &[u8]) -> Option<f64> {
    match fast_float2::parse::<f64, _>(word) {
        Ok(value) => Some(value),
        Err(_) => {
            let unsigned =
                word.strip_prefix(b"-").or(word.strip_prefix(b"+")).unwrap_or(word).to_ascii_lowercase();
            let msvc = [&b"nan("[..], b"1.#ind", b"1.#qnan", b"1.#snan", b"1.#inf"];
            msvc.iter().any(|form| unsigned.starts_with(form)).then_some(f64::NAN)
        }
    }
}

/// A decimal integer with an optional sign, within i64.
#[inline]
pub(super) fn parse_integer(word: &[u8]) -> Option<i64> {
    let (negative, digits) = match word {
        [b'-', digits @ ..] => (true, digits),
        [b'+', digits @ ..] => (false, digits),
        digits => (false, digits),
    };
    // 18 digits always fit an i64, and no mesh has 10^18 of anything.
    if digits.is_empty() || digits.len() > 18 || !digits.iter().all(u8::is_ascii_digit) {
        return None;
    }
    let value = digits.iter().fold(0, |value, digit| value * 10 + i64::from(digit - b'0'));
    Some(if negative { -value } else { value })
}

/// At most 40 bytes of `word`, fit for a message.
pub(super) fn printable(word: &[u8]) -> String {
    word.iter().take(40).flat_map(|&byte| std::ascii::escape_default(byte)).map(char::from).collect()
}

fn is_blank(byte: u8) -> bool {
    matches!(byte, b' ' | b'\t' | 0x0b | 0x0c)
}

fn ends_word(byte: u8) -> bool {
    is_blank(byte) || matches!(byte, b'\n' | b'\r')
}

/// Length of a backslash with the line end after it, if `bytes` begins so.
fn continuation(bytes: &[u8]) -> Option<usize> {
    match bytes {
        [b'\\', b'\r', b'\n', ..] => Some(3),
        [b'\\', b'\r' | b'\n', ..] => Some(2),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::ImportOptions;

    /// Rows of words as `a b|c`, with the line on which each row begins.
    fn check(content: &str, expected: &str) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("text");
        std::fs::write(&path, content).unwrap();
        let mut text = Text::new(Input::open(&path, &ImportOptions::unlimited(folder.path())).unwrap(), 1);
        let mut rows = Vec::new();
        while text.next_row().unwrap() {
            let mut row = format!("{}:", text.line);
            while let Some(word) = text.word().unwrap() {
                row += &format!(" {}", printable(word));
            }
            rows.push(row);
        }
        assert_eq!(rows.join("|"), expected, "{content:?}");
    }

    #[test]
    fn rows_and_words() {
        check("a b\nc", "1: a b|2: c");
        check("  a\tb  \r\n\r\n c\r\n", "1: a b|3: c");
        check("a\rb\r\rc", "1: a|2: b|4: c");
        check("a \\\n b\nc", "1: a b|3: c");
        check("a\\\r\nb c\\\n\nd", "1: a b c|4: d");
        check("C:\\x y", "1: C:\\\\x y");
    }

    #[test]
    fn words_across_the_window() {
        let long = " ".repeat(WINDOW_BYTES - 3) + "abcdefgh" + &" ".repeat(WINDOW_BYTES) + "x\ny";
        check(&long, "1: abcdefgh x|2: y");
    }

    #[test]
    fn numbers() {
        for (word, value) in [
            ("1", 1.0),
            ("+2.", 2.0),
            ("-3.5e-2", -0.035),
            ("2.e01", 20.0),
            (".5", 0.5),
            ("-Inf", f64::NEG_INFINITY),
        ] {
            assert_eq!(parse_number(word.as_bytes()), Some(value), "{word}");
        }
        for word in ["nan", "-NaN", "-nan(ind)", "1.#QNAN", "-1.#IND00"] {
            assert!(parse_number(word.as_bytes()).is_some_and(f64::is_nan), "{word}");
        }
        for word in ["", "x", "1,5", "3.1+e2", "0x10", "1.0f", "--1", "1_0"] {
            assert_eq!(parse_number(word.as_bytes()), None, "{word}");
        }
        assert_eq!(parse_integer(b"-12"), Some(-12));
        for word in ["", "-", "1.0", "1e3", "9999999999999999999"] {
            assert_eq!(parse_integer(word.as_bytes()), None, "{word}");
        }
    }
}
