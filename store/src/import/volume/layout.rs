//! What a header says of its volume, and the gate behind which it is believed.
//!
//! Invariants of a `VolumeLayout`: 1. there are two samples or more along each axis, and no more than [`MAX_SIDE`];
//! 2. the samples lie in their file, or can be packed in what is there; 3. every position is finite, and no axis lies
//! in the plane of the others.

use super::samples::SampleType;
use crate::error::{Code, Error, Result};
use crate::file::open_regular;
use crate::import::scalar::ByteOrder;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Most samples along an axis.
const MAX_SIDE: u64 = 1 << 20;
/// Most lines that are left out before the samples.
const MAX_LINES: u64 = 1 << 16;
/// No bytes are packed tighter by deflate than so many to one.
const MOST_PACKED: u64 = 1032;

/// How samples are stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum SamplePacking {
    /// As they are.
    None,
    /// By gzip.
    Gzip,
    /// As a zlib stream.
    Zlib,
}

/// Where the samples are.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum SamplePlace {
    /// In the header's file, from this byte on.
    Attached(u64),
    /// In another file.
    File(PathBuf),
}

/// Bytes between the beginning of a file and its samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Skip {
    /// So many lines, and then so many bytes, unpacked.
    Count { lines: u64, bytes: u64 },
    /// As many as leave the samples at the file's end.
    ToEnd,
}

/// What a header says; nothing of it has been checked.
#[derive(Clone, Debug)]
pub(super) struct VolumeHeader {
    pub(super) size: [u64; 3],
    pub(super) sample: SampleType,
    pub(super) order: ByteOrder,
    pub(super) packing: SamplePacking,
    pub(super) axes: VolumeAxes,
    pub(super) place: SamplePlace,
    pub(super) skip: Skip,
    pub(super) warnings: Vec<String>,
}

/// Where samples stand in model space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct VolumeAxes {
    /// The first sample.
    pub(super) origin: [f64; 3],
    /// From a sample to the next one along each axis.
    pub(super) steps: [[f64; 3]; 3],
}

/// A volume whose header has been checked against the file of its samples.
#[derive(Debug)]
pub(super) struct VolumeLayout {
    /// The header's path.
    pub(super) path: PathBuf,
    /// Samples along each axis, that of the slices last.
    pub(super) size: [usize; 3],
    pub(super) sample: SampleType,
    pub(super) order: ByteOrder,
    pub(super) packing: SamplePacking,
    pub(super) axes: VolumeAxes,
    /// Where the samples are: open, its path, and from which byte to which.
    pub(super) file: File,
    pub(super) file_path: PathBuf,
    pub(super) offset: u64,
    pub(super) end: u64,
    /// Bytes to leave out once they are unpacked.
    pub(super) unpacked_skip: u64,
    pub(super) warnings: Vec<String>,
}

impl VolumeAxes {
    /// Axes along those of model space.
    pub(super) fn straight(spacing: [f64; 3]) -> VolumeAxes {
        let mut steps = [[0.0; 3]; 3];
        (0..3).for_each(|axis| steps[axis][axis] = spacing[axis]);
        VolumeAxes { origin: [0.0; 3], steps }
    }

    /// The place that so many samples along each axis lead to.
    #[inline]
    pub(super) fn position(&self, samples: [f64; 3]) -> [f64; 3] {
        let [x, y, z] = self.steps;
        std::array::from_fn(|axis| {
            self.origin[axis] + samples[0] * x[axis] + samples[1] * y[axis] + samples[2] * z[axis]
        })
    }

    /// Six times the volume of the tetrahedron that the steps span, over the product of their lengths; negative where
    /// the axes are a mirror image.
    pub(super) fn handedness(&self) -> f64 {
        let length = |v: [f64; 3]| v.iter().fold(0.0f64, |sum, x| sum.hypot(*x));
        let [a, b, c] = self.steps.map(|step| {
            let length = length(step);
            step.map(|part| part / length)
        });
        a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0])
            + a[2] * (b[0] * c[1] - b[1] * c[0])
    }
}

impl VolumeLayout {
    /// Bytes of a slice.
    pub(super) fn slice_bytes(&self) -> u64 {
        (self.size[0] * self.size[1]) as u64 * self.sample.bytes()
    }

    /// Bytes of all samples.
    pub(super) fn sample_bytes(&self) -> u64 {
        self.slice_bytes() * self.size[2] as u64
    }

