//! Normals of vertices: what a mesh file says of them stands in the page file and comes back, corner by corner;
//! pictures of a coarse sphere that has them are those of a fine one, without black at the terminator.

use crate::colours::sheet;
use crate::command::{document_in, folder, hash_of, run_in, said};
use crate::light::cube;
use crate::light_sides::red;
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Property};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs::File;
use std::io::BufReader;
use std::ops::ControlFlow;
use std::path::Path;
use trex_model::{Model, OpenOptions};
use trex_render::Scene;
use trex_store::layout::PageKind;
use trex_store::{Budget, PageFile};

/// The normals of a triangle's corners by their places, the least first; zeros where there is none.
pub(crate) type NormalsByPlace = BTreeMap<[[i64; 3]; 3], [[f64; 3]; 3]>;

fn put(all: &mut NormalsByPlace, mut places: [[i64; 3]; 3], mut normals: [[f64; 3]; 3]) {
    let first = (0..3).min_by_key(|&i| places[i]).unwrap();
    places.rotate_left(first);
    normals.rotate_left(first);
    all.insert(places, normals);
}

/// A PLY file of a sheet whose normals wave, but for a hole whose own look another way: at its edge vertices of two
/// normals stand in one place. And what it says.
pub(crate) fn waves(n: i64) -> (String, NormalsByPlace) {
    let (vertices, triangles) = sheet(n);
    let normal = |at: usize| {
        let ([x, y, _], colour) = vertices[at];
        let [x, y] = [x, y].map(|v| v as f64);
        if colour == [250, 10, 20] { [0.5, 0.5, 0.1] } else { [(0.1 * x).cos(), (0.07 * y).sin(), 2.0] }
    };
    let mut text = format!(
        "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
         property float nx\nproperty float ny\nproperty float nz\nelement face {}\n\
         property list uchar uint vertex_indices\nend_header\n",
        vertices.len(),
        triangles.len()
    );
    for (at, ([x, y, z], _)) in vertices.iter().enumerate() {
        let [nx, ny, nz] = normal(at);
        writeln!(text, "{x} {y} {z} {nx} {ny} {nz}").unwrap();
    }
    let mut all = NormalsByPlace::new();
    for triangle in &triangles {
        let [a, b, c] = triangle.map(|at| at as usize);
        writeln!(text, "3 {a} {b} {c}").unwrap();
        put(&mut all, [a, b, c].map(|at| vertices[at].0), [a, b, c].map(normal));
    }
    (text, all)
}

/// The normals of a PLY file, as `ply-rs-bw` reads it.
fn read_ply(path: &Path) -> NormalsByPlace {
    let ply =
        Parser::<DefaultElement>::new().read_ply(&mut BufReader::new(File::open(path).unwrap())).unwrap();
    let real = |property: Option<&Property>| match property {
        Some(&Property::Float(value)) => f64::from(value),
        Some(&Property::Double(value)) => value,
        None => 0.0,
        _ => panic!("no real number"),
    };
    let vertex = |v: &DefaultElement| {
        let of = |names: [&str; 3]| names.map(|name| real(v.get(name)));
        (of(["x", "y", "z"]).map(|value| value as i64), of(["nx", "ny", "nz"]))
    };
    let vertices: Vec<_> = ply.payload["vertex"].iter().map(vertex).collect();
    let mut all = NormalsByPlace::new();
    for face in &ply.payload["face"] {
        let Property::ListUInt(list) = &face["vertex_indices"] else { panic!("no list of uint") };
        let corners = [0, 1, 2].map(|corner| vertices[list[corner] as usize]);
        put(&mut all, corners.map(|corner| corner.0), corners.map(|corner| corner.1));
    }
    all
}

