//! What the command reports of model, memory, pool and device: figures that the viewer hands on to its pages.
//!
//! Invariant: plain numbers, no names of files.

use serde::Serialize;

/// What is constant of a model, for the page.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct ModelFigures {
    /// Triangles of the model.
    pub triangle_count: u64,
    /// Bytes of its file.
    pub file_bytes: u64,
    /// Pages of the file.
    pub page_count: u64,
    /// Materials of the model.
    pub material_count: u64,
}

/// Memory, as the process and its ledger have it.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct MemoryFigures {
    /// Leased now.
    pub used_bytes: u64,
    /// The limit of the process.
    pub limit_bytes: u64,
    /// Most that the process has held at once, as the system counts.
    pub peak_rss_bytes: Option<u64>,
    /// Frames of pages.
    pub frames_bytes: u64,
}

/// The pool of pages.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct PoolFigures {
    /// Frames that there are.
    pub frames: u64,
    /// Pages in them.
    pub resident: u64,
    /// Pages read since the file was opened.
    pub pages_read: u64,
    /// Look-ups that found no page.
    pub misses: u64,
    /// Pages that lost their frame.
    pub evictions: u64,
    /// Bytes read.
    pub bytes_read: u64,
    /// Damaged pages that were met: nothing is drawn of them, or something coarser.
    pub damaged: u64,
}

/// The device that answers rays through the voxels; all is 0 where that is the processor.
#[derive(Clone, Copy, Debug, Default, Serialize)]
pub struct DeviceFigures {
    /// Rays that it has answered.
    pub rays: u64,
    /// Rays that the processor has answered in its place.
    pub processor_rays: u64,
    /// Bytes that went to it.
    pub uploaded_bytes: u64,
    /// Bytes that came back.
    pub read_back_bytes: u64,
    /// Pages of units that went to it.
    pub unit_uploads: u64,
    /// Pages of units that gave way to others.
    pub unit_evictions: u64,
    /// Bytes of its memory that are leased.
    pub memory_used_bytes: u64,
    /// Most bytes of its memory.
    pub memory_limit_bytes: u64,
}
