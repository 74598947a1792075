//! `MemoryPlan`: how a memory limit is shared out for a picture, and the smallest limit that works.
//!
//! ```text
//! limit = reserve + tables + voxels + photons + film + passes + encoder + pins + staging (at most a tenth)
//!         + frames (the rest)
//! smallest: 4 staging slots, 32 frames a worker
//! ```

use crate::g_stage::CpuStage;
use crate::image::display::Display;
use crate::image::encode::encoder_bytes;
use crate::image::film::{Layers, film_bytes};
use crate::image::filter::filter_bytes;
use crate::integrate::rays_asked;
use crate::photon::irradiance::PhotonMap;
use crate::photon::kd_tree::PhotonTree;
use crate::photon::mesh::flight_bytes;
use crate::scene::settings::{Method, RenderSettings};
use crate::schedule::pass_bytes;
use crate::shading::light::{Emitter, Emitters};
use crate::trace::PooledPages;
use serde::Serialize;
use trex_store::layout::FRAME_BYTES;
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{Code, Error, PageFile, RESERVE_BYTES, Result};

/// Frames that a worker needs to work without waiting for each page: what a tile of pixels touches.
const FRAMES_PER_WORKER: u64 = 32;
/// Bytes that one staging slot reads at most.
const MERGE_BYTES: u32 = 128 << 10;
/// Staging slots: fewer delay reads, more gain nothing.
const STAGING_SLOTS: std::ops::RangeInclusive<u64> = 4..=40;

/// The properties of a picture that decide what memory it takes.
#[derive(Clone, Copy, Debug)]
pub struct PictureNeeds {
    /// The numbers of the picture.
    pub settings: RenderSettings,
    /// Layers that the film keeps beside radiance.
    pub layers: Layers,
    /// Worker threads, at least 1.
    pub workers: usize,
    /// True when the picture is made in frames with a deadline.
    pub is_live: bool,
    /// Bytes that the caller leases beside the session, for copies of pictures.
    pub copies_bytes: u64,
}

/// The shares of a memory limit for a picture, bytes.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct MemoryPlan {
    /// Outside of the ledger: text, stacks, the allocator.
    pub reserve_bytes: u64,
    /// Page table, top tree, materials, emitters.
    pub tables_bytes: u64,
    /// The upper octree and the light in it; 0 for integrators that ask no voxels.
    pub voxels_bytes: u64,
    /// Photons that are kept each by itself (`full-gi`), and those under way on the mesh.
    pub photons_bytes: u64,
    /// Film, copies of pictures, passes over tiles, encoder, filter.
    pub film_bytes: u64,
    /// Staging buffers, the pool's tables, the workers' pins.
    pub staging_bytes: u64,
    /// Frames of pages.
    pub frames_bytes: u64,
    #[serde(skip)]
    staging_slots: u64,
}

impl PictureNeeds {
    /// A picture in direct light without layers, made by so many workers.
    pub fn plain(workers: usize) -> PictureNeeds {
        PictureNeeds {
            settings: RenderSettings::default(),
            layers: Layers::default(),
            workers,
            is_live: false,
            copies_bytes: 0,
        }
    }

    /// True when voxels are needed in memory.
    pub fn asks_voxels(&self) -> bool {
        self.settings.integrator.asks_voxels() || self.settings.lod_error > 0.0 || self.is_live
    }
}

