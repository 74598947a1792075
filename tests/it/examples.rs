//! The examples of the libraries, run as they are built: each must end well and say what it did.

use crate::command::cannot_run;
use std::path::PathBuf;
use std::process::Command;

/// Where cargo puts examples: beside the folder of this test's program.
fn built(name: &str) -> PathBuf {
    let program = std::env::current_exe().unwrap();
    program.parent().unwrap().parent().unwrap().join("examples").join(name)
}

#[test]
fn examples_say_what_they_did() {
    for (name, words) in [
        ("open", "80000 triangles in"),
        ("request", "80000 triangles in"),
        ("trace", "triangle "),
        ("progressive", "8 samples a pixel"),
    ] {
        let program = built(name);
        if !program.is_file() {
            cannot_run(&format!("{name} is not built: `cargo test --workspace` builds it"));
            continue;
        }
        let output = Command::new(&program).output().unwrap();
        let (said, error) =
            (String::from_utf8(output.stdout).unwrap(), String::from_utf8_lossy(&output.stderr));
        assert!(output.status.success() && said.contains(words), "{name}: {said}\n{error}");
    }
}
