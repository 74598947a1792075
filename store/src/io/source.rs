//! `Source`: an open file as backends read it, and `IoDescription`: what is said of the one that does.

use super::ALIGN_BYTES;
use serde::Serialize;
use std::fs::File;
use std::sync::Arc;

/// An open file and whether its reads go past the page cache.
#[derive(Clone)]
pub struct Source {
    pub(super) file: Arc<File>,
    pub(super) direct: bool,
}

impl Source {
    /// Alignment that reads of this source need.
    pub(super) fn align_bytes(&self) -> usize {
        if self.direct { ALIGN_BYTES } else { 1 }
    }
}

/// Which backend runs, and why: for `-v` and JSON.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct IoDescription {
    /// `uring`, `pread`, `mmap`, `http`, `s3`, `memory`; `fault+NAME` in tests.
    pub backend: String,
    /// True when reads go past the page cache.
    pub direct: bool,
    /// Why this one, in words.
    pub reason: String,
    /// One line for people, once something went wrong since the file was opened: what, and how reading continues.
    pub notice: Option<String>,
}

impl IoDescription {
    pub(super) fn new(backend: &str, direct: bool, reason: String) -> IoDescription {
        IoDescription { backend: backend.into(), direct, reason, notice: None }
    }
}
