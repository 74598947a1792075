//! What bad input gets, through the command: exit status 3, an error in four parts with a line or a byte offset on
//! stderr and as a document, and a folder that looks as before.

use crate::command::{TREX, cannot_run, document_in, folder, listing, ran, run_in, trex_in};
use crate::fixtures::built_in;
use serde_json::Value;
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::Path;
use std::process::Command;

/// A file that is bad, the code it gets, and how the error's place ends after the name; `?`: in some line or byte.
type Bad<'a> = (&'a str, Vec<u8>, &'a str, &'a str);

/// Runs `trex LINE` with scratch in a folder of its own; expects the error and no trace of the attempt.
#[track_caller]
fn check(inside: &Path, line: &str, exit: i32, code: &str, place: &str) {
    let before = listing(inside);
    let document = run_in(inside, &format!("{line} --json -q")).expect_error(exit, code);
    let said = document["where"].as_str().unwrap();
    let place_is = match place.strip_suffix('?') {
        Some(name) => {
            said.rsplit([' ', ':']).next().is_some_and(|at| at.parse::<u64>().is_ok()) && said.contains(name)
        }
        None => said.ends_with(place),
    };
    assert!(place_is, "{line}: the place is `{said}`, expected is `...{place}`");
    assert_eq!(listing(inside), before, "{line} left something behind");
}

/// Builds each file, beside its output and with a scratch folder.
fn check_all(cases: Vec<Bad<'_>>) {
    for (name, bytes, code, place) in cases {
        let inside = folder();
        std::fs::create_dir(inside.path().join("scratch")).unwrap();
        std::fs::write(inside.path().join(name), bytes).unwrap();
        let place = format!("{name}{place}");
        check(inside.path(), &format!("build {name} -o out.trex"), 3, code, &place);
        check(inside.path(), &format!("build {name} -o out.trex --temp-dir scratch"), 3, code, &place);
        // Bad in the second place is as bad.
        check(
            inside.path(),
            &format!("build gen:soup:10k --no-asvo {name} -o out.trex --temp-dir scratch"),
            3,
            code,
            &place,
        );
    }
}

/// Header of a PLY with three vertices in f32 and one face list.
fn ply_head(format: &str, vertices: u64, faces: u64) -> String {
    format!(
        "ply\nformat {format} 1.0\nelement vertex {vertices}\nproperty float x\nproperty float y\n\
         property float z\nelement face {faces}\nproperty list uchar int vertex_indices\nend_header\n"
    )
}

/// The same with its body in little-endian: a triangle fan of `vertices` points on a circle.
fn ply(vertices: u32, faces: u32, first_corner: u32) -> Vec<u8> {
    let mut bytes = ply_head("binary_little_endian", u64::from(vertices), u64::from(faces)).into_bytes();
    for i in 0..vertices {
        let (y, x) = (f64::from(i) * 0.1).sin_cos();
        [x as f32, y as f32, 0.0].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    }
    for i in 0..faces {
        bytes.push(3);
        [first_corner, i + 1, i + 2].iter().for_each(|v| bytes.extend(v.to_le_bytes()));
    }
    bytes
}

/// A binary STL whose head says `count`, with `records` triangles whose first coordinate is `x`.
fn stl(count: u32, records: usize, x: f32) -> Vec<u8> {
    let mut bytes = vec![b' '; 80];
    bytes.extend(count.to_le_bytes());
    for i in 0..records {
        let i = i as f32;
        for v in [0.0, 0.0, 1.0, x, 0.0, i, 1.0, 0.0, i, 0.0, 1.0, i] {
            bytes.extend(f32::to_le_bytes(v));
        }
        bytes.extend([0, 0]);
    }
    bytes
}

fn utf16(text: &str, encode: fn(u16) -> [u8; 2]) -> Vec<u8> {
    std::iter::once(0xfeff).chain(text.encode_utf16()).flat_map(encode).collect()
}

const BODY: &str = "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
const STL_TEXT: &str = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\n\
                        endfacet\nendsolid a\n";

