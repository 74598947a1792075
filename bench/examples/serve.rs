//! A web server of one file over a wire of some length, to measure page files behind HTTP:
//! `serve FILE ROUND_TRIP_MS BYTES_PER_SECOND`. It tells its address, and for each line that it reads the requests and
//! bytes since the last one.

#[allow(dead_code, reason = "the tests' server, of which this needs the good side alone")]
#[path = "../../tests/it/http/server.rs"]
mod server;

use anyhow::Context;
use server::{Manners, Server, Wire};
use std::io::Write;
use std::path::Path;
use std::time::Duration;

fn main() -> anyhow::Result<()> {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let [file, round_trip_ms, bytes_per_second] = &words[..] else {
        anyhow::bail!("usage: serve FILE ROUND_TRIP_MS BYTES_PER_SECOND (0: as fast as it goes)");
    };
    let wire = Wire {
        round_trip: Duration::from_secs_f64(round_trip_ms.parse::<f64>().context("milliseconds")? / 1e3),
        bytes_per_second: bytes_per_second.parse().context("bytes a second")?,
    };
    let server = Server::over(Path::new(file), |_| Manners::Good, wire, Box::new(|stream| Box::new(stream)));
    let mut out = std::io::stdout();
    writeln!(out, "{}", server.url)?;
    let mut before = (0, 0);
    for asked in std::io::stdin().lines() {
        asked?;
        let now = (server.requests(), server.sent_bytes());
        writeln!(out, "{} requests, {} bytes", now.0 - before.0, now.1 - before.1)?;
        before = now;
    }
    Ok(())
}
