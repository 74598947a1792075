//! Seeds of the targets: meshes, volumes, glTF and texts, and what stands in a page of a file.

use crate::gltf;
use crate::tidy::root;
use std::fmt::Write;
use trex_store::PageFile;
use trex_store::layout::{Packing, PageKind};

/// Small balls, as plain samples and packed.
pub(super) fn put_volumes(put: &dyn Fn(&str, &str, &[u8])) {
    let side = 0..6i32;
    let places = side.clone().flat_map(|z| side.clone().flat_map(move |y| (0..6).map(move |x| [x, y, z])));
    let bytes: Vec<u8> = places
        .map(|at| {
            (100 - at.iter().map(|part| 8 * (2 * part - 5) * (2 * part - 5) / 4).sum::<i32>()).max(0) as u8
        })
        .collect();
    let floats = |swap: fn(f32) -> [u8; 4]| -> Vec<u8> {
        bytes.iter().flat_map(|&byte| swap(f32::from(byte) - 0.25)).collect()
    };
    let head = "NRRD0004\n# c\nkey:=value\ndimension: 3\nsizes: 6 6 6\nspace origin: (1,2,3)\n";
    let plain = format!("{head}type: float\nendian: big\nencoding: raw\nspacings: 1 2 nan\n\n");
    put("nrrd", "plain.nrrd", &[plain.as_bytes(), &floats(f32::to_be_bytes)].concat());
    let packed = format!("{head}type: uchar\nencoding: gzip\nspace directions: (1,0,0) (0,0,1) (0,1,0)\n\n");
    // A member of gzip: head, deflate, sum and length of what was packed.
    let member =
        [&[0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 3], &*miniz_oxide::deflate::compress_to_vec(&bytes, 6)].concat();
    let sum = bytes.iter().fold(u32::MAX, |sum, &byte| {
        (0..8).fold(sum ^ u32::from(byte), |sum, _| (sum >> 1) ^ (0xedb8_8320 & (sum & 1).wrapping_neg()))
    });
    let tail = [(!sum).to_le_bytes(), (bytes.len() as u32).to_le_bytes()].concat();
    put("nrrd", "packed.nrrd", &[packed.as_bytes(), &member, &tail].concat());
    let head =
        "ObjectType = Image\nNDims = 3\nDimSize = 6 6 6\nElementType = MET_UCHAR\nElementSpacing = 1 2 1\n";
    put("mhd", "local.mhd", &[head.as_bytes(), b"ElementDataFile = LOCAL\n", &bytes].concat());
    let packed = miniz_oxide::deflate::compress_to_vec_zlib(&bytes, 6);
    put(
        "mhd",
        "packed.mhd",
        &[head.as_bytes(), b"CompressedData = True\nElementDataFile = LOCAL\n", &packed].concat(),
    );
    put("raw", "floats", &[&[6, 6, 6], &*floats(f32::to_le_bytes)].concat());
}

/// Seeds of materials, scenes and views.
pub(super) fn put_texts(put: &dyn Fn(&str, &str, &[u8])) {
    let materials = "newmtl a b\nKd 0.5 0.25 0\nKs 0.1 0.1 0.1\nNs 30\nd 0.5\nmap_Kd wood.png\n# c\n\
                     newmtl a\nKe 4 5 6\nillum 5\nTr 0.25\nnewmtl b\nKd spectral x.rfl\n";
    put("mtl", "odd.mtl", materials.as_bytes());
    let all = "model = \"a.trex\"\n[camera]\nposition = [1, 2, 3.5]\ntarget = [0, 0, 0]\nup = [0, 1, 0]\nfov_x = 44.0\n\
               [[light]]\ntype = \"rect\"\ncorner = [-4.0, 4.0, -2]\nedge_u = [2, 0, 0]\nedge_v = [0, 0, 2]\n\
               radiance = [2, 1.9, 1e1]\n[material.floor]\nkd = [0.5, 0.5, 0]\nmirror = true\n\
               [render]\nresolution = [512, 256]\nspp = 64\nintegrator = \"photon\"\n";
    put("scene", "all.toml", all.as_bytes());
    let views = "[[view]]\nposition = [1, 2, 3]\ntarget = [0, 0, 0]\n[[view]]\nposition = [1, 0, 0]\n\
                 target = [0, 0, 0]\nup = [0, 0, 1]\n";
    put("views", "two.toml", views.as_bytes());
}