#[test]
fn truncated_files_say_where_they_end() {
    let whole = ply(100, 98, 0);
    let head = whole.len() - 100 * 12 - 98 * 13;
    let cut = |at: usize| whole[..at].to_vec();
    let ascii = ply_head("ascii", 3, 2) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let stl = stl(40, 40, 0.0);
    check_all(vec![
        ("head.ply", cut(60), "input-truncated", "?"),
        ("no-body.ply", cut(head), "input-truncated", &format!(" at byte {head}")),
        ("vertices.ply", cut(head + 600), "input-truncated", &format!(" at byte {head}")),
        ("faces.ply", cut(head + 1200 + 98 * 13 - 1), "input-truncated", "?"),
        ("one-face.ply", cut(head + 1200 + 5), "input-truncated", "?"),
        ("ascii.ply", ascii.clone().into_bytes(), "input-truncated", ":14"),
        ("in-a-row.ply", ascii.as_bytes()[..ascii.len() - 4].to_vec(), "input-truncated", "?"),
        ("records.stl", stl[..stl.len() - 30].to_vec(), "input-truncated", "?"),
        ("no-records.stl", stl[..84].to_vec(), "input-truncated", "?"),
        ("in-a-facet.stl", STL_TEXT.as_bytes()[..60].to_vec(), "input-truncated", "?"),
    ]);
}

#[test]
fn what_the_lattice_cannot_tell_is_told_apart_from_what_has_no_area() {
    let inside = folder();
    // One that stays; one that is a line; one of 1e-5, in steps of some 1e-3.
    let corners = "v 0 0 0\nv 100 0 0\nv 0 100 0\nv 50 50 50\nv 50.00001 50 50\nv 50 50.00001 50\n";
    let text = format!("{corners}f 1 2 3\nf 1 2 2\nf 4 5 6\n");
    std::fs::write(inside.path().join("small.obj"), text).unwrap();
    let counts = |line: &str, keys: [&str; 2]| {
        let document = document_in(inside.path(), line);
        keys.map(|key| document.pointer(key).and_then(Value::as_u64).expect("a count"))
    };
    let keys = ["/rejected_degenerate", "/rejected_collapsed"];
    assert_eq!(counts("build small.obj -o small.trex", keys), [2, 1]);
    assert_eq!(counts("info small.trex", ["/rejected/degenerate", "/rejected/collapsed"]), [2, 1]);
    assert_eq!(counts("build small.obj -o small.trex --overwrite --error 1e-7", keys), [1, 0]);
}

#[test]
fn files_without_a_triangle_are_refused() {
    let flat = "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 2 0 0\nf 2 3 4\n";
    check_all(vec![
        ("empty.ply", vec![], "input-empty", ""),
        ("empty.obj", vec![], "input-empty", ""),
        ("empty.stl", vec![], "input-empty", ""),
    ]);
    // Alone: beside another input these add nothing, which is no error.
    for (name, bytes, [read, degenerate, non_finite]) in [
        ("points.obj", b"v 0 0 0\nv 1 0 0\n".to_vec(), [0, 0, 0]),
        ("points.ply", ply(10, 0, 0), [0, 0, 0]),
        ("degenerate.obj", flat.into(), [1, 1, 0]),
        ("a-point.obj", b"v 1 1 1\nv 1 1 1\nf 1 2 1\n".to_vec(), [1, 1, 0]),
        ("nan.stl", stl(5, 5, f32::NAN), [5, 0, 5]),
        ("infinite.stl", stl(5, 5, f32::INFINITY), [5, 0, 5]),
        ("nan.obj", b"v nan nan nan\nf 1 1 1\n".to_vec(), [1, 0, 1]),
        ("a-point-and-nan.obj", b"v 1 1 1\nv nan 1 1\nf 1 1 1\nf 1 2 1\n".to_vec(), [2, 1, 1]),
        ("none.stl", stl(0, 0, 0.0), [0, 0, 0]),
    ] {
        let inside = folder();
        std::fs::write(inside.path().join(name), bytes).unwrap();
        let line = format!("build {name} -o out.trex");
        check(inside.path(), &line, 3, "input-empty", name);
        // It used to be told that it has no extent that a lattice could divide.
        let error = run_in(inside.path(), &format!("{line} --json -q")).document();
        let (what, numbers) = (error["what"].as_str().unwrap(), error["numbers"].as_str().unwrap());
        assert!(what.contains("no triangle"), "{name}: {error:#}");
        assert_eq!(
            numbers,
            format!(
                "{read} triangles read, {degenerate} degenerate, {non_finite} with coordinates that are no finite \
                 numbers"
            ),
            "{name}"
        );
    }
}

