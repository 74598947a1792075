//! `MemoryPlan`: how a memory limit is shared out for a picture, and the smallest limit that works.
//!
//! ```text
//! limit = reserve + tables + voxels + photons + film + passes + encoder + pins + reads (at most a tenth)
//!         + frames (the rest)
//! smallest: the least room of reads, 32 frames a worker
//! ```

use super::shares::{SessionFacts, SessionShares};
use crate::g_stage::{CpuStage, GNeeds};
use crate::scene::settings::{RenderKeys, RenderSettings};
use crate::trace::{PartNeeds, PooledPages};
use serde::Serialize;
use trex_film::{Display, Layers, Portion, encoder_bytes, filter_bytes};
use trex_store::io::IoOptions;
use trex_store::layout::FRAME_BYTES;
use trex_store::octree::UpperSize;
use trex_store::pool::{PagePool, PoolOptions, ReadRoom};
use trex_store::{Code, Error, FileSizes, NextStep, PageFile, RESERVE_BYTES, Result};

/// Frames that a worker needs to work without waiting for each page: what a tile of pixels touches.
const FRAMES_PER_WORKER: u64 = 32;
/// Part of the room of frames that the picture before takes at most: one over this.
const HISTORY_PART: u64 = 16;

/// The properties of a picture that decide what memory it takes.
#[derive(Clone, Copy, Debug)]
pub struct PictureNeeds {
    /// The numbers of the picture.
    pub settings: RenderSettings,
    /// Layers that the film keeps beside radiance.
    pub layers: Layers,
    /// The part of the picture that is made; `None` for all of it.
    pub portion: Option<Portion>,
    /// Worker threads, at least 1.
    pub workers: usize,
    /// What the G-stage asks that answers its rays ([`crate::GStage::needs`]): of the processor, [`CpuStage::NEEDS`].
    pub g_needs: GNeeds,
    /// True when the picture is made in frames with a deadline.
    pub is_live: bool,
    /// Bytes that the caller leases beside the session, for copies of pictures.
    pub copies_bytes: u64,
    /// What is left out of the model.
    pub parts: PartNeeds,
}

/// The shares of a memory limit for a picture, bytes.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct MemoryPlan {
    /// Outside of the ledger: text, stacks, the allocator.
    pub reserve_bytes: u64,
    /// Page table, top tree, materials, emitters.
    pub tables_bytes: u64,
    /// The upper octree, one without hidden materials, and the light in it; 0 for integrators that ask no voxels.
    pub voxels_bytes: u64,
    /// Photons that are kept each by itself (`full-gi`), and those under way on the mesh.
    pub photons_bytes: u64,
    /// Film, copies of pictures, passes over tiles, encoder, filter.
    pub film_bytes: u64,
    /// Staging buffers and their connections, the pool's tables, the workers' pins and caps of sections.
    pub staging_bytes: u64,
    /// Frames of pages.
    pub frames_bytes: u64,
    /// Of the film's: the light of before that is kept, [`crate::FrameOptions::kept_light_bytes`].
    #[serde(skip)]
    pub kept_light_bytes: u64,
    #[serde(skip)]
    read_room: ReadRoom,
}

