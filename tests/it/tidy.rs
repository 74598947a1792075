//! The repository checks itself: who may name whom, how large a file may grow, where unsafe stands.
//!
//! Each test lists every violation at once, as `path:line: why`. A rule that has to give way is changed here, in
//! the open, with the reason beside it.

use std::fs;
use std::path::{Path, PathBuf};

/// Crates and the crates of ours that each may name. One way: store <- film <- render <- gpu; store <- {datasets-gen,
/// image}; all of these <- {view, model} <- {bench <- trex, python}.
const MAY_NAME: [(&str, &[&str]); 11] = [
    ("store", &[]),
    ("datasets-gen", &["trex-store"]),
    ("film", &["trex-store"]),
    ("render", &["trex-store", "trex-film"]),
    ("gpu", &["trex-store", "trex-render"]),
    ("view", &["trex-store", "trex-render"]),
    ("image", &["trex-store"]),
    // Its examples and tests build what they open.
    ("model", &["trex-store", "trex-render", "trex-gpu", "trex-view", "datasets-gen"]),
    ("python", &["trex-store", "trex-render", "trex-view", "datasets-gen", "trex-model"]),
    ("bench", &["trex-store", "datasets-gen", "trex-render", "trex-image", "trex-model"]),
    (
        ".",
        &[
            "trex-store",
            "datasets-gen",
            "trex-render",
            "trex-gpu",
            "trex-view",
            "trex-image",
            "trex-model",
            "trex-bench",
        ],
    ),
];
/// All of them.
const OUR_CRATES: [&str; 10] = [
    "trex-store",
    "datasets-gen",
    "trex-film",
    "trex-render",
    "trex-gpu",
    "trex-view",
    "trex-image",
    "trex-model",
    "trex-bench",
    "trex",
];
/// Files that may hold `unsafe`: what they do cannot be said otherwise. Each opens with why it is sound.
const UNSAFE_FILES: [&str; 25] = [
    // Memory that the kernel writes to, and mappings.
    "store/src/io/mmap.rs",
    "bench/src/page_io/mapped.rs",
    "store/src/io/region.rs",
    "store/src/io/uring.rs",
    // Frames that readers share while the clock takes them away.
    "store/src/pool/clock.rs",
    "store/src/pool/frames.rs",
    "store/src/pool/loader.rs",
    "store/src/pool/loom_tests.rs",
    "store/src/pool/pin.rs",
    // A loop compiled for AVX2 as well.
    "film/src/coarse/neighbours.rs",
    // Intrinsics, beside their scalar twin.
    "store/src/cluster/cells.rs",
    "store/src/cluster/fields.rs",
    "store/src/cluster/finish.rs",
    "store/src/cluster/frame.rs",
    "store/src/cluster/unpack.rs",
    "render/src/trace/simd/avx2.rs",
    "render/src/trace/simd/avx2/enter.rs",
    "render/src/trace/simd/avx2/refine.rs",
    "render/src/trace/simd/avx2/tests.rs",
    "render/src/trace/simd/entry.rs",
    "render/src/trace/simd/packet.rs",
    "render/src/voxel/simd/avx2.rs",
    "render/src/voxel/simd/avx512.rs",
    // Shaders whose loops the driver's compiler does not bound.
    "gpu/src/kernels.rs",
    // A C library as a peer, behind a feature.
    "bench/src/peers/embree.rs",
];
/// How far above its block a SAFETY comment may begin.
const SAFETY_REACH: usize = 8;

/// A source file of the repository.
pub(crate) struct Source {
    /// Path relative to the root, with `/`.
    pub(crate) path: String,
    pub(crate) text: String,
}

impl Source {
    /// Lines that are no comment, numbered from 1.
    pub(crate) fn code(&self) -> impl Iterator<Item = (usize, &str)> {
        numbered(&self.text)
    }

    /// As [`Self::code`], up to the tests at the file's end; nothing of a file that is all tests.
    pub(crate) fn shipped_code(&self) -> impl Iterator<Item = (usize, &str)> {
        let all_tests = self.path.contains("/tests/") || self.path.ends_with("tests.rs");
        let tests_at = self.text.find("\n#[cfg(test)]\nmod tests").unwrap_or(self.text.len());
        let end = if all_tests { 0 } else { tests_at };
        numbered(&self.text[..end])
    }

    pub(crate) fn is_in(&self, folder: &str) -> bool {
        self.path.starts_with(folder)
    }

    /// True for code of the library crates: what others may embed.
    fn is_library(&self) -> bool {
        [
            "store/src/",
            "datasets-gen/src/",
            "film/src/",
            "render/src/",
            "gpu/src/",
            "view/src/",
            "image/src/",
            "model/src/",
            "bench/src/",
        ]
        .iter()
        .any(|folder| self.is_in(folder))
            && !["bench/src/main.rs", "bench/src/workload.rs"].contains(&self.path.as_str())
    }
}

