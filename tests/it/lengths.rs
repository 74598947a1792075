//! The code stays short, that of the viewer's page included: lines, functions, files, and the renderer as a whole.

use crate::tidy::{Source, files, none, root};

/// Longest file: past this it is two files.
const MAX_FILE_LINES: usize = 800;
/// Lines of code of the renderer, shaders included: it stays readable in a day. Tests and comments do not count: a
/// bound should speak against neither.
const MAX_RENDER_LINES: usize = 14_000;
/// Longest function, its closing line included: it fits a screen.
const MAX_FUNCTION_LINES: usize = 80;
/// Longest line, comments and documentation included.
const MAX_COLUMNS: usize = 120;
/// Files that may be longer than most, and why each is one noun all the same.
const LONG_FILES: [(&str, &str); 2] = [
    ("bench/src/peers/embree.rs", "the declarations of a C library, and the one contender that they serve"),
    (
        "render/src/trace/simd/avx2.rs",
        "one kernel, whose three tests share the registers that they are set up in",
    ),
];
/// Bytes of the page of figures: read aloud in five minutes. All rows are on another.
const MAX_PERFORMANCE_BYTES: usize = 12 << 10;
/// From here on a file is long.
const LONG_FILE_LINES: usize = 400;
#[test]
fn files_stay_short_and_the_renderer_compact() {
    let shaders_and_code =
        || ["rs", "wgsl"].into_iter().filter(|e| *e == "rs" || has_shaders()).flat_map(files);
    none(shaders_and_code().filter_map(|source| {
        let lines = source.text.lines().count();
        let may_be_long = LONG_FILES.iter().any(|(path, _)| *path == source.path);
        let most = if may_be_long { MAX_FILE_LINES } else { LONG_FILE_LINES };
        (lines > most).then(|| format!("{}: {lines} lines, at most {most}", source.path))
    }));
    none(page_files().filter_map(|source| {
        let lines = source.text.lines().count();
        let is_long = lines > LONG_FILE_LINES;
        is_long.then(|| format!("{}: {lines} lines, at most {LONG_FILE_LINES}", source.path))
    }));
    let sources = files("rs");
    none(LONG_FILES.iter().filter_map(|(path, _)| {
        let lines = sources.iter().find(|source| source.path == *path).map(|s| s.text.lines().count());
        let is_long = lines.is_some_and(|lines| lines > LONG_FILE_LINES);
        (!is_long).then(|| format!("{path} is not long any more: take it off the list"))
    }));
    // The renderer's own tests use `testing.rs`, and its examples are documentation.
    let is_shipped = |path: &str| path.starts_with("render/src/") && path != "render/src/testing.rs";
    let inside = shaders_and_code().filter(|source| is_shipped(&source.path));
    // Lines of code, as cloc and tokei count them: without comments and without blank ones.
    let is_code = |(_, line): &(usize, &str)| !line.trim().is_empty();
    let lines: usize = inside.map(|source| source.shipped_code().filter(is_code).count()).sum();
    assert!(lines < MAX_RENDER_LINES, "render/ has {lines} lines, allowed are fewer than {MAX_RENDER_LINES}");
}

#[test]
fn the_page_of_figures_is_short() {
    let pages = files("md");
    let page = pages.iter().find(|page| page.path == "docs/performance.md").expect("there is such a page");
    let bytes = page.text.len();
    assert!(
        bytes <= MAX_PERFORMANCE_BYTES,
        "docs/performance.md: {bytes} bytes, at most {MAX_PERFORMANCE_BYTES}"
    );
}

#[test]
fn lines_fit_and_functions_fit_a_screen() {
    let mut bad = Vec::new();
    for source in files("rs").iter().chain(&page_files().collect::<Vec<_>>()) {
        for (at, line) in source.text.lines().enumerate() {
            let columns = line.chars().count();
            if columns > MAX_COLUMNS {
                bad.push(format!("{}:{}: {columns} columns, at most {MAX_COLUMNS}", source.path, at + 1));
            }
        }
    }
    for source in files("rs") {
        let functions = function_lengths(&source.text);
        let long = functions.iter().filter(|(_, _, lines)| *lines > MAX_FUNCTION_LINES);
        bad.extend(long.map(|(name, at, lines)| format!("{}:{at}: {name} has {lines} lines", source.path)));
    }
    none(bad);
}

/// Name, first line (from 1) and count of lines of each function whose body is a block of its own: rustfmt closes it at
/// the indentation where it began.
fn function_lengths(text: &str) -> Vec<(&str, usize, usize)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut found = Vec::new();
    for (at, line) in lines.iter().enumerate() {
        let code = line.trim_start();
        let words = ["pub ", "pub(crate) ", "pub(super) ", "const ", "unsafe ", "extern \"C\" "];
        let mut rest = code;
        while let Some(cut) = words.iter().find_map(|word| rest.strip_prefix(word)) {
            rest = cut;
        }
        if let Some(inside) = rest.strip_prefix("pub(in ") {
            rest = inside.split_once(") ").map_or(rest, |(_, rest)| rest);
        }
        let Some(name) = rest.strip_prefix("fn ") else { continue };
        let name = name.split(|c: char| !c.is_alphanumeric() && c != '_').next().unwrap_or_default();
        let indent = &line[..line.len() - code.len()];
        let closes = |line: &&str| line.strip_prefix(indent) == Some("}");
        let ends = |line: &&str| {
            line.starts_with(indent) && line.ends_with(';') && !line[indent.len()..].starts_with(' ')
        };
        // A declaration or a body on the same line has no block.
        if line.ends_with(';') || line.ends_with('}') {
            continue;
        }
        let end = lines[at + 1..].iter().position(|line| closes(line) || ends(line));
        found.push((name, at + 1, end.map_or(1, |end| end + 2)));
    }
    found
}

#[test]
fn functions_are_measured() {
    let (inner, body) = ("        x();\n".repeat(3), "    x();\n".repeat(3));
    let text = format!(
        "impl A {{\n    pub(crate) fn one(&self) {{\n{inner}    }}\n}}\nfn two();\n\
         const fn three(\n    a: u8,\n) {{\n{body}}}\n"
    );
    assert_eq!(function_lengths(&text), [("one", 2, 5), ("three", 9, 7)]);
}

/// The viewer's page: scripts, styles and markup.
fn page_files() -> impl Iterator<Item = Source> {
    ["js", "css", "html"].into_iter().flat_map(files)
}

fn has_shaders() -> bool {
    root().join("render/src/gpu/shaders").is_dir()
}
