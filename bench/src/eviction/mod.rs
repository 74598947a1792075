//! Eviction: the pool's clock beside plain LRU and Belady's optimum, on the pages that a session asks for.
//!
//! ```text
//! a scenario of `stress`, all pages in memory, one worker -> PageTrace: the pages that each of its turns asks for
//!     -> policy: the clock as the pool has it, LRU, the optimum -> pages read
//!     -> replay: the pool itself, page after page               -> pages read, and pages that it holds
//! ```
//!
//! The optimum reads the fewest pages that anybody can who reads a page only when it is asked for: it knows what is to
//! come (Belady, "A study of replacement algorithms for a virtual-storage computer", IBM Systems Journal 5(2), 1966).
//!
//! Invariants: 1. all policies get the same trace and the same count of frames, each of one page; 2. that count is what
//! the pool came to hold in the memory that it was given, as pages take more or less of a frame there.

mod policy;
mod replay;
mod trace;

use crate::model::{Model, Surroundings};
use crate::stress::StressOptions;
use serde::Serialize;
use std::collections::BTreeMap;
use trex_store::layout::FRAME_BYTES;

/// Memory for frames, in hundredths of what whole frames of all pages that are asked for would take.
const MEMORY_PERCENT: [u64; 3] = [10, 20, 30];

/// What pages were read for one trace.
#[derive(Clone, Debug, Serialize)]
pub struct EvictionFigures {
    scene: String,
    scenario: &'static str,
    switches: u32,
    triangle_count: u64,
    /// Pages asked for, turn by turn.
    asked_count: usize,
    /// Different ones.
    page_count: usize,
    /// By the memory for frames, hundredths of what whole frames of all these pages would take.
    memory: BTreeMap<u64, PolicyFigures>,
}

/// Pages read in one size of memory.
#[derive(Clone, Debug, Serialize)]
struct PolicyFigures {
    frames_bytes: u64,
    /// Pages that the pool held in it at the end, and that the policies below hold.
    held_count: usize,
    /// Pages that the pool read.
    pool: u64,
    clock: u64,
    lru: u64,
    optimum: u64,
}

/// Records a scenario on `model` and counts the pages that each policy reads.
///
/// # Errors
/// The file or its pages cannot be read, or the limit has no room for all of them.
pub fn run(model: &Model, options: &StressOptions, around: &Surroundings) -> anyhow::Result<EvictionFigures> {
    let (file, asked) = trace::record(model, options, around)?;
    let page_count = asked.different();
    let mut memory = BTreeMap::new();
    for percent in MEMORY_PERCENT {
        let frames_bytes = percent * (page_count * FRAME_BYTES) as u64 / 100;
        let replayed = replay::replay(&file, &asked, frames_bytes, around)?;
        let frames = replayed.held_count;
        let figures = PolicyFigures {
            frames_bytes: replayed.frames_bytes,
            held_count: frames,
            pool: replayed.read_count,
            clock: policy::clock(&asked, frames),
            lru: policy::lru(&asked, frames),
            optimum: policy::optimum(&asked, frames),
        };
        memory.insert(percent, figures);
    }
    Ok(EvictionFigures {
        scene: model.scene.clone(),
        scenario: options.scenario.name(),
        switches: options.switches,
        triangle_count: file.superblock().triangle_count,
        asked_count: asked.len(),
        page_count,
        memory,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stress::Scenario;
    use rand_pcg::Pcg64;
    use rand_pcg::rand_core::{Rng, SeedableRng};
    use std::sync::Arc;
    use std::time::Duration;
    use trex_store::build::Voxels;
    use trex_store::{Budget, Interrupt, PageFile};

    fn around() -> (Surroundings, tempfile::TempDir) {
        let folder = tempfile::tempdir().unwrap();
        let (budget, interrupt) = (Budget::unlimited(), Interrupt::default());
        (Surroundings { threads: 1, budget, folder: folder.path().to_path_buf(), interrupt }, folder)
    }

    #[test]
    fn a_session_is_recorded_and_nobody_reads_less_than_the_optimum() {
        let (around, _folder) = around();
        let model = Model::for_bench("gen:isosurface:200k", Voxels::Resolution(256), around.folder.clone());
        let options = StressOptions {
            scenario: Scenario::Teleport,
            switches: 2,
            hold: Duration::from_secs(20),
            seed: 1,
            views: vec![],
            fills: true,
            requirements: vec![],
        };
        let figures = run(&model, &options, &around).unwrap();
        assert!(figures.page_count > 1 && figures.asked_count > 100 * figures.page_count, "{figures:?}");
        for told in figures.memory.values() {
            assert!(told.optimum <= told.clock.min(told.lru), "{told:?}");
            assert!(told.optimum >= figures.page_count as u64, "{told:?}");
        }
    }

    /// Pages of one model take much the same memory, so that the pool holds about as many all the time.
    #[test]
    fn the_pool_reads_what_its_clock_is_said_to_read() {
        let (around, _folder) = around();
        let model = Model::for_bench("gen:isosurface:500k", Voxels::None, around.folder.clone());
        let file = Arc::new(PageFile::open(&model.path, &around.budget).unwrap());
        let mut rng = Pcg64::seed_from_u64(3);
        // Some pages that are asked for again and again, and others by chance.
        let count = file.pages().len() as u32;
        let asked = (0..20_000).map(|at| match rng.next_u64() % 3 {
            0 => rng.next_u64() as u32 % count,
            _ => (at / 500 + rng.next_u64() as u32 % 7) % count,
        });
        let asked = trace::PageTrace::of(&asked.collect::<Vec<u32>>());
        let replayed =
            replay::replay(&file, &asked, (count as usize * FRAME_BYTES / 6) as u64, &around).unwrap();
        assert!(replayed.held_count < count as usize, "{count} pages");
        let clock = policy::clock(&asked, replayed.held_count);
        let apart = replayed.read_count as f64 / clock as f64 - 1.0;
        assert!(apart.abs() < 0.1, "{} read, {clock} by the clock", replayed.read_count);
        assert!(clock != policy::lru(&asked, replayed.held_count), "the two cannot be told apart");
    }
}