/// The content of a page, unpacked.
pub(super) fn unpacked(file: &PageFile, bytes: &[u8], kind: PageKind) -> Vec<u8> {
    let entry = file.pages().iter().find(|entry| entry.kind == kind).unwrap();
    let stored = &bytes[entry.offset as usize..][..entry.stored_bytes as usize];
    match entry.packing {
        Packing::Raw => stored.to_vec(),
        Packing::Lz4 => lz4_flex::block::decompress(stored, entry.unpacked_bytes as usize).unwrap(),
    }
}

/// A grid of n by n squares with hills, as OBJ.
pub(super) fn hills(n: usize) -> String {
    let mut text = String::from("mtllib none.mtl\n");
    for (y, x) in (0..=n).flat_map(|y| (0..=n).map(move |x| (y, x))) {
        let z = (0.7 * x as f64).sin() * (0.5 * y as f64).cos();
        writeln!(text, "v {x} {y} {z:.3}").unwrap();
    }
    for (y, x) in (0..n).flat_map(|y| (0..n).map(move |x| (y, x))) {
        let at = 1 + y * (n + 1) + x;
        writeln!(text, "usemtl m{}\nf {at} {} {} {}", (x + y) % 3, at + 1, at + n + 2, at + n + 1).unwrap();
    }
    text
}

/// Hills whose vertices have colours.
pub(super) fn coloured_hills(n: usize) -> String {
    let coloured = |(at, line): (usize, &str)| match line.starts_with("v ") {
        true => format!("{line} 0.{} 0.5 0.{}\n", at % 10, 9 - at % 7),
        false => format!("{line}\n"),
    };
    hills(n).lines().enumerate().map(coloured).collect()
}

/// Hills whose vertices have normals.
pub(super) fn bent_hills(n: usize) -> String {
    let normals: String = (0..7).map(|at| format!("vn 0.{at} -0.{} 1\n", at % 3)).collect();
    let bent = |line: &str| match line.strip_prefix("f ") {
        Some(corners) => {
            let corner = |word: &str| format!(" {word}//{}", 1 + word.parse::<usize>().unwrap() % 7);
            format!("f{}\n", corners.split(' ').map(corner).collect::<String>())
        }
        None => format!("{line}\n"),
    };
    normals + &hills(n).lines().map(bent).collect::<String>()
}

/// A PNG of 2x2 pixels.
fn grey_picture() -> Vec<u8> {
    let mut file = Vec::new();
    let mut encoder = png::Encoder::new(&mut file, 2, 2);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().expect("memory takes a header");
    writer.write_image_data(&[9, 99, 199, 255]).expect("memory takes a picture");
    drop(writer);
    file
}

