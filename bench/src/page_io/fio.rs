//! The same extents, read by fio: a script of reads that it replays as fast as it can.

use anyhow::{Context, ensure};
use std::path::Path;
use std::process::Command;
use std::time::Duration;
use trex_store::io::{ALIGN_BYTES, Extent};

/// The extents of a round, read by fio. Gives its run time and processor time.
pub(super) fn read(
    (file, extents): (&Path, &[Extent]),
    depth: usize,
    folder: &Path,
) -> anyhow::Result<(Duration, Duration)> {
    let path = std::path::absolute(file)?;
    let name = path.to_str().context("fio takes names in UTF-8 only")?;
    let mut log = format!("fio version 2 iolog\n{name} add\n{name} open\n");
    for extent in extents {
        let align = ALIGN_BYTES as u64;
        let first = extent.offset / align * align;
        log += &format!("{name} read {first} {}\n", extent.end().next_multiple_of(align) - first);
    }
    log += &format!("{name} close\n");
    let script = tempfile::NamedTempFile::new_in(folder)?;
    std::fs::write(script.path(), log)?;
    let output = Command::new("fio")
        .args(["--name=pages", "--ioengine=io_uring", "--direct=1", "--replay_no_stall=1"])
        .arg(format!("--iodepth={depth}"))
        .arg(format!("--read_iolog={}", script.path().display()))
        .arg("--output-format=json")
        .output()
        .context("fio does not run: install it (Debian: fio)")?;
    ensure!(output.status.success(), "fio failed: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout);
    let document: serde_json::Value =
        serde_json::from_str(&text[text.find('{').unwrap_or(0)..]).context("what fio says")?;
    let job = &document["jobs"][0];
    let number = |value: &serde_json::Value| value.as_f64().context("a number that fio should tell");
    ensure!(number(&job["read"]["total_ios"])? as usize == extents.len(), "fio has not read all");
    let seconds = extents.len() as f64 / number(&job["read"]["iops"])?;
    let busy = (number(&job["usr_cpu"])? + number(&job["sys_cpu"])?) / 100.0;
    Ok((Duration::from_secs_f64(seconds), Duration::from_secs_f64(seconds * busy)))
}
