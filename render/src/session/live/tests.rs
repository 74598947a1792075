//! Tests of frames: what is mixed of samples and the picture on show, and light that changes under way.

mod carried;

use super::*;
use crate::scene::method::{Method, Shadows};
use crate::scene::settings::RenderKeys;
use crate::session::tests::{DemandMesh, floor, floor_demanding, roofed_floor, sun};
use crate::session::{FetchBlock, FrameProgress};
use crate::shading::light::Light;
use crate::trace::Answer;
use std::ops::ControlFlow;

/// The picture on show is worth some samples, as the preview and with the light of samples in it, until it is done.
#[test]
fn the_preview_is_mixed_in_while_samples_are_few() {
    let keys = RenderKeys { resolution: [16, 16], n_shadow: 1, ..RenderKeys::default() };
    let options = FrameOptions {
        t_max: Duration::from_secs(60),
        fetch_block: FetchBlock::Tiles(4),
        ..FrameOptions::default()
    };
    let mut live = floor_demanding(0, keys).go_live(options).unwrap();
    // A lamp beside the floor's middle: each sample finds another part of it.
    let (edge_u, edge_v) = ([0.0, 2.0, 0.0], [2.0, 0.0, 0.0]);
    let lamp = Light::Rect { corner: [1.0, -1.0, 1.0], edge_u, edge_v, radiance: [3.0; 3] };
    live.apply(Event::Lights(vec![lamp])).unwrap();
    let (mut samples, mut mixed, mut worths) = (vec![], 0, vec![]);
    while samples.last() != Some(&3) {
        let progress = live.frame(3, &|| false).progress;
        let n = live.film.tile_samples(0);
        for pixel in (0..64).map(|at| [at % 8, at / 8]) {
            let film = live.film.radiance(pixel);
            let preview = live.live.display.radiances(pixel).next().unwrap();
            let worth = live.live.display.worth(0, pixel);
            worths.push(worth);
            let expected = match progress {
                FrameProgress::Preview => preview,
                FrameProgress::Done => film,
                _ => std::array::from_fn(|c| (n as f32 * film[c] + worth * preview[c]) / (n as f32 + worth)),
            };
            let found = live.shown(pixel);
            assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 1e-5), "{progress:?} {pixel:?}");
            mixed += u32::from(expected != film && expected != preview);
        }
        samples.push(n);
    }
    assert!(samples.contains(&1) && samples.contains(&2) && mixed > 0, "{samples:?} {mixed}");
    worths.dedup();
    assert!(worths[0] == 1.5 && worths.len() > 1 && worths.iter().all(|worth| *worth > 0.0), "{worths:?}");
}

/// Frames of three tiles each, of a floor with a lamp over it.
fn floor_of_three_tiles_a_frame(t_max: Duration) -> LiveSession<DemandMesh> {
    let keys = RenderKeys { resolution: [32, 16], n_shadow: 1, ..RenderKeys::default() };
    let (fetch_block, order) = (FetchBlock::Tiles(3), TileOrder::ZCurve);
    let options = FrameOptions { t_max, fetch_block, order, ..FrameOptions::default() };
    let mut live = floor_demanding(0, keys).go_live(options).unwrap();
    let (edge_u, edge_v) = ([0.0, 2.0, 0.0], [2.0, 0.0, 0.0]);
    let lamp = Light::Rect { corner: [1.0, -1.0, 1.0], edge_u, edge_v, radiance: [3.0; 3] };
    live.apply(Event::Lights(vec![lamp])).unwrap();
    live
}

/// The pixels of a picture of 32 x 16 and their tiles.
fn pixels_of_tiles() -> impl Iterator<Item = ([u32; 2], u32)> {
    (0..512).map(|at| [at % 32, at / 32]).map(|pixel| (pixel, pixel[1] / 8 * 4 + pixel[0] / 8))
}

/// True where voxels are on show beside no exact sample, at pixels of the grid.
fn shows_voxels(live: &LiveSession<DemandMesh>) -> bool {
    let is_sample = |pixel: [u32; 2]| pixel.iter().all(|v| v % 2 == 0);
    pixels_of_tiles().any(|(pixel, tile)| {
        is_sample(pixel)
            && live.film.tile_samples(tile) == 0
            && live.live.display.has_voxels_before(f32::INFINITY, pixel)
    })
}

