//! Workload `io`: pages of a file at random, cold, through each backend: as they are, hashed, traceable, and ready.
//!
//! ```text
//! raw        backend -> bytes                           what the disk and the system give
//! hashed     backend -> bytes -> hash                   and are believed
//! traceable  pool, loader, decoders -> hash -> frame    and rays may come: they unpack the clusters that they meet
//! ready      traceable -> all clusters unpacked         and none is left to unpack
//! waited     traceable, one after the other; busy: while more pages are asked for ahead than the pool queues
//! fio        the same extents, in the same order        somebody else's reads, aligned to 4096 bytes
//! mapped     the same, from a mapping, by its threads   as programs do that leave it all to the system
//! ```
//!
//! Invariants: 1. a round reads the same pages in the same order in every way; 2. before each the system is asked to
//! drop the file from its cache; 3. ways take turns; figures are medians over rounds.

mod clock;
mod demand;
mod figures;
mod fio;
mod mapped;
mod pages;
mod unpack;

pub use figures::{LatencyFigures, PageIoFigures, ReadStage, WayFigures};

use clock::Clock;
use mapped::MapTouch;
use pages::Pages;

use crate::full_pool;
use crate::median::median;
use crate::model::{Model, Surroundings};
use anyhow::{Context, ensure};
use hdrhistogram::Histogram;
use std::sync::Arc;
use std::time::{Duration, Instant};
use trex_store::PageFile;
use trex_store::io::{
    DirectChoice, IoChoice, IoOptions, Reader, StagingBuffer, Wait, open, staging_bytes_for,
};
use trex_store::layout::{FRAME_BYTES, STORED_BYTES};
use trex_store::pool::{PagePool, PoolOptions};

/// Longest latency that is told apart, microseconds.
const LATENCY_MOST_US: u64 = 3_600_000_000;
/// Pages over the frames that there are where some are waited for.
const PAGES_A_FRAME: usize = 4;

/// What to measure.
#[derive(Clone, Debug)]
pub struct PageIoOptions {
    /// Reads in flight, each at least 1.
    pub depths: Vec<usize>,
    /// Measured rounds, at least 1.
    pub rounds: usize,
    /// Seed of the order of pages.
    pub seed: u64,
    /// Read the same extents with fio, too, which must be installed.
    pub fio: bool,
    /// Read them from a mapping of the file, too, as programs do that leave memory to the system.
    pub mapped: bool,
}

/// A way to read, and what its rounds gave.
struct Way {
    kind: Kind,
    depth: usize,
    rates: Vec<f64>,
    cpu_us: Vec<f64>,
    latencies: Histogram<u64>,
    backend: (String, bool),
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Ours(ReadStage, IoChoice, DirectChoice),
    Fio,
    Mapped(MapTouch),
}

/// Measures `model`.
///
/// # Errors
/// The file or its pages cannot be read; the limit has no room for what is in flight; fio is asked for and does not
/// run.
pub fn run(model: &Model, options: &PageIoOptions, around: &Surroundings) -> anyhow::Result<PageIoFigures> {
    ensure!(options.rounds > 0 && options.depths.iter().all(|&depth| depth > 0), "a median takes a round");
    let file = Arc::new(PageFile::open(&model.path, &around.budget)?);
    let pages = Pages::new(&file, options.seed);
    let mut ways: Vec<Way> = options.depths.iter().flat_map(|&depth| Way::all(depth, options)).collect();
    // One round more, which is not measured.
    for round in 0..=options.rounds {
        for way in &mut ways {
            around.interrupt.check()?;
            let measured = way.round(&pages, around);
            let Round { pages, wall, cpu } = measured.with_context(|| way.name())?;
            if round > 0 {
                way.rates.push(pages as f64 / wall.as_secs_f64());
                way.cpu_us.push(cpu.as_secs_f64() * 1e6 / pages as f64);
            } else {
                way.latencies.reset();
            }
        }
    }
    let count = pages.order.len() as f64;
    let entries = pages.order.iter().map(|&page| &file.pages()[page as usize]);
    let bytes_per_page = entries.clone().map(|e| f64::from(e.stored_bytes)).sum::<f64>() / count;
    let triangles_per_page = entries.map(|e| f64::from(e.triangle_count)).sum::<f64>() / count;
    let fio: Vec<(usize, Vec<f64>)> =
        ways.iter().filter(|way| way.kind == Kind::Fio).map(|way| (way.depth, way.rates.clone())).collect();
    let figures = ways.iter().map(|way| (way.name(), way.figures(bytes_per_page, triangles_per_page, &fio)));
    Ok(PageIoFigures {
        scene: model.scene.clone(),
        seed: options.seed,
        file_bytes: file.superblock().file_bytes,
        page_count: pages.order.len(),
        bytes_per_page,
        triangles_per_page,
        thread_count: around.threads,
        round_count: options.rounds,
        ways: figures.collect(),
    })
}

