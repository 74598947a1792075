//! Control groups: the kernel's own count of what a run takes, with the limit as a wall. Versions 1 and 2.

use crate::command::{Ran, TREX, cannot_run, ran};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

const ROOT: &str = "/sys/fs/cgroup";

/// A memory control group of our own, removed on drop.
pub(crate) struct Cgroup {
    folder: PathBuf,
    version: u32,
}

impl Cgroup {
    /// A group whose processes get no more than `limit_bytes`, page cache and kernel memory included. `None`, said
    /// aloud, where none can be made.
    pub(crate) fn new(name: &str, limit_bytes: u64) -> Option<Cgroup> {
        let name = format!("trex-{name}-{}", std::process::id());
        let parents = [(Path::new(ROOT).join("memory"), 1), (PathBuf::from(ROOT), 2)];
        let made = parents.into_iter().find_map(|(parent, version)| {
            let folder = parent.join(&name);
            fs::create_dir(&folder).ok()?;
            let group = Cgroup { folder, version };
            group.limit(limit_bytes).then_some(group)
        });
        if made.is_none() {
            cannot_run("no memory control group can be made here (needs root and a writable /sys/fs/cgroup)");
        }
        made
    }

    /// False where the kernel does not take the limit.
    fn limit(&self, limit_bytes: u64) -> bool {
        let set = |file: &str, value: u64| fs::write(self.folder.join(file), value.to_string()).is_ok();
        if self.version == 1 {
            // Swapped pages would be taken out of the count: no room for them. Absent without swap accounting.
            let limited = set("memory.limit_in_bytes", limit_bytes);
            set("memory.memsw.limit_in_bytes", limit_bytes);
            limited
        } else {
            let limited = set("memory.max", limit_bytes);
            set("memory.swap.max", 0);
            limited
        }
    }

    /// `trex LINE` inside, in `folder`.
    pub(crate) fn command_in(&self, folder: &Path, line: &str) -> Command {
        // The shell enters the group and becomes the command: all that the command takes is counted.
        let script =
            format!("echo $$ > '{}' && exec '{TREX}' {line}", self.folder.join("cgroup.procs").display());
        let mut command = Command::new("sh");
        command.args(["-c", &script]).current_dir(folder);
        command
    }

    /// Runs `trex LINE` inside, in `folder`.
    pub(crate) fn run_in(&self, folder: &Path, line: &str) -> Ran {
        ran(line, self.command_in(folder, line).output().unwrap())
    }

    /// Processes of the group that the kernel has killed for memory.
    pub(crate) fn oom_kill_count(&self) -> u64 {
        let file = if self.version == 1 { "memory.oom_control" } else { "memory.events" };
        let text = fs::read_to_string(self.folder.join(file)).unwrap();
        text.lines().find_map(|line| line.strip_prefix("oom_kill ")?.parse().ok()).expect("an oom_kill count")
    }

    /// Most bytes that the group ever held, if the kernel tells.
    pub(crate) fn peak_bytes(&self) -> Option<u64> {
        let file = if self.version == 1 { "memory.max_usage_in_bytes" } else { "memory.peak" };
        fs::read_to_string(self.folder.join(file)).ok()?.trim().parse().ok()
    }
}

impl Drop for Cgroup {
    fn drop(&mut self) {
        // The last process may still be on its way out of the group.
        for _ in 0..50 {
            if fs::remove_dir(&self.folder).is_ok() {
                return;
            }
            std::thread::sleep(std::time::Duration::from_millis(20));
        }
    }
}
