//! `trex scan`, `trex build --shard` and `trex merge`: one model by many machines.

use super::beside;
use super::build::{
    BuildSummary, JOURNAL_EVERY, Work, resume, tell_sizes, tell_warnings, voxels, with_source,
};
use super::inputs::{self, InputList};
use crate::args::{BuildArgs, MergeArgs, ScanArgs};
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use crate::values::{Input, ShardNumber};
use serde::Serialize;
use std::fmt;
use std::path::Path;
use std::time::Duration;
use trex_store::build::shards::{self, MergeWork, ScanReport, ScanWork, ShardPlan, ShardReport, ShardWork};
use trex_store::build::{self, ExistingOutput, Plan, Precision, Resume, Voxels};
use trex_store::import::VolumeOptions;
use trex_store::output::check_apart;
use trex_store::printable::one_line;
use trex_store::{Code, Error, Result, content_stamp};

/// Memory that the tables of a plan take at most, over their length: while they are read, and what is kept of them.
const PLAN_COPIES: u64 = 8;

/// Runs `trex scan`.
pub fn scan(args: &ScanArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let work = Work {
        output: &args.output,
        temp_dir: args.scratch.temp_dir.as_deref(),
        existing: ExistingOutput::replace_if(args.overwrite.overwrite),
        precision: args.lattice.precision(),
        voxels: voxels(&args.voxels),
        resume: None,
    };
    check_inputs_apart(&args.output, &args.inputs)?;
    let volumes = args.volumes.options();
    let inputs = InputList::new(&args.inputs, &volumes, &args.attributes);
    let facts = facts(inputs)?;
    let options = work.options(ctx)?;
    let scanned = with_source(inputs, &work.scratch_folder(), ctx, |source| {
        let keeps_triangles = args.keep_triangles;
        let work = ScanWork { output: &args.output, facts: &facts, keeps_triangles, options: &options };
        Ok((source.name(), shards::scan(source, &work, &ctx.report())?))
    });
    let (scene, report) = scanned?;
    tell_warnings(&report.source, ctx);
    ctx.done(&ScanSummary { scene, report, memory: Memory::new(&ctx.budget) })
}

/// Runs `trex build --plan PLAN --shard I/N`.
pub fn shard(
    args: &BuildArgs,
    (plan_path, shard): (&Path, ShardNumber),
    ctx: &Context,
) -> anyhow::Result<Exit> {
    let work = Work {
        output: &args.output,
        temp_dir: args.scratch.temp_dir.as_deref(),
        existing: ExistingOutput::replace_if(args.overwrite.overwrite),
        // Both are the plan's.
        precision: Precision::Default,
        voxels: Voxels::None,
        resume: resume(args)?,
    };
    check_inputs_apart(&args.output, &args.inputs)?;
    let volumes = args.volumes.options();
    let inputs = InputList::new(&args.inputs, &volumes, &args.attributes);
    let scratch = work.scratch_folder();
    let has_inputs = !args.inputs.is_empty();
    if !has_inputs
        && (inputs.attribute_facts().next().is_some() || *inputs.volumes != VolumeOptions::default())
    {
        return Err(Error::new(Code::Usage, "what is said of how inputs are read is said of none")
            .at(plan_path)
            .numbers("0 inputs")
            .next("leave it out: it is the plan's, whose scan has read them")
            .into());
    }
    let read = ShardPlan::read(plan_path, &ctx.budget);
    let plan = read.map_err(|error| {
        let plan_bytes = PLAN_COPIES * ShardPlan::table_bytes(plan_path);
        match has_inputs {
            true => inputs::with_smallest_limit(error, inputs, &scratch, ctx).with_room(plan_bytes),
            false => error.with_room(plan_bytes + build::smallest_bytes()),
        }
    })?;
    let plan_bytes = ctx.budget.used_bytes();
    let facts = if has_inputs { Some(facts(inputs)?) } else { None };
    let options = work.options(ctx)?;
    let work = ShardWork {
        plan: &plan,
        plan_path,
        share: (shard.number, shard.count),
        facts: facts.as_deref(),
        output: &args.output,
        options: &options,
        on_plan: &|plan: &Plan| tell_sizes(plan, ctx),
    };
    let (scene, report) = if has_inputs && !plan.has_triangles() {
        let built = with_source(inputs, &scratch, ctx, |source| {
            Ok((source.name(), shards::build(Some(source), &work, &ctx.report())?))
        });
        built.map_err(|error| error.with_room(plan_bytes))?
    } else {
        (plan_path.display().to_string(), shards::build(None, &work, &ctx.report())?)
    };
    if report.resumed_sorted_count > 0 {
        let sorted = size::count(report.resumed_sorted_count);
        ctx.console.note(&format!("resumed: {sorted} triangles were sorted by an earlier build"));
    }
    tell_warnings(&report.source, ctx);
    ctx.console.finish();
    ctx.output.result("build-shard", &ShardSummary { scene, report, memory: Memory::new(&ctx.budget) })?;
    Ok(Exit::Done)
}