#[test]
fn content_that_is_something_else_is_refused() {
    check_all(vec![
        ("hello.ply", b"hello\n".to_vec(), "input-format", " at byte 0"),
        ("stl-inside.ply", STL_TEXT.into(), "input-format", " at byte 0"),
        ("ply-inside.obj", ply(10, 8, 0), "input-format", " at byte 0"),
        ("noise.xyz", (0..200u32).map(|i| (i * 37 + 11) as u8 | 0x80).collect(), "input-format", ""),
        ("zip.obj", b"PK\x03\x04\0\0\0\0\0\0\0\0".to_vec(), "input-format", "?"),
        (
            "noise.stl",
            b"not a mesh at all, but eighty-four bytes or more of plain text in a file. ".repeat(4),
            "input-format",
            "?",
        ),
        ("little.obj", utf16(OBJ, u16::to_le_bytes), "input-format", "?"),
        ("big.obj", utf16(OBJ, u16::to_be_bytes), "input-format", "?"),
        ("text.ply", utf16(&ply_head("ascii", 3, 1), u16::to_le_bytes), "input-format", "?"),
        ("text.stl", utf16(STL_TEXT, u16::to_le_bytes), "input-format", "?"),
        ("type.ply", ply_head("ascii", 3, 1).replace("float y", "quad y").into(), "input-format", ":5"),
        (
            "twice.ply",
            (ply_head("ascii", 3, 1).replace("float y", "float x") + BODY).into(),
            "input-format",
            "",
        ),
    ]);
}

#[test]
fn numbers_that_are_none_and_counts_that_lie_are_refused() {
    let ascii = |body: &str| (ply_head("ascii", 3, 1) + body).into_bytes();
    let huge = ply_head("binary_little_endian", 4_000_000_000_000, 1).into_bytes();
    let faces = ply_head("ascii", 3, 1 << 40) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    let mut long_list = ply(10, 1, 0);
    let at = long_list.len() - 13;
    long_list[at] = 255;
    check_all(vec![
        ("word.obj", OBJ.replace("1 0 0", "1 two 0").into(), "input-format", ":2"),
        ("corner.obj", OBJ.replace("1 2 3", "1 b 3").into(), "input-format", ":4"),
        ("word.ply", ascii("0 0 0\n1 x 0\n0 1 0\n3 0 1 2\n"), "input-format", ":11"),
        ("word.stl", STL_TEXT.replace("1 0 0", "1 o 0").into(), "input-format", ":5"),
        ("huge.ply", huge, "input-truncated", "?"),
        ("faces.ply", faces.into(), "input-truncated", "?"),
        ("list.ply", long_list, "input-truncated", "?"),
        ("count.stl", stl(u32::MAX, 3, 0.0), "input-truncated", "?"),
        ("count.ply", ascii("0 0 0\n1 0 0\n0 1 0\n-3 0 1 2\n"), "input-range", ":13"),
        ("beyond.obj", OBJ.replace("1 2 3", "1 2 4").into(), "input-range", ":4"),
        ("zero.obj", OBJ.replace("1 2 3", "0 1 2").into(), "input-range", ":4"),
        ("before.obj", OBJ.replace("1 2 3", "-1 -2 -4").into(), "input-range", ":4"),
        ("beyond.ply", ply(10, 8, 10), "input-range", "?"),
        ("negative.ply", ply(10, 8, u32::MAX), "input-range", "?"),
        ("ascii.ply", ascii("0 0 0\n1 0 0\n0 1 0\n3 0 1 3\n"), "input-range", ":13"),
    ]);
}

