//! Pictures of OBJ materials: corners have the colours of their places in the picture, computed here pixel by pixel.

use super::{Fixture, SourceMesh, read};
use crate::error::Code;
use crate::import::{ImportOptions, TextureUse, open};
use crate::source::TriangleBatch;
use crate::srgb;

/// Two pixels across and two down: red, green; blue, white.
const PIXELS: [[u8; 3]; 4] = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]];

fn picture() -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, 2, 2);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header().unwrap().write_image_data(PIXELS.as_flattened()).unwrap();
    file
}

/// A square with its coordinates in the picture, from the lower left corner to the upper right one.
const SQUARE: &str = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n\
    vt 0.25 0.25\nvt 0.75 0.25\nvt 0.75 0.75\nvt 0.25 0.75\nusemtl skin\nf 1/1 2/2 3/3 4/4\n";
/// What its corners have: of a picture, the lower row is the last.
const CORNERS: [[u8; 3]; 4] = [PIXELS[2], PIXELS[3], PIXELS[1], PIXELS[0]];

fn fixture(obj: &str, mtl: &str) -> Fixture {
    let fixture = Fixture::new("a.obj", obj.as_bytes());
    std::fs::write(fixture.folder.path().join("m.mtl"), mtl).unwrap();
    std::fs::write(fixture.folder.path().join("a picture.png"), picture()).unwrap();
    fixture
}

fn square(map: &str) -> SourceMesh {
    fixture(SQUARE, &format!("newmtl skin\nKd 1 1 1\n{map}\n")).read().unwrap()
}

/// The colours of the four corners.
fn corners(mesh: &SourceMesh) -> [[u8; 3]; 4] {
    let [[a, b, c], [first, third, d]] = mesh.colours[..] else { panic!("{:?}", mesh.colours) };
    assert_eq!((a, c), (first, third));
    [a, b, c, d]
}

/// Kd of the second material, after all was read.
fn kd(fixture: &Fixture, textures: TextureUse) -> [f32; 3] {
    let options = ImportOptions { textures, ..fixture.options() };
    let mut source = open(&fixture.path, &options).unwrap();
    let mut batch = TriangleBatch::default();
    while source.next_batch(&mut batch).unwrap() {}
    source.materials()[1].kd
}

#[test]
fn corners_have_the_colours_of_their_places() {
    let mesh = square("map_Kd a picture.png");
    assert_eq!(corners(&mesh), CORNERS);
    assert!(mesh.stats.warnings.is_empty(), "{:?}", mesh.stats.warnings);
    assert_eq!(mesh.stats.dropped_attribute_count, 0);
    let names: Vec<String> =
        mesh.stats.named_files.iter().map(|(name, _)| String::from_utf8_lossy(name).into()).collect();
    assert!(names.iter().any(|name| name.ends_with("/a picture.png")), "{names:?}");
}

#[test]
fn rows_have_options_and_names_of_other_machines() {
    for map in [
        "map_Kd -s 1 1 1 -o 0 0 0 a picture.png",
        "map_Kd -blendu on -clamp off -bm 2 -mm 0 1 a picture.png",
        "map_Kd C:\\scans\\a picture.png",
        "map_Kd \"a picture.png\"",
        "map_Kd missing.png\nmap_Kd a picture.png",
    ] {
        assert_eq!(corners(&square(map)), CORNERS, "{map}");
    }
    // Half a picture to the right: beside it is the picture again, or its edge.
    let [a, b, c, d] = CORNERS;
    assert_eq!(corners(&square("map_Kd -o 0.5 a picture.png")), [b, a, d, c]);
    assert_eq!(corners(&square("map_Kd -clamp on -o 0.5 a picture.png")), [b, b, c, c]);
    // From the middle of the picture on, one and a half of it.
    let halved = corners(&square("map_Kd -s 2 2 -o -0.25 -0.25 -clamp on a picture.png"));
    assert_eq!(halved, CORNERS);
}

#[test]
fn between_texels_light_is_mixed_not_bytes() {
    let obj = SQUARE.replace("vt 0.75 0.25", "vt 0.5 0.25");
    let mesh = fixture(&obj, "newmtl skin\nKd 1 1 1\nmap_Kd a picture.png\n").read().unwrap();
    let half = srgb::byte_of(0.5);
    assert_eq!(corners(&mesh)[1], [half, half, 255]);
}

#[test]
fn a_picture_is_times_the_colours_of_vertices() {
    let obj = SQUARE.replace("v 1 0 0\n", "v 1 0 0 1 0.5 0\n");
    let mesh = fixture(&obj, "newmtl skin\nKd 1 1 1\nmap_Kd a picture.png\n").read().unwrap();
    let [a, b, c, d] = corners(&mesh);
    // Of the white pixel.
    assert_eq!([a, b, c, d], [CORNERS[0], [255, 128, 0], CORNERS[2], CORNERS[3]]);
}

