//! The merge: from the fragments of all shards to the page file.

use super::by_phase;
use crate::budget::{Budget, RESERVE_BYTES};
use crate::build::draft::Draft;
use crate::build::emit::file_id::file_id;
use crate::build::emit::finish::{FinishWork, finish};
use crate::build::emit::pack_context;
use crate::build::emit::voxels::{OctreeShape, VoxelMerge};
use crate::build::emit::writer::PageWriter;
use crate::build::fragment::fragment_reader::Fragment;
use crate::build::fragment::{ChunkBytesReader, SHARDS};
use crate::build::journal::{FileKind, Journal};
use crate::build::options::{BuildOptions, Resume};
use crate::build::phases::PhaseClock;
use crate::build::plan::{smallest_bytes, smallest_bytes_for};
use crate::build::report::{BuildReport, PhaseReport};
use crate::build::shard_file::PlannedModel;
use crate::build::site::{BuildSite, stopped};
use crate::error::{Code, Error, Result};
use crate::layout::SUPERBLOCK_BYTES;
use crate::octree::RUN_BYTES;
use crate::output::check_apart;
use crate::progress::Report;
use crate::scratch::Place;
use std::path::{Path, PathBuf};

/// What is merged.
pub struct MergeWork<'a> {
    /// The fragments of all shards, in any order.
    pub fragments: &'a [PathBuf],
    /// The page file to publish.
    pub output: &'a Path,
    /// Lattice and octree are the plan's. A merge that was killed starts again.
    pub options: &'a BuildOptions,
}

/// Merges the fragments of a build into its page file.
///
/// # Errors
/// [`Code::InputMismatch`] for fragments of several plans, and where some are missing or there twice;
/// [`Code::InputFormat`], [`Code::Version`] and [`Code::Damaged`] for what is no whole fragment; those of
/// [`build`](crate::build::build()).
pub fn merge(work: &MergeWork<'_>, report: Report<'_>) -> Result<BuildReport> {
    let MergeWork { fragments, output, options } = *work;
    let mut clock = PhaseClock::start();
    fragments.iter().try_for_each(|fragment| check_apart(output, fragment))?;
    let site = BuildSite::check(output, options)?;
    let opened = open_all(fragments, &options.budget);
    let (fragments, model) = opened.map_err(|error| error.with_room(smallest_bytes()))?;
    // What is sure to be enough: a build's, beside the tables of fragments and a block of each voxel run.
    let run_count: u64 = fragments.iter().map(Fragment::run_count).sum();
    let sure_bytes = RESERVE_BYTES
        + options.budget.used_bytes()
        + smallest_bytes_for(&model.sizes)
        + run_count * RUN_BYTES;
    let input = vec![("merge of plan".to_owned(), format!("{:016x}", fragments[0].plan_id))];
    let resume = options.resume.as_ref().map(|resume| Resume { input, ..resume.clone() });
    let options = BuildOptions { resume, ..options.clone() };
    let mut journal = Journal::begin(output, &site.scratch_folder, &options)?;
    let merged = by_phase(&options.budget, report, |report| {
        MergeBuild { output, options: &options, site: &site, report }.run(fragments, &model, journal.as_ref())
    });
    let mut out = merged.map_err(|error| {
        let more_bytes = sure_bytes.saturating_sub(error.smallest_limit_bytes().unwrap_or(0));
        stopped(error, output, journal.as_mut()).with_room(more_bytes)
    })?;
    (out.phase_ms.total, out.phase_cpu_ms.total) = clock.lap();
    Ok(out)
}

