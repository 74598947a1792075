//! What comes into the build: licences and sources of all dependencies, as cargo itself lists them, against
//! `deny.toml`; and crates that are not to be there.

use crate::command::cannot_run;
use crate::tidy::root;
use serde_json::Value;
use std::process::Command;

/// Crates that the design rules out, each with what stands for it. Tests may hold answers against them.
const BANNED: [(&str, &str); 6] = [
    ("tokio", "few named threads"),
    ("object_store", "positioned reads"),
    ("opendal", "positioned reads"),
    ("gltf", "an importer that streams"),
    ("vtkio", "an importer that streams"),
    ("openusd", "an importer that streams"),
];

/// `deny.toml`, by the keys that are looked at here.
fn policy() -> toml::Table {
    std::fs::read_to_string(root().join("deny.toml")).unwrap().parse().unwrap()
}

fn strings(value: &toml::Value) -> Vec<&str> {
    value.as_array().unwrap().iter().map(|word| word.as_str().unwrap()).collect()
}

/// True when an SPDX expression can be met by `allowed`: one side of each OR, all sides of each AND.
fn is_met(expression: &str, allowed: &dyn Fn(&str) -> bool) -> bool {
    let (mut depth, mut parts, mut from) = (0, vec![], 0);
    let text = expression.trim();
    for word in [" OR ", "/", " AND "] {
        for (at, letter) in text.char_indices() {
            match letter {
                '(' => depth += 1,
                ')' => depth -= 1,
                _ if depth == 0 && text[at..].starts_with(word) => {
                    parts.push(&text[from..at]);
                    from = at + word.len();
                }
                _ => {}
            }
        }
        if !parts.is_empty() {
            parts.push(&text[from..]);
            return match word {
                " AND " => parts.iter().all(|part| is_met(part, allowed)),
                _ => parts.iter().any(|part| is_met(part, allowed)),
            };
        }
    }
    match text.strip_prefix('(').and_then(|text| text.strip_suffix(')')) {
        Some(inner) => is_met(inner, allowed),
        None => allowed(text),
    }
}

#[test]
fn expressions_are_met_by_one_side_of_or_and_all_of_and() {
    let allowed = |name: &str| ["MIT", "Zlib", "IJG"].contains(&name);
    for (expression, expected) in [
        ("MIT", true),
        ("GPL-3.0", false),
        ("GPL-3.0 OR MIT", true),
        ("GPL-3.0/MIT", true),
        ("(MIT OR GPL-3.0) AND IJG", true),
        ("(MIT OR GPL-3.0) AND GPL-3.0", false),
        ("MIT AND Zlib OR GPL-3.0", true),
        ("MIT AND GPL-3.0 OR BSD", false),
    ] {
        assert_eq!(is_met(expression, &allowed), expected, "{expression}");
    }
}

#[test]
fn what_comes_into_the_build_is_allowed() {
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    cargo.args(["metadata", "--format-version", "1", "--locked", "--all-features"]);
    cargo.args(["--filter-platform", "x86_64-unknown-linux-gnu"]).current_dir(root());
    let output = cargo.output().unwrap();
    if !output.status.success() {
        return cannot_run(&format!("cargo metadata: {}", String::from_utf8_lossy(&output.stderr)));
    }
    let policy = policy();
    let licences = &policy["licenses"];
    let (allowed, sources) = (strings(&licences["allow"]), strings(&policy["sources"]["allow-registry"]));
    let exceptions = licences["exceptions"].as_array().unwrap();
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let is_shipped = |kinds: &Value| kinds.as_array().unwrap().iter().any(|kind| kind["kind"] != "dev");
    let nodes = metadata["resolve"]["nodes"].as_array().unwrap().iter();
    let uses = nodes.flat_map(|node| node["deps"].as_array().unwrap());
    let shipped: Vec<&str> = uses
        .filter(|used| is_shipped(&used["dep_kinds"]))
        .map(|used| used["pkg"].as_str().unwrap())
        .collect();
    let (mut count, mut wrong) = (0, vec![]);
    for package in metadata["packages"].as_array().unwrap() {
        let name = package["name"].as_str().unwrap();
        let Some(source) = package["source"].as_str() else { continue };
        count += 1;
        let excepted = exceptions.iter().filter(|exception| exception["crate"].as_str() == Some(name));
        let excepted: Vec<&str> = excepted.flat_map(|exception| strings(&exception["allow"])).collect();
        let licence = package["license"].as_str().unwrap_or_default();
        if !is_met(licence, &|word| allowed.contains(&word) || excepted.contains(&word)) {
            wrong.push(format!("{name}: the licence {licence:?} is not in deny.toml"));
        }
        if !sources.iter().any(|allowed| source == format!("registry+{allowed}")) {
            wrong.push(format!("{name}: comes from {source}"));
        }
        let is_shipped = shipped.contains(&package["id"].as_str().unwrap());
        if let Some((_, instead)) = BANNED.iter().find(|(banned, _)| *banned == name && is_shipped) {
            wrong.push(format!("{name}: not to be used; instead: {instead}"));
        }
    }
    assert!(count > 100, "{count} dependencies: the list is broken");
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
