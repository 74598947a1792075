//! The verbs, one file each: from its flags to options of the libraries, from their report to a result.
//!
//! Invariants: 1. a verb translates, calls and reports; what it computes belongs in a library; 2. its result is
//! one struct, `Serialize` for scripts (units in the keys) and `Display` for people.

mod bench;
mod beside;
mod build;
mod campaign;
mod clock;
mod command_line;
mod damage;
mod demo;
mod doctor;
mod door;
mod export;
mod generate;
mod image_diff;
mod image_merge;
mod info;
mod input_summary;
mod inputs;
mod part_info;
mod picture_file;
mod references;
mod render;
mod render_part;
mod render_report;
mod scale;
mod shards;
mod show;
mod shown_file;
mod stage;
mod stress;
mod stress_options;
mod stress_pictures;
mod tradeoff;
mod verify;
mod view;
mod watch;

use crate::args::{ImageArgs, ImageVerb, Verb};
use crate::context::Context;
use crate::failure::Exit;

/// Runs a verb.
pub fn run(verb: &Verb, ctx: &Context) -> anyhow::Result<Exit> {
    match verb {
        Verb::Demo(args) => demo::run(args, ctx),
        Verb::Gen(args) => generate::run(args, ctx),
        Verb::Build(args) => match (&args.shard.plan, args.shard.shard) {
            (Some(plan), Some(shard)) => shards::shard(args, (plan, shard), ctx),
            _ => build::run(args, ctx),
        },
        Verb::Scan(args) => shards::scan(args, ctx),
        Verb::Merge(args) => shards::merge(args, ctx),
        Verb::Info(args) => info::run(args, ctx),
        Verb::Verify(args) => verify::run(args, ctx),
        Verb::Export(args) => export::run(args, ctx),
        Verb::Render(args) => render::run(args, ctx),
        Verb::View(args) => view::run(args, ctx),
        Verb::Stress(args) => stress::run(args, ctx),
        Verb::Bench(args) => bench::run(args, ctx),
        Verb::Doctor(args) => doctor::run(args, ctx),
        Verb::Image(ImageArgs { verb: ImageVerb::Diff(args) }) => image_diff::run(args, ctx),
        Verb::Image(ImageArgs { verb: ImageVerb::Merge(args) }) => image_merge::run(args, ctx),
    }
}
