//! A run of `rays`: sets made, contenders set up, turns taken, figures drawn.

use super::compare::{self, Agreement};
use super::contender::{Contender, Packets, PooledContender, RayAnswer, Resident};
use super::device;
use super::falsehood;
use super::figures::{PeerFigures, RayFigures, SetFigures};
use super::gray::{Gray, GrayCalls, GrayScene};
use super::options::{Peer, RayOptions};
use super::peer::PeerSetup;
use super::sets::{self, BenchRay, GraySets, Query, RaySet, RaySets, Space, Visible};
use super::turns::{OwnContender, Turns, take_turns};
use super::visits;
use crate::full_pool;
use crate::model::{Model, Surroundings};
use anyhow::ensure;
use std::sync::Arc;
use trex_render::{
    AllResident, Arithmetic, Camera, Hit, Occluders, PagedMesh, PooledPages, Voxels, pooled_tracers,
};
use trex_store::layout::FRAME_BYTES;
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{AttributeSet, Lease, PageFile, Result};
use xxhash_rust::xxh3::Xxh3;

/// Bytes of a pixel's rays and of the answers to a set.
const BYTES_PER_PIXEL: u64 =
    (6 * size_of::<BenchRay>() + 2 * size_of::<RayAnswer>() + 3 * size_of::<Visible>()) as u64;

/// Measures `model`.
///
/// # Errors
/// The file or its pages cannot be read; the limit has no room; the peer cannot be set up.
pub fn run(model: &Model, options: &RayOptions, around: &Surroundings) -> anyhow::Result<RayFigures> {
    ensure!(options.rounds > 0, "a median takes a round");
    let budget = &around.budget;
    let file = Arc::new(PageFile::open(&model.path, budget)?);
    let pixels = u64::from(options.resolution[0]) * u64::from(options.resolution[1]);
    let _rays_lease = budget.lease("the rays", pixels * BYTES_PER_PIXEL)?;
    let space = Space::new(file.superblock());

    let frames_bytes = (file.pages().len() * FRAME_BYTES) as u64;
    if let Ok(_pages_lease) = budget.lease("all pages", frames_bytes) {
        let pages = AllResident::load(&file);
        let voxels = Voxels::open(&file, budget)?.map(Arc::new);
        let tracers = || (0..around.threads).map(|_| PagedMesh::new(&file, &pages));
        let mut ours = Resident { space, shades: false, workers: tracers().collect() };
        let mut packets = Packets::new(space, tracers());
        let upper = voxels.as_ref().map(|voxels| GrayScene::Upper(voxels.scene(Occluders::On)));
        let finest = voxels.as_ref().and_then(|voxels| voxels.lower_scene(Occluders::On));
        let finest = finest.map(|scene| GrayScene::Finest(scene, &pages));
        let both_calls = |scene| {
            [GrayCalls::Batch, GrayCalls::Single].map(|calls| Gray::new(space, scene, calls, around.threads))
        };
        let (mut gray, mut finest_gray) = (upper.map(both_calls), finest.map(both_calls));
        let scenes = [upper, finest].map(|scene| scene.map(|scene| scene.clearance()));
        let sets = make_sets(&file, model, options, scenes, |ray| ours.hit(ray))?;
        let ours_all = Contenders {
            single: &mut ours,
            packets: Some(&mut packets),
            gray: [gray.as_mut(), finest_gray.as_mut()],
        };
        let mut figures = compete(ours_all, &sets, &file, options, around)?;
        let [of_upper, of_finest] = &sets.gray;
        for (gray, rays, [gather, shadow]) in [
            (&mut gray, of_upper, [&mut figures.gray, &mut figures.gray_shadow]),
            (&mut finest_gray, of_finest, [&mut figures.gray_finest, &mut figures.gray_finest_shadow]),
        ] {
            let (Some(gray), Some(rays)) = (gray, rays) else { continue };
            for (figures, set) in [(gather, &rays.gather), (shadow, &rays.shadow)] {
                let against = falsehood::against(&mut ours, &mut gray[0], set);
                figures.iter_mut().for_each(|figures| figures.against_mesh = Some(against));
            }
        }
        let octree = voxels.as_ref().map(|voxels| (voxels, &pages));
        figures.device = device::measure((&file, octree), (space, &sets.gray), (options, around))?;
        let upper = file.upper_size()?;
        figures.voxel_resolution = upper.map(|size| size.resolution);
        if let (Some(upper), Some(lower)) = (upper, file.lower_size()?) {
            figures.finest_resolution = Some(upper.resolution * lower.refinement.factor());
        }
        if options.stats {
            let _lease = budget.lease("two trees of boxes", visits::bytes(figures.triangle_count))?;
            figures.visits =
                Some(visits::visits(&file, &pages, [&sets.primary, &sets.shadow, &sets.incoherent])?);
        }
        figures.pages = "resident".to_owned();
        figures.scene.clone_from(&model.scene);
        return Ok(figures);
    }
    ensure!(!options.stats, "visits are counted with all pages in memory, for which the limit has no room");
    ensure!(
        options.device.is_none(),
        "a device is measured with all pages in memory, for which the limit has no room"
    );
    ensure!(
        options.peer.is_none(),
        "a peer takes all of the mesh in memory, and the limit has no room for ours"
    );
    let (pool, _pins_lease) = open_pool(&file, options, around)?;
    let workers = pooled_tracers(&file, &pool, around.threads);
    let mut ours = PooledContender { space, shades: false, workers };
    let sets = make_sets(&file, model, options, [None; 2], |ray| ours.hit(ray))?;
    let ours_all = Contenders { single: &mut ours, packets: None, gray: [None, None] };
    let mut figures = compete(ours_all, &sets, &file, options, around)?;
    figures.pages = "pooled".to_owned();
    figures.scene.clone_from(&model.scene);
    figures.resident_bytes = resident_bytes(&file, pool.frames().frames);
    figures.resident_bytes_per_triangle = figures.resident_bytes as f64 / figures.triangle_count as f64;
    Ok(figures)
}

