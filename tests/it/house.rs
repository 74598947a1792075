//! The house keeps its shape: no file imports in a circle, and each floor of the renderer and of the build imports
//! the floors that are listed before it only.
//!
//! ```text
//! file -> its `use` lines and inline paths -> the file that defines the name (through re-exports) -> arrows
//! ```
//!
//! A re-export (`pub use`, `pub(crate) use`) is a signpost, not an arrow: who names the thing in the end counts.
//! Tests at a file's end, and files of tests, are left aside.

mod floors;

use floors::{HOUSES, House};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The crates whose files are looked at, by folder.
const CRATES: [&str; 10] =
    ["store", "datasets-gen", "film", "render", "gpu", "view", "image", "model", "bench", "."];
/// Circles that stay: a type whose methods fill several files, which all need it.
const ONE_TYPE: [&[&str]; 1] = [
    // Eight lanes of registers, set up, entered and refined: what is inlined into the kernel stands in its drawer.
    &[
        "render/src/trace/simd/avx2.rs",
        "render/src/trace/simd/avx2/enter.rs",
        "render/src/trace/simd/avx2/refine.rs",
    ],
];
/// Re-exports that lead to re-exports, at most.
const SIGNPOSTS_MAX: usize = 8;

/// A source file of a crate.
struct SourceFile {
    /// Relative to the root.
    path: String,
    /// Its module path below the crate.
    module: Vec<String>,
    /// Without comments and tests.
    code: String,
}

/// The files of a crate, by module path.
struct Crate {
    files: BTreeMap<Vec<String>, SourceFile>,
}

/// A path that a file names, and whether it only hands it on.
struct PathUse {
    segments: Vec<String>,
    is_signpost: bool,
}

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

impl Crate {
    fn read(folder: &str) -> Crate {
        let src = root().join(folder).join("src");
        let mut files = BTreeMap::new();
        for path in rust_files(&src) {
            let below = path.strip_prefix(&src).unwrap().with_extension("");
            let mut module: Vec<String> =
                below.iter().map(|part| part.to_string_lossy().into_owned()).collect();
            if ["mod", "lib", "main"].contains(&module.last().unwrap().as_str()) {
                module.pop();
            }
            let is_tests = module.iter().any(|part| part == "tests" || part == "testing");
            let shown = path.strip_prefix(root()).unwrap().to_string_lossy().replace('\\', "/");
            if !is_tests {
                let code = shipped(&fs::read_to_string(&path).unwrap());
                // The binary of a crate with a library is a file of its own.
                files.entry(module.clone()).or_insert(SourceFile { path: shown, module, code });
            }
        }
        assert!(!files.is_empty(), "{folder} has no files: the walk is broken");
        Crate { files }
    }

    /// The module of the file that defines what `segments`, seen from `from`, name; `None` for other crates and locals.
    fn definer(&self, from: &[String], segments: &[String], depth: usize) -> Option<Vec<String>> {
        let mut at = from.to_vec();
        let mut rest = segments;
        match rest.first()?.as_str() {
            "crate" => {
                at.clear();
                rest = &rest[1..];
            }
            "self" => rest = &rest[1..],
            "super" => {
                while rest.first().is_some_and(|part| part == "super") {
                    at.pop()?;
                    rest = &rest[1..];
                }
            }
            child => {
                at.push(child.to_owned());
                if !self.files.contains_key(&at) {
                    return None;
                }
                rest = &rest[1..];
            }
        }
        while let Some(part) = rest.first() {
            at.push(part.clone());
            if !self.files.contains_key(&at) {
                at.pop();
                break;
            }
            rest = &rest[1..];
        }
        let file = self.files.get(&at)?;
        let name = rest.first().filter(|_| depth < SIGNPOSTS_MAX);
        let onward = name.and_then(|name| {
            let named = file.named();
            let mut posts = named.iter().filter(|named| named.is_signpost);
            let post = posts.find(|post| post.segments.last() == Some(name))?;
            self.definer(&at, &post.segments, depth + 1)
        });
        Some(onward.unwrap_or(at))
    }

    /// Who imports whom, by module.
    fn arrows(&self) -> BTreeMap<&[String], BTreeSet<Vec<String>>> {
        let arrows_of = |file: &SourceFile| {
            let named = file.named().into_iter().filter(|named| !named.is_signpost);
            let defined = named.filter_map(|named| self.definer(&file.module, &named.segments, 0));
            defined.filter(|module| *module != file.module).collect()
        };
        self.files.values().map(|file| (file.module.as_slice(), arrows_of(file))).collect()
    }
}

