//! Real models through the command, where they are at hand: counts that were found independently, pictures that are
//! not black, and what each of the world's nasty files gets.

use crate::command::{document_in, folder, models, run_in};
use serde_json::Value;

/// Path and triangles after fan triangulation, as the models' README says.
const MODELS: [(&str, u64); 13] = [
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
];

/// Of each hundred triangles, at most this many may fall together on the default lattice.
const REJECTED_PERCENT: u64 = 2;

#[test]
fn each_model_builds_with_its_count_and_gives_a_picture() {
    let Some(models) = models() else { return };
    let inside = folder();
    for (at, (name, count)) in MODELS.into_iter().enumerate() {
        // The box is closed but for its front: the camera of its reference picture looks in there.
        let camera = match name {
            "cornell/cornell.obj" => "--camera-position 278,273,-800 --camera-target 278,273,0 --fov-x 39.3",
            _ => "",
        };
        let path = models.join(name);
        // Fine voxels take most of a build's time: each fourth model has as many as it gets by default.
        let voxels = if at % 4 == 2 { "" } else { "--voxels 64" };
        let line = format!("build {} -o model.trex --overwrite {voxels}", path.display());
        let built = document_in(inside.path(), &line);
        let number = |key: &str| built[key].as_u64().unwrap();
        assert_eq!(number("input_triangle_count"), count, "{name}");
        let rejected = number("rejected_degenerate") + number("rejected_non_finite");
        assert_eq!(number("triangle_count") + rejected, count, "{name}");
        assert_eq!(number("rejected_non_finite"), 0, "{name}");
        assert!(rejected * 100 <= count * REJECTED_PERCENT, "{name}: {rejected} of {count} rejected");
        let line = format!(
            "render model.trex -o model.png --integrator direct --resolution 64x64 --spp 2 --overwrite {camera}"
        );
        let rendered = document_in(inside.path(), &line);
        assert_eq!(rendered["exact"], true, "{name}");
        for channel in rendered["image"]["mean"].as_array().unwrap() {
            assert!(channel.as_f64().unwrap() > 0.0, "{name}: {}", rendered["image"]);
        }
    }
}

/// Materials and lamps arrive in the file: counted with `grep` in the MTL and OBJ files.
#[test]
fn materials_and_lamps_come_along() {
    let Some(models) = models() else { return };
    let inside = folder();
    for (name, emitters) in [
        ("cornell/cornell.obj", 2),
        ("cornell-original/CornellBox-Original.obj", 2),
        ("sponza/sponza.obj", 0),
        ("cad/kicad_150k.obj", 4),
    ] {
        let path = models.join(name);
        document_in(inside.path(), &format!("build {} -o model.trex --overwrite --no-asvo", path.display()));
        let info = document_in(inside.path(), "info model.trex");
        assert_eq!(info["emitter_count"], emitters, "{name}: {info:#}");
        assert!(info["material_count"].as_u64().unwrap() > 1, "{name}");
    }
}

/// Triangles that the importers deliver, or the code; the same facts as in the importers' own tests. What holds no
/// triangle at all is refused by the build, here as `input-empty`.
#[rustfmt::skip]
const NASTY: &[(&str, Result<u64, &str>)] = &[
    ("OutOfMemory.off", Err("input-format")),
    ("ascii.stl.zip", Err("input-format")),
    ("box_UTF16BE.obj", Err("input-format")),
    ("box_longline.obj", Ok(944)),
    ("box_without_lineending.obj", Ok(12)),
    ("concave_polygon.obj", Ok(64)),
    ("deg_faces.obj", Ok(4)),
    ("degenerate_mesh.obj", Ok(1)),
    ("empty.obj", Err("input-empty")),
    ("empty_mat.obj", Ok(256)),
    ("inf_nan.obj", Ok(1)),
    ("malformed.obj", Err("input-range")),
    ("malformed2.obj", Ok(10)),
    ("multiple_spaces.obj", Ok(1)),
    ("nancolor.obj", Ok(12)),
    ("negative_indices.obj", Ok(12)),
    ("notenoughindices.obj", Ok(1)),
    ("number_formats.obj", Err("input-format")),
    ("octagon.obj", Ok(6)),
    ("point_cloud.obj", Err("input-empty")),
    ("polygonfaces.obj", Ok(3)),
    ("regr01.obj", Ok(2710)),
    ("singlevn.obj", Ok(2)),
    ("space_in_material_name.obj", Ok(64)),
    ("testline.obj", Err("input-empty")),
    ("wallhole.obj", Ok(66)),
    ("crash-30d6d0f7c529b3b66b4131700b7a4580cd7082df.ply", Err("input-format")),
    ("issue623.ply", Err("input-format")),
    ("cube_binary_header_with_RN_newline.ply", Ok(12)),
    ("cube_binary_starts_with_nl.ply", Ok(12)),
    ("empty.ply", Err("input-empty")),
    ("float-color.ply", Ok(1)),
    ("float_inf_point_cloud.ply", Err("input-empty")),
    ("fuze_ascii.ply", Ok(1000)),
    ("igea.ply", Ok(268_686)),
    ("metadata.ply", Ok(2)),
    ("points_emptyface.ply", Err("input-empty")),
    ("Spider_binary.stl", Ok(1368)),
    ("gebco7510_55cl.stl", Ok(4998)),
    ("multibody.stl", Ok(32)),
    ("soup.stl", Ok(100)),
    ("triangle_with_empty_solid.stl", Ok(1)),
    ("triangle_with_two_solids.stl", Ok(2)),
    ("", Err("input-unreadable")),
];

#[test]
fn each_nasty_file_builds_or_is_refused() {
    let Some(models) = models() else { return };
    let inside = folder();
    for &(name, expected) in NASTY {
        let path = models.join("nasty").join(name);
        let line = format!("build {} -o out.trex --overwrite --voxels 64 --json -q", path.display());
        let ran = run_in(inside.path(), &line);
        match expected {
            Ok(count) if ran.code == Some(0) => {
                assert_eq!(ran.document()["input_triangle_count"], count, "{name}");
                let line =
                    "render out.trex -o out.png --integrator direct --resolution 16x16 --spp 1 --overwrite";
                let rendered: Value = document_in(inside.path(), line);
                assert_eq!(rendered["exact"], true, "{name}");
            }
            // Its only triangles are degenerate or not finite: delivered, and then nothing is left to build.
            Ok(1..=4) => {
                ran.expect_error(3, "input-empty");
            }
            Ok(_) => panic!("{name}: {}", ran.stderr),
            Err(code) => {
                let document = ran.expect_error(3, code);
                assert!(document["where"].as_str().unwrap().contains(name), "{name}: {document}");
            }
        }
    }
    let listed: Vec<&str> = NASTY.iter().map(|(name, _)| *name).collect();
    for entry in std::fs::read_dir(models.join("nasty")).unwrap() {
        let name = entry.unwrap().file_name().to_string_lossy().into_owned();
        let is_mesh = [".ply", ".obj", ".stl"].iter().any(|ending| name.ends_with(ending));
        assert!(!is_mesh || listed.contains(&name.as_str()), "{name} is in no table");
    }
}
