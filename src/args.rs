//! The command line, declared: every verb, every flag, its unit, its default.
//!
//! Invariants: 1. a flag that is listed does something; 2. what clap accepted is in range (`values`), so verbs
//! check only what needs a file; 3. the same flag has the same name and meaning at every verb.

mod bench;
mod build;
mod common;
mod demo;
mod device;
mod doctor;
mod export;
mod image;
mod keys;
mod network;
mod parts;
mod render;
mod shards;
mod stress;
mod view;
mod volume;

use crate::values::MemoryLimit;
pub use bench::{
    BenchArgs, BenchBuildArgs, BenchIoArgs, BenchRaysArgs, BenchScaleArgs, BenchTradeoffArgs, BenchVerb,
};
pub use build::{AttributeArgs, BuildArgs, InfoArgs, VerifyArgs, VoxelArgs};
use clap::{CommandFactory, Parser, Subcommand};
pub use common::{CommonArgs, DiskArgs, Kind, OverwriteArgs, ScratchArgs};
pub use demo::{DemoArgs, GenArgs, GeneratedColors};
pub use device::DeviceArgs;
pub use doctor::DoctorArgs;
pub use export::ExportArgs;
pub use image::{ImageArgs, ImageDiffArgs, ImageMergeArgs, ImageVerb, Metric};
pub use keys::{STRESS_RESOLUTION, words as key_words};
pub use network::{CachedNetworkArgs, NetworkArgs};
pub use parts::PartArgs;
pub use render::{DeadlineArgs, Layer, PictureArgs, RenderArgs};
pub use shards::{MergeArgs, ScanArgs};
use std::ffi::OsString;
use std::path::Path;
pub use stress::StressArgs;
use trex_store::io::NetworkOptions;
pub use view::ViewArgs;
pub use volume::{RawArgs, VolumeArgs};

/// Opens triangle meshes far larger than memory and renders them under a memory limit.
#[derive(Debug, Parser)]
#[command(name = "trex", version, max_term_width = 100, subcommand_required = true, after_help = AFTER_TREX)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
}

const AFTER_TREX: &str = "\
Examples:
  trex demo                                            generate, build and render: one picture
  trex build statue.ply -o statue.trex                 mesh file to page file
  trex build gen:isosurface:20M -o iso.trex --memory-limit 512MiB
  trex info statue.trex                                what is inside
  trex render statue.trex -o statue.png --memory-limit 128MiB
  trex view statue.trex                                live in the browser; so does trex statue.trex
  trex stress statue.trex --scenario flip              two views in turn: how fast it responds
  trex image diff a.exr reference.exr                  how far apart two pictures are

Results go to stdout, all else to stderr; --json makes the result one JSON document.
Exit status: 0 done; 1 ran, and the answer is no; 2 usage; 3 bad input; 4 memory limit too small; \
5 disk full; 6 no such device; 7 reading or writing failed; 70 a bug in trex; 130 interrupted.";

/// The verbs.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Generate a mesh, build it and render it under a memory limit: one command, one picture
    Demo(DemoArgs),
    /// Write a generated mesh to a file
    Gen(GenArgs),
    /// Turn meshes into a page file
    Build(BuildArgs),
    /// Make the plan of a build in shards, by many machines
    Scan(ScanArgs),
    /// Put the fragments of a build in shards together to its page file
    Merge(MergeArgs),
    /// Describe a mesh or a page file without loading it
    Info(InfoArgs),
    /// Check every byte of a page file
    Verify(VerifyArgs),
    /// Write the mesh of a page file, or a part of it, to a mesh file
    Export(ExportArgs),
    /// Render a page file or a scene
    Render(RenderArgs),
    /// Show a page file or a scene live in a browser page
    View(ViewArgs),
    /// Change views, lights or limits faster than a model likes, and judge the responses
    Stress(StressArgs),
    /// Measure this machine on a model
    Bench(BenchArgs),
    /// What this machine offers, what trex uses of it, and why
    Doctor(DoctorArgs),
    /// Compare pictures, or merge the parts of one
    Image(ImageArgs),
}

