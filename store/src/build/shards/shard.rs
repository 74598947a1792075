//! A shard: its share of the chunks of a build, as a fragment; of the inputs, or of a plan that holds the triangles.
//!
//! It is locked, journalled and resumed as a build is, but that it resumes no later than behind the sort: chunks are
//! made again.

use super::by_phase;
use crate::budget::RESERVE_BYTES;
use crate::build::draft::Draft;
use crate::build::emit::voxels::VoxelWork;
use crate::build::emit::{self, ChunkSet, pack_context};
use crate::build::fragment::SHARDS;
use crate::build::fragment::fragment_reader::Fragment;
use crate::build::fragment::fragment_writer::{FragmentIdentity, FragmentWriter};
use crate::build::input_sizes::InputSizes;
use crate::build::journal::{FileKind, Journal};
use crate::build::options::{BuildOptions, Resume};
use crate::build::partition::Partition;
use crate::build::partition::cell_table::ShardShare;
use crate::build::partition::outcome::PartitionOutcome;
use crate::build::partition::shard::{ShardSort, SortedShard};
use crate::build::phases::{PhaseClock, PhaseCpuMs, PhaseMs};
use crate::build::plan::{Plan, plan, smallest_bytes_for};
use crate::build::report::PhaseReport;
use crate::build::shard_plan::ShardPlan;
use crate::build::site::{BuildSite, stopped};
use crate::error::{Code, Error, Result};
use crate::next_step::NextStep;
use crate::output::check_apart;
use crate::progress::Report;
use crate::scratch::Place;
use crate::source::{SourceStats, TriangleSource};
use serde::Serialize;
use std::path::Path;

/// What is built of a plan.
pub struct ShardWork<'a> {
    /// The plan.
    pub plan: &'a ShardPlan,
    /// Where it stands, for messages.
    pub plan_path: &'a Path,
    /// Which share, counted from 1, of how many.
    pub share: (u32, u32),
    /// What tells the inputs apart from others, by name: those of the plan; `None` where no inputs are at hand.
    pub facts: Option<&'a [(String, String)]>,
    /// The fragment to publish.
    pub output: &'a Path,
    /// Lattice and octree are the plan's.
    pub options: &'a BuildOptions,
    /// Called once, before anything is written.
    pub on_plan: &'a (dyn Fn(&Plan) + Sync),
}

/// Counts, sizes and times of a shard that is done.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ShardReport {
    /// The plan's, in hexadecimal.
    pub plan_id: String,
    /// Which share, counted from 1.
    pub shard: u32,
    /// Of how many.
    pub shard_count: u32,
    /// Triangles in the fragment.
    pub triangle_count: u64,
    /// Triangles of the whole model.
    pub model_triangle_count: u64,
    /// Chunks in the fragment.
    pub chunk_count: u64,
    /// Length of the fragment.
    pub output_bytes: u64,
    /// Scratch bytes.
    pub scratch_peak_bytes: u64,
    /// The fragment was there, whole, and was left alone.
    pub was_there: bool,
    /// Triangles that a build before this had sorted.
    pub resumed_sorted_count: u64,
    /// Milliseconds per phase.
    pub phase_ms: PhaseMs,
    /// Processor milliseconds of the process per phase.
    pub phase_cpu_ms: PhaseCpuMs,
    /// Counters of the source.
    #[serde(skip)]
    pub source: SourceStats,
}

/// Builds a shard of `source`, which is not read where the plan holds the triangles, and need not be given then. A
/// whole fragment of the same plan and share is left as it is.
///
/// # Errors
/// [`Code::Usage`] for a share that there is not, where the input is not the plan's, and without a source for a plan
/// without triangles; [`Code::InputMismatch`] where that is known before; [`Code::Damaged`] for triangles of the plan
/// that are not as they were; those of [`build`](crate::build::build()).
pub fn build(
    source: Option<&mut dyn TriangleSource>,
    work: &ShardWork<'_>,
    report: Report<'_>,
) -> Result<ShardReport> {
    let ShardWork { plan, output, options, share: (number, count), .. } = *work;
    let mut clock = PhaseClock::start();
    if !(1..=count).contains(&number) || count > SHARDS {
        return Err(Error::new(Code::Usage, "there is no such share of a build")
            .at(output)
            .numbers(format!("{number}/{count}; 1/1 to {SHARDS}/{SHARDS}"))
            .next("name a share from 1/N to N/N"));
    }
    if let Some(facts) = work.facts {
        plan.check_inputs(facts, work.plan_path)?;
    }
    if source.is_none() && !plan.has_triangles() {
        return Err(Error::new(Code::Usage, "the plan holds no triangles, and no inputs are named")
            .at(work.plan_path)
            .numbers("0 inputs")
            .next(NextStep::NameInputsOfPlan));
    }
    let share = ShardShare { index: number - 1, count };
    if let Some(report) = work.found(share) {
        return Ok(report);
    }
    let site = BuildSite::check(output, options)?;
    check_apart(output, work.plan_path)?;
    let mut input = vec![
        ("plan".to_owned(), format!("{:016x}", plan.id())),
        ("shard".to_owned(), format!("{number}/{count}")),
    ];
    input.extend_from_slice(&plan.facts);
    let resume = options.resume.as_ref().map(|resume| Resume { input, ..resume.clone() });
    let options = BuildOptions { resume, voxels: plan.voxels(), ..options.clone() };
    let mut journal = Journal::begin(output, &site.scratch_folder, &options)?;
    let used_bytes = options.budget.used_bytes();
    let built = by_phase(&options.budget, report, |report| {
        ShardBuild { work, share, options: &options, site: &site, report }.run(source, journal.as_mut())
    });
    let mut out = built.map_err(|error| {
        let error = stopped(error, output, journal.as_mut());
        match error.smallest_limit_bytes() {
            Some(bytes) if plan.has_triangles() => {
                // What is sure to be enough: a build's.
                let sure_bytes = RESERVE_BYTES + used_bytes + smallest_bytes_for(&work.sizes(share));
                error.with_room(sure_bytes.saturating_sub(bytes))
            }
            _ => error,
        }
    })?;
    (out.phase_ms.total, out.phase_cpu_ms.total) = clock.lap();
    Ok(out)
}

