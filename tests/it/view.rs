//! `trex view` without a browser: its address, its page, its end, and what it refuses. What it sends is tested in
//! `view/tests/`, what a person does with it in `browser.rs`.

use crate::command::{folder, ran, run_in, trex_in};
use crate::fixtures::built_in;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::process::{Command, Stdio};

/// Runs the viewer, asks for its page, interrupts it. Gives its address, the page's answer and the document.
#[track_caller]
fn view(inside: &Path, line: &str) -> (String, String, serde_json::Value) {
    let line = format!("view {line} --no-open --json");
    let mut command = trex_in(inside, &line);
    command.env_remove("SSH_CONNECTION");
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut said = String::new();
    BufReader::new(child.stderr.as_mut().unwrap()).read_line(&mut said).unwrap();
    let address = said.trim().to_owned();
    let host = address.trim_start_matches("http://").split('/').next().unwrap().to_owned();
    let mut stream = TcpStream::connect(&host).unwrap_or_else(|error| panic!("{said}: {error}"));
    stream.write_all(format!("GET / HTTP/1.1\r\nHost: {host}\r\n\r\n").as_bytes()).unwrap();
    let mut page = String::new();
    stream.read_to_string(&mut page).unwrap();
    let signal = format!("kill -INT {}", child.id());
    assert!(Command::new("sh").args(["-c", &signal]).status().unwrap().success());
    let ran = ran(&line, child.wait_with_output().unwrap());
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
    assert_eq!((&document["schema"], &document["clients"]), (&"trex.view/1".into(), &0.into()));
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
        ("mesh.ply", 3, "input-format", "trex build"),
        ("none.trex", 3, "input-unreadable", "spelling"),
        ("flat.trex --integrator direct --lod-error 0", 3, "scene-format", "with voxels"),
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
