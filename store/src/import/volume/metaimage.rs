//! The header of a MetaImage: `.mhd` with the name of the file that has the samples, or `.mha` with these behind it.
//!
//! ```text
//! ObjectType = Image
//! NDims = 3
//! DimSize = 181 217 181          the axis whose samples lie side by side comes first
//! ElementType = MET_UCHAR
//! ElementSpacing = 1 1 1
//! ElementDataFile = ch2.raw      or LOCAL: the samples begin behind this line
//! ```
//!
//! The format: <https://itk.org/Wiki/ITK/MetaIO/Documentation>.

use super::layout::{SamplePacking, SamplePlace, Skip, VolumeAxes, VolumeHeader};
use super::samples::SampleType;
use super::text::{HeaderLines, split};
use crate::error::Result;
use crate::import::scalar::ByteOrder;

/// Fields of a header, as far as they have come.
#[derive(Default)]
struct MetaFields {
    sample: Option<SampleType>,
    size: Option<[u64; 3]>,
    is_packed: bool,
    is_big: bool,
    spacing: Option<[f64; 3]>,
    element_size: Option<[f64; 3]>,
    origin: Option<[f64; 3]>,
    /// A direction after the other.
    directions: Option<[[f64; 3]; 3]>,
    place: Option<SamplePlace>,
    header_bytes: i64,
}

/// Reads the header.
pub(super) fn parse(mut lines: HeaderLines<'_>) -> Result<VolumeHeader> {
    let mut fields = MetaFields::default();
    while let Some(line) = lines.next_line()? {
        if line.trim_ascii().is_empty() {
            continue;
        }
        let Some((field, value)) = split(line, b"=") else {
            return Err(lines.wrong("a line of the header is not `name = value`", line));
        };
        fields.set(&field.to_ascii_lowercase(), value, &lines)?;
        if matches!(fields.place, Some(SamplePlace::Attached(_))) {
            break;
        }
    }
    fields.header(&lines)
}

impl MetaFields {
    /// Takes up the field of the last line.
    fn set(&mut self, field: &str, value: &[u8], lines: &HeaderLines<'_>) -> Result<()> {
        match field {
            "objecttype" if !value.eq_ignore_ascii_case(b"image") => {
                return Err(lines.wrong("the file holds another thing than an image", value));
            }
            "ndims" if lines.one::<u64>(field, value)? != 3 => {
                return Err(lines
                    .wrong("the volume has another number of axes than three", value)
                    .next("cut a volume of three axes out of it"));
            }
            "dimsize" => self.size = Some(lines.three(field, value)?),
            "elementtype" => {
                let sample = SampleType::from_name(&String::from_utf8_lossy(value));
                self.sample = Some(sample.ok_or_else(|| {
                    lines.wrong("the type of the samples is not one of numbers with 8 to 64 bits", value)
                })?);
            }
            "elementnumberofchannels" if lines.one::<u64>(field, value)? != 1 => {
                return Err(lines
                    .wrong("the volume has several numbers to a sample", value)
                    .next("write one channel of it to a file"));
            }
            "elementspacing" => self.spacing = Some(lines.three(field, value)?),
            "elementsize" => self.element_size = Some(lines.three(field, value)?),
            "offset" | "origin" | "position" => self.origin = Some(lines.three(field, value)?),
            "transformmatrix" | "orientation" | "rotation" => {
                let list = lines.numbers(value).and_then(|list| <[f64; 9]>::try_from(list).ok());
                let list = list.ok_or_else(|| lines.wrong("a matrix has nine numbers", value))?;
                self.directions = Some([0, 3, 6].map(|row| [list[row], list[row + 1], list[row + 2]]));
            }
            "elementbyteordermsb" | "binarydatabyteordermsb" => self.is_big = truth(value, lines)?,
            "binarydata" if !truth(value, lines)? => {
                return Err(lines.wrong("the samples are written as text", value));
            }
            "compresseddata" => self.is_packed = truth(value, lines)?,
            "headersize" => self.header_bytes = lines.one(field, value)?,
            "elementdatafile" => self.place = Some(place(value, lines)?),
            _ => {}
        }
        Ok(())
    }

    /// All fields together.
    fn header(self, lines: &HeaderLines<'_>) -> Result<VolumeHeader> {
        let mut axes = VolumeAxes::straight([1.0; 3]);
        let spacing = self.spacing.or(self.element_size).unwrap_or([1.0; 3]);
        axes.steps = self.directions.unwrap_or(axes.steps);
        for (step, spacing) in axes.steps.iter_mut().zip(spacing) {
            *step = step.map(|part| part * spacing);
        }
        axes.origin = self.origin.unwrap_or(axes.origin);
        let skip = match self.header_bytes {
            -1 => Skip::ToEnd,
            bytes => match u64::try_from(bytes) {
                Ok(bytes) => Skip::Count { lines: 0, bytes },
                Err(_) => return Err(lines.missing("HeaderSize, which is -1 or more")),
            },
        };
        Ok(VolumeHeader {
            size: self.size.ok_or_else(|| lines.missing("DimSize"))?,
            sample: self.sample.ok_or_else(|| lines.missing("ElementType"))?,
            order: if self.is_big { ByteOrder::Big } else { ByteOrder::Little },
            packing: if self.is_packed { SamplePacking::Zlib } else { SamplePacking::None },
            axes,
            place: self.place.ok_or_else(|| lines.missing("ElementDataFile"))?,
            skip,
            warnings: Vec::new(),
        })
    }
}

fn place(value: &[u8], lines: &HeaderLines<'_>) -> Result<SamplePlace> {
    if value.eq_ignore_ascii_case(b"local") {
        return Ok(SamplePlace::Attached(lines.offset()));
    }
    if value.eq_ignore_ascii_case(b"list") || value.contains(&b'%') {
        return Err(lines
            .wrong("the samples are in several files", value)
            .next("join them into one, in their order, and name that"));
    }
    lines.file(value).map(SamplePlace::File)
}

fn truth(value: &[u8], lines: &HeaderLines<'_>) -> Result<bool> {
    match value.first().map(u8::to_ascii_lowercase) {
        Some(b't' | b'1') => Ok(true),
        Some(b'f' | b'0') => Ok(false),
        _ => Err(lines.wrong("a value is neither True nor False", value)),
    }
}
