//! The repository checks its words: libraries name no flags of the command, and a type name stands in one file.
//!
//! Each test lists every violation at once, as `path:line: why`; crates are covered by a list, which grows.

use crate::tidy::{files, none};
use std::collections::{BTreeMap, BTreeSet};

/// Library crates whose strings name no flag and no verb of the command. Other crates are added once theirs do not.
const FLAGLESS: [&str; 6] =
    ["store/src/", "datasets-gen/src/", "render/src/", "image/src/", "model/src/", "view/src/"];
/// Verbs of the command.
const VERBS: [&str; 8] = ["build", "render", "view", "info", "verify", "gen", "demo", "image"];
/// Crates in which no type name stands in two files. Other crates are added once none of theirs does.
const ONE_NAME_ONE_FILE: [&str; 2] = ["store/src/", "model/src/"];

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

/// A reader who looks for a type finds one. Names that tests give count, too; types of a trait's `impl` do not.
#[test]
fn no_type_name_in_two_files_of_a_crate() {
    for (line, name) in [
        ("pub(in crate::build) struct Run<'a> {", Some("Run")),
        ("pub enum Code {", Some("Code")),
        ("struct Run(u32);", Some("Run")),
        ("let struct_of = x;", None),
        ("pub(crate) fn open(type: u32) -> Run {", None),
    ] {
        assert_eq!(declared_type(line), name, "{line}");
    }
    let sources = files("rs");
    let mut bad = Vec::new();
    for folder in ONE_NAME_ONE_FILE {
        let mut files_of: BTreeMap<&str, BTreeSet<&str>> = BTreeMap::new();
        for source in sources.iter().filter(|source| source.is_in(folder)) {
            let names = source.code().filter(|(_, line)| !line.starts_with("    type "));
            for name in names.filter_map(|(_, line)| declared_type(line)) {
                files_of.entry(name).or_default().insert(&source.path);
            }
        }
        for (name, paths) in files_of.iter().filter(|(_, paths)| paths.len() > 1) {
            bad.push(format!("{name}: {}", paths.iter().copied().collect::<Vec<_>>().join(", ")));
        }
    }
    none(bad);
}
