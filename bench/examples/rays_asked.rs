//! The Rust call beside `bench/python_rays.py`: the rays of its arrays, asked of a model as often as stdin names them.
//!
//! ```text
//! rays_asked MODEL FOLDER    ->  for each line KIND: rays of FOLDER/KIND.f64, `{"rays_per_s": .., "hits": ..}`
//! ```
//!
//! A file holds little-endian f64, six for each ray: origin and direction. Invariant: what is timed is the call alone,
//! of rays that are in memory, to answers that are in memory.

use serde_json::json;
use std::io::{BufRead, Write};
use std::path::Path;
use std::time::Instant;
use trex_model::{Model, OpenOptions};
use trex_render::Ray;
use trex_store::Interrupt;

/// The limit of the Python package's process beside.
const LIMIT_BYTES: u64 = 2 << 30;

/// The rays of a file.
fn rays_of(path: &Path) -> Vec<Ray> {
    let bytes = std::fs::read(path).expect("a file of rays");
    let number = |bytes: &[u8]| f64::from_le_bytes(bytes.try_into().expect("eight bytes"));
    let rows = bytes.chunks_exact(48).map(|row| -> Vec<f64> { row.chunks_exact(8).map(number).collect() });
    let vector = |row: &[f64]| [row[0], row[1], row[2]];
    rows.map(|row| Ray { origin: vector(&row), direction: vector(&row[3..]), t_max: f64::INFINITY }).collect()
}

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [path, folder] = arguments.as_slice() else { panic!("usage: rays_asked MODEL FOLDER") };
    let began = Instant::now();
    let model = Model::open(Path::new(path), &OpenOptions::with_limit(LIMIT_BYTES)).expect("a page file");
    let interrupt = Interrupt::default();
    let opened_s = began.elapsed().as_secs_f64();
    for kind in std::io::stdin().lock().lines() {
        let rays = rays_of(&Path::new(folder).join(kind.expect("a line")).with_extension("f64"));
        let began = Instant::now();
        let hits = model.intersect(&rays, &interrupt).expect("rays").iter().flatten().count();
        let rays_per_s = rays.len() as f64 / began.elapsed().as_secs_f64();
        let said = json!({ "rays_per_s": rays_per_s, "hits": hits, "opened_s": opened_s });
        writeln!(std::io::stdout().lock(), "{said}").expect("a reader");
    }
}