impl Verb {
    /// The verb as typed; also the middle of its JSON schema's name.
    pub fn name(&self) -> &'static str {
        match self {
            Verb::Demo(_) => "demo",
            Verb::Gen(_) => "gen",
            Verb::Build(_) => "build",
            Verb::Scan(_) => "scan",
            Verb::Merge(_) => "merge",
            Verb::Info(_) => "info",
            Verb::Verify(_) => "verify",
            Verb::Export(_) => "export",
            Verb::Render(_) => "render",
            Verb::View(_) => "view",
            Verb::Stress(_) => "stress",
            Verb::Bench(BenchArgs { verb: BenchVerb::Rays(_) }) => "bench-rays",
            Verb::Bench(BenchArgs { verb: BenchVerb::Io(_) }) => "bench-io",
            Verb::Bench(BenchArgs { verb: BenchVerb::Build(_) }) => "bench-build",
            Verb::Bench(BenchArgs { verb: BenchVerb::Tradeoff(_) }) => "bench-tradeoff",
            Verb::Bench(BenchArgs { verb: BenchVerb::Scale(_) }) => "bench-scale",
            Verb::Doctor(_) => "doctor",
            Verb::Image(ImageArgs { verb: ImageVerb::Diff(_) }) => "image-diff",
            Verb::Image(ImageArgs { verb: ImageVerb::Merge(_) }) => "image-merge",
        }
    }

    /// The flags that every verb has.
    pub fn common(&self) -> &CommonArgs {
        match self {
            Verb::Demo(args) => &args.common,
            Verb::Gen(args) => &args.common,
            Verb::Build(args) => &args.common,
            Verb::Scan(args) => &args.common,
            Verb::Merge(args) => &args.common,
            Verb::Info(args) => &args.common,
            Verb::Verify(args) => &args.common,
            Verb::Export(args) => &args.common,
            Verb::Render(args) => &args.common,
            Verb::View(args) => &args.common,
            Verb::Stress(args) => &args.common,
            Verb::Bench(BenchArgs { verb: BenchVerb::Rays(args) }) => &args.common,
            Verb::Bench(BenchArgs { verb: BenchVerb::Io(args) }) => &args.common,
            Verb::Bench(BenchArgs { verb: BenchVerb::Build(args) }) => &args.common,
            Verb::Bench(BenchArgs { verb: BenchVerb::Tradeoff(args) }) => &args.common,
            Verb::Bench(BenchArgs { verb: BenchVerb::Scale(args) }) => &args.common,
            Verb::Doctor(args) => &args.common,
            Verb::Image(ImageArgs { verb: ImageVerb::Diff(args) }) => &args.common,
            Verb::Image(ImageArgs { verb: ImageVerb::Merge(args) }) => &args.common,
        }
    }

    /// How servers are asked; what nobody typed is as it is by default.
    pub fn network(&self) -> NetworkOptions {
        match self {
            Verb::Info(args) => args.network.options(),
            Verb::Verify(args) => args.network.options(),
            Verb::Export(args) => args.network.options(),
            Verb::Render(args) => args.network.options(),
            Verb::View(args) => args.network.options(),
            Verb::Stress(args) => args.network.options(),
            _ => NetworkOptions::default(),
        }
    }

    /// The memory limit that holds when none is given.
    pub fn default_limit(&self) -> MemoryLimit {
        match self {
            Verb::Demo(_) => MemoryLimit::Bytes(DEMO_LIMIT_BYTES),
            _ => MemoryLimit::AUTO,
        }
    }
}

/// The words of the command line; on a terminal `trex FILE` is `trex view FILE`. `help` is clap's own verb.
pub fn with_verb(mut words: Vec<OsString>, is_terminal: bool) -> Vec<OsString> {
    let is_file = |word: &OsString| {
        let ending = Path::new(word).extension().and_then(|ending| ending.to_str());
        let is_verb = Cli::command().find_subcommand(word).is_some() || word == "help";
        !is_verb
            && ending.is_some_and(|ending| ["trex", "toml"].contains(&ending.to_ascii_lowercase().as_str()))
    };
    if is_terminal && words.get(1).is_some_and(is_file) {
        words.insert(1, "view".into());
    }
    words
}

