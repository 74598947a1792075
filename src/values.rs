//! Typed values of the command line: one parser per kind of value.
//!
//! Invariants: 1. a parsed value is in range, no later check is needed; 2. a refusal names what was given and
//! says what is accepted; 3. units are literal: `GB` is 10^9 bytes, `GiB` is 2^30, and a bare number has none.

mod portion;

pub use portion::{SampleRange, ShardNumber, TileShare, sample_range, shard_number, tile_share};
use std::ffi::OsString;
use std::path::PathBuf;
use trex_model::Device;
use trex_render::keys::RESOLUTION;
use trex_render::{FetchBlock, KeyValue, Section};
use trex_store::import::{ByteOrder, SampleType};
use trex_store::octree::Refinement;

/// Most triangles that one command may be asked for: four times what the format's ids are meant for.
pub const MAX_COUNT: u64 = 4_000_000_000;
/// Share of the machine's memory that `auto` stands for, percent.
pub const AUTO_PERCENT: u8 = 50;

/// A number of bytes with its unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bytes(pub u64);

/// `--memory-limit`: an amount, a share of the machine, or `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MemoryLimit {
    /// So many bytes.
    Bytes(u64),
    /// So many percent (1 to 100) of what the machine grants this process.
    Percent(u8),
}

impl MemoryLimit {
    /// What `auto` means.
    pub const AUTO: MemoryLimit = MemoryLimit::Percent(AUTO_PERCENT);

    /// The limit in bytes on a machine that grants `ceiling_bytes` to this process.
    pub fn resolve(self, ceiling_bytes: u64) -> u64 {
        match self {
            MemoryLimit::Bytes(bytes) => bytes,
            MemoryLimit::Percent(percent) => (u128::from(ceiling_bytes) * u128::from(percent) / 100) as u64,
        }
    }
}

/// `--gpu-memory-limit`: bytes, or `None` for `auto`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GpuMemoryLimit(pub Option<u64>);

/// A picture's size in pixels, in the range of [`RESOLUTION`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Resolution {
    /// Pixels per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// A point or a direction in model space; every part is finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vec3(pub [f64; 3]);

/// A plane that cuts the model: a point on it and a normal, not zero; all six are finite.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SectionPlane(pub [f64; 6]);

/// A box in model space, not empty along any axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ModelBox {
    /// Least corner.
    pub lo: [f64; 3],
    /// Greatest corner.
    pub hi: [f64; 3],
}

/// A time that is finite and above zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seconds(pub f64);

/// A time, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Milliseconds(pub f64);

/// `--voxels`: leaves of the resident octree along the longest side, and how much finer the finest ones are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Voxels {
    /// 64, 256, 512 or 1024.
    pub upper: u32,
    /// By 1, 4 or 16.
    pub refinement: Refinement,
}

/// `--size`: samples of a volume along each axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct VolumeSize(pub [u64; 3]);

/// `--type`: the samples of a file without a header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SampleFormat {
    /// Their type.
    pub sample: SampleType,
    /// Of their bytes.
    pub order: ByteOrder,
}

/// What `build` reads: a file, or a generator's name.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// A mesh file.
    File(PathBuf),
    /// `gen:KIND:COUNT[:SEED][:colors=low|high]`, as written; the generator's own parser reads it.
    Generated(String),
}

impl From<OsString> for Input {
    fn from(text: OsString) -> Input {
        match text.to_str() {
            Some(name) if name.starts_with("gen:") => Input::Generated(name.to_owned()),
            _ => Input::File(text.into()),
        }
    }
}

/// Bytes per unit; longer names first, since `B` ends all of them.
const UNITS: [(&str, u64); 9] = [
    ("TIB", 1 << 40),
    ("GIB", 1 << 30),
    ("MIB", 1 << 20),
    ("KIB", 1 << 10),
    ("TB", 1_000_000_000_000),
    ("GB", 1_000_000_000),
    ("MB", 1_000_000),
    ("KB", 1_000),
    ("B", 1),
];

/// Parses `50MB`, `1GiB/s`: bytes in a second.
pub fn rate(text: &str) -> Result<Bytes, String> {
    bytes(text.trim().strip_suffix("/s").unwrap_or(text))
}

