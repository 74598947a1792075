//! The command line of `trex doctor`.

use super::CommonArgs;
use clap::Args;
use std::path::PathBuf;

/// `trex doctor`
#[derive(Debug, Args)]
#[command(after_help = AFTER_DOCTOR)]
pub struct DoctorArgs {
    /// The folder whose disk is looked at: a file of 64 KiB is written there, and removed
    #[arg(value_name = "FOLDER", default_value = ".")]
    pub folder: PathBuf,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_DOCTOR: &str = "\
Examples:
  trex doctor                processor, memory, disk, GPUs, and what is missing
  trex doctor /scratch --json";
