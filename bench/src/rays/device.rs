//! Rays through the voxels as the renderer hands them to a device: the sets of gather and shadow rays, and mixes of
//! both, in calls as large as its stage asks for, by all threads, each with as many calls under way as the stage wants.
//! In turn with it, the processor's stage in lanes, and its scalar walk, on the same calls.
//!
//! Times are those from the first call to the last answer, rays made before. Answers are compared with the processor's.
//!
//! Invariants: 1. each round asks the same rays, and the first is not measured: units are on the device by then if they
//! fit; 2. steps are counted by a stage of its own, so that no count is in what is timed.

use super::device_course::{AskedRays, DeviceCourse, DeviceSetFigures};
use super::options::RayOptions;
use super::sets::{self, BenchRay, GraySets, Query, RayMix, RaySet, Space};
use crate::model::Surroundings;
use serde::Serialize;
use std::sync::Arc;
use trex_model::{DeviceReport, StageSource};
use trex_render::{AllResident, GKind, GUnits, MissingUnits, Ray, Voxels};
use trex_store::PageFile;
use trex_store::layout::Superblock;

/// Sets of each octree: gather, shadow, mixes.
const SETS: usize = 2 + RayMix::ALL.len();

/// Figures of a device.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceFigures {
    /// The device, and what went to it in all rounds.
    #[serde(flatten)]
    pub report: DeviceReport,
    /// Rays of a call.
    pub call_ray_count: usize,
    /// Gather rays through the upper octree.
    pub gather: DeviceSetFigures,
    /// Shadow rays through it.
    pub shadow: DeviceSetFigures,
    /// Both, as points of a picture ask them.
    pub mixes: Vec<MixFigures>,
    /// Gather rays through units; `None` for a file without.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub finest_gather: Option<DeviceSetFigures>,
    /// Shadow rays through units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub finest_shadow: Option<DeviceSetFigures>,
    /// Both through units.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub finest_mixes: Vec<MixFigures>,
}

/// Figures of shadow and gather rays together.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct MixFigures {
    /// Shadow rays of a point.
    pub n_shadow: u32,
    /// Gather rays of a point.
    pub n_gather: u32,
    /// Figures of all.
    #[serde(flatten)]
    pub set: DeviceSetFigures,
}

/// The rays that are asked: sets of the upper octree, then of units where there are any.
struct RaySource<'a> {
    space: Space,
    block: &'a Superblock,
    seed: u64,
    octrees: Vec<(&'a GraySets, GUnits)>,
}

/// Measures the device that is asked for, if one is, on the sets through the upper octree and through units.
///
/// # Errors
/// The device cannot be used, or has no room for the octree.
pub(super) fn measure(
    (file, octree): (&PageFile, Option<(&Arc<Voxels>, &AllResident)>),
    (space, sets): (Space, &[Option<GraySets>; 2]),
    (options, around): (&RayOptions, &Surroundings),
) -> anyhow::Result<Option<DeviceFigures>> {
    let (Some(device), Some((voxels, pages))) = (&options.device, octree) else { return Ok(None) };
    let source = StageSource::open(device, &around.budget)?;
    let units = [GUnits::None, GUnits::On(MissingUnits::Block)];
    let octrees = sets.iter().zip(units).filter_map(|(sets, units)| Some((sets.as_ref()?, units)));
    let rays = RaySource { space, block: file.superblock(), seed: options.seed, octrees: octrees.collect() };
    let (threads, rounds) = (around.threads, options.rounds);
    let course = DeviceCourse { source: &source, voxels, pages, threads, rounds };

    let mut stages = course.stages()?;
    let call_ray_count = stages.call_rays();
    let mut figures = rays.each(around, |asked| course.run(&mut stages, &asked))?;
    let report = source.report();
    // One octree at a time is on the device.
    drop(stages);
    if report.gpu.is_some() {
        let mut counting = source.counting_stage()?;
        counting.set_octree(voxels)?;
        let steps = rays.each(around, |asked| course.steps_per_ray(&*counting, &asked))?;
        figures.iter_mut().zip(steps).for_each(|(figures, steps)| figures.steps_per_ray = Some(steps));
    }

    let mut octrees = figures.chunks_exact(SETS).map(|sets| {
        let mixes = RayMix::ALL.into_iter().zip(&sets[2..]);
        let mix = |(RayMix { n_shadow, n_gather }, &set)| MixFigures { n_shadow, n_gather, set };
        (sets[0], sets[1], mixes.map(mix).collect())
    });
    let Some((gather, shadow, mixes)) = octrees.next() else { return Ok(None) };
    let (finest_gather, finest_shadow, finest_mixes) = match octrees.next() {
        Some((gather, shadow, mixes)) => (Some(gather), Some(shadow), mixes),
        None => (None, None, Vec::new()),
    };
    Ok(Some(DeviceFigures {
        report,
        call_ray_count,
        gather,
        shadow,
        mixes,
        finest_gather,
        finest_shadow,
        finest_mixes,
    }))
}

impl RaySource<'_> {
    /// Does `work` on each set, whose rays are made then.
    fn each<T>(&self, around: &Surroundings, mut work: impl FnMut(AskedRays) -> T) -> anyhow::Result<Vec<T>> {
        let mut done = Vec::with_capacity(SETS * self.octrees.len());
        for &(sets, units) in &self.octrees {
            let bytes = (AskedRays::RAY_BYTES * sets.points.len()) as u64;
            let _lease = around.budget.lease("the rays of the device", bytes)?;
            for number in 0..SETS {
                around.interrupt.check()?;
                done.push(work(AskedRays { rays: self.rays(sets, number), units }));
            }
        }
        Ok(done)
    }

    fn rays(&self, sets: &GraySets, number: usize) -> Vec<(Ray, GKind)> {
        let of_set =
            |set: &RaySet, kind| set.rays.iter().map(|ray| (self.space.to_gray(ray), kind)).collect();
        let of_mix = |(ray, query): (BenchRay, Query)| match query {
            Query::Any => (self.space.to_gray(&ray), GKind::Shadow),
            Query::Closest => (self.space.to_gray(&ray), GKind::Gather),
        };
        match number {
            0 => of_set(&sets.gather, GKind::Gather),
            1 => of_set(&sets.shadow, GKind::Shadow),
            mix => {
                let asked = (sets.points.as_slice(), RayMix::ALL[mix - 2]);
                sets::mixed(self.space, self.block, asked, self.seed).into_iter().map(of_mix).collect()
            }
        }
    }
}
