//! The section of materials: a JSON array, written and read one material at a time.
//!
//! Neither way holds the text: a file's section may be a hundred megabytes long, of names that JSON writes with
//! escapes.
//!
//! Invariants: 1. what is read stops at the count that was asked for, at a name that is too long, and at a string that
//! no name could need, before memory is taken for it; 2. what is written is read back.

use crate::cluster::{Colour, WHITE};
use crate::error::Result;
use crate::layout::{MATERIAL_JSON_BYTES, MATERIAL_NAME_BYTES};
use crate::material::Material;
use crate::material_list::MaterialList;
use serde::de::{Deserializer as _, Error as _, SeqAccess, Visitor};
use serde::{Deserialize, Serialize};
use std::borrow::Cow;
use std::io::{self, Read};
use std::ops::RangeInclusive;

/// Bytes of a piece that is written: one write to the disk.
const PIECE_BYTES: usize = 64 << 10;
/// Most bytes that JSON writes for a byte of a name: `\u0001`.
const ESCAPE_BYTES: usize = 6;
/// Most bytes between the quotes of a string.
const STRING_BYTES: usize = ESCAPE_BYTES * MATERIAL_NAME_BYTES;
/// Most bytes of a material beside its name: keys, eleven numbers of up to 16 characters and three of
/// up to 3, commas and brackets.
const NUMBERS_BYTES: usize = 84 + 11 * 17 + 3 * 4;

const _: () = assert!(STRING_BYTES + NUMBERS_BYTES <= MATERIAL_JSON_BYTES);

/// A material as the section has it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct StoredMaterial<'a> {
    name: Cow<'a, str>,
    kd: [f32; 3],
    ks: [f32; 3],
    ns: f32,
    ke: [f32; 3],
    d: f32,
    mirror: bool,
    /// Mean of the mesh's colours on it.
    #[serde(default = "white", skip_serializing_if = "is_white")]
    colour: Colour,
}

fn white() -> Colour {
    WHITE
}

fn is_white(colour: &Colour) -> bool {
    *colour == WHITE
}

impl<'a> StoredMaterial<'a> {
    fn new((name, material): (&'a str, &Material)) -> StoredMaterial<'a> {
        let Material { kd, ks, ns, ke, d, mirror, mean_colour: colour } = *material;
        StoredMaterial { name: Cow::Borrowed(name), kd, ks, ns, ke, d, mirror, colour }
    }

    fn material(&self) -> Material {
        let StoredMaterial { kd, ks, ns, ke, d, mirror, colour: mean_colour, .. } = *self;
        Material { kd, ks, ns, ke, d, mirror, mean_colour }
    }
}

/// Hands the section of `materials` to `put`, in pieces.
pub(crate) fn write(materials: &MaterialList, mut put: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
    let mut piece = Vec::with_capacity(PIECE_BYTES + MATERIAL_JSON_BYTES);
    piece.push(b'[');
    for (index, named) in materials.named().enumerate() {
        if index > 0 {
            piece.push(b',');
        }
        serde_json::to_writer(&mut piece, &StoredMaterial::new(named)).expect("materials are plain data");
        if piece.len() >= PIECE_BYTES {
            put(&piece)?;
            piece.clear();
        }
    }
    piece.push(b']');
    put(&piece)
}

/// Reads a section whose count of materials is in this range, and whose names have at most `text_bytes` together;
/// `None` for anything else.
pub(crate) fn read(
    section: impl Read,
    counts: RangeInclusive<usize>,
    text_bytes: usize,
) -> Option<MaterialList> {
    let most = *counts.end();
    let list = MaterialList::with_capacity(most, text_bytes);
    let mut text = serde_json::Deserializer::from_reader(ShortStrings::new(section));
    let mut list = text.deserialize_seq(Entries { most, text_bytes, list }).ok()?;
    text.end().ok()?;
    list.shrink();
    counts.contains(&list.len()).then_some(list)
}

/// Takes the entries of the array into a list that does not outgrow its room.
struct Entries {
    most: usize,
    text_bytes: usize,
    list: MaterialList,
}

impl<'de> Visitor<'de> for Entries {
    type Value = MaterialList;

    fn expecting(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "at most {} materials", self.most)
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut entries: A) -> std::result::Result<MaterialList, A::Error> {
        let Entries { most, text_bytes, mut list } = self;
        while let Some(entry) = entries.next_element::<StoredMaterial<'_>>()? {
            let has_room = list.len() < most
                && entry.name.len() <= MATERIAL_NAME_BYTES
                && list.names().text_bytes() + entry.name.len() <= text_bytes;
            if !has_room {
                return Err(A::Error::custom("more than the section can hold"));
            }
            list.push(&entry.name, entry.material());
        }
        Ok(list)
    }
}

/// Bytes of JSON, until a string is longer than any that belongs there: the parser would collect all of it.
struct ShortStrings<R> {
    section: io::BufReader<R>,
    /// Bytes of the string so far; `None` between strings.
    inside: Option<usize>,
    is_escaped: bool,
}

impl<R: Read> ShortStrings<R> {
    fn new(section: R) -> ShortStrings<R> {
        let section = io::BufReader::with_capacity(PIECE_BYTES, section);
        ShortStrings { section, inside: None, is_escaped: false }
    }

