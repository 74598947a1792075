//! The G-stage on a device: what it answers beside the processor, what it does when the device goes, and that it
//! keeps to its limit. Runs on any Vulkan adapter, one in software too; without one it says so, and fails under
//! TREX_REQUIRE_GPU=1.

use crate::command::{cannot_run, document_in, folder, run_in, said};
use crate::fixtures::built_in;
use crate::g_stage::{NewStage, settings};
use crate::voxels_lower_batch::{BatchStage as Setting, PartialPages, all_there};
use std::sync::{Arc, OnceLock};
use std::time::{Duration, Instant};
use trex_gpu::{DeviceQuery, GpuDevice, GpuOptions, GpuStage, WhenTooLarge, adapters};
use trex_render::{
    CpuStage, GAnswer, GCall, GKind, GRay, GRays, GStage, GUnits, GView, MissingUnits, Occluders, Pages,
};
use trex_store::octree::Refinement;
use trex_store::{Budget, Code, NextStep};

/// Rays that may meet another leaf than on the processor.
const OTHER_LEAF_MAX: f64 = 1e-4;
/// The same of a device in hardware, which fuses and divides as it likes: a share of these rays is made to go along
/// planes, edges and corners of voxels. An H100 met another leaf with 4 of 6,032.
const OTHER_LEAF_MAX_IN_HARDWARE: f64 = 2e-3;
/// Subvoxels by which the two may be apart then.
const APART_MAX: f32 = 1.0;

/// A device that all tests share; `None` where the machine has none.
pub(crate) fn device() -> Option<&'static Arc<GpuDevice>> {
    static DEVICE: OnceLock<Option<Arc<GpuDevice>>> = OnceLock::new();
    DEVICE.get_or_init(|| open(1 << 30)).as_ref()
}

/// A device of its own, with so many bytes of video memory.
fn open(limit_bytes: u64) -> Option<Arc<GpuDevice>> {
    let options = GpuOptions { memory_limit_bytes: Some(limit_bytes), budget: Budget::unlimited() };
    match GpuDevice::open(DeviceQuery::Any, &options) {
        Ok(device) => Some(Arc::new(device)),
        Err(error) => {
            let is_required = std::env::var_os("TREX_REQUIRE_GPU").is_some_and(|value| value == "1");
            assert!(!is_required, "TREX_REQUIRE_GPU is set: {error}");
            cannot_run(&format!("no GPU: {error}"));
            None
        }
    }
}

/// Whether it rounds as the processor does: a device in software, on this processor.
pub(crate) fn rounds_alike() -> bool {
    device().is_some_and(|device| !device.report().is_hardware)
}

/// Of so many rays, those that may meet another leaf.
fn other_leaf_max(rays: usize) -> usize {
    let share = if rounds_alike() { OTHER_LEAF_MAX } else { OTHER_LEAF_MAX_IN_HARDWARE };
    (share * rays as f64).ceil() as usize
}

/// What makes a stage on that device, with its name, if its answers are to be the processor's to the last bit.
pub(crate) fn stage() -> Option<(&'static str, NewStage)> {
    let stage: NewStage = || {
        let device = device().expect("there is one").clone();
        Box::new(GpuStage::new(device, WhenTooLarge::Refuse).unwrap())
    };
    rounds_alike().then_some(("device", stage))
}

/// All rays of a setting, of all kinds, with cones and without, in parts of so many.
fn call(setting: &Setting, view: GView, part: usize) -> GCall {
    let (upper, lower) = (setting.voxels.scene(view.occluders), setting.voxels.lower_scene(view.occluders));
    let lower = lower.filter(|_| view.units != GUnits::None);
    let ray = |at: usize| -> GRay {
        let kind = GKind::ALL[at * 7 % 11 % 4];
        let ray = &setting.rays[at];
        match lower {
            Some(lower) => lower.g_ray(ray, kind).0.with_cone(0.0, [0.0, 0.05, 0.2][at % 3]),
            None => upper.g_ray(ray, kind).0,
        }
    };
    let all: Vec<usize> = (0..setting.rays.len()).collect();
    let parts = all.chunks(part).map(|places| {
        let mut rays = GRays::default();
        places.iter().for_each(|&at| {
            rays.push(ray(at));
        });
        rays
    });
    GCall { view, parts: parts.collect() }
}

