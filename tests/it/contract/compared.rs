//! What `trex stress` compares with references: on the way of a hand, kept between runs, and written as pictures.

use super::measured::{near, number};
use crate::command::{document_in, folder, run_in};
use crate::fixtures::built_in;
use std::os::unix::fs::MetadataExt;

const REFERENCED: &str = "--resolution 64x48 --photons 5k --memory-limit 128MiB --switches 1 --hold 80 --t-max 50 \
                          --exposure 1 --light scene --require frame.max=600000";

#[test]
fn stress_tells_what_a_moving_hand_is_shown() {
    let inside = folder();
    built_in(inside.path(), "gen:isosurface:20k", "iso.trex");
    let line = format!("stress iso.trex --scenario drag {REFERENCED} --reference-spp 2");
    let document = document_in(inside.path(), &line);
    let at = |pointer: &str| number(&document, pointer);
    // The last of 150 events begins the rest, which is held as any view is.
    assert_eq!(
        (at("/drag/events"), at("/drag/picture_ms/count"), at("/whole_ms/count")),
        (149.0, 149.0, 1.0)
    );
    assert!(at("/drag/pictures") >= 149.0 && at("/drag/pictures_per_s") > 0.0);
    assert!(at("/drag/picture_ms/p50") <= at("/drag/picture_ms/max"));
    let coverage = at("/drag/coverage");
    assert!(coverage > 0.0 && coverage <= 1.0, "{document:#}");
    for of in ["relmse", "flip"] {
        assert_eq!(at(&format!("/drag/{of}/count")), 11.0);
        let [median, p95] = ["median", "p95"].map(|key| at(&format!("/drag/{of}/{key}")));
        assert!(median > 0.0 && median <= p95, "{document:#}");
    }
    assert_eq!(at("/error_floor/count"), 3.0);
    let resting = at("/error_at_ms/33/flip/median");
    assert!(resting > 0.0 && resting < 0.5, "a picture of another view: {document:#}");
    assert!(at("/drag/flip/median") < 0.5, "pictures of other views: {document:#}");
}

/// References stay as they are for the same pictures, and are made anew for others; no other file is replaced.
#[test]
fn references_are_kept_for_the_same_pictures() {
    let inside = folder();
    built_in(inside.path(), "gen:isosurface:20k", "iso.trex");
    let line =
        |flags: &str| format!("stress iso.trex --scenario flip {REFERENCED} --references kept.refs {flags}");
    let floor = |flags: &str| document_in(inside.path(), &line(flags))["error_floor"].clone();
    let file = || std::fs::metadata(inside.path().join("kept.refs")).unwrap().ino();
    let first = (floor("--reference-spp 2"), file());
    assert_eq!((floor("--reference-spp 2"), file()), first);
    let other = (floor("--reference-spp 2 --n-shadow 5"), file());
    assert!(other.0 != first.0 && other.1 != first.1, "{first:?} {other:?}");
    let text = "not what it replaces";
    std::fs::write(inside.path().join("kept.refs"), text).unwrap();
    run_in(inside.path(), &format!("{} --json -q", line("--reference-spp 2"))).expect_error(2, "usage");
    assert_eq!(std::fs::read_to_string(inside.path().join("kept.refs")).unwrap(), text);
    for input in ["iso.trex", "."] {
        let line = line("--reference-spp 2").replace("kept.refs", input);
        run_in(inside.path(), &format!("{line} --json -q")).expect_error(2, "usage");
    }
}

/// The pictures that are written are those that the figures are of; none is replaced unless that is asked for.
#[test]
fn stress_writes_the_pictures_that_it_compares() {
    let inside = folder();
    built_in(inside.path(), "gen:isosurface:20k", "iso.trex");
    let line = format!("stress iso.trex --scenario flip {REFERENCED} --reference-spp 2 --pictures seen");
    let names = || {
        let entries = std::fs::read_dir(inside.path().join("seen")).unwrap();
        let mut names: Vec<_> =
            entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    };
    run_in(inside.path(), &format!("{line} --json -q")).expect_error(2, "usage");
    std::fs::create_dir(inside.path().join("seen")).unwrap();
    let document = document_in(inside.path(), &line);
    assert!(["33-ms.png", "reference.png"].iter().all(|name| names().iter().any(|found| found == name)));
    let reached =
        |ms: &str| document.pointer(&format!("/error_at_ms/{ms}/flip/median")).is_some_and(|v| v.is_f64());
    for name in names().iter().filter(|name| *name != "reference.png") {
        let ms = name.strip_suffix("-ms.png").unwrap();
        assert!(reached(ms), "{name}: {document:#}");
        let diff = document_in(inside.path(), &format!("image diff seen/{name} seen/reference.png --flip"));
        near(
            number(&diff, "/flip"),
            number(&document, &format!("/error_at_ms/{ms}/flip/median")),
            0.05,
            &diff,
        );
    }
    run_in(inside.path(), &format!("{line} --json -q")).expect_error(2, "usage");
    document_in(inside.path(), &format!("{line} --overwrite"));
}
