//! `Journal`: what lets a build that was killed go on, beside the output.
//!
//! ```text
//! .NAME.HASH.journal   who builds what: its flock keeps two builders of one output apart
//! .NAME.HASH.cells     triangles on the lattice, in runs          (in --temp-dir where one is given)
//! .NAME.HASH.voxels    voxel records, in runs                     (as above)
//! .NAME.HASH.part      the output, page by page
//! .NAME.HASH.sorted    record: the first triangles of the input, in cells, replaced every few seconds
//! .NAME.HASH.chunks    record: what partition found, which runs make which chunk
//! .NAME.HASH.done      record: the chunks that are in .part and .voxels, replaced every few seconds
//! ```
//!
//! A finished unit is each batch of triangles that is in cells, then each chunk. A stream cannot be entered in its
//! middle: what is in cells is read again, but neither scanned nor sorted (`sorted_record`).
//!
//! Invariants: 1. a record is written after all that it speaks of was synced; 2. a run of cells is given back after the
//! record that does without it was; 3. input and options stand in the journal: a build goes on with the same ones or
//! not at all; 4. a builder that ends, but for an interrupt, removes all of them; 5. the lock is the kernel's: it ends
//! with its process, however that ends.

use super::record::unfinished;
use super::{BuildOptions, Error, Result, Resume};
use crate::error::Code;
use crate::layout::VERSION;
use crate::output::folder_of;
use crate::source::{SourceStats, stamp};
use rustix::fs::{FlockOperation, flock};
use rustix::io::{Errno, retry_on_intr};
use serde::{Deserialize, Serialize};
use std::ffi::OsStr;
use std::fs::{File, OpenOptions};
use std::io::Read;
use std::os::unix::ffi::OsStrExt;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use xxhash_rust::xxh3::xxh3_64;

/// Says that a file is a journal, and of which form.
const FORMAT: &str = "trex-journal/3";
/// Characters of an output's name that its journal's has, too: names end at 255 bytes.
const NAME_CHARS: usize = 40;
/// Longest journal: names and numbers of inputs.
const JOURNAL_BYTES: u64 = 1 << 20;
/// Tries to lock a journal that others remove meanwhile.
const LOCK_TRIES: u32 = 16;
/// How long somebody may hold the lock who only looks whether it is held.
const GLANCE: Duration = Duration::from_millis(50);
/// Time between two records, over the time that one took: so they cost a twentieth. Beyond the second number, over the
/// time that was asked for, a slow disk costs more than that.
const PAUSE: u32 = 20;
const PAUSE_MOST: u32 = 3;
/// Endings of the files of a build, the journal's last: while it is there, the others are found.
const ENDINGS: [&str; 7] = ["part", "cells", "voxels", "sorted", "chunks", "done", "journal"];
/// Endings of records, which have another name while they are written.
const RECORDS: [&str; 3] = ["sorted", "chunks", "done"];

/// Names of the files of one output's builds.
#[derive(Clone)]
pub(super) struct Names {
    folder: PathBuf,
    scratch_folder: PathBuf,
    stem: String,
}

impl Names {
    pub(super) fn new(output: &Path, scratch_folder: &Path) -> Names {
        let name = output.file_name().unwrap_or_default();
        let kept: String = name.to_string_lossy().chars().take(NAME_CHARS).collect();
        let stem = format!(".{kept}.{:016x}", xxh3_64(name.as_bytes()));
        Names { folder: folder_of(output).to_path_buf(), scratch_folder: scratch_folder.to_path_buf(), stem }
    }

    /// The file of an ending.
    pub(super) fn file(&self, ending: &str) -> PathBuf {
        let is_scratch = ["cells", "voxels"].contains(&ending);
        let folder = if is_scratch { &self.scratch_folder } else { &self.folder };
        folder.join(format!("{}.{ending}", self.stem))
    }

    /// All files that may be there.
    pub(super) fn all(&self) -> Vec<PathBuf> {
        let unfinished = RECORDS.map(|ending| unfinished(&self.file(ending)));
        unfinished.into_iter().chain(ENDINGS.map(|ending| self.file(ending))).collect()
    }

    /// Removes what is there, but for the journal.
    fn clear(&self) {
        self.all().iter().filter(|path| **path != self.file("journal")).for_each(|path| {
            let _ = std::fs::remove_file(path);
        });
    }
}

