//! Eight pages for minutes: one drags and rests, six watch, and one leaves and comes back all the time. That is as many
//! as a server takes: where it has not noticed yet that one left, the next is refused, and comes again later.

use crate::page::{Failure, Page, SIZE};
use crate::process::{Process, ProcessUse};
use serde_json::{Value, json};
use std::time::{Duration, Instant};

const WATCHERS: usize = 6;
/// A turn: the driver drags for a part of it, and rests.
const TURN: Duration = Duration::from_secs(2);
const DRAGS: u32 = 20;
/// The page that comes and goes stays for so long.
const STAYS: Duration = Duration::from_millis(40);
/// What a server answers that has as many pages as it takes.
const FULL: &str = "503";
/// Share of the samples at the beginning that are left out: pages of the model come in.
const WARM: f64 = 0.3;

/// Runs for `time`; gives what the server's `process` held.
pub(crate) fn soak(url: &str, process: &Process, time: Duration) -> Result<Value, Failure> {
    let mut driver = Page::open(url, SIZE)?;
    let mut watchers = (0..WATCHERS).map(|_| Page::open(url, SIZE)).collect::<Result<Vec<_>, _>>()?;
    let (begin, mut reconnects, mut refused, mut samples) = (Instant::now(), 0u64, 0u64, vec![]);
    let first = process.held()?;
    let mut events = 0u32;
    while begin.elapsed() < time {
        let turn = Instant::now();
        for _ in 0..DRAGS {
            events += 1;
            driver.turn(f64::from(events) * 0.01)?;
            driver.listen(Instant::now() + Duration::from_millis(10))?;
            match Page::open(url, SIZE) {
                Ok(mut page) => {
                    page.listen(Instant::now() + STAYS)?;
                    reconnects += 1;
                }
                Err(error) if error.to_string().contains(FULL) => refused += 1,
                Err(error) => return Err(error),
            }
            for watcher in &mut watchers {
                watcher.listen(Instant::now() + Duration::from_millis(1))?;
            }
        }
        driver.listen(turn + TURN)?;
        // What went is gone.
        samples.push((begin.elapsed().as_secs_f64() / 60.0, process.held()?));
    }
    let warm = &samples[(samples.len() as f64 * WARM) as usize..];
    let last = samples.last().ok_or("no time for a sample")?.1;
    let span = |of: fn(&ProcessUse) -> u64| {
        let values = warm.iter().map(|(_, held)| of(held));
        [values.clone().min(), values.max()]
    };
    Ok(json!({
        "minutes": time.as_secs_f64() / 60.0,
        "reconnects": reconnects,
        "refused": refused,
        "pages": WATCHERS + 2,
        "resident_bytes": [first.resident_bytes, last.resident_bytes],
        "resident_slope_bytes_per_min": slope(warm.iter().map(|(at, held)| (*at, held.resident_bytes as f64))),
        "threads": span(|held| held.threads),
        "files": span(|held| held.files),
        "driver_frames": driver.log.frames,
    }))
}

/// Of the line of least squares.
fn slope(points: impl Iterator<Item = (f64, f64)> + Clone) -> Option<f64> {
    let count = points.clone().count() as f64;
    let mean = |of: fn((f64, f64)) -> f64| points.clone().map(of).sum::<f64>() / count;
    let [x, y] = [mean(|(x, _)| x), mean(|(_, y)| y)];
    let product: f64 = points.clone().map(|(a, b)| (a - x) * (b - y)).sum();
    let square: f64 = points.map(|(a, _)| (a - x).powi(2)).sum();
    (square > 0.0).then(|| product / square)
}
