//! PLY: headers, bodies and counts that are wrong.

use super::super::check_error;
use super::*;
use crate::error::Code;

#[test]
fn headers_that_are_wrong() {
    let check =
        |content: &str, words: &str| check_error("a.ply", content.as_bytes(), Code::InputFormat, words);
    check("ply\nelement vertex 1\nend_header\n", "no `format`");
    check("ply\nformat ascii64 1.0\nend_header\n", "unknown format");
    check("ply\nformat ascii 1.0\nproperty float x\nend_header\n", ":3");
    check("ply\nformat ascii 1.0\nelement vertex many\nend_header\n", "not a number");
    check("ply\nformat ascii 1.0\nelement vertex -1\nend_header\n", "not a number");
    check("ply\nformat ascii 1.0\nelement vertex 1\nproperty quad x\nend_header\n1\n", "unknown property");
    check(
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty list float int x\nend_header\n1\n",
        "unknown property",
    );
    check("ply\nformat ascii 1.0\nwhat is this\nend_header\n", "unknown keyword");
    check("ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n", "no number `y`");
    check(&cube("element face 1\nproperty float x\n", "1\n"), "no list `vertex_indices`");
    check(&cube("element face 1\nproperty list uchar float vertex_indices\n", "1 1\n"), "not integers");
    check(&cube("element vertex 1\nproperty float x\n", "1\n"), "two `vertex`");
    check_error("a.ply", b"ply\nformat ascii 1.0\n", Code::InputTruncated, "end_header");
}

#[test]
fn bodies_that_are_wrong() {
    let check = |rows: &str, code: Code, words: &str| {
        let content = cube(&format!("element face 1\n{FACES}"), rows);
        check_error("a.ply", content.as_bytes(), code, words);
    };
    check("3 0 1 8\n", Code::InputRange, "index 8, and there are 8 vertices");
    check("3 0 -1 2\n", Code::InputRange, "index -1");
    check("3 0 1\n\n\n", Code::InputFormat, "a.ply:18");
    check("3 0 one 2\n", Code::InputFormat, "found `one`");
    check("-3 0 1 2\n", Code::InputRange, "negative length");
    check("99999999 0 1 2\n", Code::InputRange, "too many sides");
    check("3 0 1", Code::InputTruncated, "ends early");
    check("", Code::InputTruncated, "ends early");
}

#[test]
fn counts_that_lie_allocate_nothing() {
    for format in FORMATS {
        for (vertices, faces) in
            [(u64::MAX / 40, 1), (3, u64::MAX / 40), (1_000_000_000, 1_000_000_000), (13, 4), (8, 99)]
        {
            let text = String::from_utf8_lossy(&write(Variant { format, ..PLAIN })).into_owned();
            assert!(text.contains("element face 4"));
            let content = write(Variant { format, ..PLAIN });
            let split = text.find("end_header").unwrap();
            let header = text[..split]
                .replace("element vertex 8", &format!("element vertex {vertices}"))
                .replace("element face 4", &format!("element face {faces}"));
            let content = [header.as_bytes(), &content[split..]].concat();
            let fixture = Fixture::new("a.ply", &content);
            let mut options = fixture.options();
            options.budget = crate::Budget::new(crate::RESERVE_BYTES + (4 << 20));
            let code = read(&fixture.path, &options).map(|mesh| mesh.triangles.len()).unwrap_err().code();
            assert!(
                matches!(code, Code::InputTruncated | Code::InputFormat | Code::InputRange),
                "{format} {vertices} {faces}: {code:?}"
            );
        }
    }
}