/// The preview saw voxels alone, or mesh: the same floor. Voxels count for nothing in any pixel that has an exact
/// sample, until they are looked at again.
#[test]
fn no_stand_in_shines_through_exact_samples() {
    for is_absent in [true, false] {
        let mut live = floor_of_three_tiles_a_frame(Duration::from_millis(50));
        live.session.tracers[0].is_absent = is_absent;
        while live.live.display.step() != Some(2) {
            live.frame(3, &|| false);
        }
        assert_eq!(shows_voxels(&live), is_absent);
        live.session.tracers[0].is_absent = false;
        let (mut previews, mut alone) = (0, 0);
        while live.frame(3, &|| false).progress != FrameProgress::Done {
            let looked_again = live.live.display.refreshes() > 0;
            assert!(!looked_again || !shows_voxels(&live));
            for (pixel, tile) in pixels_of_tiles() {
                let worth = live.live.display.worth(tile, pixel);
                let is_exact = live.film.tile_samples(tile) > 0;
                let is_preview = is_exact && worth == 1.5;
                assert!(!is_preview || !is_absent || looked_again, "{pixel:?}");
                if is_exact && worth == 0.0 {
                    assert_eq!(live.shown(pixel), live.film.radiance(pixel), "{pixel:?}");
                    alone += u32::from(!looked_again);
                }
                previews += u32::from(is_preview);
            }
        }
        assert!(previews > 0 && (alone >= 3 * 64) == is_absent, "{previews} {alone}");
    }
}

/// Mesh that comes while a rough picture of voxels is on show: the first tiles come before the finest grid, which is
/// then of mesh alone, beside them as they are; and the film ends as that of a picture at leisure.
#[test]
fn a_whole_picture_waits_for_mesh_on_its_way() {
    let mut live = floor_of_three_tiles_a_frame(Duration::from_secs(60));
    live.session.tracers[0].is_absent = true;
    let rough = live.frame(2, &|| false);
    assert_eq!(
        (rough.progress, rough.sample_step, shows_voxels(&live)),
        (FrameProgress::Preview, Some(4), true)
    );
    live.session.tracers[0].is_absent = false;
    let block = live.frame(2, &|| false);
    assert_eq!((block.progress, block.sample_step), (FrameProgress::Block, Some(4)));
    let film = |live: &LiveSession<_>| {
        pixels_of_tiles().map(|(pixel, _)| live.film.radiance(pixel)).collect::<Vec<_>>()
    };
    let exact = film(&live);
    let whole = live.frame(2, &|| false);
    assert_eq!(
        (whole.progress, whole.sample_step, shows_voxels(&live)),
        (FrameProgress::Block, Some(2), false)
    );
    assert!(film(&live) == exact && whole.preview_samples > 0 && whole.preview_tiles == 5);
    while live.frame(2, &|| false).progress != FrameProgress::Done {}
    let found = film(&live);
    let mut session = live.into_session();
    session.render(2, &|| false, &mut |_, _| ControlFlow::Continue(()));
    assert!(pixels_of_tiles().zip(found).all(|((pixel, _), found)| session.film().radiance(pixel) == found));
}

/// A preview has the shadows of the mesh where that is resident, and those of voxels where it is not, or where these
/// alone are asked for.
#[test]
fn a_preview_has_the_shadows_of_the_mesh_that_is_there() {
    let lit = |integrator: Method, shadows: Shadows, occluded: Answer<bool>| {
        let keys = RenderKeys {
            resolution: [16, 16],
            n_shadow: 1,
            n_gather: 0,
            integrator,
            ..RenderKeys::default()
        };
        let mut live = roofed_floor(RenderKeys { shadows, ..keys }).go_live(FrameOptions::default()).unwrap();
        live.session.tracers[0].occluded = Some(occluded);
        while live.live.display.step() != Some(2) {
            live.frame(1, &|| false);
        }
        live.shown([8, 8])[1] * std::f32::consts::PI
    };
    let near = |found: f32, expected: f32| assert!((found - expected).abs() < 1e-3, "{found} {expected}");
    for (integrator, by_voxels) in [(Method::Photon, 0.0), (Method::Direct, 0.7)] {
        near(lit(integrator, Shadows::Mesh, Answer::Exact(false)), 0.7);
        near(lit(integrator, Shadows::Mesh, Answer::Exact(true)), 0.0);
        near(lit(integrator, Shadows::Mesh, Answer::Blocked), 0.0);
        near(lit(integrator, Shadows::Voxel, Answer::Exact(false)), by_voxels);
    }
}

