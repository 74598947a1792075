//! The repository checks its words: libraries name no flags of the command.
//!
//! Each test lists every violation at once, as `path:line: why`; crates are covered by a list, which grows.

use crate::tidy::{files, none};

/// Library crates whose strings name no flag and no verb of the command. Other crates are added once theirs do not.
const FLAGLESS: [&str; 4] = ["store/src/", "datasets-gen/src/", "render/src/", "image/src/"];
/// Verbs of the command.
const VERBS: [&str; 8] = ["build", "render", "view", "info", "verify", "gen", "demo", "image"];

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
