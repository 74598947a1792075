//! Tests of the session: events, refusals, passes, memory.

use super::*;
use crate::image::film::film_bytes;
use crate::scene::settings::RenderKeys;
use crate::testing::{pool, view};
use crate::trace::{NaiveMesh, NaiveTriangle};
use trex_store::{Aabb, Code, Material};

fn session(budget: &Budget) -> Result<Session<NaiveMesh>> {
    let corners = [[-9.0, -9.0, 0.0], [9.0, -9.0, 0.0], [0.0, 9.0, 0.0]];
    let mesh = NaiveMesh::new(vec![NaiveTriangle { corners, material: 0 }]);
    let bounds = Aabb { lo: [-9.0, -9.0, 0.0], hi: [9.0, 9.0, 0.0] };
    let model = Model { bounds, materials: vec![Material::default()], emitters: vec![], voxels: None };
    let lights = vec![Light::Directional { direction: [0.0, 0.0, -1.0], irradiance: [1.0; 3] }];
    let keys = RenderKeys { resolution: [16, 16], n_shadow: 1, seed: 0, ..RenderKeys::default() };
    let view = view([0.0, 0.0, 3.0], 30.0, lights, keys);
    let setup =
        SessionSetup { model, view, layers: Layers::default(), tracers: vec![mesh; 2], pool: pool(2) };
    Session::new(setup, budget)
}

fn mean(session: &mut Session<NaiveMesh>) -> f64 {
    session.render(1, &|| false, &mut |_, _| ControlFlow::Continue(()));
    session.film().mean()[0] * std::f64::consts::PI
}

#[test]
fn events_change_the_picture_and_refused_ones_do_not() {
    let mut session = session(&Budget::unlimited()).unwrap();
    let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-5, "{a} {b}");
    near(mean(&mut session), 0.7);
    let darker = MaterialEdit { kd: Some([0.2; 3]), ..MaterialEdit::default() };
    session.apply(Event::Material { index: 0, edit: darker }).unwrap();
    assert_eq!(session.film().samples(), 0);
    near(mean(&mut session), 0.2);
    let lights = vec![Light::Directional { direction: [0.0, 0.0, -1.0], irradiance: [3.0; 3] }];
    session.apply(Event::Lights(lights)).unwrap();
    near(mean(&mut session), 0.6);
    let away = Camera { target: [0.0, 0.0, 9.0], ..session.view().camera };
    session.apply(Event::Camera(away)).unwrap();
    near(mean(&mut session), 0.0);

    let nowhere = Camera { target: away.position, ..away };
    let dark = Light::Sky { radiance: [-1.0; 3] };
    let lamp = MaterialEdit { ke: Some([1.0; 3]), ..MaterialEdit::default() };
    let before = session.view().camera;
    for event in [Event::Camera(nowhere), Event::Lights(vec![dark]), Event::Material { index: 0, edit: lamp }]
    {
        assert_eq!(session.apply(event).unwrap_err().code(), Code::SceneFormat);
    }
    assert_eq!((session.view().camera, session.film().samples()), (before, 1));
    assert_eq!(session.model().materials[0].ke, [0.0; 3]);
}

#[test]
fn passes_grow_and_may_be_ended() {
    let mut session = session(&Budget::unlimited()).unwrap();
    let mut seen = vec![];
    let stats = session.render(13, &|| false, &mut |film, stats| {
        seen.push(film.samples());
        if stats.spp == 8 { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    assert_eq!((seen.as_slice(), stats.complete), (&[1, 2, 4, 8][..], false));
    let stats = session.render(13, &|| false, &mut |_, _| ControlFlow::Continue(()));
    assert_eq!((stats.spp, stats.passes, stats.total.samples, stats.complete), (13, 2, 5 * 256, true));
}

#[test]
fn a_film_that_does_not_fit_is_refused() {
    let bytes = pass_bytes([16, 16], 2) + film_bytes([16, 16], Layers::default());
    let limit = trex_store::RESERVE_BYTES + bytes;
    assert!(session(&Budget::new(limit)).is_ok());
    let error = session(&Budget::new(limit - 1)).unwrap_err();
    assert_eq!((error.code(), error.smallest_limit_bytes()), (Code::MemoryLimit, Some(limit)));
}
