//! Files that lie, or say what is not read: each is refused in four parts, before anything is taken for it.

use super::super::{Fixture, check_error};
use super::glb::{F32, GlbWriter, U8, U16, U32, glb, grid, small_glb};
use crate::budget::{Budget, RESERVE_BYTES};
use crate::error::Code;
use crate::import::{Format, ImportOptions, info, open};
use serde_json::{Value, json};

/// A small sound file, changed.
fn changed(change: impl FnOnce(&mut Value)) -> Vec<u8> {
    let (positions, indices) = grid(3);
    let mut writer = GlbWriter::new();
    let primitive = json!({
        "attributes": { "POSITION": writer.positions(&positions) }, "indices": writer.indices(&indices, U16)
    });
    writer.place(primitive);
    change(&mut writer.json);
    writer.glb()
}

fn check(code: Code, words: &str, change: impl FnOnce(&mut Value)) {
    check_error("a.glb", &changed(change), code, words);
}

#[test]
fn headers_that_lie() {
    let sound = changed(|_| {});
    let with = |at: usize, bytes: &[u8]| {
        let mut file = sound.clone();
        file[at..at + bytes.len()].copy_from_slice(bytes);
        file
    };
    check_error("a.glb", &with(4, &[1]), Code::InputFormat, "version 1");
    check_error("a.glb", &with(8, &[0xff; 4]), Code::InputTruncated, "4294967295 bytes in the header");
    check_error("a.glb", &with(12, &[0xff; 4]), Code::InputTruncated, "4294967295 bytes");
    check_error("a.glb", &with(16, b"BIN\0"), Code::InputFormat, "first chunk");
    check_error("a.glb", b"glTF\x02\0\0\0", Code::InputTruncated, "12 bytes needed");
    check_error("a.glb", b"{\"asset\":{}}", Code::InputFormat, "begins with the letters `glTF`");
    check_error("a.gltf", &sound, Code::InputFormat, "named .gltf, begins like .glb");
    let json_at = 20 + sound[20..].windows(3).position(|three| three == b"BIN").unwrap() - 4;
    check_error(
        "a.glb",
        &with(json_at, &[0xf0, 0xff, 0xff, 0]),
        Code::InputTruncated,
        "longer than the file",
    );
}

#[test]
fn versions_and_extensions() {
    check(Code::InputFormat, "version 1.0", |json| json["asset"]["version"] = json!("1.0"));
    check(Code::InputFormat, "asset.version", |json| json["asset"] = json!({}));
    check(Code::InputFormat, "EXT_other", |json| json["extensionsRequired"] = json!(["EXT_other"]));
    // The accessors have no bytes, and the stream is not there.
    check(
        Code::InputFormat,
        if cfg!(feature = "draco") { "no list" } else { "gltf-transform copy" },
        |json| {
            json["meshes"][0]["primitives"][0]["extensions"] = json!({ "KHR_draco_mesh_compression": {} });
            json["accessors"][0].as_object_mut().unwrap().remove("bufferView");
        },
    );
    check_error("a.gltf", b"{\"asset\":", Code::InputFormat, "EOF");
    check_error("a.gltf", b"[1]", Code::InputFormat, "invalid type");
}

#[test]
fn counts_and_offsets_that_lie() {
    let accessor =
        |key: &'static str, value: Value| move |json: &mut Value| json["accessors"][0][key] = value;
    let view = |key: &'static str, value: Value| move |json: &mut Value| json["bufferViews"][0][key] = value;
    check(Code::InputRange, "outside of its view", accessor("count", json!(17)));
    check(Code::InputRange, "outside of its view", accessor("count", json!(u64::MAX)));
    check(Code::InputRange, "outside of its view", accessor("byteOffset", json!(u64::MAX)));
    check(Code::InputRange, "outside of its view", view("byteLength", json!(191)));
    check(Code::InputRange, "outside of its buffer", view("byteLength", json!(u64::MAX)));
    check(Code::InputRange, "outside of its buffer", view("byteOffset", json!(u64::MAX)));
    check(Code::InputFormat, "on top of each other", view("byteStride", json!(8)));
    check(Code::InputFormat, "buffers[3]", view("buffer", json!(3)));
    check(Code::InputFormat, "bufferViews[9]", accessor("bufferView", json!(9)));
    check(Code::InputFormat, "componentType 7", accessor("componentType", json!(7)));
    check(Code::InputFormat, "VEC2", accessor("type", json!("VEC2")));
    check(Code::InputFormat, "componentType 5125", accessor("componentType", json!(U32)));
    check(Code::InputFormat, "-1", accessor("count", json!(-1)));
    check(Code::InputTruncated, "bytes said", |json| json["buffers"][0]["byteLength"] = json!(1u64 << 40));
    check(Code::InputFormat, "no URI", |json| {
        let buffer = json["buffers"][0].clone();
        json["buffers"].as_array_mut().unwrap().push(buffer);
        json["bufferViews"][0]["buffer"] = json!(1);
    });
    // Zeros without end, of no bytes at all.
    check(Code::InputRange, "at most without a view", |json| {
        json["accessors"][0] = json!({ "componentType": F32, "type": "VEC3", "count": 4_000_000_000u32 });
    });
}

