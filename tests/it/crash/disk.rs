//! A disk of one folder: what has been synced, and what has not; and the calls of a log of strace.
//!
//! Invariant: what a sync has promised is in every folder that `after_loss` gives.

use crate::random::Random;
use std::collections::BTreeMap;
use std::path::Path;

/// Bytes that a disk writes as a whole.
const SECTOR: usize = 512;

/// A change that a build asked for. Files go by their names at that time.
#[derive(Clone, Debug)]
pub(super) enum Op {
    /// Made, or emptied where it is there and that was asked for.
    Open {
        name: String,
        is_emptied: bool,
    },
    /// Bytes at an offset; `None`: behind what is there.
    Write {
        name: String,
        offset: Option<usize>,
        bytes: Vec<u8>,
    },
    /// Cut off, or filled up with zeros.
    Resize {
        name: String,
        length: usize,
    },
    /// A range given back: zeros.
    Punch {
        name: String,
        offset: usize,
        length: usize,
    },
    Sync(String),
    SyncFolder,
    Rename(String, String),
    Unlink(String),
}

/// What a loss of power leaves of what was not synced.
#[derive(Clone, Copy, Debug)]
pub(super) enum PowerLoss {
    Nothing,
    Everything,
    /// All names, no bytes; and the other way.
    Names,
    Bytes,
    /// Of each change all, nothing, or the first sectors, by a seed.
    Some(u64),
}

/// A change of a file's bytes.
#[derive(Clone)]
enum Change {
    Write(usize, Vec<u8>),
    Resize(usize),
}

/// A change of a name: where it leads then, if anywhere.
#[derive(Clone)]
enum NameChange {
    Set(String, usize),
    Move(String, String),
    Remove(String),
}

#[derive(Clone, Default)]
struct DiskFile {
    synced: Vec<u8>,
    /// What a reader sees.
    seen: Vec<u8>,
    pending: Vec<Change>,
}

/// The folder and its files.
#[derive(Clone, Default)]
pub(super) struct Disk {
    files: Vec<DiskFile>,
    synced: BTreeMap<String, usize>,
    seen: BTreeMap<String, usize>,
    pending: Vec<NameChange>,
}

impl Change {
    fn apply(&self, bytes: &mut Vec<u8>) {
        match self {
            Change::Write(offset, written) => {
                let end = offset + written.len();
                if bytes.len() < end {
                    bytes.resize(end, 0);
                }
                bytes[*offset..end].copy_from_slice(written);
            }
            Change::Resize(length) => bytes.resize(*length, 0),
        }
    }

    /// The part of it that was written first.
    fn torn(&self, random: &mut Random) -> Change {
        match self {
            Change::Write(offset, written) => {
                let sectors = random.below(written.len().div_ceil(SECTOR) as i64 + 1) as usize;
                Change::Write(*offset, written[..written.len().min(sectors * SECTOR)].to_vec())
            }
            whole => whole.clone(),
        }
    }
}

impl NameChange {
    fn apply(&self, names: &mut BTreeMap<String, usize>) {
        match self {
            NameChange::Set(name, file) => drop(names.insert(name.clone(), *file)),
            NameChange::Move(from, to) => {
                if let Some(file) = names.remove(from) {
                    names.insert(to.clone(), file);
                }
            }
            NameChange::Remove(name) => drop(names.remove(name)),
        }
    }
}

impl Disk {
    /// A disk with one file.
    pub(super) fn with(name: &str, bytes: Vec<u8>) -> Disk {
        let names = BTreeMap::from([(name.to_owned(), 0)]);
        let file = DiskFile { synced: bytes.clone(), seen: bytes, pending: Vec::new() };
        Disk { files: vec![file], synced: names.clone(), seen: names, pending: Vec::new() }
    }

    pub(super) fn apply(&mut self, op: &Op) {
        match op {
            Op::Open { name, is_emptied } => match self.seen.get(name) {
                Some(_) if *is_emptied => self.change(name, Change::Resize(0)),
                Some(_) => {}
                None => {
                    self.files.push(DiskFile::default());
                    self.rename(NameChange::Set(name.clone(), self.files.len() - 1));
                }
            },
            Op::Write { name, offset, bytes } => {
                let offset = offset.unwrap_or_else(|| self.files[self.seen[name]].seen.len());
                self.change(name, Change::Write(offset, bytes.clone()));
            }
            Op::Resize { name, length } => self.change(name, Change::Resize(*length)),
            Op::Punch { name, offset, length } => self.change(name, Change::Write(*offset, vec![0; *length])),
            Op::Sync(name) => {
                let file = &mut self.files[self.seen[name]];
                file.pending.clear();
                file.synced.clone_from(&file.seen);
            }
            Op::SyncFolder => {
                self.pending.clear();
                self.synced.clone_from(&self.seen);
            }
            Op::Rename(from, to) => self.rename(NameChange::Move(from.clone(), to.clone())),
            Op::Unlink(name) => self.rename(NameChange::Remove(name.clone())),
        }
    }

    fn change(&mut self, name: &str, change: Change) {
        let file = &mut self.files[self.seen[name]];
        change.apply(&mut file.seen);
        file.pending.push(change);
    }