/// Parses `512MiB`, `1.5GiB`, `2GB`, `4096B`; case does not matter.
pub fn bytes(text: &str) -> Result<Bytes, String> {
    let refused = |why: &str| Err(format!("{why}; accepted are amounts like 512MiB, 1.5GiB, 2GB or 65536B"));
    let upper = text.trim().to_ascii_uppercase();
    let Some((number, unit)) = UNITS.iter().find_map(|(name, unit)| Some((upper.strip_suffix(name)?, *unit)))
    else {
        return refused(UNKNOWN_UNIT);
    };
    let Some(number) = plain_number(number) else {
        let is_unit = number.ends_with(|last: char| last.is_alphabetic());
        return refused(if is_unit { UNKNOWN_UNIT } else { "the amount is not a number" });
    };
    let value = number * unit as f64;
    if value < 1.0 {
        return refused("the amount is less than one byte");
    }
    // 2^63: far above any memory or disk, and exactly representable.
    if value > (1u64 << 63) as f64 {
        return refused("the amount is beyond any machine");
    }
    Ok(Bytes(value as u64))
}

/// Most tiles of a fetch block: those of a picture of 8192x8192.
const FETCH_BLOCK_MAX: u32 = 1 << 20;
const UNKNOWN_UNIT: &str = "the unit is missing or unknown (M and G are ambiguous)";

/// Parses `--memory-limit`: an amount of [`bytes`], `50%`, or `auto`.
pub fn memory_limit(text: &str) -> Result<MemoryLimit, String> {
    if text == "auto" {
        return Ok(MemoryLimit::AUTO);
    }
    if let Some(percent) = text.strip_suffix('%') {
        return match percent.trim().parse::<u8>() {
            Ok(percent @ 1..=100) => Ok(MemoryLimit::Percent(percent)),
            _ => Err("a share is a whole number from 1% to 100%".to_owned()),
        };
    }
    bytes(text).map(|b| MemoryLimit::Bytes(b.0)).map_err(|why| format!("{why}, shares like 50%, and auto"))
}

/// Parses a whole number of things: `250000`, `250_000`, `250k`, `5M`, `1.5M`, `1G`; without a unit it is exact.
pub fn whole(text: &str) -> Result<u64, String> {
    let refused = || "not a count; accepted are counts like 250000, 250k, 5M or 1G".to_owned();
    let compact = text.trim().replace('_', "");
    if compact.bytes().all(|byte| byte.is_ascii_digit()) {
        return compact.parse().map_err(|_| refused());
    }
    let (number, unit) = match compact.char_indices().last() {
        Some((at, 'k' | 'K')) => (&compact[..at], 1e3),
        Some((at, 'm' | 'M')) => (&compact[..at], 1e6),
        Some((at, 'g' | 'G')) => (&compact[..at], 1e9),
        _ => return Err(refused()),
    };
    let value = (plain_number(number).ok_or_else(refused)? * unit).round();
    if value < u64::MAX as f64 { Ok(value as u64) } else { Err(refused()) }
}

/// Parses a count of triangles.
pub fn count(text: &str) -> Result<u64, String> {
    whole(text).and_then(|count| match count {
        1..=MAX_COUNT => Ok(count),
        _ => Err(format!("the count must lie between 1 and {MAX_COUNT}")),
    })
}

/// Parses `1024x768`.
pub fn resolution(text: &str) -> Result<Resolution, String> {
    let parsed = text.split_once(['x', 'X']).and_then(|(width, height)| {
        let (width, height) = (width.parse().ok()?, height.parse().ok()?);
        RESOLUTION.check(KeyValue::Pair([width, height])).is_ok().then_some(Resolution { width, height })
    });
    parsed.ok_or_else(|| format!("accepted is WIDTHxHEIGHT in pixels, {}, like 1024x768", RESOLUTION.range()))
}

/// Parses `--device`: `cpu`, `auto`, `gpu`, or a part of a GPU's name.
pub fn device(text: &str) -> Result<Device, String> {
    match text.trim() {
        "" => Err("accepted are cpu, auto, gpu, and a part of a GPU's name".to_owned()),
        "cpu" => Ok(Device::Cpu),
        "auto" => Ok(Device::Auto),
        "gpu" => Ok(Device::Gpu),
        name => Ok(Device::Named(name.to_owned())),
    }
}

