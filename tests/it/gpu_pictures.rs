//! Pictures whose rays through the voxels a device answers: the light that photons bring, pictures beside the
//! processor's, views that change under a small limit of video memory, the viewer. On any Vulkan adapter, as `gpu.rs`.

use crate::command::{document_in, folder, models, said, trex_in};
use crate::fixtures::built_in;
use crate::gpu::{device, rounds_alike};
use crate::light::write_room;
use crate::view::{ViewProcess, text_until};
use serde_json::Value;
use std::path::Path;
use trex_model::{Device, DeviceOptions, Model, OpenOptions, SessionOptions};
use trex_render::{Method, RenderKeys, Scene};
use trex_store::Budget;
use trex_store::layout::FRAME_BYTES;

/// Sides of facets whose light may be another, of those that have any.
const OTHER_SIDE_MAX: f64 = 1e-4;
/// What their flux may differ by, all together, of all flux.
const FLUX_MAX: f64 = 1e-4;
/// The same of a device in hardware: a photon that meets another leaf there scatters otherwise from then on.
const FLUX_MAX_IN_HARDWARE: f64 = 2e-3;
/// relMSE of a picture by a device beside the processor's, as `docs/gpu.md` states it.
const PICTURE_MAX: &str = "1e-4";

/// Flux on each side of each facet, W, red, after so many photons, by a device.
fn flux(path: &Path, scene: &Scene, device: Device) -> Vec<f64> {
    let options = OpenOptions {
        device: DeviceOptions { device, gpu_memory_limit_bytes: None },
        ..OpenOptions::with_limit(2 << 30)
    };
    let model = Model::open(path, &options).unwrap();
    let mut session = model.session_with(scene, &SessionOptions::default()).unwrap();
    session.illuminate(&|| false, &mut |_, _| {}).unwrap();
    let map = session.photon_map().expect("photon keeps its light by facets");
    assert_eq!(map.photons(), scene.render.photons);
    let (octree, _lease) = model.file().upper(&Budget::unlimited()).unwrap().unwrap();
    let area = |side: usize| f64::from(octree.facets().side_area(side));
    map.irradiance().enumerate().map(|(side, rgb)| f64::from(rgb[0]) * area(side)).collect()
}

/// Photons fly from leaf to leaf: one that met another leaf on a device would leave all that follows elsewhere. Their
/// flux is summed in integers, so equal ways give equal sums, whatever the order.
#[test]
fn photons_bring_the_light_that_they_bring_on_the_processor() {
    if device().is_none() {
        return;
    }
    let inside = folder();
    built_in(inside.path(), "gen:pipes:30k --voxels 64", "plant.trex");
    built_in(inside.path(), "gen:isosurface:20k --voxels 64", "iso.trex");
    write_room(inside.path(), "room", true, false);
    let room = std::fs::read_to_string(inside.path().join("room.toml")).unwrap();
    let room = Scene::parse(&room, Path::new("room.toml")).unwrap();
    for (name, scene) in [("plant", Scene::default()), ("iso", Scene::default()), ("room", room)] {
        let keys = RenderKeys { integrator: Method::Photon, photons: 300_000, ..scene.render };
        let scene = Scene { render: keys, ..scene };
        let path = inside.path().join(format!("{name}.trex"));
        let [expected, found] = [Device::Cpu, Device::Gpu].map(|device| flux(&path, &scene, device));
        let lit = expected.iter().filter(|flux| **flux > 0.0).count();
        let other = expected.iter().zip(&found).filter(|(a, b)| a != b).count();
        let [all, all_found] = [&expected, &found].map(|flux| flux.iter().sum::<f64>());
        let apart = (all_found / all - 1.0).abs();
        said(&format!("{name}: {other} of {lit} lit sides have other light, {apart:e} of all flux"));
        assert!(lit > 50 && all > 0.0, "{name}: {lit} sides have light");
        let is_alike = other as f64 <= OTHER_SIDE_MAX * lit as f64;
        assert!(is_alike || !rounds_alike(), "{name}: {other} of {lit}");
        let flux_max = if rounds_alike() { FLUX_MAX } else { FLUX_MAX_IN_HARDWARE };
        assert!(apart <= flux_max, "{name}: {all_found} W in place of {all}");
    }
}

