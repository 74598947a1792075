//! How fast a mesh file is read: `cargo run --release -p trex-store --example read_speed -- FILE [CACHE_MIB [VALUE]]`.
//! VALUE is that of the surface of a volume.
//! Reads it twice, prints both; the second pass has the file in the page cache if memory allows.
#![allow(clippy::print_stdout)]

use std::path::PathBuf;
use std::time::Instant;
use trex_store::TriangleBatch;
use trex_store::import::{ImportOptions, open};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = PathBuf::from(arguments.next().ok_or("usage: read_speed FILE [CACHE_MIB [VALUE]]")?);
    let mut options = ImportOptions::unlimited(&std::env::temp_dir());
    if let Some(mebibytes) = arguments.next() {
        options.vertex_cache_bytes = mebibytes.parse::<u64>()? << 20;
    }
    options.volumes.iso_values = arguments.map(|value| value.parse()).collect::<Result<_, _>>()?;
    let mut source = open(&path, &options)?;
    for pass in 1..=2 {
        let start = Instant::now();
        // Read, so that the compiler cannot leave the corners out.
        let mut sum = 0.0;
        let mut batch = TriangleBatch::default();
        while source.next_batch(&mut batch)? {
            sum += batch
                .corners
                .iter()
                .map(|corners| corners[0][0] + corners[1][1] + corners[2][2])
                .sum::<f64>();
        }
        let seconds = start.elapsed().as_secs_f64();
        let stats = source.stats();
        println!(
            "pass {pass}: {:.0} MB/s, {:.1} M triangles/s, {} triangles, {} of {} look-ups missed, \
             {} bytes held, sum {sum:e}",
            stats.bytes_total as f64 / 1e6 / seconds,
            stats.triangle_count as f64 / 1e6 / seconds,
            stats.triangle_count,
            stats.vertex_cache_misses,
            stats.vertex_lookups,
            options.budget.used_bytes(),
        );
        source.rewind()?;
    }
    Ok(())
}