fn answers(stage: &dyn GStage, call: GCall, pages: &mut dyn Pages) -> Vec<(GRay, GAnswer)> {
    let found = stage.submit(call, pages).wait();
    let parts = found.parts.iter();
    parts.flat_map(|part| part.rays().iter().copied().zip(part.answers().iter().copied())).collect()
}

/// Whether two answers are of the same leaf, met in the same way.
fn is_same(a: &GAnswer, b: &GAnswer) -> bool {
    let same_words = (a.outcome, a.side, a.material, a.axis) == (b.outcome, b.side, b.material, b.axis);
    let normals = a.normal.iter().zip(&b.normal).all(|(a, b)| (a - b).abs() < 1e-5);
    same_words && normals && (a.t - b.t).abs() <= 1e-4 * a.t.abs().max(1.0)
}

/// The bound that is stated in `docs/gpu.md`. What is met otherwise is met nearby: a ray that grazes a corner may
/// miss it on one of the two, and then goes on; so it is counted, but of no more rays than one in ten thousand.
#[test]
fn a_device_answers_as_the_processor_does() {
    let Some(device) = device() else { return };
    let (mut all, mut other, mut apart) = (0, 0, 0);
    for setting in [
        Setting::new("gen:pipes:30k:2", Refinement::By16, 40_000),
        Setting::new("gen:isosurface:20k:2", Refinement::By4, 40_000),
    ] {
        let mut twin = CpuStage::default();
        twin.set_octree(&setting.voxels).unwrap();
        let mut stage = GpuStage::new(device.clone(), WhenTooLarge::Refuse).unwrap();
        stage.set_octree(&setting.voxels).unwrap();
        let before = device.counts();
        for units in [GUnits::None, GUnits::On(MissingUnits::Block)] {
            let view = GView { occluders: Occluders::On, units };
            let mut pages = PartialPages::new(&setting.all, all_there, usize::MAX);
            let expected = answers(&twin, call(&setting, view, 64), &mut pages);
            let found = answers(&stage, call(&setting, view, 64), &mut pages);
            assert_eq!(found.len(), expected.len());
            for ((ray, found), (_, expected)) in found.iter().zip(&expected) {
                all += 1;
                if !is_same(found, expected) {
                    other += 1;
                    let both = found.outcome == GAnswer::MET && expected.outcome == GAnswer::MET;
                    apart += usize::from(!both || (found.t - expected.t).abs() > APART_MAX);
                    assert!(other < 20 || !rounds_alike(), "{ray:?}: {found:?} in place of {expected:?}");
                }
            }
        }
        let counts = device.counts();
        assert!(counts.rays > before.rays && counts.unit_uploads > before.unit_uploads, "{counts:?}");
    }
    said(&format!("{other} of {all} rays meet another leaf on the device, {apart} of them not nearby"));
    assert!(other <= other_leaf_max(all), "{other} of {all}");
}