/// Parses `--gpu-memory-limit`: an amount, or `auto`, which is `None`.
pub fn gpu_memory_limit(text: &str) -> Result<GpuMemoryLimit, String> {
    match text.trim() {
        "auto" => Ok(GpuMemoryLimit(None)),
        text => at_least(text, 1 << 20, "1MiB").map(|bytes| GpuMemoryLimit(Some(bytes.0))),
    }
}

/// Parses what the resident octree may take: the coarsest one of a surface takes some hundred KiB.
pub fn upper_budget(text: &str) -> Result<Bytes, String> {
    at_least(text, 1 << 20, "1MiB")
}

/// Parses a limit that pictures will be made under: a process takes some 24 MiB by itself.
pub fn render_limit(text: &str) -> Result<Bytes, String> {
    at_least(text, 32 << 20, "32MiB")
}

fn at_least(text: &str, least: u64, name: &str) -> Result<Bytes, String> {
    bytes(text).and_then(|value| {
        if value.0 < least { Err(format!("accepted are {name} and more")) } else { Ok(value) }
    })
}

/// Parses `512` or `512/2048`.
pub fn voxels(text: &str) -> Result<Voxels, String> {
    let (upper, finest) = text.split_once('/').unwrap_or((text, text));
    let number = |text: &str| text.parse::<u32>().ok();
    let parsed = || {
        let upper = number(upper).filter(|upper| [64, 256, 512, 1024].contains(upper))?;
        let finest = number(finest).filter(|finest| finest.is_multiple_of(upper))?;
        Some(Voxels { upper, refinement: Refinement::from_factor(finest / upper)? })
    };
    parsed().ok_or_else(|| {
        "accepted is RU or RU/RFINEST, RU one of 64, 256, 512, 1024 and RFINEST 1, 4 or 16 times that, like 512/2048"
            .into()
    })
}

/// Parses `x,y,z`, for example `1.5,-2,0.25`.
pub fn vec3(text: &str) -> Result<Vec3, String> {
    let parts: Option<Vec<f64>> = text.split(',').map(|part| finite(part.trim())).collect();
    parts.and_then(|parts| <[f64; 3]>::try_from(parts).ok()).map(Vec3).ok_or_else(|| {
        "accepted are three finite numbers x,y,z with no space between, like 1.5,-2,0.25".into()
    })
}

/// Parses a point and a normal: `0,0,0,0,0,-1`.
pub fn section(text: &str) -> Result<SectionPlane, String> {
    let parts: Option<Vec<f64>> = text.split(',').map(|part| finite(part.trim())).collect();
    let plane = parts.and_then(|parts| <[f64; 6]>::try_from(parts).ok());
    let is_plane = |[px, py, pz, nx, ny, nz]: [f64; 6]| Section::new([px, py, pz], [nx, ny, nz]).is_some();
    plane.filter(|plane| is_plane(*plane)).map(SectionPlane).ok_or_else(|| {
        "accepted are six finite numbers px,py,pz,nx,ny,nz: a point on the plane, and a normal that is not 0,0,0".into()
    })
}

/// Parses `512x512x300`.
pub fn volume_size(text: &str) -> Result<VolumeSize, String> {
    let sides: Option<Vec<u64>> = text.split(['x', 'X']).map(|side| side.trim().parse().ok()).collect();
    let sides = sides.and_then(|sides| <[u64; 3]>::try_from(sides).ok()).filter(|sides| !sides.contains(&0));
    sides.map(VolumeSize).ok_or_else(|| "accepted are samples along three axes, like 512x512x300".into())
}

/// Parses `uint16`, `float32be`.
pub fn sample_format(text: &str) -> Result<SampleFormat, String> {
    let (name, order) = match text.trim().strip_suffix("be") {
        Some(name) => (name, ByteOrder::Big),
        None => (text.trim(), ByteOrder::Little),
    };
    let sample = SampleType::from_name(name);
    sample.map(|sample| SampleFormat { sample, order }).ok_or_else(|| {
        "accepted are int8, uint8, int16, uint16, int32, uint32, int64, uint64, float32 and float64, with `be` behind \
         it for the most significant byte first"
            .into()
    })
}

