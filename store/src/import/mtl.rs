//! MTL text, one line at a time: the materials in it.
//!
//! ```text
//! newmtl NAME    -> the material before is whole
//! Kd, Ks, ...    -> the last row of each key counts
//! map_Kd         -> the picture of its colour, and where in it coordinates lie
//! ```
//!
//! `tobj` makes a material of its rows. It is given one material at a time, and only rows that are well formed: it
//! panics on colours of fewer than three numbers and refuses a whole file for one empty texture name.
//!
//! Invariants: 1. memory is a line and a row of each key, whatever the file holds; 2. names come as files hold them.

use crate::material::Material;
use crate::material_names::stored_name;
use std::fmt::Write;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};

/// Most bytes of a line; of longer ones only so many are looked at. No `usemtl` has a name as long.
const LINE_BYTES: usize = 16 << 10;
/// Bytes of memory while a file is read: its buffer, a line, and rows as text and as `tobj` keeps them.
pub(super) const READING_BYTES: u64 = 512 << 10;
/// Keys that make a material, and the count of numbers that each is given to `tobj` with.
const KEYS: [(&str, usize); 7] =
    [("Kd", 3), ("Ks", 3), ("Ke", 3), ("Ns", 1), ("d", 1), ("Tr", 1), ("illum", 1)];

const _: () = assert!((3 * KEYS.len() + 8) * LINE_BYTES <= READING_BYTES as usize);

/// Hands the materials in the first `bytes` of `file` to `define`, with their names, until it says no; gives the count
/// of lines that are not used.
///
/// # Errors
/// Those of the file.
pub(super) fn read(
    file: File,
    bytes: u64,
    define: &mut dyn FnMut(&str, Material, Option<PictureRow>) -> bool,
) -> io::Result<u64> {
    let mut text = BufReader::new(file.take(bytes));
    let (mut line, mut dropped) = (Vec::new(), 0);
    let mut open: Option<OpenMaterial> = None;
    while read_line(&mut text, &mut line)? {
        let line = String::from_utf8_lossy(&line);
        let line = line.trim_start_matches('\u{feff}').trim();
        let mut words = line.split_whitespace();
        let key = words.next().unwrap_or_default();
        if key == "newmtl" {
            let name = line[key.len()..].trim();
            dropped += u64::from(name.is_empty());
            // Without a name, lines that follow must not change the material before.
            let next = OpenMaterial::new(if name.is_empty() { "(no name)" } else { name });
            if !open.replace(next).is_none_or(|whole| whole.define(define)) {
                return Ok(dropped);
            }
        } else if key == "map_Kd" {
            let row = PictureRow::parse(&line[key.len()..]);
            dropped += u64::from(row.is_none());
            if let (Some(row), Some(open)) = (row, &mut open) {
                open.picture = Some(row);
            }
        } else if let Some(place) = KEYS.iter().position(|(known, _)| *known == key) {
            match (numbers(words, KEYS[place].1, key), &mut open) {
                (None, _) => dropped += 1,
                (row, Some(open)) => open.rows[place] = row,
                (Some(_), None) => {}
            }
        }
    }
    if let Some(last) = open {
        last.define(define);
    }
    Ok(dropped)
}

/// Reads the next line, without what is behind its first [`LINE_BYTES`]; false at the end.
fn read_line(text: &mut impl BufRead, line: &mut Vec<u8>) -> io::Result<bool> {
    line.clear();
    (&mut *text).take(LINE_BYTES as u64).read_until(b'\n', line)?;
    if line.len() == LINE_BYTES && !line.ends_with(b"\n") {
        text.skip_until(b'\n')?;
    }
    Ok(!line.is_empty())
}

/// A material whose rows are being read.
struct OpenMaterial {
    name: String,
    /// The last row of each of [`KEYS`], as numbers.
    rows: [Option<String>; KEYS.len()],
    picture: Option<PictureRow>,
}

