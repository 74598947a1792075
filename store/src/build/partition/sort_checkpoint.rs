//! `SortCheckpoint`: how far a partition has come, as a record of its journal, and the way back from it.
//!
//! ```text
//! sorted   scan, counts, bounds, hash of what was read | sketches of the surface | cells | runs | sums of colours
//! cell     level, place x, y, z, runs of it             (8 bytes each)
//! run      offset, bytes << 32 | triangles              (8 bytes each; cell after cell)
//! ```
//!
//! A stream cannot be entered in its middle: what is in cells is read again, hashed and compared, but neither snapped
//! nor sorted nor written.
//!
//! Invariants: 1. a cell holds the same triangles in the same order, however often its buffer was written before it was
//! full, so the bytes that follow are those of a build that was never killed; 2. a record whose file is gone or too
//! short, or whose numbers cannot be true together, counts as absent.

use super::cells::{CellPlace, PartitionCells, first_levels, is_on_lattice};
use super::collapsed::CollapsedSizes;
use super::colour_means::ColourMeans;
use super::snap::{Prefix, SnapSummary};
use super::surface::SurfaceSums;
use crate::attributes::AttributeSet;
use crate::budget::Budget;
use crate::build::journal::record::JournalRecord;
use crate::build::journal::{FileKind, Journal};
use crate::build::options::Precision;
use crate::build::scan::lattice::choose;
use crate::build::scan::{Grid, Scan};
use crate::build::scratch::{Run, Scratch};
use crate::cluster::LatticeBox;
use crate::error::Result;
use crate::geom::{Aabb, Lattice};
use crate::layout::TRIANGLES;
use crate::stated_lattice;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::path::PathBuf;
use std::time::Instant;

/// Words of a cell and of a run.
const CELL_WORDS: usize = 5;
const RUN_WORDS: usize = 2;
/// Bytes of the words, as often as they are held while a record is written or parsed.
const COPIES: u64 = 2;

/// What stands in `sorted`. Numbers that are not whole stand by their bits.
#[derive(Serialize, Deserialize)]
struct SortedHead {
    /// The scan's: bounds, median edge, counts.
    scanned_bounds: [[u64; 3]; 2],
    median_edge: u64,
    expected: [u64; 2],
    /// Exponent and origin of the lattice that the input states.
    lattice: Option<(i32, [u64; 3])>,
    attributes: AttributeSet,
    /// Triangles read, and their hash.
    triangle_count: u64,
    hash: u64,
    rejected_degenerate: u64,
    collapsed: CollapsedSizes,
    rejected_non_finite: u64,
    is_exact: bool,
    lattice_bounds: [[i64; 3]; 2],
    surface: SurfaceSums,
    scratch_bytes: u64,
}

/// The first triangles of an input, in cells.
pub(crate) struct SortCheckpoint {
    pub(crate) scan: Scan,
    pub(crate) grid: Grid,
    /// What was read: it is read again, and compared.
    pub(crate) prefix: Prefix,
    pub(crate) snapped: SnapSummary,
    pub(crate) scratch: Scratch,
    pub(crate) runs: Vec<(CellPlace, Vec<Run>)>,
}

impl SortCheckpoint {
    /// Records what was sorted, once it is on the disk. Does nothing where there is no memory for that.
    pub(crate) fn record(
        journal: &mut Journal,
        (scan, prefix): (&Scan, Prefix),
        snapped: &SnapSummary,
        cells: &mut PartitionCells,
        budget: &Budget,
    ) -> Result<()> {
        let begin = Instant::now();
        cells.sync()?;
        let (scratch, runs) = cells.runs();
        let run_count: usize = runs.clone().map(|(_, runs)| runs.len()).sum();
        let words = CELL_WORDS * runs.clone().count() + RUN_WORDS * run_count;
        let Ok(_lease) = budget.lease("the journal", COPIES * 8 * words as u64) else {
            journal.postpone(begin);
            return Ok(());
        };
        let (surface, registers) = snapped.surface.parts();
        let head = SortedHead {
            scanned_bounds: [scan.bounds.lo, scan.bounds.hi].map(|corner| corner.map(f64::to_bits)),
            median_edge: scan.median_edge.to_bits(),
            expected: [scan.triangle_count, scan.non_finite_count],
            lattice: scan.lattice.map(|lattice| (lattice.exponent, lattice.origin.map(f64::to_bits))),
            attributes: scan.attributes,
            triangle_count: prefix.triangle_count,
            hash: prefix.hash,
            rejected_degenerate: snapped.rejected_degenerate,
            collapsed: snapped.collapsed,
            rejected_non_finite: snapped.rejected_non_finite,
            is_exact: snapped.exact,
            lattice_bounds: [snapped.bounds.lo, snapped.bounds.hi],
            surface,
            scratch_bytes: scratch.bytes(),
        };
        let mut words = [Vec::new(), Vec::with_capacity(RUN_WORDS * run_count)];
        for (CellPlace { level, at: [x, y, z] }, runs) in runs {
            words[0].extend([level, x, y, z, runs.len() as u32].map(u64::from));
            let run = |run: &Run| [run.offset, u64::from(run.bytes) << 32 | u64::from(run.triangle_count)];
            words[1].extend(runs.iter().flat_map(run));
        }
        let [cell_words, run_words] = [&words[0], &words[1]].map(|words| bytemuck::cast_slice(words));
        let means = snapped.means.as_ref().map_or(&[][..], ColourMeans::words);
        let blobs = [&registers[..], cell_words, run_words, means];
        journal.write_record((FileKind::Sorted, begin), &head, &blobs)?;
        scratch.keep_segments();
        Ok(())
    }

