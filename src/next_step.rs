//! What libraries say without flags and verbs, in those of the command: the next step of an error, and its place.
//!
//! Invariant: every step has its words here: a new one does not compile without.

use trex_store::{Error, NextStep, Setting};

/// Bytes of a MiB, in which `--memory-limit` is told.
const MIB: u64 = 1 << 20;

/// The place of an error: the flag of a setting, where it is one.
pub(crate) fn place(error: &Error) -> String {
    match error.setting() {
        Some(Setting::MemoryLimit) => "--memory-limit".to_owned(),
        None => error.place().to_owned(),
    }
}

/// A step in the words of the command line.
pub(crate) fn words(step: &NextStep) -> String {
    let words = match step {
        NextStep::RaiseLimit { bytes } => {
            return format!("raise --memory-limit to at least {}MiB", bytes.div_ceil(MIB));
        }
        NextStep::RaiseLimitOrAskForLess { bytes } => {
            return format!(
                "--memory-limit {}MiB or more, a smaller --resolution, or fewer --threads",
                bytes.div_ceil(MIB)
            );
        }
        NextStep::RaiseGpuLimit { bytes } => {
            return format!("raise --gpu-memory-limit to at least {}MiB", bytes.div_ceil(MIB));
        }
        NextStep::OtherDevice => "name a device that is there, or leave --device away",
        NextStep::BuildVoxels { or } => return format!("build the file without --no-asvo, or {or}"),
        NextStep::RaiseLimitOrCheckDevice => "raise --memory-limit, or look whether the device hangs (dmesg)",
        NextStep::LowerLimitOrRaiseAddresses => {
            "raise the limit on address space (ulimit -v), or lower --memory-limit"
        }
        NextStep::MakeOutputFolder => "make the folder, or name another output with -o",
        NextStep::NameOutputFile => "name a file with -o",
        NextStep::NameLinkTarget => "name with -o what it leads to",
        NextStep::NameOutput => "name another output with -o",
        NextStep::Overwrite => "name another output with -o, or allow --overwrite",
        NextStep::WaitOrNameOutput => "wait for its end, or name another output with -o",
        NextStep::MakeScratchFolder => "make the folder, or name another with --temp-dir",
        NextStep::FreeSpace => "free space there, or name another folder with -o or --temp-dir",
        NextStep::FreeScratchSpace => "free space there, or name another folder with --temp-dir",
        NextStep::CheckScratchDisk => {
            "check the disk and the memory, or name another folder with --temp-dir; nothing was published"
        }
        NextStep::ResumeOrClean => {
            "run the same command again to resume, or remove them with trex build --clean"
        }
        NextStep::SameInputOrClean => {
            "build with the same input and options, or remove it with trex build --clean"
        }
        NextStep::BuildWithoutResume => "this file system may have no locks: add --no-resume",
        NextStep::ScanAgain => {
            "run `trex scan` again on these inputs, or name those that the plan was made of"
        }
        NextStep::NameInputsOfPlan => {
            "name the inputs that the plan was made of, or make it with `trex scan --keep-triangles`"
        }
        NextStep::BuildShardAgain => "build it again with `trex build --plan PLAN --shard I/N`",
        NextStep::FinerLattice => {
            "ask for a finer lattice with --error: some triangles are smaller than its step"
        }
        NextStep::Build => "make one with `trex build`",
        NextStep::Rebuild => {
            "build it again from its input with `trex build`: until 1.0 no older version is read"
        }
        NextStep::OpenNewerOrRebuild => {
            "open it with a newer trex, or build it again with this one (`trex build`)"
        }
        NextStep::Verify => "run `trex verify` to see what else is damaged, and build the file again",
        NextStep::AutomaticIo => "use --io auto --direct auto",
        NextStep::BuildFromGenerator => {
            "ask for fewer triangles, or give the gen: spec to `trex build` directly"
        }
        NextStep::FewerThreads => "ask for fewer --threads, or raise the limit on processes (ulimit -u)",
        NextStep::ListMaterials => "use a name that `trex info` lists",
        NextStep::DescribeVolume => {
            "add --size XxYxZ --type TYPE, or name a .nhdr or .mhd file that says both"
        }
        NextStep::NameIsoValue => {
            "add --iso VALUE, between the samples inside and outside; once for each surface"
        }
        NextStep::Text(text) => text,
    };
    words.to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use trex_store::Code;

    /// Errors of libraries named flags of this command, which their other users do not have.
    #[test]
    fn a_step_names_flags_here_and_nowhere_else() {
        let error = Error::new(Code::MemoryLimit, "no room")
            .at_setting(Setting::MemoryLimit)
            .next(NextStep::RaiseLimit { bytes: (7 << 20) + 1 });
        assert_eq!((place(&error).as_str(), error.place()), ("--memory-limit", "the memory limit"));
        assert_eq!(words(error.next_step_kind()), "raise --memory-limit to at least 8MiB");
        assert_eq!(error.next_step(), "raise the memory limit to at least 8MiB");
        let text = Error::new(Code::Io, "gone").at_place("there").next("look for it");
        assert_eq!((place(&text).as_str(), words(text.next_step_kind()).as_str()), ("there", "look for it"));
    }
}
