//! `Watch`: whether files of a model have changed, for `view --watch`.
//!
//! They are looked at twice a second, since not every file system tells of changes, and networks do not. A file that is
//! being written changes at each look: it has changed when two looks find it alike, and otherwise than at first.
//!
//! Invariant: the thread ends with the watch.

use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError, Sender};
use std::thread::{self, JoinHandle};
use std::time::{Duration, SystemTime};
use trex_store::{Error, Result};

/// Time between two looks.
pub const LOOK_EVERY: Duration = Duration::from_millis(500);

/// What a file is taken for: its inode, bytes and time of change; `None` where it is not there.
type Stamp = Option<(u64, u64, SystemTime)>;

/// See the module's description.
pub struct Watch {
    has_changed: Arc<AtomicBool>,
    /// Its end ends the thread.
    end: Option<Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Watch {
    /// Watches `files` from now on.
    ///
    /// # Errors
    /// The system refuses a thread.
    pub fn begin(files: Vec<PathBuf>) -> Result<Watch> {
        let has_changed = Arc::new(AtomicBool::new(false));
        let (end, ended) = mpsc::channel::<()>();
        let first = stamps(&files);
        let tells = has_changed.clone();
        let watch = move || {
            let mut before = first.clone();
            while ended.recv_timeout(LOOK_EVERY) == Err(RecvTimeoutError::Timeout) {
                let now = stamps(&files);
                if now == before && now != first && now.iter().all(Option::is_some) {
                    return tells.store(true, Ordering::Relaxed);
                }
                before = now;
            }
        };
        let thread = thread::Builder::new().name("view-watch".into()).spawn(watch);
        let thread = thread.map_err(|error| Error::thread_refused("the watch of the model", &error))?;
        Ok(Watch { has_changed, end: Some(end), thread: Some(thread) })
    }

    /// True once a file has changed.
    pub fn has_changed(&self) -> bool {
        self.has_changed.load(Ordering::Relaxed)
    }
}

impl Drop for Watch {
    fn drop(&mut self) {
        drop(self.end.take());
        // It does nothing that could panic.
        let _ = self.thread.take().map(JoinHandle::join);
    }
}

fn stamps(files: &[PathBuf]) -> Vec<Stamp> {
    let stamp = |found: Metadata| Some((found.ino(), found.len(), found.modified().ok()?));
    files.iter().map(|file| file.metadata().ok().and_then(stamp)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Instant;

    /// Written in place, put in its place by a rename, and gone: the last is no model.
    #[test]
    fn a_file_has_changed_once_it_is_there_whole() {
        let folder = tempfile::tempdir().unwrap();
        let [file, other] = ["a", "b"].map(|name| folder.path().join(name));
        std::fs::write(&file, "one").unwrap();
        let changes = |change: &dyn Fn()| {
            let watch = Watch::begin(vec![file.clone()]).unwrap();
            change();
            let begin = Instant::now();
            while !watch.has_changed() && begin.elapsed() < 6 * LOOK_EVERY {
                thread::sleep(LOOK_EVERY / 10);
            }
            watch.has_changed()
        };
        assert!(!changes(&|| {}));
        assert!(changes(&|| std::fs::write(&file, "longer").unwrap()));
        std::fs::write(&other, "otherr").unwrap();
        assert!(changes(&|| std::fs::rename(&other, &file).unwrap()));
        assert!(!changes(&|| std::fs::remove_file(&file).unwrap()));
    }
}
