//! Models that walls are tried on: honest ones of each kind, and odd ones, whose numbers no generator makes. Each is a
//! mesh file, so that a build inside of a wall has something to read.

use crate::command::{document_in, models};
use crate::random::Random;
use std::fs;
use std::path::Path;

type WallTriangle = [[f64; 3]; 3];

/// A mesh file, and how it is written.
pub(super) struct WallModel {
    pub(super) what: &'static str,
    /// Its file in the folder.
    pub(super) file: &'static str,
    /// Flags of its build.
    pub(super) flags: &'static str,
    write: fn(&Path),
}

/// All of them; the first is the one of a normal run, at all sizes.
pub(super) const MODELS: [WallModel; 10] = [
    WallModel { what: "a scan", write: |path| generated("scan", path), ..PLAIN },
    WallModel { what: "an iso-surface", write: |path| generated("isosurface", path), ..PLAIN },
    WallModel { what: "a plant", write: |path| generated("pipes", path), flags: "--voxels 64/256", ..PLAIN },
    WallModel { what: "plates and bolts", write: |path| ply(path, &plates_and_bolts()), ..PLAIN },
    WallModel { what: "a flat sheet", write: |path| ply(path, &sheet(220, |x, y| [x, y, 0.0])), ..PLAIN },
    WallModel { what: "one triangle", write: |path| ply(path, &[LARGE]), ..PLAIN },
    WallModel {
        what: "a sheet far away",
        write: |path| ply(path, &sheet(220, |x, y| [x + 1e12, y - 1e12, (0.1 * x).sin() * (0.2 * y).cos()])),
        ..PLAIN
    },
    WallModel {
        what: "a sheet of huge extent",
        write: |path| ply(path, &sheet(220, |x, y| [1e150 * x, 1e150 * y, 1e148 * (x * y % 7.0)])),
        ..PLAIN
    },
    WallModel { what: "copies of a triangle", write: |path| ply(path, &vec![LARGE; 100_000]), ..PLAIN },
    WallModel { what: "triangles of all sizes", write: |path| ply(path, &all_sizes()), ..PLAIN },
];

const PLAIN: WallModel = WallModel { what: "", file: "m.ply", flags: "--voxels 256", write: |_| () };
const LARGE: WallTriangle = [[0.0, 0.0, 0.0], [1000.0, 3.0, 500.0], [20.0, 1000.0, 700.0]];

impl WallModel {
    /// Writes the mesh file into a folder, and builds `m.trex` of it.
    pub(super) fn make(&self, inside: &Path) {
        (self.write)(&inside.join(self.file));
        document_in(inside, &format!("build {} -o m.trex --overwrite {}", self.file, self.flags));
    }
}

fn generated(kind: &str, path: &Path) {
    let inside = path.parent().unwrap();
    document_in(inside, &format!("gen {kind} --triangles 140k -o m.ply --overwrite"));
}

/// Writes triangles as binary PLY in f64, each with vertices of its own.
fn ply(path: &Path, triangles: &[WallTriangle]) {
    let mut bytes = format!(
        "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty double x\nproperty double y\n\
         property double z\nelement face {}\nproperty list uchar uint vertex_indices\nend_header\n",
        3 * triangles.len(),
        triangles.len()
    )
    .into_bytes();
    bytes.extend(triangles.iter().flatten().flatten().flat_map(|value| value.to_le_bytes()));
    for first in (0..3 * triangles.len() as u32).step_by(3) {
        bytes.push(3);
        bytes.extend((first..first + 3).flat_map(u32::to_le_bytes));
    }
    fs::write(path, bytes).unwrap();
}

/// `n` by `n` squares of side 1, each point of which is put somewhere.
fn sheet(n: u32, point: impl Fn(f64, f64) -> [f64; 3]) -> Vec<WallTriangle> {
    let squares = (0..n).flat_map(|y| (0..n).map(move |x| (f64::from(x), f64::from(y))));
    let pairs = squares.map(|(x, y)| {
        let [a, b, c, d] = [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)].map(|(u, v)| point(x + u, y + v));
        [[a, b, c], [a, c, d]]
    });
    pairs.flatten().collect()
}

/// Plates of two triangles as large as the model, and boxes on them that are a thousand times smaller.
fn plates_and_bolts() -> Vec<WallTriangle> {
    let (mut triangles, mut random) = (Vec::new(), Random::seeded(17));
    for floor in 0..40 {
        let z = 50.0 * f64::from(floor);
        triangles.extend(sheet(1, |x, y| [2000.0 * x, 2000.0 * y, z]));
        for _ in 0..200 {
            let [x, y] = [2000.0 * random.unit(), 2000.0 * random.unit()];
            let corner = |i: usize| [x + 2.0 * f64::from(i as u32 & 1), y + f64::from(i as u32 & 2), z];
            let at = |i: usize| {
                let [x, y, z] = corner(i);
                [x, y, z + 0.5 * f64::from(i as u32 & 4)]
            };
            for [a, b, c, d] in
                [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [1, 5, 7, 3], [3, 7, 6, 2], [2, 6, 4, 0]]
            {
                triangles.extend([[at(a), at(b), at(c)], [at(a), at(c), at(d)]]);
            }
        }
    }
    triangles
}

/// Loose triangles, of a millionth of the model's size to all of it.
fn all_sizes() -> Vec<WallTriangle> {
    let mut random = Random::seeded(18);
    let one = |_| {
        let (size, center) = (10f64.powf(6.0 * random.unit() - 3.0), random.point([0.0; 3], [1000.0; 3]));
        std::array::from_fn(|_| center.map(|value| value + size * (random.unit() - 0.5)))
    };
    (0..60_000).map(one).collect()
}

/// Real models that are to be built in walls, and files that others found nasty; none, said aloud, where none are.
pub(super) fn real_files() -> (Vec<std::path::PathBuf>, Vec<std::path::PathBuf>) {
    let Some(models) = models() else { return (vec![], vec![]) };
    let honest = ["cad/kicad_150k.obj", "scans/bunny.ply", "scans/horse.ply"].map(|name| models.join(name));
    let mut nasty = Vec::new();
    let mut folders = vec![models.join("nasty")];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            match path.is_dir() {
                true => folders.push(path),
                false => nasty.push(path),
            }
        }
    }
    nasty.sort();
    (honest.into(), nasty)
}
