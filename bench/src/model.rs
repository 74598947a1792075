//! The model of a workload: a page file as it lies, or a generator's mesh, built into a temporary folder.
//!
//! Invariant: nothing is left behind: the folder of a built model goes with its [`Model`].

use datasets_gen::{GenOptions, Spec};
use rayon::ThreadPoolBuilder;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tempfile::TempDir;
use trex_render::{Camera, Fov};
use trex_store::build::{BuildOptions, BuildReport, ExistingOutput, Precision, Voxels};
use trex_store::{Budget, Error, Interrupt};

/// What a workload runs on.
#[derive(Debug)]
pub struct Model {
    /// The page file.
    pub path: PathBuf,
    /// How it was named: a path, or `gen:KIND:COUNT:SEED`.
    pub scene: String,
    /// The generator's overview; `None`: the camera frames the model.
    pub view: Option<Camera>,
    _folder: Option<TempDir>,
}

/// Surroundings of a workload.
#[derive(Clone, Debug)]
pub struct Surroundings {
    /// Worker threads, at least 1.
    pub threads: usize,
    /// The ledger of the memory limit.
    pub budget: Budget,
    /// Where temporary folders are made.
    pub folder: PathBuf,
    /// Stops the work when raised.
    pub interrupt: Interrupt,
}

impl Model {
    /// Opens `name`: the path of a page file, or a generator's specification, which is built first.
    ///
    /// # Errors
    /// Those of the generator and of the build.
    pub fn open(name: &str, around: &Surroundings) -> anyhow::Result<Model> {
        Model::with_voxels(name, Voxels::Resolution(1024), around)
    }

    /// A generator's mesh for a bench: built in `folder` by one thread in 1 GiB.
    ///
    /// # Panics
    /// When it cannot be built.
    pub fn for_bench(name: &str, voxels: Voxels, folder: PathBuf) -> Model {
        let around = Surroundings {
            threads: 1,
            budget: Budget::new(1 << 30),
            folder,
            interrupt: Interrupt::default(),
        };
        Model::with_voxels(name, voxels, &around).expect("a build")
    }

    fn with_voxels(name: &str, voxels: Voxels, around: &Surroundings) -> anyhow::Result<Model> {
        if !name.starts_with("gen:") {
            let path = PathBuf::from(name);
            return Ok(Model { path, scene: name.to_owned(), view: None, _folder: None });
        }
        let spec = Spec::parse(name)?;
        let folder = temporary_folder(&around.folder)?;
        let path = folder.path().join("model.trex");
        build(&spec, &path, voxels, around)?;
        let view = datasets_gen::views(&spec).into_iter().next().map(|view| Camera {
            position: view.position,
            target: view.target,
            up: view.up,
            fov: Fov::X(view.fov_x_deg),
        });
        Ok(Model { path, scene: name.to_owned(), view, _folder: Some(folder) })
    }
}

/// An own folder in `parent`, removed when dropped.
pub(crate) fn temporary_folder(parent: &Path) -> anyhow::Result<TempDir> {
    let made = tempfile::Builder::new().prefix("trex-bench-").tempdir_in(parent);
    Ok(made.map_err(|error| Error::writing("make a temporary folder", parent, &error))?)
}

/// Generates `spec` and builds it at the default precision.
pub(crate) fn build(
    spec: &Spec,
    path: &Path,
    voxels: Voxels,
    around: &Surroundings,
) -> anyhow::Result<BuildReport> {
    let Surroundings { threads, budget, interrupt, .. } = around.clone();
    let options = GenOptions { threads, budget: budget.clone(), interrupt: interrupt.clone() };
    let mut source = datasets_gen::open(spec, &options)?;
    let options = BuildOptions {
        precision: Precision::Default,
        voxels,
        pool: Arc::new(ThreadPoolBuilder::new().num_threads(threads).build()?),
        budget,
        temp_dir: None,
        existing: ExistingOutput::Keep,
        resume: None,
        interrupt,
    };
    Ok(trex_store::build::build(&mut *source, path, &options, &|_| {}, &|_| {})?)
}
