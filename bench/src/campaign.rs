//! `Campaign`: a folder in which points are run once, each by a process of its own, and kept.
//!
//! ```text
//! FOLDER/points.jsonl    what it is of, then a line a point: its command and what came of it
//! FOLDER/NAME.exr        pictures that points are compared with
//! ```
//!
//! Invariants: 1. a line stands where its point was run to its end: what is stopped goes on with the next; 2. lines of
//! another subject are told, never mixed with; 3. no process outlives the campaign.

use anyhow::Context;
use rustix::process::{Pid, Signal, kill_process};
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fmt::Debug;
use std::fs::{self, File, OpenOptions};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant, UNIX_EPOCH};
use trex_store::{Budget, Code, Error, Interrupt, Result};

/// Longest that an interrupt waits for a process to be ended.
const POLL: Duration = Duration::from_millis(5);
/// Endings of what is built first.
const MESHES: [&str; 5] = ["ply", "obj", "stl", "gltf", "glb"];

/// A file of a campaign as it was when it began, or the name of a generator's mesh.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct Input {
    pub(crate) name: String,
    /// Length and time of change; zeros for a generator.
    bytes: u64,
    changed_s: u64,
}

impl Input {
    /// The input that is named so.
    ///
    /// # Errors
    /// There is no such file.
    pub(crate) fn named(name: &str) -> Result<Input> {
        let mut input = Input { name: name.to_owned(), bytes: 0, changed_s: 0 };
        if !name.starts_with("gen:") {
            let path = Path::new(name);
            let about = fs::metadata(path).map_err(|error| Error::io("open", path, &error))?;
            let changed = about.modified().ok().and_then(|time| time.duration_since(UNIX_EPOCH).ok());
            (input.bytes, input.changed_s) = (about.len(), changed.map_or(0, |since| since.as_secs()));
        }
        Ok(input)
    }

    /// True for what is built before it is looked at.
    pub(crate) fn is_mesh(&self) -> bool {
        let ending = Path::new(&self.name).extension().map(|ending| ending.to_ascii_lowercase());
        let is_of = |mesh: &&str| ending.as_ref().is_some_and(|ending| ending == *mesh);
        self.name.starts_with("gen:") || MESHES.iter().any(is_of)
    }
}

/// What a campaign needs beside its options.
pub struct Around<'a> {
    /// The ledger; processes get what it has left.
    pub budget: &'a Budget,
    /// Ends it; what is done is kept.
    pub interrupt: &'a Interrupt,
    /// Hears what is done, and of how much.
    pub tell: &'a dyn Fn(u64, u64),
}

impl Around<'_> {
    /// Bytes that a process may take.
    pub(crate) fn left_bytes(&self) -> u64 {
        self.budget.limit_bytes() - self.budget.used_bytes() - trex_store::RESERVE_BYTES
    }
}

/// The campaign.
pub(crate) struct Campaign<'a> {
    /// The command itself.
    pub(crate) program: &'a Path,
    pub(crate) folder: &'a Path,
    pub(crate) interrupt: &'a Interrupt,
    kept: BTreeMap<String, Value>,
}

/// What a process said, and how long it took from its start to its end.
#[derive(Debug)]
pub(crate) struct Ran {
    pub(crate) document: Value,
    pub(crate) wall: Duration,
}

#[derive(Serialize, Deserialize)]
struct JournalLine<T> {
    key: String,
    value: T,
}

