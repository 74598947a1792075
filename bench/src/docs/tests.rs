//! Pages with markers, records beside them, and what comes of both.

use super::*;
use crate::machine::Machine;
use crate::record::Record;
use serde_json::json;

fn record(name: &str, count: u64, speed: f64) -> Record {
    let machine =
        Machine { cpu: "Test CPU".into(), core_count: 2, memory_bytes: 4 << 30, kernel: "Linux 6".into() };
    Record {
        name: name.into(),
        command: format!("trex build gen:soup:{count} -o a.trex"),
        scene: String::new(),
        seed: Some(1),
        machine,
        commit: "abc".into(),
        date: "2026-01-01".into(),
        result_hash: Some("00ff".into()),
        values: [("triangle_count", json!(count)), ("triangles_per_s", json!(speed))]
            .map(|(key, value)| (key.to_owned(), value))
            .into(),
    }
}

/// A checkout with one page and some records.
fn checkout(page: &str, records: &[Record]) -> tempfile::TempDir {
    let root = tempfile::tempdir().unwrap();
    fs::create_dir_all(root.path().join("docs")).unwrap();
    fs::create_dir_all(record::folder(root.path())).unwrap();
    fs::write(root.path().join("docs/page.md"), page).unwrap();
    records.iter().for_each(|record| drop(record::append(root.path(), record).unwrap()));
    root
}

const PAGE: &str = "# Speed\n\n<!-- record:build-* triangle_count triangles_per_s=\"Speed of it\" \
    triangles_per_s.spread=\"Spread\" -->\nold\n\
    <!-- end -->\n\
    text\n<!-- plot:speed build-* x=triangle_count y=triangles_per_s -->\n<!-- end -->\n\
    <!-- commands:build-* -->\n<!-- end -->\nlast\n";

#[test]
fn tables_and_plots_stand_between_their_markers() {
    let runs =
        [record("build-a", 10_000, 1e6), record("build-a", 10_000, 3e6), record("build-b", 20_000, 2e6)];
    let root = checkout(PAGE, &runs);
    let changed = write(root.path()).unwrap();
    assert_eq!(changed.len(), 2);
    let page = fs::read_to_string(root.path().join("docs/page.md")).unwrap();
    assert!(page.starts_with("# Speed\n") && page.ends_with("<!-- end -->\nlast\n"), "{page}");
    assert!(!page.contains("old"), "{page}");
    assert!(page.contains("| | triangles | Speed of it | Spread |\n"), "{page}");
    assert!(page.contains("| a | 10.0 k | 2.00 M/s | 100 % |\n| b |"), "{page}");
    assert!(page.contains("\n\nTest CPU, 2 cores, 4.0 GiB, Linux 6.\n"), "{page}");
    assert!(page.contains("Commit abc, 2026-01-01; Test CPU"), "{page}");
    assert!(
        page.contains(
            "- `build-a`: `trex build gen:soup:10000 -o a.trex`; seed 1; result 00ff; median of 2 runs"
        ),
        "{page}"
    );
    assert!(page.contains("](plots/speed.svg)"), "{page}");
    let svg = fs::read_to_string(root.path().join("docs/plots/speed.svg")).unwrap();
    assert!(svg.starts_with("<svg") && svg.contains("triangles per s"), "{svg}");
}

#[test]
fn what_a_figure_tells_at_several_places_is_a_line() {
    let page = "<!-- plot:error err-* x=error_at_ms.* y=median -->\n<!-- end -->\n\
                <!-- commands:err-* -->\n<!-- end -->\n";
    let mut one = record("err-a", 1, 1.0);
    for (key, value) in [("33.median", 3.0), ("100.median", 2.0), ("100.max", 9.0), ("x.median", 7.0)] {
        one.values.insert(format!("error_at_ms.{key}"), json!(value));
    }
    let figures = figure::group(vec![one.clone()]);
    let line = figures[0].line("error_at_ms", "median");
    assert_eq!(line.points, [(33.0, 3.0), (100.0, 2.0)]);
    let root = checkout(page, &[one]);
    write(root.path()).unwrap();
    let page = fs::read_to_string(root.path().join("docs/page.md")).unwrap();
    assert!(page.contains("![median over error at](plots/error.svg)"), "{page}");
}

#[test]
fn a_second_run_changes_nothing() {
    let root = checkout(PAGE, &[record("build-a", 10_000, 1e6)]);
    write(root.path()).unwrap();
    assert_eq!(stale(root.path()).unwrap(), Vec::<PathBuf>::new());
    fs::remove_file(root.path().join("docs/plots/speed.svg")).unwrap();
    assert_eq!(stale(root.path()).unwrap(), [root.path().join("docs/plots/speed.svg")]);
}

/// A heading over an empty table once promised what was not there.
#[test]
fn a_table_without_records_is_absent_with_its_words() {
    let page = "<!-- record:build-* say=\"How fast it is.\" triangle_count -->\nold\n<!-- end -->\n";
    let root = checkout(page, &[]);
    write(root.path()).unwrap();
    let empty = fs::read_to_string(root.path().join("docs/page.md")).unwrap();
    assert_eq!(empty.lines().count(), 2, "{empty}");
    let page = page.to_owned() + "<!-- commands:build-a -->\n<!-- end -->\n";
    let root = checkout(&page, &[record("build-a", 10_000, 1e6)]);
    write(root.path()).unwrap();
    let full = fs::read_to_string(root.path().join("docs/page.md")).unwrap();
    assert!(full.contains("-->\n\nHow fast it is.\n\n| | triangles |"), "{full}");
}

