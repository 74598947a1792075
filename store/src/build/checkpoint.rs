//! `Checkpoint`: where a build resumes, by the records of the builds before it.
//!
//! ```text
//!         batches are in cells       all cells are chunks          chunks are in the output
//!   Fresh -------------------> Sorted ------------------> Partitioned -------------------> Emitting --> published
//!
//!                records                  known                        files reused           files overwritten
//! Fresh          none                     nothing                      none                   all
//! Sorted         sorted                   scan, lattice, what was read cells                  voxels, draft
//! Partitioned    chunks                   all of the input             cells                  voxels, draft
//! Emitting       chunks and done          and what is in the output    cells, voxels, draft   none
//! ```
//!
//! A record is written when it is due, so a build may pass a checkpoint without one. Work between the record and the
//! moment at which the build was killed is done again: triangles behind those that are in cells, chunks behind those
//! that are in the output. Of chunks whose ends share a page that was not full, the ends are made again.
//!
//! Invariants: 1. a build resumes from the furthest checkpoint whose records are whole and can be true, and whose files
//! are as long as these say; 2. records of other checkpoints are removed before the files that they speak of are
//! overwritten; 3. whatever it resumes from, the bytes of the output are those of a build that was never killed.

use super::emit::emit_checkpoint::EmitCheckpoint;
use super::journal::{FileKind, Journal};
use super::options::BuildOptions;
use super::partition::outcome::PartitionOutcome;
use super::partition::sort_checkpoint::SortCheckpoint;
use crate::error::Result;
use crate::scratch::Place;
use std::path::Path;

/// Where a build resumes, with all that is known there.
pub(super) enum Checkpoint {
    /// At the start of the input.
    Fresh,
    /// Within the input, whose first triangles are in cells.
    Sorted(Box<SortCheckpoint>),
    /// Before the first chunk.
    Partitioned(Box<PartitionOutcome>),
    /// Among the chunks, or behind the last.
    Emitting(Box<PartitionOutcome>, Box<EmitCheckpoint>),
}

/// Where the files of a build are.
pub(super) struct FilePlaces {
    pub(super) cells: Place,
    pub(super) voxels: Place,
    pub(super) draft: Place,
}

impl Checkpoint {
    /// The checkpoint of a journal, in which no record is left but those that lead to it; [`Checkpoint::Fresh`] for a
    /// build without one.
    ///
    /// # Errors
    /// [`Code::Usage`](crate::Code::Usage) where files that the input names have changed; those of reading the records.
    pub(super) fn find(journal: Option<&mut Journal>, options: &BuildOptions) -> Result<Checkpoint> {
        let Some(journal) = journal else { return Ok(Checkpoint::Fresh) };
        let checkpoint = Checkpoint::read(journal, options)?;
        let others = FileKind::RECORDS.into_iter().filter(|record| !checkpoint.records().contains(record));
        // The furthest first: it speaks of what the others lead to.
        others.rev().try_for_each(|record| journal.remove_record(record))?;
        Ok(checkpoint)
    }

    fn read(journal: &mut Journal, options: &BuildOptions) -> Result<Checkpoint> {
        let outcome = PartitionOutcome::read(journal, &options.budget)?.filter(|outcome| {
            let parted = &outcome.partition;
            parted.chunk_triangle_count() == parted.summary.triangle_count
        });
        let Some(outcome) = outcome else {
            let sorted = SortCheckpoint::read(journal, options.precision, &options.budget)?;
            return Ok(sorted.map_or(Checkpoint::Fresh, |sorted| Checkpoint::Sorted(Box::new(sorted))));
        };
        let emitted = EmitCheckpoint::read(journal, &outcome.partition, &options.budget)?;
        journal.check_named_files(&outcome.source)?;
        outcome.partition.set_unread(emitted.as_ref().map_or(0, EmitCheckpoint::consumed));
        Ok(match emitted {
            None => Checkpoint::Partitioned(Box::new(outcome)),
            Some(emitted) => Checkpoint::Emitting(Box::new(outcome), Box::new(emitted)),
        })
    }

    /// Records that lead here.
    fn records(&self) -> &'static [FileKind] {
        match self {
            Checkpoint::Fresh => &[],
            Checkpoint::Sorted(_) => &[FileKind::Sorted],
            Checkpoint::Partitioned(_) => &[FileKind::Chunks],
            Checkpoint::Emitting(..) => &[FileKind::Chunks, FileKind::Emitted],
        }
    }

    /// Files that are reused; others are overwritten.
    fn reused(&self) -> &'static [FileKind] {
        match self {
            Checkpoint::Fresh => &[],
            Checkpoint::Sorted(_) | Checkpoint::Partitioned(_) => &[FileKind::Cells],
            Checkpoint::Emitting(..) => &[FileKind::Cells, FileKind::Voxels, FileKind::Draft],
        }
    }

    /// Where the files of the build are: named by its journal, or without a name in the folder of scratch.
    pub(super) fn places(&self, journal: Option<&Journal>, scratch_folder: &Path) -> FilePlaces {
        let place = |kind| match journal {
            None => Place::Unnamed(scratch_folder.to_path_buf()),
            Some(journal) if self.reused().contains(&kind) => Place::Left(journal.path(kind)),
            Some(journal) => Place::New(journal.path(kind)),
        };
        FilePlaces {
            cells: place(FileKind::Cells),
            voxels: place(FileKind::Voxels),
            draft: place(FileKind::Draft),
        }
    }
}
