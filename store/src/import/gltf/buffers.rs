//! The buffers of a glTF file: the binary chunk, files beside it, and data URIs, each found when it is first asked for.
//!
//! As OBJ's `mtllib` does, a URI may lead anywhere that the user may read: a relative one begins at the file's folder.
//! Only regular files are opened, and only their bytes as numbers come out of them.
//!
//! Invariants: 1. a place is as long as the file says the buffer is, and lies in what is there; 2. a data URI goes to
//! the spool, decoded in pieces; 3. every file that is named is in `named`, with its stamp from before it was read.

use super::bytes::{BufferPlace, Spool};
use super::container::Container;
use super::json::JsonDocument;
use crate::budget::Lease;
use crate::error::{Code, Error, Result};
use crate::import::ImportOptions;
use crate::import::text::printable;
use crate::stamp;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::os::unix::ffi::{OsStrExt, OsStringExt};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Characters of base64 that are decoded at once: a multiple of four.
const DECODED_CHARS: usize = 32 << 10;
/// Bytes leased per buffer, and per file that is named, beside its path, which is kept twice.
const BUFFER_BYTES: u64 = size_of::<Option<BufferPlace>>() as u64;
const NAMED_BYTES: u64 = 256;
/// Most files that are named.
const MAX_NAMED: usize = 4096;
/// Most bytes of a path, as of all calls of the system.
const PATH_BYTES_MAX: usize = 4096;
/// Schemes of URIs that name no file.
const SCHEMES: [&str; 4] = ["http:", "https:", "file:", "ftp:"];

/// The buffers of a file.
pub(super) struct Buffers<'a> {
    path: Arc<Path>,
    document: &'a JsonDocument<'a>,
    bin: Option<(u64, u64)>,
    places: Vec<Option<BufferPlace>>,
    /// Files that are named, by full path, each with its stamp.
    pub(super) named: Vec<(Vec<u8>, String)>,
    /// Bytes of all files that are read from.
    pub(super) file_bytes: u64,
    /// Of `places`, and of `named`.
    _lease: Lease,
    named_lease: Lease,
}

