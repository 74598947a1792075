//! Tests of the light of earlier pictures in those of a session: how much less noise they have with it.

use super::*;
use crate::scene::camera::Camera;

/// A lamp over the floor at some x.
fn lamp(x: f64) -> Event {
    let (edge_u, edge_v) = ([0.0, 2.0, 0.0], [2.0, 0.0, 0.0]);
    Event::Lights(vec![Light::Rect { corner: [x, -1.0, 1.0], edge_u, edge_v, radiance: [3.0; 3] }])
}

fn moved(camera: Camera, by: f64) -> Event {
    let along = |[x, y, z]: [f64; 3]| [x + by, y, z];
    Event::Camera(Camera { position: along(camera.position), target: along(camera.target), ..camera })
}

/// How much pictures of `side` pixels along a side and of other random numbers differ: of the floor under the lamp,
/// after `events` of the camera at first, a frame each.
fn noise(side: u32, options: FrameOptions, events: impl Fn(Camera) -> Vec<Vec<Event>>) -> f32 {
    let shown = |seed: u64| {
        let resolution = [side, side];
        let keys =
            RenderKeys { resolution, n_shadow: 1, integrator: Method::Direct, seed, ..RenderKeys::default() };
        let options = FrameOptions { t_max: Duration::from_secs(60), ..options };
        let mut live = floor_demanding(0, keys).go_live(options).unwrap();
        live.apply(lamp(1.0)).unwrap();
        live.frame(1, &|| false);
        for together in events(live.view.camera) {
            together.into_iter().for_each(|event| live.apply(event).unwrap());
            live.frame(1, &|| false);
        }
        (0..side * side).map(|at| live.shown([at % side, at / side])[1]).collect::<Vec<f32>>()
    };
    let pictures: Vec<_> = (1..=8).map(shown).collect();
    let variance = |at: usize| {
        let mean = pictures.iter().map(|picture| picture[at]).sum::<f32>() / 8.0;
        pictures.iter().map(|picture| (picture[at] - mean).powi(2)).sum::<f32>()
    };
    (0..pictures[0].len()).map(variance).sum()
}

/// From picture to picture of a camera that moves a little the noise of the preview falls; less where a lamp moves a
/// little, too, and not where that moves far, nor where nothing is to be carried.
#[test]
fn previews_of_a_moving_camera_have_the_light_of_those_before() {
    let events = |by: f64| {
        move |camera| {
            let lamps = |step: u32| (by > 0.0).then(|| lamp(1.0 + by * f64::from(step % 2)));
            let step =
                |step: u32| [moved(camera, 1e-3 * f64::from(step))].into_iter().chain(lamps(step)).collect();
            (1..=8).map(step).collect()
        }
    };
    let options = FrameOptions { caches_light: false, ..FrameOptions::default() };
    let alone = noise(48, FrameOptions { carries_light: false, ..options }, events(0.0));
    let [carried, lit_alike, lit_anew] = [0.0, 1e-3, 4.0].map(|by| noise(48, options, events(by)));
    assert!(carried < 0.5 * alone && lit_anew > 0.8 * alone, "{carried} {lit_alike} {lit_anew} {alone}");
    assert!(carried < lit_alike && lit_alike < 0.9 * alone, "{carried} {lit_alike} {lit_anew} {alone}");
}

/// A view that is seen again after another, of which nothing is seen in it, has less noise where light is kept in the
/// world; not where a lamp has moved since. In a picture of so few samples that smoothing leaves noise.
#[test]
fn previews_of_a_view_that_comes_back_have_the_light_of_the_time_before() {
    let events = |by: f64| {
        move |camera| {
            let lamps = |step: u32| (by > 0.0).then(|| lamp(1.0 + by * f64::from(step)));
            let event = |to: f64, step: u32| [moved(camera, to)].into_iter().chain(lamps(step)).collect();
            (1..=8).flat_map(|step| [event(50.0, step), event(0.0, step)]).collect()
        }
    };
    let alone = noise(8, FrameOptions { caches_light: false, ..FrameOptions::default() }, events(0.0));
    let [kept, lit_anew] = [0.0, 1e-3].map(|by| noise(8, FrameOptions::default(), events(by)));
    assert!(kept < 0.5 * alone && lit_anew > 0.8 * alone, "{kept} {lit_anew} {alone}");
}