/// A pool with all frames that the limit has room for.
fn open_pool(
    file: &Arc<PageFile>,
    options: &RayOptions,
    around: &Surroundings,
) -> Result<(Arc<PagePool>, Lease)> {
    let pins = PooledPages::bytes(file.pages().len(), file.pages().len()) * around.threads as u64;
    let lease = around.budget.lease("the pins of the workers", pins)?;
    let pool_options = PoolOptions {
        io: options.io.clone(),
        staging_slots: 8,
        merge_bytes: 128 << 10,
        ..PoolOptions::default()
    };
    Ok((Arc::new(full_pool::open(file, pool_options, u64::MAX, around)?), lease))
}

fn make_sets(
    file: &PageFile,
    model: &Model,
    options: &RayOptions,
    clearances: [Option<f64>; 2],
    mut hit: impl FnMut(&BenchRay) -> Option<Hit>,
) -> anyhow::Result<RaySets> {
    let (block, space) = (file.superblock(), Space::new(file.superblock()));
    let camera = model.view.unwrap_or_else(|| Camera::framing(&block.bounds, options.resolution, None, None));
    let primary = sets::primary(space, &camera, options.resolution)?;
    let points: Vec<_> =
        primary.rays.iter().filter_map(|ray| Some(sets::visible(space, ray, &hit(ray)?))).collect();
    ensure!(!points.is_empty(), "the camera sees nothing of {}", model.scene);
    let shadow = sets::shadow(space, block, &points);
    let incoherent = sets::incoherent(&points, options.seed);
    let gray = clearances.map(|clearance| {
        let clearance = clearance? / block.lattice.step();
        let points: Vec<_> = points.iter().map(|point| sets::lifted(point, clearance)).collect();
        let (gather, shadow) = (sets::incoherent(&points, options.seed), sets::shadow(space, block, &points));
        Some(GraySets { gather, shadow, points })
    });
    Ok(RaySets { primary, shadow, incoherent, gray })
}

