//! Tests of the light that is carried from picture to picture.

use super::*;

/// A display that keeps the picture before.
fn with_history() -> Display {
    let mut display = display(RESOLUTION);
    let bytes = Display::history_bytes(RESOLUTION);
    display.keep_history(Some(Budget::unlimited().lease("the picture before", bytes).unwrap()));
    display
}

/// All that is seen has moved so many pixels to the right, and as far away as it was; whether light is another.
struct MovedRight(f64, bool);

impl Reprojection for MovedRight {
    fn before(&self, [x, y]: [f64; 2], depth: f64) -> Option<([f64; 2], f64)> {
        Some(([x - self.0, y], depth))
    }

    fn is_lit_anew(&self) -> bool {
        self.1
    }
}

/// Shows a picture of the finest grid, whose samples saw what `seen` says, in light of `radiance`.
fn show_moved(
    display: &mut Display,
    moved: Option<f64>,
    seen: impl Fn([u32; 2]) -> LayerPixel,
    radiance: impl Fn([u32; 2]) -> f32,
) {
    show_lit(display, (moved, false), seen, radiance);
}

/// As [`show_moved`], in light that may be another than before.
fn show_lit(
    display: &mut Display,
    (moved, is_lit_anew): (Option<f64>, bool),
    seen: impl Fn([u32; 2]) -> LayerPixel,
    radiance: impl Fn([u32; 2]) -> f32,
) {
    for pixel in pixels().filter(|pixel| pixel.iter().all(|v| v % 2 == 0)) {
        display.set(pixel, Vec3::splat(radiance(pixel)), &seen(pixel));
    }
    let moved = moved.map(|by| MovedRight(by, is_lit_anew));
    let reprojection = moved.as_ref().map(|moved| moved as &dyn Reprojection);
    display.show((0, 2), false, reprojection, &pool(2));
}

/// What is seen again has the mean of its light in all pictures; what comes in from the left has that of the last.
#[test]
fn light_is_carried_to_where_its_surface_is_seen() {
    let plain = |_: [u32; 2]| seen([0, 0]);
    let mut display = with_history();
    for (index, light) in [1.0, 4.0, 7.0].into_iter().enumerate() {
        assert_eq!(display.remember(false), index > 0, "nothing was shown before the first");
        show_moved(&mut display, Some(4.0), plain, |_| light);
        for [x, y] in pixels() {
            // So many pictures had it before, as far as the samples around say.
            let (least, most) = (index.min(x as usize / 4), index.min((x as usize).div_ceil(4)));
            let mean = |count: usize| [light, light - 1.5, light - 3.0][count];
            let found = at(&display, [x, y])[0];
            let is_between = (mean(most) - 1e-2..=mean(least) + 1e-2).contains(&found);
            assert!(is_between, "{index} {x} {y}: {found}");
        }
    }
}

#[test]
fn noise_falls_from_picture_to_picture_to_a_bound() {
    let plain = |_: [u32; 2]| seen([0, 0]);
    let mut display = with_history();
    let mut variances = vec![];
    for picture in 0..40u64 {
        display.remember(false);
        let noise = |[x, y]: [u32; 2]| (mix(picture << 32 | u64::from(x << 16 | y)) % 1000) as f32 / 500.0;
        show_moved(&mut display, Some(0.0), plain, noise);
        variances.push(pixels().map(|pixel| (at(&display, pixel)[0] - 1.0).powi(2)).sum::<f32>());
    }
    let mean = |of: &[f32]| of.iter().sum::<f32>() / of.len() as f32;
    assert!(variances[0] > 3.0 * mean(&variances[8..]), "{variances:?}");
    // What was long ago counts ever less: light that has changed comes through.
    for _ in 0..20 {
        display.remember(false);
        show_moved(&mut display, Some(0.0), plain, |_| 5.0);
    }
    assert!(pixels().all(|pixel| at(&display, pixel)[0] > 4.5));
}

/// Another surface, another form, a hole, a step out of the picture, light that has changed.
#[test]
fn what_was_not_seen_before_has_no_light_of_before() {
    let same = seen([0, 0]);
    let others = [
        LayerPixel { depth: 6.0, ..same },
        LayerPixel { id: NO_ID, ..same },
        LayerPixel { albedo: [0.5, 0.5, 0.7], ..same },
        LayerPixel { normal: [0.8, 0.0, 0.6], ..same },
        LayerPixel::NOTHING,
    ];
    let shown = |now: LayerPixel, moved: Option<f64>, is_forgotten: bool| {
        let mut display = with_history();
        show_moved(&mut display, None, |_| same, |_| 1.0);
        assert!(display.remember(false) && !display.remember(false), "once a picture");
        if is_forgotten {
            display.forget();
        }
        show_moved(&mut display, moved, |_| now, |_| 3.0);
        at(&display, [9, 6])[0]
    };
    for other in others {
        assert!((shown(other, Some(0.0), false) - 3.0).abs() < 1e-2, "{other:?}");
    }
    assert!((shown(same, Some(0.0), false) - 2.0).abs() < 1e-2);
    for (moved, is_forgotten) in
        [(Some(100.0), false), (Some(f64::NAN), false), (None, false), (Some(0.0), true)]
    {
        assert!((shown(same, moved, is_forgotten) - 3.0).abs() < 1e-2, "{moved:?}");
    }
}