impl<'a> Buffers<'a> {
    /// None of them found so far.
    pub(super) fn new(
        path: &Arc<Path>,
        document: &'a JsonDocument<'a>,
        container: &Container,
        options: &ImportOptions,
    ) -> Result<Buffers<'a>> {
        let count = document.buffers.len();
        let lease = options.budget.lease("the buffers of a glTF file", count as u64 * BUFFER_BYTES)?;
        Ok(Buffers {
            path: path.clone(),
            document,
            bin: container.bin,
            places: vec![None; count],
            named: Vec::new(),
            file_bytes: 0,
            _lease: lease,
            named_lease: options.budget.lease("the files that a glTF file names", 0)?,
        })
    }

    /// What was named, and its lease.
    pub(super) fn into_named(self) -> (Vec<(Vec<u8>, String)>, Lease) {
        (self.named, self.named_lease)
    }

    /// The place of a buffer.
    pub(super) fn place(&mut self, index: u32, spool: &mut Spool) -> Result<BufferPlace> {
        let Some(buffer) = self.document.buffers.get(index as usize) else {
            let count = self.document.buffers.len();
            return Err(wrong(
                &self.path,
                "buffers",
                index,
                "the glTF file refers to a buffer that is not there",
            )
            .numbers(format!("there are {count} buffers")));
        };
        if let Some(place) = &self.places[index as usize] {
            return Ok(place.clone());
        }
        let bytes = buffer.byte_length;
        let place = match (buffer.uri.as_deref(), self.bin) {
            (Some(uri), _) if is_data(uri) => self.data(("buffers", index), uri, bytes, spool)?,
            (Some(uri), _) => self.file(index, uri, bytes)?,
            (None, Some((offset, there))) if index == 0 => {
                self.check_length(("buffers", index), bytes, there)?;
                BufferPlace::File { path: self.path.clone(), offset, bytes }
            }
            (None, _) => {
                return Err(wrong(&self.path, "buffers", index, "a buffer of the glTF file has no bytes")
                    .numbers("it has no URI, and is not the binary chunk of a GLB file")
                    .next("export the file again, as .glb or with a .bin file beside it"));
            }
        };
        self.places[index as usize] = Some(place.clone());
        Ok(place)
    }

    /// Adds a file that is named to the list.
    pub(super) fn name(&mut self, path: &Path) -> Result<()> {
        if self.named.len() >= MAX_NAMED {
            return Err(Error::new(Code::InputRange, "the glTF file names too many files")
                .at(&self.path)
                .numbers(format!("more than {MAX_NAMED}"))
                .next("write its buffers to one .bin file, or to a .glb file"));
        }
        let full = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf()).into_os_string();
        if self.named.iter().any(|(named, _)| named == full.as_bytes()) {
            return Ok(());
        }
        self.named_lease.grow("the files that a glTF file names", NAMED_BYTES + 2 * full.len() as u64)?;
        self.named.push((full.into_vec(), stamp(path)));
        Ok(())
    }

    /// The path of a URI that is no data; `None` where it is on another machine, or longer than paths are.
    pub(super) fn path_of(&self, uri: &str) -> Option<PathBuf> {
        let is_foreign = SCHEMES
            .iter()
            .any(|scheme| uri.get(..scheme.len()).is_some_and(|start| start.eq_ignore_ascii_case(scheme)));
        let is_foreign = is_foreign || uri.len() > PATH_BYTES_MAX;
        let folder = self.path.parent().unwrap_or(Path::new(""));
        (!is_foreign).then(|| {
            let plain = folder.join(uri);
            // Some writers do not escape: a file of that very name wins.
            if plain.exists() { plain } else { folder.join(std::ffi::OsStr::from_bytes(&unescaped(uri))) }
        })
    }

    fn file(&mut self, index: u32, uri: &str, bytes: u64) -> Result<BufferPlace> {
        let Some(path) = self.path_of(uri) else {
            return Err(wrong(
                &self.path,
                "buffers",
                index,
                "a buffer of the glTF file is not on this machine",
            )
            .numbers(printable(&uri.as_bytes()[..uri.len().min(64)]))
            .next("download it, and name the file in its place"));
        };
        self.name(&path)?;
        let kind = std::fs::metadata(&path).map_err(|error| {
            Error::new(Code::InputUnreadable, "a buffer of the glTF file cannot be opened")
                .at(&path)
                .numbers(error.to_string())
                .next(format!("put the file beside {}, which names it", self.path.display()))
        })?;
        if !kind.is_file() {
            return Err(Error::new(Code::InputUnreadable, "a buffer of the glTF file is not a regular file")
                .at(&path)
                .next("save it to a file first: it is read twice, and at more than one place"));
        }
        if kind.len() < bytes {
            return Err(Error::new(Code::InputTruncated, "a buffer is shorter than the glTF file says")
                .at(&path)
                .numbers(format!("{bytes} bytes said, {} there", kind.len()))
                .next("copy or download the file again"));
        }
        self.file_bytes += kind.len();
        Ok(BufferPlace::File { path: path.into(), offset: 0, bytes })
    }

    /// The bytes of an image whose URI is its data; `None` where it is not.
    pub(super) fn embedded(&self, image: u32, uri: &str, spool: &mut Spool) -> Result<Option<BufferPlace>> {
        if !is_data(uri) {
            return Ok(None);
        }
        let data = uri.split_once(',').map_or("", |(_, data)| data).trim_end();
        let bytes = data.trim_end_matches('=').len() as u64 * 3 / 4;
        self.data(("images", image), uri, bytes, spool).map(Some)
    }

    fn data(&self, of: (&str, u32), uri: &str, bytes: u64, spool: &mut Spool) -> Result<BufferPlace> {
        let bad = |what: &str| wrong(&self.path, of.0, of.1, what);
        let (kind, data) = uri.split_once(',').unwrap_or((uri, ""));
        if !kind.ends_with(";base64") {
            return Err(bad("a data URI of the glTF file is not in base64")
                .numbers(printable(&kind.as_bytes()[..kind.len().min(64)])));
        }
        let mut writer = spool.writer()?;
        let mut decoded = [0; DECODED_CHARS / 4 * 3];
        let mut left = bytes;
        for piece in data.trim_end().as_bytes().chunks(DECODED_CHARS) {
            let count = STANDARD.decode_slice(piece, &mut decoded).map_err(|error| {
                bad("a data URI of the glTF file is no base64").numbers(error.to_string())
            })?;
            let wanted = left.min(count as u64);
            writer.write(&decoded[..wanted as usize])?;
            left -= wanted;
        }
        self.check_length(of, bytes, bytes - left)?;
        writer.finish()
    }

    fn check_length(&self, (list, index): (&str, u32), said: u64, there: u64) -> Result<()> {
        if said <= there {
            return Ok(());
        }
        Err(Error::new(Code::InputTruncated, "a buffer of the glTF file is shorter than it says")
            .at_place(format!("{}: {list}[{index}]", self.path.display()))
            .numbers(format!("{said} bytes said, {there} there"))
            .next("copy or download the file again"))
    }
}

/// The error of an item of the file's lists that is not as it has to be.
pub(super) fn wrong(path: &Path, list: &str, index: u32, what: &str) -> Error {
    Error::new(Code::InputFormat, what)
        .at_place(format!("{}: {list}[{index}]", path.display()))
        .next("check the file with a glTF validator, or export it again")
}

/// Whether a URI is its data.
pub(super) fn is_data(uri: &str) -> bool {
    uri.get(..5).is_some_and(|scheme| scheme.eq_ignore_ascii_case("data:"))
}

/// The bytes of a URI, with `%20` and its like replaced.
fn unescaped(uri: &str) -> Vec<u8> {
    let (mut out, mut rest) = (Vec::with_capacity(uri.len()), uri.as_bytes());
    while let Some((&first, after)) = rest.split_first() {
        let digits = after.get(..2).and_then(|digits| std::str::from_utf8(digits).ok());
        match digits.and_then(|digits| u8::from_str_radix(digits, 16).ok()) {
            Some(byte) if first == b'%' => {
                out.push(byte);
                rest = &after[2..];
            }
            _ => {
                out.push(first);
                rest = after;
            }
        }
    }
    out
}

const _: () = assert!(DECODED_CHARS.is_multiple_of(4));

#[cfg(test)]
mod tests {
    #[test]
    fn escapes_are_replaced_and_others_stay() {
        for (uri, bytes) in [("a%20b", "a b"), ("50%", "50%"), ("%zz%2", "%zz%2"), ("%C3%A4", "\u{e4}")] {
            assert_eq!(super::unescaped(uri), bytes.as_bytes());
        }
    }
}
