//! The header of an NRRD file: `.nrrd` with its samples behind it, or `.nhdr` with the name of the file that has them.
//!
//! ```text
//! NRRD0004
//! # a comment
//! type: short
//! sizes: 512 512 300             the axis whose samples lie side by side comes first
//! space directions: (0.5,0,0) (0,0.5,0) (0,0,1.25)
//! a key:=a value, of which nothing is read
//!                                an empty line; then the samples, where no `data file` is named
//! ```
//!
//! The format: <https://teem.sourceforge.net/nrrd/format.html>.

use super::layout::{SamplePacking, SamplePlace, Skip, VolumeAxes, VolumeHeader};
use super::samples::SampleType;
use super::text::{HeaderLines, split};
use crate::error::{Code, Error, Result};
use crate::import::scalar::ByteOrder;

/// What an NRRD file begins with; one digit follows.
pub(in crate::import) const MAGIC: &[u8] = b"NRRD000";
/// The newest version.
const LAST_VERSION: u8 = b'5';
/// Fields that may be written without the blank in their name.
const JOINED: [(&str, &str); 3] =
    [("datafile", "data file"), ("byteskip", "byte skip"), ("lineskip", "line skip")];

/// Fields of a header, as far as they have come.
#[derive(Default)]
struct NrrdFields {
    sample: Option<SampleType>,
    size: Option<[u64; 3]>,
    packing: Option<SamplePacking>,
    order: Option<ByteOrder>,
    spacings: Option<[f64; 3]>,
    directions: Option<[[f64; 3]; 3]>,
    origin: Option<[f64; 3]>,
    place: Option<SamplePlace>,
    lines: u64,
    bytes: i64,
    warnings: Vec<String>,
}

/// Reads the header.
pub(super) fn parse(mut lines: HeaderLines<'_>) -> Result<VolumeHeader> {
    let magic = lines.next_line()?.unwrap_or_default();
    match magic.strip_prefix(MAGIC) {
        Some(&[b'1'..=LAST_VERSION]) => {}
        _ => return Err(lines.wrong("this is no NRRD file of version 1 to 5", magic)),
    }
    let (mut fields, mut has_end) = (NrrdFields::default(), false);
    while let Some(line) = lines.next_line()? {
        if line.is_empty() {
            has_end = true;
            break;
        }
        if line.starts_with(b"#") || memchr::memmem::find(line, b":=").is_some() {
            continue;
        }
        let Some((field, value)) = split(line, b": ").or_else(|| split(line, b":")) else {
            return Err(lines.wrong("a line of the header is neither a field nor a comment", line));
        };
        fields.set(&field.to_ascii_lowercase(), value, &lines)?;
    }
    fields.header(&lines, has_end)
}

