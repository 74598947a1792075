//! `RenderReport`: what a render tells, as text and as JSON.

use super::damage::Damage;
use super::render_part::PartReport;
use super::show::Frames;
use crate::memory::Memory;
use crate::size;
use serde::Serialize;
use std::fmt;
use std::time::Duration;
use trex_model::{GpuFigures, RayRates};
use trex_render::{GStats, MemoryPlan, PhotonStats, RayCounts};
use trex_store::io::IoDescription;
use trex_store::pool::PoolStats;
use trex_store::printable::one_line;

/// The result of a render.
#[derive(Debug, Serialize)]
pub struct RenderReport {
    pub scene: String,
    pub output: String,
    /// Each picture, of a camera path one for each viewpoint.
    pub pictures: Vec<Picture>,
    /// The part of the picture that it is, where it is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub part: Option<PartReport>,
    pub integrator: &'static str,
    /// The lamps, and the factor of the PNG, as they were decided.
    pub light: &'static str,
    pub exposure: f32,
    pub spp: u32,
    pub rays: RayCounts,
    pub rays_per_s: RayRates,
    pub g_stage: GStats,
    pub photons: PhotonStats,
    pub photons_ms: u64,
    /// Look-ups of the photons nearest to a place; of `full-gi`.
    pub look_ups: u64,
    pub look_ups_per_s: f64,
    pub time_ms: u64,
    pub first_picture_ms: Option<u64>,
    /// Of frames with a deadline.
    #[serde(flatten)]
    pub frames: Option<Frames>,
    pub complete_ms: Option<u64>,
    pub exact: bool,
    pub lod_error_px: f64,
    pub damaged_pages: Vec<u32>,
    /// The first of them, with what was drawn in their place.
    pub damage: Damage,
    pub image: Image,
    pub waits: u64,
    pub narrow_samples: u64,
    /// Materials that are open where a section cuts them, so that nothing fills them; and rays that met such.
    pub open_materials: Vec<String>,
    pub open_rays: u64,
    pub pool: PoolStats,
    pub shares: MemoryPlan,
    pub memory: Memory,
    pub io_backend: IoDescription,
    /// What answered G-rays, and why; why the processor did in its place, if it did.
    pub device: String,
    pub device_reason: String,
    pub device_notice: Option<String>,
    pub gpu: Option<GpuFigures>,
    pub arithmetic: &'static str,
}

/// A picture that was written.
#[derive(Debug, Serialize)]
pub struct Picture {
    pub output: String,
    pub spp: u32,
    pub time_ms: u64,
}

#[derive(Debug, Serialize)]
pub struct Image {
    pub mean: [f64; 3],
    pub width: u32,
    pub height: u32,
}

impl fmt::Display for RenderReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (rays, pool) = (&self.rays, &self.pool);
        let total = rays.total();
        let output = match self.pictures.as_slice() {
            [first, .., last] => format!("{} to {}", first.output, last.output),
            _ => self.output.clone(),
        };
        writeln!(
            f,
            "{}: {}x{}, {} samples a pixel, {}",
            one_line(&output),
            self.image.width,
            self.image.height,
            self.spp,
            size::duration(Duration::from_millis(self.time_ms))
        )?;
        if let Some(PartReport { tiles: [first, end], tile_count, samples: [from, to], spp }) = self.part {
            writeln!(f, "a part: tiles {first}..{end} of {tile_count}, samples {from}..{to} of {spp}")?;
        }
        writeln!(
            f,
            "{} ({} primary, {} mirror, {} shadow, {} gather, {} photon), {}",
            size::count(total),
            size::count(rays.primary),
            size::count(rays.mirror),
            size::count(rays.shadow),
            size::count(rays.gather),
            size::count(rays.photon),
            size::rate(total as f64 * 1e3 / self.time_ms.max(1) as f64, "rays")
        )?;
        if self.look_ups > 0 {
            writeln!(
                f,
                "{} photons stored, {} look-ups of the nearest, {}",
                size::count(self.photons.deposits),
                size::count(self.look_ups),
                size::rate(self.look_ups_per_s, "look-ups")
            )?;
        }
        if !self.damaged_pages.is_empty() {
            writeln!(
                f,
                "not whole: {} damaged pages, left out; see `trex verify`",
                self.damaged_pages.len()
            )?;
        }
        write!(
            f,
            "pages: {} read ({}), {} evicted, {} read again; memory limit {}, peak {}",
            size::count(pool.pages_read),
            size::bytes(pool.bytes_read),
            size::count(pool.evictions),
            size::count(pool.refaults),
            size::bytes(self.memory.limit_bytes),
            self.memory.peak_rss_bytes.map_or_else(|| "unknown".into(), size::bytes)
        )
    }
}