/// What a round read, and the time that it took: of the wall, and of the processors.
struct Round {
    pages: usize,
    wall: Duration,
    cpu: Duration,
}

impl Way {
    /// All ways at a depth.
    fn all(depth: usize, options: &PageIoOptions) -> Vec<Way> {
        use DirectChoice::{Auto, Off};
        let reads =
            [(IoChoice::Uring, Auto), (IoChoice::Uring, Off), (IoChoice::Pread, Auto), (IoChoice::Mmap, Off)];
        let mut kinds = vec![Kind::Fio];
        kinds.retain(|_| options.fio);
        kinds.extend(MapTouch::ALL.into_iter().filter(|_| options.mapped).map(Kind::Mapped));
        kinds.extend(reads.map(|(io, direct)| Kind::Ours(ReadStage::Raw, io, direct)));
        kinds.push(Kind::Ours(ReadStage::Hashed, IoChoice::Auto, Auto));
        let of_pool = [ReadStage::Traceable, ReadStage::Ready, ReadStage::Waited, ReadStage::WaitedBusy];
        kinds.extend(of_pool.map(|stage| Kind::Ours(stage, IoChoice::Auto, Auto)));
        let way = |kind| Way {
            kind,
            depth,
            rates: Vec::new(),
            cpu_us: Vec::new(),
            latencies: Histogram::new_with_max(LATENCY_MOST_US, 3).expect("three digits"),
            backend: match kind {
                Kind::Mapped(_) => ("a mapping".to_owned(), false),
                _ => ("fio".to_owned(), true),
            },
        };
        kinds.into_iter().map(way).collect()
    }

    /// How it is called in figures.
    fn name(&self) -> String {
        let name = match self.kind {
            Kind::Fio => "fio",
            Kind::Mapped(MapTouch::Faults) => "mapped",
            Kind::Mapped(MapTouch::RandomFaults) => "mapped_random",
            Kind::Mapped(MapTouch::Populate) => "mapped_populate",
            Kind::Ours(ReadStage::Hashed, ..) => "hashed",
            Kind::Ours(ReadStage::Traceable, ..) => "traceable",
            Kind::Ours(ReadStage::Ready, ..) => "ready",
            Kind::Ours(ReadStage::Waited, ..) => "waited",
            Kind::Ours(ReadStage::WaitedBusy, ..) => "waited_busy",
            Kind::Ours(ReadStage::Raw, IoChoice::Mmap, _) => "mmap",
            Kind::Ours(ReadStage::Raw, IoChoice::Pread, _) => "pread",
            Kind::Ours(ReadStage::Raw, _, DirectChoice::Off) => "uring_cached",
            Kind::Ours(ReadStage::Raw, ..) => "uring",
        };
        format!("{name}_{}", self.depth)
    }

