//! MTL text, one line at a time: the materials in it.
//!
//! ```text
//! newmtl NAME    -> the material before is whole
//! Kd, Ks, ...    -> the last row of each key counts
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
    define: &mut dyn FnMut(&str, Material) -> bool,
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
}

impl OpenMaterial {
    fn new(name: &str) -> OpenMaterial {
        OpenMaterial { name: stored_name(name).into_owned(), rows: [const { None }; KEYS.len()] }
    }

    /// Makes the material, and hands it on; false where that says no.
    fn define(self, define: &mut dyn FnMut(&str, Material) -> bool) -> bool {
        // The name stays here: `tobj` has rules of its own for names.
        let mut text = String::from("newmtl m\n");
        for ((key, _), row) in KEYS.iter().zip(&self.rows) {
            if let Some(row) = row {
                let _ = writeln!(text, "{key} {row}");
            }
        }
        let made = tobj::load_mtl_buf(&mut text.as_bytes()).ok().and_then(|(mut made, _)| made.pop());
        made.is_none_or(|made| define(&self.name, from_tobj(&made)))
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
