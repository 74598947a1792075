//! The commands that the README and the pages of `docs/` tell people to type: each is run, in order, and must end well.
//!
//! ```text
//! page -> blocks of ```sh -> lines that begin with `trex ` or `cargo run --release -- `, made small -> exit status 0
//! ```
//!
//! A page's commands share a folder, so that one may use what another wrote. Models are made small and samples few;
//! sizes of pictures and memory limits stay as they are written. A block that cannot run has its reason above it, in
//! words: `<!-- not run: REASON -->`.

use crate::command::{TREX, folder, trex_in};
use crate::tidy::{files, root};
use std::io::{BufRead, BufReader, Read};
use std::path::Path;
use std::process::{Command, Stdio};

/// Beginnings of lines that are run, and what the rest is handed to: `trex`.
const RUN: [&str; 2] = ["trex ", "cargo run --release -- "];
/// What stands above a block that is not run.
const NOT_RUN: &str = "<!-- not run:";
/// Triangles of models, where a page says millions.
const TRIANGLES: &str = "20k";
/// Flags that make a command quick, by its verb; no time is required of a machine that does other things, too.
const QUICK: [(&str, &str); 7] = [
    // No page writes its size, and its own takes 12 s of processor time.
    ("demo", "--triangles 20k --spp 1 --resolution 256x256"),
    ("render", "--spp 1 --photons 20k"),
    ("stress", "--switches 4 --hold 300 --resolution 96x72 --photons 20k --require frame.max=600000"),
    ("bench rays", "--rounds 1 --resolution 64x64"),
    ("bench io", "--rounds 1"),
    ("bench tradeoff", "--knobs quality --resolution 32x32 --reference-spp 2"),
    ("bench scale", "--switches 2 --resolution 96x72"),
];

/// The commands of a page, as they are written.
fn commands(page: &str) -> Vec<String> {
    let (mut found, mut above, mut is_run) = (vec![], "", None);
    let mut lines = page.lines();
    while let Some(line) = lines.next() {
        match is_run {
            None if line == "```sh" => is_run = Some(!above.starts_with(NOT_RUN)),
            None => above = if line.is_empty() { above } else { line },
            Some(_) if line == "```" => (is_run, above) = (None, ""),
            Some(is_run) => {
                let mut command = line.split(" #").next().unwrap().trim().to_owned();
                while let Some(begun) = command.strip_suffix('\\') {
                    command = format!("{}{}", begun.trim_end(), lines.next().expect("a line goes on"));
                }
                let rest = RUN.iter().find_map(|start| command.strip_prefix(start));
                found.extend(rest.filter(|_| is_run).map(str::to_owned));
            }
        }
    }
    found
}

/// The command with a small model and few samples.
fn small(command: &str) -> String {
    let is_millions = |word: &str| {
        word.strip_suffix('M').is_some_and(|digits| digits.bytes().all(|byte| byte.is_ascii_digit()))
    };
    let part = |part: &str| if is_millions(part) { TRIANGLES.to_owned() } else { part.to_owned() };
    let word = |word: &str| word.split(':').map(part).collect::<Vec<_>>().join(":");
    let small: Vec<String> = command.split_whitespace().map(word).collect();
    let small = small.join(" ");
    let quick = QUICK.iter().find(|(verb, _)| small.starts_with(verb)).map_or("", |(_, flags)| flags);
    format!("{small} {quick}")
}

/// Starts the viewer, waits until it says where its page is, and ends it as Ctrl-C does.
fn view(inside: &Path, line: &str) -> (Option<i32>, String) {
    let mut viewer = trex_in(inside, &format!("{line} --no-open"));
    let mut viewer = viewer.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
    let mut stderr = BufReader::new(viewer.stderr.take().unwrap());
    let mut said = String::new();
    while stderr.read_line(&mut said).unwrap() > 0 && !said.contains("#token=") {}
    let asked = Command::new("kill").args(["-INT", &viewer.id().to_string()]).status().unwrap();
    assert!(asked.success(), "{line} was gone: {said}");
    stderr.read_to_string(&mut said).unwrap();
    (viewer.wait().unwrap().code(), said)
}

#[test]
fn what_the_pages_say_to_type_works() {
    let pages = files("md");
    let is_for_users = |path: &str| path == "README.md" || path.starts_with("docs/");
    let mut count = 0;
    for page in pages.iter().filter(|page| is_for_users(&page.path)) {
        let inside = folder();
        for command in commands(&page.text) {
            count += 1;
            let line = small(&command);
            let (code, said) = if line.starts_with("view ") {
                view(inside.path(), &line)
            } else {
                let output = trex_in(inside.path(), &line).output().unwrap();
                (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
            };
            assert_eq!(code, Some(0), "{}: {command}, run as\n{TREX} {line}\n{said}", page.path);
        }
    }
    assert!(count >= 15, "only {count} commands were found");
}

/// A page once told people to render under a limit that the command refused.
#[test]
fn commands_are_found_and_made_small() {
    let page = "text\n```sh\ntrex gen scan --triangles 20M -o a.ply   # a note\ncargo run --release -- demo\nssh host\n\
                trex build gen:pipes:5M:7 \\\n    -o b.trex\n```\n<!-- not run: it needs a browser -->\n\n```sh\n\
                trex view b.trex\n```\n```toml\ntrex x\n```\n";
    let found = commands(page);
    assert_eq!(found, ["gen scan --triangles 20M -o a.ply", "demo", "build gen:pipes:5M:7    -o b.trex"]);
    assert_eq!(small(&found[2]).trim(), "build gen:pipes:20k:7 -o b.trex");
    assert_eq!(small("demo"), "demo --triangles 20k --spp 1 --resolution 256x256");
    assert!(
        small("render a.trex --memory-limit 256MiB")
            .starts_with("render a.trex --memory-limit 256MiB --spp 1")
    );
}

/// A promise without a test is a wish: each row of the list names files that are there. A name alone is beside the one
/// before it.
#[test]
fn promises_name_tests_that_are_there() {
    let page = std::fs::read_to_string(root().join("docs/reliability.md")).unwrap();
    let list = page.split_once("## The promises").unwrap().1;
    let rows: Vec<&str> =
        list.lines().filter(|line| line.starts_with("| ") && !line.contains("**")).skip(1).collect();
    assert!(rows.len() >= 36, "{} promises", rows.len());
    for row in rows {
        let mut folder = None;
        let names = row
            .split('`')
            .skip(1)
            .step_by(2)
            .filter(|name| [".rs", ".py"].iter().any(|end| name.ends_with(end)));
        let there = names.map(|name| {
            let path = match (name.contains('/'), &folder) {
                (false, Some(folder)) => root().join(folder).join(name),
                _ => root().join(name),
            };
            folder = folder.take().or(Path::new(name).parent().map(Path::to_path_buf));
            assert!(path.is_file(), "{row}: there is no {}", path.display());
        });
        assert!(there.count() > 0, "{row}: no test");
    }
}