#[test]
fn normals_come_back_by_way_of_every_format() {
    let inside = folder();
    let at = |name: &str| inside.path().join(name);
    let (text, expected) = waves(120);
    std::fs::write(at("a.ply"), text).unwrap();
    document_in(inside.path(), "build a.ply -o m.trex --voxels 64");
    assert_eq!(document_in(inside.path(), "verify m.trex --deep")["verdict"], "clean");
    document_in(inside.path(), "export m.trex -o back.ply");
    let back = read_ply(&at("back.ply"));
    assert!(back.keys().eq(expected.keys()));
    for (found, expected) in back.values().zip(expected.values()) {
        for (found, expected) in found.iter().zip(expected) {
            let length = expected.iter().map(|v| v * v).sum::<f64>().sqrt();
            let cos: f64 = found.iter().zip(expected).map(|(a, b)| a * b / length).sum();
            assert!(cos > 0.25f64.to_radians().cos(), "{found:?}, not {expected:?}");
        }
    }
    // What was rounded once is not rounded again.
    document_in(inside.path(), "export m.trex -o back.obj");
    document_in(inside.path(), "export m.trex -o back.glb");
    for (number, file) in ["back.ply", "back.obj", "back.glb"].into_iter().enumerate() {
        document_in(inside.path(), &format!("build {file} -o again{number}.trex --no-asvo"));
        document_in(inside.path(), &format!("export again{number}.trex -o again{number}.ply"));
        assert!(read_ply(&at(&format!("again{number}.ply"))) == back, "{file}");
    }
    let file = PageFile::open(&at("m.trex"), &Budget::unlimited()).unwrap();
    let normals = file.pages().iter().filter(|page| page.kind == PageKind::Normals);
    assert_eq!(normals.clone().count() as u64, file.superblock().normal_page_count);
    let bytes = normals.map(|page| u64::from(page.stored_bytes)).sum::<u64>();
    let per_triangle = bytes as f64 / expected.len() as f64;
    said(&format!("{per_triangle:.2} B of normals a triangle"));
    // Five degrees an edge, and a hole of another direction.
    assert!(per_triangle > 0.1 && per_triangle < 1.0, "{per_triangle}");
    let info = document_in(inside.path(), "info m.trex");
    assert_eq!(info["section_bytes"]["normals"], bytes);
}

#[test]
fn what_is_dropped_was_never_there() {
    let inside = folder();
    let (text, _) = waves(30);
    let without: String = text
        .lines()
        .filter(|line| !line.starts_with("property float n"))
        .map(|line| match line.split(' ').collect::<Vec<_>>()[..] {
            [x, y, z, _, _, _] => format!("{x} {y} {z}\n"),
            _ => format!("{line}\n"),
        })
        .collect();
    std::fs::write(inside.path().join("a.ply"), text).unwrap();
    std::fs::write(inside.path().join("b.ply"), without).unwrap();
    for line in ["a.ply -o kept.trex", "a.ply -o a.trex --normals drop", "b.ply -o b.trex"] {
        document_in(inside.path(), &format!("build {line} --voxels 64"));
    }
    let hash = |name: &str| hash_of(&inside.path().join(name));
    assert!(hash("a.trex") == hash("b.trex") && hash("a.trex") != hash("kept.trex"));
}

#[test]
fn damage_to_normals_is_named() {
    let inside = folder();
    std::fs::write(inside.path().join("a.ply"), waves(60).0).unwrap();
    document_in(inside.path(), "build a.ply -o m.trex --no-asvo");
    let file = PageFile::open(&inside.path().join("m.trex"), &Budget::unlimited()).unwrap();
    let at = file.pages().iter().position(|page| page.kind == PageKind::Normals).unwrap();
    let mut bytes = std::fs::read(file.path()).unwrap();
    bytes[file.pages()[at].offset as usize + 9] ^= 4;
    std::fs::write(inside.path().join("bad.trex"), bytes).unwrap();
    let ran = run_in(inside.path(), "verify bad.trex");
    ran.expect(1);
    assert!(ran.stdout.contains(&format!("page {at} (normals)")), "{}", ran.stdout);
    // Without them the surface is drawn by its planes.
    let ran =
        run_in(inside.path(), "render bad.trex --integrator direct --resolution 8x8 --json -q -o a.png");
    ran.expect(1);
    assert!(ran.stdout.contains("without its normals"), "{}", ran.stdout);
}