/// Units that do not all fit: slots change hands, answers are the same, and the limit holds.
#[test]
fn units_share_few_slots() {
    let Some(any) = device() else { return };
    let setting = Setting::new("gen:isosurface:50k:2", Refinement::By16, 6000);
    let octree = setting.voxels.octree();
    // As `gpu/src/slots.rs` and `octree.rs` take them, and 16 slots.
    let batch_bytes = GpuStage::batch_bytes(any);
    let octree_bytes = 12 * octree.nodes().len() + 12 * octree.leaf_count() + 12 * octree.last_nodes().len();
    let fixed = octree_bytes as u64 + batch_bytes + 4 * u64::from(setting.voxels.page_count());
    let limit = fixed + (17 << 16);
    let device = open(limit).unwrap();
    let mut twin = CpuStage::default();
    twin.set_octree(&setting.voxels).unwrap();
    let mut stage = GpuStage::new(device.clone(), WhenTooLarge::Refuse).unwrap();
    stage.set_octree(&setting.voxels).unwrap();
    let view = GView { occluders: Occluders::On, units: GUnits::On(MissingUnits::Block) };
    let mut pages = PartialPages::new(&setting.all, all_there, usize::MAX);
    let expected = answers(&twin, call(&setting, view, 64), &mut pages);
    let found = answers(&stage, call(&setting, view, 64), &mut pages);
    let other = found.iter().zip(&expected).filter(|((_, a), (_, b))| !is_same(a, b)).count();
    assert!(other <= other_leaf_max(found.len()), "{other} of {}", found.len());
    let counts = device.counts();
    assert!(counts.unit_evictions > 0 && counts.rays > counts.processor_rays, "{counts:?}");
    assert!(device.memory_used_bytes() <= limit, "{} of {limit}", device.memory_used_bytes());
}

/// A limit below the octree: refused with the limit that would do, or answered by the processor.
#[test]
fn an_octree_without_room_is_refused_or_left_to_the_processor() {
    let Some(device) = open(64 << 10) else { return };
    let setting = Setting::new("gen:scan:10k:2", Refinement::By4, 500);
    let mut stage = GpuStage::new(device.clone(), WhenTooLarge::Refuse).unwrap();
    let error = stage.set_octree(&setting.voxels).unwrap_err();
    assert_eq!(error.code(), Code::MemoryLimit);
    assert!(
        matches!(error.next_step_kind(), NextStep::RaiseGpuLimit { bytes } if *bytes > 64 << 10),
        "{error}"
    );
    let mut stage = GpuStage::new(device.clone(), WhenTooLarge::UseProcessor).unwrap();
    stage.set_octree(&setting.voxels).unwrap();
    assert!(device.notice().is_some_and(|notice| notice.contains("video memory")), "{:?}", device.notice());
    let view = GView { occluders: Occluders::On, units: GUnits::None };
    let mut pages = PartialPages::new(&setting.all, all_there, usize::MAX);
    let found = answers(&stage, call(&setting, view, 64), &mut pages);
    assert!(found.iter().any(|(_, answer)| answer.outcome == GAnswer::MET));
    assert_eq!((device.counts().processor_rays, device.counts().rays), (found.len() as u64, 0));
    assert_eq!(device.memory_used_bytes(), 0);
}

/// The device dropped the octree before and the processor took the refused one, so a session that stayed as it was got
/// answers of a model that it did not show.
#[test]
fn an_octree_that_is_refused_leaves_the_one_before() {
    let Some(any) = device() else { return };
    let specs = ["gen:scan:10k:2", "gen:isosurface:50k:2"];
    let [mut small, mut large] = specs.map(|spec| Setting::new(spec, Refinement::By4, 2000));
    // As in `units_share_few_slots`.
    let batch_bytes = GpuStage::batch_bytes(any);
    let fixed_bytes = |setting: &Setting| {
        let octree = setting.voxels.octree();
        let words = octree.nodes().len() + octree.leaf_count() + octree.last_nodes().len();
        12 * words as u64 + batch_bytes + 4 * u64::from(setting.voxels.page_count())
    };
    if fixed_bytes(&small) > fixed_bytes(&large) {
        std::mem::swap(&mut small, &mut large);
    }
    let device = open((fixed_bytes(&small) + fixed_bytes(&large)) / 2).unwrap();
    let mut twin = CpuStage::default();
    twin.set_octree(&small.voxels).unwrap();
    let mut stage = GpuStage::new(device.clone(), WhenTooLarge::Refuse).unwrap();
    stage.set_octree(&small.voxels).unwrap();
    let refused = stage.set_octree(&large.voxels).unwrap_err();
    assert_eq!(refused.code(), Code::MemoryLimit, "{refused}");
    let view = GView { occluders: Occluders::On, units: GUnits::None };
    let mut pages = PartialPages::new(&small.all, all_there, usize::MAX);
    let expected = answers(&twin, call(&small, view, 64), &mut pages);
    let found = answers(&stage, call(&small, view, 64), &mut pages);
    let other = found.iter().zip(&expected).filter(|((_, a), (_, b))| !is_same(a, b)).count();
    assert!(other <= other_leaf_max(found.len()), "{other} of {}", found.len());
    assert!(expected.iter().any(|(_, answer)| answer.outcome == GAnswer::MET));
    let counts = device.counts();
    assert!(counts.rays > counts.processor_rays, "the device answers again: {counts:?}");
}

