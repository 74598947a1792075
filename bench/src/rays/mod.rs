//! Workload `rays`: how many rays per second, ours and a peer's, on the same mesh with the same rays and threads.
//!
//! ```text
//! file -> resident, or pooled where the limit has no room -> ray sets (`sets`)
//! for each set: one round unmeasured, then rounds in which the contenders (`contender`) take turns
//! figures: medians over the rounds; ratios, by processor time, are medians of the rounds' own ratios
//! closest hits of the peer are compared ray by ray, disagreements settled in f64 (`compare`)
//! ```
//!
//! Invariants: 1. `result_hash` depends on file, resolution and seed alone: not on threads, limit or pages; 2. every
//! round of ours gives the answers of the first.

pub mod compare;
pub mod contender;
pub mod falsehood;
pub mod sets;

pub use contender::{Contender, RayAnswer};
pub use sets::{BenchRay, GraySets, Query, RaySet, RaySets};

use crate::median::median;
use crate::model::{Model, Surroundings};
use anyhow::ensure;
use compare::Agreement;
use contender::{Gray, GrayCalls, GrayWorker, Packets, Pooled, Resident};
use falsehood::AgainstMesh;
use serde::Serialize;
use sets::Space;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;
use trex_render::{AllResident, Camera, Occluders, PagedMesh, PooledPages, Voxels, pooled_tracers};
use trex_store::io::IoOptions;
use trex_store::layout::FRAME_BYTES;
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{Lease, PageFile, Result};
use xxhash_rust::xxh3::Xxh3;

/// What to measure.
#[derive(Clone, Debug)]
pub struct RayOptions {
    /// Width and height of the picture; every pixel gives up to one ray to each set.
    pub resolution: [u32; 2],
    /// Measured rounds, at least 1.
    pub rounds: usize,
    /// Seed of the gather rays.
    pub seed: u64,
    /// How pages are read where they do not all fit.
    pub io: IoOptions,
    /// Whom to compare with.
    pub peer: Option<Peer>,
}

/// Somebody else's ray tracer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Peer {
    /// Intel Embree 3.
    #[cfg(feature = "peer-embree")]
    Embree,
}

/// Figures of a run.
#[derive(Clone, Debug, Serialize)]
pub struct RayFigures {
    /// The model.
    pub scene: String,
    /// Seed of the gather rays.
    pub seed: u64,
    /// Hash of our answers: who is hit by every ray of every set.
    pub result_hash: String,
    /// Triangles of the model.
    pub triangle_count: u64,
    /// Worker threads.
    pub thread_count: usize,
    /// Measured rounds.
    pub round_count: usize,
    /// Width and height.
    pub resolution: [u32; 2],
    /// Our kernel.
    pub arithmetic: String,
    /// `resident` or `pooled`.
    pub pages: String,
    /// Frames and tables that the model takes, or may take, in memory.
    pub resident_bytes: u64,
    /// The same per triangle.
    pub resident_bytes_per_triangle: f64,
    /// From the camera, closest hit; in packets where all pages are in memory.
    pub primary: SetFigures,
    /// Towards a light, any hit; in packets like these.
    pub shadow: SetFigures,
    /// Cosine-distributed, closest hit.
    pub incoherent: SetFigures,
    /// Leaves of the voxels along the model's longest side; `None` for a file without, or where they did not fit.
    pub voxel_resolution: Option<u32>,
    /// The same through the voxels, in batches, against the peer's rays on the mesh; `None` for a file without voxels.
    pub gray: Option<SetFigures>,
    /// Shadow rays through the voxels.
    pub gray_shadow: Option<SetFigures>,
    /// The peer, where one was asked for.
    pub peer: Option<PeerFigures>,
}

/// Figures of a set.
#[derive(Clone, Debug, Serialize)]
pub struct SetFigures {
    /// Rays.
    pub ray_count: usize,
    /// Of these, with a hit.
    pub hit_count: usize,
    /// Rays per second of wall time, median.
    pub per_s: f64,
    /// Rays per second of processor time, median: what one core does when it is not shared.
    pub per_core_s: f64,
    /// Ours over the peer's reference mode, by processor time.
    pub ratio: Option<f64>,
    /// Of rays that go in packets or batches: the same rays one by one.
    pub single: Option<SingleFigures>,
    /// How often voxels answered falsely; `None` for sets that ask the mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub against_mesh: Option<AgainstMesh>,
}

