//! What is done with files as a whole: build, info, verify.
//!
//! Answers are JSON texts with the keys of the command's documents, which the package reads.

use crate::detached;
use crate::errors::raised;
use crate::spool::NativeSpool;
use datasets_gen::{GenOptions, Spec};
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use serde_json::Value;
use std::num::NonZero;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::thread::available_parallelism;
use trex_model::{Model, OpenOptions};
use trex_store::build::{BuildOptions, ExistingOutput, Precision, Voxels, build as build_from};
use trex_store::import::{self, ByteOrder, ImportOptions, RawVolume, SampleType, VolumeOptions};
use trex_store::octree::Refinement;
use trex_store::output::check_apart;
use trex_store::verify::{self as verification, Level};
use trex_store::{Budget, Chain, Code, Error, Progress, Result, TriangleSource};

/// What a name begins with that is a generator's.
const GENERATED: &str = "gen:";
/// What a page file's name ends in.
const PAGE_FILE: &str = "trex";
/// Share of the free memory that vertex caches of all inputs may take.
const CACHE_SHARE: u64 = 4;
/// Limit of those who read tables alone, unless they are larger.
const INFO_LIMIT_BYTES: u64 = 512 << 20;

/// How [`build`] works.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct BuildArgs {
    memory_limit: u64,
    threads: Option<usize>,
    /// `None`: as fine as their share of memory allows. Resolutions of the resident leaves and of the finest; 0: none.
    voxels: Option<(u32, u32)>,
    grid_bits: Option<u32>,
    error: Option<f64>,
    overwrite: bool,
    temp_dir: Option<PathBuf>,
    /// Values of the surfaces of volumes.
    iso: Vec<f64>,
    /// What `.raw` files hold: size, type of samples, whether their bytes are swapped, spacing.
    raw: Option<([u64; 3], String, bool, [f64; 3])>,
}

/// Builds a page file from files and generators.
#[pyfunction]
pub(crate) fn build(
    py: Python<'_>,
    inputs: Vec<PathBuf>,
    out: PathBuf,
    args: BuildArgs,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    detached::run(py, progress.as_ref(), |work| {
        let options = build_options(&args, Budget::new(args.memory_limit), work)?;
        let mut source = open(&inputs, &out, &options, volumes(&args)?)?;
        build_file(&mut *source, &out, &options, work)
    })
}

/// Builds a page file from what was spooled.
#[pyfunction]
pub(crate) fn build_spooled(
    py: Python<'_>,
    spool: PyRef<'_, NativeSpool>,
    out: PathBuf,
    args: BuildArgs,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let mut source = raised(py, spool.take())?;
    detached::run(py, progress.as_ref(), |work| {
        let options = build_options(&args, source.budget().clone(), work)?;
        build_file(&mut source, &out, &options, work)
    })
}

/// What a page file or a mesh file holds, without loading it.
#[pyfunction]
pub(crate) fn info(py: Python<'_>, path: PathBuf) -> PyResult<String> {
    detached::run(py, None, |_| info_of(&path))
}

/// Checks a page file as far as `level` says: `quick`, `hashes` or `deep`.
#[pyfunction]
pub(crate) fn verify(
    py: Python<'_>,
    path: PathBuf,
    level: &str,
    memory_limit: u64,
    progress: Option<Py<PyAny>>,
) -> PyResult<String> {
    let level = raised(py, level_of(level))?;
    detached::run(py, progress.as_ref(), |work| {
        let budget = Budget::new(memory_limit);
        let report = |done, total| {
            let memory_bytes = budget.used_bytes();
            work.report(Progress { phase: "verify", done, total, unit: "bytes", memory_bytes });
            work.interrupt.check()
        };
        let verdict = verification::check(
            &path,
            &verification::Options { level, bytes_per_s: None },
            &budget,
            &report,
        )?;
        Ok(json(&verdict).to_string())
    })
}

fn level_of(name: &str) -> Result<Level> {
    match name {
        "quick" => Ok(Level::Quick),
        "hashes" => Ok(Level::Hashes),
        "deep" => Ok(Level::Deep),
        _ => Err(usage("level", "there is no such level", format!("{name:?}"))
            .next("give 'quick', 'hashes' or 'deep'")),
    }
}

fn info_of(path: &Path) -> Result<String> {
    if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case(PAGE_FILE)) {
        let mut options = OpenOptions::with_limit(INFO_LIMIT_BYTES);
        options.budget = Budget::unlimited();
        options.threads = trex_model::ThreadSource::Start(NonZero::<usize>::MIN);
        return Ok(json(&Model::open(path, &options)?.info()?).to_string());
    }
    let options = ImportOptions::new(Budget::new(INFO_LIMIT_BYTES), path.parent().unwrap_or(path));
    Ok(json(&import::info(path, &options)?).to_string())
}

