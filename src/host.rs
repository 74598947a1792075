//! What the machine grants this process: physical memory and control group limits.
//!
//! Reading `/proc` and `/sys` belongs here, in the command; the libraries are told. What cannot be read counts
//! as absent, never as an error.
//!
//! Invariant: the ceiling is the least of physical memory and the limits of every control group above us, since
//! a parent's limit binds its children, too.

use crate::size;
use std::fmt;
use std::fs;
use std::path::Path;

/// Ceiling where neither `/proc/meminfo` nor a control group answers (another system): 2 GiB.
const UNKNOWN_CEILING_BYTES: u64 = 2 << 30;

/// Memory of the machine, as far as this process may use it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostMemory {
    /// Installed memory, if known.
    pub physical_bytes: Option<u64>,
    /// Least limit of the control groups that hold this process, if any is set.
    pub cgroup_limit_bytes: Option<u64>,
}

impl fmt::Display for HostMemory {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let amount = |bytes: Option<u64>| bytes.map(size::bytes);
        match amount(self.physical_bytes) {
            Some(installed) => write!(f, "{installed} installed, ")?,
            None => write!(f, "installed memory unknown, ")?,
        }
        match amount(self.cgroup_limit_bytes) {
            Some(limit) => write!(f, "control group limited to {limit}"),
            None => write!(f, "no control group limits it"),
        }
    }
}

impl HostMemory {
    /// Asks the running system.
    pub fn detect() -> HostMemory {
        let read = |path: &str| fs::read_to_string(path).unwrap_or_default();
        HostMemory {
            physical_bytes: total_memory(&read("/proc/meminfo")),
            cgroup_limit_bytes: cgroup_limit(Path::new("/sys/fs/cgroup"), &read("/proc/self/cgroup")),
        }
    }

    /// What percentages and `auto` refer to, bytes.
    pub fn ceiling_bytes(&self) -> u64 {
        [self.physical_bytes, self.cgroup_limit_bytes]
            .into_iter()
            .flatten()
            .min()
            .unwrap_or(UNKNOWN_CEILING_BYTES)
    }
}

/// `MemTotal` of `/proc/meminfo`, bytes.
fn total_memory(meminfo: &str) -> Option<u64> {
    kib_field(meminfo, "MemTotal:")
}

/// A field of `/proc` that reads `NAME:  12345 kB`, in bytes.
pub fn kib_field(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    line.split_whitespace().next()?.parse::<u64>().ok()?.checked_mul(1024)
}

/// The least limit of the groups named in `membership` (the text of `/proc/self/cgroup`), version 1 or 2,
/// mounted at `root`.
fn cgroup_limit(root: &Path, membership: &str) -> Option<u64> {
    membership
        .lines()
        .filter_map(|line| {
            // "hierarchy:controllers:path"; version 2 has no controllers.
            let mut parts = line.splitn(3, ':').skip(1);
            let (controllers, path) = (parts.next()?, parts.next()?);
            if controllers.is_empty() {
                limit_upwards(root, path, "memory.max")
                    .into_iter()
                    .chain(limit_upwards(&root.join("unified"), path, "memory.max"))
                    .min()
            } else if controllers.split(',').any(|name| name == "memory") {
                limit_upwards(&root.join("memory"), path, "memory.limit_in_bytes")
            } else {
                None
            }
        })
        .min()
}

/// The least number in `file` from the group `path` up to `mount`. Inside a container the path may name groups
/// that are not visible; the walk then finds those that are.
fn limit_upwards(mount: &Path, path: &str, file: &str) -> Option<u64> {
    let group = mount.join(path.trim_start_matches('/'));
    group
        .ancestors()
        .take_while(|folder| folder.starts_with(mount))
        .filter_map(|folder| fs::read_to_string(folder.join(file)).ok())
        .filter_map(|text| text.trim().parse::<u64>().ok())
        // Version 1 writes "no limit" as the largest page-aligned i64.
        .filter(|bytes| *bytes < 1 << 62)
        .min()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(root: &Path, file: &str, text: &str) {
        let path = root.join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    #[test]
    fn meminfo_is_in_kib() {
        assert_eq!(total_memory("MemTotal:       2048 kB\nMemFree: 1 kB\n"), Some(2 << 20));
        assert_eq!(total_memory("MemFree: 1 kB\n"), None);
        assert_eq!(total_memory("MemTotal: much kB\n"), None);
    }

    #[test]
    fn version_2_takes_the_least_limit_on_the_way_up() {
        let root = tempfile::tempdir().unwrap();
        write(root.path(), "a/b/memory.max", "max\n");
        write(root.path(), "a/memory.max", "1000\n");
        write(root.path(), "memory.max", "5000\n");
        assert_eq!(cgroup_limit(root.path(), "0::/a/b\n"), Some(1000));
        assert_eq!(cgroup_limit(root.path(), "0::/not/here\n"), Some(5000));
        assert_eq!(cgroup_limit(root.path(), ""), None);
    }

    #[test]
    fn version_1_knows_its_controller_and_its_word_for_unlimited() {
        let root = tempfile::tempdir().unwrap();
        write(root.path(), "memory/memory.limit_in_bytes", "9223372036854771712\n");
        assert_eq!(cgroup_limit(root.path(), "4:cpu,memory:/job\n0::/\n"), None);
        write(root.path(), "memory/job/memory.limit_in_bytes", "268435456\n");
        assert_eq!(cgroup_limit(root.path(), "4:cpu,memory:/job\n0::/\n"), Some(256 << 20));
        assert_eq!(cgroup_limit(root.path(), "4:cpu:/job\n"), None);
    }

    #[test]
    fn the_ceiling_is_the_least_that_is_known() {
        let host = |physical_bytes, cgroup_limit_bytes| HostMemory { physical_bytes, cgroup_limit_bytes };
        assert_eq!(host(Some(8), Some(5)).ceiling_bytes(), 5);
        assert_eq!(host(Some(8), None).ceiling_bytes(), 8);
        assert_eq!(host(None, None).ceiling_bytes(), UNKNOWN_CEILING_BYTES);
    }
}
