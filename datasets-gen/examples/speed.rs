//! Triangles per second of one generator: `speed KIND COUNT [THREADS] [SEED]`.
#![allow(clippy::print_stdout)]

use datasets_gen::{GenOptions, Spec};
use std::time::Instant;

fn main() -> trex_store::Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let arg = |index: usize, default: &str| args.get(index).cloned().unwrap_or(default.to_string());
    let spec = Spec::parse(&format!("gen:{}:{}:{}", arg(0, "isosurface"), arg(1, "5M"), arg(3, "1")))?;
    let threads = arg(2, "2").parse().unwrap_or(2);
    let options = GenOptions { threads, ..GenOptions::default() };
    let start = Instant::now();
    let mut source = datasets_gen::open(&spec, &options)?;
    let opened = start.elapsed();
    let mut batch = trex_store::TriangleBatch::default();
    let mut count = 0;
    while source.next_batch(&mut batch)? {
        count += batch.len() as u64;
    }
    let all = start.elapsed();
    let hint = source.hint().expect("generators know");
    let off = |count: u64, from: u64| 100.0 * (count as f64 / from as f64 - 1.0);
    println!(
        "{spec}, {threads} threads: {count} triangles ({:+.3} % of asked, {:+.3} % of hint), open {:.3} s, \
         stream {:.3} s, {:.3} M triangles/s in all, {:.1} MiB leased at most",
        off(count, spec.triangles),
        off(count, hint.triangle_count),
        opened.as_secs_f64(),
        (all - opened).as_secs_f64(),
        count as f64 / all.as_secs_f64() / 1e6,
        options.budget.peak_bytes() as f64 / f64::from(1 << 20),
    );
    Ok(())
}
