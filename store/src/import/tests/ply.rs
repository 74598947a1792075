//! PLY: types, orders, layouts, strips, headers, and what is wrong with files that lie.

mod wrong;

use super::{Fixture, SourceMesh, SourceTriangle, check_corners, corner, read, same};
use ply_rs_bw::parser::Parser;
use ply_rs_bw::ply::{DefaultElement, Property};

const TRIANGLES: [[usize; 3]; 4] = [[0, 1, 3], [0, 3, 2], [4, 5, 7], [7, 0, 6]];

/// How a cube with [`TRIANGLES`] is written.
#[derive(Clone, Copy, Debug)]
struct Variant {
    format: &'static str,
    coordinate: &'static str,
    count: &'static str,
    index: &'static str,
    list_name: &'static str,
    line_end: &'static str,
    layout: Layout,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Layout {
    Plain,
    /// Values and lists before, between and after, and elements around.
    Crowded,
    FacesFirst,
}

const PLAIN: Variant = Variant {
    format: "ascii",
    coordinate: "float",
    count: "uchar",
    index: "int",
    list_name: "vertex_indices",
    line_end: "\n",
    layout: Layout::Plain,
};

const FORMATS: [&str; 3] = ["ascii", "binary_little_endian", "binary_big_endian"];

/// Writes values of named types as text or bytes.
struct PlyWriter {
    format: &'static str,
    line_end: &'static str,
    bytes: Vec<u8>,
}

impl PlyWriter {
    fn value(&mut self, kind: &str, value: i64) {
        macro_rules! put {
            ($type:ty) => {{
                let value = value as $type;
                match self.format {
                    "ascii" => self.bytes.extend(format!("{value} ").bytes()),
                    "binary_big_endian" => self.bytes.extend(value.to_be_bytes()),
                    _ => self.bytes.extend(value.to_le_bytes()),
                }
            }};
        }
        match kind {
            "char" | "int8" => put!(i8),
            "uchar" | "uint8" => put!(u8),
            "short" | "int16" => put!(i16),
            "ushort" | "uint16" => put!(u16),
            "int" | "int32" => put!(i32),
            "uint" | "uint32" => put!(u32),
            "float" | "float32" => put!(f32),
            "double" | "float64" => put!(f64),
            other => panic!("{other}"),
        }
    }

    fn list(&mut self, count: &str, item: &str, values: &[i64]) {
        self.value(count, values.len() as i64);
        values.iter().for_each(|&value| self.value(item, value));
    }