#[test]
fn references_to_what_is_not_there() {
    check(Code::InputRange, "index 16", |json| {
        json["accessors"][0]["count"] = json!(16);
        json["accessors"][1]["byteOffset"] = json!(0);
        json["accessors"][1]["componentType"] = json!(U8);
        json["accessors"][1]["count"] = json!(36);
        json["accessors"][0]["count"] = json!(15);
        json["accessors"][1]["componentType"] = json!(U16);
        json["accessors"][1]["count"] = json!(54);
        json["accessors"][0]["count"] = json!(16);
        json["bufferViews"][1]["byteOffset"] = json!(12);
    });
    let node = |key: &'static str, value: Value| move |json: &mut Value| json["nodes"][0][key] = value;
    check(Code::InputFormat, "meshes[5]", node("mesh", json!(5)));
    check(Code::InputFormat, "cameras[1]", node("camera", json!(1)));
    check(Code::InputFormat, "nodes[8]", node("children", json!([8])));
    check(Code::InputFormat, "under itself", node("children", json!([0])));
    check(Code::InputFormat, "scenes[4]", |json| json["scene"] = json!(4));
    let primitive = |key: &'static str, value: Value| {
        move |json: &mut Value| json["meshes"][0]["primitives"][0][key] = value
    };
    check(Code::InputFormat, "materials[2]", primitive("material", json!(2)));
    check(Code::InputFormat, "accessors[99]", primitive("indices", json!(99)));
    check(Code::InputFormat, "mode 7", primitive("mode", json!(7)));
    // Two parents make every picture of it a question, and a stack of them 2^n of it.
    check(Code::InputFormat, "under two others", |json| {
        json["nodes"] =
            json!([{ "children": [1, 2] }, { "children": [3] }, { "children": [3] }, { "mesh": 0 }]);
    });
    check(Code::InputFormat, "different counts", |json| {
        let rows =
            |count: u32| json!({ "bufferView": 0, "componentType": F32, "type": "VEC3", "count": count });
        json["accessors"].as_array_mut().unwrap().extend([rows(2), rows(3)]);
        let attributes = json!({ "TRANSLATION": 2, "SCALE": 3 });
        json["nodes"][0]["extensions"] = json!({ "EXT_mesh_gpu_instancing": { "attributes": attributes } });
    });
}

#[test]
fn sparse_accessors_that_lie() {
    let sparse = |count: u64, offset: u64| {
        move |json: &mut Value| {
            json["accessors"][0]["sparse"] = json!({
                "count": count, "values": { "bufferView": 0 },
                "indices": { "bufferView": 1, "byteOffset": offset, "componentType": U16 },
            });
        }
    };
    check(Code::InputFormat, "replaces more than it has", sparse(17, 0));
    // 0 1 5 0 ...: the fourth index does not rise.
    check(Code::InputFormat, "do not rise", sparse(4, 0));
    check(Code::InputRange, "outside of its view", sparse(16, 1 << 40));
}

#[test]
fn buffers_that_are_not_there() {
    let uri = |uri: &str| {
        let mut writer = GlbWriter::new();
        let (positions, _) = grid(3);
        let at = writer.positions(&positions);
        writer.place(json!({ "attributes": { "POSITION": at } }));
        writer.gltf(uri)
    };
    let refused =
        |content: &[u8]| Fixture::new("a.gltf", content).read().map(|mesh| mesh.triangles.len()).unwrap_err();
    let missing = refused(&uri("none.bin"));
    assert_eq!(missing.code(), Code::InputUnreadable);
    assert!(missing.place().ends_with("none.bin") && missing.next_step().contains("a.gltf"), "{missing}");
    assert_eq!(refused(&uri("/dev/zero")).code(), Code::InputUnreadable);
    assert_eq!(refused(&uri(".")).code(), Code::InputUnreadable);
    assert!(refused(&uri("https://example.org/a.bin")).to_string().contains("not on this machine"));
    // Itself, whose text is no numbers but has enough bytes; and too short a one.
    assert!(Fixture::new("a.gltf", &uri("a.gltf")).read().is_ok());
    check_error("a.gltf", &uri("data:;base64,AAAA"), Code::InputTruncated, "3 there");
    check_error("a.gltf", &uri("data:;base64,A*"), Code::InputFormat, "no base64");
    check_error("a.gltf", &uri("data:,hello"), Code::InputFormat, "not in base64");
    let short = Fixture::new("a.gltf", &uri("short.bin"));
    std::fs::write(short.folder.path().join("short.bin"), "x").unwrap();
    assert_eq!(short.read().map(|_| ()).unwrap_err().code(), Code::InputTruncated);
}