    /// Checks `header`, which was read from `path`, a file of `length` bytes.
    pub(super) fn check(header: VolumeHeader, path: &Path) -> Result<VolumeLayout> {
        let bytes = checked_bytes(&header, path)?;
        check_axes(&header, path)?;
        let VolumeHeader { size, sample, order, packing, axes, place, skip, mut warnings } = header;
        let (file_path, from) = match place {
            SamplePlace::Attached(offset) => (path.to_path_buf(), offset),
            SamplePlace::File(file) => (file, 0),
        };
        let file = open_regular(&file_path)?;
        let end = file.metadata().map_err(|error| Error::io("open the input", &file_path, &error))?.len();
        let (offset, unpacked_skip) = match skip {
            Skip::ToEnd if packing == SamplePacking::None => (end.saturating_sub(bytes).max(from), 0),
            Skip::ToEnd => {
                return Err(Error::new(
                    Code::InputFormat,
                    "packed samples have no known place at a file's end",
                )
                .at(path)
                .numbers("-1 bytes are to be left out before them")
                .next("write the volume again, without bytes before its samples"));
            }
            Skip::Count { lines, bytes } => {
                let offset = behind_lines(&file, &file_path, from, lines)?;
                match packing {
                    SamplePacking::None => (offset.saturating_add(bytes), 0),
                    _ => (offset, bytes),
                }
            }
        };
        let left = end.saturating_sub(offset);
        let most = if packing == SamplePacking::None { left } else { left.saturating_mul(MOST_PACKED) };
        if bytes.saturating_add(unpacked_skip) > most {
            let is_packed = if packing == SamplePacking::None {
                ""
            } else {
                ", packed, which hold at most 1032 times as many"
            };
            return Err(Error::new(
                Code::InputTruncated,
                "the file is too short for the volume that its header declares",
            )
            .at_byte(&file_path, offset.min(end))
            .numbers(format!("{} take {bytes} bytes, and there are {left}{is_packed}", shown(size, sample)))
            .next("copy or download the file again, or correct the header"));
        }
        if packing == SamplePacking::None && left > bytes {
            warnings.push(format!("{} bytes behind the last sample are not read", left - bytes));
        }
        Ok(VolumeLayout {
            path: path.to_path_buf(),
            size: size.map(|side| side as usize),
            sample,
            order,
            packing,
            axes,
            file,
            file_path,
            offset,
            end,
            unpacked_skip,
            warnings,
        })
    }
}

/// A volume in words.
pub(super) fn shown([x, y, z]: [u64; 3], sample: SampleType) -> String {
    format!("{x} x {y} x {z} samples of {}", sample.name())
}

/// Bytes of all samples, once the size has been looked at.
fn checked_bytes(header: &VolumeHeader, path: &Path) -> Result<u64> {
    let VolumeHeader { size, sample, .. } = header;
    let shown = shown(*size, *sample);
    if size.iter().any(|&side| side < 2) {
        return Err(Error::new(Code::InputEmpty, "a surface needs two samples or more along each axis")
            .at(path)
            .numbers(shown)
            .next("check the size, or write the volume with more slices"));
    }
    let bytes = size.iter().try_fold(sample.bytes(), |bytes, &side| bytes.checked_mul(side));
    match bytes.filter(|&bytes| bytes <= i64::MAX as u64 && size.iter().all(|&side| side <= MAX_SIDE)) {
        Some(bytes) => Ok(bytes),
        None => Err(Error::new(Code::InputRange, "the volume is too large")
            .at(path)
            .numbers(format!("{shown}, and {MAX_SIDE} along an axis at most"))
            .next("check the size, or cut the volume into parts")),
    }
}

fn check_axes(header: &VolumeHeader, path: &Path) -> Result<()> {
    let VolumeHeader { axes, size, .. } = header;
    let far = axes.position(size.map(|side| side as f64));
    let reach = (0..3).map(|a| {
        axes.origin[a].abs() + (0..3).map(|i| (axes.steps[i][a] * size[i] as f64).abs()).sum::<f64>()
    });
    let is_finite = reach.into_iter().all(f64::is_finite) && far.into_iter().all(f64::is_finite);
    // What lies flat to within a millionth is a mistake: no scanner and no grid is so oblique.
    if is_finite && axes.handedness().abs() > 1e-6 {
        return Ok(());
    }
    Err(Error::new(Code::InputRange, "the axes of the volume do not span a space")
        .at(path)
        .numbers(format!("origin {:?}, steps {:?}", axes.origin, axes.steps))
        .next("correct the spacings, directions and origin in the header"))
}

/// The byte behind so many lines.
fn behind_lines(file: &File, path: &Path, from: u64, lines: u64) -> Result<u64> {
    use std::io::{BufRead, BufReader, Seek, SeekFrom};
    if lines == 0 {
        return Ok(from);
    }
    if lines > MAX_LINES {
        return Err(Error::new(Code::InputRange, "too many lines are to be left out before the samples")
            .at(path)
            .numbers(format!("{lines}, and {MAX_LINES} at most"))
            .next("correct the header"));
    }
    let failed = |error| Error::io("read the input", path, &error);
    let mut reader = BufReader::new(file);
    reader.seek(SeekFrom::Start(from)).map_err(failed)?;
    let (mut offset, mut left) = (from, lines);
    while left > 0 {
        let block = reader.fill_buf().map_err(failed)?;
        if block.is_empty() {
            return Err(Error::new(Code::InputTruncated, "the file has fewer lines than are to be left out")
                .at_byte(path, offset)
                .numbers(format!("{lines} lines before the samples, {} in the file", lines - left))
                .next("correct the header"));
        }
        let used = match memchr::memchr(b'\n', block) {
            Some(at) => {
                left -= 1;
                at + 1
            }
            None => block.len(),
        };
        reader.consume(used);
        offset += used as u64;
    }
    Ok(offset)
}
