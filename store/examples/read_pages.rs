//! Random page reads through every backend, pages per second: `cargo run --release -p trex-store --example read_pages
//! -- FILE [EXTENT_BYTES] [READS] [DEPTH]`
#![allow(clippy::print_stdout)]

use rand_pcg::rand_core::Rng;
use std::path::Path;
use std::time::Instant;
use trex_store::Error;
use trex_store::io::{
    DirectChoice, Extent, IoChoice, IoOptions, Reader, StagingBuffer, Wait, open, staging_bytes_for,
};

fn main() -> Result<(), Error> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let path = Path::new(arguments.first().map_or("read_pages.bin", String::as_str));
    let number =
        |index: usize, default| arguments.get(index).and_then(|text| text.parse().ok()).unwrap_or(default);
    let (stored_bytes, reads, depth) = (number(1, 24_000), number(2, 20_000), number(3, 32) as usize);
    let file_bytes = path.metadata().map_err(|error| Error::io("open", path, &error))?.len();
    for (io, direct) in [
        (IoChoice::Uring, DirectChoice::Auto),
        (IoChoice::Uring, DirectChoice::Off),
        (IoChoice::Pread, DirectChoice::Auto),
        (IoChoice::Pread, DirectChoice::Off),
        (IoChoice::Mmap, DirectChoice::Off),
    ] {
        let options = IoOptions { io, direct, depth, pread_threads: depth, connections: 0 };
        match open(path, &options) {
            Ok(backend) => {
                let mut reader = Reader::new(backend, path);
                let mut random = rand_pcg::Pcg64Mcg::new(1);
                let staging = || StagingBuffer::new(staging_bytes_for(stored_bytes as usize));
                let mut idle = (0..depth).map(|_| staging()).collect::<Result<Vec<_>, _>>()?;
                let (mut sent, mut arrivals, start) = (0, Vec::new(), Instant::now());
                while sent < reads || reader.in_flight() > 0 {
                    while sent < reads && reader.room() > 0 {
                        let offset =
                            random.next_u64() % file_bytes.saturating_sub(u64::from(stored_bytes)).max(1);
                        reader.submit(
                            sent,
                            Extent { offset, stored_bytes },
                            idle.pop().expect("a buffer a read"),
                        );
                        sent += 1;
                    }
                    reader.complete(Wait::One, &mut arrivals);
                    for arrival in arrivals.drain(..) {
                        arrival.result?;
                        idle.push(arrival.staging);
                    }
                }
                let seconds = start.elapsed().as_secs_f64();
                let (per_s, io) = (f64::from(reads) / seconds, reader.describe());
                let mib_per_s = per_s * f64::from(stored_bytes) / f64::from(1 << 20);
                println!(
                    "{:>6} direct={:<5} {per_s:>9.0} pages/s {mib_per_s:>7.0} MiB/s",
                    io.backend, io.direct
                );
            }
            Err(error) => println!("NOT RUN: {io:?} {direct:?}: {error}"),
        }
    }
    Ok(())
}