impl PictureNeeds {
    /// Bytes of the light before that is kept, of `room` that frames take otherwise: none where these would feel it.
    fn history_bytes(&self, room: u64) -> u64 {
        let resolution = self.settings.resolution;
        let within = |room: u64, bytes: u64| if HISTORY_PART * bytes <= room { bytes } else { 0 };
        let picture = within(room, Display::history_bytes(resolution));
        let world = within(room - picture, Display::cache_bytes(resolution));
        if self.is_live { picture + world } else { 0 }
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
    /// [`Code::MemoryLimit`] with the smallest limit that works; those of reading the sizes of the file's octree.
    pub fn new(file: &PageFile, needs: &PictureNeeds, limit_bytes: u64) -> Result<MemoryPlan> {
        MemoryPlan::for_sizes(&file.sizes(), needs, limit_bytes)
    }

    /// The shares of a limit for a picture of a file of these sizes, which need not be open.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] with the smallest limit that works.
    pub fn for_sizes(file: &FileSizes, needs: &PictureNeeds, limit_bytes: u64) -> Result<MemoryPlan> {
        let smallest = MemoryPlan::smallest_for_sizes(file, needs)?;
        for read_room in [ReadRoom::within(limit_bytes, file.is_far), ReadRoom::LEAST] {
            let fixed = MemoryPlan::fixed(file, needs, read_room)?;
            let taken = fixed.sum();
            let least = FRAMES_PER_WORKER * needs.workers as u64 * FRAME_BYTES as u64;
            if taken + least <= limit_bytes && smallest <= limit_bytes {
                let all = (file.page_count.max(2) as usize * FRAME_BYTES) as u64;
                let history = needs.history_bytes(limit_bytes - taken);
                let film_bytes = fixed.film_bytes + history;
                let frames_bytes = (limit_bytes - taken - history).min(all.max(least));
                return Ok(MemoryPlan { film_bytes, frames_bytes, kept_light_bytes: history, ..fixed });
            }
        }
        let mib = |bytes: u64| format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20));
        Err(Error::new(Code::MemoryLimit, "the memory limit has no room for this picture")
            .at(&file.path)
            .numbers(format!("limit {}, {} needed", mib(limit_bytes), mib(smallest)))
            .next(NextStep::RaiseLimitOrAskForLess { bytes: smallest })
            .smallest_limit(smallest))
    }

    /// The shares of a limit for rays of a caller on the mesh of `file`, by so many workers, beside `beside_bytes` that
    /// are leased for other things.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] with the smallest limit that works.
    pub fn of_rays(
        file: &PageFile,
        workers: usize,
        limit_bytes: u64,
        beside_bytes: u64,
    ) -> Result<MemoryPlan> {
        let settings = RenderSettings::new(RenderKeys { resolution: [1, 1], ..RenderKeys::default() })?;
        let rays = PictureNeeds {
            settings,
            layers: Layers::default(),
            portion: None,
            workers,
            g_needs: CpuStage::NEEDS,
            is_live: false,
            copies_bytes: beside_bytes,
            parts: PartNeeds::default(),
        };
        MemoryPlan::new(file, &rays, limit_bytes)
    }

    /// The smallest limit for a picture of `file`, bytes.
    ///
    /// # Errors
    /// Those of reading the sizes of the file's octree.
    pub fn smallest_limit_bytes(file: &PageFile, needs: &PictureNeeds) -> Result<u64> {
        MemoryPlan::smallest_for_sizes(&file.sizes(), needs)
    }

    /// With what it takes to open the file, where that is more.
    fn smallest_for_sizes(file: &FileSizes, needs: &PictureNeeds) -> Result<u64> {
        let fixed = MemoryPlan::fixed(file, needs, ReadRoom::LEAST)?;
        let least = fixed.sum() + FRAMES_PER_WORKER * needs.workers as u64 * FRAME_BYTES as u64;
        Ok(least.max(RESERVE_BYTES + file.opening_bytes))
    }

    /// Options of the pool for these shares, which reads as `io` says.
    pub fn pool_options(&self, io: &IoOptions) -> PoolOptions {
        PoolOptions { frames_bytes: self.frames_bytes, ..self.read_room.pool_options(io) }
    }

    /// The shares of all but the frames.
    fn fixed(file: &FileSizes, needs: &PictureNeeds, read_room: ReadRoom) -> Result<MemoryPlan> {
        let PictureNeeds { settings, layers, portion, workers, g_needs, is_live, copies_bytes, parts } =
            *needs;
        let overhead =
            PagePool::overhead_bytes(file.page_count, &read_room.pool_options(&IoOptions::default()))?;
        let page_count = file.page_count as usize;
        let pins = PooledPages::bytes(page_count, page_count) * workers as u64;
        let upper = if needs.asks_voxels() { file.upper.clone()? } else { None };
        let facts = SessionFacts {
            layers,
            portion,
            workers,
            is_live,
            facets: upper.as_ref().map(|size| size.facet_count as usize),
            materials: file.material_count,
            emitters: file.emitter_count,
            g_needs,
            is_far: file.is_far,
        };
        let session = SessionShares::new(&settings, &facts);
        Ok(MemoryPlan {
            reserve_bytes: RESERVE_BYTES,
            tables_bytes: file.kept_bytes + session.model_bytes,
            voxels_bytes: match upper {
                Some(upper) => {
                    voxels_bytes(file, &upper, &session)? + parts.voxel_bytes(upper.leaf_count as usize)
                }
                None => 0,
            },
            photons_bytes: session.light_bytes.photons,
            film_bytes: session.film_bytes + session.pass_bytes + copies_bytes + shown_bytes(needs, &session),
            staging_bytes: overhead + pins + parts.cap_bytes(workers),
            frames_bytes: 0,
            kept_light_bytes: 0,
            read_room,
        })
    }

    fn sum(&self) -> u64 {
        let MemoryPlan { reserve_bytes, tables_bytes, voxels_bytes, photons_bytes, .. } = *self;
        let MemoryPlan { film_bytes, staging_bytes, frames_bytes, .. } = *self;
        let light = voxels_bytes + photons_bytes;
        reserve_bytes + tables_bytes + light + film_bytes + staging_bytes + frames_bytes
    }
}

/// Bytes that it takes to show a film and to write it. Beside a display the filter works in the display's room.
fn shown_bytes(needs: &PictureNeeds, session: &SessionShares) -> u64 {
    let resolution = needs.settings.resolution;
    let shown = match needs.is_live {
        true => session.display_bytes,
        false if needs.layers.filter => filter_bytes(resolution),
        false => 0,
    };
    shown + encoder_bytes(resolution, needs.layers)
}

/// Bytes that the octree takes, with its light; or while it is read, with its stored form.
fn voxels_bytes(file: &FileSizes, upper: &UpperSize, session: &SessionShares) -> Result<u64> {
    let links = file.lower.clone()?.map_or(0, |lower| lower.resident_bytes + lower.reading_bytes);
    let light = session.lit_bytes() + session.light_bytes.pass;
    Ok(upper.resident_bytes + links + light.max(upper.reading_bytes))
}
