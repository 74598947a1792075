//! STL: which of its two forms a file has, and `StlSource`, the binary one.
//!
//! ```text
//! bytes   0..80    80..84   84..134 ...
//!         header   count    records: normal 3 x f32, corners 3 x 3 x f32, attribute u16
//! ```
//!
//! Many binary files begin with `solid` too, so the length decides first: 84 + 50 * count.
//!
//! Invariant: the count has been compared with the file's length before a record is read.

use super::input::{Input, WINDOW_BYTES};
use super::scalar::head;
use super::warn;
use crate::error::{Code, Error, Result};
use crate::material::Material;
use crate::material_list::MaterialList;
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};

const HEADER_BYTES: u64 = 84;
const RECORD_BYTES: usize = 50;

/// Bytes of a file that are looked at to tell text from numbers.
const PROBE_BYTES: usize = 1024;

/// The form of an STL file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum StlForm {
    /// Text.
    Ascii,
    /// Records, and how many of them.
    Binary {
        /// Triangles, as the header says and the length allows.
        count: u64,
    },
}

/// Decides the form of the file that `input` stands at the beginning of.
pub(super) fn form(input: &mut Input) -> Result<StlForm> {
    input.fill(PROBE_BYTES)?;
    let (length, window) = (input.length(), input.window());
    let probe = &window[..window.len().min(PROBE_BYTES)];
    let count = probe.get(80..84).map(|bytes| u64::from(u32::from_le_bytes(head(bytes))));
    let exact = |count: u64| HEADER_BYTES + RECORD_BYTES as u64 * count;
    if let Some(count) = count
        && exact(count) == length
    {
        return Ok(StlForm::Binary { count });
    }
    let is_text = probe.iter().all(|&byte| byte >= 0x20 || byte.is_ascii_whitespace());
    if is_text && begins_with_solid(probe) {
        return Ok(StlForm::Ascii);
    }
    match count {
        Some(_) if is_text => Err(Error::new(
            Code::InputFormat,
            "this is no STL file: it is text that does not begin with `solid`",
        )
        .at_byte(input.path(), 0)
        .numbers(format!("it begins `{}`", super::text::printable(&probe[..16])))
        .next("check the file's name and content")),
        Some(count) if exact(count) < length => Ok(StlForm::Binary { count }),
        _ => Err(Error::new(Code::InputTruncated, "the file is shorter than its header says")
            .at_byte(input.path(), 80.min(length))
            .numbers(match count {
                Some(count) => {
                    format!("{count} triangles take {} bytes, the file has {length}", exact(count))
                }
                None => format!("a binary STL file has at least {HEADER_BYTES} bytes, this one has {length}"),
            })
            .next("copy or download the file again")),
    }
}

/// True for text that begins with the word `solid`, in any case.
pub(super) fn begins_with_solid(text: &[u8]) -> bool {
    let text = text.trim_ascii_start();
    text.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"))
        && text.get(5).is_none_or(u8::is_ascii_whitespace)
}

/// Triangles of a binary STL file.
pub(super) struct StlSource {
    input: Input,
    count: u64,
    left: u64,
    materials: MaterialList,
    stats: SourceStats,
}

impl StlSource {
    /// Reads `count` records of `input`.
    pub(super) fn new(mut input: Input, count: u64) -> StlSource {
        let end = HEADER_BYTES + RECORD_BYTES as u64 * count;
        let mut stats = SourceStats { bytes_total: input.length(), ..SourceStats::default() };
        if end < input.length() {
            warn(&mut stats, format!("{} bytes after the last triangle are not read", input.length() - end));
        }
        input.seek(HEADER_BYTES);
        StlSource { input, count, left: count, materials: MaterialList::from(Material::default()), stats }
    }
}

impl TriangleSource for StlSource {
    fn name(&self) -> String {
        self.input.path().display().to_string()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        const _: () = assert!(WINDOW_BYTES >= TriangleBatch::TARGET_TRIANGLES * RECORD_BYTES);
        batch.clear();
        let count = self.left.min(TriangleBatch::TARGET_TRIANGLES as u64) as usize;
        let records = self.input.take(count * RECORD_BYTES)?;
        batch.corners.extend(records.chunks_exact(RECORD_BYTES).map(corners));
        batch.material.resize(count, 0);
        self.left -= count as u64;
        self.stats.triangle_count += count as u64;
        Ok(count > 0)
    }

    fn rewind(&mut self) -> Result<()> {
        self.input.seek(HEADER_BYTES);
        self.left = self.count;
        self.stats.triangle_count = 0;
        Ok(())
    }

    fn hint(&self) -> Option<ScanHint> {
        None
    }

    fn materials(&self) -> &MaterialList {
        &self.materials
    }

    fn stats(&self) -> SourceStats {
        SourceStats { bytes_read: self.input.offset(), ..self.stats.clone() }
    }
}

#[inline]
fn corners(record: &[u8]) -> [[f64; 3]; 3] {
    let record: &[u8; RECORD_BYTES] = record.try_into().expect("chunks of this size");
    let number = |at: usize| {
        f64::from(f32::from_le_bytes([record[at], record[at + 1], record[at + 2], record[at + 3]]))
    };
    std::array::from_fn(|corner| std::array::from_fn(|axis| number(12 + 12 * corner + 4 * axis)))
}
