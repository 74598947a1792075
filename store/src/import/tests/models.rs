//! Real models, where they are at hand: exact triangle counts, and what each file of the world's nasty ones does.
#![allow(clippy::print_stderr)]

use super::super::ImportOptions;
use super::read;
use crate::error::Code;
use std::io::Write;
use std::path::{Path, PathBuf};

/// The folder of models, or `None`, said aloud.
pub(super) fn models() -> Option<PathBuf> {
    let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../shared/models"));
    if !folder.is_dir() {
        let is_required = std::env::var_os("TREX_REQUIRE_ALL").is_some_and(|value| value == "1");
        assert!(!is_required, "TREX_REQUIRE_ALL is set, and there is no {}", folder.display());
        // Not `eprintln!`, which the runner captures.
        let _ =
            writeln!(std::io::stderr().lock(), "\nNOT RUN: real models: there is no {}", folder.display());
        return None;
    }
    Some(folder.to_path_buf())
}

/// Triangles delivered, or the code of the error.
fn outcome(path: &Path) -> Result<usize, Code> {
    let scratch = tempfile::tempdir().unwrap();
    read(path, &ImportOptions::unlimited(scratch.path())).map(|mesh| mesh.triangles.len()).map_err(|error| {
        eprintln!("{error}");
        error.code()
    })
}

#[test]
fn exact_counts() {
    let Some(folder) = models() else { return };
    for (name, count) in [
        ("cornell/cornell.obj", 32),
        ("cornell-original/CornellBox-Original.obj", 36),
        ("sponza/sponza.obj", 66_454),
        ("scans/bunny.ply", 69_451),
        ("scans/horse.ply", 96_966),
        ("scans/lucy.ply", 99_970),
        ("scans/buddha_100k.obj", 100_000),
        ("scans/dragon_vrip_res2.ply", 202_520),
        ("cad/kicad_150k.obj", 154_274),
        ("cad/kicad_1m.obj", 1_002_075),
        ("cad/peterbilt/peterbilt.obj", 116_501),
        ("cad/concept-sedan-02/concept-sedan-02.obj", 124_188),
        ("cad/chandelier-lamp/chandelier-lamp.obj", 133_112),
    ] {
        assert_eq!(outcome(&folder.join(name)), Ok(count), "{name}");
    }
}

/// What each file holds was read from the files themselves and counted by a script, not by this reader.
#[test]
fn nasty_files() {
    let Some(folder) = models() else { return };
    for (name, expected) in [
        // Other formats.
        ("OutOfMemory.off", Err(Code::InputFormat)),
        ("ascii.stl.zip", Err(Code::InputFormat)),
        ("box_UTF16BE.obj", Err(Code::InputFormat)),
        // OBJ. A face of 936 sides that runs round and round the same four corners, and five quads.
        ("box_longline.obj", Ok(944)),
        ("box_without_lineending.obj", Ok(12)),
        ("concave_polygon.obj", Ok(64)),
        ("deg_faces.obj", Ok(4)),
        ("degenerate_mesh.obj", Ok(1)),
        ("empty.obj", Err(Code::InputEmpty)),
        ("empty_mat.obj", Ok(256)),
        ("inf_nan.obj", Ok(1)),
        // Index 12 of 8 vertices, and index 0.
        ("malformed.obj", Err(Code::InputRange)),
        ("malformed2.obj", Ok(10)),
        ("multiple_spaces.obj", Ok(1)),
        ("nancolor.obj", Ok(12)),
        ("negative_indices.obj", Ok(12)),
        ("notenoughindices.obj", Ok(1)),
        // `3.1+e2` is no number.
        ("number_formats.obj", Err(Code::InputFormat)),
        ("octagon.obj", Ok(6)),
        ("point_cloud.obj", Ok(0)),
        ("polygonfaces.obj", Ok(3)),
        ("regr01.obj", Ok(2710)),
        ("singlevn.obj", Ok(2)),
        ("space_in_material_name.obj", Ok(64)),
        ("testline.obj", Ok(0)),
        ("wallhole.obj", Ok(66)),
        // PLY. NUL bytes in the header; a list in the vertices that their rows do not have.
        ("crash-30d6d0f7c529b3b66b4131700b7a4580cd7082df.ply", Err(Code::InputFormat)),
        ("issue623.ply", Err(Code::InputFormat)),
        ("cube_binary_header_with_RN_newline.ply", Ok(12)),
        ("cube_binary_starts_with_nl.ply", Ok(12)),
        ("empty.ply", Ok(0)),
        ("float-color.ply", Ok(1)),
        ("float_inf_point_cloud.ply", Ok(0)),
        ("fuze_ascii.ply", Ok(1000)),
        ("igea.ply", Ok(268_686)),
        ("metadata.ply", Ok(2)),
        ("points_emptyface.ply", Ok(0)),
        // glTF. A scene without nodes, none at all, and shapes with values that are no numbers.
        ("gltf/TestNoRootNode/NoScene.gltf", Ok(0)),
        ("gltf/TestNoRootNode/SceneWithoutNodes.gltf", Ok(0)),
        ("gltf/RecursiveNodes/RecursiveNodes.gltf", Err(Code::InputFormat)),
        ("gltf/MissingBin/BoxTextured.gltf", Err(Code::InputUnreadable)),
        ("gltf/IndexOutOfRange/IndexOutOfRange.gltf", Err(Code::InputRange)),
        ("gltf/IndexOutOfRange/AllIndicesOutOfRange.gltf", Err(Code::InputRange)),
        ("gltf/BoxBadNormals-glTF-Binary/BoxBadNormals.glb", Ok(12)),
        ("gltf/BoxWithInfinites-glTF-Binary/BoxWithInfinites.glb", Ok(12)),
        // Of the wrong types only those of what is read matter.
        ("gltf/wrongTypes/badArray.gltf", Err(Code::InputFormat)),
        ("gltf/wrongTypes/badObject.gltf", Err(Code::InputFormat)),
        ("gltf/wrongTypes/badExtension.gltf", Err(Code::InputFormat)),
        ("gltf/wrongTypes/badNumber.gltf", Ok(12)),
        ("gltf/wrongTypes/badString.gltf", Ok(12)),
        ("gltf/wrongTypes/badUint.gltf", Err(Code::InputFormat)),
        // STL.
        ("Spider_binary.stl", Ok(1368)),
        ("gebco7510_55cl.stl", Ok(4998)),
        ("multibody.stl", Ok(32)),
        ("soup.stl", Ok(100)),
        ("triangle_with_empty_solid.stl", Ok(1)),
        ("triangle_with_two_solids.stl", Ok(2)),
    ] {
        assert_eq!(outcome(&folder.join("nasty").join(name)), expected, "{name}");
    }
}
