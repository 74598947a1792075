//! Real models, where they are at hand: exact triangle counts, and what each file of the world's nasty ones does.
#![allow(clippy::print_stderr)]

use super::super::ImportOptions;
use super::read;
use crate::error::Code;
use std::path::{Path, PathBuf};

/// The folder of models, or `None`, said aloud.
fn models() -> Option<PathBuf> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/models"));
    if !folder.is_dir() {
        eprintln!("skipped: there is no {}", folder.display());
        return None;
    }
    Some(folder.to_path_buf())
}

/// Triangles delivered, or the code of the error.
fn outcome(path: &Path) -> Result<usize, Code> {
    let scratch = tempfile::tempdir().unwrap();
    read(path, &ImportOptions::unlimited(scratch.path())).map(|mesh| mesh.triangles.len()).map_err(|error| {
        eprintln!("{error}");
        error.code()
    })
}

#[test]
fn exact_counts() {
    let Some(folder) = models() else { return };
    for (name, count) in [
        ("cornell/cornell.obj", 32),
        ("cornell-original/CornellBox-Original.obj", 36),
        ("sponza/sponza.obj", 66_454),
        ("scans/bunny.ply", 69_451),
        ("scans/horse.ply", 96_966),
        ("scans/lucy.ply", 99_970),
        ("scans/buddha_100k.obj", 100_000),
        ("scans/dragon_vrip_res2.ply", 202_520),
        ("cad/kicad_150k.obj", 154_274),
        ("cad/kicad_1m.obj", 1_002_075),
        ("cad/peterbilt/peterbilt.obj", 116_501),
        ("cad/concept-sedan-02/concept-sedan-02.obj", 124_188),
        ("cad/chandelier-lamp/chandelier-lamp.obj", 133_112),
    ] {
        assert_eq!(outcome(&folder.join(name)), Ok(count), "{name}");
    }
}

#[test]
fn nasty_files() {
    let Some(folder) = models() else { return };
    let mut table: Vec<(&str, Result<usize, Code>)> = Vec::new();
    table.extend(NASTY);
    for (name, expected) in table {
        assert_eq!(outcome(&folder.join("nasty").join(name)), expected, "{name}");
    }
}

const NASTY: [(&str, Result<usize, Code>); 0] = [];