/// Parses `x,y,z`, each above 0.
pub fn spacing(text: &str) -> Result<Vec3, String> {
    let spacing = vec3(text)?;
    if spacing.0.iter().all(|&part| part > 0.0) { Ok(spacing) } else { Err("a spacing is above 0".into()) }
}

/// Parses `x,y,z`, not all of them 0.
pub fn direction(text: &str) -> Result<Vec3, String> {
    let direction = vec3(text)?;
    if direction.0 == [0.0; 3] { Err("a direction has a part that is not 0".into()) } else { Ok(direction) }
}

/// Parses `x0,y0,z0,x1,y1,z1`: the least and the greatest corner of a box.
pub fn model_box(text: &str) -> Result<ModelBox, String> {
    let parts: Option<Vec<f64>> = text.split(',').map(|part| finite(part.trim())).collect();
    let corners = parts.and_then(|parts| <[f64; 6]>::try_from(parts).ok());
    let bounds = corners.map(|[x0, y0, z0, x1, y1, z1]| ModelBox { lo: [x0, y0, z0], hi: [x1, y1, z1] });
    bounds.filter(|bounds| (0..3).all(|axis| bounds.lo[axis] < bounds.hi[axis])).ok_or_else(|| {
        "accepted are six finite numbers x0,y0,z0,x1,y1,z1, the least corner and then the greatest".into()
    })
}

/// Parses a time: `90s`, `1500ms`, `2min`, or a bare number of seconds.
pub fn seconds(text: &str) -> Result<Seconds, String> {
    let text = text.trim();
    let (number, unit) = [("ms", 1e-3), ("min", 60.0), ("s", 1.0)]
        .iter()
        .find_map(|(name, unit)| Some((text.strip_suffix(name)?, *unit)))
        .unwrap_or((text, 1.0));
    finite(number.trim())
        .map(|number| number * unit)
        .filter(|seconds| *seconds > 0.0)
        .map(Seconds)
        .ok_or_else(|| "accepted is a time above zero: 1500ms, 90s, 2min, or seconds as a bare number".into())
}

/// Parses a time in milliseconds: `33`, `33ms`.
pub fn milliseconds(text: &str) -> Result<Milliseconds, String> {
    let number = text.trim().strip_suffix("ms").unwrap_or(text.trim());
    finite(number.trim())
        .filter(|ms| (0.1..=3_600_000.0).contains(ms))
        .map(Milliseconds)
        .ok_or_else(|| "accepted are milliseconds from 0.1 to 3600000, like 33 or 33ms".into())
}

/// Parses the tiles of a fetch block, or `adaptive`.
pub fn fetch_block(text: &str) -> Result<FetchBlock, String> {
    match text.trim() {
        "adaptive" => Ok(FetchBlock::Adaptive),
        number => number
            .parse()
            .ok()
            .filter(|tiles| (1..=FETCH_BLOCK_MAX).contains(tiles))
            .map(FetchBlock::Tiles)
            .ok_or_else(|| format!("accepted are 1 to {FETCH_BLOCK_MAX} tiles, or adaptive")),
    }
}

/// Parses a finite number above zero (a length).
pub fn positive(text: &str) -> Result<f64, String> {
    finite(text).filter(|x| *x > 0.0).ok_or_else(|| "accepted is a finite number above zero".into())
}

/// Parses a finite number.
pub fn number(text: &str) -> Result<f64, String> {
    finite(text).ok_or_else(|| "accepted is a finite number".into())
}

/// Parses a field of view, degrees.
pub fn degrees(text: &str) -> Result<f64, String> {
    finite(text)
        .filter(|x| (0.001..=179.0).contains(x))
        .ok_or_else(|| "accepted is an angle from 0.001 to 179 degrees".into())
}

/// A finite float.
fn finite(text: &str) -> Option<f64> {
    text.parse::<f64>().ok().filter(|x| x.is_finite())
}

/// A decimal without sign or exponent: what people write before a unit.
fn plain_number(text: &str) -> Option<f64> {
    let text = text.trim();
    let plain = !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit() || b == b'.');
    if plain { finite(text) } else { None }
}

#[cfg(test)]
mod tests;