/// Light that changes by itself while samples are taken: what was shown stays, and counts for some beside new ones.
#[test]
fn what_was_shown_counts_on_when_light_has_changed() {
    let keys = RenderKeys { resolution: [8, 8], n_shadow: 1, ..RenderKeys::default() };
    let t_max = Duration::from_secs(60);
    let options = FrameOptions { t_max, fetch_block: FetchBlock::Tiles(1), ..FrameOptions::default() };
    let mut live = floor_demanding(0, keys).go_live(options).unwrap();
    let (edge_u, edge_v) = ([0.0, 2.0, 0.0], [2.0, 0.0, 0.0]);
    let lamp = Light::Rect { corner: [1.0, -1.0, 1.0], edge_u, edge_v, radiance: [3.0; 3] };
    live.apply(Event::Lights(vec![lamp])).unwrap();
    let pixels = || (0..64).map(|at| [at % 8, at / 8]);
    let mut changed = 0;
    for _ in 0..3 {
        while live.film.tile_samples(0) < 2 {
            live.frame(9, &|| false);
        }
        let before: Vec<_> = pixels().map(|pixel| live.shown(pixel)).collect();
        live.begin_light();
        let worth = live.live.display.worth(0, [0, 0]);
        assert!((2.0..=4.0).contains(&worth), "{worth}");
        let shown: Vec<_> = pixels().map(|pixel| live.shown(pixel)).collect();
        // As it was, to the bits that are kept of it: thirteen of the greatest channel.
        for (before, kept) in before.iter().zip(&shown) {
            let most = before.iter().fold(0.0, |most: f32, &x| most.max(x)) / 8000.0;
            assert!((0..3).all(|c| (before[c] - kept[c]).abs() <= most), "{before:?} {kept:?}");
        }
        let stamp = live.tile_stamp(0);
        assert_ne!(live.frame(9, &|| false).preview_tiles, 1);
        assert_ne!(live.tile_stamp(0), stamp);
        let n = live.film.tile_samples(0) as f32;
        assert!(n > 0.0);
        for (pixel, before) in pixels().zip(&shown) {
            let (film, found) = (live.film.radiance(pixel), live.shown(pixel));
            let expected: [f32; 3] = std::array::from_fn(|c| (n * film[c] + worth * before[c]) / (n + worth));
            assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 1e-5), "{found:?} {expected:?}");
            changed += u32::from(film != *before);
        }
    }
    assert!(changed > 0);
}

/// The light of `full-gi` after an edit: on its way while frames go on, the one before on show meanwhile, and in the
/// end the film of a session that had it from the beginning.
#[test]
fn full_gi_lights_itself_anew_while_frames_go_on() {
    let keys = RenderKeys {
        resolution: [16, 16],
        n_shadow: 1,
        integrator: Method::FullGi,
        photons: 20_000,
        k_nearest: 16,
        ..RenderKeys::default()
    };
    let options = FrameOptions { t_max: Duration::from_millis(20), ..FrameOptions::default() };
    let film = |film: &Film| (0..256).map(|at| film.radiance([at % 16, at / 16])).collect::<Vec<_>>();
    let at_leisure = |irradiance| {
        let mut session = floor(keys);
        session.apply(Event::Lights(sun(irradiance))).unwrap();
        session.illuminate(&|| false, &mut |_, _| {}).unwrap();
        session.render(2, &|| false, &mut |_, _| ControlFlow::Continue(()));
        film(session.film())
    };
    let mut live = floor(keys).go_live(options).unwrap();
    for irradiance in [1.0, 3.0] {
        live.apply(Event::Lights(sun(irradiance))).unwrap();
        let mut shares = vec![];
        while live.frame(2, &|| false).progress != FrameProgress::Done {
            shares.push(live.light.share());
            assert!(shares.len() < 10_000);
        }
        assert!(shares.is_sorted() && shares[0] < 1.0, "{shares:?}");
        assert!(film(live.film()) == at_leisure(irradiance), "{irradiance}");
        // An event in between forgets what was on its way.
        live.apply(Event::Lights(sun(2.0))).unwrap();
        for _ in 0..4 {
            live.frame(2, &|| false);
        }
    }
}