/// Seeds of glTF: a strip with a replaced row, instances, a material with a picture, a camera and a light; in a data
/// URI, and in a container.
pub(super) fn put_gltf(put: &dyn Fn(&str, &str, &[u8])) {
    let corners = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.5f32, 3.0, 2.0, 1.0];
    let mut bin: Vec<u8> = corners.iter().flat_map(|value| value.to_le_bytes()).collect();
    bin.extend([0, 1, 2, 3, 2, 0, 0, 0]);
    bin.extend([0, 0, 255, 0, 0, 255, 255, 255]);
    let picture = grey_picture();
    bin.extend(&picture);
    let views = [(0, 48, ""), (60, 4, ""), (48, 12, ""), (64, 1, ""), (68, 8, ""), (76, picture.len(), "")];
    let rows = |view: usize, kind: &str, count: usize, more: &str| {
        format!("{{\"bufferView\":{view},\"componentType\":{kind},\"count\":{count}{more}}}")
    };
    let sparse = ",\"sparse\":{\"count\":1,\"indices\":{\"bufferView\":3,\"componentType\":5121},\
                  \"values\":{\"bufferView\":2}}";
    let vector = "5126,\"type\":\"VEC3\"";
    let accessors = [
        rows(0, vector, 4, sparse),
        rows(1, "5121,\"type\":\"SCALAR\"", 4, ""),
        rows(2, vector, 1, ""),
        rows(4, "5121,\"type\":\"VEC2\"", 4, ",\"normalized\":true"),
    ];
    let primitive = "\"attributes\":{\"POSITION\":0,\"NORMAL\":0,\"COLOR_0\":0,\"TEXCOORD_0\":3},\"indices\":1,\
                     \"mode\":5,\"material\":0";
    let node = ",\"scale\":[-1,2,1],\"rotation\":[0,0,1,1],\"camera\":0,\"children\":[1],\"extensions\":{\
                \"EXT_mesh_gpu_instancing\":{\"attributes\":{\"TRANSLATION\":2}},\
                \"KHR_lights_punctual\":{\"light\":0}}},{\"matrix\":[1,0,0,0,0,1,0,0,0,0,1,0,5,0,0,1]";
    let text = gltf::document(&views, &accessors.join(","), primitive, node).replacen(
        '{',
        "{\"materials\":[{\"name\":\"a\",\"emissiveFactor\":[1,1,1],\"pbrMetallicRoughness\":{\"baseColorTexture\":\
         {\"index\":0}}}],\"textures\":[{\"source\":0}],\"images\":[{\"bufferView\":5}],\
         \"cameras\":[{\"type\":\"perspective\",\"perspective\":{\"yfov\":1}}],\
         \"extensions\":{\"KHR_lights_punctual\":{\"lights\":[{\"type\":\"spot\"}]}},",
        1,
    );
    put("glb", "small.glb", &gltf::file(&text, &bin));
    // A triangle, whose nine numbers are 48 letters.
    let rows = rows(0, vector, 3, "");
    let text = gltf::document(&[(0, 36, "")], &rows, "\"attributes\":{\"POSITION\":0}", "");
    let uri = "AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA";
    let text = text.replace("BYTES", &format!("36,\"uri\":\"data:;base64,{uri}\""));
    put("gltf", "small.gltf", text.as_bytes());
}

/// Seeds of Draco: the smaller grids of the files that the importer is held to, behind their counts.
pub(super) fn put_draco(put: &dyn Fn(&str, &str, &[u8])) {
    for name in ["edgebreaker", "sequential"] {
        let file =
            std::fs::read(root().join(format!("store/src/import/tests/gltf/draco/{name}.glb"))).unwrap();
        let length = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
        let json: serde_json::Value = serde_json::from_slice(&file[20..20 + length]).unwrap();
        let number = |value: &serde_json::Value| value.as_u64().unwrap() as usize;
        let primitive = &json["meshes"][0]["primitives"][1];
        let view = number(&primitive["extensions"]["KHR_draco_mesh_compression"]["bufferView"]);
        let view = &json["bufferViews"][view];
        let from = 20 + length + 8 + number(&view["byteOffset"]);
        let count =
            |accessor: &serde_json::Value| number(&json["accessors"][number(accessor)]["count"]) as u16;
        let vertices = count(&primitive["attributes"]["POSITION"]);
        let counts = [vertices, count(&primitive["indices"]) / 3].map(u16::to_le_bytes).concat();
        put("draco", name, &[&counts[..], &file[from..from + number(&view["byteLength"])]].concat());
    }
}