/// Ours, in the ways that rays can go.
struct Contenders<'a, 'p> {
    single: &'a mut dyn Contender,
    packets: Option<&'a mut Packets<'p>>,
    /// Through the voxels, those of the upper octree and the finest: in batches, and one by one.
    gray: [Option<&'a mut [Gray<'p>; 2]>; 2],
}

/// What comes of set after set.
struct Score<'a> {
    file: &'a PageFile,
    options: &'a RayOptions,
    around: &'a Surroundings,
    peer: Option<PeerSetup>,
    /// Of our answers.
    hash: Xxh3,
    agreement: Agreement,
    shadow_difference_count: usize,
}

/// Times all contenders on all sets.
fn compete(
    ours: Contenders<'_, '_>,
    sets: &RaySets,
    file: &PageFile,
    options: &RayOptions,
    around: &Surroundings,
) -> anyhow::Result<RayFigures> {
    let peer = options.peer.map(|peer| set_up(peer, file, around)).transpose()?;
    let (hash, agreement) = (Xxh3::new(), Agreement::default());
    let mut score = Score { file, options, around, peer, hash, agreement, shadow_difference_count: 0 };

    // Rays that go much the same way: in packets where there are any.
    let Contenders { single, mut packets, gray } = ours;
    let primary = score.measure("primary", coherent(single, &mut packets), &sets.primary)?;
    let shadow = score.measure("shadow", coherent(single, &mut packets), &sets.shadow)?;
    let incoherent = score.measure("incoherent", OwnContender::alone(single), &sets.incoherent)?;
    let shaded = match file.superblock().attributes() == AttributeSet::default() {
        true => None,
        false => Some(score.measure_shaded((single, &mut packets), sets)?),
    };
    let (primary_shaded, incoherent_shaded) = shaded.unzip();

    // Rays through the voxels.
    let mut through_voxels = [None, None, None, None];
    let names = [["gray", "gray_shadow"], ["gray_finest", "gray_finest_shadow"]];
    for (at, (gray, sets)) in gray.into_iter().zip(&sets.gray).enumerate() {
        let (Some([batch, single]), Some(sets)) = (gray, sets) else { continue };
        for (kind, set) in [&sets.gather, &sets.shadow].into_iter().enumerate() {
            let ours = OwnContender { contender: batch, single: Some(single) };
            through_voxels[2 * at + kind] = Some(score.measure(names[at][kind], ours, set)?);
        }
    }
    let [gray, gray_shadow, gray_finest, gray_finest_shadow] = through_voxels;

    let resident_bytes = resident_bytes(file, file.pages().len());
    let triangle_count = file.superblock().triangle_count;
    let result_hash = format!("{:016x}", score.hash.digest());
    Ok(RayFigures {
        scene: String::new(),
        seed: options.seed,
        result_hash,
        triangle_count,
        thread_count: around.threads,
        round_count: options.rounds,
        resolution: options.resolution,
        arithmetic: Arithmetic::for_file(file).name().to_owned(),
        pages: String::new(),
        resident_bytes,
        resident_bytes_per_triangle: resident_bytes as f64 / triangle_count as f64,
        peer: score.into_peer(resident_bytes, primary.ratio),
        primary,
        shadow,
        incoherent,
        primary_shaded,
        incoherent_shaded,
        device: None,
        visits: None,
        voxel_resolution: None,
        gray,
        gray_shadow,
        finest_resolution: None,
        gray_finest,
        gray_finest_shadow,
    })
}