/// What a journal says.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Header {
    format: String,
    /// Name of the output as the system writes it.
    pub(super) output: Vec<u8>,
    /// Full path of the folder of scratch; empty for that of the output.
    scratch_folder: Vec<u8>,
    /// What the bytes of the output depend on, by name.
    facts: Vec<(String, String)>,
}

impl Header {
    fn new(output: &Path, resume: &Resume, options: &BuildOptions) -> Header {
        let given = options.temp_dir.as_deref();
        let scratch_folder = given.map(|given| given.canonicalize().unwrap_or_else(|_| given.to_path_buf()));
        let scratch_folder = scratch_folder.unwrap_or_default();
        let option = |name: &str, value: &dyn std::fmt::Debug| (name.to_owned(), format!("{value:?}"));
        let mut facts = vec![
            ("trex".to_owned(), format!("{}, format {VERSION}", env!("CARGO_PKG_VERSION"))),
            option("precision", &options.precision),
            option("voxels", &options.voxels),
            option("folder of scratch", &scratch_folder),
        ];
        facts.extend(resume.input.iter().cloned());
        Header {
            format: FORMAT.into(),
            output: output.file_name().unwrap_or_default().as_bytes().to_vec(),
            scratch_folder: scratch_folder.as_os_str().as_bytes().to_vec(),
            facts,
        }
    }

    /// Reads an open journal; `None` for anything else.
    pub(super) fn read(mut file: &File) -> Option<Header> {
        let mut bytes = Vec::new();
        Read::by_ref(&mut file).take(JOURNAL_BYTES).read_to_end(&mut bytes).ok()?;
        serde_json::from_slice(&bytes).ok().filter(|header: &Header| header.format == FORMAT)
    }

    /// The folder of scratch, for an output in `folder`.
    pub(super) fn scratch_folder<'a>(&'a self, folder: &'a Path) -> &'a Path {
        match self.scratch_folder.as_slice() {
            [] => folder,
            given => Path::new(OsStr::from_bytes(given)),
        }
    }

    /// What stands here in another way than in `now`.
    fn differences(&self, now: &Header) -> String {
        let value = |header: &Header, name: &str| {
            let found = header.facts.iter().find(|fact| fact.0 == name);
            found.map_or("none".to_owned(), |fact| fact.1.clone())
        };
        let mut names: Vec<&str> = self.facts.iter().chain(&now.facts).map(|fact| fact.0.as_str()).collect();
        names.dedup();
        let mut told: Vec<String> = Vec::new();
        for name in names {
            let (then, now) = (value(self, name), value(now, name));
            let line = format!("{name}: {then} then, {now} now");
            if then != now && !told.contains(&line) {
                told.push(line);
            }
        }
        told.join("; ")
    }
}

/// The journal of a build under way.
pub(super) struct Journal {
    output: PathBuf,
    names: Names,
    /// Holds the lock.
    file: File,
    every: Duration,
    due: Instant,
    /// There is a record to go on from.
    pub(super) has_record: bool,
    is_kept: bool,
}

impl Journal {
    /// Takes the lock of `output`; `None` for a build that leaves nothing.
    ///
    /// # Errors
    /// [`Code::Usage`] where another builder is at work on this output, or one was with other input or options.
    pub(super) fn begin(
        output: &Path,
        scratch_folder: &Path,
        options: &BuildOptions,
    ) -> Result<Option<Journal>> {
        let Some(resume) = &options.resume else { return Ok(None) };
        let names = Names::new(output, scratch_folder);
        let path = names.file("journal");
        let mut locked = lock(&path)?;
        if locked.is_none() {
            // Who lists unfinished builds holds the lock for a moment.
            std::thread::sleep(GLANCE);
            locked = lock(&path)?;
        }
        let file = locked.ok_or_else(|| busy(output))?;
        let now = Header::new(output, resume, options);
        let found = Header::read(&file);
        let (every, due) = (resume.every, Instant::now() + resume.every);
        let output = output.to_path_buf();
        let mut journal = Journal { output, names, file, every, due, has_record: false, is_kept: false };
        match found {
            Some(found) if found == now => {}
            Some(found) => {
                return Err(journal.refuse(found.differences(&now)));
            }
            None => {
                journal.names.clear();
                let failed = |e| Error::writing("write the journal", &path, &e);
                let header = serde_json::to_vec(&now).expect("headers are plain data");
                let file = &journal.file;
                file.set_len(0).and_then(|()| file.write_all_at(&header, 0)).map_err(failed)?;
                file.sync_all().map_err(failed)?;
            }
        }
        Ok(Some(journal))
    }