/// Brackets by the million: each would become a struct of a hundred bytes and more.
#[test]
fn bombs_of_json_are_refused_by_the_limit() {
    let text = |item: &str, list: &str| {
        let items = vec![item; 30_000].join(",");
        format!("{{\"asset\":{{\"version\":\"2.0\"}},\"{list}\":[{items}]}}")
    };
    let mut bombs = vec![];
    for list in ["nodes", "meshes", "accessors", "buffers", "materials", "images", "animations", "scenes"] {
        for item in ["{}", "[]", "[[]]", "{\"children\":[1,2,3]}", "0", "null"] {
            bombs.push(text(item, list));
        }
    }
    bombs.push("[".repeat(1 << 20));
    bombs.push(format!("{{\"asset\":{{\"version\":\"2.0\",\"extras\":{}1", "{\"a\":".repeat(100_000)));
    for bomb in bombs {
        let fixture = Fixture::new("a.gltf", bomb.as_bytes());
        for free in [1 << 20, 8 << 20, 64 << 20] {
            let mut options = fixture.options();
            options.budget = Budget::new(RESERVE_BYTES + free);
            options.held_bytes = free;
            let taken = allocation_counter::measure(|| drop(open(&fixture.path, &options)));
            // Beside the ledger: paths, and the handle of a file.
            assert!(taken.bytes_max <= free + 4096, "{} of {free} bytes: {}", taken.bytes_max, &bomb[..64]);
            assert_eq!(options.budget.used_bytes(), 0);
        }
    }
}

/// Those who only count have a ledger without a limit: what is held then has one all the same.
#[test]
fn counting_holds_no_more_than_the_limit_has_room_for() {
    let fixture = Fixture::new("a.glb", &small_glb());
    let mut options = fixture.options();
    options.held_bytes = 1000;
    let error = open(&fixture.path, &options).map(|_| ()).unwrap_err();
    assert_eq!(error.code(), Code::MemoryLimit);
    assert!(error.smallest_limit_bytes().unwrap() > RESERVE_BYTES + 1000, "{error}");
}

#[test]
fn what_a_file_declares() {
    let declared = |name: &str, content: &[u8]| {
        let fixture = Fixture::new(name, content);
        // Where nothing can be written: buffers in the text are counted, not kept.
        let options = ImportOptions { temp_dir: "/proc/none".into(), ..fixture.options() };
        let info = info(&fixture.path, &options).unwrap();
        (info.format, info.vertex_count, info.face_count)
    };
    assert_eq!(declared("a.glb", &small_glb()), (Format::Glb, Some(4), Some(2)));
    let mut writer = GlbWriter::new();
    let at = writer.positions(&grid(3).0);
    writer.place(json!({ "attributes": { "POSITION": at } }));
    assert_eq!(declared("a.gltf", &writer.gltf(&writer.data_uri())), (Format::Gltf, Some(16), Some(5)));
    let empty = glb(b"{\"asset\":{\"version\":\"2.0\"}}\0", b"");
    assert_eq!(declared("a.glb", &empty), (Format::Glb, Some(0), Some(0)));
    assert_eq!(declared("a", b"{\"asset\":{\"version\":\"2.1\"}}"), (Format::Gltf, Some(0), Some(0)));
}

/// A scratch folder that is not there is told as such.
#[test]
fn a_missing_scratch_folder_is_named() {
    let mut writer = GlbWriter::new();
    let (positions, _) = grid(3);
    let at = writer.positions(&positions);
    writer.place(json!({ "attributes": { "POSITION": at } }));
    let fixture = Fixture::new("a.gltf", &writer.gltf(&writer.data_uri()));
    let mut options: ImportOptions = fixture.options();
    options.temp_dir = fixture.folder.path().join("none");
    assert_eq!(open(&fixture.path, &options).map(|_| ()).unwrap_err().code(), Code::Io);
}
