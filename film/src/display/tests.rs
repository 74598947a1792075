//! Tests of the display: what is between samples, what it is worth, and the light of exact ones in it.

mod cache;
mod history;

use super::*;
use crate::coarse::STEPS;
use crate::film::{Layers, NO_ID};
use crate::hash::mix;
use crate::testing::pool;
use crate::tile::tile;
use trex_store::Budget;

const RESOLUTION: [u32; 2] = [19, 13];

/// What pixel (x, y) saw: two surfaces, left and right of column 10.
fn seen([x, _]: [u32; 2]) -> LayerPixel {
    let depth = if x < 10 { 5.0 } else { 9.0 };
    LayerPixel { depth, normal: [0.0, 0.0, 1.0], albedo: [0.5; 3], id: 0, ..LayerPixel::NOTHING }
}

/// A display with a sample at every `step`-th pixel.
fn shown(step: u32, radiance: impl Fn([u32; 2]) -> f32) -> Display {
    let mut display = display(RESOLUTION);
    set_samples(&mut display, step, radiance);
    display.show((7, step), false, None, &pool(2));
    assert_eq!((display.state(), display.step()), (Some(7), Some(step)));
    display
}

fn set_samples(display: &mut Display, step: u32, radiance: impl Fn([u32; 2]) -> f32) {
    for y in (0..RESOLUTION[1]).step_by(step as usize) {
        for x in (0..RESOLUTION[0]).step_by(step as usize) {
            display.set([x, y], Vec3::splat(radiance([x, y])), &seen([x, y]));
        }
    }
}

/// What is on show at a pixel.
fn at(display: &Display, pixel: [u32; 2]) -> [f32; 3] {
    display.radiances(pixel).next().unwrap()
}

fn pixels() -> impl Iterator<Item = [u32; 2]> {
    (0..RESOLUTION[1]).flat_map(|y| (0..RESOLUTION[0]).map(move |x| [x, y]))
}

/// A display that shows nothing yet.
fn display(resolution: [u32; 2]) -> Display {
    let lease = Budget::unlimited().lease("the picture on show", Display::bytes(resolution)).unwrap();
    Display::in_lease(resolution, lease)
}

/// A slope is its own mean, away from edges.
#[test]
fn a_slope_stays_a_slope_between_samples() {
    let slope = |[x, y]: [u32; 2]| x as f32 + 10.0 * y as f32;
    let mut display = display([160, 160]);
    for (x, y) in (0..160).step_by(2).flat_map(|y| (0..160).step_by(2).map(move |x| (x, y))) {
        display.set([x, y], Vec3::splat(slope([x, y])), &seen([0, 0]));
    }
    display.show((0, 2), false, None, &pool(2));
    for pixel in (62..98).flat_map(|y| (62..98).map(move |x| [x, y])) {
        let found = at(&display, pixel)[0];
        // To the precision of what is kept.
        assert!((found - slope(pixel)).abs() < 1e-4 * 2048.0, "{pixel:?}: {found}");
    }
}

/// Light by chance, of mean 1: its variance falls as the smoothing's weights say.
#[test]
fn noise_is_smoothed() {
    let noise = |[x, y]: [u32; 2]| 2.0 * (mix(u64::from(x) << 32 | u64::from(y)) % 1000) as f32 / 999.0;
    let mut display = display([128, 128]);
    for pixel in (0..128).step_by(2).flat_map(|y| (0..128).step_by(2).map(move |x| [x, y])) {
        display.set(pixel, Vec3::splat(noise(pixel)), &seen([0, 0]));
    }
    display.show((0, 2), false, None, &pool(2));
    let pixels = || (0..128).flat_map(|y| (0..128).map(move |x| [x, y]));
    let value = |pixel| f64::from(at(&display, pixel)[0]);
    let mean = pixels().map(value).sum::<f64>() / 128.0f64.powi(2);
    let variance = pixels().map(|pixel| (value(pixel) - mean).powi(2)).sum::<f64>() / 128.0f64.powi(2);
    assert!((mean - 1.0).abs() < 0.03 && variance < 0.03 / 3.0, "{mean} {variance}");
}

#[test]
fn nothing_bleeds_over_the_edge_of_a_surface() {
    for step in STEPS {
        let display = shown(step, |[x, _]| if x < 10 { 1.0 } else { 3.0 });
        for pixel in pixels() {
            let found = at(&display, pixel)[0];
            assert!([1.0, 3.0].iter().any(|value| (found - value).abs() < 1e-3), "{step} {pixel:?}: {found}");
            // The edge is off by less than the step.
            let (before, after) = (pixel[0] + step <= 10, pixel[0] >= 10 + step);
            assert!(!before || found < 2.0);
            assert!(!after || found > 2.0);
        }
    }
}

