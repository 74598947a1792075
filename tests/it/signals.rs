//! Signals that ask the command to end, and one that is not to.

use crate::command::{TREX, folder};
use crate::fixtures::built_in;
use crate::view::ViewProcess;
use std::process::Command;

/// Sends a signal to a viewer.
fn signal(viewing: &ViewProcess, name: &str) {
    let line = format!("kill -{name} {}", viewing.id());
    assert!(Command::new("sh").args(["-c", &line]).status().unwrap().success());
}

#[test]
fn each_of_three_signals_ends_a_viewer_as_its_user_would() {
    let inside = folder();
    built_in(inside.path(), "gen:soup:10k --voxels 64", "model.trex");
    for name in ["INT", "TERM", "HUP"] {
        let viewing = ViewProcess::start(inside.path(), "model.trex --spp 1 --memory-limit 128MiB");
        signal(&viewing, name);
        let ran = viewing.wait();
        ran.expect(0);
        assert_eq!(ran.document()["schema"], "trex.view/1", "{name}");
    }
}

/// `nohup` has a process ignore the hangup of its terminal; a handler would have undone that.
#[test]
fn a_viewer_under_nohup_outlives_its_terminal() {
    let inside = folder();
    built_in(inside.path(), "gen:soup:10k --voxels 64", "model.trex");
    let line = "view model.trex --spp 1 --memory-limit 128MiB --no-open --json";
    let mut command = Command::new("sh");
    command.args(["-c", &format!("trap '' HUP; exec {TREX} {line}")]).current_dir(inside.path());
    let viewing = ViewProcess::start_as(command, line.to_owned());
    signal(&viewing, "HUP");
    viewing.told_after_waits(|text| text["type"] == "welcome");
    viewing.end().expect(0);
}
