//! Volumes: NRRD, MetaImage and plain samples, whose surfaces at given values are the triangles.
//!
//! ```text
//! HeaderLines -> nrrd | metaimage | options -> VolumeHeader -> VolumeLayout (the gate)
//! SampleReader -> slice, slice -> SliceMask per value -> CellRow: vertices and triangles of a row -> VolumeSource
//! ```
//!
//! A sample is inside of a surface where it is its value or more. Marching cubes by one table, which leaves no holes
//! (`marching_cubes`): a surface is closed but where the volume's border cuts it.
//!
//! Invariants: 1. two slices of the volume are in memory, leased; 2. nothing of a header is used before `layout.rs` has
//! checked it.

mod cells;
mod layout;
mod masks;
mod metaimage;
pub(super) mod nrrd;
mod reader;
mod samples;
mod source;
mod text;

pub use layout::SamplePacking;
pub use samples::SampleType;

use super::input::Input;
use super::options::RawVolume;
use super::scalar::ByteOrder;
use super::{Encoding, Format, ImportOptions, warn};
use crate::RESERVE_BYTES;
use crate::error::{Code, Error, Result};
use crate::material::Material;
use crate::material_list::MaterialList;
use crate::next_step::NextStep;
use crate::source::{SourceStats, TriangleSource};
use crate::stamp;
use cells::CellRow;
use layout::{SamplePlace, Skip, VolumeAxes, VolumeHeader, VolumeLayout};
use reader::SampleReader;
use source::{VolumeParts, VolumeSource, source_bytes};
use std::os::unix::ffi::OsStringExt;
use text::HeaderLines;

/// Most values of one volume, each with a surface and a material.
pub const MAX_ISO_VALUES: usize = 64;

/// What a volume's header says of it.
#[derive(Clone, Debug, serde::Serialize)]
pub struct VolumeInfo {
    /// Samples along each axis, that of the slices last.
    pub size: [usize; 3],
    /// Their type.
    pub sample_type: SampleType,
    /// How they are stored.
    pub packing: SamplePacking,
    /// Where the first sample stands.
    pub origin: [f64; 3],
    /// From a sample to the next one along each axis.
    pub steps: [[f64; 3]; 3],
    /// The file of the samples.
    pub sample_file: String,
}

/// Opens the surfaces of the volume that `input` has found to be of `format`.
pub(super) fn open(input: Input, format: Format, options: &ImportOptions) -> Result<Box<dyn TriangleSource>> {
    let layout = layout(input, format, options)?;
    let values = iso_values(&layout, options)?;
    let held = source_bytes(&layout, values.len());
    let path = layout.path.clone();
    if held > options.held_bytes {
        let smallest = RESERVE_BYTES.saturating_add(held);
        return Err(Error::new(
            Code::MemoryLimit,
            "the memory limit has no room for two slices of the volume",
        )
        .at(&path)
        .numbers(format!("{held} bytes, {} free", options.held_bytes))
        .next(NextStep::RaiseLimit { bytes: smallest })
        .smallest_limit(smallest));
    }
    let lease = options.budget.lease("two slices of a volume", held)?;
    let [side, _, slices] = layout.size;
    let mut stats = SourceStats {
        bytes_total: layout.sample_bytes(),
        slab_count: slices as u64 - 1,
        slab_bytes: 2 * layout.slice_bytes(),
        ..SourceStats::default()
    };
    layout.warnings.iter().for_each(|warning| warn(&mut stats, warning.clone()));
    if layout.file_path != path {
        let full = std::path::absolute(&layout.file_path).unwrap_or_else(|_| layout.file_path.clone());
        stats.named_files.push((full.into_os_string().into_vec(), stamp(&layout.file_path)));
    }
    let named = values.iter().map(|&value| (material_name(value), Material::default()));
    let materials = MaterialList::from_iter(named);
    stats.material_name_bytes = materials.names().text_bytes() as u64;
    let file = layout.file.try_clone().map_err(|error| Error::io("open the input again", &path, &error))?;
    let parts = VolumeParts {
        path,
        size: layout.size,
        is_foreign: samples::is_foreign(layout.order),
        reader: SampleReader::new(&layout, file, &options.interrupt),
        cells: CellRow::new(layout.axes, side),
        values,
        materials,
        stats,
        lease,
    };
    Ok(match layout.sample {
        SampleType::Int8 => Box::new(VolumeSource::<i8>::new(parts)),
        SampleType::Uint8 => Box::new(VolumeSource::<u8>::new(parts)),
        SampleType::Int16 => Box::new(VolumeSource::<i16>::new(parts)),
        SampleType::Uint16 => Box::new(VolumeSource::<u16>::new(parts)),
        SampleType::Int32 => Box::new(VolumeSource::<i32>::new(parts)),
        SampleType::Uint32 => Box::new(VolumeSource::<u32>::new(parts)),
        SampleType::Int64 => Box::new(VolumeSource::<i64>::new(parts)),
        SampleType::Uint64 => Box::new(VolumeSource::<u64>::new(parts)),
        SampleType::Float32 => Box::new(VolumeSource::<f32>::new(parts)),
        SampleType::Float64 => Box::new(VolumeSource::<f64>::new(parts)),
    })
}

