//! A small model of a generator, built for tests.

use std::path::{Path, PathBuf};

/// The path of the model in `folder`.
pub(crate) fn build(folder: &Path) -> PathBuf {
    let path = folder.join("model.trex");
    build_with(&path, "gen:isosurface:20k", trex_store::build::Voxels::Resolution(64));
    path
}

/// Builds the model of a generator as `path`.
pub(crate) fn build_with(path: &Path, spec: &str, voxels: trex_store::build::Voxels) {
    use trex_store::{Budget, Interrupt, build};
    let pool = std::sync::Arc::new(rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap());
    let (budget, interrupt) = (Budget::new(512 << 20), Interrupt::default());
    let spec = datasets_gen::Spec::parse(spec).unwrap();
    let generator =
        datasets_gen::GenOptions { threads: 2, budget: budget.clone(), interrupt: interrupt.clone() };
    let options = build::BuildOptions {
        precision: build::Precision::Default,
        voxels,
        pool,
        budget,
        temp_dir: None,
        existing: build::ExistingOutput::Keep,
        resume: None,
        interrupt,
    };
    let mut source = datasets_gen::open(&spec, &generator).unwrap();
    build::build(&mut *source, path, &options, &|_| {}, &|_| {}).unwrap();
}