    fn end_row(&mut self) {
        if self.format == "ascii" {
            self.bytes.extend(self.line_end.bytes());
        }
    }
}

fn write(variant: Variant) -> Vec<u8> {
    let Variant { format, coordinate, count, index, list_name, line_end, layout } = variant;
    let crowded = layout == Layout::Crowded;
    let vertex = if crowded {
        format!(
            "element vertex 8|property uchar red|property {coordinate} z|property list uchar double extra|\
             property {coordinate} x|property short q|property {coordinate} y|property float s"
        )
    } else {
        format!("element vertex 8|property {coordinate} x|property {coordinate} y|property {coordinate} z")
    };
    let face = if crowded {
        format!(
            "element face 4|property double area|property list {count} {index} {list_name}|\
                 property list uchar float texcoord|property uchar red"
        )
    } else {
        format!("element face 4|property list {count} {index} {list_name}")
    };
    let elements = match layout {
        Layout::Plain => format!("{vertex}|{face}"),
        Layout::FacesFirst => format!("{face}|{vertex}"),
        Layout::Crowded => format!(
            "element camera 2|property float f|property list ushort char name|{vertex}|element edge 3|property int a|\
             {face}|element material 1|property uchar m"
        ),
    };
    let header = format!("ply|format {format} 1.0|comment made by a test|obj_info x|{elements}|end_header|");
    let mut out = PlyWriter { format, line_end, bytes: header.replace('|', line_end).into_bytes() };
    if crowded {
        for name in [&[1, 2, 3][..], &[]] {
            out.value("float", 9);
            out.list("ushort", "char", name);
            out.end_row();
        }
    }
    if layout == Layout::FacesFirst {
        faces(&mut out, variant);
    }
    for v in 0..8 {
        let [x, y, z] = corner(v).map(|value| value as i64);
        if crowded {
            out.value("uchar", 200);
            out.value(coordinate, z);
            out.list("uchar", "double", &[5; 3][..v % 4]);
            out.value(coordinate, x);
            out.value("short", -3);
            out.value(coordinate, y);
            out.value("float", 1);
        } else {
            [x, y, z].iter().for_each(|&value| out.value(coordinate, value));
        }
        out.end_row();
    }
    if crowded {
        for _ in 0..3 {
            out.value("int", 77);
            out.end_row();
        }
    }
    if layout != Layout::FacesFirst {
        faces(&mut out, variant);
    }
    if crowded {
        out.value("uchar", 1);
        out.end_row();
    }
    out.bytes
}

fn faces(out: &mut PlyWriter, variant: Variant) {
    let crowded = variant.layout == Layout::Crowded;
    for (at, triangle) in TRIANGLES.iter().enumerate() {
        if crowded {
            out.value("double", 3);
        }
        out.list(variant.count, variant.index, &triangle.map(|index| index as i64));
        if crowded {
            out.list("uchar", "float", &[1, 2, 3, 4][..at]);
            out.value("uchar", 7);
        }
        out.end_row();
    }
}

/// The same file through another reader.
fn oracle(content: &[u8]) -> Vec<SourceTriangle> {
    let ply = Parser::<DefaultElement>::new().read_ply(&mut &content[..]).unwrap();
    let number = |element: &DefaultElement, name: &str| match element[name] {
        Property::Char(value) => f64::from(value),
        Property::UChar(value) => f64::from(value),
        Property::Short(value) => f64::from(value),
        Property::UShort(value) => f64::from(value),
        Property::Int(value) => f64::from(value),
        Property::UInt(value) => f64::from(value),
        Property::Float(value) => f64::from(value),
        Property::Double(value) => value,
        ref other => panic!("{other:?}"),
    };
    let vertices: Vec<[f64; 3]> =
        ply.payload["vertex"].iter().map(|vertex| ["x", "y", "z"].map(|name| number(vertex, name))).collect();
    let corners = |element: &DefaultElement| -> Vec<usize> {
        let list = element.get("vertex_indices").or(element.get("vertex_index")).unwrap();
        match list {
            Property::ListChar(list) => list.iter().map(|&index| index as usize).collect(),
            Property::ListUChar(list) => list.iter().map(|&index| index as usize).collect(),
            Property::ListShort(list) => list.iter().map(|&index| index as usize).collect(),
            Property::ListUShort(list) => list.iter().map(|&index| index as usize).collect(),
            Property::ListInt(list) => list.iter().map(|&index| index as usize).collect(),
            Property::ListUInt(list) => list.iter().map(|&index| index as usize).collect(),
            other => panic!("{other:?}"),
        }
    };
    ply.payload["face"]
        .iter()
        .map(|face| corners(face)[..3].try_into().unwrap())
        .map(|triangle: [usize; 3]| triangle.map(|index| vertices[index]))
        .collect()
}

fn check(variant: Variant) -> SourceMesh {
    let content = write(variant);
    let mesh = check_corners("a.ply", &content, &TRIANGLES);
    // The oracle takes no lone CR.
    if variant.line_end != "\r" {
        assert!(same(&mesh.triangles, &oracle(&content)), "{variant:?}");
    }
    mesh
}

#[test]
fn every_type_in_every_format() {
    let integers = [
        "char", "uint8", "short", "ushort", "int", "uint32", "int8", "uchar", "int16", "uint16", "int32",
        "uint",
    ];
    for format in FORMATS {
        for index in integers {
            check(Variant { format, index, ..PLAIN });
            check(Variant { format, index, count: index, layout: Layout::Crowded, ..PLAIN });
        }
        for coordinate in ["double", "float64", "float32"].iter().chain(&integers) {
            check(Variant { format, coordinate, ..PLAIN });
        }
    }
}

#[test]
fn every_layout_in_every_format() {
    for format in FORMATS {
        for line_end in ["\n", "\r\n", "\r"] {
            for layout in [Layout::Plain, Layout::Crowded, Layout::FacesFirst] {
                let mesh = check(Variant { format, line_end, layout, list_name: "vertex_index", ..PLAIN });
                let dropped = if layout == Layout::Crowded { 8 } else { 0 };
                assert_eq!((mesh.stats.vertex_count, mesh.stats.dropped_attribute_count), (8, dropped));
                assert_eq!((mesh.stats.vertex_lookups, &mesh.stats.warnings[..]), (12, &[][..]));
            }
        }
    }
}

#[test]
fn data_may_begin_with_a_line_feed() {
    // The first byte of the data is 0x0a, after a header in each line end. It once vanished with a lone CR.
    for line_end in ["\n", "\r\n", "\r"] {
        let header = "ply|format binary_little_endian 1.0|element vertex 3|property uchar x|property uchar y|\
                      property uchar z|element face 1|property list uchar uchar vertex_indices|end_header|";
        let content =
            [header.replace('|', line_end).as_bytes(), b"\x0a\0\0\x01\x01\0\0\x01\0\x03\0\x01\x02"].concat();
        let mesh = Fixture::new("a.ply", &content).read().unwrap();
        assert_eq!(mesh.triangles, [[[10.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]]]);
    }
}

/// A cube's vertices and one element more, as text.
fn cube(element: &str, rows: &str) -> String {
    let vertices: String =
        (0..8).map(|v| corner(v).map(|value| format!("{value} ")).concat() + "\n").collect();
    format!(
        "ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n{element}\
         end_header\n{vertices}{rows}"
    )
}

const FACES: &str = "property list uchar int vertex_indices\n";

#[test]
fn polygons_strips_and_odd_rows() {
    let check = |element: &str, rows: &str, expected: &[[usize; 3]]| {
        check_corners("a.ply", cube(element, rows).as_bytes(), expected)
    };
    let faces = |count: usize| format!("element face {count}\n{FACES}");
    let mesh = check(&faces(3), "4 0 1 3 2\n2 0 1\n3 4 5 6 9 9\n", &[[0, 1, 3], [0, 3, 2], [4, 5, 6]]);
    assert_eq!(
        (mesh.stats.polygon_count, mesh.stats.skipped_face_count, mesh.stats.warnings.len()),
        (1, 1, 1)
    );
    let strips = "element tristrips 2\nproperty list int int vertex_indices\n";
    let expected = [[0, 1, 2], [2, 1, 3], [2, 3, 4], [5, 6, 7], [7, 6, 0], [1, 2, 3]];
    check(strips, "10 0 1 2 3 4 -1 5 6 7 0\n7 -1 -1 0 -1 1 2 3\n", &expected);
    let both = format!("{}{strips}", faces(1));
    check(&both, "3 7 6 5\n3 0 1 2\n4 4 5 6 7\n", &[[7, 6, 5], [0, 1, 2], [4, 5, 6], [6, 5, 7]]);
    let mesh = check("", "", &[]);
    assert_eq!(mesh.stats.warnings.len(), 1);
}

#[test]
fn a_long_strip_crosses_batches() {
    let count = 100_000;
    let header = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {count}\nproperty double x\nproperty double y\n\
         property double z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    );
    let mut content = header.into_bytes();
    let position = |v: usize| [v as f64, (v % 2) as f64, 0.5];
    content.extend((0..count).flat_map(position).flat_map(f64::to_le_bytes));
    content.extend((count as i32).to_le_bytes());
    content.extend((0..count as i32).flat_map(i32::to_le_bytes));
    let mesh = Fixture::new("a.ply", &content).read().unwrap();
    assert_eq!(mesh.triangles.len(), count - 2);
    for (at, triangle) in mesh.triangles.iter().enumerate() {
        let expected = if at % 2 == 0 { [at, at + 1, at + 2] } else { [at + 1, at, at + 2] };
        assert_eq!(*triangle, expected.map(position));
    }
}

