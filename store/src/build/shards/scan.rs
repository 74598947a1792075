//! The scan: from inputs to the plan of their shards.

use super::{by_phase, check_named};
use crate::build::draft::Draft;
use crate::build::input_sizes::CountingSource;
use crate::build::model_materials::ModelMaterials;
use crate::build::options::BuildOptions;
use crate::build::partition::shard::CensusWork;
use crate::build::phases::PhaseClock;
use crate::build::report::PhaseReport;
use crate::build::scan::{self, lattice};
use crate::build::scratch::Scratch;
use crate::build::shard_file::PlannedModel;
use crate::build::shard_plan::ShardPlan;
use crate::build::site::BuildSite;
use crate::error::Result;
use crate::progress::Report;
use crate::scratch::Place;
use crate::source::{SourceStats, TriangleSource};
use serde::Serialize;
use std::path::Path;

/// What is scanned.
pub struct ScanWork<'a> {
    /// The plan to publish.
    pub output: &'a Path,
    /// What tells the inputs apart from others, by name: their content and how it is read. Shards must have the same.
    pub facts: &'a [(String, String)],
    /// Whether the plan gets the triangles, sorted, so that shards need no inputs: at 4 to 9 bytes each, more with
    /// colours and normals; until it is written, as much scratch.
    pub keeps_triangles: bool,
    /// Those of the build; threads and resumption are not used.
    pub options: &'a BuildOptions,
}

/// Counts, sizes and times of a scan.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ScanReport {
    /// Tells the plan from others, in hexadecimal.
    pub plan_id: String,
    /// Triangles delivered by the source.
    pub input_triangle_count: u64,
    /// Triangles that will be stored.
    pub triangle_count: u64,
    /// Cells of the first sort.
    pub cell_count: u64,
    /// Stretches of cells that no shard divides: more shards than these leave some without work.
    pub stretch_count: u64,
    /// Triangles of the longest of them.
    pub longest_stretch: u64,
    /// Leaves of the resident octree along an axis; 0 without one.
    pub upper_resolution: u32,
    /// Length of the plan.
    pub plan_bytes: u64,
    /// Milliseconds, on the wall and in the processor.
    pub total_ms: u64,
    /// See `total_ms`.
    pub total_cpu_ms: u64,
    /// Counters of the source on its last pass.
    #[serde(skip)]
    pub source: SourceStats,
}

/// Scans `source`, and publishes the plan of its shards.
///
/// # Errors
/// Those of [`build`](crate::build::build()) up to the sort of triangles.
pub fn scan(source: &mut dyn TriangleSource, work: &ScanWork<'_>, report: Report<'_>) -> Result<ScanReport> {
    by_phase(&work.options.budget, report, |report| work.run(source, report))
}

impl ScanWork<'_> {
    fn run(&self, source: &mut dyn TriangleSource, report: PhaseReport<'_>) -> Result<ScanReport> {
        let ScanWork { output, facts, keeps_triangles, options } = *self;
        let mut clock = PhaseClock::start();
        let BuildSite { folder, scratch_folder } = BuildSite::folders(output, options)?;
        let scan = scan::scan(source, options, report, &mut 0)?;
        let grid = lattice::choose(&scan, options.precision, &source.name())?;
        let mut source = CountingSource::new(source);
        let place = Place::Unnamed(scratch_folder);
        let scratch = if keeps_triangles { Some(Scratch::create(place)?) } else { None };
        let census = CensusWork { scan: &scan, grid, scratch, options, report }.run(&mut source)?;
        let materials = ModelMaterials::of(source.materials(), &census.mean_colours, &options.budget)?;
        let (sizes, stats) = (source.sizes(), source.stats());
        check_named(output, &stats)?;
        // Files that the inputs name stand elsewhere on other machines, and what was looked up follows from the limit.
        let source = SourceStats {
            named_files: Vec::new(),
            vertex_lookups: 0,
            vertex_cache_misses: 0,
            ..stats.clone()
        };
        let model = PlannedModel { summary: census.summary.clone(), sizes, source, materials };
        let draft = Draft::create(output, &folder, Place::Unnamed(folder.clone()))?;
        let (id, plan_bytes) = ShardPlan::write(facts, &model, &census, draft.file(), options)?;
        draft.publish_unread(output, options)?;
        let stretches = census.cells.stretch_lengths();
        let (total_ms, total_cpu_ms) = clock.lap();
        Ok(ScanReport {
            plan_id: format!("{id:016x}"),
            input_triangle_count: model.summary.input_triangle_count,
            triangle_count: model.summary.triangle_count,
            cell_count: census.cells.len() as u64,
            stretch_count: stretches.len() as u64,
            longest_stretch: stretches.into_iter().max().unwrap_or(0),
            upper_resolution: model.summary.octree.map_or(0, |(resolution, _)| resolution),
            plan_bytes,
            total_ms,
            total_cpu_ms,
            source: stats,
        })
    }
}
