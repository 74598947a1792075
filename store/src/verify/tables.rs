//! Verify, what leads to the pages: both superblocks, and the sections of a file that cannot be opened.
//!
//! Invariant: what does not match is read again before it counts as damaged.

use super::{Damage, Verdict};
use crate::error::{Code, Error, Result};
use crate::file::{read_superblock, streamed_section, twice};
use crate::io::Origin;
use crate::layout::{SUPERBLOCK_BYTES, SectionKind, Superblock};
use std::path::Path;

/// Head and tail must both be whole and the same.
pub(super) fn check_superblocks(path: &Path, block: &Superblock, verdict: &mut Verdict) -> Result<()> {
    let file = Origin::open(path)?;
    let length = SUPERBLOCK_BYTES as u64;
    for (what, offset) in [("the head is damaged", 0), ("the tail is damaged", block.file_bytes - length)] {
        let checked = twice(&file, (offset, length), || {
            let mut bytes = [0; SUPERBLOCK_BYTES];
            file.read_exact_at(&mut bytes, offset).map_err(|e| Error::io("read", path, &e))?;
            if bytes == block.to_bytes() { Ok(()) } else { Err(Error::new(Code::Damaged, what)) }
        });
        verdict.take(checked, Damage::of_bytes(what, offset, length))?;
    }
    Ok(())
}

/// What is damaged in a file that cannot be opened for `error`: sections that do not match their hashes, or, where
/// no superblock tells of sections, the file.
pub(super) fn check_sections(path: &Path, error: &Error, verdict: &mut Verdict) -> Result<()> {
    let file = Origin::open(path)?;
    if let Ok(block) = read_superblock(&file, path) {
        check_superblocks(path, &block, verdict)?;
        for section in block.sections.iter().filter(|section| section.kind != 0) {
            let kind = SectionKind::from_word(section.kind);
            let name = kind.map_or("unknown", SectionKind::name);
            let what = format!("the section `{name}` does not match its hash");
            // The place in messages; what is told here is `what`.
            let place = (kind.unwrap_or(SectionKind::PageTable), block.file_id);
            let checked = streamed_section(&file, *section, place, path, |_| Ok(()));
            verdict.take(checked, Damage::of_bytes(&what, section.offset, section.bytes))?;
        }
    }
    if verdict.damage_count == 0 {
        let bytes = file.length().map_err(|e| Error::io("open", path, &e))?;
        verdict.add(Damage::of_bytes(&summary(error), 0, bytes));
    }
    Ok(())
}

impl Verdict {
    /// Takes `damage` for an error that says so.
    pub(super) fn take(&mut self, checked: Result<()>, damage: Damage) -> Result<()> {
        match checked {
            Err(error) if error.code() == Code::Damaged => self.add(damage),
            checked => checked?,
        }
        Ok(())
    }
}

fn summary(error: &Error) -> String {
    format!("{} ({})", error.what(), error.numbers_text())
}