/// What the header declares.
pub(super) fn declared(
    input: Input,
    format: Format,
    options: &ImportOptions,
) -> Result<(Encoding, VolumeInfo)> {
    let layout = layout(input, format, options)?;
    let encoding = match layout.order {
        ByteOrder::Little => Encoding::BinaryLittleEndian,
        ByteOrder::Big => Encoding::BinaryBigEndian,
    };
    let VolumeAxes { origin, steps } = layout.axes;
    let VolumeLayout { size, sample: sample_type, packing, .. } = layout;
    let sample_file = layout.file_path.display().to_string();
    Ok((encoding, VolumeInfo { size, sample_type, packing, origin, steps, sample_file }))
}

fn layout(mut input: Input, format: Format, options: &ImportOptions) -> Result<VolumeLayout> {
    let path = input.path().to_path_buf();
    let header = match format {
        Format::Nrrd => nrrd::parse(HeaderLines::new(&mut input)?)?,
        Format::MetaImage => metaimage::parse(HeaderLines::new(&mut input)?)?,
        _ => plain(&input, options)?,
    };
    VolumeLayout::check(header, &path)
}

/// The header of a file that has none, as the options say it.
fn plain(input: &Input, options: &ImportOptions) -> Result<VolumeHeader> {
    let (path, length) = (input.path(), input.length());
    let Some(RawVolume { size, sample, order, spacing }) = options.volumes.raw else {
        return Err(Error::new(Code::InputFormat, "a .raw file does not say what is in it")
            .at(path)
            .numbers(format!("{length} bytes of samples"))
            .next(NextStep::DescribeVolume));
    };
    let bytes = size.iter().try_fold(sample.bytes(), |bytes, &side| bytes.checked_mul(side));
    // A file that is longer has a header, or another size: its samples are not where they are looked for.
    if let Some(bytes) = bytes.filter(|&bytes| bytes < length) {
        return Err(Error::new(
            Code::InputFormat,
            "the file is longer than the volume that it is said to hold",
        )
        .at_byte(path, bytes)
        .numbers(format!("{} take {bytes} bytes, and the file has {length}", layout::shown(size, sample)))
        .next(NextStep::DescribeVolume));
    }
    Ok(VolumeHeader {
        size,
        sample,
        order,
        packing: SamplePacking::None,
        axes: VolumeAxes::straight(spacing),
        place: SamplePlace::Attached(0),
        skip: Skip::Count { lines: 0, bytes: 0 },
        warnings: Vec::new(),
    })
}

/// The values of the surfaces, each once, in the order in which they were given.
fn iso_values(layout: &VolumeLayout, options: &ImportOptions) -> Result<Vec<f64>> {
    let mut values: Vec<f64> = Vec::new();
    for &value in &options.volumes.iso_values {
        if !value.is_finite() {
            return Err(Error::new(Code::Usage, "the value of a surface is no finite number")
                .at(&layout.path)
                .numbers(format!("{value}"))
                .next(NextStep::NameIsoValue));
        }
        if !values.contains(&value) {
            // Not -0.
            values.push(value + 0.0);
        }
    }
    if values.is_empty() || values.len() > MAX_ISO_VALUES {
        let shown = layout::shown(layout.size.map(|side| side as u64), layout.sample);
        let what = match values.len() {
            0 => "a volume becomes triangles at the value of a surface, and none was named",
            _ => "too many surfaces of a volume are asked for",
        };
        return Err(Error::new(Code::Usage, what)
            .at(&layout.path)
            .numbers(format!("{} values, 1 to {MAX_ISO_VALUES} are possible; {shown}", values.len()))
            .next(NextStep::NameIsoValue));
    }
    Ok(values)
}

/// What the material of the surface at a value is called: a key that TOML takes without quotes, where it has no point.
fn material_name(value: f64) -> String {
    let is_plain = value == 0.0 || (1e-6..1e15).contains(&value.abs());
    if is_plain { format!("iso_{value}") } else { format!("iso_{value:e}") }
}
