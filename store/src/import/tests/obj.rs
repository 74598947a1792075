//! OBJ: indices in all forms, rows of all kinds, materials, and `tobj` as the oracle.

use super::{Fixture, SourceTriangle, check_corners, check_error, corner, read, same};
use crate::error::Code;
use rand_pcg::{Pcg64, rand_core::Rng};

fn cube(rows: &str) -> String {
    let vertices: String =
        (0..8).map(|v| format!("v {}\n", corner(v).map(|value| format!("{value} ")).concat())).collect();
    vertices + rows
}

/// The same file through another reader; faces are fans.
pub(super) fn oracle(content: &[u8]) -> Vec<SourceTriangle> {
    let options = tobj::LoadOptions { triangulate: true, ..Default::default() };
    let (models, _) =
        tobj::load_obj_buf(&mut &content[..], &options, |_| tobj::load_mtl_buf(&mut &b""[..])).unwrap();
    let triangles = models.iter().flat_map(|model| {
        let positions = &model.mesh.positions;
        model.mesh.indices.chunks_exact(3).map(|triangle| {
            [0, 1, 2].map(|c| [0, 1, 2].map(|axis| f64::from(positions[3 * triangle[c] as usize + axis])))
        })
    });
    triangles.collect()
}

#[test]
fn faces_in_all_forms() {
    let check = |rows: &str, expected: &[[usize; 3]]| check_corners("a.obj", cube(rows).as_bytes(), expected);
    check("f 1 2 4\nf 1/1 2/2 4/3\nf 1//1 2//2 4//3\nf 1/1/1 2/2/2 4/3/3\n", &[[0, 1, 3]; 4]);
    check("f -8 -7 -5\nf -8//-1 2/-2 -5\nf 1// 2/ 4//\n", &[[0, 1, 3]; 3]);
    check("  f\t1  2 4   \r\n\r\nf 1 \\\r\n 2 \\\n4\nf 1\\\n2 4 # end\nfo 1 2 4", &[[0, 1, 3]; 4]);
    check("v 0 0 0\nf -1 2 -5\nf 1 2 3\nv 1 1 1\nf -2 -1 3", &[[0, 1, 4], [0, 1, 2], [0, 7, 2]]);
    let mesh = check(
        "f 1 2\nf 1\nf\nl 1 2 3\np 1\nf 1 2 4 3\nvn 0 0 1\nvt 0 0\nv 0 0 0 1 0.5 nan\nv 0 0 0 2\n",
        &[[0, 1, 3], [0, 3, 2]],
    );
    let stats = mesh.stats;
    assert_eq!((stats.skipped_face_count, stats.polygon_count, stats.dropped_attribute_count), (5, 1, 1));
    assert_eq!((stats.vertex_count, stats.vertex_lookups), (10, 7));
    let mesh = check("# C:\\path\\\nf 1 2 4\no x\ng a b\ns off\ncurv 1 2\ncurv 3\nsurf 9\n", &[[0, 1, 3]]);
    assert_eq!(mesh.stats.warnings.len(), 2);
}

#[test]
fn concave_faces_are_cut_inside() {
    // A dart whose fan from the first corner would leave it.
    let mesh =
        Fixture::new("a.obj", b"v 0 0 0\nv 4 0 0\nv 1 1 0\nv 0 4 0\nf 2 3 4 1\nf 1 2 3 4\n").read().unwrap();
    let area = |t: &SourceTriangle| {
        (t[1][0] - t[0][0]) * (t[2][1] - t[0][1]) - (t[1][1] - t[0][1]) * (t[2][0] - t[0][0])
    };
    assert!(mesh.triangles.iter().all(|triangle| area(triangle) > 0.0), "{:?}", mesh.triangles);
}

#[test]
fn rows_that_are_wrong() {
    let check =
        |rows: &str, code: Code, words: &str| check_error("a.obj", cube(rows).as_bytes(), code, words);
    check("\nf 1 2 9\n", Code::InputRange, "index 9, and 8 vertices stand before this line");
    check("\nf 1 2 9\n", Code::InputRange, "a.obj:10");
    check("f 0 1 2\n", Code::InputRange, "index 0");
    check("f -9 1 2\n", Code::InputRange, "index -9");
    check("f 1 2 99999999999999999999\n", Code::InputFormat, "vertex index belongs");
    check("f 1 2.0 3\n", Code::InputFormat, "found `2.0`");
    check("f a b c\n", Code::InputFormat, "found `a`");
    check("v 1 2\n", Code::InputFormat, "the line ends where a number belongs");
    check("v 1 2", Code::InputTruncated, "a.obj:9");
    check("v 1 x 2\n", Code::InputFormat, "found `x`");
    check("v 1 0x1 2\n", Code::InputFormat, "a.obj:9");
    check(&format!("f{}\n", " 1".repeat(20_000)), Code::InputRange, "too many sides");
    check(&format!("f {}\n", "1".repeat(5000)), Code::InputFormat, "too long");
}

#[test]
fn non_finite_coordinates_are_delivered() {
    let mesh =
        Fixture::new("a.obj", b"v nan 1 +inf\nv -Inf NaN 0\nv 1.#IND 0 1e999\nf 1 2 3\n").read().unwrap();
    let finite = mesh.triangles[0].as_flattened().iter().filter(|value| value.is_finite()).count();
    assert_eq!((mesh.triangles.len(), finite), (1, 3));
}