#[test]
fn what_cannot_be_opened_is_named() {
    let inside = folder();
    std::fs::create_dir(inside.path().join("folder.ply")).unwrap();
    std::fs::write(inside.path().join("mesh.obj"), OBJ).unwrap();
    for (line, place) in [
        ("build folder.ply -o out.trex", "folder.ply"),
        ("build missing.ply -o out.trex", "missing.ply"),
        ("build /dev/null -o out.trex", "/dev/null"),
        ("build mesh.obj missing.obj -o out.trex", "missing.obj"),
        ("info folder.ply", "folder.ply"),
        ("info missing.trex", "missing.trex"),
        ("verify folder.ply", "folder.ply"),
        ("verify missing.trex", "missing.trex"),
        ("render missing.trex -o out.png", "missing.trex"),
        ("render missing.toml -o out.png", "missing.toml"),
        ("render folder.ply -o out.png", "folder.ply"),
    ] {
        check(inside.path(), line, 3, "input-unreadable", place);
    }
    for line in ["verify mesh.obj", "render mesh.obj -o out.png"] {
        check(inside.path(), line, 3, "input-format", "mesh.obj");
    }
    for line in ["build gen:cube:5 -o out.trex", "build gen:soup:many -o out.trex", "info gen:soup"] {
        check(inside.path(), line, 2, "usage", "");
    }
}

/// Opening a pipe waits for a writer: `trex info` of one did not end, and not by SIGTERM either.
#[test]
fn pipes_sockets_and_devices_end_at_once() {
    let inside = folder();
    let pipes = ["pipe.trex", "pipe.ply", "pipe.toml", "pipe.png"];
    assert!(Command::new("mkfifo").args(pipes).current_dir(inside.path()).status().unwrap().success());
    let _socket = std::os::unix::net::UnixListener::bind(inside.path().join("socket.trex")).unwrap();
    // Not `check`, which looks into every file of the folder.
    let refused = |line: &str, place: &str| {
        let document =
            run_in(inside.path(), &format!("{line} --json -q")).expect_error(3, "input-unreadable");
        assert!(document["where"].as_str().unwrap().ends_with(place), "{line}: {document}");
    };
    for file in ["pipe.trex", "socket.trex", "/dev/zero", "/dev/tty"] {
        for verb in ["info FILE", "verify FILE", "render FILE -o out.png", "stress FILE --scenario flip"] {
            refused(&verb.replace("FILE", file), file);
        }
        refused(&format!("view {file} --no-open"), file);
    }
    for (line, place) in [
        ("build pipe.ply -o out.trex", "pipe.ply"),
        ("build socket.trex -o out.trex", "socket.trex"),
        ("render pipe.toml -o out.png", "pipe.toml"),
        ("image diff pipe.png pipe.png", "pipe.png"),
        ("image diff /dev/zero /dev/zero", "/dev/zero"),
    ] {
        refused(line, place);
    }
}

/// A link that leads to itself, a file in place of a folder, a name that no file system takes: failures of the disk, by
/// their status, with the advice to check the device.
#[test]
fn paths_that_lead_nowhere_are_bad_input() {
    let inside = folder();
    std::fs::write(inside.path().join("mesh.obj"), OBJ).unwrap();
    let long = "n".repeat(256);
    // Not `check`, which looks into every file of the folder.
    let refused = |line: &str, place: &str| {
        let document =
            run_in(inside.path(), &format!("{line} --json -q")).expect_error(3, "input-unreadable");
        assert!(document["where"].as_str().unwrap().ends_with(place), "{line}: {document}");
    };
    for ending in ["obj", "trex", "toml", "png"] {
        let name = format!("loop.{ending}");
        std::os::unix::fs::symlink(&name, inside.path().join(&name)).unwrap();
        for file in [name, format!("mesh.obj/x.{ending}"), format!("{long}.{ending}")] {
            let line = match ending {
                "obj" => "build FILE -o out.trex",
                "trex" => "verify FILE",
                "toml" => "render FILE -o out.png",
                _ => "image diff FILE FILE",
            };
            refused(&line.replace("FILE", &file), &file);
            refused(&format!("info {file}"), &file);
        }
    }
    refused("view loop.obj --no-open", "loop.obj");
    refused("stress loop.trex --scenario flip", "loop.trex");
}

