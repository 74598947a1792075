//! Pictures out of their parts beside those of one film.

use super::*;
use crate::encode::{write_exr, write_exr_strips, write_png, write_png_strips};
use crate::film::LayerPixel;
use crate::filter::smooth;
use crate::hash::mix;
use crate::part::write_part;
use crate::testing::{Pinhole, pool};
use crate::tile::tile;
use allocation_counter::measure;
use glam::DVec3;
use std::collections::HashMap;
use std::io::Cursor;
use std::sync::Mutex;
use trex_store::{Code, RESERVE_BYTES};

const SPP: u32 = 4;
const ALL: Layers = Layers { depth: true, normal: true, albedo: true, id: true, filter: true };

/// Part files in memory, by the thread of a test and their name.
static FILES: Mutex<Option<HashMap<PathBuf, Vec<u8>>>> = Mutex::new(None);

fn open(path: &Path) -> Result<(Cursor<Vec<u8>>, u64)> {
    let bytes = FILES.lock().unwrap().as_ref().unwrap()[path].clone();
    let length = bytes.len() as u64;
    Ok((Cursor::new(bytes), length))
}

fn keep(name: &str, bytes: Vec<u8>) -> PathBuf {
    let path = PathBuf::from(format!("{:?} {name}", std::thread::current().id()));
    FILES.lock().unwrap().get_or_insert_default().insert(path.clone(), bytes);
    path
}

fn lens(resolution: [u32; 2]) -> Pinhole {
    Pinhole { position: DVec3::new(0.0, 0.0, 3.0), target: DVec3::ZERO, fov_x: 40.0, resolution }
}

/// The samples of a portion: noise on a plane, with a hole in it.
fn sampled(resolution: [u32; 2], layers: Layers, portion: Portion) -> Film {
    let bytes = portion_bytes(resolution, layers, &portion);
    let mut film =
        Film::of_portion(resolution, layers, portion, Budget::unlimited().lease("a film", bytes).unwrap());
    for tile in (portion.tiles[0]..portion.tiles[1]).map(|index| tile(resolution, index)) {
        let pixels: Vec<_> = (0..tile.pixel_count()).map(|index| tile.pixel(index)).collect();
        for sample in portion.samples[0]..portion.samples[1] {
            let light = |&[x, y]: &[u32; 2]| {
                [0, 1, 2].map(|c| {
                    let key = u64::from(x) << 40 ^ u64::from(y) << 16 ^ u64::from(sample) << 4 ^ c;
                    (mix(key) >> 40) as f32 / (1 << 24) as f32
                })
            };
            let indirect: Vec<_> = pixels.iter().map(light).collect();
            film.add(&tile, &indirect.iter().map(|light| light.map(|x| x + 0.25)).collect::<Vec<_>>());
            if layers.filter {
                film.add_indirect(&tile, &indirect);
            }
        }
        for &[x, y] in pixels.iter().filter(|_| portion.samples[0] == 0) {
            let seen = LayerPixel {
                depth: 3.0,
                normal: [0.0, 0.0, 1.0],
                albedo: [0.5; 3],
                id: x ^ y,
                ..LayerPixel::NOTHING
            };
            film.set_layers([x, y], if x.abs_diff(9) < 3 { &LayerPixel::NOTHING } else { &seen });
        }
    }
    film
}

fn head(resolution: [u32; 2], layers: Layers, portion: Portion) -> PartHead {
    PartHead {
        resolution,
        portion,
        spp: SPP,
        layers,
        exposure: 1.0,
        damaged_page_count: 0,
        camera: [0.0; 11],
        facts: vec![],
    }
}

/// Part files of these portions.
fn parts(resolution: [u32; 2], layers: Layers, portions: &[Portion]) -> Vec<PartFile<Cursor<Vec<u8>>>> {
    let part = |(index, portion): (usize, &Portion)| {
        let (head, mut bytes) = (head(resolution, layers, *portion), vec![]);
        write_part(&sampled(resolution, layers, *portion), &head, &mut bytes).unwrap();
        let (_, hash) = PartHead::read(Path::new("a"), &mut &bytes[..], bytes.len() as u64).unwrap();
        PartFile::new(&keep(&index.to_string(), bytes), (*portion, hash))
    };
    portions.iter().enumerate().map(part).collect()
}

/// The EXR and the PNG of parts, and the mean.
fn merged(resolution: [u32; 2], layers: Layers, portions: &[Portion]) -> (Vec<u8>, Vec<u8>, [f64; 3]) {
    let (threads, interrupt, lens) = (pool(2), Interrupt::default(), lens(resolution));
    let head = head(resolution, layers, portions[0]);
    let strips = || {
        let parts = parts(resolution, layers, portions);
        let setup =
            MergeSetup { head: &head, parts, open, lens: &lens, pool: &threads, interrupt: &interrupt };
        MergedStrips::new(setup, &Budget::unlimited()).unwrap()
    };
    let (mut exr, mut png) = (Cursor::new(vec![]), vec![]);
    write_exr_strips(&mut strips(), &mut exr).unwrap();
    let mut strips = strips();
    write_png_strips(&mut strips, 1.0, &threads, &mut png).unwrap();
    (exr.into_inner(), png, strips.mean())
}

