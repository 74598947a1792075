//! Nodes, instances, materials, cameras and lights.

use super::super::{Fixture, SourceMesh, SourceTriangle};
use super::glb::{GlbWriter, U8};
use crate::source_scene::{SourceCamera, SourceLight};
use serde_json::{Value, json};

const TRIANGLE: [[f64; 3]; 3] = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]];

/// A mesh of one triangle, in no node.
fn triangle_mesh() -> GlbWriter {
    let mut glb = GlbWriter::new();
    let positions = glb.positions(&TRIANGLE);
    glb.push("meshes", json!({ "primitives": [{ "attributes": { "POSITION": positions } }] }));
    glb
}

fn read(glb: &GlbWriter) -> SourceMesh {
    Fixture::new("a.glb", &glb.glb()).read().unwrap_or_else(|error| panic!("{error}"))
}

fn moved(by: [f64; 3]) -> SourceTriangle {
    TRIANGLE.map(|corner| std::array::from_fn(|axis| corner[axis] + by[axis]))
}

#[test]
fn children_stand_where_their_parents_place_them() {
    let mut glb = triangle_mesh();
    // A parent that doubles and moves, its child with a matrix, and that one's child.
    let leaf = glb.push("nodes", json!({ "mesh": 0, "translation": [0, 0, 0.5] }));
    let matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 10, 0, 1];
    let child = glb.push("nodes", json!({ "mesh": 0, "matrix": matrix, "children": [leaf] }));
    glb.node(json!({ "scale": [2, 2, 2], "translation": [100, 0, 0], "children": [child] }));
    let mesh = read(&glb);
    let doubled =
        |by: [f64; 3]| TRIANGLE.map(|corner| std::array::from_fn(|axis| 2.0 * corner[axis] + by[axis]));
    assert_eq!(mesh.triangles, [doubled([100.0, 20.0, 0.0]), doubled([100.0, 20.0, 1.0])]);
    assert_eq!((mesh.stats.instanced_mesh_count, mesh.stats.instance_count), (1, 2));
}

/// Far from the origin an f32 would move corners by a quarter: transforms are f64.
#[test]
fn transforms_are_exact_far_away() {
    let mut glb = triangle_mesh();
    glb.node(json!({ "mesh": 0, "translation": [4_000_000.125, -0.0078125, 0] }));
    assert_eq!(read(&glb).triangles, [moved([4_000_000.125, -0.0078125, 0.0])]);
}

#[test]
fn mirrored_triangles_turn_the_other_way() {
    let mut glb = triangle_mesh();
    glb.node(json!({ "mesh": 0, "scale": [-1, 1, 1] }));
    glb.node(json!({ "mesh": 0, "scale": [-1, -1, 1] }));
    let [a, b, c] = TRIANGLE;
    let times = |corner: [f64; 3], x: f64, y: f64| [corner[0] * x, corner[1] * y, corner[2]];
    let once = [times(a, -1.0, 1.0), times(c, -1.0, 1.0), times(b, -1.0, 1.0)];
    assert_eq!(read(&glb).triangles, [once, [a, b, c].map(|corner| times(corner, -1.0, -1.0))]);
}

#[test]
fn instances_of_a_node() {
    let mut glb = triangle_mesh();
    let places: Vec<[f64; 3]> = (0..9000).map(|i| [f64::from(i), f64::from(i % 3), 0.0]).collect();
    let scales: Vec<[f64; 3]> = (0..9000).map(|i| [1.0, 1.0, if i % 2 == 0 { 1.0 } else { -1.0 }]).collect();
    let (places_at, scales_at) = (glb.positions(&places), glb.positions(&scales));
    glb.node(json!({
        "mesh": 0, "translation": [0, 0, 7],
        "extensions": { "EXT_mesh_gpu_instancing": { "attributes": { "TRANSLATION": places_at, "SCALE": scales_at } } },
    }));
    let mesh = read(&glb);
    let expected: Vec<_> = places
        .iter()
        .enumerate()
        .map(|(at, place)| {
            let mut triangle = moved([place[0], place[1], 7.0]);
            if at % 2 == 1 {
                triangle.swap(1, 2);
            }
            triangle
        })
        .collect();
    assert!(mesh.triangles == expected);
    assert_eq!(mesh.stats.instance_count, 9000);
}