/// What a `map_Kd` row says: a file, and where in its picture the coordinates of a vertex lie.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PictureRow {
    /// As it is written.
    pub(super) file: String,
    /// `-s`: what coordinates are times.
    pub(super) scale: [f64; 2],
    /// `-o`: what is added to these.
    pub(super) offset: [f64; 2],
    /// `-clamp on`: beside the picture is its edge, else the picture again.
    pub(super) clamps: bool,
}

impl PictureRow {
    /// What is behind the key: options, and the name of a file, which may have spaces. `None` without a name.
    fn parse(row: &str) -> Option<PictureRow> {
        let mut found = PictureRow { file: String::new(), scale: [1.0; 2], offset: [0.0; 2], clamps: false };
        let mut rest = row.trim();
        loop {
            let (word, behind) = split_word(rest);
            let Some(option) = word.strip_prefix('-') else { break };
            let most = match option {
                "blendu" | "blendv" | "cc" | "clamp" | "bm" | "boost" | "texres" | "imfchan" => 1,
                "mm" => 2,
                "o" | "s" | "t" => 3,
                _ => break,
            };
            rest = behind;
            let mut numbers = Vec::new();
            for _ in 0..most {
                let (value, behind) = split_word(rest);
                match value.parse::<f64>() {
                    Ok(number) if number.is_finite() => numbers.push(number),
                    _ if most == 1 => found.clamps |= option == "clamp" && value == "on",
                    // A number that is left out; what comes is another option, or the file.
                    _ => break,
                }
                rest = behind;
            }
            let pair = match option {
                "o" => &mut found.offset,
                "s" => &mut found.scale,
                _ => continue,
            };
            pair.iter_mut().zip(numbers).for_each(|(part, number)| *part = number);
        }
        found.file = rest.trim_matches('"').to_owned();
        (!found.file.is_empty()).then_some(found)
    }
}

/// The first word, and what is behind it.
fn split_word(text: &str) -> (&str, &str) {
    let (word, behind) = text.split_once(char::is_whitespace).unwrap_or((text, ""));
    (word, behind.trim_start())
}

impl OpenMaterial {
    fn new(name: &str) -> OpenMaterial {
        OpenMaterial {
            name: stored_name(name).into_owned(),
            rows: [const { None }; KEYS.len()],
            picture: None,
        }
    }

    /// Makes the material, and hands it on; false where that says no.
    fn define(self, define: &mut dyn FnMut(&str, Material, Option<PictureRow>) -> bool) -> bool {
        // The name stays here: `tobj` has rules of its own for names.
        let mut text = String::from("newmtl m\n");
        for ((key, _), row) in KEYS.iter().zip(&self.rows) {
            if let Some(row) = row {
                let _ = writeln!(text, "{key} {row}");
            }
        }
        let made = tobj::load_mtl_buf(&mut text.as_bytes()).ok().and_then(|(mut made, _)| made.pop());
        made.is_none_or(|made| define(&self.name, from_tobj(&made), self.picture))
    }
}

/// `count` numbers; green and blue that are left out equal red, as the MTL specification says.
fn numbers<'a>(words: impl Iterator<Item = &'a str>, count: usize, key: &str) -> Option<String> {
    let mut numbers: Vec<&str> = words.filter(|&word| word != "-halo").take(count).collect();
    let well_formed =
        |word: &&str| if key == "illum" { word.parse::<u8>().is_ok() } else { word.parse::<f32>().is_ok() };
    if numbers.is_empty() || !numbers.iter().all(well_formed) {
        return None;
    }
    numbers.resize(count, numbers[0]);
    Some(numbers.join(" "))
}

fn from_tobj(material: &tobj::Material) -> Material {
    let default = Material::default();
    let transparency = || material.unknown_param.get("Tr").and_then(|text| text.parse::<f32>().ok());
    Material {
        d: material.dissolve.or_else(|| transparency().map(|tr| 1.0 - tr)).unwrap_or(default.d),
        kd: material.diffuse.unwrap_or(default.kd),
        ks: material.specular.unwrap_or(default.ks),
        ns: material.shininess.unwrap_or(default.ns),
        ke: material.emissive.unwrap_or(default.ke),
        mirror: matches!(material.illumination_model, Some(3 | 5)),
        mean_colour: default.mean_colour,
    }
    .checked()
}
