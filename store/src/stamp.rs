//! `stamp`: what tells an input from what it was when a build began.
//!
//! ```text
//! length, time of its last change, hash of its first 4 KiB, of its last, and of 63 parts as long between them
//! ```
//!
//! A file that is written over in place may keep its length, and tools that copy set its time back: the parts tell
//! what these do not. All of a file of up to 256 KiB is in them. Of a larger one a change between them goes unseen, as
//! long as length and time stay.

use std::fs::File;
use std::io;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::Path;
use xxhash_rust::xxh3::Xxh3;

/// Bytes of a part.
const PART: u64 = 4096;
/// Steps from the first part to the last.
const STEPS: u64 = 64;

/// What tells a file from what it was before; or that it cannot be found. Reads a quarter of a megabyte of it at most.
pub fn stamp(path: &Path) -> String {
    let Ok(found) = path.metadata() else { return "not there".to_owned() };
    let bytes = found.len();
    let known = format!("{bytes} bytes, changed at {}.{:09} s", found.mtime(), found.mtime_nsec());
    // A pipe has no parts, and would wait for somebody who writes.
    if !found.is_file() {
        return known;
    }
    match parts_hash(path, bytes) {
        Ok(hash) => format!("{known}, parts {hash:016x}"),
        Err(error) => format!("{known}, {}", error.kind()),
    }
}

/// What tells a file from others by its content alone, wherever it stands: its length and the hash of its parts.
pub fn content_stamp(path: &Path) -> io::Result<String> {
    let bytes = path.metadata()?.len();
    Ok(format!("{bytes} bytes, parts {:016x}", parts_hash(path, bytes)?))
}

fn parts_hash(path: &Path, bytes: u64) -> io::Result<u64> {
    let (file, mut hasher) = (File::open(path)?, Xxh3::new());
    let mut part = [0; PART as usize];
    let last = bytes.saturating_sub(PART);
    for step in 0..=STEPS {
        let at = (u128::from(last) * u128::from(step) / u128::from(STEPS)) as u64;
        let part = &mut part[..PART.min(bytes) as usize];
        file.read_exact_at(part, at)?;
        hasher.update(part);
    }
    Ok(hasher.digest())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::SystemTime;

    /// Fourteen of sixteen builds went on with the model as it had been.
    #[test]
    fn bytes_tell_where_length_and_time_do_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("input");
        let then = SystemTime::UNIX_EPOCH;
        let stamped = |content: &[u8]| {
            std::fs::write(&path, content).unwrap();
            File::options().write(true).open(&path).unwrap().set_modified(then).unwrap();
            stamp(&path)
        };
        for bytes in [0, 1, PART, PART * STEPS, PART * STEPS + PART, 9 << 20] {
            let content = vec![7; bytes as usize];
            let before = stamped(&content);
            assert_eq!(stamped(&content), before);
            // Ends and middle are parts of any file; of a small one all is.
            let all = 0..bytes.min(PART * STEPS);
            let places = if bytes <= PART * STEPS {
                all.step_by(1009).collect()
            } else {
                vec![0, bytes / 2, bytes - 1]
            };
            for place in places {
                let mut content = content.clone();
                content[place as usize] ^= 1;
                assert_ne!(stamped(&content), before, "{place} of {bytes}");
            }
        }
        let copy = folder.path().join("copy");
        std::fs::copy(&path, &copy).unwrap();
        assert_eq!(content_stamp(&copy).unwrap(), content_stamp(&path).unwrap());
        std::fs::write(&copy, b"other").unwrap();
        assert_ne!(content_stamp(&copy).unwrap(), content_stamp(&path).unwrap());
        assert_eq!(stamp(&folder.path().join("none")), "not there");
        assert!(!stamp(folder.path()).contains("parts"));
    }
}
