//! How a memory limit is shared out for a picture, and the smallest limit that works.
//!
//! ```text
//! limit = reserve + tables + voxels + photons + film + frame loop + encoder + pins + staging (at most a tenth)
//!         + frames (the rest)
//! smallest: 4 staging slots, 32 frames a worker
//! ```

use super::stage::Play;
use crate::size;
use serde::Serialize;
use std::fmt;
use trex_render::emitter::{Emitter, Emitters};
use trex_render::film::{Layers, film_bytes};
use trex_render::filter::filter_bytes;
use trex_render::frame::frame_bytes;
use trex_render::indirect::mesh_photons_bytes;
use trex_render::integrator::Method;
use trex_render::live::Shown;
use trex_render::picture::encoder_bytes;
use trex_render::trace::PooledPages;
use trex_render::voxel::PhotonMap;
use trex_render::world::GRays;
use trex_store::layout::FRAME_BYTES;
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{Code, Error, PageFile, RESERVE_BYTES, Result};

/// Frames that a worker needs to work without waiting for each page: what a tile of pixels touches.
const FRAMES_PER_WORKER: u64 = 32;
/// Bytes that one staging slot reads at most.
const MERGE_BYTES: u32 = 128 << 10;
const STAGING_SLOTS: std::ops::RangeInclusive<u64> = 4..=40;

/// What each part of a render takes, bytes.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Shares {
    pub reserve_bytes: u64,
    /// Page table, top tree, materials, emitters.
    pub tables_bytes: u64,
    /// The upper octree and the light in it; 0 for integrators that ask no voxels.
    pub voxels_bytes: u64,
    /// Photons that are kept each by itself (`full-gi`), and those under way on the mesh.
    pub photons_bytes: u64,
    /// Film, frame loop, encoder, filter.
    pub film_bytes: u64,
    /// Staging buffers, the pool's tables, the workers' pins.
    pub staging_bytes: u64,
    /// Frames of pages.
    pub frames_bytes: u64,
    #[serde(skip)]
    staging_slots: u64,
}

/// A picture to be rendered.
#[derive(Clone, Copy)]
pub struct Picture {
    resolution: [u32; 2],
    layers: Layers,
    workers: usize,
    method: Method,
    /// How G-rays and photons work.
    g_rays: GRays,
    /// Voxels stand in for the mesh where it is far.
    has_far: bool,
    /// It is made in frames with a deadline.
    is_live: bool,
}

impl Picture {
    /// What `play` shows, by so many workers.
    pub fn of(play: &Play<'_>, workers: usize) -> Picture {
        let keys = &play.scene.render;
        Picture {
            resolution: keys.resolution,
            layers: play.layers,
            workers,
            method: keys.integrator,
            g_rays: keys.g_rays(),
            has_far: keys.lod_error > 0.0,
            is_live: play.live.is_some(),
        }
    }

    /// Direct light, no layers.
    fn plain(resolution: [u32; 2], workers: usize) -> Picture {
        let (layers, method, g_rays) = (Layers::default(), Method::Direct, GRays::default());
        Picture { resolution, layers, workers, method, g_rays, has_far: false, is_live: false }
    }

    /// Whether voxels are needed in memory.
    pub fn asks_voxels(&self) -> bool {
        self.method.asks_voxels() || self.has_far || self.is_live
    }
}

impl Shares {
    /// The shares of a limit for a picture in direct light without layers.
    pub fn of(file: &PageFile, resolution: [u32; 2], limit_bytes: u64, workers: usize) -> Result<Shares> {
        Shares::for_picture(file, &Picture::plain(resolution, workers), limit_bytes)
    }

    /// The shares of a limit.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] with the smallest limit that works.
    pub fn for_picture(file: &PageFile, picture: &Picture, limit_bytes: u64) -> Result<Shares> {
        let smallest = Shares::smallest(file, picture)?;
        let staging =
            (limit_bytes / 10 / u64::from(MERGE_BYTES)).clamp(*STAGING_SLOTS.start(), *STAGING_SLOTS.end());
        for slots in [staging, *STAGING_SLOTS.start()] {
            let fixed = Shares::fixed(file, picture, slots)?;
            let taken = fixed.sum();
            let least = FRAMES_PER_WORKER * picture.workers as u64 * FRAME_BYTES as u64;
            if taken + least <= limit_bytes {
                let all = (file.pages().len().max(2) * FRAME_BYTES) as u64;
                return Ok(Shares { frames_bytes: (limit_bytes - taken).min(all.max(least)), ..fixed });
            }
        }
        Err(Error::new(Code::MemoryLimit, "the memory limit has no room for this picture")
            .at(file.path())
            .numbers(format!("limit {}, {} needed", size::bytes(limit_bytes), size::bytes(smallest)))
            .next(format!(
                "--memory-limit {}MiB or more, a smaller --resolution, or fewer --threads",
                smallest.div_ceil(1 << 20)
            ))
            .smallest_limit(smallest))
    }

