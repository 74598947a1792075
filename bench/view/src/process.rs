//! What the system says of a process, Linux's `/proc`.

use crate::page::Failure;

/// A process, by its id.
pub(crate) struct Process(pub(crate) u64);

/// What a process holds.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ProcessUse {
    pub(crate) resident_bytes: u64,
    pub(crate) threads: u64,
    pub(crate) files: u64,
}

impl Process {
    fn read(&self, name: &str) -> Result<String, Failure> {
        Ok(std::fs::read_to_string(format!("/proc/{}/{name}", self.0))?)
    }

    /// Processor time that it has used, seconds.
    pub(crate) fn cpu_s(&self) -> Result<f64, Failure> {
        let nanoseconds = |task: std::fs::DirEntry| -> Option<f64> {
            let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
            text.split_whitespace().next()?.parse().ok()
        };
        let tasks = std::fs::read_dir(format!("/proc/{}/task", self.0))?;
        Ok(tasks.filter_map(|task| nanoseconds(task.ok()?)).sum::<f64>() * 1e-9)
    }

    pub(crate) fn held(&self) -> Result<ProcessUse, Failure> {
        let status = self.read("status")?;
        let number = |key: &str| -> Result<u64, Failure> {
            let line = status.lines().find(|line| line.starts_with(key)).ok_or("no such line in /proc")?;
            Ok(line.split_whitespace().nth(1).ok_or("no number in /proc")?.parse()?)
        };
        let files = std::fs::read_dir(format!("/proc/{}/fd", self.0))?.count() as u64;
        Ok(ProcessUse { resident_bytes: number("VmRSS:")? << 10, threads: number("Threads:")?, files })
    }
}
