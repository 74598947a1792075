//! Rays through the voxels as the renderer hands them to a device: the sets of gather and shadow rays in calls as
//! large as its stage asks for, by all threads, each with as many calls under way as the stage wants.
//!
//! Times are those from the first call to the last answer, rays made before. Answers are compared with the processor's.
//!
//! Invariant: each round asks the same rays, and the first is not measured: units are on the device by then, if they
//! fit.

use super::options::RayOptions;
use super::sets::{GraySets, RaySet, Space};
use crate::median::median;
use crate::model::Surroundings;
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;
use trex_model::{DeviceReport, StageSource};
use trex_render::{
    AllResident, CpuStage, GAnswer, GCall, GKind, GRay, GRays, GStage, GTurn, GUnits, GView, MissingUnits,
    Occluders, Ray, Voxels,
};

/// Rays of a part of a call: about those of a tile.
const PART_RAYS: usize = 512;

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
    /// Gather rays through units; `None` for a file without.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub finest_gather: Option<DeviceSetFigures>,
    /// Shadow rays through units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub finest_shadow: Option<DeviceSetFigures>,
}

/// Figures of a set of rays on a device.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct DeviceSetFigures {
    /// Rays.
    pub ray_count: usize,
    /// Of these, with a hit.
    pub hit_count: usize,
    /// Rays per second of wall time, median.
    pub per_s: f64,
    /// Rays per second of the time of kernels; `None` of a device that does not tell.
    pub kernel_per_s: Option<f64>,
    /// Rays whose answers are not the processor's, bit for bit.
    pub other_count: usize,
}

/// The device, its stage and the octree that it has.
struct DeviceCourse<'a> {
    source: StageSource,
    stage: Box<dyn GStage>,
    processor: CpuStage,
    voxels: &'a Arc<Voxels>,
    pages: &'a AllResident,
    threads: usize,
    rounds: usize,
}

/// Measures the device that is asked for, if one is, on the sets through the upper octree and through units.
///
/// # Errors
/// The device cannot be used, or has no room for the octree.
pub(super) fn measure(
    octree: Option<(&Arc<Voxels>, &AllResident)>,
    (space, sets): (Space, &[Option<GraySets>; 2]),
    (options, around): (&RayOptions, &Surroundings),
) -> anyhow::Result<Option<DeviceFigures>> {
    let (Some(device), Some((voxels, pages))) = (&options.device, octree) else { return Ok(None) };
    let [Some(upper_sets), finest_sets] = sets else { return Ok(None) };
    let source = StageSource::open(device, &around.budget)?;
    let mut stage = source.stage()?;
    stage.set_octree(voxels)?;
    let mut processor = CpuStage::default();
    processor.set_octree(voxels)?;
    let (threads, rounds) = (around.threads, options.rounds);
    let course = DeviceCourse { source, stage, processor, voxels, pages, threads, rounds };
    let run = |set: &RaySet, kind: GKind, units: GUnits| {
        let bytes = set.rays.len() * (size_of::<GRay>() + 2 * size_of::<GAnswer>());
        let _lease = around.budget.lease("the rays of the device", bytes as u64)?;
        around.interrupt.check()?;
        let rays: Vec<Ray> = set.rays.iter().map(|ray| space.to_gray(ray)).collect();
        anyhow::Ok(course.run(&rays, kind, units))
    };
    let gather = run(&upper_sets.gather, GKind::Gather, GUnits::None)?;
    let shadow = run(&upper_sets.shadow, GKind::Shadow, GUnits::None)?;
    let units = GUnits::On(MissingUnits::Block);
    let finest = |set: Option<&RaySet>, kind| set.map(|set| run(set, kind, units)).transpose();
    let finest_gather = finest(finest_sets.as_ref().map(|sets| &sets.gather), GKind::Gather)?;
    let finest_shadow = finest(finest_sets.as_ref().map(|sets| &sets.shadow), GKind::Shadow)?;
    let call_ray_count = course.stage.needs().batch_rays;
    let report = course.source.report();
    Ok(Some(DeviceFigures { report, call_ray_count, gather, shadow, finest_gather, finest_shadow }))
}

