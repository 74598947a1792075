//! The frames of a live session, by what they show: a whole picture at once, exact tiles that stay through edits, and
//! in the end the picture that comes without a deadline.

use crate::command::folder;
use crate::fixtures::built_in;
use std::ops::ControlFlow;
use std::time::Duration;
use trex_model::{LiveSession, Model, OpenOptions, Pace, Session, SessionOptions, ThreadSource};
use trex_render::{
    Camera, Event, FetchBlock, Fov, FrameOptions, FrameProgress, FrameReport, Light, MaterialEdit, Method,
    RenderKeys, Scene, TileOrder,
};
use trex_store::Budget;

const RESOLUTION: [u32; 2] = [128, 96];
const TILES: u32 = 16 * 12;
const BLOCK: u32 = 16;

/// A model whose pages are all on the disk at first.
struct Stage {
    model: Model,
    _folder: tempfile::TempDir,
}

impl Stage {
    fn new() -> Stage {
        Stage::of("gen:isosurface:58k")
    }

    /// As `trex build` makes it of `what`.
    fn of(what: &str) -> Stage {
        let inside = folder();
        built_in(inside.path(), what, "iso.trex");
        let options = OpenOptions {
            budget: Budget::unlimited(),
            threads: ThreadSource::Start(2.try_into().unwrap()),
            ..OpenOptions::with_limit(0)
        };
        let model = Model::open(&inside.path().join("iso.trex"), &options).unwrap();
        Stage { model, _folder: inside }
    }

    /// A session with its photons, if it has any.
    fn session(&self, method: Method) -> Session {
        let mut scene = Scene::default();
        let keys = RenderKeys::default();
        scene.render = RenderKeys { integrator: method, resolution: RESOLUTION, photons: 100_000, ..keys };
        let options = SessionOptions { pace: Pace::InFrames, ..SessionOptions::default() };
        let mut session = self.model.session_with(&scene, &options).unwrap();
        // Near enough for surfaces that are wider than the grid of a preview.
        let camera = Camera { fov: Fov::X(8.0), ..session.view().camera };
        session.apply(Event::Camera(camera)).unwrap();
        session.illuminate(&|| false, &mut |_, _| {}).unwrap();
        session
    }

    fn live(&self, method: Method) -> LiveSession {
        // Long enough for a frame to end by its work, whatever else the machine does.
        self.live_for(method, Duration::from_secs(60))
    }

    /// With frames of `t_max`.
    fn live_for(&self, method: Method, t_max: Duration) -> LiveSession {
        let options = FrameOptions {
            t_max,
            fetch_block: FetchBlock::Tiles(BLOCK),
            order: TileOrder::Row,
            ..FrameOptions::default()
        };
        self.session(method).go_live(options).unwrap()
    }
}

fn frame(session: &mut LiveSession) -> FrameReport {
    session.frame(1, &|| false)
}

fn frame_until(session: &mut LiveSession, progress: FrameProgress) -> FrameReport {
    (0..10_000).map(|_| frame(session)).find(|report| report.progress >= progress).expect("it gets there")
}

fn shown(session: &LiveSession) -> Vec<[f32; 3]> {
    let [width, height] = RESOLUTION;
    (0..height).flat_map(|y| (0..width).map(move |x| session.shown([x, y]))).collect()
}

/// The picture at leisure, of one sample and of many.
fn at_leisure(stage: &Stage, method: Method, spp: u32, event: Option<Event>) -> Vec<[f32; 3]> {
    let mut session = stage.session(method);
    if let Some(event) = event {
        session.apply(event).unwrap();
        session.illuminate(&|| false, &mut |_, _| {}).unwrap();
    }
    session.render(spp, &|| false, &mut |_, _| ControlFlow::Continue(()));
    let [width, height] = RESOLUTION;
    (0..height).flat_map(|y| (0..width).map(move |x| [x, y])).map(|at| session.film().radiance(at)).collect()
}

/// Root of the mean squared difference of the first channels.
fn rmse(a: &[[f32; 3]], b: &[[f32; 3]]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| f64::from(a[0] - b[0]).powi(2));
    (squares.sum::<f64>() / a.len() as f64).sqrt()
}

