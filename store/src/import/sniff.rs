//! Which format a file has: by its ending, and by its first bytes.
//!
//! Invariants: 1. content that is certainly something else is refused, whatever the ending says; 2. a UTF-8 byte
//! order mark is stepped over, other encodings of text are named and refused.

use super::input::Input;
use super::stl;
use super::text::printable;
use super::volume::nrrd;
use crate::error::{Code, Error, Result};
use crate::layout::MAGIC;
use std::path::Path;

/// Bytes that are looked at.
const PROBE_BYTES: usize = 4096;

/// A mesh file format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Format {
    /// Stanford polygon file.
    Ply,
    /// Wavefront object.
    Obj,
    /// Stereolithography.
    Stl,
    /// glTF as JSON, with buffers beside it or in it.
    Gltf,
    /// glTF in a container.
    Glb,
    /// A volume: nearly raw raster data.
    Nrrd,
    /// A volume with a header of ITK.
    MetaImage,
    /// Samples of a volume without a header.
    Raw,
}

/// How a file writes its numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Encoding {
    /// As text.
    Ascii,
    /// In bytes, least first.
    BinaryLittleEndian,
    /// In bytes, greatest first.
    BinaryBigEndian,
}

impl Format {
    /// The format that a path's ending names.
    pub fn of_path(path: &Path) -> Option<Format> {
        Format::from_ending(&path.extension()?.to_str()?.to_ascii_lowercase())
    }

    /// Whether files of this format are volumes, which become triangles at a value.
    pub fn is_volume(self) -> bool {
        matches!(self, Format::Nrrd | Format::MetaImage | Format::Raw)
    }

    fn from_ending(ending: &str) -> Option<Format> {
        match ending {
            "ply" => Some(Format::Ply),
            "obj" => Some(Format::Obj),
            "stl" => Some(Format::Stl),
            "gltf" => Some(Format::Gltf),
            "glb" => Some(Format::Glb),
            "nrrd" | "nhdr" => Some(Format::Nrrd),
            "mhd" | "mha" => Some(Format::MetaImage),
            "raw" => Some(Format::Raw),
            _ => None,
        }
    }

    fn ending(self) -> &'static str {
        match self {
            Format::Ply => ".ply",
            Format::Obj => ".obj",
            Format::Stl => ".stl",
            Format::Gltf => ".gltf",
            Format::Glb => ".glb",
            Format::Nrrd => ".nrrd",
            Format::MetaImage => ".mhd",
            Format::Raw => ".raw",
        }
    }
}

/// The format of `input`, which stands at its beginning; afterwards it stands behind a UTF-8 byte order mark.
pub(super) fn format(input: &mut Input) -> Result<Format> {
    input.fill(PROBE_BYTES)?;
    let ending = input.path().extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let named = Format::from_ending(&ending);
    if named == Some(Format::Raw) {
        // Samples may look like anything.
        return Ok(Format::Raw);
    }
    let probe = &input.window()[..input.window().len().min(PROBE_BYTES)];
    let is_stl_by_length =
        named.is_none_or(|named| named == Format::Stl) && length_is_stl(probe, input.length());
    if !is_stl_by_length {
        refuse_other_files(probe, named, input)?;
    }
    let content = of_content(probe);
    let found = match (named, content) {
        (Some(named), Some(Certain(content))) if named != content => {
            return Err(Error::new(Code::InputFormat, "the content is not what the file's name says")
                .at_byte(input.path(), 0)
                .numbers(format!("named {}, begins like {}", named.ending(), content.ending()))
                .next(format!(
                    "rename it to {}",
                    input.path().with_extension(&content.ending()[1..]).display()
                )));
        }
        (Some(Format::Ply), None) => {
            return Err(other_beginning(
                "a PLY file begins with a line `ply`, this one does not",
                probe,
                input,
            ));
        }
        (Some(Format::Glb), None) => {
            let what = "a GLB file begins with the letters `glTF`, this one does not";
            return Err(other_beginning(what, probe, input));
        }
        (Some(Format::Nrrd), None) => {
            let what = "an NRRD file begins with the letters `NRRD000`, this one does not";
            return Err(other_beginning(what, probe, input));
        }
        (Some(named), _) => named,
        (None, Some(Certain(content))) => content,
        (None, None) if is_stl_by_length => Format::Stl,
        (None, None) if begins_like_obj(probe) => Format::Obj,
        (None, None) if begins_like_gltf(probe) => Format::Gltf,
        (None, None) => {
            return Err(Error::new(Code::InputFormat, "this is no mesh file that can be read")
                .at(input.path())
                .numbers(format!("it begins `{}`", printable(&probe[..probe.len().min(16)])))
                .next("convert it to .ply, .obj, .stl, .gltf or .glb, a volume to .nrrd or .mhd"));
        }
    };
    if probe.starts_with(UTF8_MARK) && !is_stl_by_length {
        input.consume(UTF8_MARK.len());
    }
    Ok(found)
}