/// A sphere of an octahedron whose triangles were cut in four `rounds` times.
fn sphere(rounds: usize, is_smooth: bool) -> String {
    let unit = |v: [f64; 3]| {
        let length = v.iter().map(|v| v * v).sum::<f64>().sqrt();
        v.map(|v| v / length)
    };
    let mut triangles = Vec::new();
    for signs in 0..8 {
        let [x, y, z] = [0, 1, 2].map(|axis| if signs >> axis & 1 == 0 { 1.0 } else { -1.0 });
        let (a, b, c) = ([x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, z]);
        triangles.push(if x * y * z > 0.0 { [a, b, c] } else { [a, c, b] });
    }
    for _ in 0..rounds {
        let cut = |[a, b, c]: [[f64; 3]; 3]| {
            let middle = |p: [f64; 3], q: [f64; 3]| unit([0, 1, 2].map(|i| p[i] + q[i]));
            let (x, y, z) = (middle(a, b), middle(b, c), middle(c, a));
            [[a, x, z], [b, y, x], [c, z, y], [x, y, z]]
        };
        triangles = triangles.into_iter().flat_map(cut).collect();
    }
    let mut text = String::new();
    for [x, y, z] in triangles.as_flattened() {
        writeln!(text, "v {x} {y} {z}").unwrap();
        if is_smooth {
            writeln!(text, "vn {x} {y} {z}").unwrap();
        }
    }
    for first in (1..=3 * triangles.len()).step_by(3) {
        let [a, b, c] = [first, first + 1, first + 2];
        match is_smooth {
            true => writeln!(text, "f {a}//{a} {b}//{b} {c}//{c}").unwrap(),
            false => writeln!(text, "f {a} {b} {c}").unwrap(),
        }
    }
    text
}

const SIDE: u32 = 96;

/// Radiance of the pixels within nine tenths of a sphere's outline, which a sun lights from one side.
fn lit_sphere(inside: &Path, name: &str, text: &str) -> Vec<f64> {
    lit_by(inside, (name, text), "")
}

/// The same, of a build with flags.
fn lit_by(inside: &Path, (name, text): (&str, &str), flags: &str) -> Vec<f64> {
    std::fs::write(inside.join(format!("{name}.obj")), text).unwrap();
    document_in(inside, &format!("build {name}.obj -o {name}.trex --no-asvo {flags}"));
    let scene = format!(
        "model = '{name}.trex'\n[camera]\nposition = [0, 0, 4]\ntarget = [0, 0, 0]\nup = [0, 1, 0]\nfov_y = 30\n\
         [[light]]\ntype = 'directional'\ndirection = [-1, -0.4, -0.15]\nirradiance = [4, 4, 4]\n\
         [render]\nintegrator = 'direct'\nresolution = [{SIDE}, {SIDE}]\n"
    );
    let scene = Scene::parse(&scene, &inside.join("s.toml")).unwrap();
    let path = inside.join(format!("{name}.trex"));
    let model = Model::open(&path, &OpenOptions::with_limit(1 << 30)).unwrap();
    let mut session = model.session(&scene).unwrap();
    session.render(16, &|| false, &mut |_, _| ControlFlow::Continue(()));
    // The outline of a unit sphere 4 away: tan of asin(1/4), of tan 15 degrees.
    let outline = f64::from(SIDE) / 2.0 * 0.258 / 0.268;
    let is_within = |[x, y]: &[u32; 2]| {
        let [x, y] = [*x, *y].map(|v| f64::from(v) + 0.5 - f64::from(SIDE) / 2.0);
        x.hypot(y) < 0.9 * outline
    };
    let pixels = (0..SIDE * SIDE).map(|at| [at % SIDE, at / SIDE]).filter(is_within);
    pixels.map(|at| f64::from(session.film().radiance(at)[0])).collect()
}

/// 512 triangles with normals are lit as 130 thousand without; where the fine sphere is well lit none of them is dark,
/// and nowhere are they brighter than it.
#[test]
fn a_coarse_sphere_with_normals_is_lit_as_a_fine_one() {
    let inside = folder();
    let fine = lit_sphere(inside.path(), "fine", &sphere(7, false));
    let flat = lit_sphere(inside.path(), "flat", &sphere(3, false));
    let smooth = lit_sphere(inside.path(), "smooth", &sphere(3, true));
    let error = |of: &[f64]| {
        let squares: f64 = of.iter().zip(&fine).map(|(a, b)| (a - b) * (a - b)).sum();
        (squares / fine.len() as f64).sqrt()
    };
    let (flat, bent) = (error(&flat), error(&smooth));
    let brightest = fine.iter().fold(0.0f64, |most, &v| most.max(v));
    said(&format!("sphere: error flat {flat:.4}, with normals {bent:.4}, of {brightest:.3}"));
    assert!(bent < flat / 3.0, "{bent} with normals, {flat} without");
    for (smooth, fine) in smooth.iter().zip(&fine) {
        assert!(*smooth > 0.7 * fine || *fine < 0.25 * brightest, "{smooth}, not {fine}");
        assert!(*smooth < fine + 0.05 * brightest, "{smooth}, not {fine}");
    }
}