/// Bumps finer than the grid: between samples of one surface that are turned otherwise is their mean.
#[test]
fn between_samples_that_are_turned_otherwise_lies_their_mean() {
    let mut display = display([16, 16]);
    // Two of each, so that none is alone.
    for [x, y] in [[0, 0], [8, 0], [0, 8], [8, 8]] {
        let normal = if x == 0 { [0.8, 0.0, 0.6] } else { [-0.8, 0.0, 0.6] };
        display.set([x, y], Vec3::splat(1.0 + x as f32), &LayerPixel { normal, ..seen([0, 0]) });
    }
    display.show((0, 8), false, None, &pool(2));
    for (x, share) in (0..8).zip([0.0, 0.125, 0.25, 0.375, 0.5, 0.625, 0.75, 0.875]) {
        assert!((at(&display, [x, 0])[0] - (1.0 + 8.0 * share)).abs() < 1e-2, "{x}");
    }
}

/// The one tile of a picture whose pixels all saw `seen`.
fn learn(display: &mut Display, saw: impl Fn([u32; 2]) -> LayerPixel) {
    let tile = crate::tile::tile(RESOLUTION, 0);
    let saw: Vec<_> = (0..64).map(|index| tile.pixel(index)).map(|pixel| (pixel, saw(pixel))).collect();
    display.learn(&tile, &saw);
}

#[test]
fn a_preview_is_worth_nothing_where_exact_samples_saw_something_else() {
    let same = seen([0, 0]);
    let turned = LayerPixel { normal: [0.8, 0.0, 0.6], ..same };
    let other = [
        LayerPixel { depth: 5.6, ..same },
        LayerPixel { id: NO_ID, ..same },
        LayerPixel { albedo: [0.5, 0.5, 0.7], ..same },
        turned,
        LayerPixel::NOTHING,
    ];
    for other in other {
        let mut display = shown(2, |_| 1.0);
        learn(&mut display, |[x, y]| if x < 3 && y > 4 { other } else { LayerPixel { id: 77, ..same } });
        for [x, y] in pixels().filter(|[x, y]| *x < 8 && *y < 8) {
            let expected = if x < 3 && y > 4 { 0.0 } else { FIRST_WORTH };
            assert_eq!(display.worth(0, [x, y]), expected, "{other:?} {x} {y}");
        }
        assert_eq!(display.worth(1, [8, 5]), FIRST_WORTH, "nothing is known of other tiles");
        // What holds samples is of what they saw, whatever the preview was of; the next preview begins anew.
        display.stand(0, 8, 1);
        learn(&mut display, |_| other);
        assert_eq!(display.worth(0, [0, 5]), FIRST_WORTH + 1.0);
        // Light that changes once more, before the tile is taken in that of before.
        display.stand(0, 9, 0);
        learn(&mut display, |_| other);
        assert_eq!(display.worth(0, [0, 5]), FIRST_WORTH + 1.0);
        display.show((9, 2), false, None, &pool(1));
        assert_eq!(display.worth(0, [0, 5]), FIRST_WORTH);
    }
}

/// Voxels on show count where exact samples saw them, too: behind the cut of the footprint rule they are the model.
#[test]
fn voxels_beside_voxels_and_nothing_beside_nothing_are_the_same() {
    for saw in [LayerPixel { id: NO_ID, ..seen([0, 0]) }, LayerPixel::NOTHING] {
        let mut display = display(RESOLUTION);
        pixels().filter(|[x, y]| x % 2 == 0 && y % 2 == 0).for_each(|pixel| {
            display.set(pixel, Vec3::ONE, &saw);
        });
        display.show((0, 2), false, None, &pool(1));
        learn(&mut display, |_| saw);
        assert!((0..64).all(|at| display.worth(0, [at % 8, at / 8]) == FIRST_WORTH), "{saw:?}");
        learn(&mut display, |_| seen([0, 0]));
        assert!((0..64).all(|at| display.worth(0, [at % 8, at / 8]) == 0.0), "{saw:?}");
    }
}

/// Exact samples of radiance 3 in the tiles that `is_exact` tells, over a preview of radiance 1 that saw `preview`.
fn refreshed(preview: LayerPixel, exact: LayerPixel, is_exact: impl Fn(u32) -> bool) -> Display {
    let mut display = display(RESOLUTION);
    pixels().filter(|[x, y]| x % 2 == 0 && y % 2 == 0).for_each(|pixel| {
        display.set(pixel, Vec3::ONE, &preview);
    });
    display.show((0, 2), false, None, &pool(2));
    let mut film = Film::new(RESOLUTION, Layers::default(), &Budget::unlimited()).unwrap();
    for tile in (0..tile_count(RESOLUTION)).filter(|index| is_exact(*index)).map(|i| tile(RESOLUTION, i)) {
        film.add(&tile, &vec![[3.0; 3]; tile.pixel_count() as usize]);
        let saw: Vec<_> = (0..tile.pixel_count()).map(|index| (tile.pixel(index), exact)).collect();
        display.learn(&tile, &saw);
    }
    (0..5).for_each(|_| display.refresh(&film, &pool(2)));
    display
}