/// Limit of the demo: its mesh, unpacked, takes several times as much.
const DEMO_LIMIT_BYTES: u64 = 256 << 20;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::values::{self, Input};
    use clap::ValueEnum;
    use trex_render::UpAxis;

    fn parse(line: &str) -> Result<Verb, clap::Error> {
        Cli::try_parse_from(line.split_whitespace()).map(|cli| cli.verb)
    }

    #[test]
    fn the_declaration_is_sound() {
        Cli::command().debug_assert();
    }

    #[test]
    fn build_takes_files_and_generators() {
        let Verb::Build(args) = parse("trex build a.ply gen:soup:10k -o m.trex --error 0.5").unwrap() else {
            panic!("not a build")
        };
        assert_eq!(args.inputs, [Input::File("a.ply".into()), Input::Generated("gen:soup:10k".into())]);
        let lattice = (args.lattice.error, args.lattice.grid_bits);
        assert_eq!((lattice, args.common.memory_limit), ((Some(0.5), None), None));
        assert!(parse("trex build a.ply -o m.trex --error 1 --grid-bits 20").is_err());
        assert!(parse("trex build -o m.trex").is_err());
        assert!(parse("trex build a.ply").is_err());
        assert!(parse("trex build a.ply -o 1.trexfrag --plan p --shard 1/2").is_ok());
        for flags in ["--plan p", "--shard 1/2", "--plan p --shard 3/2", "--plan p --shard 1/2 --no-asvo"] {
            assert!(parse(&format!("trex build a.ply -o 1.trexfrag {flags}")).is_err(), "{flags}");
        }
    }

    #[test]
    fn render_takes_negative_coordinates_and_layers() {
        let line = "trex render m.trex -o m.exr --camera-position -1,-2.5,3 --layers depth,id --fov-y 40";
        let Verb::Render(args) = parse(line).unwrap() else { panic!("not a render") };
        assert_eq!(args.picture.camera.camera_position, Some(values::Vec3([-1.0, -2.5, 3.0])));
        assert_eq!(args.layers, [Layer::Depth, Layer::Id]);
        assert!(parse("trex render m.trex -o m.png --fov-x 40 --fov-y 40").is_err());
        for (line, up) in [("--up -Z", UpAxis::ZDown), ("--up +y", UpAxis::YUp), ("--up auto", UpAxis::Auto)]
        {
            let line = format!("trex render m.trex -o m.png --camera-direction -1,0,0 {line}");
            let Verb::Render(args) = parse(&line).unwrap() else { panic!("not a render") };
            assert_eq!(args.picture.keys.edit().up, Some(up));
            assert_eq!(args.picture.camera.camera_direction, Some(values::Vec3([-1.0, 0.0, 0.0])));
        }
        assert!(parse("trex render m.trex -o m.png --camera-direction 0,0,0").is_err());
        assert!(parse("trex render m.trex -o m.png --up up").is_err());
        assert!(parse("trex render m.trex -o m.png --spp 0").is_err());
    }

    #[test]
    fn a_file_alone_is_seen_where_there_is_a_terminal() {
        let words = |line: &str| line.split_whitespace().map(OsString::from).collect::<Vec<_>>();
        for (typed, meant) in [
            ("trex a.trex", "trex view a.trex"),
            ("trex a/b.TOML --spp 4", "trex view a/b.TOML --spp 4"),
            ("trex info a.trex", "trex info a.trex"),
            ("trex a.ply", "trex a.ply"),
            ("trex --help", "trex --help"),
            ("trex", "trex"),
        ] {
            assert_eq!(with_verb(words(typed), true), words(meant), "{typed}");
            assert_eq!(with_verb(words(typed), false), words(typed));
        }
        let Verb::View(args) = parse("trex view a.trex --bind ::1 --host a --host b --no-open").unwrap()
        else {
            panic!("not a view")
        };
        assert!(args.bind.is_loopback() && args.no_open);
        assert_eq!((args.host.as_slice(), args.port), (&["a".to_owned(), "b".to_owned()][..], 0));
    }

    #[test]
    fn only_the_demo_has_a_limit_of_its_own() {
        assert_eq!(parse("trex demo").unwrap().default_limit(), MemoryLimit::Bytes(256 << 20));
        assert_eq!(parse("trex info a.ply").unwrap().default_limit(), MemoryLimit::AUTO);
    }

    #[test]
    fn kinds_have_the_names_that_are_typed() {
        for kind in Kind::value_variants() {
            assert_eq!(kind.to_possible_value().unwrap().get_name(), kind.as_str());
        }
    }

    #[test]
    fn refusals_name_the_value_and_what_is_accepted() {
        let message = parse("trex info a.ply --memory-limit 512M").unwrap_err().to_string();
        assert!(
            message.contains("512M") && message.contains("512MiB") && message.contains("50%"),
            "{message}"
        );
    }
}
