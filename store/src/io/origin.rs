//! `Origin`: where the bytes of a page file are: in a file of this machine, or behind HTTP.
//!
//! ```text
//! path: https://host/x.trex, http://.., s3://.. -> ranges of it, one version of it (`http`)
//!       any other                               -> a regular file
//! ```
//!
//! Invariants: 1. all bytes of an origin are those of one file, or of one version of what the server has: what has
//! changed there is an error; 2. nothing is opened but regular files and addresses.

#[cfg(feature = "http")]
use super::http::{HttpFile, RUN_BYTES};
use super::{Backend, IoOptions, drop_cached, open};
use crate::error::{Code, Error, Result};
use crate::url::is_url;
use std::fs::File;
use std::os::unix::fs::FileExt;
use std::path::Path;
#[cfg(feature = "http")]
use std::sync::Arc;

/// The bytes of a page file.
pub enum Origin {
    /// A regular file.
    File(File),
    /// What a server has at an address.
    #[cfg(feature = "http")]
    Http(Arc<HttpFile>),
}

impl Origin {
    /// Opens a regular file, or asks a server for the end of what it has.
    ///
    /// # Errors
    /// [`Code::InputUnreadable`] for what cannot be opened, is no regular file, or is not given in parts;
    /// [`Code::Usage`] for an address that this build, or anybody, cannot read.
    pub fn open(path: &Path) -> Result<Origin> {
        if is_url(path) {
            return Origin::open_url(path);
        }
        let failed = |error| Error::io("open", path, &error);
        // Asked before the open: opening a pipe would wait for a writer.
        if !std::fs::metadata(path).map_err(failed)?.is_file() {
            return Err(Error::new(Code::InputUnreadable, "this is no regular file")
                .at(path)
                .next("name a file: nothing is read from folders, pipes, sockets or devices"));
        }
        File::open(path).map(Origin::File).map_err(failed)
    }

    #[cfg(feature = "http")]
    fn open_url(path: &Path) -> Result<Origin> {
        HttpFile::open(path).map(|file| Origin::Http(Arc::new(file)))
    }

    #[cfg(not(feature = "http"))]
    fn open_url(path: &Path) -> Result<Origin> {
        Err(Error::new(Code::Usage, "this build reads nothing from the web")
            .at(path)
            .next("build it with the feature http, or copy the file"))
    }

    /// Length, bytes.
    ///
    /// # Errors
    /// What the system says.
    pub fn length(&self) -> std::io::Result<u64> {
        match self {
            Origin::File(file) => file.metadata().map(|found| found.len()),
            #[cfg(feature = "http")]
            Origin::Http(file) => Ok(file.length()),
        }
    }

    /// Fills `out` with the bytes from `offset` on.
    ///
    /// # Errors
    /// What the system or the server says; `UnexpectedEof` where there are not as many.
    pub fn read_exact_at(&self, out: &mut [u8], offset: u64) -> std::io::Result<()> {
        match self {
            Origin::File(file) => file.read_exact_at(out, offset),
            #[cfg(feature = "http")]
            Origin::Http(file) => file.read_exact_at(out, offset),
        }
    }

    /// True behind a network: most of the time of a read is the way, and the end is at hand before the beginning is.
    pub(crate) fn is_far(&self) -> bool {
        match self {
            Origin::File(_) => false,
            #[cfg(feature = "http")]
            Origin::Http(_) => true,
        }
    }

    /// Gets all of these parts (offset, bytes) at a time, where each would be a way to the server and back. They stay
    /// until [`Origin::forget_parts`]. An error is met again by those who read them.
    pub(crate) fn fetch_parts(&self, parts: &[(u64, u64)]) {
        match self {
            Origin::File(_) => {
                let _ = parts;
            }
            #[cfg(feature = "http")]
            Origin::Http(file) => file.fetch_parts(parts),
        }
    }

    /// Gets a run of bytes from `offset` on, none behind `end`, unless they are there; what was got before goes.
    pub(crate) fn fetch_run(&self, (offset, bytes): (u64, u64), end: u64) {
        match self {
            Origin::File(_) => {
                let _ = (offset, bytes, end);
            }
            #[cfg(feature = "http")]
            Origin::Http(file) => {
                if !file.has(offset, bytes) {
                    file.forget_parts();
                    file.fetch_parts(&[(offset, RUN_BYTES.min(end.saturating_sub(offset)).max(bytes))]);
                }
            }
        }
    }

    /// Frees what [`Origin::fetch_parts`] got, but for heads.
    pub(crate) fn forget_parts(&self) {
        #[cfg(feature = "http")]
        if let Origin::Http(file) = self {
            file.forget_parts();
        }
    }

    /// Bytes that connections take, while it is open.
    pub(crate) fn connection_bytes(&self) -> u64 {
        match self {
            Origin::File(_) => 0,
            #[cfg(feature = "http")]
            Origin::Http(_) => HttpFile::CONNECTIONS_BYTES,
        }
    }

    /// Drops bytes from the page cache, and what was got ahead, so that they are read again from where they are.
    pub(crate) fn drop_cached(&self, offset: u64, bytes: u64) {
        match self {
            Origin::File(file) => drop_cached(file, offset, bytes),
            #[cfg(feature = "http")]
            Origin::Http(file) => file.forget_all(offset, bytes),
        }
    }

    /// A backend that reads it; `path` is the one that it was opened by.
    ///
    /// # Errors
    /// Those of [`open`].
    pub(crate) fn backend(&self, path: &Path, options: &IoOptions) -> Result<Box<dyn Backend>> {
        match self {
            Origin::File(_) => open(path, options),
            #[cfg(feature = "http")]
            Origin::Http(file) => Ok(Box::new(file.threads(options))),
        }
    }
}
