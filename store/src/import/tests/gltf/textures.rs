//! Base colour textures: vertices have the colours of their places in the picture, computed here pixel by pixel.

use super::super::{Fixture, SourceMesh};
use super::glb::{F32, GlbWriter, U8, U16, U32, floats, grid, integers};
use crate::import::TextureUse;
use crate::srgb;
use base64::Engine;
use serde_json::{Value, json};

/// Texels of a side, and squares of the grid: each vertex stands at the centre of a texel.
const SIDE: usize = 16;

fn texel(x: usize, y: usize) -> [u8; 3] {
    [(x * 16) as u8, (255 - y * 16) as u8, ((x + y) * 7) as u8]
}

fn picture() -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, SIDE as u32, SIDE as u32);
    encoder.set_color(png::ColorType::Rgb);
    let texels = (0..SIDE).flat_map(|y| (0..SIDE).flat_map(move |x| texel(x, y))).collect::<Vec<u8>>();
    encoder.write_header().unwrap().write_image_data(&texels).unwrap();
    file
}

/// The place of a vertex of the grid.
fn place(vertex: usize) -> [f64; 2] {
    [vertex % SIDE, vertex / SIDE].map(|at| (at as f64 + 0.5) / SIDE as f64)
}

/// A grid whose material has the picture, with coordinates of this type in this set.
fn textured(component: u32, set: &str, info: Value) -> (GlbWriter, Vec<u32>) {
    let (positions, indices) = grid(SIDE - 1);
    let mut glb = GlbWriter::new();
    let places: Vec<[f64; 2]> = (0..positions.len()).map(place).collect();
    let share = |greatest: f64| -> Vec<u32> {
        places.as_flattened().iter().map(|part| (part * greatest).round() as u32).collect()
    };
    let bytes = match component {
        F32 => places.as_flattened().iter().flat_map(|&part| (part as f32).to_le_bytes()).collect(),
        U16 => integers(&share(65_535.0), U16),
        _ => integers(&share(255.0), U8),
    };
    let accessor = glb.accessor(&bytes, component, "VEC2", positions.len());
    glb.json["accessors"][accessor]["normalized"] = json!(component != F32);
    let view = glb.view(&picture());
    glb.json["images"] = json!([{ "mimeType": "image/png", "bufferView": view }]);
    glb.json["samplers"] = json!([{ "wrapS": 33_071, "wrapT": 33_071 }, {}]);
    glb.json["textures"] = json!([{ "source": 0, "sampler": 0 }, { "source": 0, "sampler": 1 }, {}]);
    let factor = json!([0.5, 0.25, 1.0, 1.0]);
    let look = json!({ "baseColorFactor": factor, "baseColorTexture": info, "metallicFactor": 0.0 });
    let material = glb.push("materials", json!({ "pbrMetallicRoughness": look }));
    let attributes = json!({ "POSITION": glb.positions(&positions), set: accessor });
    let indices_at = glb.indices(&indices, U32);
    glb.place(json!({ "attributes": attributes, "indices": indices_at, "material": material }));
    (glb, indices)
}

fn read(glb: &GlbWriter) -> SourceMesh {
    Fixture::new("a.glb", &glb.glb()).read().unwrap_or_else(|error| panic!("{error}"))
}

/// Checks that the corners have the texels that `expected` says of their vertices, each byte within `bound`.
fn check(mesh: &SourceMesh, indices: &[u32], bound: u8, expected: impl Fn(usize) -> [u8; 3]) {
    assert_eq!(mesh.colours.len(), indices.len() / 3);
    for (found, &vertex) in mesh.colours.as_flattened().iter().zip(indices) {
        let wanted = expected(vertex as usize);
        let is_near = found.iter().zip(wanted).all(|(found, wanted)| found.abs_diff(wanted) <= bound);
        assert!(is_near, "vertex {vertex}: {found:?}, not {wanted:?}");
    }
}

fn own_texel(vertex: usize) -> [u8; 3] {
    texel(vertex % SIDE, vertex / SIDE)
}

#[test]
fn vertices_have_the_colour_of_their_place() {
    // Coordinates of 8 bits are off by up to a thirtieth of a texel.
    for (component, bound) in [(F32, 0), (U16, 1), (U8, 2)] {
        let (glb, indices) = textured(component, "TEXCOORD_0", json!({ "index": 0 }));
        let mesh = read(&glb);
        check(&mesh, &indices, bound, own_texel);
        assert_eq!((mesh.stats.dropped_attribute_count, mesh.stats.warnings.len()), (0, 0));
    }
    let (glb, indices) = textured(F32, "TEXCOORD_2", json!({ "index": 0, "texCoord": 2 }));
    check(&read(&glb), &indices, 0, own_texel);
}

#[test]
fn pictures_beside_the_file_and_in_its_text_are_read() {
    let (mut glb, indices) = textured(F32, "TEXCOORD_0", json!({ "index": 0 }));
    let text = base64::engine::general_purpose::STANDARD.encode(picture());
    glb.json["images"] = json!([{ "uri": format!("data:image/png;base64,{text}") }]);
    check(&read(&glb), &indices, 0, own_texel);
    glb.json["images"] = json!([{ "uri": "a%20b.png" }]);
    let fixture = Fixture::new("a.glb", &glb.glb());
    std::fs::write(fixture.folder.path().join("a b.png"), picture()).unwrap();
    let mesh = fixture.read().unwrap();
    check(&mesh, &indices, 0, own_texel);
    assert!(mesh.stats.named_files[0].0.ends_with(b"a b.png"), "{:?}", mesh.stats.named_files);
}