/// Root may read everything, so the command runs as nobody here, where that is allowed.
#[test]
fn a_file_without_permission_is_named() {
    const NOBODY: u32 = 65_534;
    let inside = folder();
    let closed = inside.path().join("closed.obj");
    std::fs::write(&closed, OBJ).unwrap();
    let mode = |path: &Path, bits| std::fs::set_permissions(path, PermissionsExt::from_mode(bits)).unwrap();
    mode(&closed, 0o000);
    mode(inside.path(), 0o777);
    let mut command = trex_in(inside.path(), "build closed.obj -o out.trex --json -q");
    if std::fs::File::open(&closed).is_ok() {
        command.uid(NOBODY).gid(NOBODY);
    }
    let Ok(output) = command.output() else {
        return cannot_run(&format!("this user reads all files, and nobody cannot run {TREX}"));
    };
    let document = ran("build closed.obj", output).expect_error(3, "input-unreadable");
    assert!(document["where"].as_str().unwrap().ends_with("closed.obj"), "{document}");
    assert_eq!(listing(inside.path()).len(), 1);
}

#[test]
fn several_inputs_become_one_model() {
    let inside = folder();
    std::fs::write(inside.path().join("fan.ply"), ply(100, 98, 0)).unwrap();
    std::fs::write(inside.path().join("plates.stl"), stl(40, 40, 0.0)).unwrap();
    std::fs::write(inside.path().join("one.obj"), OBJ).unwrap();
    let built = document_in(inside.path(), "build fan.ply plates.stl one.obj -o all.trex");
    assert_eq!(built["input_triangle_count"], 98 + 40 + 1);
    assert_eq!(built["triangle_count"], 98 + 40 + 1);
    let soup = document_in(inside.path(), "build gen:soup:20k --no-asvo -o soup.trex");
    let both = document_in(inside.path(), "build gen:soup:20k one.obj --no-asvo -o both.trex");
    let count = |document: &serde_json::Value| document["input_triangle_count"].as_u64().unwrap();
    assert_eq!(count(&both), count(&soup) + 1);
    assert_eq!(listing(inside.path()).len(), 6);
}

#[test]
fn the_lattice_keeps_the_error_or_the_bits_asked_for() {
    let inside = folder();
    std::fs::write(inside.path().join("fan.ply"), ply(100, 98, 0)).unwrap();
    let grid = |flags: &str| {
        document_in(inside.path(), &format!("build fan.ply -o grid.trex --overwrite {flags}"));
        document_in(inside.path(), "info grid.trex")["grid"].clone()
    };
    for error in [0.1, 0.01, 1e-5] {
        let grid = grid(&format!("--error {error}"));
        assert!(grid["error_bound"].as_f64().unwrap() <= error, "--error {error}: {grid}");
        assert!(grid["step"].as_f64().unwrap() > error, "--error {error} is overdone: {grid}");
    }
    for bits in [8, 16, 24, 40] {
        let got = grid(&format!("--grid-bits {bits}"));
        // A whole power of two of the step, and an origin on the lattice: one bit either way.
        let found = got["bits"].as_u64().unwrap();
        assert!((bits - 1..=bits).contains(&found), "--grid-bits {bits}: {got}");
    }
    check(inside.path(), "build fan.ply -o out.trex --error 1e-300", 2, "usage", "");
    check(inside.path(), "build fan.ply -o out.trex --error 1e-14", 2, "usage", "fan.ply");
}

/// Needles whose three lattice corners differ but lie on one line are kept, and rays hit them. They have no normal:
/// the first picture of them ended in a panic, exit status 70.
#[test]
fn a_model_of_needles_gives_a_picture() {
    let inside = folder();
    built_in(inside.path(), "gen:soup:20k --voxels 64", "soup.trex");
    let line = "render soup.trex -o soup.png --integrator direct --resolution 512x512 --spp 2";
    assert_eq!(document_in(inside.path(), line)["exact"], true);
}