    /// Reads all pages once, or waits for some.
    fn round(&mut self, pages: &Pages<'_>, around: &Surroundings) -> anyhow::Result<Round> {
        pages.forget()?;
        let all = pages.order.len();
        let (count, (wall, cpu)) = match self.kind {
            Kind::Fio => (all, fio::read((pages.file.path(), &pages.extents), self.depth, &around.folder)?),
            Kind::Mapped(touch) => (all, mapped::read(pages, touch, (self.depth, around.threads))?),
            Kind::Ours(stage @ (ReadStage::Traceable | ReadStage::Ready), io, direct) => {
                let pool = self.pool(pages, (io, direct), u64::MAX, around)?;
                let clock = Clock::start();
                match stage {
                    ReadStage::Traceable => pool.fetch_blocking(&pages.order)?,
                    _ => unpack::all(&pool, &pages.order, around.threads)?,
                }
                (all, clock.spent())
            }
            Kind::Ours(stage @ (ReadStage::Waited | ReadStage::WaitedBusy), io, direct) => {
                // Room for a part: what is asked for ahead never comes to an end.
                let frames_bytes = (all * FRAME_BYTES / PAGES_A_FRAME) as u64;
                let pool = self.pool(pages, (io, direct), frames_bytes, around)?;
                demand::wait_for_some(&pool, pages, stage == ReadStage::WaitedBusy, &mut self.latencies)?
            }
            Kind::Ours(stage, io, direct) => (all, self.read(pages, (io, direct), stage, around)?),
        };
        Ok(Round { pages: count, wall, cpu })
    }

    fn options(&self, (io, direct): (IoChoice, DirectChoice)) -> IoOptions {
        let pread_threads = self.depth.min(IoOptions::default().pread_threads);
        IoOptions { io, direct, depth: self.depth, pread_threads, connections: 0 }
    }

    /// Through a backend, without a pool.
    fn read(
        &mut self,
        pages: &Pages<'_>,
        choice: (IoChoice, DirectChoice),
        stage: ReadStage,
        around: &Surroundings,
    ) -> anyhow::Result<(Duration, Duration)> {
        let slot_bytes = staging_bytes_for(STORED_BYTES);
        let _lease = around.budget.lease("reads in flight", (self.depth * slot_bytes) as u64)?;
        let mut reader = Reader::new(open(pages.file.path(), &self.options(choice))?, pages.file.path());
        let mut slots = Vec::new();
        for _ in 0..self.depth.min(pages.order.len()) {
            slots.push(StagingBuffer::new(slot_bytes)?);
        }
        let mut begun = vec![Instant::now(); pages.order.len()];
        let (mut next, mut arrivals) = (0, Vec::new());
        let clock = Clock::start();
        while next < pages.order.len() || reader.in_flight() > 0 {
            while next < pages.order.len() && reader.room() > 0 {
                let Some(slot) = slots.pop() else { break };
                begun[next] = Instant::now();
                reader.submit(next as u32, pages.extents[next], slot);
                next += 1;
            }
            reader.complete(Wait::One, &mut arrivals);
            for arrival in arrivals.drain(..) {
                let (place, bytes) = (arrival.tag as usize, arrival.result?);
                let stored = &arrival.staging[bytes];
                let is_sound = stage == ReadStage::Raw || pages.is_sound(place, stored);
                ensure!(is_sound, "page {} is damaged: run trex verify", pages.order[place]);
                self.latencies.saturating_record(begun[place].elapsed().as_micros() as u64);
                slots.push(arrival.staging);
            }
        }
        let spent = clock.spent();
        let described = reader.describe();
        self.backend = (described.backend.clone(), described.direct);
        Ok(spent)
    }

    /// A pool that has room for all pages, or for so many bytes of them, or for what the limit allows.
    fn pool(
        &mut self,
        pages: &Pages<'_>,
        choice: (IoChoice, DirectChoice),
        frames_bytes: u64,
        around: &Surroundings,
    ) -> anyhow::Result<PagePool> {
        let pool_options = PoolOptions {
            io: self.options(choice),
            decode_threads: around.threads.min(trex_store::pool::DECODE_THREADS_MAX),
            ..PoolOptions::default()
        };
        let wanted = frames_bytes.min((pages.file.pages().len() * FRAME_BYTES) as u64);
        let pool = full_pool::open(pages.file, pool_options, wanted, around)?;
        self.backend = (pool.io().backend, pool.io().direct);
        Ok(pool)
    }