/// The same picture by the processor and by a device.
#[track_caller]
fn compare(inside: &Path, name: &str, flags: &str) {
    let line = format!("render {name} --threads 2 --memory-limit 1GiB --overwrite {flags}");
    document_in(inside, &format!("{line} --device cpu -o cpu.exr"));
    let by_device = document_in(inside, &format!("{line} --device gpu -o gpu.exr"));
    assert!(by_device["gpu"]["rays"].as_u64().unwrap() > 1000, "{name}: {by_device:#}");
    assert_eq!(by_device["device_notice"], Value::Null, "{name}");
    let line = format!("image diff gpu.exr cpu.exr --metric relmse --threshold {PICTURE_MAX}");
    let compared = document_in(inside, &line);
    assert_eq!(compared["threshold"]["is_kept"], true, "{name}: {compared:#}");
    said(&format!("{name}: relMSE {}", compared["threshold"]["value"]));
}

/// Rays are cut before they go to a device, and hidden materials have no bits in the octree that it gets; so it agrees
/// with the processor on what is left, with units and without, where light comes in through what is gone.
#[test]
fn pictures_of_parts_are_those_of_the_processor() {
    if device().is_none() {
        return;
    }
    let inside = folder();
    built_in(inside.path(), "gen:pipes:50k --voxels 64/256", "plant.trex");
    let small = "--integrator photon --spp 2 --photons 20k --resolution 64x48";
    let info = document_in(inside.path(), "info plant.trex");
    let middle = |axis: usize| {
        let side = |end: &str| info["bounds"][end][axis].as_f64().unwrap();
        0.5 * (side("lo") + side("hi"))
    };
    let section = format!("--section {},{},{},0.2,-1,0.1", middle(0), middle(1), middle(2));
    compare(inside.path(), "plant.trex", &format!("{small} {section}"));
    compare(inside.path(), "plant.trex", &format!("{small} --hide roof --hide wall"));
    compare(inside.path(), "plant.trex", &format!("{small} {section} --hide roof --lod-error 2"));
}

/// A room with a mirror for a wall, the inside of a plant, an iso-surface, and of the real models a box and a hall;
/// with units and without, with the mesh near what is seen and without, with voxels beyond the cut of the footprint.
#[test]
fn pictures_are_those_of_the_processor() {
    if device().is_none() {
        return;
    }
    let inside = folder();
    built_in(inside.path(), "gen:pipes:50k --voxels 64/256", "plant.trex");
    built_in(inside.path(), "gen:isosurface:60k --voxels 64/256", "iso.trex");
    write_room(inside.path(), "room", true, true);
    let small = "--integrator photon --spp 2 --photons 20k";
    compare(inside.path(), "room.toml", small);
    compare(inside.path(), "room.toml", &format!("{small} --near exact"));
    let plant = "--camera-position 6,1.7,-4 --camera-target 12,2,-8 --resolution 64x48";
    compare(inside.path(), "plant.trex", &format!("{small} {plant}"));
    compare(inside.path(), "iso.trex", &format!("{small} --resolution 64x48 --lod-error 2"));
    compare(inside.path(), "iso.trex", "--integrator ao --spp 2 --resolution 64x48");
    let Some(models) = models() else { return };
    let scenes = concat!(env!("CARGO_MANIFEST_DIR"), "/bench/scenes");
    for (name, obj) in [("cornell", "cornell/cornell.obj"), ("sponza", "sponza/sponza.obj")] {
        let obj = models.join(obj);
        if !obj.is_file() {
            continue;
        }
        let line = format!("build {} -o {name}.trex --voxels 256", obj.display());
        document_in(inside.path(), &line);
        let scene = std::fs::read_to_string(format!("{scenes}/{name}.toml")).unwrap();
        std::fs::write(inside.path().join(format!("{name}.toml")), scene.replace("../../out/", "")).unwrap();
        compare(inside.path(), &format!("{name}.toml"), &format!("{small} --resolution 64x48"));
    }
}