    fn step(&mut self, byte: u8) -> io::Result<()> {
        self.inside = match (self.inside, byte) {
            (None, b'"') => Some(0),
            (None, _) => None,
            (Some(_), b'"') if !self.is_escaped => None,
            (Some(length), _) if length < STRING_BYTES => Some(length + 1),
            (Some(_), _) => return Err(io::Error::other("a string that is too long")),
        };
        self.is_escaped = self.inside.is_some() && byte == b'\\' && !self.is_escaped;
        Ok(())
    }
}

impl<R: Read> Read for ShortStrings<R> {
    fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
        let length = self.section.read(out)?;
        out[..length].iter().try_for_each(|&byte| self.step(byte))?;
        Ok(length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn written(list: &MaterialList) -> Vec<u8> {
        let mut bytes = Vec::new();
        write(list, |piece| {
            assert!(piece.len() <= PIECE_BYTES + MATERIAL_JSON_BYTES);
            bytes.extend_from_slice(piece);
            Ok(())
        })
        .unwrap();
        bytes
    }

    proptest! {
        /// Against `serde_json` on values, which shares no code with the section's own types.
        #[test]
        fn sections_are_json_and_come_back(
            names in proptest::collection::vec("(.|[\\x01-\\x1f\"\\\\]){0,300}", 1..9),
            numbers: [f32; 11],
            mirror: bool,
            mean_colour: [u8; 3],
        ) {
            let [a, b, c, d, e, f, g, h, i, ns, alpha] = numbers;
            let (kd, ks, ke) = ([a, b, c], [d, e, f], [g, h, i]);
            let material = Material { kd, ks, ke, ns, d: alpha, mirror, mean_colour };
            let list: MaterialList = names.iter().map(|name| (name, material)).collect();
            let bytes = written(&list);
            prop_assert!(bytes.len() <= 2 + names.len() * MATERIAL_JSON_BYTES);
            let value: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
            for (entry, (name, material)) in value.as_array().unwrap().iter().zip(list.named()) {
                prop_assert_eq!(entry["name"].as_str().unwrap(), name);
                prop_assert_eq!(entry["ks"][1].as_f64().unwrap() as f32, material.ks[1]);
                prop_assert_eq!(entry["d"].as_f64().unwrap() as f32, material.d);
                prop_assert_eq!(entry["mirror"].as_bool().unwrap(), material.mirror);
                let green = entry["colour"][1].as_u64();
                prop_assert_eq!(green, (mean_colour != WHITE).then_some(u64::from(mean_colour[1])));
            }
            let text_bytes = list.names().text_bytes();
            let read_back = read(bytes.as_slice(), 1..=9, text_bytes).unwrap();
            prop_assert_eq!(read_back.names(), list.names());
            prop_assert!(read_back.iter().all(|read| read.mean_colour == mean_colour));
            // Names that have less room, or another count of entries.
            prop_assert!(text_bytes == 0 || read(bytes.as_slice(), 1..=9, text_bytes - 1).is_none());
            prop_assert!(read(bytes.as_slice(), names.len() + 1..=9, text_bytes).is_none());
            prop_assert!(read(bytes.as_slice(), 0..=names.len() - 1, text_bytes).is_none());
            for end in 0..bytes.len() {
                prop_assert!(read(&bytes[..end], 0..=9, text_bytes).is_none());
            }
        }
    }

    /// A reader that counts what is taken of it: entries without end, and a string without end.
    struct Endless<'a>(&'a [u8], usize);

    impl Read for Endless<'_> {
        fn read(&mut self, out: &mut [u8]) -> io::Result<usize> {
            let from = self.1;
            out.iter_mut().zip(from..).for_each(|(byte, at)| *byte = self.0[at % self.0.len()]);
            self.1 += out.len();
            assert!(self.1 < 1 << 20, "it is read on and on");
            Ok(out.len())
        }
    }

    /// A section of 162 MB was parsed to its end before its 4 million entries were found to be too many.
    #[test]
    fn reading_stops_at_the_count_and_at_a_long_string() {
        let list: MaterialList = [("", Material::default()); 2].into_iter().collect();
        let entry = &written(&list)[..];
        let one = &entry[1..entry.len() / 2];
        for (start, repeated) in [
            ("[".to_owned(), [one, b","].concat()),
            ("[{\"name\":\"".to_owned(), b"n".to_vec()),
            ("[{\"name\":\"".to_owned(), b"\\u0001".to_vec()),
            ("[{\"".to_owned(), b"k".to_vec()),
            ("[{\"name\":".to_owned(), b"[".to_vec()),
            ("[{\"other\":".to_owned(), b"[".to_vec()),
            ("[".to_owned(), b"[".to_vec()),
        ] {
            let mut endless = Endless(&repeated, 0);
            assert!(read(start.as_bytes().chain(&mut endless), 28..=28, 28 * 255).is_none(), "{start}");
        }
    }

    #[test]
    fn names_beyond_the_format_are_refused() {
        for (length, is_sound) in [(255, true), (256, false), (1000, false)] {
            let numbers = r#""kd":[0,0,0],"ks":[0,0,0],"ns":0,"ke":[0,0,0],"d":1,"mirror":false"#;
            let text = format!("[{{\"name\":\"{}\",{numbers}}}]  \n", "n".repeat(length));
            assert_eq!(read(text.as_bytes(), 1..=1, 1 << 20).is_some(), is_sound, "{length}");
        }
    }
}