    /// What a build before this has sorted, on the lattice of such a precision; `None` for nothing.
    pub(crate) fn read(
        journal: &Journal,
        precision: Precision,
        budget: &Budget,
    ) -> Result<Option<SortCheckpoint>> {
        let record = journal.read_record::<SortedHead>(FileKind::Sorted, budget)?;
        let record = record.filter(|record| journal.holds(FileKind::Cells, record.head.scratch_bytes));
        record.map_or(Ok(None), |record| {
            SortCheckpoint::parse(record, precision, journal.path(FileKind::Cells))
        })
    }

    /// Of a record, with the scratch file that it speaks of; `None` where it cannot be one of ours.
    fn parse(
        record: JournalRecord<SortedHead>,
        precision: Precision,
        cells: PathBuf,
    ) -> Result<Option<SortCheckpoint>> {
        let head = record.head;
        let [lo, hi] = head.scanned_bounds.map(|corner| corner.map(f64::from_bits));
        let [triangle_count, non_finite_count] = head.expected;
        let median_edge = f64::from_bits(head.median_edge);
        let lattice = head.lattice.map(|(exponent, origin)| {
            stated_lattice::checked(Lattice { origin: origin.map(f64::from_bits), exponent })
        });
        let (bounds, is_lattice) = (Aabb { lo, hi }, lattice != Some(None));
        let lattice = lattice.flatten();
        let attributes = head.attributes;
        let scan = Scan { bounds, median_edge, triangle_count, non_finite_count, lattice, attributes };
        let is_scan = is_lattice
            && lo.iter().chain(&hi).chain([&median_edge]).all(|v| v.is_finite())
            && (0..3).all(|axis| lo[axis] <= hi[axis])
            && median_edge >= 0.0
            && lattice.is_none_or(|lattice| {
                let last = lattice.snap(hi);
                last.iter().all(|&v| v >> Lattice::MAX_BITS == 0) && last != [0; 3]
            })
            && non_finite_count <= triangle_count
            && triangle_count <= TRIANGLES;
        let Some(grid) = is_scan.then(|| choose(&scan, precision, "").ok()).flatten() else {
            return Ok(None);
        };
        let mut snapped = SnapSummary::new(&scan, &grid);
        let Ok([registers, cell_words, run_words, means]) = <[Vec<u8>; 4]>::try_from(record.blobs) else {
            return Ok(None);
        };
        let is_surface = snapped.surface.restore(head.surface, &registers)
            && snapped.means.as_mut().map_or(means.is_empty(), |sums| sums.restore(&means));
        (snapped.rejected_degenerate, snapped.collapsed) = (head.rejected_degenerate, head.collapsed);
        (snapped.rejected_non_finite, snapped.exact) = (head.rejected_non_finite, head.is_exact);
        let [cell_words, run_words] =
            [cell_words, run_words].map(|words| bytemuck::allocation::pod_collect_to_vec::<u8, u64>(&words));
        let levels = first_levels(triangle_count, &grid);
        let Some(runs) = runs(&cell_words, &run_words, levels, head.scratch_bytes) else { return Ok(None) };
        let sorted: u64 =
            runs.iter().flat_map(|(_, runs)| runs).map(|run| u64::from(run.triangle_count)).sum();
        let counts = [sorted, head.rejected_degenerate, head.rejected_non_finite];
        let read = counts.into_iter().try_fold(0u64, |sum, count| sum.checked_add(count));
        let lattice_bounds = head.lattice_bounds;
        let is_box = is_on_lattice(&lattice_bounds, grid.bits)
            && (0..3).all(|axis| lattice_bounds[0][axis] <= lattice_bounds[1][axis]);
        let is_sound = is_surface
            && read == Some(head.triangle_count)
            && head.triangle_count <= TRIANGLES
            && head.collapsed.count() <= head.rejected_degenerate
            && (sorted == 0 || is_box);
        if !is_sound {
            return Ok(None);
        }
        if sorted > 0 {
            snapped.bounds = LatticeBox { lo: lattice_bounds[0], hi: lattice_bounds[1] };
        }
        let scratch = Scratch::reopen(cells, head.scratch_bytes)?;
        scratch.keep_segments();
        let prefix = Prefix { triangle_count: head.triangle_count, hash: head.hash };
        Ok(Some(SortCheckpoint { scan, grid, prefix, snapped, scratch, runs }))
    }
}

/// The cells of a record, of which no two are the same, and their runs, all of which lie in the scratch file; `None`
/// for words that say anything else.
fn runs(
    cell_words: &[u64],
    run_words: &[u64],
    levels: u32,
    scratch_bytes: u64,
) -> Option<Vec<(CellPlace, Vec<Run>)>> {
    let (cells, []) = cell_words.as_chunks::<CELL_WORDS>() else { return None };
    let (mut rest, []) = run_words.as_chunks::<RUN_WORDS>() else { return None };
    let (mut all, mut seen) = (Vec::with_capacity(cells.len()), HashSet::new());
    for &[level, x, y, z, run_count] in cells {
        let level = u32::try_from(level).ok().filter(|&level| level <= levels)?;
        if [x, y, z].iter().any(|&at| at >> level != 0) {
            return None;
        }
        let place = CellPlace { level, at: [x, y, z].map(|at| at as u32) };
        let (these, others) = rest.split_at_checked(usize::try_from(run_count).ok()?)?;
        rest = others;
        let run = |&[offset, word]: &[u64; RUN_WORDS]| {
            let run = Run { offset, bytes: (word >> 32) as u32, triangle_count: word as u32 };
            run.is_sound(scratch_bytes).then_some(run)
        };
        all.push((place, these.iter().map(run).collect::<Option<Vec<Run>>>()?));
        if !seen.insert(place) {
            return None;
        }
    }
    rest.is_empty().then_some(all)
}