/// Video memory for an eighth of the units beside the upper octree and the batches: views that jump are exact in the
/// end, without holes, within the limit. Units that have no room in a batch are the processor's.
#[test]
fn views_change_in_an_eighth_of_the_units_video_memory() {
    if device().is_none() {
        return;
    }
    let inside = folder();
    built_in(inside.path(), "gen:isosurface:200k --voxels 64/256", "iso.trex");
    let pages = document_in(inside.path(), "info iso.trex")["asvo"]["unit_page_count"].as_u64().unwrap();
    let whole =
        "render iso.trex -o x.exr --resolution 8x8 --spp 1 --photons 1k --memory-limit 1GiB --device gpu";
    let used = document_in(inside.path(), whole)["gpu"]["memory_used_bytes"].as_u64().unwrap();
    // As `gpu/src/units.rs` has it: slots in what tables and a frame leave.
    let limit = used - (pages - pages / 8 - 1) * FRAME_BYTES as u64;
    for scenario in ["flip", "light-edit"] {
        let line = format!(
            "stress iso.trex --scenario {scenario} --resolution 64x48 --photons 5k --switches 4 --hold 60000 \
             --n-shadow 2 --n-gather 2 --threads 2 --memory-limit 512MiB --require frame.max=60000 \
             --device gpu --gpu-memory-limit {limit}B"
        );
        let told = document_in(inside.path(), &line);
        let gpu = &told["device"]["gpu"];
        let count = |key: &str| gpu[key].as_u64().unwrap();
        said(&format!("{scenario}: {gpu:#}"));
        assert_eq!((&told["verdict"], &told["holes"]), (&"pass".into(), &0.into()), "{told:#}");
        assert_eq!(told["complete_ms"]["count"], 4, "{told:#}");
        assert!(count("rays") > 20_000 && count("unit_uploads") > pages / 8, "{gpu:#}");
        assert!(count("unit_evictions") > 0, "{gpu:#}");
        assert_eq!(count("memory_limit_bytes"), limit);
        assert!(count("memory_used_bytes") <= limit, "{gpu:#}");
        assert!(count("uploaded_bytes") > 40 * count("rays") && count("read_back_bytes") > 0, "{gpu:#}");
        assert!(told["memory"]["peak_rss_bytes"].as_u64().unwrap() <= 512 << 20, "{told:#}");
    }
}

/// The page is told which device answers, and what went to it.
#[test]
fn the_viewer_tells_its_device() {
    let Some(device) = device() else { return };
    let inside = folder();
    built_in(inside.path(), "gen:isosurface:20k --voxels 64", "iso.trex");
    let rest = "iso.trex --resolution 64x48 --spp 2 --photons 5k --memory-limit 1GiB";
    for (flag, name) in [("gpu", device.report().name.as_str()), ("cpu", "cpu")] {
        // Drivers in software say on stderr, before the address, that they miss it.
        let line = format!("view {rest} --device {flag} --no-open --json");
        let mut command = trex_in(inside.path(), &line);
        command.env("XDG_RUNTIME_DIR", inside.path());
        let viewing = ViewProcess::start_as(command, line);
        let mut page = viewing.page();
        let welcome = text_until(&mut page, |text| text["type"] == "welcome");
        assert_eq!(welcome["device"], name, "{welcome:#}");
        let done = text_until(&mut page, |text| text["progress"] == "done");
        match flag {
            "gpu" => assert!(done["gpu"]["rays"].as_u64().unwrap() > 1000, "{done:#}"),
            _ => assert_eq!(done["gpu"], Value::Null, "{done:#}"),
        }
        let ran = viewing.end();
        ran.expect(0);
        assert_eq!(ran.document()["device"]["name"], name);
    }
}

/// Steps that a device counts are those of the scalar walk: within a hundredth, as it may round otherwise.
#[test]
fn walks_on_a_device_have_the_steps_of_those_on_the_processor() {
    if device().is_none() {
        return;
    }
    let inside = folder();
    built_in(inside.path(), "gen:pipes:20k --voxels 64/256", "plant.trex");
    let line = "bench rays plant.trex --resolution 64x64 --rounds 1 --threads 2 --memory-limit 1GiB";
    let figures = document_in(inside.path(), &format!("{line} --device gpu"));
    let measured = &figures["device"];
    let mixes = ["mixes", "finest_mixes"].map(|key| measured[key].as_array().unwrap());
    let mixes = mixes.into_iter().flatten();
    let sets = ["gather", "shadow", "finest_gather", "finest_shadow"].map(|key| &measured[key]);
    for set in sets.into_iter().chain(mixes) {
        let number = |key: &str| set[key].as_f64().unwrap_or_else(|| panic!("{key}: {set:#}"));
        let (found, expected) = (number("steps_per_ray"), number("scalar_steps_per_ray"));
        assert!(expected > 1.0 && (found / expected - 1.0).abs() < 0.01, "{set:#}");
        assert!(["per_s", "lanes_per_s", "scalar_per_s"].iter().all(|key| number(key) > 0.0), "{set:#}");
    }
    let cpu = document_in(inside.path(), &format!("{line} --device cpu"));
    assert_eq!(cpu["device"]["gather"]["steps_per_ray"], Value::Null, "{:#}", cpu["device"]);
}