/// Colours of vertices and of the picture are multiplied as light.
#[test]
fn colours_of_vertices_count_too() {
    let (mut glb, indices) = textured(F32, "TEXCOORD_0", json!({ "index": 0 }));
    let halves = glb.accessor(&floats(&vec![[0.5, 1.0, 0.25]; SIDE * SIDE]), F32, "VEC3", SIDE * SIDE);
    glb.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = json!(halves);
    let times = |byte: u8, by: f64| srgb::byte_of(by * srgb::linear_of(byte));
    check(&read(&glb), &indices, 1, |vertex| {
        let [r, g, b] = own_texel(vertex);
        [times(r, 0.5), g, times(b, 0.25)]
    });
}

/// A quarter turn, a mirror and a shift, each by whole texels.
#[test]
fn transforms_and_wraps_move_places() {
    let moved = |index: u32, transform: Value| {
        let extensions = json!({ "KHR_texture_transform": transform });
        let info = json!({ "index": index, "extensions": extensions });
        let (glb, indices) = textured(F32, "TEXCOORD_0", info);
        (read(&glb), indices)
    };
    // v grows downwards: a turn against the clock takes what is right of the corner to above it.
    let (mesh, indices) = moved(1, json!({ "rotation": std::f64::consts::FRAC_PI_2, "offset": [0.0, 1.0] }));
    check(&mesh, &indices, 1, |vertex| texel(vertex / SIDE, SIDE - 1 - vertex % SIDE));
    let (mesh, indices) = moved(1, json!({ "scale": [-1.0, 1.0], "offset": [1.0, 0.0] }));
    check(&mesh, &indices, 1, |vertex| texel(SIDE - 1 - vertex % SIDE, vertex / SIDE));
    // Past the edge: the picture again, or its edge.
    let (mesh, indices) = moved(1, json!({ "offset": [0.25, 0.0] }));
    check(&mesh, &indices, 1, |vertex| texel((vertex % SIDE + 4) % SIDE, vertex / SIDE));
    let (mesh, indices) = moved(0, json!({ "offset": [0.25, 0.0] }));
    check(&mesh, &indices, 1, |vertex| texel((vertex % SIDE + 4).min(SIDE - 1), vertex / SIDE));
}

fn material_of(glb: &GlbWriter, textures: TextureUse) -> (crate::Material, Vec<String>) {
    let fixture = Fixture::new("a.glb", &glb.glb());
    let options = crate::import::ImportOptions { textures, ..fixture.options() };
    let mut source = crate::import::open(&fixture.path, &options).unwrap();
    let mut batch = crate::TriangleBatch::default();
    while source.next_batch(&mut batch).unwrap() {
        let is_white = (0..batch.len()).all(|i| batch.attributes.of(i).colours == [[255; 3]; 3]);
        assert!(is_white || textures == TextureUse::Sampled);
    }
    (source.materials()[1], source.stats().warnings)
}

#[test]
fn a_material_keeps_its_factor_or_has_the_mean_of_its_picture() {
    let (glb, _) = textured(F32, "TEXCOORD_0", json!({ "index": 0 }));
    let close = |found: [f32; 3], wanted: [f64; 3]| {
        assert!(
            found.iter().zip(wanted).all(|(f, w)| (f64::from(*f) - w).abs() < 1e-5),
            "{found:?}, {wanted:?}"
        );
    };
    let factor = [0.5, 0.25, 1.0];
    let (material, warnings) = material_of(&glb, TextureUse::Sampled);
    close(material.kd, factor.map(|c| 0.96 * c));
    assert_eq!(warnings, [""; 0]);
    let texels = (0..SIDE * SIDE).map(|at| texel(at % SIDE, at / SIDE).map(srgb::linear_of));
    let mean = texels.fold([0.0; 3], |sum, t| [0, 1, 2].map(|i| sum[i] + t[i] / (SIDE * SIDE) as f64));
    let (material, _) = material_of(&glb, TextureUse::Mean);
    close(material.kd, [0, 1, 2].map(|i| 0.96 * factor[i] * mean[i]));
}

/// What is no picture, or not there, costs the picture alone, and is told.
#[test]
fn pictures_that_cannot_be_read_are_told() {
    for (image, words) in [
        (json!({ "uri": "not-there.png" }), "No such file"),
        (json!({ "uri": "http://example.com/a.png" }), "not on this machine"),
        (json!({ "uri": "data:image/png;base64,AAAA" }), "neither PNG nor JPEG"),
        (json!({ "uri": "data:image/png;base64,?" }), "no base64"),
        (json!({ "bufferView": 77 }), "a view that is not there"),
        (json!({}), "names no bytes"),
    ] {
        let (mut glb, _) = textured(F32, "TEXCOORD_0", json!({ "index": 0 }));
        glb.json["images"] = json!([image]);
        let (material, warnings) = material_of(&glb, TextureUse::Sampled);
        assert!(warnings.iter().any(|told| told.contains(words)), "{image}: {warnings:?}");
        assert!(warnings.iter().any(|told| told.contains("half of their colour")), "{image}: {warnings:?}");
        assert!((material.kd[0] - 0.24).abs() < 1e-5, "{:?}", material.kd);
    }
}

#[test]
fn triangles_that_show_little_of_their_picture_are_told() {
    let (mut glb, _) = textured(F32, "TEXCOORD_0", json!({ "index": 0 }));
    glb.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["extensions"] =
        json!({ "KHR_texture_transform": { "scale": [12.0, 12.0] } });
    let mesh = read(&glb);
    let told = format!("{0} of {0} triangles with a picture", mesh.triangles.len());
    assert!(mesh.stats.warnings.iter().any(|warning| warning.contains(&told)), "{:?}", mesh.stats.warnings);
}