fn numbered(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines()
        .enumerate()
        .map(|(at, line)| (at + 1, line))
        .filter(|(_, line)| !line.trim_start().starts_with("//"))
}

pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(path: &str) -> String {
    fs::read_to_string(root().join(path)).unwrap_or_else(|error| panic!("{path}: {error}"))
}

/// All files below the root whose name ends in `.extension`, build outputs left out, sorted.
pub(crate) fn files(extension: &str) -> Vec<Source> {
    let mut folders = vec![root().to_path_buf()];
    let mut paths: Vec<PathBuf> = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy();
            let skipped = ["target", "out", ".git"].contains(&name.as_ref());
            if path.is_dir() && !path.is_symlink() && !skipped {
                folders.push(path);
            } else if path.extension().is_some_and(|found| found == extension) {
                paths.push(path);
            }
        }
    }
    paths.sort();
    let source = |path: PathBuf| Source {
        path: path.strip_prefix(root()).unwrap().to_string_lossy().replace('\\', "/"),
        text: fs::read_to_string(&path).unwrap(),
    };
    let sources: Vec<Source> = paths.into_iter().map(source).collect();
    assert!(!sources.is_empty(), "no .{extension} file: the walk is broken");
    sources
}

/// Fails with all violations, if any.
#[track_caller]
pub(crate) fn none(violations: impl IntoIterator<Item = String>) {
    let violations: Vec<String> = violations.into_iter().collect();
    assert!(violations.is_empty(), "\n{}\n", violations.join("\n"));
}

/// Lines of `code` that hold one of `words`.
fn holding<'a>(
    path: &'a str,
    code: impl Iterator<Item = (usize, &'a str)> + 'a,
    words: &'a [&'a str],
) -> impl Iterator<Item = String> + 'a {
    code.flat_map(move |(number, line)| {
        words
            .iter()
            .filter(move |word| line.contains(**word))
            .map(move |word| format!("{path}:{number}: `{word}` has no place here"))
    })
}

#[test]
fn manifests_depend_one_way() {
    none(MAY_NAME.iter().flat_map(|(folder, may)| {
        let path = format!("{folder}/Cargo.toml");
        let mut section = String::new();
        let mut bad = Vec::new();
        for (number, line) in read(&path).lines().enumerate() {
            if line.starts_with('[') {
                section = line.to_owned();
            }
            let key = line.split([' ', '.', '=']).next().unwrap_or_default();
            // The list of all dependencies of the workspace is no use of them.
            let counts = section.contains("dependencies") && !section.starts_with("[workspace");
            if counts && OUR_CRATES.contains(&key) && !may.contains(&key) {
                bad.push(format!("{path}:{}: must not depend on {key}", number + 1));
            }
        }
        bad
    }));
}

#[test]
fn code_names_crates_one_way() {
    let sources = files("rs");
    none(MAY_NAME.iter().filter(|(folder, _)| *folder != ".").flat_map(|(folder, may)| {
        let banned: Vec<String> = OUR_CRATES
            .iter()
            .filter(|name| **name != "trex" && !may.contains(name) && !own_crate(folder, name))
            .map(|name| name.replace('-', "_"))
            .collect();
        let words: Vec<&str> = banned.iter().map(String::as_str).collect();
        let inside = format!("{folder}/");
        let found = sources.iter().filter(|source| source.is_in(&inside));
        found
            .flat_map(|source| holding(&source.path, source.code(), &words).collect::<Vec<_>>())
            .collect::<Vec<_>>()
    }));
}

fn own_crate(folder: &str, name: &str) -> bool {
    name == folder || name.strip_prefix("trex-") == Some(folder)
}

#[test]
fn the_renderer_knows_no_files() {
    let sources = files("rs");
    // `Path` is a name: errors of scenes carry one.
    let words = ["std::fs", "use std::{fs", "File::open", "File::create"];
    let render = sources.iter().filter(|source| source.is_in("render/src/") || source.is_in("film/src/"));
    none(render.flat_map(|source| holding(&source.path, source.shipped_code(), &words)));
}

/// The viewer knows a session and sockets; what it needs of files it is given.
#[test]
fn the_viewer_knows_no_files() {
    let sources = files("rs");
    let words = ["std::fs", "use std::{fs", "File::open", "File::create", "trex_store::PageFile", "PagePool"];
    let view = sources.iter().filter(|source| source.is_in("view/src/"));
    none(view.flat_map(|source| holding(&source.path, source.shipped_code(), &words)));
}

#[test]
fn libraries_do_not_print_exit_or_read_the_environment() {
    let sources = files("rs");
    let words = [
        "println!",
        "print!(",
        "io::stdout",
        "io::stderr",
        "process::exit",
        "process::abort",
        "env::var",
        "env::args",
        "env::temp_dir",
        "env::current_dir",
        "static mut",
    ];
    let library = sources.iter().filter(|source| source.is_library());
    none(library.flat_map(|source| holding(&source.path, source.shipped_code(), &words)));
}