/// Rays one by one.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SingleFigures {
    /// Rays per second of wall time, median.
    pub per_s: f64,
    /// Rays per second of processor time, median.
    pub per_core_s: f64,
}

/// Figures of a peer.
#[derive(Clone, Debug, Serialize)]
pub struct PeerFigures {
    /// Name.
    pub name: String,
    /// Version.
    pub version: String,
    /// Primary rays, ours (in packets where they go so) over its reference mode.
    pub ratio: f64,
    /// The mode that `ratio` and the sets' ratios refer to.
    pub reference: String,
    /// Its mesh: positions and indices, bytes.
    pub mesh_bytes: u64,
    /// Every mode: key is the mode's name.
    pub mode: BTreeMap<String, ModeFigures>,
    /// Closest hits against the reference mode, primary and incoherent together.
    pub closest: Agreement,
    /// Shadow rays whose answers differ.
    pub shadow_difference_count: usize,
}

/// Figures of one mode of a peer.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ModeFigures {
    /// Its tree as its own memory monitor counts it.
    pub tree_bytes: u64,
    /// Tree per triangle.
    pub tree_bytes_per_triangle: f64,
    /// Tree and mesh over our resident bytes.
    pub memory_ratio: f64,
    /// Time of its build.
    pub build_ms: f64,
    /// Per set: rays per second, and ours over it.
    #[serde(flatten)]
    pub sets: BTreeMap<&'static str, ModeSet>,
}

/// A mode's speed on a set.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ModeSet {
    /// Rays per second of wall time, median.
    pub per_s: f64,
    /// Rays per second of processor time, median.
    pub per_core_s: f64,
    /// Ours over it by processor time, median of the rounds' own ratios.
    pub ratio: f64,
    /// The same of our rays one by one, where `ratio` is of packets or batches.
    pub single_ratio: Option<f64>,
    /// `ratio` by wall time.
    pub wall_ratio: f64,
}

/// A peer set up on our mesh: its modes as contenders.
pub(crate) struct PeerSetup {
    pub(crate) name: String,
    pub(crate) version: String,
    pub(crate) reference: String,
    pub(crate) mesh_bytes: u64,
    pub(crate) modes: Vec<(Box<dyn Contender>, ModeFigures)>,
}

/// Measures `model`.
///
/// # Errors
/// The file or its pages cannot be read; the limit has no room; the peer cannot be set up.
pub fn run(model: &Model, options: &RayOptions, around: &Surroundings) -> anyhow::Result<RayFigures> {
    ensure!(options.rounds > 0, "a median takes a round");
    let budget = &around.budget;
    let file = Arc::new(PageFile::open(&model.path, budget)?);
    let pixels = u64::from(options.resolution[0]) * u64::from(options.resolution[1]);
    let _rays_lease = budget.lease("the rays", pixels * sets::BYTES_PER_PIXEL)?;
    let space = Space::of(file.superblock());

    let frames_bytes = (file.pages().len() * FRAME_BYTES) as u64;
    if let Ok(_pages_lease) = budget.lease("all pages", frames_bytes) {
        let pages = AllResident::load(&file);
        let voxels = Voxels::open(&file, budget)?;
        let tracers = || (0..around.threads).map(|_| PagedMesh::new(&file, &pages));
        let mut ours = Resident { space, workers: tracers().collect() };
        let mut packets = Packets::new(space, tracers());
        let scene = voxels.as_ref().map(|voxels| voxels.scene(Occluders::On));
        let mut gray = scene.map(|scene| {
            [GrayCalls::Batch, GrayCalls::Single].map(|calls| {
                let workers = vec![GrayWorker::default(); around.threads];
                Gray { space, scene, calls, workers }
            })
        });
        let clearance =
            scene.map(|scene| scene.clearance([1.0, 0.0, 0.0]) / file.superblock().lattice.step());
        let sets = make_sets(&file, model, options, clearance, |ray| ours.hit(ray))?;
        let mut figures =
            compete((&mut ours, Some(&mut packets), gray.as_mut()), &sets, &file, options, around)?;
        if let (Some(gray), Some(rays)) = (&mut gray, &sets.gray) {
            let sets = [(&mut figures.gray, &rays.gather), (&mut figures.gray_shadow, &rays.shadow)];
            for (figures, set) in sets {
                let against = falsehood::against(&mut ours, &mut gray[0], set);
                figures.iter_mut().for_each(|figures| figures.against_mesh = Some(against));
            }
        }
        figures.voxel_resolution = file.upper_size()?.map(|size| size.resolution);
        figures.pages = "resident".to_owned();
        figures.scene.clone_from(&model.scene);
        return Ok(figures);
    }
    ensure!(
        options.peer.is_none(),
        "a peer takes all of the mesh in memory, and the limit has no room for ours"
    );
    let (pool, _pins_lease) = open_pool(&file, options, around)?;
    let mut ours = Pooled { space, workers: pooled_tracers(&file, &pool, around.threads) };
    let sets = make_sets(&file, model, options, None, |ray| ours.hit(ray))?;
    let mut figures = compete((&mut ours, None, None), &sets, &file, options, around)?;
    figures.pages = "pooled".to_owned();
    figures.scene.clone_from(&model.scene);
    figures.resident_bytes = file.resident_table_bytes() + (pool.frames().frames * FRAME_BYTES) as u64;
    figures.resident_bytes_per_triangle = figures.resident_bytes as f64 / figures.triangle_count as f64;
    Ok(figures)
}