fn build_options(args: &BuildArgs, budget: Budget, work: &detached::Work) -> Result<BuildOptions> {
    Ok(BuildOptions {
        precision: precision(args)?,
        voxels: voxels(args)?,
        pool: threads(args.threads)?,
        budget,
        temp_dir: args.temp_dir.clone(),
        existing: ExistingOutput::replace_if(args.overwrite),
        interrupt: work.interrupt.clone(),
        resume: None,
    })
}

fn build_file(
    source: &mut dyn TriangleSource,
    out: &Path,
    options: &BuildOptions,
    work: &detached::Work,
) -> Result<String> {
    let report = build_from(source, out, options, &|_| {}, &|progress| work.report(progress))?;
    let mut answer = json(&report);
    answer["bytes_per_triangle"] = (report.output_bytes as f64 / report.triangle_count.max(1) as f64).into();
    answer["warnings"] = report.source.warnings.into();
    Ok(answer.to_string())
}

/// All inputs as one source.
fn open(
    inputs: &[PathBuf],
    out: &Path,
    options: &BuildOptions,
    volumes: VolumeOptions,
) -> Result<Box<dyn TriangleSource>> {
    if inputs.is_empty() {
        return Err(usage("inputs", "there is no input", "0 inputs".into()).next("give at least one"));
    }
    let beside = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let mut reading =
        ImportOptions::new(options.budget.clone(), options.temp_dir.as_deref().unwrap_or(beside));
    reading.interrupt = options.interrupt.clone();
    reading.volumes = volumes;
    reading.vertex_cache_bytes = options.budget.free_bytes() / CACHE_SHARE / inputs.len() as u64;
    let generating = GenOptions {
        threads: options.pool.current_num_threads(),
        budget: options.budget.clone(),
        interrupt: options.interrupt.clone(),
    };
    let open_one = |input: &PathBuf| match input.to_str().filter(|name| name.starts_with(GENERATED)) {
        Some(name) => datasets_gen::open(&Spec::parse(name)?, &generating),
        None => check_apart(out, input).and_then(|()| import::open(input, &reading)),
    };
    let sources: Result<Vec<_>> = inputs.iter().map(open_one).collect();
    Chain::from_sources(sources?, &options.budget)
}

/// How the volumes among the inputs are read.
fn volumes(args: &BuildArgs) -> Result<VolumeOptions> {
    let raw = args.raw.as_ref().map(|(size, name, is_big_endian, spacing)| {
        let sample = SampleType::from_name(name).ok_or_else(|| {
            usage("raw", "there are no such samples", format!("type {name:?}"))
                .next("give a type of integers of 8 to 64 bits, or of floats of 32 or 64")
        })?;
        let order = if *is_big_endian { ByteOrder::Big } else { ByteOrder::Little };
        Ok(RawVolume { size: *size, sample, order, spacing: *spacing })
    });
    Ok(VolumeOptions { iso_values: args.iso.clone(), raw: raw.transpose()? })
}

fn precision(args: &BuildArgs) -> Result<Precision> {
    match (args.grid_bits, args.error) {
        (None, None) => Ok(Precision::Default),
        (Some(bits), None) => Ok(Precision::GridBits(bits)),
        (None, Some(error)) => Ok(Precision::Error(error)),
        (Some(bits), Some(error)) => Err(usage(
            "grid_bits",
            "both say how fine the lattice is",
            format!("{bits}, beside error {error}"),
        )
        .next("give one of them")),
    }
}

fn voxels(args: &BuildArgs) -> Result<Voxels> {
    let Some((upper, finest)) = args.voxels else { return Ok(Voxels::default()) };
    if (upper, finest) == (0, 0) {
        return Ok(Voxels::None);
    }
    let offered = [64, 256, 512, 1024].contains(&upper) && finest.is_multiple_of(upper);
    match Refinement::from_factor(if offered { finest / upper } else { 0 }) {
        Some(refinement) => Ok(Voxels::Refined { upper, refinement }),
        None => Err(usage("voxels", "there are no such voxels", format!("{upper}, the finest {finest}"))
            .next("give 64, 256, 512 or 1024, or a pair of one of these and 1, 4 or 16 times that")),
    }
}

/// The threads of work that begins and ends with a call.
fn threads(count: Option<usize>) -> Result<Arc<ThreadPool>> {
    let count = count.or_else(|| available_parallelism().ok().map(NonZero::get)).unwrap_or(1).max(1);
    let pool =
        ThreadPoolBuilder::new().num_threads(count).thread_name(|index| format!("trex-worker-{index}"));
    pool.build().map(Arc::new).map_err(|error| Error::threads_refused(count, &error))
}

fn usage(place: &str, what: &str, numbers: String) -> Error {
    Error::new(Code::Usage, what).at_place(place).numbers(numbers)
}

fn json(answer: &impl serde::Serialize) -> Value {
    serde_json::to_value(answer).expect("reports have keys that are text")
}
