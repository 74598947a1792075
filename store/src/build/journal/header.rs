//! `JournalHeader`: what a journal says of its build: output, folder of scratch, and all that the bytes depend on.

use crate::build::options::{BuildOptions, Resume};
use crate::layout::VERSION;
use serde::{Deserialize, Serialize};
use std::ffi::OsStr;
use std::fs::File;
use std::io::Read;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

/// Says that a file is a journal, and of which form.
const FORMAT: &str = "trex-journal/4";
/// Longest journal: names and numbers of inputs.
const JOURNAL_BYTES: u64 = 64 << 20;

/// What a journal says.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct JournalHeader {
    format: String,
    /// Name of the output as the system writes it.
    pub(crate) output: Vec<u8>,
    /// Full path of the folder of scratch; empty for that of the output.
    scratch_folder: Vec<u8>,
    /// What the bytes of the output depend on, by name.
    facts: Vec<(String, String)>,
}

impl JournalHeader {
    pub(super) fn new(output: &Path, resume: &Resume, options: &BuildOptions) -> JournalHeader {
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
        JournalHeader {
            format: FORMAT.into(),
            output: output.file_name().unwrap_or_default().as_bytes().to_vec(),
            scratch_folder: scratch_folder.as_os_str().as_bytes().to_vec(),
            facts,
        }
    }

    /// Reads an open journal; `None` for anything else.
    pub(crate) fn read(mut file: &File) -> Option<JournalHeader> {
        let mut bytes = Vec::new();
        Read::by_ref(&mut file).take(JOURNAL_BYTES).read_to_end(&mut bytes).ok()?;
        serde_json::from_slice(&bytes).ok().filter(|header: &JournalHeader| header.format == FORMAT)
    }

    /// The folder of scratch, for an output in `folder`.
    pub(crate) fn scratch_folder<'a>(&'a self, folder: &'a Path) -> &'a Path {
        match self.scratch_folder.as_slice() {
            [] => folder,
            given => Path::new(OsStr::from_bytes(given)),
        }
    }

    /// The facts that differ from those of `now`, as words.
    pub(super) fn differences(&self, now: &JournalHeader) -> String {
        let value = |header: &JournalHeader, name: &str| {
            let found = header.facts.iter().find(|fact| fact.0 == name);
            found.map_or("none".to_owned(), |fact| fact.1.clone())
        };
        let mut names: Vec<&str> = self.facts.iter().chain(&now.facts).map(|fact| fact.0.as_str()).collect();
        names.dedup();
        let mut lines: Vec<String> = Vec::new();
        for name in names {
            let (then, now) = (value(self, name), value(now, name));
            let line = format!("{name}: {then} then, {now} now");
            if then != now && !lines.contains(&line) {
                lines.push(line);
            }
        }
        lines.join("; ")
    }
}
