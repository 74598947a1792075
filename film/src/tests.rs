//! What pictures take: the bytes that are leased, beside those that the allocator gave, and how many there are a pixel.

use super::coarse::STEPS;
use super::display::Display;
use super::film::{Film, LayerPixel, Layers, film_bytes};
use super::filter::{filter_bytes, smooth};
use super::saliency::{self, ReducedPicture, Saliency};
use super::tile::{tile, tile_count};
use crate::testing::{Pinhole, pool};
use allocation_counter::{AllocationInfo, measure};
use glam::{DVec3, Vec3};
use rayon::ThreadPool;
use trex_store::Budget;

const RESOLUTIONS: [[u32; 2]; 4] = [[1, 1], [333, 7], [64, 200], [640, 360]];
const FILTERED: Layers = Layers { depth: false, normal: false, albedo: false, id: false, filter: true };
const SEEN: LayerPixel =
    LayerPixel { depth: 2.0, normal: [0.0, 0.0, 1.0], albedo: [0.5; 3], id: 3, ..LayerPixel::NOTHING };

/// Nine rows of samples of seven numbers that a thread decodes, beside what is leased.
fn row_bytes([width, _]: [u32; 2]) -> u64 {
    u64::from(width.div_ceil(2)) * 9 * 8 * 4 + QUEUE_BYTES
}

/// Two budgets and the names of their leases.
const LEASE_BYTES: u64 = 1 << 10;

/// A block of the queues of a thread pool.
const QUEUE_BYTES: u64 = 2 << 10;

/// What `body` takes from the allocator, on the one thread of `threads`: work for them is done at once then, where
/// another thread would queue it, and now and then a queue takes a block.
fn taken(threads: &ThreadPool, body: impl FnOnce() + Send) -> AllocationInfo {
    threads.install(|| measure(body))
}

/// Every tile with a sample, and what its pixels saw.
fn sampled(film: &mut Film) {
    let resolution = film.resolution();
    for tile in (0..tile_count(resolution)).map(|index| tile(resolution, index)) {
        let light = vec![[0.5; 3]; tile.pixel_count() as usize];
        film.add(&tile, &light);
        if film.layers().filter {
            film.add_indirect(&tile, &light);
        }
        (0..tile.pixel_count()).for_each(|index| film.set_layers(tile.pixel(index), &SEEN));
    }
}

#[test]
fn a_film_takes_what_is_leased_for_it() {
    for resolution in RESOLUTIONS {
        for bits in 0..32 {
            let is = |bit: u32| bits >> bit & 1 == 1;
            let layers = Layers { depth: is(0), normal: is(1), albedo: is(2), id: is(3), filter: is(4) };
            let mut film = None;
            let made =
                taken(&pool(1), || film = Some(Film::new(resolution, layers, &Budget::unlimited()).unwrap()));
            // What a ledger takes for itself.
            let ledger = measure(|| drop(Budget::unlimited())).bytes_max as i64;
            assert_eq!(made.bytes_current, film_bytes(resolution, layers) as i64 + ledger, "{layers:?}");
        }
    }
}

/// A display takes its work with its first picture, and makes way for the work of others.
#[test]
fn a_display_takes_what_is_leased_for_it() {
    for resolution in RESOLUTIONS {
        let lease = Budget::unlimited().lease("a display", Display::bytes(resolution)).unwrap();
        let threads = pool(1);
        let mut display = None;
        let shown = taken(&threads, || {
            let display = display.insert(Display::in_lease(resolution, lease));
            for step in STEPS {
                for y in (0..resolution[1]).step_by(step as usize) {
                    for x in (0..resolution[0]).step_by(step as usize) {
                        display.set([x, y], Vec3::ONE, &SEEN);
                    }
                }
                display.show((0, step), false, None, &threads);
            }
        });
        let leased = Display::bytes(resolution);
        assert!(shown.bytes_max <= leased + row_bytes(resolution), "{resolution:?} {shown:?}");
        let display = display.as_mut().unwrap();
        let freed = -taken(&threads, || display.release_work(&threads)).bytes_current as u64;
        let others = saliency::work_bytes(tile_count(resolution)).max(filter_bytes(resolution));
        assert!(freed > 0 && shown.bytes_current as u64 - freed + others <= leased, "{resolution:?}");
        // What was on show stays, and the next picture has its work again.
        assert!((display.radiances([0, 0]).next().unwrap()[0] - 1.0).abs() < 1e-3);
        let again =
            taken(&threads, || display.show((0, STEPS[0]), false, None, &threads)).bytes_current as u64;
        assert_eq!(again, freed, "{resolution:?}");
    }
}

