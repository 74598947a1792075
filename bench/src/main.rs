//! The `trex-bench` command: run a workload, keep a run as a record, write the docs from the records.
//!
//! ```text
//! cargo run --release -p trex-bench --features peer-embree -- rays gen:pipes:5M --peer embree > run.json
//! trex build ... --json | cargo run --release -p trex-bench -- record --name build-iso-20m
//! cargo run --release -p trex-bench -- docs
//! ```

mod workload;

use anyhow::Context;
use clap::{Parser, Subcommand};
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use trex_bench::docs;
use trex_bench::estimates;
use trex_bench::machine::Machine;
use trex_bench::record::{self, Labels, Record};

/// Measures, keeps measured runs, and writes the figures of the documentation from them.
#[derive(Debug, Parser)]
#[command(version, max_term_width = 100)]
struct Cli {
    /// The checkout whose `bench/record/` and `docs/` are meant
    #[arg(long, global = true, value_name = "DIR", default_value = ".")]
    root: PathBuf,
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    /// Rays per second on a model: primary, shadow, incoherent
    Rays(workload::RaysArgs),
    /// Pages per second at random, cold: as they are, hashed, and ready to trace
    Io(workload::IoArgs),
    /// Triangles per second of the build of a generated mesh
    Build(workload::BuildArgs),
    /// What a viewer shows of a picture of few samples, and the time of its filter
    Smooth(workload::SmoothArgs),
    /// Pages that the pool's clock reads, beside LRU and the optimum, while views change
    Eviction(workload::EvictionArgs),
    /// Medians of the criterion benches of a model, as they were measured last
    Estimates {
        /// Where criterion keeps them
        #[arg(long, value_name = "DIR", default_value = "target/criterion")]
        folder: PathBuf,
        /// The model, by its name in the benches
        model: String,
    },
    /// Rewrite the figures of README.md and docs/ from the records
    Docs {
        /// Write nothing; exit 1 if a file would change
        #[arg(long)]
        check: bool,
    },
    /// Append the JSON document of a trex verb to the records
    Record {
        /// Name of the record: what was measured (a-z, 0-9, -)
        #[arg(long)]
        name: String,
        /// The command line [default: as the document says]
        #[arg(long)]
        command: Option<String>,
        /// The model or scene [default: as the document says]
        #[arg(long)]
        scene: Option<String>,
        /// The seed [default: as the document says]
        #[arg(long)]
        seed: Option<u64>,
        /// Where it ran, as a record has it: a file with one JSON object [default: this machine]
        #[arg(long)]
        machine: Option<PathBuf>,
        /// The document; - is stdin
        #[arg(default_value = "-")]
        document: PathBuf,
    },
}

fn main() -> anyhow::Result<ExitCode> {
    let Cli { root, verb } = Cli::parse();
    match verb {
        Verb::Rays(args) => workload::rays(&args, &command_line()).map(|()| ExitCode::SUCCESS),
        Verb::Io(args) => workload::io(&args, &command_line()).map(|()| ExitCode::SUCCESS),
        Verb::Build(args) => workload::build(&args, &command_line()).map(|()| ExitCode::SUCCESS),
        Verb::Smooth(args) => workload::smooth(&args, &command_line()).map(|()| ExitCode::SUCCESS),
        Verb::Eviction(args) => workload::eviction(&args, &command_line()).map(|()| ExitCode::SUCCESS),
        Verb::Estimates { folder, model } => {
            let estimates = estimates::read(&root.join(folder), &model)?;
            writeln!(io::stdout().lock(), "{}", serde_json::to_string(&estimates)?)?;
            Ok(ExitCode::SUCCESS)
        }
        Verb::Docs { check: true } => check_docs(&root),
        Verb::Docs { check: false } => write_docs(&root),
        Verb::Record { name, command, scene, seed, machine, document } => {
            let machine = machine.as_deref().map(machine_in).transpose()?;
            keep(&root, &document, Labels { name, command, scene, seed, machine })
        }
    }
}

/// What was typed, for documents.
fn command_line() -> String {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    format!("trex-bench {}", arguments.join(" "))
}

fn check_docs(root: &Path) -> anyhow::Result<ExitCode> {
    let stale = docs::stale(root)?;
    let lines: Vec<String> =
        stale.iter().map(|path| format!("{} is not up to date", path.display())).collect();
    tell(&lines)?;
    Ok(if stale.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

fn write_docs(root: &Path) -> anyhow::Result<ExitCode> {
    let written = docs::write(root)?;
    let lines: Vec<String> = written.iter().map(|path| format!("wrote {}", path.display())).collect();
    tell(&lines)?;
    Ok(ExitCode::SUCCESS)
}

/// The machine that a file describes.
fn machine_in(path: &Path) -> anyhow::Result<Machine> {
    let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("{} describes no machine", path.display()))
}

fn keep(root: &Path, document: &Path, labels: Labels) -> anyhow::Result<ExitCode> {
    let text = if document == Path::new("-") {
        let mut text = String::new();
        io::stdin().lock().read_to_string(&mut text).context("cannot read stdin")?;
        text
    } else {
        fs::read_to_string(document).with_context(|| format!("cannot read {}", document.display()))?
    };
    let document = serde_json::from_str(&text).context("the document is not JSON")?;
    let path = record::append(root, &Record::from_document(&document, labels, root)?)?;
    tell(&[format!("appended to {}", path.display())])?;
    Ok(ExitCode::SUCCESS)
}

fn tell(lines: &[String]) -> io::Result<()> {
    lines.iter().try_for_each(|line| writeln!(io::stderr().lock(), "{line}"))
}