/// Ours for rays that go much the same way: in packets where there are any.
fn coherent<'a>(
    single: &'a mut dyn Contender,
    packets: &'a mut Option<&mut Packets<'_>>,
) -> OwnContender<'a> {
    match packets {
        Some(packets) => OwnContender { contender: &mut **packets, single: Some(single) },
        None => OwnContender::alone(single),
    }
}

/// What tables and so many frames take.
fn resident_bytes(file: &PageFile, frame_count: usize) -> u64 {
    file.resident_table_bytes() + (frame_count * FRAME_BYTES) as u64
}

impl Score<'_> {
    /// Times all contenders on one set, and compares what they answered.
    fn measure(
        &mut self,
        name: &'static str,
        ours: OwnContender<'_>,
        set: &RaySet,
    ) -> anyhow::Result<SetFigures> {
        self.around.interrupt.check()?;
        let turn = take_turns(ours, self.peer.as_mut(), set, self.options.rounds);
        turn.ours.iter().for_each(|answer| self.hash.update(&answer.triangle.to_le_bytes()));
        let ratio = self.learn(name, &turn);
        // Voxels are not the mesh: how far they lie is no matter of speed.
        if self.peer.is_some() && !name.starts_with("gray") {
            self.compare(set, &turn);
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
    }

    /// Times ours where hits are shaded, too: primary and incoherent rays.
    fn measure_shaded(
        &mut self,
        (single, packets): (&mut dyn Contender, &mut Option<&mut Packets<'_>>),
        sets: &RaySets,
    ) -> anyhow::Result<(SetFigures, SetFigures)> {
        let peer = self.peer.take();
        single.shade(true);
        packets.iter_mut().for_each(|packets| packets.shade(true));
        let primary = self.measure("primary_shaded", coherent(single, packets), &sets.primary)?;
        let incoherent = self.measure("incoherent_shaded", OwnContender::alone(single), &sets.incoherent)?;
        single.shade(false);
        packets.iter_mut().for_each(|packets| packets.shade(false));
        self.peer = peer;
        Ok((primary, incoherent))
    }

    /// Keeps the speeds of the peer's modes; ours over its reference mode.
    fn learn(&mut self, name: &'static str, turn: &Turns) -> Option<f64> {
        let peer = self.peer.as_mut()?;
        let mut ratio = None;
        for ((contender, figures), speed) in peer.modes.iter_mut().zip(&turn.modes) {
            figures.sets.insert(name, *speed);
            if contender.label() == peer.reference {
                ratio = Some(speed.ratio);
            }
        }
        ratio
    }

    /// Counts where the peer answers otherwise.
    fn compare(&mut self, set: &RaySet, turn: &Turns) {
        match set.query {
            Query::Closest => {
                self.agreement.add(&compare::closest(self.file, set, &turn.ours, &turn.reference));
            }
            Query::Any => {
                let both = turn.ours.iter().zip(&turn.reference);
                self.shadow_difference_count += both.filter(|(a, b)| a.is_hit() != b.is_hit()).count();
            }
        }
    }

    /// The figures of the peer, where there is one.
    fn into_peer(self, resident_bytes: u64, primary_ratio: Option<f64>) -> Option<PeerFigures> {
        let triangle_count = self.file.superblock().triangle_count as f64;
        let PeerSetup { name, version, reference, mesh_bytes, modes } = self.peer?;
        let mode = modes.into_iter().map(|(contender, mut figures)| {
            figures.tree_bytes_per_triangle = figures.tree_bytes as f64 / triangle_count;
            figures.memory_ratio = (figures.tree_bytes + mesh_bytes) as f64 / resident_bytes as f64;
            (contender.label().to_owned(), figures)
        });
        Some(PeerFigures {
            ratio: primary_ratio.unwrap_or(f64::NAN),
            mode: mode.collect(),
            closest: self.agreement,
            shadow_difference_count: self.shadow_difference_count,
            name,
            version,
            reference,
            mesh_bytes,
        })
    }
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