impl DeviceCourse<'_> {
    /// Measures a set.
    fn run(&self, rays: &[Ray], kind: GKind, units: GUnits) -> DeviceSetFigures {
        let expected = self.round(&self.processor, self.calls(rays, kind, units)).1;
        let (_, mut calls) = self.round(&*self.stage, self.calls(rays, kind, units));
        let before = self.kernel_ns();
        let mut per_s = Vec::with_capacity(self.rounds);
        for _ in 0..self.rounds {
            let (time_s, answered) = self.round(&*self.stage, calls);
            per_s.push(rays.len() as f64 / time_s);
            calls = answered;
        }
        let kernel_ns = self.kernel_ns() - before;
        let answers = |calls: &[GCall]| -> Vec<GAnswer> {
            calls.iter().flat_map(|call| &call.parts).flat_map(|part| part.answers()).copied().collect()
        };
        let (found, expected) = (answers(&calls), answers(&expected));
        DeviceSetFigures {
            ray_count: rays.len(),
            hit_count: found.iter().filter(|answer| answer.outcome == GAnswer::MET).count(),
            per_s: median(&per_s),
            kernel_per_s: (kernel_ns > 0).then(|| (rays.len() * self.rounds) as f64 * 1e9 / kernel_ns as f64),
            other_count: found.iter().zip(&expected).filter(|(found, expected)| found != expected).count(),
        }
    }

    /// The rays as calls.
    fn calls(&self, rays: &[Ray], kind: GKind, units: GUnits) -> Vec<GCall> {
        let view = GView { occluders: Occluders::On, units };
        let upper = self.voxels.scene(view.occluders);
        let lower = self.voxels.lower_scene(view.occluders).filter(|_| units != GUnits::None);
        let part = |rays: &[Ray]| {
            let mut part = GRays::default();
            for ray in rays {
                part.push(lower.map_or_else(|| upper.g_ray(ray, kind).0, |lower| lower.g_ray(ray, kind).0));
            }
            part
        };
        let calls = rays.chunks(self.stage.needs().batch_rays);
        calls.map(|rays| GCall { view, parts: rays.chunks(PART_RAYS).map(part).collect() }).collect()
    }

    /// Has all calls answered; seconds from the first call to the last answer, and the calls in their order.
    fn round(&self, stage: &dyn GStage, calls: Vec<GCall>) -> (f64, Vec<GCall>) {
        let share = calls.len().div_ceil(self.threads).max(1);
        let mut rest = calls.into_iter();
        let shares: Vec<Vec<GCall>> =
            std::iter::repeat_with(|| rest.by_ref().take(share).collect::<Vec<_>>())
                .take_while(|share| !share.is_empty())
                .collect();
        let began = Instant::now();
        let answered = std::thread::scope(|scope| {
            let workers: Vec<_> =
                shares.into_iter().map(|share| scope.spawn(|| self.answer_share(stage, share))).collect();
            let joined = workers.into_iter().map(|worker| worker.join().expect("a worker panicked"));
            joined.flatten().collect()
        });
        (began.elapsed().as_secs_f64(), answered)
    }

    /// The calls of a worker, with so many under way as the stage wants.
    fn answer_share(&self, stage: &dyn GStage, calls: Vec<GCall>) -> Vec<GCall> {
        let (mut answered, mut under_way) = (Vec::with_capacity(calls.len()), VecDeque::new());
        for call in calls {
            if under_way.len() == stage.needs().calls {
                let first: GTurn = under_way.pop_front().expect("at least one");
                answered.push(first.wait());
            }
            under_way.push_back(stage.submit(call, &mut { self.pages }));
        }
        answered.extend(under_way.into_iter().map(GTurn::wait));
        answered
    }

    fn kernel_ns(&self) -> u64 {
        self.source.report().gpu.map_or(0, |gpu| gpu.shadow_ns + gpu.surface_ns)
    }
}