#[test]
fn what_is_not_there_costs_the_picture_alone() {
    for (map, why) in [("map_Kd none.png", "none.png is not read"), ("map_Kd m.mtl", "m.mtl is not read")] {
        let mesh = square(map);
        assert_eq!(corners(&mesh), [[255; 3]; 4], "{map}");
        assert!(mesh.stats.warnings.iter().any(|told| told.contains(why)), "{:?}", mesh.stats.warnings);
    }
    for (colour, expected) in [("Kd 0.2 0.4 0.6", [0.2, 0.4, 0.6]), ("Kd 0 0 0", [0.5; 3])] {
        let unread = fixture(SQUARE, &format!("newmtl skin\n{colour}\nmap_Kd none.png\n"));
        assert_eq!(kd(&unread, TextureUse::Sampled), expected);
    }
}

#[test]
fn the_mean_stands_for_pictures_that_are_not_sampled() {
    for (colour, own) in [("Kd 1 0.5 0.25", [1.0, 0.5, 0.25]), ("Kd 0 0 0", [1.0; 3])] {
        let fixture = fixture(SQUARE, &format!("newmtl skin\n{colour}\nmap_Kd a picture.png\n"));
        assert_eq!(kd(&fixture, TextureUse::Sampled), own);
        // Each channel is full in two of four pixels.
        assert_eq!(kd(&fixture, TextureUse::Mean), own.map(|part| part * 0.5));
        let options = ImportOptions { textures: TextureUse::Mean, ..fixture.options() };
        assert_eq!(corners(&read(&fixture.path, &options).unwrap()), [[255; 3]; 4]);
    }
}

/// Corners without coordinates, with some that are not there, and a picture that is named too late.
#[test]
fn corners_without_a_place_have_the_mean() {
    let mtl = "newmtl skin\nKd 1 1 1\nmap_Kd a picture.png\n";
    let mean = [srgb::byte_of(0.5); 3];
    let mesh = fixture(&SQUARE.replace("f 1/1 2/2 3/3 4/4", "f 1 2/9 3/3 4//"), mtl).read().unwrap();
    assert_eq!(corners(&mesh), [mean, mean, CORNERS[2], mean]);
    assert!(mesh.stats.warnings[0].contains("coordinates that are not there"), "{:?}", mesh.stats.warnings);
    let late = SQUARE.replace("mtllib m.mtl\n", "").replace("usemtl", "mtllib m.mtl\nusemtl");
    let mesh = fixture(&late, mtl).read().unwrap();
    assert_eq!(corners(&mesh), [mean; 4]);
    assert!(mesh.stats.warnings[0].contains("mtllib"), "{:?}", mesh.stats.warnings);
    assert_eq!(mesh.stats.dropped_attribute_count, 4);
}

/// A library behind another, and one behind a face of its material: as on the first pass, with which `read` compares.
#[test]
fn pictures_that_are_named_late_are_so_on_every_pass() {
    let mtl = "newmtl skin\nKd 1 1 1\nmap_Kd a picture.png\n";
    let mean = [srgb::byte_of(0.5); 3];
    let behind = SQUARE.replace("mtllib m.mtl", "mtllib none.mtl").replace("usemtl", "mtllib m.mtl\nusemtl");
    assert_eq!(corners(&fixture(&behind, mtl).read().unwrap()), [mean; 4]);
    let ahead = "v 0 0 0\nv 1 0 0\nv 1 1 0\nusemtl skin\nf 1 2 3\nmtllib m.mtl\nf 1 2 3\n";
    assert_eq!(fixture(ahead, mtl).read().unwrap().colours, [[[255; 3]; 3], [mean; 3]]);
}

#[test]
fn large_triangles_are_told() {
    let obj = SQUARE.replace("vt 0.75 0.75", "vt 80.75 80.75");
    let mesh = fixture(&obj, "newmtl skin\nKd 1 1 1\nmap_Kd a picture.png\n").read().unwrap();
    assert!(mesh.stats.warnings[0].starts_with("2 of 2 triangles"), "{:?}", mesh.stats.warnings);
}

/// A budget that has no room for the caches says so before anything is taken.
#[test]
fn memory_is_leased_before_pictures_are_read() {
    let fixture = fixture(SQUARE, "newmtl skin\nmap_Kd a picture.png\n");
    let mut refused = 0;
    for kib in 0..64 {
        let budget = crate::budget::Budget::new(crate::budget::RESERVE_BYTES + (kib << 16));
        let options = ImportOptions { budget: budget.clone(), ..fixture.options() };
        match read(&fixture.path, &options) {
            Ok(mesh) => assert_eq!(corners(&mesh), CORNERS),
            Err(error) => {
                assert_eq!(error.code(), Code::MemoryLimit, "{error}");
                refused += 1;
            }
        }
        assert_eq!(budget.used_bytes(), 0);
    }
    assert!((1..64).contains(&refused), "{refused}");
}