impl<'a> Campaign<'a> {
    /// Opens `folder`, or begins it.
    ///
    /// # Errors
    /// [`Code::InputMismatch`] for a folder of another subject; those of the folder.
    pub(crate) fn open<S: Serialize + DeserializeOwned + PartialEq + Debug>(
        program: &'a Path,
        folder: &'a Path,
        subject: &S,
        interrupt: &'a Interrupt,
    ) -> anyhow::Result<Campaign<'a>> {
        fs::create_dir_all(folder).map_err(|error| Error::writing("make the folder", folder, &error))?;
        let mut campaign = Campaign { program, folder, interrupt, kept: BTreeMap::new() };
        let path = campaign.log();
        if !path.exists() {
            campaign.append(&serde_json::to_string(subject)?)?;
            return Ok(campaign);
        }
        let text = fs::read_to_string(&path).map_err(|error| Error::io("read", &path, &error))?;
        let mut lines = text.lines();
        let there: Option<S> = lines.next().and_then(|line| serde_json::from_str(line).ok());
        if there.as_ref() != Some(subject) {
            let there = there.map_or_else(|| "something else".into(), |there| format!("{there:?}"));
            return Err(Error::new(Code::InputMismatch, "this folder is of another campaign")
                .at(&path)
                .numbers(format!("asked: {subject:?}; there: {there}"))
                .next("name another folder, or remove this one")
                .into());
        }
        // A last line that a kill has cut is no line.
        for line in lines {
            if let Ok(JournalLine { key, value }) = serde_json::from_str(line) {
                campaign.kept.insert(key, value);
            }
        }
        Ok(campaign)
    }

    fn log(&self) -> PathBuf {
        self.folder.join("points.jsonl")
    }

    fn append(&self, line: &str) -> anyhow::Result<()> {
        let path = self.log();
        let appended = OpenOptions::new().create(true).append(true).open(&path).and_then(|mut file| {
            file.write_all(format!("{line}\n").as_bytes())?;
            file.sync_data()
        });
        Ok(appended.map_err(|error| Error::writing("write", &path, &error))?)
    }

    /// What came of `key`, from before or from `run`.
    pub(crate) fn once<T: Serialize + DeserializeOwned>(
        &mut self,
        key: &str,
        run: impl FnOnce(&Campaign<'a>) -> anyhow::Result<T>,
    ) -> anyhow::Result<T> {
        if let Some(value) = self.kept.get(key)
            && let Ok(value) = serde_json::from_value(value.clone())
        {
            return Ok(value);
        }
        let value = run(self)?;
        let line = JournalLine { key: key.to_owned(), value: serde_json::to_value(&value)? };
        // What was cut has no end of line: an own one is no harm.
        self.append(&serde_json::to_string(&line)?)?;
        self.kept.insert(line.key, line.value);
        Ok(value)
    }

    /// Runs the command with `words` and `--json`. A refusal is a document like any other.
    pub(crate) fn trex(&self, words: &[String]) -> anyhow::Result<Ran> {
        self.interrupt.check()?;
        let start = Instant::now();
        let mut command = Command::new(self.program);
        command.args(words).args(["--json", "-q"]);
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::null());
        let mut child = command.spawn().map_err(|error| Error::io("start", self.program, &error))?;
        let mut pipe = child.stdout.take().expect("its output is piped");
        let read_all = move || {
            let mut text = String::new();
            pipe.read_to_string(&mut text).map(|_| text)
        };
        let reader = std::thread::Builder::new().name("trex-read-document".into()).spawn(read_all);
        let reader = reader.map_err(|error| {
            // It would wait for ever for somebody who reads what it says.
            let _ = child.kill().and_then(|()| child.wait());
            Error::thread_refused("the reader of a run's document", &error)
        })?;
        let status = loop {
            if let Some(status) = child.try_wait()? {
                break status;
            }
            if self.interrupt.is_raised() {
                // It may have been told already, by the terminal; it takes away what it has begun.
                let _ = kill_process(Pid::from_child(&child), Signal::TERM);
                child.wait()?;
                return Err(Error::interrupted().into());
            }
            std::thread::sleep(POLL);
        };
        let wall = start.elapsed();
        let text = reader.join().expect("reading does not panic")?;
        self.interrupt.check()?;
        let document = serde_json::from_str(&text)
            .with_context(|| format!("trex {} ended with {status} and no document", words.join(" ")))?;
        Ok(Ran { document, wall })
    }

    /// A picture that is made once.
    pub(crate) fn picture(&self, name: &str, words: &[String]) -> anyhow::Result<PathBuf> {
        let path = self.folder.join(name);
        if !File::open(&path).is_ok_and(|file| file.metadata().is_ok_and(|about| about.len() > 0)) {
            let output = ["-o".to_owned(), path.display().to_string()];
            let ran = self.trex(&[words, &output].concat())?;
            if let Some(refusal) = refusal(&ran.document) {
                return Err(refusal.into());
            }
        }
        Ok(path)
    }
}

/// The error that a document tells, as an error again.
pub(crate) fn refusal(document: &Value) -> Option<Error> {
    let text = |key: &str| document[key].as_str().unwrap_or_default().to_owned();
    if !text("schema").starts_with("trex.error/") {
        return None;
    }
    let code = match document["code"].as_str() {
        Some("memory-limit") => Code::MemoryLimit,
        Some("disk-full") => Code::DiskFull,
        Some("interrupted") => Code::Interrupted,
        Some("io") => Code::Io,
        _ => Code::SceneFormat,
    };
    let said = Error::new(code, text("what")).at_place(text("where")).numbers(text("numbers"));
    Some(said.next(text("next_step")))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn subject() -> (Input, u32) {
        (Input { name: "a.trex".into(), bytes: 5, changed_s: 7 }, 9)
    }

    #[test]
    fn what_is_built_first_is_known_by_its_name() {
        let named = |name: &str| Input { name: name.into(), bytes: 0, changed_s: 0 };
        for (name, is_mesh) in [
            ("gen:pipes:1M", true),
            ("a/B.PLY", true),
            ("a.glb", true),
            ("a.trex", false),
            ("a.toml", false),
            ("ply", false),
        ] {
            assert_eq!(named(name).is_mesh(), is_mesh, "{name}");
        }
    }

    #[test]
    fn what_was_run_is_not_run_again() {
        let inside = tempfile::tempdir().unwrap();
        let interrupt = Interrupt::default();
        let open =
            |subject: &(Input, u32)| Campaign::open(Path::new("none"), inside.path(), subject, &interrupt);
        let mut first = open(&subject()).unwrap();
        assert_eq!(first.once("a", |_| Ok(3)).unwrap(), 3);
        assert!(first.once("b", |_| -> anyhow::Result<i32> { anyhow::bail!("no") }).is_err());
        // A kill in the middle of a line.
        first.append("{\"key\":\"b\",\"va").unwrap();
        let mut again = open(&subject()).unwrap();
        assert_eq!(again.once("a", |_| -> anyhow::Result<i32> { panic!("it is there") }).unwrap(), 3);
        assert_eq!(again.once("b", |_| Ok(4)).unwrap(), 4);

        let other = (subject().0, 10);
        let error = open(&other).err().unwrap();
        assert_eq!(error.downcast_ref::<Error>().unwrap().code(), Code::InputMismatch);
    }
}