    /// The smallest limit for a picture without layers.
    pub fn smallest_limit_bytes(file: &PageFile, resolution: [u32; 2], workers: usize) -> Result<u64> {
        Shares::smallest(file, &Picture::plain(resolution, workers))
    }

    /// Options of the pool for these shares.
    pub fn pool_options(&self) -> PoolOptions {
        PoolOptions { frames_bytes: self.frames_bytes, ..pool_options(self.staging_slots) }
    }

    fn smallest(file: &PageFile, picture: &Picture) -> Result<u64> {
        let fixed = Shares::fixed(file, picture, *STAGING_SLOTS.start())?;
        Ok(fixed.sum() + FRAMES_PER_WORKER * picture.workers as u64 * FRAME_BYTES as u64)
    }

    fn fixed(file: &PageFile, picture: &Picture, staging_slots: u64) -> Result<Shares> {
        let (overhead, _) = PagePool::smallest_bytes(file, &pool_options(staging_slots))?;
        let pins = PooledPages::bytes(file.pages().len(), file.pages().len()) * picture.workers as u64;
        Ok(Shares {
            reserve_bytes: RESERVE_BYTES,
            tables_bytes: file.resident_table_bytes() + model_bytes(file),
            voxels_bytes: voxels_bytes(file, picture)?,
            photons_bytes: mesh_photons_bytes(picture.method, &picture.g_rays, picture.workers),
            film_bytes: film_bytes(picture.resolution, picture.layers)
                + if picture.is_live { Shown::bytes(picture.resolution) } else { 0 }
                + frame_bytes(picture.resolution, picture.workers)
                + encoder_bytes(picture.resolution, picture.layers)
                + if picture.layers.filter { filter_bytes(picture.resolution) } else { 0 },
            staging_bytes: overhead + pins,
            frames_bytes: 0,
            staging_slots,
        })
    }

    fn sum(&self) -> u64 {
        let Shares { reserve_bytes, tables_bytes, voxels_bytes, photons_bytes, .. } = *self;
        let Shares { film_bytes, staging_bytes, frames_bytes, .. } = *self;
        let light = voxels_bytes + photons_bytes;
        reserve_bytes + tables_bytes + light + film_bytes + staging_bytes + frames_bytes
    }
}

/// What the renderer's copies of materials and emitters take: those of the stage, of the session and of an edit; and what
/// lights are drawn from, twice while a state replaces the one before.
pub fn model_bytes(file: &PageFile) -> u64 {
    let (materials, emitters) = (file.materials().len(), file.emitters().len());
    let copies = 3 * (materials * size_of::<trex_store::Material>() + emitters * size_of::<Emitter>());
    copies as u64 + 2 * Emitters::bytes(emitters)
}

/// What the octree takes, with its light; or while it is read, with its stored form.
fn voxels_bytes(file: &PageFile, picture: &Picture) -> Result<u64> {
    if !picture.asks_voxels() {
        return Ok(0);
    }
    let Some(size) = file.upper_size()? else { return Ok(0) };
    let links = file.lower_size()?.map_or(0, |lower| lower.resident_bytes + lower.reading_bytes);
    // The map, the sums of a pass, and the map that comes when light changes.
    let maps = match picture.method {
        Method::Photon if picture.is_live => 3,
        Method::Photon => 2,
        _ => 0,
    };
    let light = maps * PhotonMap::bytes(size.facet_count as usize);
    Ok(size.resident_bytes + links + light.max(size.reading_bytes))
}

fn pool_options(staging_slots: u64) -> PoolOptions {
    PoolOptions { staging_slots: staging_slots as usize, merge_bytes: MERGE_BYTES, ..PoolOptions::default() }
}

impl fmt::Display for Shares {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "reserve {}, tables {}, voxels {}, photons {}, film {}, staging {}, frames {}",
            size::bytes(self.reserve_bytes),
            size::bytes(self.tables_bytes),
            size::bytes(self.voxels_bytes),
            size::bytes(self.photons_bytes),
            size::bytes(self.film_bytes),
            size::bytes(self.staging_bytes),
            size::bytes(self.frames_bytes)
        )
    }
}
