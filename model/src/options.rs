//! How a model is opened, and how a session on it is made.

use crate::device::DeviceOptions;
use rayon::ThreadPool;
use std::num::NonZero;
use std::sync::Arc;
use trex_render::{CpuStage, Filter, Layers, PartNeeds, PictureNeeds, Portion, RenderSettings, Scene};
use trex_store::io::IoOptions;
use trex_store::{Budget, Result};

/// Where the threads of a model's work come from.
#[derive(Clone, Debug)]
pub enum ThreadSource {
    /// So many are started with the model, and joined when the last that uses them is dropped: the model, or a session
    /// that outlives it.
    Start(NonZero<usize>),
    /// Those of a pool that is somebody else's.
    Shared(Arc<ThreadPool>),
}

/// What becomes of answers where pages are damaged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DamagePolicy {
    /// Rays of the caller, and pictures that are rendered to their end, end in the error of the first damaged page that
    /// was met since the model was opened.
    #[default]
    Refuse,
    /// Damaged pages count as empty; [`crate::Model::damage`] lists them.
    LeaveOut,
}

/// How a model is opened.
#[derive(Clone, Debug)]
pub struct OpenOptions {
    /// The ledger of the memory limit.
    pub budget: Budget,
    /// The threads.
    pub threads: ThreadSource,
    /// How the file is read.
    pub io: IoOptions,
    /// What becomes of answers where pages are damaged.
    pub damage: DamagePolicy,
    /// What answers G-rays.
    pub device: DeviceOptions,
    /// The picture that it is opened for, if that is known: a limit that is too small for the tables is then refused
    /// with the smallest that does for all of it.
    pub picture: Option<PictureNeeds>,
}

/// Whether pictures of a session take what they take, or come in frames with a deadline.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Pace {
    /// As long as it takes.
    #[default]
    AtLeisure,
    /// In frames: the session is to go live.
    InFrames,
}

/// How a session is made.
#[derive(Clone, Copy, Debug, Default)]
pub struct SessionOptions {
    /// Layers that the film keeps beside radiance; those of the filter follow from the scene.
    pub layers: Layers,
    /// The part of the picture that is made; `None` for all of it.
    pub portion: Option<Portion>,
    /// How its pictures come.
    pub pace: Pace,
    /// Bytes that the caller will lease beside the session, for copies of pictures.
    pub copies_bytes: u64,
}

impl SessionOptions {
    /// What a session on `scene` by so many workers needs of memory.
    ///
    /// # Errors
    /// [`trex_store::Code::SceneFormat`] for settings that do not go together.
    pub fn picture_needs(&self, scene: &Scene, workers: usize) -> Result<PictureNeeds> {
        let needs = self.needs_of(RenderSettings::new(scene.render)?, workers);
        Ok(PictureNeeds { parts: scene.parts.needs(), ..needs })
    }

    /// What a session with these settings on the whole model by so many workers needs of memory, where the processor
    /// answers G-rays; what another device needs beside it, the model adds.
    pub fn needs_of(&self, settings: RenderSettings, workers: usize) -> PictureNeeds {
        PictureNeeds {
            settings,
            // Smoothed light needs some.
            layers: Layers { filter: settings.filter == Filter::On, ..self.layers },
            portion: self.portion,
            workers,
            g_needs: CpuStage::NEEDS,
            is_live: self.pace == Pace::InFrames,
            copies_bytes: self.copies_bytes,
            parts: PartNeeds::default(),
        }
    }
}

impl OpenOptions {
    /// Options for a process that may take `limit_bytes` in all (24 MiB of it are reserved for text, stacks and the
    /// allocator), with a thread for each processor.
    pub fn with_limit(limit_bytes: u64) -> OpenOptions {
        let count = std::thread::available_parallelism().unwrap_or(NonZero::<usize>::MIN);
        OpenOptions {
            budget: Budget::new(limit_bytes),
            threads: ThreadSource::Start(count),
            io: IoOptions::default(),
            damage: DamagePolicy::default(),
            device: DeviceOptions::default(),
            picture: None,
        }
    }
}