    fn figures(&self, bytes: f64, triangles: f64, fio: &[(usize, Vec<f64>)]) -> WayFigures {
        let pages_per_s = median(&self.rates);
        let beside = fio.iter().find(|(depth, _)| *depth == self.depth && self.kind != Kind::Fio);
        let of_fio = beside.map(|(_, rates)| {
            let ratios: Vec<f64> = self.rates.iter().zip(rates).map(|(ours, fio)| ours / fio).collect();
            median(&ratios)
        });
        let at = |share| self.latencies.value_at_quantile(share);
        let latency =
            LatencyFigures { p50: at(0.5), p99: at(0.99), p999: at(0.999), max: self.latencies.max() };
        WayFigures {
            backend: self.backend.0.clone(),
            direct: self.backend.1,
            stage: match self.kind {
                Kind::Ours(stage, ..) => stage,
                Kind::Fio | Kind::Mapped(_) => ReadStage::Raw,
            },
            depth: self.depth,
            pages_per_s,
            bytes_per_s: pages_per_s * bytes,
            triangles_per_s: pages_per_s * triangles,
            cpu_us_per_page: median(&self.cpu_us),
            latency_us: (!self.latencies.is_empty()).then_some(latency),
            of_fio,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trex_store::{Budget, Interrupt};

    #[test]
    fn all_ways_read_all_pages() {
        let folder = tempfile::tempdir().unwrap();
        let around = Surroundings {
            threads: 2,
            budget: Budget::unlimited(),
            folder: folder.path().to_path_buf(),
            interrupt: Interrupt::default(),
        };
        let model = Model::open("gen:isosurface:60k", &around).unwrap();
        let options = PageIoOptions { depths: vec![1, 8], rounds: 2, seed: 1, fio: false, mapped: true };
        let figures = run(&model, &options, &around).unwrap();
        assert_eq!(figures.ways.len(), 24);
        for (name, way) in &figures.ways {
            assert_eq!(
                way.latency_us.is_none(),
                ["ready", "traceable", "mapped"].iter().any(|way| name.starts_with(way)),
                "{name}"
            );
            assert!(way.pages_per_s > 0.0 && way.of_fio.is_none(), "{way:?}");
            // The longest of all, told in whole microseconds, is no shorter than the mean.
            let waits = way.latency_us.map_or(f64::INFINITY, |latency| latency.max as f64);
            assert!(waits + 1.0 >= 1e6 / way.pages_per_s / way.depth as f64, "{way:?}");
        }
        // Beside somebody else's reads, where they can be had.
        let has_fio = std::process::Command::new("fio").arg("--version").output().is_ok();
        if has_fio {
            let beside =
                run(&model, &PageIoOptions { depths: vec![8], fio: true, ..options.clone() }, &around);
            let ways = beside.unwrap().ways;
            assert!(ways.values().any(|way| way.of_fio.is_some_and(|ratio| ratio > 0.0)), "{ways:?}");
        } else {
            let required = std::env::var("TREX_REQUIRE").unwrap_or_default();
            assert!(!required.contains("fio"), "fio is missing, and TREX_REQUIRE names it");
            let said = std::io::Write::write_all(
                &mut std::io::stderr(),
                b"\nNOT RUN: beside fio: it is not installed\n",
            );
            said.unwrap();
        }
        // A page with another byte is found by all that hash.
        let file = PageFile::open(&model.path, &around.budget).unwrap();
        let at = file.pages()[0].offset as usize;
        let mut bytes = std::fs::read(&model.path).unwrap();
        bytes[at] ^= 1;
        let path = folder.path().join("damaged.trex");
        std::fs::write(&path, bytes).unwrap();
        let damaged = Model::open(path.to_str().unwrap(), &around).unwrap();
        assert!(run(&damaged, &options, &around).is_err());
    }
}