    fn rename(&mut self, change: NameChange) {
        change.apply(&mut self.seen);
        self.pending.push(change);
    }

    /// What the folder holds after a loss of power.
    pub(super) fn after_loss(&self, kept: PowerLoss) -> BTreeMap<String, Vec<u8>> {
        let (has_names, has_bytes, seed) = match kept {
            PowerLoss::Nothing => (false, false, 0),
            PowerLoss::Everything => (true, true, 0),
            PowerLoss::Names => (true, false, 0),
            PowerLoss::Bytes => (false, true, 0),
            PowerLoss::Some(seed) => (true, true, seed),
        };
        let mut random = matches!(kept, PowerLoss::Some(_)).then(|| Random::seeded(seed));
        let mut names = self.synced.clone();
        for change in self.pending.iter().filter(|_| has_names) {
            if random.as_mut().is_none_or(|random| random.below(2) == 0) {
                change.apply(&mut names);
            }
        }
        let mut bytes_of = |file: &DiskFile| {
            let mut bytes = file.synced.clone();
            for change in file.pending.iter().filter(|_| has_bytes) {
                match random.as_mut().map(|random| (random.below(3), random)) {
                    None | Some((0, _)) => change.apply(&mut bytes),
                    Some((1, random)) => change.torn(random).apply(&mut bytes),
                    Some(_) => {}
                }
            }
            bytes
        };
        names.iter().map(|(name, file)| (name.clone(), bytes_of(&self.files[*file]))).collect()
    }
}

/// The calls of a log (`strace -f -y -xx`) that change what is in `folder`.
pub(super) fn ops_of(log: &str, folder: &Path) -> Vec<Op> {
    let mut unfinished: BTreeMap<&str, &str> = BTreeMap::new();
    let mut ops = Vec::new();
    for line in log.lines() {
        let (thread, call) = line.split_once(' ').unwrap();
        let call = call.trim_start();
        if let Some((begin, _)) = call.split_once(" <unfinished ...>") {
            unfinished.insert(thread, begin);
        } else if let Some((_, end)) = call.split_once(" resumed>") {
            let begin = unfinished.remove(thread).unwrap_or_default();
            ops.extend(op_of(&format!("{begin}{end}"), folder));
        } else {
            ops.extend(op_of(call, folder));
        }
    }
    ops
}

/// The change that one call asks for, if it went well.
fn op_of(call: &str, folder: &Path) -> Option<Op> {
    let (call, result) = call.rsplit_once(" = ")?;
    let (name, arguments) = call.split_once('(')?;
    let arguments = arguments.trim_end().strip_suffix(')')?;
    if result.starts_with('-') {
        return None;
    }
    let texts: Vec<Vec<u8>> = arguments.split('"').skip(1).step_by(2).map(unescaped).collect();
    // The file that a number stands for, and the file that a path leads to.
    let open = arguments.split_once('<').and_then(|(_, rest)| rest.split_once('>')).map(|(path, _)| path);
    let open = open.map(|path| String::from_utf8(unescaped(path)).unwrap());
    let here = |path: &str| {
        let path = Path::new(path);
        let parent =
            path.parent().filter(|parent| !parent.as_os_str().is_empty() && *parent != Path::new("."));
        let is_here = parent.is_none_or(|parent| parent == folder);
        // What has no name is gone with the power.
        let name = path.file_name()?.to_str().unwrap();
        (is_here && !name.starts_with('#')).then(|| name.to_owned())
    };
    let named = |at: usize| here(std::str::from_utf8(&texts[at]).unwrap());
    let number = |from_end: usize| arguments.rsplit(", ").nth(from_end)?.parse::<usize>().ok();
    let file = || here(open.as_deref().filter(|path| path.starts_with('/'))?);
    match name {
        "openat" if arguments.contains("O_CREAT") => {
            Some(Op::Open { name: named(0)?, is_emptied: arguments.contains("O_TRUNC") })
        }
        "write" => Some(Op::Write { name: file()?, offset: None, bytes: texts.concat() }),
        "pwrite64" => Some(Op::Write { name: file()?, offset: Some(number(0)?), bytes: texts.concat() }),
        "fsync" | "fdatasync" if open.as_deref().map(Path::new) == Some(folder) => Some(Op::SyncFolder),
        "fsync" | "fdatasync" => Some(Op::Sync(file()?)),
        "ftruncate" => Some(Op::Resize { name: file()?, length: number(0)? }),
        "fallocate" => Some(Op::Punch { name: file()?, offset: number(1)?, length: number(0)? }),
        "rename" | "renameat" | "renameat2" => Some(Op::Rename(named(0)?, named(1)?)),
        "unlink" | "unlinkat" => Some(Op::Unlink(named(0)?)),
        "link" | "linkat" => panic!("what a link does is not known here: {call}"),
        _ => None,
    }
}

/// The bytes of `\x61\x62`.
fn unescaped(text: &str) -> Vec<u8> {
    let digits = |pair: &[u8]| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap();
    text.as_bytes().chunks_exact(4).map(|escaped| digits(&escaped[2..])).collect()
}