impl ShardWork<'_> {
    fn report(&self, share: ShardShare) -> ShardReport {
        ShardReport {
            plan_id: format!("{:016x}", self.plan.id()),
            shard: share.index + 1,
            shard_count: share.count,
            model_triangle_count: self.plan.triangle_count(),
            ..ShardReport::default()
        }
    }

    /// Sizes of a shard, from which its memory follows.
    fn sizes(&self, share: ShardShare) -> InputSizes {
        let triangle_count = self.plan.range(share).triangle_count;
        let all = self.plan.model.sizes;
        InputSizes { triangle_count, emissive_count: all.emissive_count.min(triangle_count), ..all }
    }

    /// The report of a fragment that is there, whole, of this share of this plan.
    fn found(&self, share: ShardShare) -> Option<ShardReport> {
        if !self.output.is_file() {
            return None;
        }
        let (found, _) = Fragment::open(self.output, &self.options.budget).ok()?;
        (found.plan_id == self.plan.id() && found.share == share).then(|| ShardReport {
            triangle_count: found.triangle_count,
            chunk_count: found.chunk_count() as u64,
            output_bytes: found.bytes,
            was_there: true,
            ..self.report(share)
        })
    }
}

/// A shard under way.
struct ShardBuild<'a> {
    work: &'a ShardWork<'a>,
    share: ShardShare,
    options: &'a BuildOptions,
    site: &'a BuildSite,
    report: PhaseReport<'a>,
}

