//! `Model::show`: a live session on a model, in pages of a browser, until it is told to stop.
//!
//! What pages show of memory, pool, device and damage is the model's; what only the caller knows (how it was asked for,
//! how its user words a picture, when to stop) comes in as [`ShownModel`].

use crate::handle::{LiveSession, Model};
use crate::options::{Pace, SessionOptions};
use std::cell::Cell;
use std::net::TcpListener;
use trex_render::{PictureNeeds, Scene};
use trex_store::layout::FRAME_BYTES;
use trex_store::pool::PagePool;
use trex_store::{DamageList, Result};
use trex_view::{
    DeviceFigures, MemoryFigures, ModelFigures, PoolFigures, Recipe, Room, ServeOptions, ServeReport,
    Surroundings, view_bytes,
};

/// What pages are told beside what the model knows.
pub struct ShownModel<'a> {
    /// Name of the model, for the page's title.
    pub name: &'a str,
    /// Path of the model, for scene files.
    pub path: &'a str,
    /// What the session is on.
    pub scene: &'a Scene,
    /// Words what makes a picture, for the page to copy.
    pub words: &'a dyn Fn(&Recipe<'_>) -> String,
    /// Most that the process has held at once, bytes, as the system counts, where it does.
    pub peak_rss_bytes: &'a dyn Fn() -> Option<u64>,
    /// True once the viewer is to end.
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

impl SessionOptions {
    /// Those of a session that is shown in pages, where its picture has so many pixels to begin with.
    pub fn shown(resolution: [u32; 2]) -> SessionOptions {
        let copies_bytes = view_bytes(resolution);
        SessionOptions { pace: Pace::InFrames, copies_bytes, ..SessionOptions::default() }
    }
}

impl Model {
    /// Shows `session`, one on this model that was made with [`SessionOptions::shown`], to the pages that connect to
    /// `listener`, until `shown.stop` says so; then it ends within a second. The calling thread works meanwhile.
    ///
    /// # Errors
    /// Those of [`trex_view::serve`].
    pub fn show(
        &self,
        session: LiveSession,
        listener: &TcpListener,
        options: &ServeOptions,
        shown: &ShownModel<'_>,
    ) -> Result<ServeReport> {
        let pool = self.pool().expect("a session has a pool");
        // What frames of pages make room for.
        let now = Cell::new(Room::of(session.view().settings, session.view().parts.needs(), 0));
        let needs = |room: &Room| self.shown_needs(room);
        let around = Surroundings {
            name: shown.name,
            command_line: shown.words,
            model_path: shown.path,
            model: self.model_figures(),
            file_materials: self.file().materials(),
            views: if shown.scene.model.is_empty() { vec![] } else { vec![session.view().camera] },
            camera: shown.scene.camera,
            budget: self.budget(),
            memory: &|| MemoryFigures {
                used_bytes: self.budget().used_bytes(),
                limit_bytes: self.budget().limit_bytes(),
                peak_rss_bytes: (shown.peak_rss_bytes)(),
                frames_bytes: pool.stats().frames * FRAME_BYTES as u64,
            },
            pool: &|| pool_figures(&pool),
            device_name: &self.device().name,
            device: &|| self.device_figures(),
            damage: &|| DamageList::of(self.file(), &pool),
            kept_light: &|rooms, limit_bytes| {
                self.kept_light_bytes(&rooms.iter().map(needs).collect::<Vec<_>>(), limit_bytes)
            },
            set_limit: &|bytes| self.set_limit(bytes, &needs(&now.get())),
            exchange: &|room, apply| {
                self.exchange(&needs(&room), apply)?;
                now.set(room);
                Ok(())
            },
            make_room: &|rooms| {
                self.make_room(&rooms.iter().map(needs).collect::<Vec<_>>())?;
                if let [only] = rooms {
                    now.set(*only);
                }
                Ok(())
            },
            stop: shown.stop,
        };
        let served = trex_view::serve(session, listener, options, &around);
        // A limit that a page has set goes with it.
        self.restore_limit();
        served
    }

    /// What a picture in pages needs of memory.
    fn shown_needs(&self, room: &Room) -> PictureNeeds {
        let Room { settings, copies_bytes, parts } = *room;
        let options = SessionOptions { pace: Pace::InFrames, copies_bytes, ..SessionOptions::default() };
        PictureNeeds { parts, ..options.needs_of(settings, self.worker_count()) }
    }

    fn model_figures(&self) -> ModelFigures {
        let file = self.file();
        ModelFigures {
            triangle_count: file.superblock().triangle_count,
            file_bytes: file.superblock().file_bytes,
            page_count: file.pages().len() as u64,
            material_count: file.materials().len() as u64,
        }
    }

    fn device_figures(&self) -> Option<DeviceFigures> {
        self.device().gpu.map(|gpu| DeviceFigures {
            rays: gpu.rays,
            processor_rays: gpu.processor_rays,
            uploaded_bytes: gpu.uploaded_bytes,
            read_back_bytes: gpu.read_back_bytes,
            unit_uploads: gpu.unit_uploads,
            unit_evictions: gpu.unit_evictions,
            memory_used_bytes: gpu.memory_used_bytes,
            memory_limit_bytes: gpu.memory_limit_bytes,
        })
    }
}

fn pool_figures(pool: &PagePool) -> PoolFigures {
    let stats = pool.stats();
    PoolFigures {
        frames: stats.frames,
        resident: stats.pages_read.saturating_sub(stats.evictions).min(stats.frames),
        pages_read: stats.pages_read,
        misses: stats.misses,
        evictions: stats.evictions,
        bytes_read: stats.bytes_read,
        damaged: stats.damaged,
    }
}