fn whole(resolution: [u32; 2], layers: Layers) -> (Vec<u8>, Vec<u8>, [f64; 3]) {
    let mut film = sampled(resolution, layers, Portion::whole(resolution, SPP));
    let threads = pool(2);
    if layers.filter {
        smooth(&mut film, &lens(resolution), &threads, &|| false);
    }
    let (mut exr, mut png) = (Cursor::new(vec![]), vec![]);
    write_exr(&film, &mut exr).unwrap();
    write_png(&film, 1.0, &threads, &mut png).unwrap();
    (exr.into_inner(), png, film.mean())
}

#[test]
fn tiles_give_the_bytes_of_the_whole() {
    let filtered = Layers { filter: true, ..Layers::default() };
    for (resolution, layers) in [
        ([37, 61], ALL),
        ([37, 61], filtered),
        ([8, 8], ALL),
        ([100, 17], Layers::default()),
        ([5, 300], filtered),
    ] {
        let expected = whole(resolution, layers);
        for count in [1, 3, 8].into_iter().filter(|&count| count <= tile_count(resolution)) {
            let mut portions: Vec<_> = (0..count)
                .map(|index| Portion::tiles_of_share(resolution, index, count))
                .map(|tiles| Portion { tiles, samples: [0, SPP] })
                .collect();
            portions.reverse();
            assert!(merged(resolution, layers, &portions) == expected, "{resolution:?} {layers:?} {count}");
        }
    }
}

/// Whatever the order in which the parts are named, the bytes are the same.
#[test]
fn a_cut_has_its_bytes_whatever_the_order_of_its_parts() {
    let resolution = [37, 61];
    let part = |tiles, samples| Portion { tiles, samples };
    let all = [0, tile_count(resolution)];
    let mut portions =
        vec![part(all, [0, 1]), part([0, 20], [1, 3]), part([20, all[1]], [1, 3]), part(all, [3, 4])];
    let first = merged(resolution, ALL, &portions);
    portions.reverse();
    assert!(merged(resolution, ALL, &portions) == first);
}

/// Two strips, however high the picture; and a limit below is refused with the one that works.
#[test]
fn a_merge_takes_what_is_leased_for_it() {
    let (threads, interrupt) = (pool(1), Interrupt::default());
    for resolution in [[200, 48], [200, 400]] {
        let portions = [Portion::whole(resolution, SPP)];
        let (lens, head) = (lens(resolution), head(resolution, ALL, portions[0]));
        let setup = |parts| MergeSetup {
            head: &head,
            parts,
            open,
            lens: &lens,
            pool: &threads,
            interrupt: &interrupt,
        };
        let bytes = merge_bytes(resolution, ALL, 1);
        let all = parts(resolution, ALL, &portions);
        let budget = Budget::new(RESERVE_BYTES + bytes);
        // The file in memory is no part of it, and of the disk in the field.
        let file = head.file_bytes();
        let taken = threads.install(|| {
            measure(|| {
                let mut strips = MergedStrips::new(setup(all), &budget).unwrap();
                write_exr_strips(&mut strips, &mut Cursor::new(Vec::with_capacity(1 << 20))).unwrap();
            })
        });
        assert!(taken.bytes_max <= bytes + file + (1 << 20), "{resolution:?} {taken:?} {bytes}");
        let error = MergedStrips::new(setup(vec![]), &Budget::new(RESERVE_BYTES + 1000)).err().unwrap();
        assert_eq!(error.code(), Code::MemoryLimit);
        assert_eq!(error.smallest_limit_bytes(), Some(RESERVE_BYTES + merge_bytes(resolution, ALL, 0)));
        assert_eq!((budget.used_bytes(), budget.peak_bytes()), (0, bytes));
    }
    let of_height = |height| merge_bytes([200, height], ALL, 1) - 8 * u64::from(height.div_ceil(16));
    assert_eq!(of_height(48), of_height(4800));
}

#[test]
fn damage_is_told_by_the_strip_that_meets_it() {
    let resolution = [40, 40];
    let (threads, interrupt, lens) = (pool(1), Interrupt::default(), lens(resolution));
    let portion = Portion::whole(resolution, SPP);
    let head = head(resolution, ALL, portion);
    let parts = parts(resolution, ALL, &[portion]);
    let path = parts[0].path.clone();
    let mut bytes = open(&path).unwrap().0.into_inner();
    let last = bytes.len() - 9;
    bytes[last] ^= 1;
    keep("0", bytes);
    let setup = MergeSetup { head: &head, parts, open, lens: &lens, pool: &threads, interrupt: &interrupt };
    let mut strips = MergedStrips::new(setup, &Budget::unlimited()).unwrap();
    assert!(write_png_strips(&mut strips, 1.0, &threads, io::sink()).is_err());
    let error = strips.take_failure().unwrap();
    assert!(error.code() == Code::Damaged && error.place().contains("at byte"), "{error}");
}
