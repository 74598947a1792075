//! The container: the text of a `.gltf` file, or the chunks of a `.glb` file, and the JSON in it.
//!
//! ```text
//! GLB   0..4    4..8       8..12    12..16   16..20  20..              then
//!       glTF    version 2  length   bytes    JSON    text, spaces      bytes | BIN | buffer 0
//! ```
//!
//! Invariants: 1. a length is compared with the file's before it is used; 2. the text and what is parsed of it are
//! leased before either is taken, and both go when the parts that are kept have been made.

use super::json::{JsonDocument, parsed_bytes};
use crate::budget::Lease;
use crate::error::{Code, Error, Result};
use crate::import::ImportOptions;
use crate::import::scalar::head;
use crate::import::text::printable;
use crate::next_step::NextStep;
use crate::{RESERVE_BYTES, import::Format};
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Most bytes of JSON: that of a million nodes.
pub(super) const MAX_JSON_BYTES: u64 = 256 << 20;
/// Bytes of a GLB header, and of the header of a chunk.
const HEADER_BYTES: u64 = 12;
const CHUNK_HEADER_BYTES: u64 = 8;
const JSON_CHUNK: u32 = 0x4e4f_534a;
const BIN_CHUNK: u32 = 0x004e_4942;
/// Characters of the JSON parser's message that are shown: it may quote a whole buffer.
const MESSAGE_CHARS: usize = 200;

/// The text of the JSON, and where the binary chunk lies.
pub(super) struct Container {
    text: Vec<u8>,
    /// Offset and bytes.
    pub(super) bin: Option<(u64, u64)>,
    /// Bytes of the file behind what its header counts.
    pub(super) trailing_bytes: u64,
    text_offset: u64,
    _lease: Lease,
}

impl Container {
    /// Reads the JSON of `file`, which has `length` bytes.
    pub(super) fn read(
        file: &File,
        path: &Path,
        format: Format,
        length: u64,
        options: &ImportOptions,
    ) -> Result<Container> {
        let reader = ContainerFile { file, path, length };
        let (text_offset, text_bytes, bin, end) = match format {
            Format::Glb => reader.chunks()?,
            _ => (0, length, None, length),
        };
        if text_bytes > MAX_JSON_BYTES {
            return Err(Error::new(Code::InputRange, "the JSON of the file is too large")
                .at(path)
                .numbers(format!("{text_bytes} bytes, and {MAX_JSON_BYTES} at most"))
                .next("write its buffers to a .bin file beside it, or to a .glb file"));
        }
        within(text_bytes, path, options)?;
        let lease = options.budget.lease("the JSON of a glTF file", text_bytes)?;
        let mut text = vec![0; text_bytes as usize];
        reader.exact(text_offset, &mut text)?;
        Ok(Container { text, bin, trailing_bytes: length - end, text_offset, _lease: lease })
    }

    /// The document, and the lease of what it takes.
    pub(super) fn parse(&self, path: &Path, options: &ImportOptions) -> Result<(JsonDocument<'_>, Lease)> {
        // Writers of GLB fill the chunk up, some of them with zeros; other tools leave a byte order mark.
        let text = self.text.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&self.text);
        let end = text.iter().rposition(|&byte| byte != 0).map_or(0, |last| last + 1);
        let text = &text[..end];
        let bytes = parsed_bytes(text);
        within(self.text.len() as u64 + bytes, path, options)?;
        let lease = options.budget.lease("the parsed JSON of a glTF file", bytes)?;
        let document = serde_json::from_slice(text).map_err(|error| {
            let message: String = error.to_string().chars().take(MESSAGE_CHARS).collect();
            let wrong = Error::new(Code::InputFormat, "the JSON of the glTF file is not as it should be");
            let wrong = match self.text_offset {
                0 => wrong.at_line(path, error.line() as u64),
                offset => wrong.at_byte(path, offset),
            };
            wrong.numbers(message).next("check the file with a glTF validator, or export it again")
        })?;
        Ok((document, lease))
    }
}