impl MemoryPlan {
    /// The shares of a limit for a picture of `file`.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] with the smallest limit that works.
    pub fn new(file: &PageFile, needs: &PictureNeeds, limit_bytes: u64) -> Result<MemoryPlan> {
        let smallest = MemoryPlan::smallest_limit_bytes(file, needs)?;
        let staging =
            (limit_bytes / 10 / u64::from(MERGE_BYTES)).clamp(*STAGING_SLOTS.start(), *STAGING_SLOTS.end());
        for slots in [staging, *STAGING_SLOTS.start()] {
            let fixed = MemoryPlan::fixed(file, needs, slots)?;
            let taken = fixed.sum();
            let least = FRAMES_PER_WORKER * needs.workers as u64 * FRAME_BYTES as u64;
            if taken + least <= limit_bytes {
                let all = (file.pages().len().max(2) * FRAME_BYTES) as u64;
                return Ok(MemoryPlan { frames_bytes: (limit_bytes - taken).min(all.max(least)), ..fixed });
            }
        }
        let mib = |bytes: u64| format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20));
        Err(Error::new(Code::MemoryLimit, "the memory limit has no room for this picture")
            .at(file.path())
            .numbers(format!("limit {}, {} needed", mib(limit_bytes), mib(smallest)))
            .next(format!(
                "--memory-limit {}MiB or more, a smaller --resolution, or fewer --threads",
                smallest.div_ceil(1 << 20)
            ))
            .smallest_limit(smallest))
    }

    /// The smallest limit for a picture of `file`, bytes.
    ///
    /// # Errors
    /// Those of reading the sizes of the file's octree.
    pub fn smallest_limit_bytes(file: &PageFile, needs: &PictureNeeds) -> Result<u64> {
        let fixed = MemoryPlan::fixed(file, needs, *STAGING_SLOTS.start())?;
        Ok(fixed.sum() + FRAMES_PER_WORKER * needs.workers as u64 * FRAME_BYTES as u64)
    }

    /// Options of the pool for these shares.
    pub fn pool_options(&self) -> PoolOptions {
        PoolOptions { frames_bytes: self.frames_bytes, ..pool_options(self.staging_slots) }
    }

    /// The shares of all but the frames.
    fn fixed(file: &PageFile, needs: &PictureNeeds, staging_slots: u64) -> Result<MemoryPlan> {
        let PictureNeeds { settings, layers, workers, is_live, copies_bytes } = *needs;
        let resolution = settings.resolution;
        let (overhead, _) = PagePool::smallest_bytes(file, &pool_options(staging_slots))?;
        let pins = PooledPages::bytes(file.pages().len(), file.pages().len()) * workers as u64;
        Ok(MemoryPlan {
            reserve_bytes: RESERVE_BYTES,
            tables_bytes: file.resident_table_bytes() + model_bytes(file),
            voxels_bytes: voxels_bytes(file, needs)?,
            photons_bytes: photons_bytes(needs),
            film_bytes: film_bytes(resolution, layers)
                + copies_bytes
                + if is_live { Display::bytes(resolution) } else { 0 }
                + pass_bytes(resolution, workers, rays_asked(&settings), &CpuStage::NEEDS)
                + encoder_bytes(resolution, layers)
                + if layers.filter { filter_bytes(resolution) } else { 0 },
            staging_bytes: overhead + pins,
            frames_bytes: 0,
            staging_slots,
        })
    }

    fn sum(&self) -> u64 {
        let MemoryPlan { reserve_bytes, tables_bytes, voxels_bytes, photons_bytes, .. } = *self;
        let MemoryPlan { film_bytes, staging_bytes, frames_bytes, .. } = *self;
        let light = voxels_bytes + photons_bytes;
        reserve_bytes + tables_bytes + light + film_bytes + staging_bytes + frames_bytes
    }
}

/// Bytes of the renderer's copies of materials and emitters of `file`: those of the caller, of the session and of an
/// edit; and what lights are drawn from, twice while a state replaces the one before.
pub fn model_bytes(file: &PageFile) -> u64 {
    let (materials, emitters) = (file.materials().len(), file.emitters().len());
    let copies = 3 * (materials * size_of::<trex_store::Material>() + emitters * size_of::<Emitter>());
    copies as u64 + 2 * Emitters::bytes(emitters)
}

/// Bytes that photons on the mesh take at most, with those under way.
fn photons_bytes(needs: &PictureNeeds) -> u64 {
    match needs.settings.integrator {
        Method::FullGi => {
            // In frames the light on show stays until what comes after it is there.
            let trees = if needs.is_live { 2 } else { 1 };
            trees * (PhotonTree::bytes(needs.settings.photons) + flight_bytes(needs.workers))
        }
        Method::Photon if needs.settings.bake => flight_bytes(needs.workers),
        _ => 0,
    }
}

/// Bytes that the octree takes, with its light; or while it is read, with its stored form.
fn voxels_bytes(file: &PageFile, needs: &PictureNeeds) -> Result<u64> {
    if !needs.asks_voxels() {
        return Ok(0);
    }
    let Some(size) = file.upper_size()? else { return Ok(0) };
    let links = file.lower_size()?.map_or(0, |lower| lower.resident_bytes + lower.reading_bytes);
    // The map, the sums of a pass, and the map that comes when light changes.
    let maps = match needs.settings.integrator {
        Method::Photon if needs.is_live => 3,
        Method::Photon => 2,
        _ => 0,
    };
    let light = maps * PhotonMap::bytes(size.facet_count as usize);
    Ok(size.resident_bytes + links + light.max(size.reading_bytes))
}

fn pool_options(staging_slots: u64) -> PoolOptions {
    PoolOptions { staging_slots: staging_slots as usize, merge_bytes: MERGE_BYTES, ..PoolOptions::default() }
}
