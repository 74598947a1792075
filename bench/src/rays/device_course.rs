//! `DeviceCourse`: sets of rays answered in turn by a device, by the processor in lanes, and by its scalar walk, in the
//! same calls.
//!
//! Invariant: a round ends with the calls that it began with, answered, in their order.

use super::scalar_stage::ScalarStage;
use crate::median::median;
use serde::Serialize;
use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;
use trex_model::StageSource;
use trex_render::{
    AllResident, CpuStage, GAnswer, GCall, GKind, GRay, GRays, GStage, GTurn, GUnits, GView, Occluders, Ray,
    Voxels,
};

/// Rays of a part of a call: about those of a tile.
const PART_RAYS: usize = 512;

/// Share of a distance by which equal answers may differ.
const SAME: f32 = 1e-4;

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
    /// Rays that meet another surface than on the processor, or at another distance, by a ten-thousandth: devices
    /// round otherwise.
    pub other_count: usize,
    /// The same calls answered by the processor in lanes, rays per second of wall time, median.
    pub lanes_per_s: f64,
    /// By its scalar walk.
    pub scalar_per_s: f64,
    /// Empty cubes that a ray leaves, on average, as the device counts them; `None` of the processor as a device.
    pub steps_per_ray: Option<f64>,
    /// As the scalar walk counts them.
    pub scalar_steps_per_ray: f64,
}

/// The octree, pages and threads that rays are answered with.
pub(super) struct DeviceCourse<'a> {
    pub(super) source: &'a StageSource,
    pub(super) voxels: &'a Arc<Voxels>,
    pub(super) pages: &'a AllResident,
    pub(super) threads: usize,
    pub(super) rounds: usize,
}

/// Rays of a set, and what they find below the upper octree.
pub(super) struct AskedRays {
    pub(super) rays: Vec<(Ray, GKind)>,
    pub(super) units: GUnits,
}

/// Who answers in turn.
pub(super) struct Stages {
    device: Box<dyn GStage>,
    lanes: CpuStage,
    scalar: ScalarStage,
}

impl AskedRays {
    /// Bytes of a ray: as it is made, in its call, its answer there, and two copies of that.
    pub(super) const RAY_BYTES: usize =
        size_of::<(Ray, GKind)>() + size_of::<GRay>() + 3 * size_of::<GAnswer>();
}

impl Stages {
    /// Rays of a call.
    pub(super) fn call_rays(&self) -> usize {
        self.device.needs().batch_rays
    }
}

impl DeviceCourse<'_> {
    /// All stages, with the octree.
    ///
    /// # Errors
    /// The device has no room for it.
    pub(super) fn stages(&self) -> anyhow::Result<Stages> {
        let device = self.source.stage()?;
        let mut stages = Stages { device, lanes: CpuStage::default(), scalar: ScalarStage::default() };
        stages.device.set_octree(self.voxels)?;
        stages.lanes.set_octree(self.voxels)?;
        stages.scalar.set_octree(self.voxels)?;
        Ok(stages)
    }

    /// Measures a set.
    pub(super) fn run(&self, stages: &mut Stages, asked: &AskedRays) -> DeviceSetFigures {
        let Stages { device, lanes, scalar } = stages;
        let in_turn: [&dyn GStage; 3] = [&**device, lanes, scalar];
        let mut calls = self.calls(asked, device.needs().batch_rays);
        let (mut per_s, mut found) = ([const { Vec::new() }; 3], [const { Vec::new() }; 2]);
        let mut kernel_ns = 0;
        for round in 0..=self.rounds {
            for (at, stage) in in_turn.into_iter().enumerate() {
                let before = self.kernel_ns();
                let time_s;
                (time_s, calls) = self.round(stage, calls);
                if round == 0 && at != 1 {
                    let answers = calls.iter().flat_map(|call| &call.parts).flat_map(|part| part.answers());
                    found[at / 2] = answers.copied().collect::<Vec<GAnswer>>();
                }
                if round > 0 {
                    per_s[at].push(asked.rays.len() as f64 / time_s);
                    kernel_ns += self.kernel_ns() - before;
                }
            }
        }
        let [found, expected] = &found;
        let ray_count = asked.rays.len();
        DeviceSetFigures {
            ray_count,
            hit_count: found.iter().filter(|answer| answer.outcome == GAnswer::MET).count(),
            per_s: median(&per_s[0]),
            kernel_per_s: (kernel_ns > 0).then(|| (ray_count * self.rounds) as f64 * 1e9 / kernel_ns as f64),
            other_count: found
                .iter()
                .zip(expected)
                .filter(|(found, expected)| !is_same(found, expected))
                .count(),
            lanes_per_s: median(&per_s[1]),
            scalar_per_s: median(&per_s[2]),
            steps_per_ray: None,
            scalar_steps_per_ray: self.scalar_steps_per_ray(asked),
        }
    }

    /// Steps of a walk on a device whose stage counts them, once all units are there.
    pub(super) fn steps_per_ray(&self, counting: &dyn GStage, asked: &AskedRays) -> f64 {
        let (_, calls) = self.round(counting, self.calls(asked, counting.needs().batch_rays));
        let before = self.source.steps_and_walks();
        self.round(counting, calls);
        let [steps, walks] = self.source.steps_and_walks();
        (steps - before[0]) as f64 / (walks - before[1]).max(1) as f64
    }

    fn scalar_steps_per_ray(&self, asked: &AskedRays) -> f64 {
        let (upper, lower) = (self.voxels.scene(Occluders::On), self.voxels.lower_scene(Occluders::On));
        let lower = lower.filter(|_| asked.units != GUnits::None);
        let mut pages = self.pages;
        let steps = asked.rays.iter().map(|(ray, kind)| match &lower {
            Some(lower) => lower.steps(&lower.g_ray(ray, *kind).0, &mut pages),
            None => upper.steps(&upper.g_ray(ray, *kind).0),
        });
        steps.sum::<u64>() as f64 / asked.rays.len().max(1) as f64
    }

    /// The rays as calls of so many.
    fn calls(&self, asked: &AskedRays, call_rays: usize) -> Vec<GCall> {
        let view = GView { occluders: Occluders::On, units: asked.units };
        let upper = self.voxels.scene(view.occluders);
        let lower = self.voxels.lower_scene(view.occluders).filter(|_| asked.units != GUnits::None);
        let part = |rays: &[(Ray, GKind)]| {
            let mut part = GRays::default();
            part.reserve_exact(rays.len());
            for (ray, kind) in rays {
                part.push(lower.map_or_else(|| upper.g_ray(ray, *kind).0, |lower| lower.g_ray(ray, *kind).0));
            }
            part
        };
        let calls = asked.rays.chunks(call_rays);
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

/// Whether two answers are of the same surface, met in the same way.
fn is_same(a: &GAnswer, b: &GAnswer) -> bool {
    let words = |answer: &GAnswer| (answer.outcome, answer.side, answer.material, answer.axis);
    words(a) == words(b) && (a.t - b.t).abs() <= SAME * a.t.abs().max(1.0)
}
