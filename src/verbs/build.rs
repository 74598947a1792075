//! `trex build`: meshes to a page file.

use super::beside;
use super::inputs::{self, InputList};
use crate::args::{BuildArgs, VoxelArgs};
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use crate::values::Input;
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Duration;
use trex_store::build::left_over::{self, LeftOver};
use trex_store::build::{self, BuildOptions, BuildReport, ExistingOutput, Plan, Precision, Resume, Voxels};
use trex_store::output::check_apart;
use trex_store::printable::one_line;
use trex_store::{
    AttributeSet, CreaseOptions, CreasedSource, Error, PlainSource, Result, SourceStats, TriangleSource,
    stamp,
};

/// About how much work a kill may cost where nothing else is said: as the flag has it.
pub const JOURNAL_EVERY: Duration = Duration::from_secs(3);
/// Longest time between two records of a journal, seconds: a day.
const JOURNAL_EVERY_MOST_S: f64 = 86_400.0;

/// Runs `trex build`.
pub fn run(args: &BuildArgs, ctx: &Context) -> anyhow::Result<Exit> {
    if args.resume.clean {
        let unfinished = left_over::clean(&args.output)?;
        ctx.output.result("build-clean", &UnfinishedBuilds { is_cleaned: true, unfinished })?;
        return Ok(Exit::Done);
    }
    let work = Work {
        output: &args.output,
        temp_dir: args.scratch.temp_dir.as_deref(),
        existing: ExistingOutput::replace_if(args.overwrite.overwrite),
        precision: args.lattice.precision(),
        voxels: voxels(&args.voxels),
        resume: resume(args)?,
    };
    for input in &args.inputs {
        if let Input::File(path) = input {
            check_apart(&args.output, path)?;
        }
    }
    let volumes = args.volumes.options();
    let inputs = InputList::new(&args.inputs, &volumes, &args.attributes);
    let built = with_source(inputs, &work.scratch_folder(), ctx, |source| work.build(source, ctx));
    ctx.done(&built?)
}

/// Opens the inputs for `build`. An error of a limit that is too small names the one that has room for a build.
pub fn with_source<T>(
    inputs: InputList<'_>,
    scratch: &Path,
    ctx: &Context,
    build: impl FnOnce(&mut dyn TriangleSource) -> Result<T>,
) -> Result<T> {
    let opened = inputs::open(inputs, scratch, inputs.crease_bytes() + build::smallest_bytes(), ctx);
    let opened = opened.map(|source| -> Box<dyn TriangleSource> {
        match inputs.dropped {
            none if none == AttributeSet::default() => source,
            dropped => Box::new(PlainSource { source, dropped }),
        }
    });
    let made = opened.and_then(|source| match inputs.crease_deg {
        Some(degrees) => with_normals(source, degrees, scratch, ctx),
        None => Ok(source),
    });
    let built = made.and_then(|mut source| build(&mut *source));
    built.map_err(|error| inputs::with_smallest_limit(error, inputs, scratch, ctx))
}

/// A source whose normals are made of its mesh.
fn with_normals(
    source: Box<dyn TriangleSource>,
    angle_deg: f64,
    folder: &Path,
    ctx: &Context,
) -> Result<Box<dyn TriangleSource>> {
    let options = CreaseOptions {
        angle_deg,
        folder,
        budget: &ctx.budget,
        interrupt: &ctx.interrupt,
        report: &ctx.report(),
    };
    Ok(Box::new(CreasedSource::new(source, &options)?))
}

/// What the build does so that it can resume.
pub fn resume(args: &BuildArgs) -> Result<Option<Resume>> {
    let every = Duration::from_secs_f64(args.resume.journal_every.0.min(JOURNAL_EVERY_MOST_S));
    let volumes = args.volumes.options();
    let inputs = InputList::new(&args.inputs, &volumes, &args.attributes);
    let mut resume = Resume { every, ..resume_of(inputs)? };
    resume.input.extend(inputs.attribute_facts());
    Ok((!args.resume.no_resume).then_some(resume))
}

/// What tells the inputs apart from others: a file by its path, length, time and parts of its bytes, a generator by its
/// name, volumes also by how they are read.
pub fn resume_of(list: InputList<'_>) -> Result<Resume> {
    let fact = |(number, input): (usize, &Input)| {
        let value = match input {
            Input::Generated(name) => name.clone(),
            Input::File(path) => {
                let full = path.canonicalize().map_err(|error| Error::io("open the input", path, &error))?;
                format!("{full:?}, {}", stamp(&full))
            }
        };
        Ok((format!("input {}", number + 1), value))
    };
    let mut input = list.inputs.iter().enumerate().map(fact).collect::<Result<Vec<_>>>()?;
    if !list.volumes.iso_values.is_empty() {
        input.push(("volumes".to_owned(), format!("{:?}", list.volumes)));
    }
    Ok(Resume { input, every: JOURNAL_EVERY })
}