/// A device that goes in the middle: whatever was asked is answered, by the processor, and soon.
#[test]
fn a_lost_device_leaves_its_rays_to_the_processor() {
    let setting = settings().remove(0);
    let view = GView { occluders: Occluders::On, units: GUnits::None };
    for units in [GUnits::None, GUnits::On(MissingUnits::Block)] {
        let Some(device) = open(1 << 30) else { return };
        let view = GView { units, ..view };
        let mut twin = CpuStage::default();
        twin.set_octree(&setting.voxels).unwrap();
        let mut stage = GpuStage::new(device.clone(), WhenTooLarge::Refuse).unwrap();
        stage.set_octree(&setting.voxels).unwrap();
        let mut pages = PartialPages::new(&setting.all, all_there, usize::MAX);
        let expected = answers(&twin, call(&setting, view, 64), &mut pages);
        assert_eq!(answers(&stage, call(&setting, view, 64), &mut pages).len(), expected.len());
        let turns: Vec<_> = (0..4).map(|_| stage.submit(call(&setting, view, 64), &mut pages)).collect();
        device.destroy();
        let began = Instant::now();
        for turn in turns {
            assert_eq!(turn.wait().parts.len(), setting.rays.len().div_ceil(64));
        }
        let found = answers(&stage, call(&setting, view, 64), &mut pages);
        assert!(began.elapsed() < Duration::from_secs(2), "{:?}", began.elapsed());
        assert!(found.iter().zip(&expected).all(|((_, a), (_, b))| a == b), "the processor's own answers");
        let counts = device.counts();
        assert!(counts.processor_rays >= found.len() as u64, "{counts:?}");
        assert!(device.notice().is_some_and(|notice| notice.contains("lost")));
    }
}

/// What `trex doctor` says is what the libraries find.
#[test]
fn a_doctor_tells_what_is_there_and_what_is_used() {
    let inside = folder();
    let told = document_in(inside.path(), "doctor . --memory-limit 300MiB");
    assert_eq!(told["memory"]["limit_bytes"], 300 << 20);
    assert_eq!(told["disk"]["chosen"]["backend"] == "uring", told["disk"]["uring"]["works"], "{told:#}");
    assert_eq!(told["disk"]["chosen"]["direct"], told["disk"]["direct"]["works"], "{told:#}");
    assert_eq!(std::fs::read_dir(inside.path()).unwrap().count(), 0, "it leaves nothing behind");
    let gpus = told["gpus"].as_array().unwrap();
    let adapters = adapters();
    assert_eq!(gpus.len(), adapters.len());
    let usable = adapters.iter().find(|adapter| adapter.is_hardware && adapter.refusal.is_none());
    assert_eq!(told["uses"]["auto"], usable.map_or("cpu", |adapter| &adapter.name));
    assert_eq!([&told["uses"]["render"], &told["uses"]["view"]], ["cpu", "cpu"]);
    let text = run_in(inside.path(), "doctor");
    text.expect(0);
    for adapter in &adapters {
        assert!(text.stdout.contains(&adapter.name), "{}", text.stdout);
    }
    let lines = text.stdout.lines();
    assert!(lines.last().is_some_and(|line| line.starts_with("rays through the voxels are answered by")));
}