/// The light before is taken when it is leased, and goes with its lease.
#[test]
fn the_light_before_takes_what_is_leased_for_it() {
    for resolution in RESOLUTIONS {
        let lease = |bytes: u64| Some(Budget::unlimited().lease("light before", bytes).unwrap());
        let (history, cache) = (Display::history_bytes(resolution), Display::cache_bytes(resolution));
        let mut display = Display::in_lease(resolution, lease(Display::bytes(resolution)).unwrap());
        let threads = pool(1);
        let kept = taken(&threads, || {
            display.keep_history(lease(history));
            display.keep_cache(lease(cache));
        });
        assert!(kept.bytes_current as u64 >= history + cache, "{resolution:?} {kept:?}");
        assert!(kept.bytes_max <= history + cache + LEASE_BYTES, "{resolution:?} {kept:?}");
    }
}

/// Rows beyond the window are never held: the filter of a picture ten times as high takes no more.
#[test]
fn the_filter_takes_what_is_leased_for_it_and_no_more_for_a_higher_picture() {
    let threads = pool(1);
    for resolution in RESOLUTIONS {
        let mut film = Film::new(resolution, FILTERED, &Budget::unlimited()).unwrap();
        sampled(&mut film);
        let lens = Pinhole { position: DVec3::ZERO, target: DVec3::NEG_Z, fov_x: 40.0, resolution };
        let work = taken(&threads, || smooth(&mut film, &lens, &threads, &|| false));
        assert!(work.bytes_max <= filter_bytes(resolution) + QUEUE_BYTES, "{resolution:?} {work:?}");
        assert!(work.bytes_max * 10 > filter_bytes(resolution) * 9, "{resolution:?} {work:?}");
    }
    assert_eq!(filter_bytes([640, 360]), filter_bytes([640, 3600]));
}

#[test]
fn saliency_takes_what_is_leased_for_it() {
    for resolution in [[640, 360], [1280, 720]] {
        let most = [Saliency::Achanta, Saliency::Itti].map(|metric| {
            let work = measure(|| {
                let picture = ReducedPicture::of(resolution, |[x, y]| {
                    [x as f32 / 1280.0, 0.5, (x ^ y) as f32 / 2048.0]
                });
                assert_eq!(metric.tiles(&picture).len(), tile_count(resolution) as usize);
            });
            work.bytes_max
        });
        let leased = saliency::work_bytes(tile_count(resolution));
        let taken = most[0].max(most[1]);
        assert!(taken <= leased && taken * 10 > leased * 9, "{most:?} of {leased}");
    }
}

/// Film, filter and display take 64 bytes a pixel with all that they can keep, and what is carried from picture to
/// picture 6 more, light in the world 8. The work of the filter on a whole picture took 52 alone.
#[test]
fn a_picture_with_everything_on_takes_64_bytes_a_pixel() {
    for resolution in [[1280, 720], [1920, 1080], [3840, 2160]] {
        let pixels = f64::from(resolution[0]) * f64::from(resolution[1]);
        let bytes = film_bytes(resolution, FILTERED) + Display::bytes(resolution);
        let each = bytes as f64 / pixels;
        assert!(each <= 64.0, "{resolution:?}: {each}");
        let history = Display::history_bytes(resolution) as f64 / pixels;
        assert!(history <= 6.0, "{resolution:?}: {history}");
        let cache = Display::cache_bytes(resolution) as f64 / pixels;
        assert!(cache <= 8.0, "{resolution:?}: {cache}");
        let plain = (film_bytes(resolution, Layers::default()) + Display::bytes(resolution)) as f64 / pixels;
        assert!(plain <= 31.0, "{resolution:?}: {plain}");
    }
}