/// A pool with all frames that the limit has room for.
fn open_pool(file: &Arc<PageFile>, options: &RayOptions, around: &Surroundings) -> Result<(PagePool, Lease)> {
    let budget = &around.budget;
    let defaults = PoolOptions {
        io: options.io.clone(),
        staging_slots: 8,
        merge_bytes: 128 << 10,
        ..PoolOptions::default()
    };
    let (overhead, smallest) = PagePool::smallest_bytes(&**file, &defaults)?;
    let pins = PooledPages::bytes(file.pages().len(), file.pages().len()) * around.threads as u64;
    let lease = budget.lease("the pins of the workers", pins)?;
    let frames_bytes = budget.free_bytes().saturating_sub(overhead).max(smallest - overhead);
    let pool_options = PoolOptions { frames_bytes, ..defaults };
    Ok((PagePool::open(file.clone(), file.path(), budget, &pool_options)?, lease))
}

fn make_sets(
    file: &PageFile,
    model: &Model,
    options: &RayOptions,
    clearance: Option<f64>,
    mut hit: impl FnMut(&BenchRay) -> Option<trex_render::Hit>,
) -> anyhow::Result<RaySets> {
    let (block, space) = (file.superblock(), Space::of(file.superblock()));
    let camera = model.view.unwrap_or_else(|| Camera::framing(&block.bounds, options.resolution, None, None));
    let primary = sets::primary(space, &camera, options.resolution)?;
    let points: Vec<_> =
        primary.rays.iter().filter_map(|ray| Some(sets::visible(space, ray, &hit(ray)?))).collect();
    ensure!(!points.is_empty(), "the camera sees nothing of {}", model.scene);
    let shadow = sets::shadow(space, block, &points);
    let incoherent = sets::incoherent(&points, options.seed);
    let gray = clearance.map(|clearance| {
        let points: Vec<_> = points.iter().map(|point| sets::lifted(point, clearance)).collect();
        let (gather, shadow) = (sets::incoherent(&points, options.seed), sets::shadow(space, block, &points));
        GraySets { gather, shadow }
    });
    Ok(RaySets { primary, shadow, incoherent, gray })
}

