//! Page files behind HTTP: the same answers as from a disk, and a clear error or the right picture whatever the server
//! does.

mod server;

use crate::command::{document_in, folder, hash_of, run_in};
use crate::fixtures::built_in;
use server::{Manners, Server};
use std::collections::BTreeSet;
use std::path::Path;
use std::sync::{Arc, Mutex};

const MODEL: &str = "gen:pipes:60k --voxels 64";
/// A place behind most pages of the model, and before its tables.
const PAGES_END: usize = 100_000;
const PICTURE: &str = "--overwrite --resolution 64x48 --spp 2 --exposure 1 --light scene";

/// The hash of the picture that `render` makes of `file`, under this limit.
fn picture(inside: &Path, file: &str, limit: &str) -> u64 {
    let line = format!("render {file} -o picture.png {PICTURE} --memory-limit {limit}");
    document_in(inside, &line);
    hash_of(&inside.join("picture.png"))
}

#[test]
fn a_file_behind_http_is_the_same_as_on_a_disk() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let path = inside.path().join("model.trex");
    let server = Server::of(&path, |_| Manners::Good);
    let url = &server.url;
    let known = picture(inside.path(), "model.trex", "256MiB");
    for limit in ["256MiB", "64MiB"] {
        assert_eq!(picture(inside.path(), url, limit), known, "{limit}");
    }
    // The description differs in what it says of the place, and in the memory of connections.
    let info = |file: &str| {
        let mut document = document_in(inside.path(), &format!("info {file}"));
        let document = document.as_object_mut().unwrap();
        for key in ["command", "scene", "smallest_limit_bytes", "smallest_limit_view_bytes", "shares"] {
            document.remove(key);
        }
        serde_json::to_string(document).unwrap()
    };
    assert_eq!(info(url), info("model.trex"));
    for depth in ["", "--quick", "--deep"] {
        let verdict = document_in(inside.path(), &format!("verify {url} {depth}"));
        assert_eq!(verdict["verdict"], "clean", "{verdict:#}");
    }
    for file in [url, "model.trex"] {
        let name = if file == url { "far.ply" } else { "near.ply" };
        document_in(inside.path(), &format!("export {file} -o {name}"));
    }
    // The comment of a PLY names the file that it came from.
    let faces = |name: &str| {
        let bytes = std::fs::read(inside.path().join(name)).unwrap();
        let head = bytes.windows(11).position(|part| part == b"end_header\n").unwrap();
        bytes[head..].to_vec()
    };
    assert!(faces("far.ply") == faces("near.ply"), "exports differ");
    let scene = format!("model = \"{url}\"\n[render]\nexposure = 1.0\nlight = \"scene\"\n");
    std::fs::write(inside.path().join("far.toml"), scene).unwrap();
    assert_eq!(picture(inside.path(), "far.toml", "256MiB"), known, "by a scene");
}

/// `info` reads the tables alone: the end of the file, then what is in no 64 KiB of it.
#[test]
fn opening_asks_for_the_tables_alone() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let path = inside.path().join("model.trex");
    let server = Server::of(&path, |_| Manners::Good);
    document_in(inside.path(), &format!("info {}", server.url));
    let bytes = path.metadata().unwrap().len() as usize;
    assert!(server.requests() <= 8, "{} requests", server.requests());
    assert!(server.sent_bytes() < bytes / 2, "{} of {bytes} bytes", server.sent_bytes());
}

/// The first request for each range fails, in five ways, and nothing is seen of it.
#[test]
fn failures_that_pass_are_not_seen() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let known = picture(inside.path(), "model.trex", "256MiB");
    for bad in [Manners::Unavailable, Manners::Closed, Manners::Short, Manners::Long, Manners::OtherRange] {
        let asked = Arc::new(Mutex::new(BTreeSet::new()));
        let seen = Arc::clone(&asked);
        let server = Server::of(&inside.path().join("model.trex"), move |first| {
            if seen.lock().unwrap().insert(first) { bad } else { Manners::Good }
        });
        assert_eq!(picture(inside.path(), &server.url, "256MiB"), known, "{bad:?}");
        let ranges = asked.lock().unwrap().len();
        assert!(ranges > 2 && server.requests() > ranges, "{bad:?}: {} of {ranges}", server.requests());
    }
    let server = Server::of(&inside.path().join("model.trex"), |_| Manners::Elsewhere);
    assert_eq!(picture(inside.path(), &server.url, "256MiB"), known, "where it was sent on");
}

/// What a server does from its first request on ends in an error in four parts and in no picture; where pages alone
/// cannot be had, the picture is not whole.
#[test]
fn what_a_server_does_for_good_is_told() {
    let inside = folder();
    built_in(inside.path(), MODEL, "model.trex");
    let render = |url: &str| {
        let line = format!("render {url} -o none.png {PICTURE} --memory-limit 256MiB --json");
        let ran = run_in(inside.path(), &line);
        assert!(!inside.path().join("none.png").exists(), "{}", ran.line);
        ran
    };
    let path = inside.path().join("model.trex");
    for (bad, code, exit) in [
        (Manners::Nothing, "input-unreadable", 3),
        (Manners::Forbidden, "input-unreadable", 3),
        (Manners::Whole, "input-unreadable", 3),
        (Manners::NoRange, "input-unreadable", 3),
        (Manners::Unavailable, "io", 7),
        (Manners::Closed, "io", 7),
        (Manners::Short, "io", 7),
        (Manners::Long, "io", 7),
        (Manners::OtherRange, "io", 7),
    ] {
        let server = Server::of(&path, move |_| bad);
        let told = render(&server.url).expect_error(exit, code);
        assert!(told["where"].as_str().unwrap().contains(&server.url), "{bad:?}: {told:#}");
    }
    // Pages that cannot be had are left out of the picture, as damaged ones of a file are, and the status says so.
    for bad in [Manners::Changed, Manners::Unavailable, Manners::Damaged] {
        let server = Server::of(&path, move |first| if first < PAGES_END { bad } else { Manners::Good });
        let line = format!("render {} -o holes.png {PICTURE} --memory-limit 256MiB --json", server.url);
        let ran = run_in(inside.path(), &line);
        ran.expect(1);
        let pages = ran.document()["damaged_pages"].as_array().unwrap().len();
        assert!(pages > 0, "{bad:?}: {}", ran.stdout);
    }
}

#[test]
fn an_address_without_a_server_or_with_a_password_is_told() {
    let inside = folder();
    let told = run_in(inside.path(), "info http://127.0.0.1:1/model.trex --json").expect_error(7, "io");
    assert!(told["next_step"].as_str().unwrap().contains("network"), "{told:#}");
    let ran = run_in(inside.path(), "info http://me:secret@127.0.0.1:1/model.trex --json");
    let told = ran.expect_error(2, "usage");
    // The line that was typed stands in the document; what is told does not repeat the password.
    assert!(!told["where"].as_str().unwrap().contains("secret"), "{told:#}");
}
