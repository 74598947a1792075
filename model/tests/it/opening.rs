//! What a session decides before its first picture: by the scene alone, and so that surfaces are seen.

use super::{built, open};
use std::ops::ControlFlow;
use std::path::Path;
use tempfile::TempDir;
use trex_model::{Model, OpenOptions, Session, SessionOptions, ThreadSource};
use trex_render::{
    Event, Exposure, Filter, Layers, Light, LightRig, Method, RenderKeys, RenderSettings, Scene,
};
use trex_store::RESERVE_BYTES;
use trex_store::build::Voxels;

/// A scene of a file alone, small.
fn of_file() -> Scene {
    let mut scene = Scene::of_file();
    (scene.render.resolution, scene.render.photons) = ([160, 120], 50_000);
    scene
}

fn settings(session: &Session) -> RenderSettings {
    session.view().settings
}

fn factor(session: &Session) -> f32 {
    match settings(session).exposure {
        Exposure::Factor(factor) => factor,
        Exposure::Auto => panic!("a session has it decided"),
    }
}

/// A plant in its halls, with lamps inside.
fn plant(folder: &TempDir) -> Model {
    let path = folder.path().join("plant.trex");
    built::build_with(&path, "gen:pipes:60k", Voxels::Resolution(64));
    open_with(&path, 160, 2)
}

fn open_with(path: &Path, limit_mib: u64, threads: usize) -> Model {
    let threads = ThreadSource::Start(threads.try_into().unwrap());
    Model::open(path, &OpenOptions { threads, ..OpenOptions::with_limit(limit_mib << 20) }).unwrap()
}

#[test]
fn what_is_decided_depends_on_the_scene_alone() {
    let model = open(96);
    let expected = settings(&model.session(&of_file()).unwrap());
    assert!(expected.light == LightRig::Scene && expected.exposure != Exposure::Auto, "{expected:?}");
    let path = model.file().path();
    for (limit_mib, threads) in [(80, 1), (400, 3)] {
        let other = open_with(path, limit_mib, threads);
        assert_eq!(settings(&other.session(&of_file()).unwrap()), expected);
    }
    let mut seeded = of_file();
    seeded.render.seed = 99;
    assert_eq!(settings(&model.session(&seeded).unwrap()).exposure, expected.exposure);
    // What is given stays, and another camera decides nothing anew.
    let mut given = of_file();
    (given.render.exposure, given.render.light) = (Exposure::Factor(3.5), LightRig::Studio);
    let mut session = model.session(&given).unwrap();
    assert_eq!(
        (settings(&session).exposure, settings(&session).light),
        (Exposure::Factor(3.5), LightRig::Studio)
    );
    let mut camera = session.view().camera;
    camera.target[0] += 1.0;
    session.apply(Event::Camera(camera)).unwrap();
    assert_eq!(settings(&session).exposure, Exposure::Factor(3.5));
}

/// The limit that a refusal names does, also where a look comes before the picture.
#[test]
fn a_look_takes_no_more_than_its_picture() {
    let path = open(96).file().path().to_path_buf();
    for resolution in [[160, 120], [16, 16], [3, 700]] {
        let mut scene = of_file();
        scene.render.resolution = resolution;
        let refused = open_with(&path, 27, 2).session(&scene).err().unwrap();
        let smallest = refused.smallest_limit_bytes().expect("it is named");
        let threads = ThreadSource::Start(2.try_into().unwrap());
        let model =
            Model::open(&path, &OpenOptions { threads, ..OpenOptions::with_limit(smallest) }).unwrap();
        let mut session = model.session(&scene).unwrap_or_else(|error| panic!("{resolution:?}: {error}"));
        session.render(1, &|| false, &mut |_, _| ControlFlow::Continue(()));
        assert!(model.budget().peak_bytes() <= smallest - RESERVE_BYTES);
    }
}

/// How bright nine tenths of the surfaces are, found in a picture of another size, seed and count of samples than the
/// look's.
#[test]
fn the_exposure_shows_the_surfaces_whatever_is_behind_them() {
    let model = open(160);
    for sky in [None, Some(0.01), Some(40.0)] {
        let mut scene = of_file();
        (scene.render.spp, scene.render.seed) = (8, 5);
        if let Some(radiance) = sky {
            scene.lights = vec![
                Light::Sky { radiance: [radiance; 3] },
                Light::Directional { direction: [0.2, -1.0, -0.4], irradiance: [2.0; 3] },
            ];
        }
        let layers = Layers { depth: true, ..Layers::default() };
        let options = SessionOptions { layers, ..SessionOptions::default() };
        let mut session = model.session_with(&scene, &options).unwrap();
        session.illuminate(&|| false, &mut |_, _| {}).unwrap();
        session.render(8, &|| false, &mut |_, _| ControlFlow::Continue(()));
        let (film, factor) = (session.film(), factor(&session));
        let mut shown: Vec<f32> = (0..160 * 120u32)
            .map(|at| [at % 160, at / 160])
            .filter(|&pixel| film.depth(pixel) < f32::INFINITY)
            .map(|pixel| film.radiance(pixel))
            .map(|[r, g, b]| factor * (0.2126 * r + 0.7152 * g + 0.0722 * b))
            .collect();
        assert!(shown.len() > 1000 && shown.len() < 160 * 120, "{} pixels", shown.len());
        shown.sort_by(f32::total_cmp);
        let bright = shown[shown.len() * 9 / 10];
        assert!((0.5..0.72).contains(&bright), "sky {sky:?}: they are shown as {bright}");
    }
}