    /// That a build is not the one that left what is here, which stays.
    pub(super) fn refuse(&mut self, differences: String) -> Error {
        self.is_kept = true;
        Error::new(Code::Usage, "an unfinished build of this output is of something else")
            .at(&self.output)
            .numbers(differences)
            .next("build with the same input and options, or remove it with trex build --clean")
    }

    /// Whether the files that the input names are what they were when it was read.
    ///
    /// # Errors
    /// [`Code::Usage`] where one is not.
    pub(super) fn compare_named(&mut self, read: &SourceStats) -> Result<()> {
        let changed = read.named_files.iter().filter_map(|(path, then)| {
            let path = Path::new(OsStr::from_bytes(path));
            let now = stamp(path);
            (now != *then).then(|| format!("{path:?}: {then} then, {now} now"))
        });
        match changed.collect::<Vec<String>>() {
            changed if changed.is_empty() => Ok(()),
            changed => Err(self.refuse(changed.join("; "))),
        }
    }

    /// Removes a record that there is nothing to go on from by, before the files that it speaks of are written anew.
    pub(super) fn forget(&self, ending: &str) -> Result<()> {
        let path = self.path(ending);
        if !path.exists() {
            return Ok(());
        }
        std::fs::remove_file(&path).map_err(|e| Error::writing("remove a record", &path, &e))?;
        let synced = File::open(self.folder()).and_then(|folder| folder.sync_all());
        synced.map_err(|e| Error::writing("write the folder to the disk", self.folder(), &e))
    }

    /// Path of the file of an ending.
    pub(super) fn path(&self, ending: &str) -> PathBuf {
        self.names.file(ending)
    }

    /// The folder of the records.
    pub(super) fn folder(&self) -> &Path {
        &self.names.folder
    }

    /// Whether a record is due.
    pub(super) fn is_due(&self) -> bool {
        Instant::now() >= self.due
    }

    /// A record that was begun at `begin` is written.
    pub(super) fn written(&mut self, begin: Instant) {
        self.has_record = true;
        self.postpone(begin);
    }

    /// No record is due for a while, since that of a moment begun at `begin` is written or cannot be.
    pub(super) fn postpone(&mut self, begin: Instant) {
        self.due = Instant::now() + self.every.max((begin.elapsed() * PAUSE).min(self.every * PAUSE_MOST));
    }

    /// Leaves all files for the next build; gives their bytes on disk.
    pub(super) fn keep(&mut self) -> u64 {
        self.is_kept = true;
        bytes_of(&self.names)
    }
}

impl Drop for Journal {
    fn drop(&mut self) {
        if !self.is_kept {
            self.names.clear();
            let _ = std::fs::remove_file(self.names.file("journal"));
        }
    }
}

/// Bytes that the files take on disk.
pub(super) fn bytes_of(names: &Names) -> u64 {
    names.all().iter().filter_map(|path| path.metadata().ok()).map(|found| found.blocks() * 512).sum()
}

/// The journal `path`, made where there is none, and locked; `None` where somebody else holds the lock.
pub(super) fn lock(path: &Path) -> Result<Option<File>> {
    let failed = |e| Error::writing("open the journal", path, &e);
    for _ in 0..LOCK_TRIES {
        let file = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path);
        let file = file.map_err(failed)?;
        match retry_on_intr(|| flock(&file, FlockOperation::NonBlockingLockExclusive)) {
            Ok(()) => {}
            Err(Errno::WOULDBLOCK) => return Ok(None),
            Err(error) => {
                // Without locks nobody holds it.
                if file.metadata().is_ok_and(|found| found.len() == 0) {
                    let _ = std::fs::remove_file(path);
                }
                return Err(Error::writing("lock the journal", path, &error.into())
                    .next("this file system may have no locks: add --no-resume"));
            }
        }
        // Who held the lock may have removed the file since it was opened.
        let ours = file.metadata().map_err(failed)?;
        if path.metadata().is_ok_and(|found| (found.dev(), found.ino()) == (ours.dev(), ours.ino())) {
            return Ok(Some(file));
        }
    }
    Ok(None)
}

/// The error of an output that somebody else builds.
pub(super) fn busy(output: &Path) -> Error {
    Error::new(Code::Usage, "another build of this output is at work")
        .at(output)
        .next("wait for its end, or name another output with -o")
}
