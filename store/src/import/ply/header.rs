//! The header of a PLY file (G. Turk, "The PLY Polygon File Format", 1994), checked against the file's length.
//!
//! ```text
//! ply / format binary_little_endian 1.0 / comment ... / obj_info ...
//! element vertex 8 / property float x / ... / element face 6 / property list uchar int vertex_indices / end_header
//! ```
//!
//! Invariants: 1. after [`Header::parse`] all elements together need no more bytes than the file has; 2. list counts
//! are integers; 3. header and element sizes are bounded, whatever the file says.

use super::super::input::{Input, WINDOW_BYTES};
use super::super::scalar::{ByteOrder, Scalar};
use super::super::text::{parse_integer, printable};
use crate::error::{Code, Error, Result};
use crate::geom::Lattice;
use crate::stated_lattice;

/// Most elements, and most properties of one: real files have below ten, and some dozens.
const MAX_ELEMENTS: usize = 64;
const MAX_PROPERTIES: usize = 1024;

/// Columns of a colour, by channel.
const COLOUR_NAMES: [&[&str]; 3] =
    [&["red", "r", "diffuse_red"], &["green", "g", "diffuse_green"], &["blue", "b", "diffuse_blue"]];
/// Columns of a normal.
const NORMAL_NAMES: [&[&str]; 3] = [&["nx"], &["ny"], &["nz"]];

/// A header that has been checked.
#[derive(Debug)]
pub(super) struct Header {
    /// How values are written.
    pub(super) form: Form,
    /// In the order of the file.
    pub(super) elements: Vec<Element>,
    /// The lattice that a comment states.
    pub(super) lattice: Option<Lattice>,
    /// Line of the first byte after the header.
    pub(super) data_line: u64,
}

/// How values are written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Form {
    /// As words.
    Ascii,
    /// As bytes.
    Binary(ByteOrder),
}

/// A kind of rows: vertices, faces, anything.
#[derive(Clone, Debug)]
pub(super) struct Element {
    /// Its name.
    pub(super) name: String,
    /// Rows.
    pub(super) count: u64,
    /// Columns.
    pub(super) properties: Vec<Property>,
}

/// A column.
#[derive(Clone, Debug)]
pub(super) struct Property {
    /// Its name.
    pub(super) name: String,
    /// Type of the value, or of the items of the list.
    pub(super) scalar: Scalar,
    /// Type of a list's count; `None` when there is no list.
    pub(super) list_count: Option<Scalar>,
}

impl Header {
    /// Reads the header that `input` stands at the beginning of, and steps behind it.
    pub(super) fn parse(input: &mut Input) -> Result<Header> {
        input.fill(WINDOW_BYTES)?;
        let mut lines = Lines { rest: input.window(), taken: 0, line: 0, only_cr: true };
        let mut form = None;
        let mut elements = Vec::new();
        let mut lattice = None;
        loop {
            let Some(raw) = lines.next() else { return Err(no_end(input, lines.taken, lines.line)) };
            let text = String::from_utf8_lossy(raw);
            let words: Vec<&str> = text.split_whitespace().take(6).collect();
            let wrong = |what: &str| {
                Error::new(Code::InputFormat, format!("PLY header: {what}"))
                    .at_line(input.path(), lines.line)
                    .numbers(format!("the line is `{}`", printable(raw)))
                    .next("export the mesh again")
            };
            match words[..] {
                ["comment" | "obj_info", ..] | [] => {
                    let stated = text.trim_start().strip_prefix("comment").and_then(stated_lattice::parse);
                    lattice = lattice.or(stated);
                }
                ["ply"] if lines.line == 1 => {}
                ["format", name, _] => {
                    form = Some(Form::from_name(name).ok_or_else(|| wrong("unknown format"))?)
                }
                ["element", name, count] => {
                    let count = parse_integer(count.as_bytes()).and_then(|count| u64::try_from(count).ok());
                    let count = count.ok_or_else(|| wrong("the count of an element is not a number"))?;
                    if elements.len() == MAX_ELEMENTS {
                        return Err(wrong("too many elements"));
                    }
                    elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
                }
                ["property", ref column @ ..] => {
                    let element =
                        elements.last_mut().ok_or_else(|| wrong("a property before any element"))?;
                    if element.properties.len() == MAX_PROPERTIES {
                        return Err(wrong("too many properties"));
                    }
                    element
                        .properties
                        .push(Property::parse(column).ok_or_else(|| wrong("unknown property"))?);
                }
                ["end_header"] => break,
                _ => return Err(wrong("unknown keyword")),
            }
        }
        let (taken, line) = (lines.taken, lines.line);
        let form = form.ok_or_else(|| {
            Error::new(Code::InputFormat, "PLY header: there is no `format` line")
                .at_line(input.path(), line)
                .next("export the mesh again")
        })?;
        input.consume(taken);
        let header = Header { form, elements, lattice, data_line: line + 1 };
        header.check_length(input)?;
        Ok(header)
    }