impl ShardBuild<'_> {
    fn run(
        &self,
        source: Option<&mut dyn TriangleSource>,
        mut journal: Option<&mut Journal>,
    ) -> Result<ShardReport> {
        let mut out = self.work.report(self.share);
        let ShardBuild { work: ShardWork { plan: shard_plan, output, .. }, options, .. } = *self;

        // Its cells, sorted: by the scan, by a build before this, or now.
        let planned = self.planned()?;
        let is_planned = planned.is_some();
        let before = match journal.as_deref_mut() {
            Some(journal) if !is_planned => self.sorted_before(journal)?,
            _ => None,
        };
        out.resumed_sorted_count =
            before.as_ref().map_or(0, |outcome| outcome.partition.chunk_triangle_count());
        let mut plan = plan(&self.work.sizes(self.share), options, &self.site.scratch_folder)?;
        if is_planned {
            plan.scratch_bytes = 0;
        }
        (self.work.on_plan)(&plan);
        let outcome = match (planned.or(before), source) {
            (Some(outcome), _) => outcome,
            (None, Some(source)) => self.sort(source, journal.as_deref_mut(), &mut out)?,
            (None, None) => unreachable!("a plan without triangles was refused"),
        };

        // Clusters, voxel records, pages: chunk by chunk, in order.
        let mut clock = PhaseClock::start();
        let place = |kind| match &journal {
            None => Place::Unnamed(self.site.scratch_folder.clone()),
            Some(journal) => Place::New(journal.path(kind)),
        };
        let (draft_place, voxel_place) = (place(FileKind::Draft), place(FileKind::Voxels));
        let draft = Draft::create(output, &self.site.folder, draft_place)?;
        let voxels = VoxelWork::begin(&outcome.partition.summary, voxel_place)?;
        let mut writer = FragmentWriter::new(draft.file(), &options.budget)?;
        let emissive = outcome.materials.emissive();
        let parted = &outcome.partition;
        let context = pack_context(&parted.summary, &emissive, &outcome.sizes);
        // A build that resumes reads all of them again, and so do other shards of the plan.
        let is_kept =
            is_planned || journal.as_ref().is_some_and(|journal| journal.has_record(FileKind::Chunks));
        let (mut done, all) = (0, parted.chunk_triangle_count());
        let chunks = ChunkSet { first: 0, outcome: &outcome, voxels: voxels.as_ref(), context };
        (self.report)("clusters", "triangles", 0, all);
        emit::build_chunks(&chunks, options, |index, pages| {
            writer.add_chunk(&pages)?;
            let chunk = &parted.chunks[index];
            if !is_kept {
                chunk.pieces.iter().for_each(|piece| parted.scratch.consume(&piece.run, piece.take));
            }
            done += chunk.triangle_count;
            (self.report)("clusters", "triangles", done, all);
            Ok(())
        })?;
        let identity =
            FragmentIdentity { plan_id: shard_plan.id(), share: self.share, model: &shard_plan.model };
        let runs = voxels.as_ref().map(|work| &work.runs);
        out.output_bytes = writer.finish(&identity, all, runs, &options.budget)?;
        out.triangle_count = all;
        out.chunk_count = parted.chunks.len() as u64;
        let sorted_bytes = if is_planned { 0 } else { parted.scratch.bytes() };
        out.scratch_peak_bytes = sorted_bytes + runs.map_or(0, |runs| runs.size().bytes);
        (out.phase_ms.clusters, out.phase_cpu_ms.clusters) = clock.lap();

        draft.publish_unread(output, options)?;
        (out.phase_ms.publish, out.phase_cpu_ms.publish) = clock.lap();
        out.source = outcome.source;
        Ok(out)
    }

    /// The triangles of the shard as the plan holds them.
    fn planned(&self) -> Result<Option<PartitionOutcome>> {
        let plan = self.work.plan;
        let Some((scratch, chunks)) = plan.triangles(self.share, self.work.plan_path)? else {
            return Ok(None);
        };
        let summary = plan.model.summary.clone();
        let partition =
            Partition { scratch, chunks, summary, mean_colours: Vec::new(), wait_ms: 0, _lists: None };
        let materials = plan.model.materials.copy(&self.options.budget)?;
        // What its scan has told is not told again.
        let source = SourceStats::default();
        Ok(Some(PartitionOutcome { partition, materials, sizes: self.work.sizes(self.share), source }))
    }

    /// What a build before this has sorted, where that is whole; records that are not are removed.
    fn sorted_before(&self, journal: &mut Journal) -> Result<Option<PartitionOutcome>> {
        let found = PartitionOutcome::read(journal, &self.options.budget)?;
        let plan = self.work.plan;
        let is_ours = |found: &PartitionOutcome| {
            found.partition.summary.content_hash == plan.model.summary.content_hash
                && found.partition.chunk_triangle_count() == plan.range(self.share).triangle_count
        };
        let Some(outcome) = found.filter(is_ours) else {
            journal.remove_record(FileKind::Chunks)?;
            return Ok(None);
        };
        journal.check_named_files(&outcome.source)?;
        outcome.partition.set_unread(0);
        Ok(Some(PartitionOutcome { sizes: self.work.sizes(self.share), ..outcome }))
    }

    fn sort(
        &self,
        source: &mut dyn TriangleSource,
        journal: Option<&mut Journal>,
        out: &mut ShardReport,
    ) -> Result<PartitionOutcome> {
        let mut clock = PhaseClock::start();
        let (plan, options) = (self.work.plan, self.options);
        let place = match &journal {
            None => Place::Unnamed(self.site.scratch_folder.clone()),
            Some(journal) => Place::New(journal.path(FileKind::Cells)),
        };
        let work = ShardSort {
            summary: &plan.model.summary,
            attributes: plan.model.sizes.attributes,
            levels: plan.levels(),
            range: plan.range(self.share),
            place,
            options,
            report: self.report,
        };
        let SortedShard { scratch, chunks, lists, waited } = work.run(source)?;
        super::check_named(self.work.output, &source.stats())?;
        let wait_ms = waited.as_millis() as u64;
        let partition = Partition {
            scratch,
            chunks,
            summary: plan.model.summary.clone(),
            mean_colours: Vec::new(),
            wait_ms,
            _lists: Some(lists),
        };
        let materials = plan.model.materials.copy(&options.budget)?;
        let outcome = PartitionOutcome {
            partition,
            materials,
            sizes: self.work.sizes(self.share),
            source: source.stats(),
        };
        if let Some(journal) = journal.filter(|journal| journal.is_due()) {
            outcome.record(journal, &options.budget)?;
        }
        out.phase_ms.generate = wait_ms;
        (out.phase_ms.partition, out.phase_cpu_ms.partition) = clock.lap();
        Ok(outcome)
    }
}
