//! Sums, states and memory of the film.

use super::*;
use crate::tile::{tile, tile_count};

#[test]
fn the_mean_is_right_after_a_million_samples() {
    let mut film = Film::new([1, 1], Layers::default(), &Budget::unlimited()).unwrap();
    let tile = tile([1, 1], 0);
    // Large and small in turn: an f32 sum is off by parts in a thousand here.
    for index in 0..1_000_000u32 {
        let value = if index % 2 == 0 { 1000.0 } else { 0.1f32 };
        film.add(&tile, &[[value; 3]]);
    }
    assert!((film.radiance([0, 0])[0] - 500.05).abs() < 1e-4);
    assert_eq!(film.samples(), 1_000_000);
}

#[test]
fn a_cleared_film_is_as_a_new_one() {
    let layers = Layers { depth: true, normal: true, albedo: true, id: true, filter: true };
    // Tiles at the right and at the bottom are cut.
    let resolution = [20, 11];
    let new = || Film::new(resolution, layers, &Budget::unlimited()).unwrap();
    let mut film = new();
    // All but one tile.
    for index in 1..tile_count(resolution) {
        let tile = tile(resolution, index);
        film.add(&tile, &vec![[1.0, 2.0, 3.0]; tile.pixel_count() as usize]);
        film.add_indirect(&tile, &vec![[0.5; 3]; tile.pixel_count() as usize]);
        let seen =
            LayerPixel { depth: 7.0, normal: [1.0; 3], albedo: [0.5; 3], id: 9, ..LayerPixel::NOTHING };
        (0..tile.pixel_count()).for_each(|i| film.set_layers(tile.pixel(i), &seen));
    }
    assert_ne!(format!("{film:?}"), format!("{:?}", new()));
    film.clear();
    assert_eq!(format!("{film:?}"), format!("{:?}", new()));
}

#[test]
fn samples_of_another_state_are_shown_and_do_not_count() {
    let mut film = Film::new([16, 8], Layers::default(), &Budget::unlimited()).unwrap();
    let tiles = [tile([16, 8], 0), tile([16, 8], 1)];
    let add = |film: &mut Film, index: usize, value: f32| film.add(&tiles[index], &[[value; 3]; 64]);
    add(&mut film, 0, 1.0);
    add(&mut film, 1, 1.0);
    assert_eq!((film.samples(), film.state(), film.tile_state(1)), (1, 0, Some(0)));
    film.begin_state();
    add(&mut film, 0, 5.0);
    assert_eq!([0, 1].map(|index| film.tile_samples(index)), [1, 0]);
    assert_eq!((film.radiance([0, 0])[0], film.radiance([8, 0])[0]), (5.0, 1.0));
    add(&mut film, 0, 7.0);
    add(&mut film, 1, 3.0);
    assert_eq!((film.samples(), film.tile_state(1)), (1, Some(1)));
    assert_eq!((film.radiance([0, 0])[0], film.radiance([8, 0])[0]), (6.0, 3.0));
}

#[test]
fn memory_is_leased_and_given_back() {
    let layers = Layers { depth: true, normal: true, albedo: true, id: true, filter: false };
    let budget = Budget::unlimited();
    let film = Film::new([100, 50], layers, &budget).unwrap();
    assert_eq!(budget.used_bytes(), 100 * 50 * (16 + 32) + 13 * 7 * 8);
    drop(film);
    assert_eq!(budget.used_bytes(), 0);
    assert!(Film::new([100, 50], layers, &Budget::new(trex_store::RESERVE_BYTES)).is_err());
}

#[test]
fn a_row_is_its_pixels() {
    let layers = Layers { filter: true, ..Layers::default() };
    let mut film = Film::new([20, 3], layers, &Budget::unlimited()).unwrap();
    for index in 0..3 {
        let tile = tile([20, 3], index);
        let radiances: Vec<_> = (0..2 * tile.pixel_count()).map(|i| [i as f32, index as f32, 1.0]).collect();
        film.add(&tile, &radiances);
        film.add_indirect(&tile, &radiances);
    }
    for is_smooth in [false, true] {
        if is_smooth {
            let smoothed = (0..).zip(film.smoothed_mut(0..3));
            smoothed.for_each(|(i, smoothed)| *smoothed = PackedLight::new([100.0 + i as f32; 3]));
            film.set_smooth();
        }
        for (x, width) in [(0, 8), (10, 6), (16, 4)] {
            let mut row = vec![[0.0; 3]; width];
            film.radiances([x, 1], &mut row);
            for (x, found) in (x..).zip(row) {
                assert_eq!(found, film.radiance([x, 1]), "{x}");
                assert!(!is_smooth || found == [120.0 + x as f32; 3], "{x}");
            }
        }
    }
}

#[test]
fn smoothed_samples_count_for_more_beside_a_preview() {
    let layers = Layers { filter: true, ..Layers::default() };
    let mut film = Film::new([8, 8], layers, &Budget::unlimited()).unwrap();
    let tile = tile([8, 8], 0);
    for _ in 0..3 {
        film.add(&tile, &[[1.0; 3]; 64]);
        film.add_indirect(&tile, &[[0.5; 3]; 64]);
    }
    assert_eq!(film.tile_worth(0), 3);
    film.set_smooth();
    assert_eq!(film.tile_worth(0), 9);
    film.begin_state();
    assert_eq!(film.tile_worth(0), 0);
}
