//! Flags that many verbs share: limits, threads, disks, folders, and the names of generators.

use crate::progress::Mode;
use crate::values::{self, MemoryLimit};
use clap::{ArgAction, Args, ValueEnum};
use std::path::PathBuf;
use trex_store::io::{DirectChoice, IoChoice};

/// Flags of every verb.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Common options")]
pub struct CommonArgs {
    /// Most memory this process may take: an amount (512MiB, 2GB), a share of what the machine grants (50%), or
    /// auto (default: auto = 50% of the smaller of installed memory and cgroup limit; demo: 256MiB)
    #[arg(long, value_name = "LIMIT", value_parser = values::memory_limit)]
    pub memory_limit: Option<MemoryLimit>,
    /// Worker threads (default: one per core); results do not depend on it
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Print the result as one JSON document, units in the keys
    #[arg(long)]
    pub json: bool,
    /// How to show progress on stderr; auto = bar on a terminal, plain lines elsewhere
    #[arg(long, value_enum, value_name = "MODE", default_value_t = Mode::Auto)]
    pub progress: Mode,
    /// Tell more on stderr; twice for details
    #[arg(short, long, action = ArgAction::Count, conflicts_with = "quiet")]
    pub verbose: u8,
    /// Tell nothing on stderr but errors
    #[arg(short, long)]
    pub quiet: bool,
}

/// Flags of verbs that read page files.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Disk options")]
pub struct DiskArgs {
    /// How pages are read; auto = the fastest that the system allows (-v says which, and why)
    #[arg(long, value_enum, value_name = "BACKEND", default_value_t = Io::Auto)]
    pub io: Io,
    /// Whether reads bypass the system's file cache; auto = where the file system allows
    #[arg(long, value_enum, value_name = "WHEN", default_value_t = Direct::Auto)]
    pub direct: Direct,
}

/// Flag of verbs that write.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Output options")]
pub struct OverwriteArgs {
    /// Replace the output if it exists; without this flag that is an error
    #[arg(long)]
    pub overwrite: bool,
}

/// Flag of verbs that need scratch files.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Output options")]
pub struct ScratchArgs {
    /// Folder for scratch files (default: beside the output; bench and stress: here); removed again, but for those that
    /// a killed build goes on from
    #[arg(long, value_name = "DIR")]
    pub temp_dir: Option<PathBuf>,
}

/// `--io`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Io {
    /// The fastest that works here
    Auto,
    /// io_uring (Linux)
    Uring,
    /// Positioned reads on a few threads
    Pread,
    /// Memory-mapped file, for comparison: copies from it one after the other, many times slower
    Mmap,
}

impl Io {
    /// The library's form.
    pub fn choice(self) -> IoChoice {
        match self {
            Io::Auto => IoChoice::Auto,
            Io::Uring => IoChoice::Uring,
            Io::Pread => IoChoice::Pread,
            Io::Mmap => IoChoice::Mmap,
        }
    }
}

/// `--direct`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Direct {
    /// Where the file system allows
    Auto,
    /// Always; an error where the file system refuses
    On,
    /// Never
    Off,
}

impl Direct {
    /// The library's form.
    pub fn choice(self) -> DirectChoice {
        match self {
            Direct::Auto => DirectChoice::Auto,
            Direct::On => DirectChoice::On,
            Direct::Off => DirectChoice::Off,
        }
    }
}

/// Kinds of generated meshes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Kind {
    /// Turbulent mixing layer, detail at all scales
    Isosurface,
    /// Plant with interior: pipes, bolts, tanks, mirrors, lamps
    Pipes,
    /// Dense closed statue
    Scan,
    /// Slivers, duplicates, degenerates, far from the origin
    Soup,
}

impl Kind {
    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            Kind::Isosurface => "isosurface",
            Kind::Pipes => "pipes",
            Kind::Scan => "scan",
            Kind::Soup => "soup",
        }
    }
}