/// The error of a file that begins otherwise than its name says.
fn other_beginning(what: &str, probe: &[u8], input: &Input) -> Error {
    Error::new(Code::InputFormat, what)
        .at_byte(input.path(), 0)
        .numbers(format!("it begins `{}`", printable(&probe[..probe.len().min(16)])))
        .next("check the file's name and content")
}

const UTF8_MARK: &[u8] = b"\xef\xbb\xbf";

/// A format that no other content begins like.
struct Certain(Format);

fn of_content(probe: &[u8]) -> Option<Certain> {
    let text = probe.strip_prefix(UTF8_MARK).unwrap_or(probe);
    let facets = || text.windows(5).any(|word| word.eq_ignore_ascii_case(b"facet"));
    match text {
        [b'p', b'l', b'y', b'\n' | b'\r' | b' ' | b'\t', ..] => Some(Certain(Format::Ply)),
        [b'g', b'l', b'T', b'F', ..] => Some(Certain(Format::Glb)),
        _ if text.starts_with(nrrd::MAGIC) => Some(Certain(Format::Nrrd)),
        _ if stl::begins_with_solid(text) && facets() => Some(Certain(Format::Stl)),
        _ => None,
    }
}

fn length_is_stl(probe: &[u8], length: u64) -> bool {
    probe
        .get(80..84)
        .is_some_and(|count| 84 + 50 * u64::from(u32::from_le_bytes(super::scalar::head(count))) == length)
}

fn begins_like_obj(probe: &[u8]) -> bool {
    let text = String::from_utf8_lossy(probe.strip_prefix(UTF8_MARK).unwrap_or(probe));
    let row = text.lines().map(str::trim).find(|line| !line.is_empty() && !line.starts_with('#'));
    let word = row.and_then(|row| row.split_whitespace().next()).unwrap_or_default();
    matches!(word, "v" | "vn" | "vt" | "o" | "g" | "s" | "mtllib" | "usemtl")
}

fn begins_like_gltf(probe: &[u8]) -> bool {
    let text = probe.strip_prefix(UTF8_MARK).unwrap_or(probe).trim_ascii_start();
    text.starts_with(b"{") && memchr::memmem::find(text, b"\"asset\"").is_some()
}

fn refuse_other_files(probe: &[u8], named: Option<Format>, input: &Input) -> Result<()> {
    // Files of several formats may hold any bytes behind their head.
    let may_hold_bytes = matches!(named, Some(Format::Stl | Format::MetaImage)) || begins_with_head(probe);
    let text_only = !may_hold_bytes;
    let (what, next) = match probe {
        [0xff, 0xfe, 0, 0, ..] | [0, 0, 0xfe, 0xff, ..] => {
            ("the text is UTF-32", "convert it: iconv -t UTF-8")
        }
        [0xff, 0xfe, ..] | [0xfe, 0xff, ..] => ("the text is UTF-16", "convert it: iconv -t UTF-8"),
        [0x1f, 0x8b, ..] => ("the file is packed with gzip", "unpack it: gunzip"),
        [b'P', b'K', 3, 4, ..] => ("the file is a zip archive", "unpack it: unzip"),
        [0x28, 0xb5, 0x2f, 0xfd, ..] => ("the file is packed with zstd", "unpack it: zstd -d"),
        _ if probe.starts_with(&MAGIC) => {
            ("the file is a page file: it is built already", "name the mesh that it was built from")
        }
        _ if is_wide_text(probe) => ("the text is UTF-16 or UTF-32", "convert it: iconv -t UTF-8"),
        _ if text_only && probe.contains(&0) => {
            ("the file holds binary data where text belongs", "check the file's name and content")
        }
        _ => return Ok(()),
    };
    Err(Error::new(Code::InputFormat, what)
        .at_byte(input.path(), 0)
        .numbers(format!("it begins `{}`", printable(&probe[..probe.len().min(16)])))
        .next(next))
}

fn begins_with_head(probe: &[u8]) -> bool {
    [b"ply".as_slice(), b"glTF", nrrd::MAGIC].iter().any(|head| probe.starts_with(head))
}

/// True for Latin text in UTF-16 or UTF-32 without a mark: plain characters that stand alone between NULs.
fn is_wide_text(probe: &[u8]) -> bool {
    let head = &probe[..probe.len().min(64) / 4 * 4];
    let plain = |byte: u8| byte.is_ascii_graphic() || byte.is_ascii_whitespace();
    let alone_at = |step: usize, place: usize| {
        head.iter().enumerate().all(|(at, &byte)| if at % step == place { plain(byte) } else { byte == 0 })
    };
    !head.is_empty() && (alone_at(2, 0) || alone_at(2, 1) || alone_at(4, 0) || alone_at(4, 3))
}