    /// Counts that lie are met here, before anything is read or allocated by them.
    fn check_length(&self, input: &Input) -> Result<()> {
        // A last line needs no line end.
        let spare = u128::from(self.form == Form::Ascii);
        let needed: u128 = self.elements.iter().map(|element| element.least_bytes(self.form)).sum();
        if needed <= u128::from(input.left()) + spare {
            return Ok(());
        }
        let counts: Vec<_> =
            self.elements.iter().map(|element| format!("{} {}", element.count, element.name)).collect();
        Err(Error::new(Code::InputTruncated, "the file is shorter than its header says")
            .at_byte(input.path(), input.offset())
            .numbers(format!(
                "{} take at least {needed} bytes, {} follow the header",
                counts.join(", "),
                input.left()
            ))
            .next("copy or download the file again"))
    }
}

impl Form {
    fn from_name(name: &str) -> Option<Form> {
        match name {
            "ascii" => Some(Form::Ascii),
            "binary_little_endian" => Some(Form::Binary(ByteOrder::Little)),
            "binary_big_endian" => Some(Form::Binary(ByteOrder::Big)),
            _ => None,
        }
    }
}

impl Element {
    /// Bytes of each row, in a binary file, when no row differs.
    pub(super) fn row_bytes(&self) -> Option<u64> {
        self.properties.iter().map(|p| p.list_count.is_none().then(|| p.scalar.size() as u64)).sum()
    }

    /// The column called by one of `names`.
    pub(super) fn column(&self, names: &[&str]) -> Option<usize> {
        self.properties.iter().position(|property| names.contains(&property.name.as_str()))
    }

    /// Bytes that the rows take when all lists are empty.
    fn least_bytes(&self, form: Form) -> u128 {
        let row: usize = match form {
            // A character and a space, or the line end, for each value.
            Form::Ascii => 2 * self.properties.len(),
            Form::Binary(_) => self.properties.iter().map(|p| p.list_count.unwrap_or(p.scalar).size()).sum(),
        };
        row as u128 * u128::from(self.count)
    }
}

impl Property {
    fn parse(column: &[&str]) -> Option<Property> {
        match *column {
            ["list", count, item, name] => {
                let count = Scalar::from_ply_name(count).filter(|count| count.is_integer())?;
                let scalar = Scalar::from_ply_name(item)?;
                Some(Property { name: name.to_owned(), scalar, list_count: Some(count) })
            }
            [scalar, name] => Some(Property {
                name: name.to_owned(),
                scalar: Scalar::from_ply_name(scalar)?,
                list_count: None,
            }),
            _ => None,
        }
    }
}

/// The columns of a colour, where all three are there.
pub(super) fn colour_columns(properties: &[Property]) -> Option<[usize; 3]> {
    columns(properties, &COLOUR_NAMES)
}

/// The columns of a normal, where all three are there.
pub(super) fn normal_columns(properties: &[Property]) -> Option<[usize; 3]> {
    columns(properties, &NORMAL_NAMES)
}

fn columns(properties: &[Property], names: &[&[&str]; 3]) -> Option<[usize; 3]> {
    let column = |names: &&[&str]| {
        properties.iter().position(|p| names.contains(&p.name.as_str()) && p.list_count.is_none())
    };
    let [a, b, c] = [0, 1, 2].map(|channel| column(&names[channel]));
    Some([a?, b?, c?])
}

/// Lines of a header; the line end may be LF, CR LF or CR, and the last one's matters: data follow it.
struct Lines<'a> {
    rest: &'a [u8],
    taken: usize,
    line: u64,
    /// All lines so far ended in a lone CR.
    only_cr: bool,
}

impl<'a> Iterator for Lines<'a> {
    type Item = &'a [u8];

    fn next(&mut self) -> Option<&'a [u8]> {
        let length = memchr::memchr2(b'\n', b'\r', self.rest)?;
        let crlf = self.rest[length..].starts_with(b"\r\n");
        // Where lines end in CR alone, a LF after the last of them is the first byte of the data.
        let both = crlf && !(self.only_cr && self.line > 0);
        self.only_cr &= self.rest[length] == b'\r' && !both;
        let line = &self.rest[..length];
        let step = length + 1 + usize::from(both);
        self.rest = &self.rest[step..];
        self.taken += step;
        self.line += 1;
        Some(line)
    }
}

fn no_end(input: &Input, taken: usize, line: u64) -> Error {
    let rest = &input.window()[taken..];
    let whole = input.window().len() as u64 == input.left();
    let error = if rest.iter().any(|&byte| byte.is_ascii_control() && byte != b'\t') {
        Error::new(Code::InputFormat, "the PLY header holds bytes that are no text")
    } else if whole {
        Error::new(Code::InputTruncated, "the file ends before `end_header` of the PLY header")
    } else {
        Error::new(Code::InputFormat, "the PLY header has no `end_header`")
    };
    error
        .at_line(input.path(), line + 1)
        .numbers(format!("{} bytes looked at, the line begins `{}`", input.window().len(), printable(rest)))
        .next("copy or export the file again")
}
