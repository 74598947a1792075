//! `trex view` without a browser: its address, its page, its end, and what it refuses. What it sends is tested in
//! `view/tests/`, what a person does with it in `browser.rs`.

use crate::command::{Ran, cannot_run, document_in, folder, hash_of, ran, run_in, trex_in};
use crate::faults::traced_folder;
use crate::fixtures::built_in;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};
use trex_store::{Budget, PageFile};
use tungstenite::{Message, WebSocket};

/// Longest wait for what has to come.
const PATIENCE: Duration = Duration::from_secs(120);
/// The kind of message that a file comes in.
pub(crate) const KIND_FILE: u8 = 3;
/// As many materials as a file may have, beside the one of triangles that name none.
const MATERIALS: usize = 65_535;

/// A viewer that runs.
pub(crate) struct ViewProcess {
    line: String,
    child: Child,
    /// Its address, with the token.
    address: String,
}

impl ViewProcess {
    #[track_caller]
    pub(crate) fn start(inside: &Path, line: &str) -> ViewProcess {
        let line = format!("view {line} --no-open --json");
        ViewProcess::start_as(trex_in(inside, &line), line)
    }

    /// A viewer that `command` becomes, which is that of `line`.
    #[track_caller]
    pub(crate) fn start_as(mut command: Command, line: String) -> ViewProcess {
        command.env_remove("SSH_CONNECTION");
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut said = String::new();
        BufReader::new(child.stderr.as_mut().unwrap()).read_line(&mut said).unwrap();
        ViewProcess { line, child, address: said.trim().to_owned() }
    }

    /// A socket that has said hello.
    pub(crate) fn page(&self) -> WebSocket<TcpStream> {
        self.try_page().unwrap()
    }

    /// The same; `None` where nobody answers.
    pub(crate) fn try_page(&self) -> Option<WebSocket<TcpStream>> {
        let (base, token) = self.address.split_once("/#token=").unwrap();
        let host = base.trim_start_matches("http://");
        let stream = TcpStream::connect(host).ok()?;
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let (mut socket, _) = tungstenite::client(format!("ws://{host}/socket"), stream).ok()?;
        let hello = json!({"type": "hello", "token": token, "size": [320, 240]});
        socket.send(Message::text(hello.to_string())).ok()?;
        Some(socket)
    }

    /// Pages that connect one after another, as the page does when it has lost its server, until one is told what
    /// `is_it`. Gives that, and what they were told while they waited.
    pub(crate) fn told_after_waits(&self, is_it: fn(&Value) -> bool) -> (Value, Vec<Value>) {
        let (begin, mut waits) = (Instant::now(), vec![]);
        while begin.elapsed() < PATIENCE {
            let Some(mut page) = self.try_page() else {
                std::thread::sleep(Duration::from_millis(50));
                continue;
            };
            while let Ok(message) = page.read() {
                let Message::Text(text) = message else { continue };
                let text = serde_json::from_str(&text).unwrap();
                if is_it(&text) {
                    return (text, waits);
                }
                waits.push(text);
            }
        }
        panic!("it did not come; told meanwhile: {waits:?}")
    }

    /// Interrupts it, and gives how it ended.
    pub(crate) fn end(self) -> Ran {
        let signal = format!("kill -INT {}", self.child.id());
        assert!(Command::new("sh").args(["-c", &signal]).status().unwrap().success());
        self.wait()
    }

    /// How it ended.
    pub(crate) fn wait(self) -> Ran {
        ran(&self.line, self.child.wait_with_output().unwrap())
    }

    /// The number of the process that was started.
    pub(crate) fn id(&self) -> u32 {
        self.child.id()
    }

    /// Its address, with the token; or what it said in its place.
    pub(crate) fn address(&self) -> &str {
        &self.address
    }
}

/// The least memory limit that `view LINE` names, MiB.
#[track_caller]
pub(crate) fn smallest_limit_mib(inside: &Path, line: &str) -> u64 {
    let ran = run_in(inside, &format!("view {line} --no-open --json --memory-limit 1MiB"));
    let document = ran.expect_error(4, "memory-limit");
    document["smallest_limit_bytes"].as_u64().unwrap().div_ceil(1 << 20)
}

pub(crate) fn say(page: &mut WebSocket<TcpStream>, message: &Value) {
    page.send(Message::text(message.to_string())).unwrap();
}