/// Normals that are made of the mesh light a coarse sphere as those that it comes with; a box keeps its edges.
#[test]
fn normals_are_made_of_the_mesh_up_to_an_angle() {
    let inside = folder();
    let lit = |name: &str, text: &str, flags: &str| lit_by(inside.path(), (name, text), flags);
    let given = lit("given", &sphere(3, true), "");
    let made = lit("made", &sphere(3, false), "--normals from-crease:60");
    let flat = lit("flat", &sphere(3, true), "--normals drop");
    let apart = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| (a - b).abs()).sum::<f64>();
    let (near, far) = (apart(&made, &given), apart(&flat, &given));
    assert!(near < 0.1 * far && far > 0.0, "{near} {far}");
    assert_eq!(lit("sharp", &sphere(3, false), "--normals from-crease:0"), flat);

    let normals = |line: &str| {
        let built = document_in(inside.path(), &format!("build {line} -o c.trex --no-asvo --overwrite"));
        assert!(built["triangle_count"].as_u64().unwrap() > 0);
        let told = document_in(inside.path(), "info c.trex");
        told["normal_page_count"].as_u64().unwrap()
    };
    assert!(normals("made.obj --normals from-crease:60") > 0);
    assert_eq!(normals("made.obj --normals from-crease:0"), 0, "no faces lie in one plane");
    assert!(normals("gen:scan:20k:1:colors=low --normals from-crease:40 --memory-limit 256MiB") > 0);
    for wrong in
        ["from-crease", "from-crease:", "from-crease:-1", "from-crease:181", "from-crease:NaN", "smooth"]
    {
        run_in(inside.path(), &format!("build made.obj -o d.trex --normals {wrong}")).expect(2);
    }
}

/// A room whose every wall shines with 1 and reflects a half: to each place comes 1 / (1 - 1/2) from all sides. Its
/// back wall is seen, and has no normals; those of the others lean by 60 degrees. `path` lost a part of the light at
/// every bounce off these.
#[test]
fn light_is_not_lost_between_walls_with_normals() {
    let inside = folder();
    let (corners, faces) = cube();
    let mut text = "mtllib m.mtl\nusemtl m\n".to_owned();
    corners.iter().for_each(|[x, y, z]| writeln!(text, "v {x} {y} {z}").unwrap());
    for face in &faces {
        // Inwards, and along an edge.
        let normal = |axis: usize| -0.25 * face.iter().map(|&at| corners[at][axis]).sum::<f64>();
        let edge = |axis: usize| 0.5 * (corners[face[1]][axis] - corners[face[0]][axis]);
        let [x, y, z] = [0, 1, 2].map(|axis| 0.5 * normal(axis) + 0.75f64.sqrt() * edge(axis));
        writeln!(text, "vn {x} {y} {z}").unwrap();
        let is_back = face.iter().all(|&at| corners[at][2] < 0.0);
        let corner = |at: &usize| if is_back { format!("{}", at + 1) } else { format!("{}//-1", at + 1) };
        writeln!(text, "f {}", face.iter().map(corner).collect::<Vec<_>>().join(" ")).unwrap();
    }
    std::fs::write(inside.path().join("m.obj"), text).unwrap();
    std::fs::write(inside.path().join("m.mtl"), "newmtl m\nKd 0.5 0.5 0.5\nKe 1 1 1\n").unwrap();
    document_in(inside.path(), "build m.obj -o m.trex --voxels 64");
    let scene = "model = 'm.trex'\n[camera]\nposition = [0, 0, 0.5]\ntarget = [0, 0, -1]\nfov_x = 60\n\
                 [render]\nresolution = [16, 16]\n";
    std::fs::write(inside.path().join("m.toml"), scene).unwrap();
    for way in ["path --spp 256", "full-gi --spp 64 --photons 200k", "photon --spp 64 --photons 1M"] {
        document_in(
            inside.path(),
            &format!("render m.toml -o m.exr --overwrite --filter off --integrator {way}"),
        );
        let red = red(&inside.path().join("m.exr"));
        let mean = red.iter().sum::<f64>() / red.len() as f64;
        said(&format!("{way}: {mean:.4}, 2 expected"));
        assert!((mean - 2.0).abs() < 0.03, "{way}: {mean}");
    }
}