#[test]
fn figures_stand_in_sentences_of_pages_and_of_the_readme() {
    let page = "fast: <!-- figure:build-a triangles_per_s -->old<!-- -->, \
                <!-- figure:build-* triangle_count -->old<!-- --> each, \
                <!-- figure:build-b triangles_per_s/triangle_count -->old<!-- --> of it, \
                <!-- figure:build-a triangle_count+triangle_count -->old<!-- --> of both\n\
                <!-- commands:build-* -->\n<!-- end -->\n";
    let root = checkout(page, &[record("build-a", 10_000, 1e6), record("build-b", 20_000, 3e6)]);
    fs::write(root.path().join(README), "It makes <!-- figure:build-a triangles_per_s --><!-- -->.\n")
        .unwrap();
    write(root.path()).unwrap();
    let page = fs::read_to_string(root.path().join("docs/page.md")).unwrap();
    for text in [
        "-->1.00 M/s<!-- -->, ",
        "-->10.0 k to 20.0 k<!-- --> each",
        "-->150<!-- --> of it",
        "-->20.0 k<!-- --> of both",
    ] {
        assert!(page.contains(text), "{page}");
    }
    let readme = fs::read_to_string(root.path().join(README)).unwrap();
    assert_eq!(readme, "It makes <!-- figure:build-a triangles_per_s -->1.00 M/s<!-- -->.\n");
}

#[test]
fn models_without_records_have_no_table() {
    let page = "<!-- compare:a=\"Model A\" build-*:triangles_per_s=\"Speed\" -->\nold\n<!-- end -->\nafter\n";
    let root = checkout(page, &[]);
    write(root.path()).unwrap();
    let page = fs::read_to_string(root.path().join("docs/page.md")).unwrap();
    assert!(!page.contains("| |") && !page.contains("old") && page.ends_with("-->\nafter\n"), "{page}");
}

#[test]
fn models_stand_side_by_side() {
    let page = "<!-- compare:a=\"Model A\" b=\"Model B\" beside=\"Theirs\"\n\
                build-*:triangles_per_s,triangle_count=\"Speed, size\" beside=\"0.5 M/s\" -->\nold\n<!-- end -->\n\
                <!-- commands:build-* -->\n<!-- end -->\n";
    let root = checkout(page, &[record("build-a", 10_000, 1e6)]);
    write(root.path()).unwrap();
    let page = fs::read_to_string(root.path().join("docs/page.md")).unwrap();
    let table = "| | Model A | Model B | Theirs |\n|---|---:|---:|---:|\n\
                 | Speed, size | 1.00 M/s, 10.0 k | - | 0.5 M/s |\n\nTest CPU";
    assert!(page.contains(table), "{page}");
}

/// Tables once held rows of a Xeon beside rows of an EPYC, as if they compared.
#[test]
fn no_table_has_two_machines() {
    let mut other = record("build-b", 20_000, 2e6);
    other.machine.cpu = "Other CPU".into();
    let records = [record("build-a", 10_000, 1e6), other];
    let root = checkout(PAGE, &records);
    write(root.path()).unwrap();
    let page = fs::read_to_string(root.path().join("docs/page.md")).unwrap();
    assert_eq!(page.matches("| | triangles | Speed of it |").count(), 2, "{page}");
    let page = "<!-- compare:a=\"A\" b=\"B\" build-*:triangle_count=\"Size\" -->\n<!-- end -->\n";
    let error = format!("{:#}", render(checkout(page, &records).path()).unwrap_err());
    assert!(error.contains("2 machines"), "{error}");
}

#[test]
fn bad_markers_are_named_with_their_line() {
    for (page, why) in [
        ("\n<!-- record:a b -->\n", "line 2: <!-- end --> is missing"),
        ("a <!-- figure:a b -->\n", "line 1: <!-- --> is missing"),
        ("a <!-- figure:a b --><!-- -->\n", "a: no such record"),
        ("a <!-- figure:build-a b --><!-- -->\n", "build-a: the record has no b"),
        ("<!-- figure:build-a triangle_count --><!-- -->\n", "again: [\"build-a\"]"),
        (
            "<!-- compare:a=\"A\" build-*:triangle_count=\"T\" x-*:b=\"B\" -->\n<!-- end -->\n",
            "no record of any column",
        ),
        ("<!-- record:a say=b c -->\n<!-- end -->\n", "say="),
        ("<!-- record:a -->\n<!-- end -->\n", "names no key"),
        ("<!-- record:a b=c -->\n<!-- end -->\n", "accepted is KEY"),
        ("<!-- record:a b\n<!-- end -->\n", "does not end in"),
        ("<!-- plot:a b x=c -->\n<!-- end -->\n", "accepted is"),
        ("<!-- plot:a b c d -->\n<!-- end -->\n", "axes are"),
    ] {
        let root = checkout(page, &[record("build-a", 10_000, 1e6)]);
        let error = format!("{:#}", render(root.path()).unwrap_err());
        assert!(error.contains(why), "{page}: {error}");
    }
}