/// Photons that arrive make another state of the film: once all pixels have a sample in it, the picture is made anew of
/// those, and not before.
#[test]
fn the_picture_is_made_anew_in_light_that_has_changed_by_itself() {
    let mut display = shown(2, |_| 1.0);
    let mut film = Film::new(RESOLUTION, Layers::default(), &Budget::unlimited()).unwrap();
    (0..7).for_each(|_| film.begin_state());
    let tiles = || (0..tile_count(RESOLUTION)).map(|index| tile(RESOLUTION, index));
    let take = |film: &mut Film, display: &mut Display, tile: &Tile, light: f32| {
        film.add(tile, &vec![[light; 3]; tile.pixel_count() as usize]);
        let saw: Vec<_> = (0..tile.pixel_count()).map(|at| (tile.pixel(at), seen(tile.pixel(at)))).collect();
        display.learn(tile, &saw);
    };
    tiles().for_each(|tile| take(&mut film, &mut display, &tile, 3.0));
    display.refresh(&film, &pool(2));
    assert!(display.refreshes() == 1 && display.state() == Some(7));
    film.begin_state();
    tiles().for_each(|tile| display.stand(tile.index, film.state(), 1));
    for tile in tiles() {
        display.refresh(&film, &pool(2));
        assert!(
            display.refreshes() == 1 && (at(&display, tile.first)[0] - 3.0).abs() < 1e-2,
            "{}",
            tile.index
        );
        take(&mut film, &mut display, &tile, 5.0);
    }
    display.refresh(&film, &pool(2));
    assert!(display.refreshes() == 2 && display.state() == Some(film.state()));
    assert!(pixels().all(|pixel| (at(&display, pixel)[0] - 5.0).abs() < 1e-2));
}

/// A picture of first rays that is shown over exact samples knows nothing of what they saw: it stays as it is.
#[test]
fn a_picture_that_is_shown_over_exact_samples_is_not_made_of_them() {
    let mut display = shown(2, |_| 1.0);
    let mut film = Film::new(RESOLUTION, Layers::default(), &Budget::unlimited()).unwrap();
    for tile in (0..tile_count(RESOLUTION)).map(|index| tile(RESOLUTION, index)) {
        film.add(&tile, &vec![[3.0; 3]; tile.pixel_count() as usize]);
        let saw: Vec<_> = (0..tile.pixel_count()).map(|at| (tile.pixel(at), seen(tile.pixel(at)))).collect();
        display.learn(&tile, &saw);
    }
    set_samples(&mut display, 2, |_| 2.0);
    display.show((film.state(), 2), false, None, &pool(2));
    display.refresh(&film, &pool(2));
    assert_eq!(display.refreshes(), 1);
    assert!(pixels().all(|pixel| (at(&display, pixel)[0] - 2.0).abs() < 1e-2));
}

/// Tiles 0 and 4 of 6 are exact. What is there is the exact light alone where the preview saw voxels; where it saw
/// the same surface its light counts beside it. The preview stays what it was.
#[test]
fn exact_light_takes_the_place_of_the_preview() {
    let mesh = seen([0, 0]);
    let voxels = LayerPixel { id: NO_ID, ..mesh };
    let is_exact = |[x, y]: [u32; 2]| [0, 4].contains(&(y / 8 * 3 + x / 8));
    for (preview, exact, is_apart) in [(voxels, mesh, true), (mesh, mesh, false), (mesh, voxels, false)] {
        let display = refreshed(preview, exact, |index| [0, 4].contains(&index));
        let mut mixed = 0;
        for pixel in pixels() {
            let found = at(&display, pixel)[0];
            let expected = if is_exact(pixel) { 3.0 } else { 1.0 };
            mixed += u32::from((found - expected).abs() > 1e-3);
            assert!((0.999..=3.001).contains(&found), "{pixel:?} {found}");
            let worth = display.worth(pixel[1] / 8 * 3 + pixel[0] / 8, pixel);
            match is_exact(pixel) {
                true => assert_eq!(worth, 0.0, "no noise is seen"),
                false => assert_eq!(worth, FIRST_WORTH),
            }
        }
        // Mesh of the preview is a neighbour of what looks like it; voxels that stand in are none.
        assert_eq!(mixed == 0, is_apart, "{mixed}");
    }
}