#[test]
fn the_first_frames_show_a_whole_picture_without_a_page() {
    let stage = Stage::new();
    let mut direct = None;
    for method in [Method::Photon, Method::Direct, Method::Ao, Method::Path, Method::FullGi] {
        let mut session = stage.live(method);
        let read = stage.model.pool().unwrap().stats().pages_read;
        let rough = frame(&mut session);
        assert_eq!((rough.progress, rough.sample_step), (FrameProgress::Preview, Some(4)), "{method:?}");
        assert_eq!((rough.hole_tiles, rough.preview_tiles), (0, TILES));
        // The first of all finds an empty pool, asks for nothing, and no ray has waited.
        assert!(
            method != Method::Photon || stage.model.pool().unwrap().stats().pages_read == read,
            "{method:?}"
        );
        let whole = frame(&mut session);
        assert_eq!((whole.progress, whole.sample_step), (FrameProgress::Preview, Some(2)), "{method:?}");
        assert!(whole.preview_rays.primary > rough.preview_rays.primary);
        assert_eq!(
            (session.film().samples(), session.film().mean()),
            (0, [0.0; 3]),
            "nothing is on the film"
        );

        // It is near the picture: nearer than a flat one of the right mean, for all the noise of one ray of a kind.
        // Those of path and full-gi show direct light alone.
        let exact = match method {
            Method::Direct | Method::Path | Method::FullGi => {
                direct.get_or_insert_with(|| at_leisure(&stage, Method::Direct, 64, None)).clone()
            }
            _ => at_leisure(&stage, method, 64, None),
        };
        let mean = exact.iter().map(|p| p[0]).sum::<f32>() / exact.len() as f32;
        let (error, flat) = (rmse(&shown(&session), &exact), rmse(&vec![[mean; 3]; exact.len()], &exact));
        assert!(error < 0.7 * flat, "{method:?}: {error}, flat {flat}");
    }
}

/// As fine as in the end: what a tile shows is what its film holds, and the rest is the preview.
#[test]
fn tiles_replace_the_preview_one_by_one() {
    let stage = Stage::new();
    let mut session = stage.live(Method::Direct);
    frame_until(&mut session, FrameProgress::Part);
    let report = frame_until(&mut session, FrameProgress::Block);
    assert_eq!((report.block_tiles, report.sample_step), (BLOCK, Some(2)));
    assert!((report.block_share - f64::from(BLOCK) / f64::from(TILES)).abs() < 1e-12);
    assert!(report.preview_tiles <= TILES - BLOCK && report.preview_tiles > 0);
    let report = frame_until(&mut session, FrameProgress::Done);
    assert_eq!((report.preview_tiles, report.sample_step), (0, Some(1)));
    assert_eq!(shown(&session), at_leisure(&stage, Method::Direct, 1, None));
}

#[test]
fn an_edit_shows_everywhere_at_once_and_the_end_is_that_of_the_edit() {
    let stage = Stage::new();
    let dark = Event::Lights(vec![Light::Sky { radiance: [0.0; 3] }]);
    let dim = MaterialEdit { kd: Some([0.1; 3]), ..MaterialEdit::default() };
    let dim = Event::Material { index: 0, edit: dim };
    for (method, event) in [(Method::Direct, dark), (Method::Direct, dim.clone()), (Method::Photon, dim)] {
        let mut session = stage.live(method);
        frame_until(&mut session, FrameProgress::Done);
        let before = shown(&session);
        session.apply(event.clone()).unwrap();
        let report = frame(&mut session);
        assert_eq!((report.sample_step, report.preview_tiles), (Some(4), TILES));
        let (after, end) = (shown(&session), at_leisure(&stage, method, 1, Some(event)));
        assert!(rmse(&after, &end) < 0.5 * rmse(&before, &end), "{method:?}");
        frame_until(&mut session, FrameProgress::Done);
        assert_eq!(shown(&session), end, "{method:?}");
    }
}

/// While photons come, exact tiles of less light stay until their turn: none goes back to the preview.
#[test]
fn exact_tiles_stay_while_more_light_comes() {
    let stage = Stage::new();
    let mut session = stage.live(Method::Photon);
    frame_until(&mut session, FrameProgress::Done);
    session.apply(Event::Lights(vec![Light::Sky { radiance: [2.0; 3] }])).unwrap();
    let mut exact = 0;
    let mut shares = vec![];
    loop {
        let report = frame(&mut session);
        if report.progress > FrameProgress::Preview {
            let now = TILES - report.preview_tiles;
            assert!(now >= exact, "{now} of {exact} exact tiles are left");
            exact = now;
        }
        shares.push(report.light_share);
        if report.progress == FrameProgress::Done {
            break;
        }
    }
    assert!(shares.is_sorted() && shares[0] == 0.0 && shares[shares.len() - 1] == 1.0, "{shares:?}");
}