impl NrrdFields {
    /// Takes up the field of the last line.
    fn set(&mut self, field: &str, value: &[u8], lines: &HeaderLines<'_>) -> Result<()> {
        let field = JOINED.iter().find(|(joined, _)| *joined == field).map_or(field, |(_, apart)| apart);
        let word = String::from_utf8_lossy(value).to_ascii_lowercase();
        match field {
            "type" => {
                let sample = SampleType::from_name(&word);
                self.sample = Some(sample.ok_or_else(|| {
                    lines.wrong("the type of the samples is not one of numbers with 8 to 64 bits", value)
                })?);
            }
            "dimension" if lines.one::<u64>(field, value)? != 3 => {
                return Err(lines
                    .wrong("the volume has another number of axes than three", value)
                    .next("cut a volume of three axes out of it, with one number to a sample"));
            }
            "sizes" => self.size = Some(lines.three(field, value)?),
            "spacings" => {
                // What is not known is written as NaN.
                let known = |spacing: f64| if spacing.is_nan() { 1.0 } else { spacing };
                self.spacings = Some(lines.three(field, value)?.map(known));
            }
            "space directions" => {
                let vectors = vectors(lines, value).and_then(|vectors| vectors.try_into().ok());
                self.directions =
                    Some(vectors.ok_or_else(|| lines.wrong("`space directions` has three vectors", value))?);
            }
            "space origin" => {
                let vectors = vectors(lines, value).and_then(|vectors| <[_; 1]>::try_from(vectors).ok());
                let [origin] = vectors.ok_or_else(|| lines.wrong("`space origin` is a vector", value))?;
                self.origin = Some(origin);
            }
            "axis mins" | "axismins" => {
                self.warnings.push("`axis mins` are not read: the first sample is at the origin".to_owned());
            }
            "encoding" => {
                self.packing = Some(match word.as_str() {
                    "raw" => SamplePacking::None,
                    "gzip" | "gz" => SamplePacking::Gzip,
                    _ => {
                        let error =
                            lines.wrong("the encoding of the samples is not read: raw and gzip are", value);
                        return Err(error.next("convert it with unu save, to the encoding gzip"));
                    }
                });
            }
            "endian" => {
                self.order = Some(match word.as_str() {
                    "little" => ByteOrder::Little,
                    "big" => ByteOrder::Big,
                    _ => return Err(lines.wrong("the order of bytes is little or big", value)),
                });
            }
            "data file" => {
                if word.starts_with("list") || value.contains(&b'%') {
                    return Err(lines
                        .wrong("the samples are in several files", value)
                        .next("join them into one with unu save"));
                }
                self.place = Some(SamplePlace::File(lines.file(value)?));
            }
            "line skip" => self.lines = lines.one(field, value)?,
            "byte skip" => self.bytes = lines.one(field, value)?,
            _ => {}
        }
        Ok(())
    }

    /// All fields together.
    fn header(self, lines: &HeaderLines<'_>, has_end: bool) -> Result<VolumeHeader> {
        let sample = self.sample.ok_or_else(|| lines.missing("type"))?;
        let size = self.size.ok_or_else(|| lines.missing("sizes"))?;
        let packing = self.packing.ok_or_else(|| lines.missing("encoding"))?;
        let order = match self.order {
            Some(order) => order,
            None if sample.bytes() == 1 => ByteOrder::Little,
            None => return Err(lines.missing("endian")),
        };
        let place = match self.place {
            Some(place) => place,
            None if has_end => SamplePlace::Attached(lines.offset()),
            None => {
                return Err(Error::new(Code::InputTruncated, "the file ends within its header")
                    .at_byte(lines.path(), lines.offset())
                    .numbers("no empty line comes behind the header, and no data file is named")
                    .next("copy or download the file again"));
            }
        };
        let mut axes = VolumeAxes::straight(self.spacings.unwrap_or([1.0; 3]));
        axes.steps = self.directions.unwrap_or(axes.steps);
        axes.origin = self.origin.unwrap_or(axes.origin);
        let skip = match self.bytes {
            -1 => Skip::ToEnd,
            bytes => match u64::try_from(bytes) {
                Ok(bytes) => Skip::Count { lines: self.lines, bytes },
                Err(_) => return Err(lines.missing("byte skip, which is -1 or more")),
            },
        };
        Ok(VolumeHeader { size, sample, order, packing, axes, place, skip, warnings: self.warnings })
    }
}

/// Vectors `(x,y,z)`; `None` where something else is among them.
fn vectors(lines: &HeaderLines<'_>, value: &[u8]) -> Option<Vec<[f64; 3]>> {
    let mut vectors = Vec::new();
    let mut rest = value;
    while !rest.is_empty() {
        let inside = rest.strip_prefix(b"(")?;
        let end = memchr::memchr(b')', inside)?;
        let spaced: Vec<u8> =
            inside[..end].iter().map(|&byte| if byte == b',' { b' ' } else { byte }).collect();
        vectors.push(lines.numbers(&spaced)?.try_into().ok()?);
        rest = inside[end + 1..].trim_ascii_start();
    }
    Some(vectors)
}
