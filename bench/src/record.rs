//! `Record`: one measured run, a line of JSON in `bench/record/NAME.jsonl`.
//!
//! Invariants: 1. files only grow, at their end; 2. a record carries what is needed to run it again (command,
//! scene, seed, machine, commit); 3. a value's key ends in its unit, as in the verbs' documents it comes from;
//! 4. the map is ordered, so the same run gives the same line.

use crate::machine::{self, Machine};
use anyhow::{Context, bail, ensure};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs::{self, OpenOptions};
use std::io::Write;
use std::path::{Path, PathBuf};

/// Longest name of a record.
const MAX_NAME: usize = 64;

/// Keys of a verb's document that become fields of the record, not values.
const ENVELOPE: [&str; 6] = ["schema", "command", "version", "scene", "seed", "result_hash"];
/// Keys of a verb's document that are as long as the run was: its figures sum them up.
const LOGS: [&str; 2] = ["per_switch", "points"];

/// One run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Record {
    /// What was measured: `build-iso-20m`. The docs ask for records by it.
    pub name: String,
    /// The command line.
    pub command: String,
    /// The model or scene; empty when the command says it.
    pub scene: String,
    /// Seed of what was sampled or generated, if any.
    pub seed: Option<u64>,
    /// Where.
    pub machine: Machine,
    /// Of what: the commit, see [`machine::commit`].
    pub commit: String,
    /// When: `YYYY-MM-DD`, UTC.
    pub date: String,
    /// Hash of the result (file id, picture), which says that two runs did the same work.
    pub result_hash: Option<String>,
    /// The figures: dotted keys with units (`phase_ms.generate`), scalar values.
    pub values: BTreeMap<String, Value>,
}

/// What a document does not say about its run.
#[derive(Clone, Debug, Default)]
pub struct Labels {
    /// Name of the record.
    pub name: String,
    /// Overrides the document's `command`.
    pub command: Option<String>,
    /// Overrides the document's `scene`.
    pub scene: Option<String>,
    /// Overrides the document's `seed`.
    pub seed: Option<u64>,
    /// Where it ran, if not here.
    pub machine: Option<Machine>,
}

impl Record {
    /// A record of the run that printed `document` (the `--json` output of a verb), on this machine unless the
    /// labels name another, from the checkout at `root`.
    ///
    /// # Errors
    /// The document is no object, reports a failure, or names no command; [`machine::commit`] refuses the checkout.
    pub fn from_document(document: &Value, labels: Labels, root: &Path) -> anyhow::Result<Record> {
        let Some(object) = document.as_object() else { bail!("the document is not a JSON object") };
        let text = |key: &str| object.get(key).and_then(Value::as_str).map(str::to_owned);
        let schema = text("schema").unwrap_or_default();
        ensure!(!schema.starts_with("trex.error/"), "the run failed: {document}");
        check_name(&labels.name)?;

        let mut values = BTreeMap::new();
        for (key, value) in object {
            if !ENVELOPE.contains(&key.as_str()) && !LOGS.contains(&key.as_str()) {
                flatten(key, value, &mut values);
            }
        }
        ensure!(!values.is_empty(), "the document holds no figures");
        values.values_mut().for_each(strip_folders);
        let command = labels.command.or_else(|| text("command")).context("no command: pass --command")?;
        let scene = labels.scene.or_else(|| text("scene")).unwrap_or_default();
        Ok(Record {
            command: without_folders(&command),
            scene: without_folders(&scene),
            seed: labels.seed.or_else(|| object.get("seed").and_then(Value::as_u64)),
            machine: labels.machine.unwrap_or_else(Machine::here),
            commit: machine::commit(root)?,
            date: machine::today(),
            result_hash: text("result_hash"),
            name: labels.name,
            values,
        })
    }
}

/// `{"a":{"b":1},"c":[2,3]}` to `a.b = 1`, `c.0 = 2`, `c.1 = 3`; nulls are left out.
fn flatten(key: &str, value: &Value, into: &mut BTreeMap<String, Value>) {
    match value {
        Value::Object(object) => {
            object.iter().for_each(|(inner, value)| flatten(&format!("{key}.{inner}"), value, into));
        }
        Value::Array(items) => {
            items.iter().enumerate().for_each(|(at, value)| flatten(&format!("{key}.{at}"), value, into));
        }
        Value::Null => {}
        scalar => {
            into.insert(key.to_owned(), scalar.clone());
        }
    }
}

/// `/home/ann/out/a.trex` to `a.trex`: where files lie on the machine of a run is no part of its record.
fn without_folders(text: &str) -> String {
    let name = |word: &str| {
        // `--output=/home/ann/a.png`, too.
        let at = word.find("=/").map_or(0, |at| at + 1);
        let (before, path) = word.split_at(at);
        let is_path = path.starts_with('/') && path.len() > 1;
        let kept = if is_path { path.trim_end_matches('/').rsplit('/').next().unwrap_or(path) } else { path };
        format!("{before}{kept}")
    };
    text.split(' ').map(name).collect::<Vec<_>>().join(" ")
}

fn strip_folders(value: &mut Value) {
    if let Value::String(text) = value {
        *text = without_folders(text);
    }
}

