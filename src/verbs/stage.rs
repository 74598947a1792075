//! What `render`, `demo`, `stress` and `view` begin with: the scene that a file names or is, the model that it is of,
//! and how disks are read.

use crate::args::DiskArgs;
use crate::context::Context;
use crate::size;
use serde::Serialize;
use std::path::Path;
use std::sync::Arc;
use trex_model::{
    DamagePolicy, DeviceOptions, DeviceReport, Model, OpenOptions, Session, SessionOptions, ThreadSource,
    set_direct_without_voxels,
};
use trex_render::{Camera, MemoryPlan, Scene, parse_views};
use trex_store::io::{IoDescription, IoOptions};
use trex_store::layout::PageKind;
use trex_store::pool::{PagePool, PageState};
use trex_store::{Error, PageFile, Result, StopSignal, open_regular};

/// Counts of pages that are in frames.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct ResidentPages {
    /// Clusters and their trees.
    pub mesh: u32,
    /// Units of the finer octrees.
    pub units: u32,
    /// Colours of triangles.
    pub colours: u32,
    /// Normals of triangles.
    pub normals: u32,
}

/// What is to be shown, and how.
#[derive(Clone, Copy)]
pub struct Play<'a> {
    pub scene: &'a Scene,
    pub file: &'a Path,
    pub options: SessionOptions,
    pub io: &'a IoOptions,
    pub device: &'a DeviceOptions,
    /// When what is decided by a look at the opening view is to be decided without.
    pub stop: &'a StopSignal,
}

/// A model with a session on it.
pub struct Stage {
    pub model: Model,
    pub pool: Arc<PagePool>,
    pub plan: MemoryPlan,
}

impl Stage {
    /// Opens the file under the limit of `ctx`, and begins the session.
    ///
    /// # Errors
    /// Those of [`Model::open`] and [`Model::session`].
    pub fn open(play: &Play<'_>, ctx: &Context) -> Result<(Stage, Session)> {
        let Play { scene, file, options, io, device, stop } = play;
        let open_options = OpenOptions {
            budget: ctx.budget.clone(),
            threads: ThreadSource::Shared(ctx.thread_pool()?),
            io: (*io).clone(),
            damage: DamagePolicy::LeaveOut,
            device: (*device).clone(),
            picture: Some(options.picture_needs(scene, ctx.threads)?),
        };
        let model = Model::open(file, &open_options)?;
        let session = model.session_until(scene, options, stop)?;
        let begun = "a session has a pool and a plan";
        let (pool, plan) = (model.pool().expect(begun), model.memory_plan().expect(begun));
        let io = pool.io();
        tracing::info!("pages are read by {}: {}", io.backend, io.reason);
        let DeviceReport { name, reason, gpu, .. } = model.device();
        tracing::info!("rays through the voxels are answered by {name}: {reason}");
        if let Some(gpu) = gpu {
            tracing::info!(
                "video memory: limit {}; driver {}",
                size::bytes(gpu.memory_limit_bytes),
                gpu.driver
            );
        }
        tracing::info!("memory: {}", size::memory_plan(&plan));
        Ok((Stage { model, pool, plan }, session))
    }

    /// The backend that reads pages; that it took the place of another is told.
    pub fn io(&self, ctx: &Context) -> IoDescription {
        let io = self.pool.io();
        if let Some(notice) = &io.notice {
            ctx.console.note(&format!("note: {notice}"));
        }
        io
    }

    /// The device that answers G-rays; why the processor does in its place is told.
    pub fn device(&self, ctx: &Context) -> DeviceReport {
        let device = self.model.device();
        if let Some(notice) = &device.notice {
            ctx.console
                .note(&format!("note: rays through the voxels were answered by the processor: {notice}"));
        }
        device
    }

    /// The pages that are in frames now, by what they hold.
    pub fn resident_pages(&self) -> ResidentPages {
        let mut resident = ResidentPages::default();
        for (page, entry) in (0..).zip(self.model.file().pages()) {
            if self.pool.state(page) == PageState::Resident {
                *match entry.kind {
                    PageKind::Mesh => &mut resident.mesh,
                    PageKind::Units => &mut resident.units,
                    PageKind::Colours => &mut resident.colours,
                    PageKind::Normals => &mut resident.normals,
                } += 1;
            }
        }
        resident
    }
}

/// What nobody has asked for gives way to what the file has: without voxels there is direct light, with a note.
///
/// # Errors
/// Those of [`PageFile::superblock_of`].
pub fn suit_file(scene: &mut Scene, file: &Path, ctx: &Context) -> Result<()> {
    if set_direct_without_voxels(scene, &PageFile::superblock_of(file)?) {
        ctx.console
            .note("note: the file has no voxels, so that light is direct; --integrator path has all of it");
    }
    Ok(())
}

/// The libraries' form of `--io` and `--direct`.
pub fn io_options(disk: &DiskArgs) -> IoOptions {
    IoOptions { io: disk.io.choice(), direct: disk.direct.choice(), ..IoOptions::default() }
}

/// The viewpoints of a file, otherwise like `camera`.
pub fn read_views(path: &Path, camera: &Camera) -> Result<Vec<Camera>> {
    let text = std::io::read_to_string(open_regular(path)?)
        .map_err(|error| Error::io("read the views", path, &error))?;
    parse_views(&text, camera).map_err(|error| error.at(path))
}