/// A pixel that is not of one surface with the sample of its cell has nothing but its own samples.
#[test]
fn a_pixel_beside_an_edge_has_its_own_samples_alone() {
    for is_noisy in [false, true] {
        let mut display = display(RESOLUTION);
        set_samples(&mut display, 2, |_| 1.0);
        display.show((0, 2), false, None, &pool(2));
        let mut film = Film::new(RESOLUTION, Layers::default(), &Budget::unlimited()).unwrap();
        let first = tile(RESOLUTION, 0);
        // Column 3 saw the surface behind, and is brighter.
        let light = |[x, y]: [u32; 2]| match x {
            3 => 9.0,
            _ if is_noisy && (x / 2 + y / 2) % 2 == 0 => 0.0,
            _ => 2.0,
        };
        film.add(&first, &(0..64).map(|i| [light(first.pixel(i)); 3]).collect::<Vec<_>>());
        learn(&mut display, |[x, _]| if x == 3 { seen([15, 0]) } else { seen([0, 0]) });
        display.refresh(&film, &pool(1));
        for [x, y] in pixels().filter(|[x, y]| *x < 8 && *y < 8) {
            assert_eq!(display.worth(0, [x, y]) > 0.0, is_noisy && x != 3, "{x} {y}");
            assert!(at(&display, [x, y])[0] < 2.001, "the light of column 3 is no other's");
        }
    }
}

/// Columns from 3 on saw the surface behind. Column 3, whose cell's sample is of the one in front, has the light of
/// column 4: the edge is where the exact samples say, not on the grid.
#[test]
fn a_pixel_beside_an_edge_has_the_light_of_its_own_side() {
    let mut display = display(RESOLUTION);
    pixels().filter(|[x, y]| x % 2 == 0 && y % 2 == 0).for_each(|pixel| {
        display.set(pixel, Vec3::ONE, &LayerPixel { id: NO_ID, ..seen(pixel) });
    });
    display.show((0, 2), false, None, &pool(2));
    let mut film = Film::new(RESOLUTION, Layers::default(), &Budget::unlimited()).unwrap();
    let first = tile(RESOLUTION, 0);
    let light = |x: u32| if x < 3 { 2.0 } else { 9.0 };
    film.add(&first, &(0..64).map(|i| [light(first.pixel(i)[0]); 3]).collect::<Vec<_>>());
    learn(&mut display, |[x, _]| seen([if x < 3 { 0 } else { 15 }, 0]));
    display.refresh(&film, &pool(1));
    for [x, y] in pixels().filter(|[x, y]| *x < 8 && *y < 8) {
        assert!((at(&display, [x, y])[0] - light(x)).abs() < 1e-2, "{x} {y}");
    }
}

/// The mean of some samples of a pixel, less noisy: light by chance, of mean 1.
#[test]
fn a_picture_that_is_made_anew_is_smoother_than_its_samples() {
    let resolution = [128, 128];
    let mut display = display(resolution);
    display.show((0, 2), false, None, &pool(2));
    let mut film = Film::new(resolution, Layers::default(), &Budget::unlimited()).unwrap();
    for tile in (0..tile_count(resolution)).map(|index| tile(resolution, index)) {
        let noise = |i| [2.0 * (mix(u64::from(tile.index << 8 | i)) % 1000) as f32 / 999.0; 3];
        film.add(&tile, &(0..64).map(noise).collect::<Vec<_>>());
        let saw: Vec<_> = (0..64).map(|index| (tile.pixel(index), seen([0, 0]))).collect();
        display.learn(&tile, &saw);
    }
    display.refresh(&film, &pool(2));
    let value = |at: u32| f64::from(display.radiances([at % 128, at / 128]).next().unwrap()[0]);
    let mean = (0..128 * 128).map(value).sum::<f64>() / 128.0f64.powi(2);
    let variance = (0..128 * 128).map(|at| (value(at) - mean).powi(2)).sum::<f64>() / 128.0f64.powi(2);
    // The samples' is a third.
    assert!((mean - 1.0).abs() < 0.02 && variance < 0.01 / 3.0, "{mean} {variance}");
}

#[test]
fn a_sparse_picture_is_that_of_its_samples_until_it_is_filled() {
    let light = |[x, y]: [u32; 2]| (mix(u64::from(x * 100 + y)) % 100) as f32 / 99.0;
    for step in STEPS {
        let whole = shown(step, light);
        let mut sparse = shown(step, light);
        set_samples(&mut sparse, step, light);
        sparse.radiance.fill(PackedLight::new([7.0; 3]));
        sparse.show((8, step), true, None, &pool(2));
        for pixel in pixels() {
            let is_sample = pixel.iter().all(|v| v % step == 0);
            let expected = if is_sample { at(&whole, pixel) } else { [7.0; 3] };
            assert_eq!(at(&sparse, pixel), expected, "{step} {pixel:?}");
        }
        (0..2).for_each(|_| sparse.fill(&pool(2)));
        assert_eq!((sparse.radiance == whole.radiance, sparse.state()), (true, Some(8)), "{step}");
    }
}