/// A device on the rays of `bench rays`: answers beside the processor's, and times of kernels where it tells them.
#[test]
fn rays_of_the_bench_go_through_a_device() {
    let Some(device) = device() else { return };
    let inside = folder();
    built_in(inside.path(), "gen:pipes:20k --voxels 64/256", "plant.trex");
    let line =
        "bench rays plant.trex --resolution 64x64 --rounds 1 --threads 2 --memory-limit 1GiB --device gpu";
    let figures = document_in(inside.path(), line);
    let measured = &figures["device"];
    assert_eq!(measured["name"], device.report().name.as_str(), "{measured:#}");
    let pairs = [
        ("gather", "gray"),
        ("shadow", "gray_shadow"),
        ("finest_gather", "gray_finest"),
        ("finest_shadow", "gray_finest_shadow"),
    ];
    for (of_device, of_processor) in pairs {
        let (found, expected) = (&measured[of_device], &figures[of_processor]);
        assert_eq!(found["ray_count"], expected["ray_count"], "{of_device}: {measured:#}");
        let other = found["other_count"].as_u64().unwrap() as f64;
        let all = found["ray_count"].as_u64().unwrap() as f64;
        assert!(all > 500.0 && other <= (OTHER_LEAF_MAX * all).max(1.0), "{of_device}: {measured:#}");
        let hits = |set: &serde_json::Value| set["hit_count"].as_f64().unwrap();
        assert!((hits(found) - hits(expected)).abs() <= other, "{of_device}: {figures:#}");
        assert_eq!(found["kernel_per_s"].is_number(), device.report().has_timestamps, "{of_device}");
    }
}

/// Pictures of the command by a device and by the processor; the choice, its reason, and what is refused.
#[test]
fn a_picture_is_asked_of_a_device_by_name() {
    let inside = folder();
    built_in(inside.path(), "gen:pipes:20k", "plant.trex");
    let line = "render plant.trex --resolution 48x32 --spp 2 --photons 20k --memory-limit 1GiB --threads 2";
    let by_processor = document_in(inside.path(), &format!("{line} -o cpu.exr"));
    assert_eq!((&by_processor["device"], &by_processor["gpu"]), (&"cpu".into(), &serde_json::Value::Null));
    let refused = run_in(inside.path(), &format!("{line} -o no.exr --device no-such-gpu --json"));
    refused.expect_error(6, "no-adapter");
    let automatic = run_in(inside.path(), &format!("{line} -o auto.exr --device auto -v"));
    automatic.expect(0);
    assert!(automatic.stderr.contains("rays through the voxels are answered by"), "{}", automatic.stderr);
    let Some(device) = device() else { return };
    let by_device = document_in(inside.path(), &format!("{line} -o gpu.exr --device gpu"));
    assert_eq!(by_device["device"], device.report().name.as_str());
    assert!(by_device["gpu"]["rays"].as_u64().unwrap() > 10_000, "{by_device:#}");
    assert_eq!(by_device["device_notice"], serde_json::Value::Null);
    let compared = document_in(inside.path(), "image diff gpu.exr cpu.exr --threshold 1e-3 --metric relmse");
    assert_eq!(compared["threshold"]["is_kept"], true, "{compared:#}");
    let limited =
        run_in(inside.path(), &format!("{line} -o no.exr --device gpu --gpu-memory-limit 1MiB --json"));
    let document = limited.expect_error(4, "memory-limit");
    assert!(document["next_step"].as_str().unwrap().contains("--gpu-memory-limit"), "{document:#}");
}