#[test]
fn a_small_cache_gives_the_same_triangles() {
    let (count, faces) = (30_000i64, 1500);
    for (format, vertex_list) in
        [("ascii", false), ("binary_big_endian", false), ("binary_little_endian", true)]
    {
        let list = if vertex_list { "property list uchar uchar more\n" } else { "" };
        let header = format!(
            "ply\nformat {format} 1.0\nelement vertex {count}\nproperty float x\nproperty float y\nproperty float z\n\
             {list}element face {faces}\nproperty list uchar uint vertex_indices\nend_header\n"
        );
        let mut out = PlyWriter { format, line_end: "\n", bytes: header.into_bytes() };
        for v in 0..count {
            [v, v % 7, v % 11].iter().for_each(|&value| out.value("float", value));
            if vertex_list {
                out.list("uchar", "uchar", &[1, 2][..v as usize % 3]);
            }
            out.end_row();
        }
        for f in 0..faces {
            out.list("uchar", "uint", &[f, (f * 7919) % count, (f * 104_729 + 5) % count]);
            out.end_row();
        }
        let fixture = Fixture::new("a.ply", &out.bytes);
        let flat = fixture.read().unwrap();
        let mut options = fixture.options();
        options.vertex_cache_bytes = 0;
        let small = read(&fixture.path, &options).unwrap();
        assert!(same(&flat.triangles, &small.triangles), "{format}");
        assert!(small.stats.vertex_cache_misses > 1000 && flat.stats.vertex_cache_misses < 60, "{format}");
        assert_eq!(flat.triangles[1][1], [7919.0, (7919 % 7) as f64, (7919 % 11) as f64]);
    }
}

#[test]
fn what_is_declared_is_known_without_loading() {
    let fixture = Fixture::new("a.ply", &write(Variant { format: "binary_big_endian", ..PLAIN }));
    let info = super::super::info(&fixture.path, &fixture.options()).unwrap();
    assert_eq!((info.vertex_count, info.face_count), (Some(8), Some(4)));
    assert_eq!(info.encoding, super::super::Encoding::BinaryBigEndian);
}