/// Names are file names everywhere: lower-case letters, digits, dashes.
fn check_name(name: &str) -> anyhow::Result<()> {
    let good = name.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-');
    ensure!(
        good && !name.is_empty() && name.len() <= MAX_NAME,
        "record name {name:?}: accepted are 1 to {MAX_NAME} of a-z, 0-9 and -"
    );
    Ok(())
}

/// The folder of records below the checkout's root.
pub fn folder(root: &Path) -> PathBuf {
    root.join("bench/record")
}

/// Appends a record to its file; gives the file's path.
///
/// # Errors
/// The name is refused, or the file cannot be written.
pub fn append(root: &Path, record: &Record) -> anyhow::Result<PathBuf> {
    check_name(&record.name)?;
    let path = folder(root).join(format!("{}.jsonl", record.name));
    let line = serde_json::to_string(record)? + "\n";
    let write = || {
        fs::create_dir_all(folder(root))?;
        // One write call, so that two runs that end together cannot mix their lines.
        OpenOptions::new().create(true).append(true).open(&path)?.write_all(line.as_bytes())
    };
    write().with_context(|| format!("cannot append to {}", path.display()))?;
    Ok(path)
}

/// All records below `root`, in order of file name and line.
///
/// # Errors
/// A file cannot be read, or a line is no record; path and line are named.
pub fn read_all(root: &Path) -> anyhow::Result<Vec<Record>> {
    let folder = folder(root);
    let mut files = Vec::new();
    for entry in fs::read_dir(&folder).with_context(|| format!("cannot read {}", folder.display()))? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "jsonl") {
            files.push(path);
        }
    }
    files.sort();
    let mut records = Vec::new();
    for path in files {
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
            let place = || format!("{}:{}: not a record", path.display(), index + 1);
            records.push(serde_json::from_str(line).with_context(place)?);
        }
    }
    Ok(records)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn labels(name: &str) -> Labels {
        Labels { name: name.into(), ..Labels::default() }
    }

    #[test]
    fn a_document_becomes_a_line_and_comes_back() {
        let root = tempfile::tempdir().unwrap();
        let document = json!({
            "schema": "trex.build/1", "command": "trex build gen:soup:1k -o a.trex", "version": "0.1.0", "seed": 7,
            "triangle_count": 1000, "phase_ms": {"scan": 1.5, "emit": null}, "mean": [0.1, 0.2], "io_backend": "uring",
        });
        let record = Record::from_document(&document, labels("build-soup"), root.path()).unwrap();
        assert_eq!(record.command, "trex build gen:soup:1k -o a.trex");
        assert_eq!(record.seed, Some(7));
        let keys: Vec<_> = record.values.keys().map(String::as_str).collect();
        assert_eq!(keys, ["io_backend", "mean.0", "mean.1", "phase_ms.scan", "triangle_count"]);

        append(root.path(), &record).unwrap();
        append(root.path(), &record).unwrap();
        assert_eq!(read_all(root.path()).unwrap(), [record.clone(), record]);
    }

    /// Records once held the home folders of who made them.
    #[test]
    fn folders_of_the_machine_are_left_out() {
        let root = tempfile::tempdir().unwrap();
        let document = json!({
            "command": "trex render /home/ann/iso.trex -o=/tmp/work/a.png --memory-limit 1GiB gen:soup:1k a/b.trex",
            "scene": "/home/ann/iso.trex", "output": "/tmp/work/a.png",
            "io_backend": "io_uring, /dev/nvme0 with O_DIRECT", "rate": "3 a/s", "time_ms": 1,
        });
        let record = Record::from_document(&document, labels("x"), root.path()).unwrap();
        assert_eq!(record.command, "trex render iso.trex -o=a.png --memory-limit 1GiB gen:soup:1k a/b.trex");
        assert_eq!((record.scene.as_str(), &record.values["output"]), ("iso.trex", &json!("a.png")));
        assert_eq!(record.values["io_backend"], json!("io_uring, nvme0 with O_DIRECT"));
        assert_eq!(record.values["rate"], json!("3 a/s"));
        let line = serde_json::to_string(&record).unwrap();
        assert!(!line.contains("ann") && !line.contains("work"), "{line}");
    }

    #[test]
    fn what_is_no_run_is_refused() {
        let root = tempfile::tempdir().unwrap();
        for (document, name, why) in [
            (json!([1]), "x", "not a JSON object"),
            (json!({"schema": "trex.error/1", "command": "c", "code": "io"}), "x", "failed"),
            (json!({"command": "c"}), "x", "no figures"),
            (json!({"a_ms": 1}), "x", "no command"),
            (json!({"command": "c", "a_ms": 1}), "../x", "accepted are"),
            (json!({"command": "c", "a_ms": 1}), "", "accepted are"),
        ] {
            let error = Record::from_document(&document, labels(name), root.path()).unwrap_err().to_string();
            assert!(error.contains(why), "{document}: {error}");
        }
    }

    #[test]
    fn a_bad_line_is_named() {
        let root = tempfile::tempdir().unwrap();
        fs::create_dir_all(folder(root.path())).unwrap();
        fs::write(folder(root.path()).join("a.jsonl"), "\n{\"name\":1}\n").unwrap();
        let error = read_all(root.path()).unwrap_err().to_string();
        assert!(error.contains("a.jsonl:2"), "{error}");
    }
}