/// The box of a model is not the model: what is seen goes from edge to edge of the picture, one way or the other.
#[test]
fn the_opening_view_is_filled() {
    let folder = tempfile::tempdir().unwrap();
    for (spec, resolution) in [
        ("gen:isosurface:20k", [160, 90]),
        ("gen:pipes:60k", [160, 90]),
        ("gen:scan:60k", [160, 90]),
        ("gen:scan:60k", [90, 160]),
        ("gen:isosurface:20k", [90, 160]),
    ] {
        let path = folder.path().join(format!("{}-{}.trex", &spec[4..7], resolution[0]));
        built::build_with(&path, spec, Voxels::Resolution(64));
        let mut scene = of_file();
        scene.render =
            RenderKeys { resolution, integrator: Method::Direct, filter: Filter::Off, ..scene.render };
        let layers = Layers { depth: true, ..Layers::default() };
        let options = SessionOptions { layers, ..SessionOptions::default() };
        let mut session = open_with(&path, 160, 2).session_with(&scene, &options).unwrap();
        session.render(1, &|| false, &mut |_, _| ControlFlow::Continue(()));
        let seen: Vec<[u32; 2]> = (0..resolution[0] * resolution[1])
            .map(|at| [at % resolution[0], at / resolution[0]])
            .filter(|&pixel| session.film().depth(pixel) < f32::INFINITY)
            .collect();
        let share = [0, 1].map(|axis| {
            let [least, most] = [seen.iter().map(|p| p[axis]).min(), seen.iter().map(|p| p[axis]).max()];
            let (least, most) = (least.unwrap(), most.unwrap());
            assert!(least > 0 && most + 1 < resolution[axis], "{spec} is cut off");
            f64::from(most + 1 - least) / f64::from(resolution[axis])
        });
        assert!(share[0].max(share[1]) > 0.8, "{spec} {resolution:?}: {share:?}");
    }
}

/// A plant that was opened as its user would was a black page: its lamps are inside.
#[test]
fn a_plant_is_lit_from_outside_and_by_its_lamps_inside() {
    let folder = tempfile::tempdir().unwrap();
    let model = plant(&folder);
    assert!(!model.file().emitters().is_empty());
    let outside = model.session(&of_file()).unwrap();
    assert_eq!(settings(&outside).light, LightRig::Studio);

    // A scene that has lamps is not lit by others; nor is one that says so.
    let mut lit = of_file();
    lit.lights = vec![Light::Sky { radiance: [1.0; 3] }];
    assert_eq!(settings(&model.session(&lit).unwrap()).light, LightRig::Scene);
    let mut said = of_file();
    said.render.light = LightRig::Scene;
    assert_eq!(settings(&model.session(&said).unwrap()).light, LightRig::Scene);

    // Inside it lamps do.
    let spec = datasets_gen::Spec::parse("gen:pipes:60k").unwrap();
    let views = datasets_gen::views(&spec);
    let view = views.iter().find(|view| view.name == "interior").unwrap();
    let mut inside = of_file();
    (inside.camera.position, inside.camera.target) = (Some(view.position), Some(view.target));
    let inside = model.session(&inside).unwrap();
    assert_eq!(settings(&inside).light, LightRig::Scene);
    assert!(factor(&inside) > 0.0 && factor(&inside) != factor(&outside));
}

/// Lamps that are off give the picture of the model's own light; studio adds a background.
#[test]
fn studio_is_light_beside_that_of_the_model() {
    let folder = tempfile::tempdir().unwrap();
    let model = plant(&folder);
    let mean = |light| {
        let mut scene = of_file();
        (scene.render.light, scene.render.spp) = (light, 2);
        let mut session = model.session(&scene).unwrap();
        session.illuminate(&|| false, &mut |_, _| {}).unwrap();
        session.render(2, &|| false, &mut |_, _| ControlFlow::Continue(()));
        (session.film().mean(), session.film().radiance([0, 0]))
    };
    let (own, nothing) = mean(LightRig::Scene);
    let (both, sky) = mean(LightRig::Studio);
    assert_eq!(nothing, [0.0; 3]);
    assert!(sky.iter().all(|&channel| channel > 0.1), "the background is {sky:?}");
    assert!((0..3).all(|channel| both[channel] > own[channel] + 0.05), "{own:?} {both:?}");
}