/// Frames of a tile each, whatever the pages in demand: four tiles at the error that was asked for, and done.
#[test]
fn frames_are_as_exact_as_was_asked_for_whatever_the_demand() {
    for percent in [0, 85, 86, 100] {
        let keys = RenderKeys { resolution: [16, 16], n_shadow: 1, lod_error: 1.0, ..RenderKeys::default() };
        let t_max = Duration::from_secs(60);
        let options = FrameOptions { t_max, fetch_block: FetchBlock::Tiles(1), ..FrameOptions::default() };
        let mut live = floor_demanding(percent, keys).go_live(options).unwrap();
        let distance = live.world.lod_distance;
        let mut tiles = 0;
        while live.frame(1, &|| false).progress != FrameProgress::Done {
            assert!(tiles < 99 && live.world.lod_distance == distance && distance.is_finite());
            tiles += 1;
        }
        let LiveSession { session, live } = &mut live;
        assert_eq!(live.tiles.is_scarce(&session.tracers), percent > 85);
    }
}

/// From an event to the first frame after it what was on show stays, as its samples are.
#[test]
fn what_was_on_show_stays_until_the_first_frame_after_an_event() {
    let keys =
        RenderKeys { resolution: [48, 48], n_shadow: 1, integrator: Method::Direct, ..RenderKeys::default() };
    let mut live = floor_demanding(0, keys).go_live(FrameOptions::default()).unwrap();
    let (edge_u, edge_v) = ([0.0, 2.0, 0.0], [2.0, 0.0, 0.0]);
    let lamp = Light::Rect { corner: [1.0, -1.0, 1.0], edge_u, edge_v, radiance: [3.0; 3] };
    live.apply(Event::Lights(vec![lamp])).unwrap();
    let shown = |live: &LiveSession<_>| {
        (0..48 * 48).map(|at| live.shown([at % 48, at / 48])[1]).collect::<Vec<f32>>()
    };
    while live.frame(4, &|| false).progress < FrameProgress::Done {}
    let before = shown(&live);
    assert!(before.iter().any(|green| *green > 0.0));
    let mut camera = live.view.camera;
    camera.position[0] += 1e-3;
    live.apply(Event::Camera(camera)).unwrap();
    assert!(shown(&live) == before);
}

/// Frames too short for anything take the first rung whole and of the others a part each; until a rung is whole the one
/// before it is on show, and the pictures are those of long frames.
#[test]
fn a_rung_that_its_frame_has_no_time_for_goes_on_in_the_next() {
    let keys = RenderKeys {
        resolution: [256, 128],
        n_shadow: 1,
        integrator: Method::Direct,
        ..RenderKeys::default()
    };
    let start = |t_max| {
        let mut live =
            floor_demanding(0, keys).go_live(FrameOptions { t_max, ..FrameOptions::default() }).unwrap();
        let (edge_u, edge_v) = ([0.0, 2.0, 0.0], [2.0, 0.0, 0.0]);
        let lamp = Light::Rect { corner: [1.0, -1.0, 1.0], edge_u, edge_v, radiance: [3.0; 3] };
        live.apply(Event::Lights(vec![lamp])).unwrap();
        live
    };
    let shown = |live: &LiveSession<_>| {
        (0..256 * 128).map(|at| live.shown([at % 256, at / 256])[1]).collect::<Vec<f32>>()
    };
    let (mut short, mut long) = (start(Duration::ZERO), start(Duration::from_secs(60)));
    assert_eq!(short.frame(1, &|| true).progress, FrameProgress::PreviewPart);
    let mut parts = vec![];
    for step in [8, 4, 2] {
        let (before, mut count) = (shown(&short), 0);
        while {
            assert!(count < 100);
            short.frame(1, &|| false).progress == FrameProgress::PreviewPart
        } {
            count += 1;
            assert_eq!(short.frame(1, &|| true).preview_samples, 0, "it was stopped");
            assert!(shown(&short) == before);
        }
        assert_eq!(short.live.display.step(), Some(step));
        parts.push(count);
        // A long frame takes the first two.
        if step < 8 {
            long.frame(1, &|| false);
            assert_eq!(long.live.display.step(), Some(step));
            assert!(shown(&short) == shown(&long) && shown(&short) != before, "every {step}th pixel");
        }
    }
    assert!(parts[0] == 0 && parts[1..].iter().all(|count| *count > 1), "{parts:?}");
}
