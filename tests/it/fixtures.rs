//! Models that several tests look at, each built once a process: page files that nobody may change.
//!
//! Invariants: 1. a model is built by the first that asks for it, while others that want the same wait; 2. the folder
//! goes when the process does, however it ends.

use crate::command::{TREX, folder, trex_in};
use crate::support::{Built, build_at, build_options, source};
use std::collections::HashMap;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex, OnceLock};
use trex_store::build::{BuildOptions, Voxels};

/// What there is one of in a process, by what it was made from.
struct Shelf<T>(Mutex<HashMap<String, Arc<OnceLock<T>>>>);

impl<T: Clone> Shelf<T> {
    fn get(&self, key: &str, make: impl FnOnce() -> T) -> T {
        let slot = self.0.lock().unwrap().entry(key.to_owned()).or_default().clone();
        slot.get_or_init(make).clone()
    }
}

/// The folder of all of them.
struct Folder {
    path: PathBuf,
    /// Waits for this process to end, and removes the folder: what is `static` is never dropped.
    _sweeper: Child,
}

fn shared_folder() -> &'static Path {
    static FOLDER: OnceLock<Folder> = OnceLock::new();
    let made = FOLDER.get_or_init(|| {
        let path = folder().keep();
        // In a group of its own, Ctrl-C does not end it first; the read ends when this end of the pipe is closed.
        let sweeper = Command::new("sh")
            .args(["-c", "read -r _; rm -rf -- \"$1\"", "sh"])
            .arg(&path)
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        Folder { path, _sweeper: sweeper }
    });
    &made.path
}

/// The model of a `gen:` name, without voxels.
pub(crate) fn model(spec: &str) -> Arc<Built> {
    model_with(spec, Voxels::None)
}

/// The model of a `gen:` name with these voxels.
pub(crate) fn model_with(spec: &str, voxels: Voxels) -> Arc<Built> {
    static MODELS: OnceLock<Shelf<Arc<Built>>> = OnceLock::new();
    let shelf = MODELS.get_or_init(|| Shelf(Mutex::default()));
    shelf.get(&format!("{spec} {voxels:?}"), || {
        let path = shared_folder().join(file_name(&format!("{spec} {voxels:?}")));
        let options = BuildOptions { voxels, ..build_options() };
        Arc::new(build_at(&path, &mut *source(spec), &options))
    })
}

/// Puts the result of `trex build WHAT` into a folder as `name`; WHAT is a `gen:` name, flags may follow.
#[track_caller]
pub(crate) fn built_in(inside: &Path, what: &str, name: &str) {
    static FILES: OnceLock<Shelf<PathBuf>> = OnceLock::new();
    let shelf = FILES.get_or_init(|| Shelf(Mutex::default()));
    let built = shelf.get(what, || {
        let name = file_name(&format!("command {what}"));
        let line = format!("build {what} -o {name} -q");
        let output = trex_in(shared_folder(), &line).output().unwrap();
        assert!(output.status.success(), "{TREX} {line}: {}", String::from_utf8_lossy(&output.stderr));
        shared_folder().join(name)
    });
    // A copy, not a link: some tests write into theirs.
    std::fs::copy(built, inside.join(name)).unwrap();
}

fn file_name(what: &str) -> String {
    format!("{}.trex", what.replace(|c: char| !c.is_ascii_alphanumeric(), "-"))
}