/// Events that follow each other before any tile is done get one frame each, as fine as fits into it.
#[test]
fn a_hand_that_moves_gets_the_finest_picture_that_fits() {
    let stage = Stage::new();
    let mut session = stage.live(Method::Direct);
    frame(&mut session);
    let mut camera = session.view().camera;
    for _ in 0..3 {
        camera.position[0] += 0.01;
        session.apply(Event::Camera(camera)).unwrap();
        let report = frame(&mut session);
        assert_eq!((report.progress, report.sample_step), (FrameProgress::Preview, Some(2)));
    }
    frame_until(&mut session, FrameProgress::Done);
    session.apply(Event::Camera(camera)).unwrap();
    assert_eq!(frame(&mut session).sample_step, Some(4), "a hand that rested");
}

/// A hand so fast that its pictures have the coarsest grid alone saw voxels for as long as it moved: finer ones alone
/// asked for pages.
#[test]
fn a_hand_that_never_rests_sees_the_mesh() {
    let stage = Stage::of("gen:isosurface:58k --voxels 64");
    let mut session = stage.live_for(Method::Direct, Duration::from_nanos(1));
    let pages_read = || stage.model.pool().unwrap().stats().pages_read;
    let (before, mut camera) = (pages_read(), session.view().camera);
    let moves = (0..200).take_while(|_| {
        camera.position[0] += 1e-4;
        session.apply(Event::Camera(camera)).unwrap();
        assert_eq!(frame(&mut session).sample_step, Some(8));
        std::thread::sleep(Duration::from_millis(10));
        pages_read() == before
    });
    assert!(moves.count() < 200, "no page has come");
}

/// Light of the pictures on the way is the display's alone: whatever a hand did, the end is the picture at leisure.
#[test]
fn light_of_pictures_on_the_way_is_not_in_the_end() {
    let stage = Stage::new();
    let mut session = stage.live(Method::Photon);
    let mut camera = session.view().camera;
    for step in 0..12 {
        camera.position[step % 3] += 0.02;
        session.apply(Event::Camera(camera)).unwrap();
        // Some have exact tiles, whose light is carried on.
        let progress = if step % 4 == 3 { FrameProgress::Block } else { FrameProgress::Preview };
        frame_until(&mut session, progress);
    }
    frame_until(&mut session, FrameProgress::Done);
    let end = at_leisure(&stage, Method::Photon, 1, Some(Event::Camera(camera)));
    assert!(shown(&session) == end);
}

/// A file without voxels was refused. Nothing stands in for the pages that its previews lack, no ray of theirs waits,
/// and the end is the picture at leisure.
#[test]
fn frames_do_without_voxels() {
    let stage = Stage::of("gen:isosurface:58k --no-asvo");
    for method in [Method::Direct, Method::Path, Method::FullGi, Method::Ao, Method::DebugPages] {
        let mut session = stage.live(method);
        let rough = frame(&mut session);
        assert_eq!((rough.progress, rough.sample_step), (FrameProgress::Preview, Some(4)), "{method:?}");
        frame_until(&mut session, FrameProgress::Done);
        let end = shown(&session);
        assert!(end == at_leisure(&stage, method, 1, None), "{method:?}");
        // Now that its pages are there, a preview shows the mesh.
        let moved =
            Camera { position: session.view().camera.position.map(|x| x + 1e-6), ..session.view().camera };
        session.apply(Event::Camera(moved)).unwrap();
        assert_eq!(frame(&mut session).progress, FrameProgress::Preview);
        let mean = end.iter().map(|p| p[0]).sum::<f32>() / end.len() as f32;
        let (error, flat) = (rmse(&shown(&session), &end), rmse(&vec![[mean; 3]; end.len()], &end));
        // Those of the others show direct light alone, or one ray of many.
        let is_alike = matches!(method, Method::Direct | Method::DebugPages);
        assert!(error < 0.9 * flat || !is_alike, "{method:?}: {error}, flat {flat}");
    }
}