#[test]
fn unsafe_stands_in_listed_files_and_says_why() {
    let sources = files("rs");
    // Split, so that this file does not name what it looks for.
    let openings = ["{", "fn ", "impl ", "extern "].map(|what| format!("{}safe {what}", "un"));
    let mut bad = Vec::new();
    for source in &sources {
        let lines: Vec<&str> = source.text.lines().collect();
        let found =
            source.code().filter(|(_, line)| openings.iter().any(|opening| line.contains(opening.as_str())));
        for (number, line) in found {
            if !UNSAFE_FILES.contains(&source.path.as_str()) {
                bad.push(format!("{}:{number}: unsafe code outside of the listed files", source.path));
            }
            let above = &lines[number.saturating_sub(SAFETY_REACH + 1)..number];
            let explained = above.iter().any(|line| line.contains("// SAFETY:"));
            let promises = line.contains(openings[1].as_str());
            if !explained && !promises {
                bad.push(format!("{}:{number}: no `// SAFETY:` above", source.path));
            }
        }
    }
    none(bad);
}

#[test]
fn every_file_opens_with_what_it_is() {
    let opens = |source: &Source| source.text.starts_with("//! ");
    none(
        files("rs")
            .iter()
            .filter(|source| !opens(source))
            .map(|s| format!("{}:1: opens without `//!`", s.path)),
    );
}

#[test]
fn nothing_is_left_for_later() {
    let sources = files("rs");
    let words = [
        concat!("to", "do!("),
        concat!("db", "g!("),
        concat!("unimpl", "emented!("),
        concat!("#[ig", "nore]"),
    ];
    none(sources.iter().flat_map(|source| holding(&source.path, source.code(), &words)));
}

#[test]
fn the_figures_of_the_docs_come_from_the_records() {
    let stale = trex_bench::docs::stale(root()).unwrap_or_else(|error| panic!("{error:#}"));
    assert!(stale.is_empty(), "{stale:?}: run `cargo run --release -p trex-bench -- docs`");
}

#[test]
fn ci_runs_what_the_readme_says() {
    let (readme, ci) = (read("README.md"), read(".ci/run"));
    for command in ["cargo test --workspace", "cargo run --release -- demo"] {
        assert!(readme.contains(command), "README.md does not say `{command}`");
    }
    assert!(ci.contains("cargo test --workspace"), ".ci/run does not run the README's test command");
}

#[test]
fn files_that_pages_and_comments_name_are_there() {
    let folders = [
        "store/",
        "datasets-gen/",
        "film/",
        "render/",
        "gpu/",
        "view/",
        "image/",
        "bench/",
        "src/",
        "tests/",
        "fuzz/",
        "python/",
        "docs/",
    ];
    let mut bad = Vec::new();
    for page in files("md").into_iter().chain(files("rs")) {
        for (number, line) in page.text.lines().enumerate() {
            let is_prose = page.path.ends_with(".md") || line.trim_start().starts_with("//");
            let quoted = line.split('`').skip(1).step_by(2).filter(|_| is_prose);
            let named = quoted.filter(|word| folders.iter().any(|folder| word.starts_with(folder)));
            let missing = named.filter(|word| {
                let is_file = [".rs", ".md", ".sh", ".toml"].iter().any(|ending| word.ends_with(ending));
                // A crate may name its own files from its folder, or from its `src`, on.
                let own = page.path.split_once('/').map_or(root().into(), |(folder, _)| root().join(folder));
                let exists = [root().to_path_buf(), own.clone(), own.join("src")];
                is_file
                    && !word.contains(['*', '{', ' '])
                    && !exists.iter().any(|from| from.join(word).exists())
            });
            bad.extend(missing.map(|word| format!("{}:{}: there is no {word}", page.path, number + 1)));
        }
    }
    none(bad);
}

#[test]
fn links_between_pages_lead_somewhere() {
    let mut bad = Vec::new();
    for page in files("md") {
        let folder = root().join(&page.path).parent().unwrap().to_path_buf();
        for (number, line) in page.text.lines().enumerate() {
            for (at, _) in line.match_indices("](") {
                let target = line[at + 2..].split([')', '#']).next().unwrap_or_default();
                // Pictures are made by commands; those of docs/ are checked with the records.
                let is_picture = line[..at].rfind('[').is_some_and(|open| line[..open].ends_with('!'));
                if !is_picture
                    && !target.is_empty()
                    && !target.contains("://")
                    && !folder.join(target).exists()
                {
                    bad.push(format!("{}:{}: {target} does not exist", page.path, number + 1));
                }
            }
        }
    }
    none(bad);
}