/// Times all contenders on all sets.
fn compete(
    (ours, packets, gray): (&mut dyn Contender, Option<&mut Packets<'_>>, Option<&mut [Gray<'_>; 2]>),
    sets: &RaySets,
    file: &PageFile,
    options: &RayOptions,
    around: &Surroundings,
) -> anyhow::Result<RayFigures> {
    let block = file.superblock();
    let resident_bytes = file.resident_table_bytes() + (file.pages().len() * FRAME_BYTES) as u64;
    let mut peer = options.peer.map(|peer| set_up(peer, file, around)).transpose()?;
    let mut hash = Xxh3::new();
    let mut agreement = Agreement::default();
    let mut shadow_difference_count = 0;
    let mut measure = |name: &'static str, ours: Ours<'_>, set: &RaySet| -> anyhow::Result<SetFigures> {
        around.interrupt.check()?;
        let turn = take_turns(ours, peer.as_mut(), set, options.rounds);
        turn.ours.iter().for_each(|answer| hash.update(&answer.triangle.to_le_bytes()));
        let mut ratio = None;
        if let Some(peer) = &mut peer {
            for ((contender, figures), speed) in peer.modes.iter_mut().zip(&turn.modes) {
                figures.sets.insert(name, *speed);
                if contender.label() == peer.reference {
                    ratio = Some(speed.ratio);
                }
            }
            match set.query {
                // Voxels are not the mesh: how far they lie is no matter of speed.
                _ if name.starts_with("gray") => {}
                Query::Closest => agreement.add(&compare::closest(file, set, &turn.ours, &turn.reference)),
                Query::Any => {
                    let both = turn.ours.iter().zip(&turn.reference);
                    shadow_difference_count += both.filter(|(a, b)| a.is_hit() != b.is_hit()).count();
                }
            }
        }
        let hit_count = turn.ours.iter().filter(|answer| answer.is_hit()).count();
        Ok(SetFigures {
            ray_count: set.rays.len(),
            hit_count,
            per_s: turn.per_s,
            per_core_s: turn.per_core_s,
            ratio,
            single: turn.single,
            against_mesh: None,
        })
    };
    let (primary, shadow) = match packets {
        Some(packets) => {
            let both = Ours { contender: packets, single: Some(ours) };
            let primary = measure("primary", both, &sets.primary)?;
            let both = Ours { contender: packets, single: Some(ours) };
            (primary, measure("shadow", both, &sets.shadow)?)
        }
        None => {
            let primary = measure("primary", Ours::of(ours), &sets.primary)?;
            (primary, measure("shadow", Ours::of(ours), &sets.shadow)?)
        }
    };
    let incoherent = measure("incoherent", Ours::of(ours), &sets.incoherent)?;
    let (mut gray_gather, mut gray_shadow) = (None, None);
    if let (Some([batch, single]), Some(sets)) = (gray, &sets.gray) {
        let ours = Ours { contender: batch, single: Some(single) };
        gray_gather = Some(measure("gray", ours, &sets.gather)?);
        let ours = Ours { contender: batch, single: Some(single) };
        gray_shadow = Some(measure("gray_shadow", ours, &sets.shadow)?);
    }
    let peer = peer.map(|peer| PeerFigures {
        name: peer.name,
        version: peer.version,
        ratio: primary.ratio.unwrap_or(f64::NAN),
        reference: peer.reference,
        mesh_bytes: peer.mesh_bytes,
        mode: peer
            .modes
            .into_iter()
            .map(|(contender, mut figures)| {
                figures.tree_bytes_per_triangle = figures.tree_bytes as f64 / block.triangle_count as f64;
                figures.memory_ratio = (figures.tree_bytes + peer.mesh_bytes) as f64 / resident_bytes as f64;
                (contender.label().to_owned(), figures)
            })
            .collect(),
        closest: agreement,
        shadow_difference_count,
    });
    Ok(RayFigures {
        scene: String::new(),
        seed: options.seed,
        result_hash: format!("{:016x}", hash.digest()),
        triangle_count: block.triangle_count,
        thread_count: around.threads,
        round_count: options.rounds,
        resolution: options.resolution,
        arithmetic: trex_render::Arithmetic::for_file(file).name().to_owned(),
        pages: String::new(),
        resident_bytes,
        resident_bytes_per_triangle: resident_bytes as f64 / block.triangle_count as f64,
        primary,
        shadow,
        incoherent,
        voxel_resolution: None,
        gray: gray_gather,
        gray_shadow,
        peer,
    })
}

/// Ours, and where it takes batches, the same for single rays.
struct Ours<'a> {
    contender: &'a mut dyn Contender,
    single: Option<&'a mut dyn Contender>,
}