#[test]
fn materials_by_name() {
    let fixture = Fixture::new(
        "a.obj",
        cube(
            "f 1 2 3\nusemtl later\nf 1 2 3\nmtllib gone.mtl b c.mtl\nusemtl red one \nf 1 2 3\nusemtl none\n\
         f 1 2 3\nusemtl\nf 1 2 3\n",
        )
        .as_bytes(),
    );
    let text = "newmtl red one\nKd 1 0 0\nd 0.5\nnewmtl later\nKe 1 1 1\n";
    std::fs::write(fixture.folder.path().join("c.mtl"), text).unwrap();
    let mesh = fixture.read().unwrap();
    assert_eq!(mesh.material_names, ["default", "later", "red one", "none", "default"]);
    assert_eq!(mesh.stats.transparent_material_count, 1);
    // gone.mtl, b, and the name `none`.
    assert_eq!(mesh.stats.warnings.len(), 3, "{:?}", mesh.stats.warnings);
    let mut source = super::open(&fixture.path, &fixture.options()).unwrap();
    super::drain(&mut *source).unwrap();
    let by_name = |name: &str| source.materials().named().find(|material| material.0 == name).unwrap().1;
    assert!(by_name("later").emits());
    assert_eq!(by_name("red one").kd, [1.0, 0.0, 0.0]);
}

/// Not all of a mesh is read to know them.
#[test]
fn info_tells_the_libraries_in_front_of_the_vertices() {
    let text =
        "# made by hand\nmtllib one.mtl two.mtl\n\no thing\nmtllib more.mtl\nv 0 0 0\nmtllib late.mtl\n";
    let fixture = Fixture::new("a.obj", text.as_bytes());
    let told = crate::import::info(&fixture.path, &fixture.options()).unwrap();
    let expected = ["one.mtl", "two.mtl", "more.mtl"].map(|name| fixture.path.with_file_name(name));
    assert_eq!(told.named_files, expected);
}

#[test]
fn a_material_called_default_is_that_of_what_has_none() {
    let text = cube("f 1 2 3\nusemtl default\nf 1 2 3\nmtllib m.mtl\nusemtl a\nf 1 2 3\n");
    let fixture = Fixture::new("a.obj", text.as_bytes());
    let write = |text: &str| std::fs::write(fixture.folder.path().join("m.mtl"), text).unwrap();
    write("newmtl a\nKd 0 1 0\nnewmtl default\nKd 1 0 0\nnewmtl default\nKd 0 0 1\n");
    let mesh = fixture.read().unwrap();
    assert_eq!(
        (mesh.material_names, mesh.stats.warnings),
        (["default", "default", "a"].map(String::from).into(), vec![])
    );
    let materials = || {
        let mut source = super::open(&fixture.path, &fixture.options()).unwrap();
        super::drain(&mut *source).unwrap();
        source.materials().named().map(|(name, material)| (name.to_owned(), material.kd)).collect::<Vec<_>>()
    };
    let green = ("a".to_owned(), [0.0, 1.0, 0.0]);
    assert_eq!(materials(), [("default".to_owned(), [1.0, 0.0, 0.0]), green.clone()]);
    // Where no library defines it, there is nothing to tell.
    write("newmtl a\nKd 0 1 0\n");
    assert_eq!(materials(), [("default".to_owned(), [0.7; 3]), green]);
    assert!(fixture.read().unwrap().stats.warnings.is_empty());
}

#[test]
fn random_meshes_equal_tobj() {
    let mut random = Pcg64::new(7, 1);
    let mut text = String::from("mtllib none.mtl\n");
    let mut count = 0;
    for row in 0..16_000 {
        if row < 3 || random.next_u32().is_multiple_of(3) {
            // 24 bits, which the oracle's f32 holds.
            let value = || format!("{}e-3", random.next_u32() >> 10);
            let [x, y, z] = std::array::from_fn::<_, 3, _>({
                let mut value = value;
                move |_| value()
            });
            text += &format!("v {x} -{y} {z}\nvn 0 0 1\n");
            count += 1;
        } else {
            let corners: String = (0..3)
                .map(|_| {
                    let index = u64::from(random.next_u32()) % count;
                    if random.next_u32().is_multiple_of(2) {
                        format!(" {}//1", index + 1)
                    } else {
                        format!(" -{}", index + 1)
                    }
                })
                .collect();
            text += &format!("f{corners}\n");
        }
    }
    let fixture = Fixture::new("a.obj", text.as_bytes());
    let flat = fixture.read().unwrap();
    let single = |triangles: &[SourceTriangle]| -> Vec<SourceTriangle> {
        triangles
            .iter()
            .map(|triangle| triangle.map(|corner| corner.map(|value| f64::from(value as f32))))
            .collect()
    };
    assert!(same(&single(&flat.triangles), &oracle(text.as_bytes())));
    let mut options = fixture.options();
    options.vertex_cache_bytes = 1;
    let small = read(&fixture.path, &options).unwrap();
    assert!(same(&flat.triangles, &small.triangles));
    assert!(flat.stats.vertex_cache_misses == 0 && small.stats.vertex_cache_misses > 1000);
}