/// A hand that rests finds the last picture whole, also when the camera has gone on by then.
#[test]
fn a_sparse_picture_can_be_filled_once_it_is_the_one_before() {
    let light = |[x, y]: [u32; 2]| (x + y) as f32;
    let whole = shown(2, light);
    let mut sparse = with_history();
    set_samples(&mut sparse, 2, light);
    sparse.show((7, 2), true, None, &pool(2));
    assert!(sparse.remember(false));
    sparse.fill(&pool(2));
    assert!(sparse.radiance == whole.radiance);
}

/// The light of exact samples is carried on for what these are worth: nearly all that the next picture shows.
#[test]
fn exact_light_is_carried_on_for_the_most_that_light_is_worth() {
    let plain = |_: [u32; 2]| seen([0, 0]);
    let shown = |samples: u32| {
        let mut display = with_history();
        show_moved(&mut display, None, plain, |_| 1.0);
        let mut film = Film::new(RESOLUTION, Layers::default(), &Budget::unlimited()).unwrap();
        for tile in (0..tile_count(RESOLUTION)).map(|index| tile(RESOLUTION, index)) {
            (0..samples).for_each(|_| film.add(&tile, &vec![[1.0; 3]; tile.pixel_count() as usize]));
            let saw: Vec<_> = (0..tile.pixel_count()).map(|at| (tile.pixel(at), plain([0, 0]))).collect();
            display.learn(&tile, &saw);
        }
        display.refresh(&film, &pool(2));
        assert!(display.remember(false));
        show_moved(&mut display, Some(0.0), plain, |_| 11.0);
        at(&display, [9, 6])[0]
    };
    // 10 more in the last picture, which is worth 1 beside 2, then beside 4.
    assert!((shown(1) - (1.0 + 10.0 / 3.0)).abs() < 0.02, "{}", shown(1));
    assert!([3, 16].iter().all(|samples| (shown(*samples) - 3.0).abs() < 0.02), "{}", shown(16));
}

/// Light that has changed a little goes on; where it has changed much that of before is gone at once.
#[test]
fn light_that_was_another_is_worth_less_the_more_it_has_changed() {
    let plain = |_: [u32; 2]| seen([0, 0]);
    let shown = |light: f32| {
        let mut display = with_history();
        show_moved(&mut display, None, plain, |_| 1.0);
        assert!(display.remember(true));
        show_lit(&mut display, (Some(0.0), true), plain, |_| light);
        at(&display, [9, 6])[0]
    };
    for light in [0.1, 0.7, 1.4, 30.0, 1e6] {
        assert!((shown(light) / light - 1.0).abs() < 1e-3, "{light}: {}", shown(light));
    }
    for (light, least, most) in [(1.0, 0.999, 1.001), (1.1, 1.05, 1.08), (0.9, 0.92, 0.95)] {
        assert!((least..most).contains(&shown(light)), "{light}: {}", shown(light));
    }
    assert!(shown(0.0) == 0.0);
}

/// Where an exact sample saw another surface than the preview, the light of that is not what the next picture finds
/// there: voxels that stood in for mesh shone on as dots along outlines.
#[test]
fn light_of_what_exact_samples_replaced_is_not_carried_on() {
    let [mesh, before] = [5.0, 9.0].map(|depth| LayerPixel { depth, ..seen([0, 0]) });
    let mut display = with_history();
    show_moved(&mut display, None, |_| before, |_| 100.0);
    let tile = tile(RESOLUTION, 0);
    let saw: Vec<_> = (0..tile.pixel_count()).map(|at| (tile.pixel(at), mesh)).collect();
    display.learn(&tile, &saw);
    assert!(display.remember(false));
    show_moved(&mut display, Some(0.0), |_| mesh, |_| 1.0);
    assert!((at(&display, [3, 3])[0] - 1.0).abs() < 1e-2, "{:?}", at(&display, [3, 3]));
}

/// Of the light of before is kept what there is room for, in the ledger and in the plan.
#[test]
fn light_of_before_stays_within_what_was_planned() {
    let (picture, world) = (Display::history_bytes(RESOLUTION), Display::cache_bytes(RESOLUTION));
    for (most_bytes, limit, expected) in [
        (u64::MAX, u64::MAX, picture + world),
        (picture + world, u64::MAX, picture + world),
        (picture + world - 1, u64::MAX, picture),
        (picture - 1, u64::MAX, 0),
        (u64::MAX, picture, picture),
        (0, u64::MAX, 0),
    ] {
        let budget = match limit {
            u64::MAX => Budget::unlimited(),
            bytes => Budget::new(trex_store::RESERVE_BYTES + bytes),
        };
        let mut display = display(RESOLUTION);
        let kept = KeptLight { in_picture: true, in_world: true, most_bytes };
        display.keep_light(&kept, &budget);
        assert_eq!(budget.used_bytes(), expected, "{most_bytes} {limit}");
        // Another plan: what may stay stays as it is, the rest goes.
        show_moved(&mut display, None, |_| seen([0, 0]), |_| 1.0);
        assert!(display.remember(false));
        display.keep_light(&KeptLight { most_bytes: most_bytes.min(picture), ..kept }, &budget);
        assert_eq!(budget.used_bytes(), expected.min(picture), "{most_bytes} {limit}");
        show_moved(&mut display, Some(0.0), |_| seen([0, 0]), |_| 3.0);
        let found = at(&display, [9, 6])[0];
        assert!(
            (found - if expected >= picture { 2.0 } else { 3.0 }).abs() < 1e-2,
            "{most_bytes} {limit}: {found}"
        );
        display.keep_no_light();
        assert_eq!(budget.used_bytes(), 0);
    }
}