/// Refuses what would take more than the options allow, before it is taken: a ledger without a limit, as of those who
/// only count, does not.
fn within(bytes: u64, path: &Path, options: &ImportOptions) -> Result<()> {
    if bytes <= options.held_bytes {
        return Ok(());
    }
    let smallest = RESERVE_BYTES.saturating_add(bytes);
    Err(Error::new(Code::MemoryLimit, "the memory limit has no room for the JSON of a glTF file")
        .at(path)
        .numbers(format!("up to {bytes} bytes to read and to parse it, {} free", options.held_bytes))
        .next(NextStep::RaiseLimit { bytes: smallest })
        .smallest_limit(smallest))
}

/// A file of known length.
struct ContainerFile<'a> {
    file: &'a File,
    path: &'a Path,
    length: u64,
}

impl ContainerFile<'_> {
    /// Offset and bytes of the JSON, those of the binary chunk, and where the container ends.
    #[allow(clippy::type_complexity)]
    fn chunks(&self) -> Result<(u64, u64, Option<(u64, u64)>, u64)> {
        let mut header = [0; HEADER_BYTES as usize];
        self.exact(0, &mut header)?;
        let [version, total] = [4, 8].map(|at| u32::from_le_bytes(head(&header[at..])));
        if version != 2 {
            return Err(self
                .wrong(4, "the GLB file has a version that is not read")
                .numbers(format!("version {version}, and 2 is read"))
                .next("convert it to glTF 2.0"));
        }
        let end = u64::from(total);
        if end > self.length {
            return Err(Error::new(Code::InputTruncated, "the GLB file is shorter than its header says")
                .at_byte(self.path, 8)
                .numbers(format!("{end} bytes in the header, {} in the file", self.length))
                .next("copy or download the file again"));
        }
        let (kind, text_bytes) = self.chunk(HEADER_BYTES, end)?;
        if kind != JSON_CHUNK {
            return Err(self
                .wrong(16, "the first chunk of a GLB file holds its JSON, this one does not")
                .numbers(format!("the chunk is called `{}`", printable(&kind.to_le_bytes())))
                .next("export the file again"));
        }
        let text_offset = HEADER_BYTES + CHUNK_HEADER_BYTES;
        // Chunks begin at multiples of four, whatever the length of the one before says.
        let next = (text_offset + text_bytes).next_multiple_of(4);
        let mut bin = None;
        if next + CHUNK_HEADER_BYTES <= end {
            let (kind, bytes) = self.chunk(next, end)?;
            bin = (kind == BIN_CHUNK).then_some((next + CHUNK_HEADER_BYTES, bytes));
        }
        Ok((text_offset, text_bytes, bin, end))
    }

    /// Kind and bytes of the chunk at `offset`, which ends before `end`.
    fn chunk(&self, offset: u64, end: u64) -> Result<(u32, u64)> {
        let mut header = [0; CHUNK_HEADER_BYTES as usize];
        self.exact(offset, &mut header)?;
        let bytes = u64::from(u32::from_le_bytes(head(&header)));
        let left = end.saturating_sub(offset + CHUNK_HEADER_BYTES);
        if bytes > left {
            return Err(Error::new(Code::InputTruncated, "a chunk of the GLB file is longer than the file")
                .at_byte(self.path, offset)
                .numbers(format!("{bytes} bytes, {left} left"))
                .next("copy or download the file again"));
        }
        Ok((u32::from_le_bytes(head(&header[4..])), bytes))
    }

    fn exact(&self, offset: u64, into: &mut [u8]) -> Result<()> {
        if offset + into.len() as u64 > self.length {
            return Err(Error::new(Code::InputTruncated, "the file ends early")
                .at_byte(self.path, offset)
                .numbers(format!("{} bytes needed here, the file has {}", into.len(), self.length))
                .next("copy or download the file again"));
        }
        self.file.read_exact_at(into, offset).map_err(|error| Error::io("read the input", self.path, &error))
    }

    fn wrong(&self, offset: u64, what: &str) -> Error {
        Error::new(Code::InputFormat, what).at_byte(self.path, offset)
    }
}