impl SourceFile {
    /// All paths that the file names.
    fn named(&self) -> Vec<PathUse> {
        let mut all = Vec::new();
        let mut rest = self.code.as_str();
        while let Some(at) = rest.find("use ") {
            let line = rest[..at].rfind('\n').map_or(0, |end| end + 1);
            let before = rest[line..at].trim();
            let end = rest[at..].find(';').map_or(rest.len(), |end| at + end);
            if before.is_empty() || before.starts_with("pub") {
                let text: String = rest[at + 4..end].split_whitespace().collect::<Vec<_>>().join(" ");
                spread(&text, &[], &mut |segments| {
                    all.push(PathUse { segments, is_signpost: before.starts_with("pub") });
                });
                rest = &rest[end..];
            } else {
                rest = &rest[at + 4..];
            }
        }
        for start in ["crate::", "super::"] {
            for (at, _) in self.code.match_indices(start) {
                let is_whole = !self.code[..at].ends_with(|c: char| c.is_alphanumeric() || "_:".contains(c));
                let word = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
                let path: String = self.code[at..].chars().take_while(|&c| word(c)).collect();
                let in_use = self.code[..at].rfind([';', '}', '{']).map_or(0, |end| end + 1);
                if is_whole && !self.code[in_use..at].contains("use ") {
                    let segments =
                        path.split("::").filter(|part| !part.is_empty()).map(str::to_owned).collect();
                    all.push(PathUse { segments, is_signpost: false });
                }
            }
        }
        all
    }
}

/// Calls `tell` with each path of a use tree: `a::{b, c::d}` is `a::b` and `a::c::d`.
fn spread(tree: &str, above: &[String], tell: &mut impl FnMut(Vec<String>)) {
    let tree = tree.trim();
    let (head, inner) = match tree.find('{') {
        Some(open) => (&tree[..open], Some(&tree[open + 1..tree.rfind('}').unwrap_or(tree.len())])),
        None => (tree.split(" as ").next().unwrap(), None),
    };
    let mut path = above.to_vec();
    path.extend(
        head.split("::").map(str::trim).filter(|part| !part.is_empty() && *part != "*").map(str::to_owned),
    );
    let Some(inner) = inner else {
        if path.last().is_some_and(|last| last == "self") && path.len() > 1 {
            path.pop();
        }
        return tell(path);
    };
    let (mut depth, mut from) = (0, 0);
    for (at, c) in inner.char_indices().chain([(inner.len(), ',')]) {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            ',' if depth == 0 => {
                if !inner[from..at].trim().is_empty() {
                    spread(&inner[from..at], &path, tell);
                }
                from = at + 1;
            }
            _ => {}
        }
    }
}

/// A file's text without comments, and without the tests at its end.
fn shipped(text: &str) -> String {
    let tests_at = text.find("\n#[cfg(test)]\nmod tests {").unwrap_or(text.len());
    let lines = text[..tests_at].lines().map(|line| line.split("//").next().unwrap_or_default());
    lines.collect::<Vec<_>>().join("\n")
}

fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let mut folders = vec![folder.to_path_buf()];
    let mut files = Vec::new();
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|ending| ending == "rs") {
                files.push(path);
            }
        }
    }
    files.sort();
    files
}

/// The circles of a graph: sets of nodes that reach each other.
fn circles(arrows: &BTreeMap<&[String], BTreeSet<Vec<String>>>) -> BTreeSet<BTreeSet<Vec<String>>> {
    let reach = |from: &[String]| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![from.to_vec()]);
        while let Some(at) = open.pop() {
            for next in arrows.get(at.as_slice()).into_iter().flatten() {
                if seen.insert(next.clone()) {
                    open.push(next.clone());
                }
            }
        }
        seen
    };
    let reached: BTreeMap<&[String], BTreeSet<Vec<String>>> =
        arrows.keys().map(|&module| (module, reach(module))).collect();
    let around = reached.iter().filter(|(module, all)| all.contains(**module));
    around
        .map(|(module, all)| {
            let back =
                |other: &&Vec<String>| reached.get(other.as_slice()).is_some_and(|r| r.contains(*module));
            all.iter().filter(back).cloned().collect()
        })
        .collect()
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let mut found = Vec::new();
    for folder in CRATES {
        let files = Crate::read(folder);
        for circle in circles(&files.arrows()) {
            let names: Vec<_> = circle.iter().map(|module| files.files[module].path.as_str()).collect();
            if ONE_TYPE.contains(&names.as_slice()) {
                continue;
            }
            found.push(format!("{} files in a circle: {}", names.len(), names.join(", ")));
        }
    }
    assert!(found.is_empty(), "\n{}\n", found.join("\n"));
}

