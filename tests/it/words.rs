//! The repository checks its words: libraries name no flags of the command, a type name stands in one file, and it is
//! a noun.
//!
//! Each test lists every violation at once, as `path:line: why`; crates are covered by a list, which grows.

use crate::tidy::{Source, files, none};
use std::collections::{BTreeMap, BTreeSet};

/// Library crates whose strings name no flag and no verb of the command. Other crates are added once theirs do not.
const FLAGLESS: [&str; 7] =
    ["store/src/", "datasets-gen/src/", "film/src/", "render/src/", "image/src/", "model/src/", "view/src/"];
/// Verbs of the command.
const VERBS: [&str; 9] = ["build", "render", "view", "info", "verify", "export", "gen", "demo", "image"];
/// Crates whose type names are nouns, and in which none stands in two files: all.
const NAMED_WELL: [&str; 12] = [
    "store/",
    "datasets-gen/",
    "film/",
    "image/",
    "model/",
    "render/",
    "view/",
    "bench/src/",
    "bench/benches/",
    "bench/view/",
    "src/",
    "tests/it/",
];
/// Nouns among the words that end as participles do.
const NOUNS: [&str; 11] = [
    "Backing", "Binning", "Encoding", "Feed", "Mapping", "Naming", "Packing", "Setting", "Speed", "Tracing",
    "Uring",
];
/// Participles of other endings.
const PARTICIPLES: [&str; 17] = [
    "Begun", "Done", "Given", "Gone", "Held", "Kept", "Known", "Left", "Made", "Put", "Said", "Seen", "Sent",
    "Shown", "Taken", "Told", "Written",
];

/// Whether words name a flag (`--flag`, `-o`) or a verb of the command (`trex build`).
fn names_command_line(words: &str) -> bool {
    let is_letter = |c: char| c.is_ascii_lowercase();
    let has_flag = words.match_indices("--").any(|(at, _)| words[at + 2..].starts_with(is_letter));
    let has_output = words.split([' ', ',', ';', ':', ')']).any(|word| word == "-o");
    let has_verb = words.match_indices("trex ").any(|(at, _)| {
        let verb = words[at + 5..].split(|c| !is_letter(c)).next().unwrap_or_default();
        VERBS.contains(&verb)
    });
    has_flag || has_output || has_verb
}

/// Errors of libraries told their users to give flags of our command. What the command says instead stands in
/// `src/next_step.rs`.
#[test]
fn libraries_do_not_speak_command_line() {
    assert!(names_command_line("raise --memory-limit") && names_command_line("name another with -o"));
    assert!(
        names_command_line("make one with `trex build`") && !names_command_line("a trex file -- or none")
    );
    let mut bad = Vec::new();
    for source in files("rs").iter().filter(|source| FLAGLESS.iter().any(|folder| source.is_in(folder))) {
        for (number, line) in source.shipped_code() {
            let strings = line.split('"').skip(1).step_by(2);
            let found = strings.filter(|words| names_command_line(words));
            bad.extend(
                found.map(|words| format!("{}:{number}: {words:?} names a flag or a verb", source.path)),
            );
        }
    }
    none(bad);
}

/// The name of the type that a line declares.
fn declared_type(line: &str) -> Option<&str> {
    let words = line.trim_start().strip_prefix("pub").map_or(line.trim_start(), |rest| {
        rest.trim_start_matches(|c| c != ' ' && c != '(').trim_start_matches('(')
    });
    let words = words
        .split_once(") ")
        .map_or(words, |(scope, rest)| if scope.contains(['<', '{', ';', '=']) { words } else { rest });
    let (kind, rest) = words.trim_start().split_once(' ')?;
    let name = rest.split(|c: char| !c.is_alphanumeric() && c != '_').next()?;
    let is_type = ["struct", "enum", "trait", "type", "union"].contains(&kind);
    (is_type && name.starts_with(|c: char| c.is_ascii_uppercase())).then_some(name)
}

/// The types that the files of a folder declare, those of tests too, each with its file and line. Types of a trait's
/// `impl` are the trait's.
fn declared_types<'a>(
    sources: &'a [Source],
    folder: &str,
) -> impl Iterator<Item = (&'a str, &'a Source, usize)> {
    sources.iter().filter(move |source| source.is_in(folder)).flat_map(|source| {
        let lines = source.code().filter(|(_, line)| !line.starts_with("    type "));
        lines.filter_map(move |(number, line)| Some((declared_type(line)?, source, number)))
    })
}

#[test]
fn a_declared_type_is_read_off_its_line() {
    for (line, name) in [
        ("pub(in crate::build) struct Run<'a> {", Some("Run")),
        ("pub enum Code {", Some("Code")),
        ("struct Run(u32);", Some("Run")),
        ("let struct_of = x;", None),
        ("pub(crate) fn open(type: u32) -> Run {", None),
    ] {
        assert_eq!(declared_type(line), name, "{line}");
    }
}

/// A reader who looks for a type finds one.
#[test]
fn no_type_name_in_two_files_of_a_crate() {
    let sources = files("rs");
    let mut bad = Vec::new();
    for folder in NAMED_WELL {
        let mut files_of: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for (name, source, _) in declared_types(&sources, folder) {
            files_of.entry(name).or_default().insert(&source.path);
        }
        assert!(!files_of.is_empty(), "{folder} declares no type: it has moved");
        for (name, paths) in files_of.iter().filter(|(_, paths)| paths.len() > 1) {
            bad.push(format!("{name}: {}", paths.iter().copied().collect::<Vec<_>>().join(", ")));
        }
    }
    none(bad);
}

/// Whether a type is named by what was done to a thing, or what it does, and not by what it is.
fn is_participle(name: &str) -> bool {
    let last_word = name.rfind(|c: char| c.is_ascii_uppercase()).map_or(name, |at| &name[at..]);
    let ends_as_one = last_word.ends_with("ed") || last_word.ends_with("ing");
    ends_as_one && !NOUNS.contains(&last_word) || PARTICIPLES.contains(&last_word)
}

/// `Settled` was a picture, `Served` the figures of a server, `Changed` a list of blocks: a signature that named one
/// said nothing of what it took.
#[test]
fn type_names_are_nouns() {
    assert!(is_participle("Settled") && is_participle("RaysMeasured") && is_participle("ToBeSent"));
    assert!(!is_participle("VertexPacking") && !is_participle("BoundedWriter") && !is_participle("Uring"));
    let sources = files("rs");
    let types = NAMED_WELL.iter().flat_map(|folder| declared_types(&sources, folder));
    let bad = types.filter(|(name, ..)| is_participle(name));
    none(bad.map(|(name, source, number)| format!("{}:{number}: {name} is no noun", source.path)));
}
