//! Numbers for people: bytes, counts, rates, durations. For machines there is `--json`, with plain numbers.
//!
//! Invariant: three significant digits or fewer are lost, never more, and the unit is always printed.

use std::time::Duration;
use trex_render::MemoryPlan;

/// Bytes in binary units: `64.0 KiB`, `1.46 GiB`.
pub fn bytes(bytes: u64) -> String {
    const UNITS: [&str; 5] = ["KiB", "MiB", "GiB", "TiB", "PiB"];
    if bytes < 1024 {
        return format!("{bytes} B");
    }
    let mut value = bytes as f64 / 1024.0;
    let mut unit = 0;
    // 999.5 and up would print as four digits; the next unit keeps three.
    while value >= 999.5 && unit + 1 < UNITS.len() {
        value /= 1024.0;
        unit += 1;
    }
    format!("{} {}", three_digits(value), UNITS[unit])
}

/// A count in decimal units: `950`, `12.3k`, `5.00M`, `1.20G`.
pub fn count(count: u64) -> String {
    if count < 1_000 {
        return count.to_string();
    }
    let mut value = count as f64 / 1e3;
    let mut unit = 0;
    while value >= 999.5 && unit < 3 {
        value /= 1e3;
        unit += 1;
    }
    format!("{}{}", three_digits(value), ["k", "M", "G", "T"][unit])
}

/// A rate of things: `1.20M triangles/s`; of bytes: `750 MiB/s`.
pub fn rate(per_second: f64, unit: &str) -> String {
    let whole = per_second.max(0.0) as u64;
    if unit == "bytes" { format!("{}/s", bytes(whole)) } else { format!("{} {unit}/s", count(whole)) }
}

/// A duration: `12.3 ms`, `4.20 s`, `2 min 05 s`, `3 h 07 min`.
pub fn duration(duration: Duration) -> String {
    let seconds = duration.as_secs_f64();
    if seconds < 0.9995 {
        return format!("{} ms", three_digits(seconds * 1e3));
    }
    if seconds < 59.95 {
        return format!("{} s", three_digits(seconds));
    }
    let whole = seconds.round() as u64;
    if whole < 3600 {
        format!("{} min {:02} s", whole / 60, whole % 60)
    } else {
        format!("{} h {:02} min", whole / 3600, whole % 3600 / 60)
    }
}

/// Three significant digits below 1000: `1.23`, `12.3`, `123`.
fn three_digits(value: f64) -> String {
    if value < 9.995 {
        format!("{value:.2}")
    } else if value < 99.95 {
        format!("{value:.1}")
    } else {
        format!("{value:.0}")
    }
}

/// The shares of a memory plan.
pub fn memory_plan(plan: &MemoryPlan) -> String {
    let parts = [
        ("reserve", plan.reserve_bytes),
        ("tables", plan.tables_bytes),
        ("voxels", plan.voxels_bytes),
        ("photons", plan.photons_bytes),
        ("film", plan.film_bytes),
        ("staging", plan.staging_bytes),
        ("frames", plan.frames_bytes),
    ];
    parts.map(|(name, part)| format!("{name} {}", bytes(part))).join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_change_unit_before_the_fourth_digit() {
        for (value, expected) in [
            (0, "0 B"),
            (1023, "1023 B"),
            (1024, "1.00 KiB"),
            (64 << 10, "64.0 KiB"),
            ((1 << 20) - 1, "1.00 MiB"),
            (512 << 20, "512 MiB"),
            (1_568_669_696, "1.46 GiB"),
            (u64::MAX, "16384 PiB"),
        ] {
            assert_eq!(bytes(value), expected);
        }
    }

    #[test]
    fn counts_and_rates_keep_three_digits() {
        for (value, expected) in [
            (0, "0"),
            (999, "999"),
            (1_000, "1.00k"),
            (999_950, "1.00M"),
            (5_000_000, "5.00M"),
            (1_200_000_000, "1.20G"),
        ] {
            assert_eq!(count(value), expected);
        }
        assert_eq!(rate(1_234_567.0, "triangles"), "1.23M triangles/s");
        assert_eq!(rate((750u64 << 20) as f64, "bytes"), "750 MiB/s");
        assert_eq!(rate(f64::NAN, "pages"), "0 pages/s");
    }

    #[test]
    fn durations_pick_their_unit() {
        for (seconds, expected) in [
            (0.0123, "12.3 ms"),
            (0.9999, "1.00 s"),
            (4.2, "4.20 s"),
            (59.97, "1 min 00 s"),
            (125.0, "2 min 05 s"),
            (11_220.0, "3 h 07 min"),
        ] {
            assert_eq!(duration(Duration::from_secs_f64(seconds)), expected);
        }
    }
}
