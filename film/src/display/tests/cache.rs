//! Tests of the light that is kept in the world.

use super::*;
use crate::{LightKey, LightPlace};

/// A display that keeps light in the world, and not the picture before.
fn with_cache() -> Display {
    let mut display = display(RESOLUTION);
    let bytes = Display::cache_bytes(RESOLUTION);
    display.keep_cache(Some(Budget::unlimited().lease("light kept in the world", bytes).unwrap()));
    display
}

/// What pixel (x, y) of a view sees: in each view another place, which four samples of the finest grid share.
fn placed(view: u32, [x, y]: [u32; 2]) -> LayerPixel {
    let place = [x / 4, y / 4, 1000 * view].map(|v| f64::from(v) + 0.25);
    let of =
        LightPlace { place, normal: [0.0, 0.0, 1.0], pixel_width: 0.1, is_voxel: false, seen_from: None };
    LayerPixel { light_key: LightKey::new(&of), ..seen([0, 0]) }
}

/// Shows a view by the grids from the coarsest to the finest, its samples with the radiance that is told.
fn show_view(display: &mut Display, view: u32, radiance: impl Fn([u32; 2]) -> f32, threads: usize) {
    for (rung, step) in STEPS.into_iter().enumerate() {
        let is_taken = |v: u32| rung > 0 && v.is_multiple_of(STEPS[rung - 1]);
        let grid = pixels().filter(|pixel| pixel.iter().all(|v| v % step == 0));
        for pixel in grid.filter(|pixel| !pixel.iter().all(|&v| is_taken(v))) {
            display.set(pixel, Vec3::splat(radiance(pixel)), &placed(view, pixel));
        }
        display.show((0, step), false, None, &pool(threads));
    }
}

/// A view that comes back has the light of the times before in it; another has not.
#[test]
fn a_view_that_comes_back_has_its_light_of_before() {
    let mut display = with_cache();
    show_view(&mut display, 0, |_| 2.0, 2);
    for (count, least) in [2.0, 2.5, 3.0, 3.2].into_iter().enumerate() {
        show_view(&mut display, 1 + count as u32 % 2, |_| 50.0, 2);
        assert!(pixels().all(|pixel| (at(&display, pixel)[0] - 50.0).abs() < 0.1), "{count}");
        show_view(&mut display, 0, |_| 4.0, 2);
        for pixel in pixels() {
            let found = at(&display, pixel)[0];
            assert!(found > least && found < 3.8, "{count} {pixel:?}: {found}");
        }
    }
}

#[test]
fn light_that_has_changed_and_light_of_no_room_are_not_kept() {
    for (is_kept, is_forgotten) in [(true, false), (true, true), (false, false)] {
        let mut display = with_cache();
        if !is_kept {
            display.keep_cache(None);
        }
        show_view(&mut display, 0, |_| 1.0, 2);
        show_view(&mut display, 1, |_| 1.0, 2);
        if is_forgotten {
            display.forget();
        }
        show_view(&mut display, 0, |_| 3.0, 2);
        let found = at(&display, [9, 6])[0];
        let is_mixed = is_kept && !is_forgotten;
        assert!(if is_mixed { found < 2.3 } else { (found - 3.0).abs() < 1e-2 }, "{is_mixed}: {found}");
    }
}

/// Exact samples are worth far more than one of a preview, and what they saw is where their light is kept.
#[test]
fn exact_light_is_kept_for_what_it_is_worth() {
    let mut display = with_cache();
    show_view(&mut display, 0, |_| 9.0, 2);
    let mut film = Film::new(RESOLUTION, Layers::default(), &Budget::unlimited()).unwrap();
    for tile in (0..tile_count(RESOLUTION)).map(|index| tile(RESOLUTION, index)) {
        (0..4).for_each(|_| film.add(&tile, &vec![[1.0; 3]; tile.pixel_count() as usize]));
        // They see another place than the preview did.
        let saw: Vec<_> =
            (0..tile.pixel_count()).map(|at| tile.pixel(at)).map(|at| (at, placed(7, at))).collect();
        display.learn(&tile, &saw);
    }
    display.refresh(&film, &pool(2));
    assert!((at(&display, [9, 6])[0] - 1.0).abs() < 1e-2, "{:?}", at(&display, [9, 6]));
    show_view(&mut display, 7, |_| 18.0, 2);
    // One to four of 18 beside sixteen of 1.
    assert!((1.9..4.5).contains(&at(&display, [9, 6])[0]), "{:?}", at(&display, [9, 6]));
    show_view(&mut display, 0, |_| 9.0, 2);
    assert!((at(&display, [9, 6])[0] - 9.0).abs() < 1e-2, "{:?}", at(&display, [9, 6]));
}

#[test]
fn what_is_shown_does_not_depend_on_threads() {
    let shown = |threads: usize| {
        let mut display = with_cache();
        for view in [0, 1, 0, 2, 1, 0] {
            show_view(
                &mut display,
                view,
                |[x, y]| (mix(u64::from(view * 900 + 31 * y + x)) % 64) as f32,
                threads,
            );
        }
        display.radiance
    };
    assert!(shown(1) == shown(4));
}
