//! The model of the examples: the page file that the command line names, or a wave of 80,000 triangles, built into a
//! folder that goes with it.

use rayon::ThreadPoolBuilder;
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;
use trex_store::build::{BuildOptions, ExistingOutput, Precision, Voxels, build};
use trex_store::import::{ImportOptions, open};
use trex_store::{Budget, Code, Error, Interrupt};

/// Squares along a side of the wave.
const SIDE: usize = 200;

/// A page file.
pub(crate) struct Model {
    pub(crate) path: PathBuf,
    _folder: Option<tempfile::TempDir>,
}

/// The file of the first argument, or the wave.
pub(crate) fn model() -> Result<Model, Error> {
    if let Some(path) = std::env::args_os().nth(1) {
        return Ok(Model { path: path.into(), _folder: None });
    }
    let folder = tempfile::tempdir().map_err(|error| Error::io("make a folder", ".".as_ref(), &error))?;
    let (input, path) = (folder.path().join("wave.obj"), folder.path().join("wave.trex"));
    let mut text = String::new();
    for at in 0..(SIDE + 1) * (SIDE + 1) {
        let [x, y] = [at % (SIDE + 1), at / (SIDE + 1)].map(|i| i as f64 / SIDE as f64);
        let _ = writeln!(text, "v {x} {} {y}", 0.1 * (9.0 * x).sin() * (7.0 * y).cos());
    }
    for at in 0..SIDE * SIDE {
        let a = at + at / SIDE + 1;
        let _ = writeln!(text, "f {a} {} {} {}", a + SIDE + 1, a + SIDE + 2, a + 1);
    }
    std::fs::write(&input, text).map_err(|error| Error::writing("write the wave", &input, &error))?;
    let pool = ThreadPoolBuilder::new()
        .num_threads(2)
        .build()
        .map_err(|error| Error::new(Code::Io, "the system refused a thread").numbers(error.to_string()))?;
    let options = BuildOptions {
        precision: Precision::Default,
        voxels: Voxels::Resolution(64),
        pool: Arc::new(pool),
        budget: Budget::unlimited(),
        temp_dir: None,
        existing: ExistingOutput::Keep,
        resume: None,
        interrupt: Interrupt::default(),
    };
    let mut source = open(&input, &ImportOptions::unlimited(folder.path()))?;
    build(&mut *source, &path, &options, &|_| {}, &|_| {})?;
    Ok(Model { path, _folder: Some(folder) })
}