#[test]
fn scenes_and_what_is_in_none() {
    let mut glb = triangle_mesh();
    let other = glb.push("nodes", json!({ "mesh": 0, "translation": [0, 0, 9] }));
    glb.node(json!({ "mesh": 0 }));
    assert_eq!(read(&glb).triangles, [TRIANGLE]);
    glb.push("scenes", json!({ "nodes": [other] }));
    glb.json["scene"] = json!(1);
    assert_eq!(read(&glb).triangles, [moved([0.0, 0.0, 9.0])]);
    glb.json["scene"] = Value::Null;
    assert_eq!(read(&glb).triangles, [TRIANGLE]);
    glb.json["scenes"] = json!([]);
    let all = read(&glb);
    assert_eq!(all.triangles, [moved([0.0, 0.0, 9.0]), TRIANGLE]);
    assert!(
        all.stats.warnings.iter().any(|warning| warning.contains("no scene")),
        "{:?}",
        all.stats.warnings
    );
    let hidden = json!({ "KHR_node_visibility": { "visible": false } });
    glb.json["nodes"][other]["extensions"] = hidden;
    assert_eq!(read(&glb).triangles, [TRIANGLE]);
    glb.json["nodes"] = json!([]);
    let none = read(&glb);
    assert!(none.triangles.is_empty());
    assert!(none.stats.warnings.iter().any(|warning| warning.starts_with("1 meshes are in no node")));
}

/// A walk of calls would take a stack as deep as the chain.
#[test]
fn a_chain_of_a_hundred_thousand_nodes() {
    let mut glb = triangle_mesh();
    let nodes: Vec<Value> =
        (1..100_000).map(|next| json!({ "translation": [1, 0, 0], "children": [next] })).collect();
    glb.json["nodes"] = json!(nodes);
    glb.push("nodes", json!({ "mesh": 0 }));
    glb.json["scenes"][0]["nodes"] = json!([0]);
    assert_eq!(read(&glb).triangles, [moved([99_999.0, 0.0, 0.0])]);
}

#[test]
fn points_and_lines_are_left_out() {
    let mut glb = triangle_mesh();
    let indices = glb.indices(&[0, 1, 2, 0, 1], U8);
    glb.json["meshes"][0]["primitives"] = json!([
        { "attributes": { "POSITION": 0 }, "mode": 0 }, { "attributes": { "POSITION": 0 }, "mode": 3 },
        { "attributes": { "NORMAL": 0 } }, { "attributes": { "POSITION": 0 }, "indices": indices },
    ]);
    glb.node(json!({ "mesh": 0 }));
    let mesh = read(&glb);
    assert_eq!((mesh.triangles, mesh.stats.skipped_face_count), (vec![TRIANGLE], 5));
    assert_eq!(mesh.stats.warnings.len(), 2, "{:?}", mesh.stats.warnings);
}

/// What is exported holds the default among its materials: read back, it has no second one.
#[test]
fn a_material_called_default_is_that_of_what_has_none() {
    let mut glb = triangle_mesh();
    let named = |name: &str| json!({ "name": name, "extensions": { "KHR_materials_unlit": {} } });
    glb.json["materials"] = json!([named("a"), named("default"), named("b"), named("default")]);
    glb.json["meshes"][0]["primitives"] = json!([
        { "attributes": { "POSITION": 0 }, "material": 0 }, { "attributes": { "POSITION": 0 }, "material": 1 },
        { "attributes": { "POSITION": 0 }, "material": 2 }, { "attributes": { "POSITION": 0 }, "material": 3 },
        { "attributes": { "POSITION": 0 } },
    ]);
    glb.node(json!({ "mesh": 0 }));
    let mesh = read(&glb);
    assert_eq!(mesh.material_names, ["a", "default", "b", "default", "default"]);
    let fixture = Fixture::new("a.glb", &glb.glb());
    let source = crate::import::open(&fixture.path, &fixture.options()).unwrap();
    let names: Vec<_> = source.materials().names().iter().collect();
    // A second one of that name is another.
    assert_eq!(names, ["default", "a", "b", "default"]);
    assert_eq!((source.materials()[0].kd, source.materials()[1].kd), ([1.0; 3], [1.0; 3]));
}

/// The first material of a document as the one that is drawn.
fn drawn(material: &Value) -> crate::Material {
    let mut glb = triangle_mesh();
    glb.json["materials"] = json!([material]);
    glb.node(json!({ "mesh": 0 }));
    let fixture = Fixture::new("a.glb", &glb.glb());
    let source = crate::import::open(&fixture.path, &fixture.options()).unwrap();
    assert_eq!(source.materials().len(), 2);
    source.materials()[1]
}