/// The voxel octree that is asked for.
pub fn voxels(args: &VoxelArgs) -> Voxels {
    match &args.voxels {
        _ if args.no_asvo => Voxels::None,
        Some(voxels) => Voxels::Refined { upper: voxels.upper, refinement: voxels.refinement },
        None => Voxels::Within { upper_bytes: upper_bytes(args) },
    }
}

/// Resident bytes that the octree may take. A leaf takes some 12, and its share of two maps of light and the sums of a
/// pass some 10 (a fifth of a facet, of 12, 12 and 24 bytes): of the two fifths of a limit that both may take, 55 % are
/// the octree's.
fn upper_bytes(args: &VoxelArgs) -> u64 {
    args.render_limit.as_ref().map_or(args.upper_budget.0, |limit| limit.0 * 2 / 5 * 55 / 100)
}

/// One build, as `build` and `demo` ask for it.
pub struct Work<'a> {
    pub output: &'a Path,
    pub temp_dir: Option<&'a Path>,
    pub existing: ExistingOutput,
    pub precision: Precision,
    pub voxels: Voxels,
    pub resume: Option<Resume>,
}

impl Work<'_> {
    /// Where scratch files go.
    pub fn scratch_folder(&self) -> PathBuf {
        let beside = self.output.parent().filter(|folder| !folder.as_os_str().is_empty());
        self.temp_dir.or(beside).unwrap_or(Path::new(".")).to_path_buf()
    }

    /// As options of the library.
    pub fn options(&self, ctx: &Context) -> Result<BuildOptions> {
        Ok(BuildOptions {
            precision: self.precision,
            voxels: self.voxels,
            pool: ctx.thread_pool()?,
            budget: ctx.budget.clone(),
            temp_dir: self.temp_dir.map(Path::to_path_buf),
            existing: self.existing,
            interrupt: ctx.interrupt.clone(),
            resume: self.resume.clone(),
        })
    }

    /// Builds, telling the plan and what the source met.
    pub fn build(&self, source: &mut dyn TriangleSource, ctx: &Context) -> Result<BuildSummary> {
        let options = self.options(ctx)?;
        let placed = source.stats();
        let tell_plan = |plan: &Plan| {
            if placed.instance_count > 0 {
                ctx.console.note(&format!(
                    "plan: {} instances of {} meshes become triangles of their own",
                    size::count(placed.instance_count),
                    size::count(placed.instanced_mesh_count),
                ));
            }
            tell_volumes(&placed, ctx);
            tell_sizes(plan, ctx);
        };
        let report = build::build(source, self.output, &options, &tell_plan, &ctx.report())?;
        if report.resumed_triangle_count > 0 {
            let [done, all] = [report.resumed_triangle_count, report.triangle_count].map(size::count);
            ctx.console.note(&format!("resumed: {done} of {all} triangles were done by an earlier build"));
        }
        if report.resumed_sorted_count > 0 {
            let sorted = size::count(report.resumed_sorted_count);
            ctx.console.note(&format!("resumed: {sorted} triangles were sorted by an earlier build"));
        }
        tell_warnings(&report.source, ctx);
        if let Some(line) = beside::write(&report.source.scene, self.output) {
            ctx.console.note(&one_line(&line));
        }
        Ok(BuildSummary::new(source.name(), report, ctx))
    }
}

/// What a build is going to take.
pub fn tell_sizes(plan: &Plan, ctx: &Context) {
    ctx.console.note(&format!(
        "plan: {} triangles; memory {} of {}; scratch about {}, output about {}, free {}",
        size::count(plan.triangle_count),
        size::bytes(plan.memory_bytes),
        size::bytes(plan.limit_bytes),
        size::bytes(plan.scratch_bytes),
        size::bytes(plan.output_bytes),
        size::bytes(plan.free_bytes),
    ));
    if plan.has_colours {
        ctx.console.note("plan: colours are kept, in pages of their own; --colors drop leaves them out");
    }
    if plan.has_normals {
        ctx.console.note("plan: normals are kept, in pages of their own; --normals drop leaves them out");
    }
    if plan.memory_bytes > plan.limit_bytes {
        ctx.console.note("plan: the limit may not be enough for the tables; --memory-limit sets another");
    }
    if plan.scratch_bytes + plan.output_bytes > plan.free_bytes {
        ctx.console.note("plan: the free space may not be enough; --temp-dir names another folder");
    }
}