/// Opens fragments, which must be all of one plan; gives them in their order, and the model.
fn open_all(paths: &[PathBuf], budget: &Budget) -> Result<(Vec<Fragment>, PlannedModel)> {
    if paths.is_empty() || paths.len() > SHARDS as usize {
        return Err(Error::new(Code::Usage, "so many fragments make no build")
            .at_place("the fragments")
            .numbers(format!("{} named, 1 to {SHARDS} can be", paths.len()))
            .next("name all fragments of one build"));
    }
    let (first, model) = Fragment::open(&paths[0], budget)?;
    let mut all = vec![first];
    for path in &paths[1..] {
        all.push(Fragment::open(path, budget)?.0);
    }
    let (plan_id, count) = (all[0].plan_id, all[0].share.count);
    let mismatch = |what: &str, path: &Path, numbers: String| {
        Error::new(Code::InputMismatch, what)
            .at(path)
            .numbers(numbers)
            .next("name all fragments of one plan and one number of shards, each once")
    };
    for fragment in &all {
        let (path, its) = (&fragment.path, fragment.share);
        if fragment.plan_id != plan_id {
            let numbers = format!("plan {:016x}, {plan_id:016x} of {:?}", fragment.plan_id, all[0].path);
            return Err(mismatch("these fragments are of different plans", path, numbers));
        }
        if its.count != count {
            let numbers = format!("shard {} of {}, others of {count}", its.index + 1, its.count);
            return Err(mismatch("these fragments are of different numbers of shards", path, numbers));
        }
    }
    all.sort_by_key(|fragment| fragment.share.index);
    for pair in all.windows(2) {
        if pair[0].share == pair[1].share {
            let numbers = format!("shard {} of {count}, as {:?}", pair[1].share.index + 1, pair[0].path);
            return Err(mismatch("a fragment is there twice", &pair[1].path, numbers));
        }
    }
    if all.len() < count as usize {
        let is_there = |index: &u32| all.iter().any(|fragment| fragment.share.index == *index);
        let missing: Vec<u32> = (0..count).filter(|index| !is_there(index)).map(|index| index + 1).collect();
        let numbers = format!("of {count} shards there are not: {}", listed(&missing));
        return Err(mismatch("fragments are missing", &all[0].path, numbers));
    }
    let all_triangles: u64 = all.iter().fold(0, |sum, fragment| sum.saturating_add(fragment.triangle_count));
    let planned = model.summary.triangle_count;
    if all_triangles != planned {
        let numbers = format!("{all_triangles} triangles in all of them, {planned} in their plan");
        return Err(mismatch("these fragments are not all of a model", &all[0].path, numbers));
    }
    Ok((all, model))
}

/// The first of some numbers, and how many more there are.
fn listed(numbers: &[u32]) -> String {
    const SHOWN: usize = 16;
    let shown: Vec<String> = numbers.iter().take(SHOWN).map(u32::to_string).collect();
    match numbers.len().saturating_sub(SHOWN) {
        0 => shown.join(", "),
        more => format!("{} and {more} more", shown.join(", ")),
    }
}

/// A merge under way.
struct MergeBuild<'a> {
    output: &'a Path,
    options: &'a BuildOptions,
    site: &'a BuildSite,
    report: PhaseReport<'a>,
}

impl MergeBuild<'_> {
    fn run(
        &self,
        mut fragments: Vec<Fragment>,
        model: &PlannedModel,
        journal: Option<&Journal>,
    ) -> Result<BuildReport> {
        let MergeBuild { output, options, report, .. } = *self;
        let mut out = BuildReport::default();
        let mut clock = PhaseClock::start();
        let place = match journal {
            None => Place::Unnamed(self.site.scratch_folder.clone()),
            Some(journal) => Place::New(journal.path(FileKind::Draft)),
        };
        let draft = Draft::create(output, &self.site.folder, place)?;
        let mut file = draft.file();

        let emissive = model.materials.emissive();
        let context = pack_context(&model.summary, &emissive, &model.sizes);
        let shape = OctreeShape::of(&model.summary);
        let file_id = file_id(&model.summary, shape, &model.materials);
        let mut writer = PageWriter::new(file_id, model.summary.superblock(), context, &options.budget)?;

        // Pages of the mesh, fragment by fragment.
        file.append(&[0; SUPERBLOCK_BYTES])?;
        let (mut chunk_count, all) = (0, model.summary.triangle_count);
        let reader = ChunkBytesReader { context, lattice_bits: model.summary.grid.bits };
        for fragment in &fragments {
            fragment.for_each_chunk(reader, &options.budget, |pages| {
                options.interrupt.check()?;
                writer.add_chunk(chunk_count, pages, &mut file)?;
                chunk_count += 1;
                report("merge", "triangles", writer.triangle_count(), all);
                Ok(())
            })?;
        }

        // All that is made of more than a chunk.
        let runs = match shape {
            None => None,
            Some(_) => Some(fragments.iter_mut().map(Fragment::take_runs).collect::<Result<Vec<_>>>()?),
        };
        let folder = &self.site.scratch_folder;
        let voxels = shape.zip(runs).map(|(shape, runs)| VoxelMerge { shape, runs, folder });
        let work = FinishWork { writer, materials: &model.materials, voxels, options, report };
        let block = finish(work, file, &mut out)?;
        let (wall, cpu) = clock.lap();
        out.phase_ms.clusters = wall.saturating_sub(out.phase_ms.voxels);
        out.phase_cpu_ms.clusters = cpu.saturating_sub(out.phase_cpu_ms.voxels);
        draft.publish(output, &block, options, report)?;
        (out.phase_ms.publish, out.phase_cpu_ms.publish) = clock.lap();
        out.keeping_error = model.summary.keeping_error();
        out.source = model.source.clone();
        Ok(out)
    }
}