/// Runs `trex merge`.
pub fn merge(args: &MergeArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let work = Work {
        output: &args.output,
        temp_dir: args.scratch.temp_dir.as_deref(),
        existing: ExistingOutput::replace_if(args.overwrite.overwrite),
        // Both are the plan's.
        precision: Precision::Default,
        voxels: Voxels::None,
        resume: Some(Resume { input: Vec::new(), every: JOURNAL_EVERY }),
    };
    let options = work.options(ctx)?;
    let merging = MergeWork { fragments: &args.fragments, output: &args.output, options: &options };
    let report = shards::merge(&merging, &ctx.report())?;
    if let Some(line) = beside::write(&report.source.scene, &args.output) {
        ctx.console.note(&one_line(&line));
    }
    ctx.done(&BuildSummary::new(args.fragments[0].display().to_string(), report, ctx))
}

fn check_inputs_apart(output: &Path, inputs: &[Input]) -> Result<()> {
    inputs.iter().try_for_each(|input| match input {
        Input::File(path) => check_apart(output, path),
        Input::Generated(_) => Ok(()),
    })
}

/// What tells the inputs apart from others on any machine: a file by its length and parts of its bytes, a generator by
/// its name; and how they are read.
fn facts(list: InputList<'_>) -> Result<Vec<(String, String)>> {
    let fact = |(number, input): (usize, &Input)| {
        let value = match input {
            Input::Generated(name) => name.clone(),
            Input::File(path) => {
                content_stamp(path).map_err(|error| Error::io("open the input", path, &error))?
            }
        };
        Ok((format!("input {}", number + 1), value))
    };
    let mut facts = list.inputs.iter().enumerate().map(fact).collect::<Result<Vec<_>>>()?;
    if !list.volumes.iso_values.is_empty() {
        facts.push(("volumes".to_owned(), format!("{:?}", list.volumes)));
    }
    facts.extend(list.attribute_facts());
    Ok(facts)
}

/// The result of a scan.
#[derive(Debug, Serialize)]
struct ScanSummary {
    scene: String,
    #[serde(flatten)]
    report: ScanReport,
    memory: Memory,
}

impl fmt::Display for ScanSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let report = &self.report;
        writeln!(
            f,
            "{} triangles in {} cells, plan of {}; {}",
            size::count(report.triangle_count),
            size::count(report.cell_count),
            size::bytes(report.plan_bytes),
            size::duration(Duration::from_millis(report.total_ms))
        )?;
        write!(
            f,
            "up to {} shards have work; the longest stretch that none divides has {} triangles",
            size::count(report.stretch_count.min(u64::from(shards::SHARDS))),
            size::count(report.longest_stretch)
        )
    }
}

/// The result of a shard.
#[derive(Debug, Serialize)]
struct ShardSummary {
    scene: String,
    #[serde(flatten)]
    report: ShardReport,
    memory: Memory,
}

impl fmt::Display for ShardSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let report = &self.report;
        write!(
            f,
            "shard {} of {}: {} of {} triangles in {} chunks, {}; ",
            report.shard,
            report.shard_count,
            size::count(report.triangle_count),
            size::count(report.model_triangle_count),
            size::count(report.chunk_count),
            size::bytes(report.output_bytes)
        )?;
        match report.was_there {
            true => write!(f, "it was there, and is left as it is"),
            false => write!(f, "{}", size::duration(Duration::from_millis(report.phase_ms.total))),
        }
    }
}