/// Arrows of a house that lead up, as a sentence each.
fn arrows_up(house: &House, files: &Crate) -> Vec<String> {
    let floor = |module: &[String]| {
        let name = module.get(house.folder.len())?;
        let at = house.floors.iter().position(|floor| floor == name);
        Some(at.unwrap_or_else(|| panic!("{}/{name} stands on no floor: add it", house.of_crate)))
    };
    let is_inside = |module: &[String]| {
        let above = module.iter().zip(house.folder);
        module.len() >= house.folder.len() && above.into_iter().all(|(part, folder)| part == folder)
    };
    let mut found = Vec::new();
    for (from, targets) in files.arrows().into_iter().filter(|(from, _)| is_inside(from)) {
        let Some(here) = floor(from) else { continue };
        for to in targets.iter().filter(|to| is_inside(to)) {
            if floor(to).is_none_or(|there| there > here) {
                found.push(format!("{} imports {}", files.files[from].path, files.files[to].path));
            }
        }
    }
    found
}

#[test]
fn each_floor_imports_those_listed_before_it() {
    let found: Vec<_> =
        HOUSES.iter().flat_map(|house| arrows_up(house, &Crate::read(house.of_crate))).collect();
    assert!(found.is_empty(), "against the floors:\n{}\n", found.join("\n"));
}

#[test]
fn arrows_up_are_found_within_a_folder() {
    let file = |module: &[&str], code: &str| {
        let module: Vec<String> = module.iter().map(|part| (*part).to_owned()).collect();
        (module.clone(), SourceFile { path: module.join("/"), module, code: code.to_owned() })
    };
    let files = Crate {
        files: BTreeMap::from([
            file(&[], ""),
            file(&["outside"], "use crate::build::upper::Up;"),
            file(&["build"], "use lower::Low;\nuse upper::Up;"),
            file(&["build", "lower"], "use crate::outside::Thing;\nuse crate::build::upper::Up;"),
            file(&["build", "upper"], "use super::lower::Low;\nuse super::Recipe;"),
        ]),
    };
    let house = House { of_crate: "a crate", folder: &["build"], floors: &["lower", "upper"] };
    assert_eq!(arrows_up(&house, &files), ["build/lower imports build/upper", "build/upper imports build"]);
}

/// `#[cfg(test)] mod tests;` among the modules of a `mod.rs` once counted as the end of what is shipped: nothing that
/// the file imports was looked at.
#[test]
fn only_tests_written_out_end_what_is_shipped() {
    let text =
        "mod a;\n#[cfg(test)]\nmod tests;\nuse a::A; // why\n#[cfg(test)]\nmod tests {\nuse super::*;\n}";
    assert_eq!(shipped(text), "mod a;\n#[cfg(test)]\nmod tests;\nuse a::A; ");
}

#[test]
fn paths_are_followed_to_who_defines_the_name() {
    let file = |module: &[&str], code: &str| {
        let module: Vec<String> = module.iter().map(|part| (*part).to_owned()).collect();
        (module.clone(), SourceFile { path: module.join("/"), module, code: code.to_owned() })
    };
    let files = Crate {
        files: BTreeMap::from([
            file(&[], "pub use a::Thing;\nmod a;"),
            file(&["a"], "pub(crate) use inner::{Thing, Other as Else};"),
            file(&["a", "inner"], "use crate::b::{self, more::{Deep, Flat}};\nstruct Thing;"),
            file(&["b"], "fn f() -> super::a::Thing {}"),
            file(&["b", "more"], "use std::fmt;\nuse super::helper;"),
        ]),
    };
    let arrows = files.arrows();
    let names = |module: &[&str]| {
        let module: Vec<String> = module.iter().map(|part| (*part).to_owned()).collect();
        arrows[module.as_slice()].iter().map(|to| to.join("/")).collect::<Vec<_>>()
    };
    assert_eq!(names(&["a"]), [""; 0]);
    assert_eq!(names(&["a", "inner"]), ["b", "b/more"]);
    assert_eq!(names(&["b"]), ["a/inner"]);
    assert_eq!(names(&["b", "more"]), ["b"]);
    let found = circles(&arrows);
    assert_eq!(found.len(), 1);
    assert_eq!(found.first().unwrap().len(), 3);
}
