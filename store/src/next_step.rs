//! `NextStep`: what the user of a failed call can do, and `Setting`: which setting of the caller an error is about.
//!
//! A library knows neither flags nor commands: it names the step, and says it in plain words
//! ([`Display`](fmt::Display)). A command says the step with its own flags and verbs.
//!
//! Invariant: no words here name a flag or a command.

use std::fmt;

/// Bytes of a MiB, in which limits are told.
const MIB: u64 = 1 << 20;

/// The next step of the user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum NextStep {
    /// Raise the memory limit to this many bytes or more.
    RaiseLimit {
        /// The smallest limit that would do.
        bytes: u64,
    },
    /// Raise the memory limit to this many bytes or more, or ask for a smaller picture, or for fewer threads.
    RaiseLimitOrAskForLess {
        /// The smallest limit that would do.
        bytes: u64,
    },
    /// Raise the limit of video memory to this many bytes or more.
    RaiseGpuLimit {
        /// The smallest limit that would do.
        bytes: u64,
    },
    /// Name another device, or leave the choice to the defaults.
    OtherDevice,
    /// Raise the memory limit, or see whether the device hangs.
    RaiseLimitOrCheckDevice,
    /// Lower the memory limit, or raise the limit on the process's addresses.
    LowerLimitOrRaiseAddresses,
    /// Make the folder of the output, or name another output.
    MakeOutputFolder,
    /// Name a file as the output.
    NameOutputFile,
    /// Name as the output what the link leads to.
    NameLinkTarget,
    /// Name another output.
    NameOutput,
    /// Name another output, or allow that this one is replaced.
    Overwrite,
    /// Wait for the other build of this output, or name another output.
    WaitOrNameOutput,
    /// Make the folder of scratch files, or name another.
    MakeScratchFolder,
    /// Free space, or name another folder for the output or the scratch files.
    FreeSpace,
    /// Free space, or name another folder for the scratch files.
    FreeScratchSpace,
    /// Check disk and memory, or name another folder for the scratch files.
    CheckScratchDisk,
    /// Start the build again, which resumes, or remove what it left.
    ResumeOrClean,
    /// Build with the input and the options of the unfinished build, or remove what it left.
    SameInputOrClean,
    /// Build without leaving anything to resume from: the file system may have no locks.
    BuildWithoutResume,
    /// Make the plan of a build in shards again, of these inputs, or name the inputs that it was made of.
    ScanAgain,
    /// Name the inputs that the plan was made of, or make it with its triangles.
    NameInputsOfPlan,
    /// Build the shard again whose fragment this is.
    BuildShardAgain,
    /// Ask for a finer lattice.
    FinerLattice,
    /// Build a file from a mesh.
    Build,
    /// Build the file again: no older version is read.
    Rebuild,
    /// Open the file with a newer version, or build it again.
    OpenNewerOrRebuild,
    /// Verify the file to see what else is damaged, and build it again.
    Verify,
    /// Leave the choice of how files are read to the defaults.
    AutomaticIo,
    /// Ask for fewer triangles, or build from the generator itself.
    BuildFromGenerator,
    /// Ask for fewer threads, or raise the system's limit on them.
    FewerThreads,
    /// List the materials of the model.
    ListMaterials,
    /// Build the file with voxels, or do the other thing.
    BuildVoxels {
        /// What does without voxels.
        or: &'static str,
    },
    /// Say what a file of plain samples holds, or name a header that does.
    DescribeVolume,
    /// Name the value of a volume's surface.
    NameIsoValue,
    /// Words for a step that names no setting of the caller. Empty for none.
    Text(String),
}

impl fmt::Display for NextStep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let words = match self {
            NextStep::RaiseLimit { bytes } => {
                return write!(f, "raise the memory limit to at least {}MiB", bytes.div_ceil(MIB));
            }
            NextStep::RaiseLimitOrAskForLess { bytes } => {
                return write!(
                    f,
                    "raise the memory limit to at least {}MiB, or ask for a smaller picture or fewer threads",
                    bytes.div_ceil(MIB)
                );
            }
            NextStep::RaiseGpuLimit { bytes } => {
                return write!(f, "raise the limit of video memory to at least {}MiB", bytes.div_ceil(MIB));
            }
            NextStep::OtherDevice => "name a device that is there, or leave the choice to the defaults",
            NextStep::BuildVoxels { or } => return write!(f, "build the file with voxels, or {or}"),
            NextStep::RaiseLimitOrCheckDevice => {
                "raise the memory limit, or look whether the device hangs (dmesg)"
            }
            NextStep::LowerLimitOrRaiseAddresses => {
                "raise the limit on address space (ulimit -v), or lower the memory limit"
            }
            NextStep::MakeOutputFolder => "make the folder, or name another output",
            NextStep::NameOutputFile => "name a file as the output",
            NextStep::NameLinkTarget => "name as the output what the link leads to",
            NextStep::NameOutput => "name another output",
            NextStep::Overwrite => "name another output, or allow that this one is replaced",
            NextStep::WaitOrNameOutput => "wait for its end, or name another output",
            NextStep::MakeScratchFolder => "make the folder, or name another for scratch files",
            NextStep::FreeSpace => "free space there, or name another folder",
            NextStep::FreeScratchSpace => "free space there, or name another folder for scratch files",
            NextStep::CheckScratchDisk => {
                "check the disk and the memory, or name another folder for scratch files; nothing was published"
            }
            NextStep::ResumeOrClean => "start the same build again to resume it, or remove what it left",
            NextStep::SameInputOrClean => {
                "build with the same input and options, or remove what the unfinished build left"
            }
            NextStep::BuildWithoutResume => {
                "this file system may have no locks: build without leaving anything to resume from"
            }
            NextStep::ScanAgain => "make the plan again of these inputs, or name those that it was made of",
            NextStep::NameInputsOfPlan => "name the inputs of the plan, or make it again with its triangles",
            NextStep::BuildShardAgain => "build this shard again",
            NextStep::FinerLattice => {
                "ask for a finer lattice: some triangles are smaller than the step of this one"
            }
            NextStep::Build => "build one from a mesh",
            NextStep::Rebuild => "build it again from its input: until 1.0 no older version is read",
            NextStep::OpenNewerOrRebuild => "open it with a newer version, or build it again with this one",
            NextStep::Verify => "verify the file to see what else is damaged, and build it again",
            NextStep::AutomaticIo => "leave the backend and direct reading to their defaults",
            NextStep::BuildFromGenerator => "ask for fewer triangles, or build from the generator itself",
            NextStep::FewerThreads => "ask for fewer threads, or raise the limit on processes (ulimit -u)",
            NextStep::ListMaterials => "list the materials of the model, and use one of their names",
            NextStep::DescribeVolume => {
                "say its size and the type of its samples, or name a .nhdr or .mhd file that does"
            }
            NextStep::NameIsoValue => {
                "name the value, between those of the samples inside and outside; one for each surface"
            }
            NextStep::Text(text) => text,
        };
        f.write_str(words)
    }
}

impl From<&str> for NextStep {
    fn from(text: &str) -> NextStep {
        NextStep::Text(text.to_owned())
    }
}

impl From<String> for NextStep {
    fn from(text: String) -> NextStep {
        NextStep::Text(text)
    }
}

/// A setting of the caller that an error is about: its place, where no file is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Setting {
    /// The memory limit.
    MemoryLimit,
}

impl fmt::Display for Setting {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Setting::MemoryLimit => "the memory limit",
        })
    }
}