impl<'a> Ours<'a> {
    fn of(contender: &'a mut dyn Contender) -> Ours<'a> {
        Ours { contender, single: None }
    }
}

/// What the rounds on one set gave.
struct Turns {
    per_s: f64,
    per_core_s: f64,
    single: Option<SingleFigures>,
    modes: Vec<ModeSet>,
    ours: Vec<RayAnswer>,
    /// Answers of the peer's reference mode.
    reference: Vec<RayAnswer>,
}

/// One round to warm up, then measured rounds; in each, ours and every mode in turn.
fn take_turns(ours: Ours<'_>, mut peer: Option<&mut PeerSetup>, set: &RaySet, rounds: usize) -> Turns {
    let Ours { contender: ours, mut single } = ours;
    let mode_count = peer.as_ref().map_or(0, |peer| peer.modes.len());
    let mut first = vec![RayAnswer::NONE; set.rays.len()];
    let mut answers = first.clone();
    let mut reference = Vec::new();
    let mut our_speeds = Vec::with_capacity(rounds);
    let mut single_speeds = Vec::with_capacity(rounds);
    let mut mode_speeds = vec![Vec::with_capacity(rounds); mode_count];
    ours.trace(set, &mut first);
    for round in 0..=rounds {
        let speed = timed(ours, set, &mut answers);
        assert!(answers == first, "a round gave other answers than the first");
        if round > 0 {
            our_speeds.push(speed);
        }
        if let Some(single) = &mut single {
            let speed = timed(&mut **single, set, &mut answers);
            assert!(answers == first, "single rays have other answers than batches");
            if round > 0 {
                single_speeds.push(speed);
            }
        }
        let Some(peer) = &mut peer else { continue };
        for ((mode, _), speeds) in peer.modes.iter_mut().zip(&mut mode_speeds) {
            let speed = timed(&mut **mode, set, &mut answers);
            if round > 0 {
                speeds.push(speed);
            } else if mode.label() == peer.reference {
                reference.clone_from(&answers);
            }
        }
    }
    let modes = mode_speeds.iter().map(|speeds| ModeSet {
        per_s: middle(speeds, |speed| speed.wall),
        per_core_s: middle(speeds, |speed| speed.core),
        ratio: median(&our_speeds.iter().zip(speeds).map(|(a, b)| a.core / b.core).collect::<Vec<_>>()),
        single_ratio: single.is_some().then(|| {
            median(&single_speeds.iter().zip(speeds).map(|(a, b)| a.core / b.core).collect::<Vec<_>>())
        }),
        wall_ratio: median(&our_speeds.iter().zip(speeds).map(|(a, b)| a.wall / b.wall).collect::<Vec<_>>()),
    });
    Turns {
        per_s: middle(&our_speeds, |speed| speed.wall),
        per_core_s: middle(&our_speeds, |speed| speed.core),
        single: single.is_some().then(|| SingleFigures {
            per_s: middle(&single_speeds, |speed| speed.wall),
            per_core_s: middle(&single_speeds, |speed| speed.core),
        }),
        modes: modes.collect(),
        ours: first,
        reference,
    }
}

/// Rays per second of one round.
#[derive(Clone, Copy)]
struct Speed {
    /// Of wall time.
    wall: f64,
    /// Of processor time.
    core: f64,
}

fn middle(speeds: &[Speed], of: fn(&Speed) -> f64) -> f64 {
    median(&speeds.iter().map(of).collect::<Vec<_>>())
}

/// The speed of one trace of the set.
fn timed(contender: &mut dyn Contender, set: &RaySet, answers: &mut [RayAnswer]) -> Speed {
    let start = Instant::now();
    let used = contender.trace(set, answers);
    let rays = set.rays.len() as f64;
    Speed { wall: rays / start.elapsed().as_secs_f64(), core: rays / used.as_secs_f64().max(1e-9) }
}

#[cfg(feature = "peer-embree")]
fn set_up(peer: Peer, file: &PageFile, around: &Surroundings) -> anyhow::Result<PeerSetup> {
    match peer {
        Peer::Embree => crate::peers::embree::set_up(file, around.threads),
    }
}

#[cfg(not(feature = "peer-embree"))]
fn set_up(peer: Peer, _: &PageFile, _: &Surroundings) -> anyhow::Result<PeerSetup> {
    match peer {}
}