/// What a source met.
pub fn tell_warnings(source: &SourceStats, ctx: &Context) {
    source.warnings.iter().for_each(|warning| ctx.console.note(&format!("note: {}", one_line(warning))));
}

/// What volumes among the inputs take.
fn tell_volumes(placed: &SourceStats, ctx: &Context) {
    if placed.slab_count > 0 {
        ctx.console.note(&format!(
            "plan: volumes of {} slabs, one after the other: {} of samples in memory",
            size::count(placed.slab_count),
            size::bytes(placed.slab_bytes),
        ));
    }
}

fn miss_rate(report: &BuildReport) -> Option<f64> {
    let lookups = report.source.vertex_lookups;
    (lookups > 0).then(|| report.source.vertex_cache_misses as f64 / lookups as f64)
}

/// Unfinished builds that were listed or removed.
#[derive(Debug, Serialize)]
pub struct UnfinishedBuilds {
    #[serde(skip)]
    pub is_cleaned: bool,
    pub unfinished: Vec<LeftOver>,
}

impl fmt::Display for UnfinishedBuilds {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.unfinished.is_empty() {
            return f.write_str("no unfinished builds");
        }
        for LeftOver { output, file_count, bytes, is_running } in &self.unfinished {
            let state = match (self.is_cleaned, is_running) {
                (true, _) => "removed",
                (false, true) => "at work",
                (false, false) => "goes on when the same command runs again; trex build --clean removes it",
            };
            let (output, bytes) = (output.display().to_string(), size::bytes(*bytes));
            writeln!(f, "unfinished: {}, {file_count} files, {bytes}: {state}", one_line(&output))?;
        }
        Ok(())
    }
}

/// The result of a build.
#[derive(Debug, Serialize)]
pub struct BuildSummary {
    pub scene: String,
    pub result_hash: String,
    #[serde(flatten)]
    pub report: BuildReport,
    /// Over the whole wall time, and over the time not spent waiting for the source.
    pub triangles_per_s: f64,
    pub triangles_per_s_without_source: f64,
    pub bytes_per_triangle: f64,
    pub vertex_cache_miss_rate: Option<f64>,
    pub dropped_attribute_count: u64,
    pub skipped_face_count: u64,
    /// Places of meshes that stand in more than one, each with triangles of its own.
    pub instance_count: u64,
    pub transparent_material_count: u64,
    pub memory: Memory,
}

impl BuildSummary {
    /// Of what was built of `scene`.
    pub fn new(scene: String, report: BuildReport, ctx: &Context) -> BuildSummary {
        let busy_ms = report.phase_ms.total.saturating_sub(report.phase_ms.generate).max(1);
        BuildSummary {
            scene,
            result_hash: report.file_id.clone(),
            triangles_per_s: report.input_triangle_count as f64 * 1e3 / report.phase_ms.total.max(1) as f64,
            triangles_per_s_without_source: report.input_triangle_count as f64 * 1e3 / busy_ms as f64,
            bytes_per_triangle: report.output_bytes as f64 / report.triangle_count as f64,
            vertex_cache_miss_rate: miss_rate(&report),
            dropped_attribute_count: report.source.dropped_attribute_count,
            skipped_face_count: report.source.skipped_face_count,
            instance_count: report.source.instance_count,
            transparent_material_count: report.source.transparent_material_count,
            memory: Memory::new(&ctx.budget),
            report,
        }
    }
}

impl fmt::Display for BuildSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let report = &self.report;
        writeln!(
            f,
            "{} triangles in {} clusters, {} pages, {}",
            size::count(report.triangle_count),
            size::count(report.cluster_count),
            report.page_count,
            size::bytes(report.output_bytes)
        )?;
        if report.triangle_count < report.input_triangle_count {
            writeln!(
                f,
                "rejected {} of {}: {} without area, {} smaller than the lattice tells, {} not finite",
                report.input_triangle_count - report.triangle_count,
                report.input_triangle_count,
                report.rejected_degenerate - report.rejected_collapsed,
                report.rejected_collapsed,
                report.rejected_non_finite
            )?;
        }
        if let Some(error) = report.keeping_error {
            writeln!(
                f,
                "note: --error {error:e} would keep all but one in 10,000 of those that the lattice lost"
            )?;
        }
        if self.dropped_attribute_count > 0 {
            writeln!(
                f,
                "dropped {} texture coordinates and other attributes, which pictures do not use",
                size::count(self.dropped_attribute_count)
            )?;
        }
        write!(
            f,
            "{:.2} bytes per triangle, vertices within {:e} of the input; {}, {}",
            self.bytes_per_triangle,
            report.error_bound,
            size::duration(std::time::Duration::from_millis(report.phase_ms.total)),
            size::rate(self.triangles_per_s, "triangles"),
        )
    }
}