/// The next text that `is_it`; frames are acknowledged meanwhile.
#[track_caller]
pub(crate) fn text_until(page: &mut WebSocket<TcpStream>, is_it: impl Fn(&Value) -> bool) -> Value {
    loop {
        match page.read().unwrap() {
            Message::Text(text) => {
                let text = serde_json::from_str(&text).unwrap();
                if is_it(&text) {
                    return text;
                }
            }
            Message::Binary(bytes) => {
                let frame = u32::from_le_bytes(bytes[4..8].try_into().unwrap());
                // A file is nobody's frame.
                if bytes[0] != KIND_FILE {
                    say(page, &json!({"type": "ack", "frame": frame}));
                }
            }
            _ => {}
        }
    }
}

/// Runs the viewer, asks for its page, interrupts it. Gives its address, the page's answer and the document.
#[track_caller]
fn view(inside: &Path, line: &str) -> (String, String, Value) {
    let viewing = ViewProcess::start(inside, line);
    let address = viewing.address.clone();
    let host = address.trim_start_matches("http://").split('/').next().unwrap().to_owned();
    let mut stream = TcpStream::connect(&host).unwrap_or_else(|error| panic!("{address}: {error}"));
    stream.write_all(format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n").as_bytes()).unwrap();
    let mut page = String::new();
    stream.read_to_string(&mut page).unwrap();
    // A build is not interrupted.
    viewing.told_after_waits(|text| text["type"] == "welcome");
    let ran = viewing.end();
    ran.expect(0);
    (address, page, ran.document())
}

#[test]
fn it_serves_its_page_until_it_is_told_to_end() {
    let inside = folder();
    built_in(inside.path(), "gen:soup:10k --voxels 64", "model.trex");
    let (address, page, document) = view(inside.path(), "model.trex --memory-limit 128MiB --spp 1");
    let (base, token) = address.split_once("/#token=").unwrap();
    assert!(base.starts_with("http://127.0.0.1:"), "{address}");
    assert!(token.len() == 32 && token.bytes().all(|byte| byte.is_ascii_hexdigit()), "{address}");
    assert!(page.starts_with("HTTP/1.1 200 ") && page.contains("<script type=\"module\""), "{page}");
    assert!(!page.contains(token), "the page knows the token before it has said it");
    assert_eq!((&document["schema"], &document["clients"]), (&"trex.view/1".into(), &1.into()));
    let memory = &document["memory"];
    assert!(memory["peak_rss_bytes"].as_u64().unwrap() <= 128 << 20, "{document}");
    // A token is of one run.
    assert_ne!(view(inside.path(), "model.trex --memory-limit 128MiB").0, address);
}

#[test]
fn what_cannot_be_seen_is_told_with_what_to_do() {
    let inside = folder();
    built_in(inside.path(), "gen:soup:10k --no-asvo", "flat.trex");
    std::fs::write(inside.path().join("mesh.ply"), "ply\nformat ascii 1.0\nend_header\n").unwrap();
    for (line, exit, code, next) in [
        ("mesh.ply", 3, "input-empty", "check the input"),
        ("none.ply", 3, "input-unreadable", "spelling"),
        ("gen:soup:1k -o none/mesh.trex", 7, "io", "-o FILE.trex"),
        ("flat.trex -o other.trex", 2, "usage", "leave out"),
        ("none.trex", 3, "input-unreadable", "spelling"),
        ("flat.trex --integrator photon", 3, "scene-format", "--no-asvo"),
        ("flat.trex --integrator direct --lod-error 1", 3, "scene-format", "--no-asvo"),
        ("flat.trex --resolution 20000x10", 2, "usage", "smaller"),
    ] {
        let ran = run_in(inside.path(), &format!("view {line} --no-open --json"));
        let document = ran.expect_error(exit, code);
        assert!(document["next_step"].as_str().unwrap().contains(next), "{document}");
    }
    // A port that is taken.
    let taken = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let line = format!("view flat.trex --no-open --json --port {}", taken.local_addr().unwrap().port());
    run_in(inside.path(), &line).expect_error(7, "io");
}

/// A newcomer has a mesh, and was told to build it first. It is built beside itself, again when it has changed, and
/// nothing else is replaced.
#[test]
fn a_mesh_is_built_beside_itself_once() {
    let inside = folder();
    let built = inside.path().join("mesh.ply.trex");
    let write = |seed| {
        let line = format!("gen isosurface --triangles 10k --seed {seed} -o mesh.ply --overwrite");
        document_in(inside.path(), &line);
    };
    let stamp = |path: &Path| (hash_of(path), path.metadata().unwrap().modified().unwrap());
    let line = "mesh.ply --quiet --spp 1 --memory-limit 160MiB";
    write(1);
    let (_, page, document) = view(inside.path(), line);
    assert!(page.starts_with("HTTP/1.1 200 ") && document["scene"] == "mesh.ply.trex", "{document}");
    let first = stamp(&built);
    view(inside.path(), line);
    assert_eq!(stamp(&built), first, "it was built again");
    write(2);
    view(inside.path(), line);
    assert_ne!(stamp(&built).0, first.0, "the mesh has changed");
    // One that was named is the user's own.
    std::fs::copy(&built, inside.path().join("own.trex")).unwrap();
    write(3);
    let ran = run_in(inside.path(), "view mesh.ply -o own.trex --no-open --json");
    ran.expect_error(2, "usage");
    let (_, _, document) = view(inside.path(), &format!("{line} -o other.trex"));
    assert_eq!(document["scene"], "other.trex");
}

/// A file whose pages had flipped bits was shown as finished, with exit status 0. The page, the document and the exit
/// status say what is missing, as those of `render` do.
#[test]
fn damage_is_reported_as_render_reports_it() {
    let inside = folder();
    built_in(inside.path(), "gen:scan:60k --voxels 64", "model.trex");
    let path = inside.path().join("model.trex");
    let file = PageFile::open(&path, &Budget::unlimited()).unwrap();
    let mut bytes = std::fs::read(&path).unwrap();
    file.pages().iter().for_each(|page| bytes[page.offset as usize + 9] ^= 0x10);
    std::fs::write(inside.path().join("bad.trex"), bytes).unwrap();
    for (flag, exit) in [("", 1), (" --allow-damage", 0)] {
        let line = format!("bad.trex --memory-limit 128MiB --spp 1 --lod-error 0 --photons 1k{flag}");
        let viewing = ViewProcess::start(inside.path(), &line);
        let mut page = viewing.page();
        let shown = text_until(&mut page, |text| !text["damage"].is_null())["damage"].clone();
        text_until(&mut page, |text| text["progress"] == "damaged");
        let ran = viewing.end();
        ran.expect(exit);
        let document = ran.document();
        let pages = document["damaged_pages"].as_array().unwrap();
        assert!(!pages.is_empty() && pages.len() <= file.pages().len(), "{document}");
        assert!(pages.contains(&shown["pages"][0]["page"]), "{shown}");
        let first = &document["damage"]["pages"][0];
        assert_eq!(first["drawn"], "as empty", "{first}");
        assert!(first["bounds"]["lo"][0].as_f64() < first["bounds"]["hi"][0].as_f64(), "{first}");
        assert!(ran.stderr.contains(&format!("damaged page {}, drawn as empty", pages[0])), "{}", ran.stderr);
    }
}

/// A file without voxels was refused, whatever light was asked for.
#[test]
fn a_file_without_voxels_is_seen_in_direct_light() {
    let inside = folder();
    built_in(inside.path(), "gen:soup:10k --no-asvo", "flat.trex");
    for (flags, integrator) in [("", "direct"), ("--integrator path --light studio", "path")] {
        let line = format!("flat.trex --spp 1 --quiet {flags}");
        let limit = smallest_limit_mib(inside.path(), &line);
        let viewing = ViewProcess::start(inside.path(), &format!("{line} --memory-limit {limit}MiB"));
        let mut page = viewing.page();
        let welcome = text_until(&mut page, |text| text["type"] == "welcome");
        assert_eq!(welcome["settings"]["integrator"], integrator, "{welcome:#}");
        text_until(&mut page, |text| text["progress"] == "done");
        let ran = viewing.end();
        ran.expect(0);
        let memory = &ran.document()["memory"];
        assert!(memory["peak_rss_bytes"].as_u64().unwrap() <= limit << 20, "{memory}");
    }
}

/// The list of all materials, some 10 MB, went to each page at each edit: past its bound, and past the limit.
#[test]
fn as_many_materials_as_there_may_be_work_under_the_smallest_limit() {
    let inside = folder();
    let (mut obj, mut mtl) = (String::from("mtllib many.mtl\n"), String::new());
    for at in 0..MATERIALS {
        let [x, z] = [at % 256, at / 256];
        writeln!(mtl, "newmtl part {at:05}\nKd 0.5 0.{:02} 0.5", at % 100).unwrap();
        writeln!(obj, "v {x} 0 {z}\nv {x} 0 {}\nv {} 0.3 {z}", z + 1, x + 1).unwrap();
        writeln!(obj, "usemtl part {at:05}\nf -3 -2 -1").unwrap();
    }
    std::fs::write(inside.path().join("many.obj"), obj).unwrap();
    std::fs::write(inside.path().join("many.mtl"), mtl).unwrap();
    run_in(inside.path(), "build many.obj -o many.trex --voxels 64").expect(0);
    let line = "many.trex --spp 1 --photons 1k";
    let limit = smallest_limit_mib(inside.path(), line);
    let viewing = ViewProcess::start(inside.path(), &format!("{line} --memory-limit {limit}MiB"));
    let mut page = viewing.page();
    let welcome = text_until(&mut page, |text| text["type"] == "welcome");
    assert!(welcome["material_count"].as_u64().unwrap() >= MATERIALS as u64, "{welcome}");
    say(&mut page, &json!({"type": "materials", "id": 1, "find": "part 654"}));
    let list = text_until(&mut page, |text| text["type"] == "materials");
    assert_eq!((&list["found"], &list["items"][0]["name"]), (&json!(100), &json!("part 65400")));
    let index = &list["items"][0]["index"];
    for seq in 1..=20 {
        let edit = json!({"mirror": seq % 2 == 0});
        say(&mut page, &json!({"type": "material", "seq": seq, "index": index, "edit": edit}));
        let edited = text_until(&mut page, |text| !text["material"].is_null());
        assert_eq!((&edited["material"]["index"], edited.to_string().len() < 2048), (index, true));
    }
    text_until(&mut page, |text| text["type"] == "texts");
    let ran = viewing.end();
    ran.expect(0);
    let memory = &ran.document()["memory"];
    assert!(memory["peak_rss_bytes"].as_u64().unwrap() <= limit << 20, "{memory}");
}

/// Where frames take all memory that is left, the room of a screenshot that was still to be sent was given to them: the
/// viewer ended with a memory error.
#[test]
fn a_screenshot_leaves_the_viewer_where_pages_take_all_memory() {
    let inside = folder();
    built_in(inside.path(), "gen:scan:1M --voxels 64", "model.trex");
    let line = "model.trex --threads 1 --resolution 320x240 --spp 1 --photons 1k";
    let limit = smallest_limit_mib(inside.path(), line) + 2;
    let viewing = ViewProcess::start(inside.path(), &format!("{line} --memory-limit {limit}MiB"));
    let mut page = viewing.page();
    for id in 1..=3 {
        say(&mut page, &json!({"type": "screenshot", "id": id, "format": "png", "size": [64, 48], "spp": 1}));
        let file = loop {
            match page.read().unwrap() {
                Message::Binary(bytes) if bytes[0] == KIND_FILE => break bytes,
                Message::Text(text) => assert!(!text.contains("\"notice\""), "{text}"),
                _ => {}
            }
        };
        assert_eq!((file[4], &file[8..12]), (id, &b"\x89PNG"[..]));
    }
    let ran = viewing.end();
    ran.expect(0);
    let document = ran.document();
    let frames = document["pool"]["frames"].as_u64().unwrap();
    let pages =
        PageFile::open(&inside.path().join("model.trex"), &Budget::unlimited()).unwrap().pages().len();
    assert!(
        document["screenshots"] == 3 && frames < pages as u64,
        "{frames} frames, {pages} pages: {document}"
    );
}

/// A thread whose stack for signals the system refuses: the process was aborted, without a document. Threads that are
/// refused as a whole are told by whoever starts them.
#[test]
fn a_thread_that_gets_no_memory_at_its_start_ends_in_a_document() {
    let Some(inside) = traced_folder() else { return };
    built_in(inside.path(), "gen:soup:10k --voxels 64", "model.trex");
    let viewing = ViewProcess::start(inside.path(), "model.trex --resolution 16x16 --spp 1 --photons 1k");
    let mut page = viewing.page();
    text_until(&mut page, |text| text["progress"] == "done");
    drop(page);
    // Its threads end, and leave their stacks to those of the next connection.
    let host = viewing.address.trim_start_matches("http://").split('/').next().unwrap().to_owned();
    std::thread::sleep(Duration::from_secs(1));
    let mut command = Command::new("timeout");
    command.args([
        "60",
        "strace",
        "-f",
        "-o",
        "/dev/null",
        "-e",
        "trace=mmap",
        "-e",
        "inject=mmap:error=ENOMEM",
    ]);
    command.args(["-p", &viewing.child.id().to_string()]).stderr(Stdio::piped());
    let mut tracing = command.spawn().unwrap();
    let mut said = String::new();
    BufReader::new(tracing.stderr.as_mut().unwrap()).read_line(&mut said).unwrap();
    if !said.contains("attached") {
        drop((tracing.wait(), viewing.end()));
        return cannot_run(&format!("strace cannot attach to a process: {said}"));
    }
    let _connection = TcpStream::connect(&host).unwrap();
    let ran = ran(&viewing.line, viewing.child.wait_with_output().unwrap());
    let _ = tracing.wait();
    let document = ran.expect_error(7, "io");
    assert_eq!(document["where"], "a thread at its start", "{document}");
}
