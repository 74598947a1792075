//! Where and when a figure was measured: the machine, the commit, the date.
//!
//! Invariants: 1. what cannot be found out reads `unknown`; 2. a checkout that differs from its commit has none.

use anyhow::{Context, ensure};
use serde::{Deserialize, Serialize};
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{SystemTime, UNIX_EPOCH};

/// The machine, as far as it matters for a figure.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Machine {
    /// Model name of the processor.
    pub cpu: String,
    /// Cores that this process may use.
    pub core_count: u64,
    /// Installed memory, bytes; 0 when not known.
    pub memory_bytes: u64,
    /// Kernel name and release.
    pub kernel: String,
}

impl Machine {
    /// Describes the machine that this runs on.
    pub fn here() -> Machine {
        let read = |path: &str| fs::read_to_string(path).unwrap_or_default();
        let release = read("/proc/sys/kernel/osrelease");
        Machine {
            cpu: cpu_model(&read("/proc/cpuinfo")),
            core_count: std::thread::available_parallelism().map_or(1, |n| n.get() as u64),
            memory_bytes: memory_total(&read("/proc/meminfo")),
            kernel: match release.trim() {
                "" => std::env::consts::OS.to_owned(),
                release => format!("Linux {release}"),
            },
        }
    }

    /// One line for people: `Xeon 8481C, 2 cores, 23.4 GiB, Linux 6.1`.
    pub fn summary(&self) -> String {
        let Machine { cpu, core_count, memory_bytes, kernel } = self;
        let memory_gib = *memory_bytes as f64 / (1u64 << 30) as f64;
        let cores = if *core_count == 1 { "core" } else { "cores" };
        format!("{cpu}, {core_count} {cores}, {memory_gib:.1} GiB, {kernel}")
    }
}

/// The first model name of `/proc/cpuinfo`; ARM kernels print none.
fn cpu_model(cpuinfo: &str) -> String {
    cpuinfo
        .lines()
        .find_map(|line| line.strip_prefix("model name")?.split_once(':'))
        .map_or_else(|| format!("unknown {}", std::env::consts::ARCH), |(_, name)| name.trim().to_owned())
}

/// `MemTotal` of `/proc/meminfo`, bytes.
fn memory_total(meminfo: &str) -> u64 {
    let kib = meminfo
        .lines()
        .find_map(|line| line.strip_prefix("MemTotal:"))
        .and_then(|rest| rest.split_whitespace().next()?.parse::<u64>().ok());
    kib.unwrap_or(0) * 1024
}

/// The commit of the checkout at `root`, 12 digits; "unknown" where there is none.
///
/// # Errors
/// Files differ from it, other than records and the pages that show them.
pub fn commit(root: &Path) -> anyhow::Result<String> {
    let git = |args: &[&str]| {
        let output = Command::new("git").arg("-C").arg(root).args(args).output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let Some(commit) = git(&["rev-parse", "--short=12", "HEAD"]) else { return Ok("unknown".to_owned()) };
    let of_code = ["status", "--porcelain", "--", ".", ":!bench/record", ":!docs", ":!README.md"];
    let changed = git(&of_code).context("git does not tell what has changed")?;
    let first = changed.lines().next().unwrap_or_default();
    ensure!(
        changed.is_empty(),
        "a record is of a commit, and files differ from {commit}: {first}; commit them first"
    );
    Ok(commit)
}

/// Today, UTC, as `YYYY-MM-DD`.
pub fn today() -> String {
    let seconds = SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs());
    date(seconds / 86_400)
}

/// The date `days` after 1970-01-01. Years begin in March here, so that the leap day comes last
/// (Hinnant, "chrono-compatible low-level date algorithms", `civil_from_days`).
fn date(days: u64) -> String {
    let shifted = days + 719_468;
    let era = shifted / 146_097;
    let day_of_era = shifted % 146_097;
    let year_of_era = (day_of_era - day_of_era / 1_460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    format!("{year:04}-{month:02}-{day:02}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dates_know_leap_years() {
        for (days, expected) in [
            (0, "1970-01-01"),
            (58, "1970-02-28"),
            (789, "1972-02-29"),
            (11_016, "2000-02-29"),
            (20_454, "2026-01-01"),
        ] {
            assert_eq!(date(days), expected);
        }
    }

    #[test]
    fn proc_files_are_read_and_absent_ones_survived() {
        assert_eq!(cpu_model("processor : 0\nmodel name\t: Some CPU @ 2 GHz\n"), "Some CPU @ 2 GHz");
        assert!(cpu_model("").starts_with("unknown"));
        assert_eq!(memory_total("MemTotal:  2048 kB\n"), 2 << 20);
        assert_eq!(memory_total(""), 0);
        assert!(Machine::here().core_count >= 1);
    }

    #[test]
    fn no_checkout_is_an_unknown_commit() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(commit(folder.path()).unwrap(), "unknown");
    }

    #[test]
    fn a_changed_file_is_refused_and_a_record_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let git = |args: &[&str]| {
            let who =
                ["-c", "user.name=test", "-c", "user.email=test@localhost", "-c", "commit.gpgsign=false"];
            assert!(Command::new("git").arg("-C").arg(root).args(who).args(args).status().unwrap().success());
        };
        git(&["init", "-q"]);
        std::fs::write(root.join("code.rs"), "1").unwrap();
        git(&["add", "."]);
        git(&["commit", "-qm", "First"]);
        let clean = commit(root).unwrap();
        assert_eq!(clean.len(), 12);

        std::fs::create_dir_all(root.join("bench/record")).unwrap();
        for name in ["bench/record/a.jsonl", "README.md"] {
            std::fs::write(root.join(name), "{}").unwrap();
        }
        assert_eq!(commit(root).unwrap(), clean);
        std::fs::write(root.join("code.rs"), "2").unwrap();
        let error = commit(root).unwrap_err().to_string();
        assert!(error.contains("code.rs") && error.contains(&clean), "{error}");
    }
}