#[test]
fn metal_and_roughness_become_phong() {
    let close = |found: [f32; 3], want: [f32; 3]| {
        assert!((0..3).all(|c| (found[c] - want[c]).abs() < 1e-6), "{found:?}, expected {want:?}");
    };
    let pbr = |colour: Value, metallic: f64, roughness: f64| {
        json!({ "pbrMetallicRoughness": {
            "baseColorFactor": colour, "metallicFactor": metallic, "roughnessFactor": roughness
        } })
    };
    let plastic = drawn(&pbr(json!([0.5, 0.25, 1, 1]), 0.0, 0.5));
    close(plastic.kd, [0.48, 0.24, 0.96]);
    close(plastic.ks, [0.04; 3]);
    // Roughness 0.5: alpha 0.25, and 2 / 0.0625 - 2 = 30, a quarter of it.
    assert_eq!((plastic.ns, plastic.mirror, plastic.d), (7.5, false, 1.0));
    let gold = drawn(&pbr(json!([1, 0.75, 0.25, 1]), 1.0, 1.0));
    close(gold.kd, [0.0; 3]);
    close(gold.ks, [1.0, 0.75, 0.25]);
    assert_eq!((gold.ns, gold.mirror), (0.0, false));
    assert!(drawn(&pbr(json!([1, 1, 1, 1]), 1.0, 0.0)).mirror);
    assert!(!drawn(&pbr(json!([1, 1, 1, 1]), 0.0, 0.0)).mirror);
    // Without any numbers a material of glTF is white metal.
    close(drawn(&json!({})).ks, [1.0; 3]);
    let lamp = drawn(&json!({
        "emissiveFactor": [1, 0.5, 0], "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 20 } }
    }));
    close(lamp.ke, [20.0, 10.0, 0.0]);
    let textured = drawn(&json!({ "pbrMetallicRoughness": {
        "baseColorTexture": { "index": 0 }, "metallicRoughnessTexture": { "index": 1 }
    } }));
    close(textured.kd, [0.48; 3]);
    close(textured.ks, [0.04; 3]);
    let mut glass = pbr(json!([1, 1, 1, 0.5]), 0.0, 0.5);
    assert_eq!(drawn(&glass).d, 1.0);
    glass["alphaMode"] = json!("BLEND");
    assert_eq!(drawn(&glass).d, 0.5);
    glass["extensions"] = json!({
        "KHR_materials_ior": { "ior": 3 }, "KHR_materials_transmission": { "transmissionFactor": 0.5 }
    });
    assert_eq!(drawn(&glass).d, 0.25);
    close(drawn(&glass).ks, [0.25; 3]);
    let older = drawn(&json!({ "extensions": { "KHR_materials_pbrSpecularGlossiness": {
        "diffuseFactor": [1, 0.5, 0, 1], "specularFactor": [0.5, 0.5, 0.5], "glossinessFactor": 0.5
    } } }));
    close(older.kd, [0.5, 0.25, 0.0]);
    close(older.ks, [0.5; 3]);
    assert_eq!(older.ns, 7.5);
    let unlit = drawn(&json!({
        "pbrMetallicRoughness": { "baseColorFactor": [0.25, 0.5, 0.75, 1] },
        "extensions": { "KHR_materials_unlit": {} }
    }));
    close(unlit.kd, [0.25, 0.5, 0.75]);
    close(unlit.ks, [0.0; 3]);
}

#[test]
fn cameras_and_lights_are_found() {
    let mut glb = triangle_mesh();
    let yfov = std::f64::consts::FRAC_PI_2;
    glb.json["cameras"] = json!([
        { "type": "orthographic", "orthographic": { "xmag": 1, "ymag": 1, "znear": 0, "zfar": 1 } },
        { "type": "perspective", "perspective": { "yfov": yfov, "znear": 0.1 } },
    ]);
    let light = |kind: &str| json!({ "type": kind, "color": [1, 0.5, 0], "intensity": 8 });
    let lights: Vec<Value> = ["point", "directional", "spot", "laser"].map(light).into();
    glb.json["extensions"] = json!({ "KHR_lights_punctual": { "lights": lights } });
    glb.node(json!({ "mesh": 0 }));
    let turned = [0.0, std::f64::consts::FRAC_1_SQRT_2, 0.0, std::f64::consts::FRAC_1_SQRT_2];
    glb.node(json!({ "camera": 0 }));
    glb.node(json!({ "camera": 1, "translation": [1, 2, 3], "rotation": turned }));
    for at in 0..4 {
        let place = json!({ "KHR_lights_punctual": { "light": at } });
        glb.node(json!({ "translation": [at, 0, 0], "rotation": turned, "extensions": place }));
    }
    let mesh = read(&glb);
    let scene = &mesh.stats.scene;
    let SourceCamera { position, direction, up, fov_y_degrees } = scene.camera.unwrap();
    let near = |a: [f64; 3], b: [f64; 3]| (0..3).all(|axis| (a[axis] - b[axis]).abs() < 1e-12);
    // A quarter turn around y makes -z to -x.
    assert!(position == [1.0, 2.0, 3.0] && near(direction, [-1.0, 0.0, 0.0]) && near(up, [0.0, 1.0, 0.0]));
    assert!((fov_y_degrees - 90.0).abs() < 1e-9);
    let colour = [8.0, 4.0, 0.0];
    let [point, SourceLight::Directional { direction, irradiance }, spot] = scene.lights[..] else {
        panic!("{scene:?}");
    };
    assert_eq!(point, SourceLight::Point { position: [0.0; 3], intensity: colour, is_spot: false });
    assert_eq!(spot, SourceLight::Point { position: [2.0, 0.0, 0.0], intensity: colour, is_spot: true });
    assert!(near(direction, [-1.0, 0.0, 0.0]) && irradiance == colour);
    assert_eq!(mesh.stats.warnings.len(), 2, "{:?}", mesh.stats.warnings);
}
