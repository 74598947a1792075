//! `Figure`: what several runs of one command have in common, and how a value reads.
//!
//! Invariant: numbers are medians over the runs; a value that is no number is that of the last run.

use super::names::label;
use crate::median::median;
use crate::plot::Line;
use crate::record::Record;
use serde_json::Value;
use std::collections::BTreeMap;

/// Ends the key of how far the runs of a value are apart.
const SPREAD: &str = ".spread";

/// Runs that agree in name, command, machine and commit.
#[derive(Clone, Debug)]
pub(super) struct Figure {
    /// The last run, with each number replaced by its median.
    pub(super) record: Record,
    /// How many runs.
    pub(super) run_count: usize,
    /// Greatest less least number of the runs, over their median; of several runs.
    spreads: BTreeMap<String, f64>,
}

impl Figure {
    /// A value as a number; of `KEY/KEY` the quotient, of `KEY+KEY` the sum, of `KEY.spread` how far runs are apart.
    pub(super) fn number(&self, key: &str) -> Option<f64> {
        if let Some(key) = key.strip_suffix(SPREAD) {
            return self.spreads.get(key).copied();
        }
        if let Some((over, under)) = key.split_once('/') {
            return Some(self.number(over)? / self.number(under)?);
        }
        if let Some((one, others)) = key.split_once('+') {
            return Some(self.number(one)? + self.number(others)?);
        }
        self.record.values.get(key)?.as_f64()
    }

    /// Whether there is a value.
    pub(super) fn has(&self, key: &str) -> bool {
        self.number(key).is_some() || self.record.values.contains_key(key)
    }

    /// A value as text with its unit; a dash when the record has none, and words where a count of 0 says something.
    pub(super) fn text(&self, key: &str) -> String {
        match (self.number(key), self.record.values.get(key)) {
            (Some(0.0), _) if key.ends_with("evictions") => "nothing evicted".to_owned(),
            (Some(number), _) if key.contains('/') => with_unit(number, ""),
            (Some(number), _) => with_unit(number, key),
            (None, Some(Value::String(text))) => text.replace('|', "\\|"),
            (None, Some(value)) => value.to_string(),
            (None, None) => "-".to_owned(),
        }
    }
}

impl Figure {
    /// What it tells as `STEM.X.TAIL`, by X, a number above zero.
    pub(super) fn line(&self, stem: &str, tail: &str) -> Line {
        let point = |key: &String| {
            let x = key.strip_prefix(stem)?.strip_prefix('.')?.strip_suffix(tail)?.strip_suffix('.')?;
            Some((x.parse().ok()?, self.number(key)?))
        };
        Line::new(&of_family(&self.record.name), self.record.values.keys().filter_map(point).collect())
    }
}

/// A name as people say it, less its first word, which all lines of a plot have.
fn of_family(name: &str) -> String {
    label(name.split_once('-').map_or(name, |(_, rest)| rest))
}

/// The line of those of `figures`, which are of one pattern, that have both keys.
pub(super) fn line_of(pattern: &str, figures: &[&Figure], x: &str, y: &str) -> Line {
    let point = |figure: &&Figure| figure.number(x).zip(figure.number(y));
    Line::new(&of_family(pattern.trim_end_matches('*')), figures.iter().filter_map(point).collect())
}

/// Groups records into figures: per name the latest group, sorted by name.
///
/// "Latest" is the group whose last run stands last in the file, since files only grow.
pub(super) fn group(records: Vec<Record>) -> Vec<Figure> {
    let mut latest: BTreeMap<String, Vec<Record>> = BTreeMap::new();
    for record in records {
        let runs = latest.entry(record.name.clone()).or_default();
        runs.push(record);
    }
    latest.into_values().map(figure_of).collect()
}

/// The figure of the runs that are like the last of `runs`.
fn figure_of(mut runs: Vec<Record>) -> Figure {
    let mut last = runs.pop().expect("a group has a first record");
    runs.retain(|run| {
        (&run.command, &run.machine, &run.commit) == (&last.command, &last.machine, &last.commit)
    });
    let mut spreads = BTreeMap::new();
    for (key, value) in &mut last.values {
        let Some(number) = value.as_f64() else { continue };
        let others = runs.iter().filter_map(|run| run.values.get(key)?.as_f64());
        let numbers: Vec<f64> = others.chain([number]).collect();
        let middle = median(&numbers);
        if numbers.len() > 1 && middle != 0.0 {
            let ends = numbers.iter().fold([number; 2], |[lo, hi], x| [lo.min(*x), hi.max(*x)]);
            spreads.insert(key.clone(), (ends[1] - ends[0]) / middle.abs());
        }
        *value = middle.into();
    }
    Figure { record: last, run_count: runs.len() + 1, spreads }
}

/// The figures whose name fits one of `patterns`, which commas part, in order of name.
pub(super) fn select<'a>(figures: &'a [Figure], patterns: &str) -> Vec<&'a Figure> {
    let fits = |name: &str| {
        patterns.split(',').any(|pattern| match pattern.split_once('*') {
            Some((stem, end)) => name
                .strip_prefix(stem)
                .is_some_and(|rest| rest.strip_suffix(end).is_some_and(|any| !any.is_empty())),
            None => name == pattern,
        })
    };
    figures.iter().filter(|figure| fits(&figure.record.name)).collect()
}

/// Values side by side, with the unit said once where it is the same of all: `42.0, 65.1 ms`.
pub(super) fn with_common_unit(texts: &[String]) -> String {
    let unit = |text: &str| text.rsplit_once(' ').map(|(_, unit)| unit.to_owned());
    let Some((last, others)) = texts.split_last() else { return String::new() };
    let common = unit(last).filter(|common| others.iter().all(|text| unit(text).as_ref() == Some(common)));
    let bare = |text: &String| match &common {
        Some(common) => text.trim_end_matches(common.as_str()).trim_end().to_owned(),
        None => text.clone(),
    };
    others.iter().map(bare).chain([last.clone()]).collect::<Vec<_>>().join(", ")
}

/// Units that the keys end in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Unit {
    Bytes,
    Milliseconds,
    Nanoseconds,
    PerSecond,
    Count,
    Share,
    Plain,
}

impl Unit {
    /// The unit of the innermost part of a dotted key that has one: `phase_ms.scan` is in milliseconds.
    fn from_key(key: &str) -> Unit {
        let unit = |part: &str| {
            let ends =
                |unit: &str| part == unit || part.strip_suffix(unit).is_some_and(|rest| rest.ends_with('_'));
            // What is told at times: `error_at_ms.33` is no time.
            if part == &SPREAD[1..] {
                Some(Unit::Share)
            } else if part.ends_with("_at_ms") {
                Some(Unit::Plain)
            } else if ends("bytes") {
                Some(Unit::Bytes)
            } else if ends("ms") {
                Some(Unit::Milliseconds)
            } else if ends("ns") {
                Some(Unit::Nanoseconds)
            } else if ends("per_s") || ends("per_core_s") {
                Some(Unit::PerSecond)
            } else if ends("count") || part == "evictions" {
                Some(Unit::Count)
            } else if part.contains("_per_") {
                Some(Unit::Plain)
            } else {
                None
            }
        };
        key.rsplit('.').find_map(unit).unwrap_or(Unit::Plain)
    }
}

fn with_unit(number: f64, key: &str) -> String {
    match Unit::from_key(key) {
        Unit::Bytes => scaled(number, 1024.0, &["B", "KiB", "MiB", "GiB", "TiB"]),
        Unit::Milliseconds if number >= 1000.0 => scaled(number / 1000.0, f64::INFINITY, &["s"]),
        Unit::Milliseconds => scaled(number, f64::INFINITY, &["ms"]),
        Unit::Nanoseconds => scaled(number, 1000.0, &["ns", "us", "ms", "s"]),
        Unit::PerSecond => scaled(number, 1000.0, &["/s", "k/s", "M/s", "G/s"]),
        Unit::Count => scaled(number, 1000.0, &["", "k", "M", "G"]),
        Unit::Share => scaled(100.0 * number, f64::INFINITY, &["%"]),
        Unit::Plain => scaled(number, f64::INFINITY, &[""]),
    }
}

/// Three significant digits and the unit that keeps them below `step`; whole numbers below it stay whole.
fn scaled(number: f64, step: f64, units: &[&str]) -> String {
    let mut value = number;
    let mut unit = 0;
    while value.abs() >= step && unit + 1 < units.len() {
        value /= step;
        unit += 1;
    }
    let digits = match value.abs() {
        _ if unit == 0 && value.fract() == 0.0 => 0,
        small if small > 0.0 && small < 0.01 => {
            return format!("{value:.2e} {}", units[unit]).trim_end().to_owned();
        }
        small if small < 0.09995 => 4,
        small if small < 0.9995 => 3,
        middle if middle < 9.995 => 2,
        middle if middle < 99.95 => 1,
        _ => 0,
    };
    format!("{value:.digits$} {}", units[unit]).trim_end().to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_read_with_their_unit() {
        for (number, key, expected) in [
            (67_108_864.0, "memory.peak_rss_bytes", "64.0 MiB"),
            (12.34, "phase_ms.scan", "12.3 ms"),
            (12_340.0, "time_ms", "12.3 s"),
            (2_508_643_681.0, "g_stage.time_ns", "2.51 s"),
            (1_234_567.0, "rays_per_s.primary", "1.23 M/s"),
            (1_234_567.0, "rays_per_s.primary+rays_per_s.shadow", "1.23 M/s"),
            (1_234_567.0, "primary.per_core_s", "1.23 M/s"),
            (0.0421, "time_ms.spread", "4.21 %"),
            (5_000_000.0, "triangle_count", "5.00 M"),
            (999.0, "triangle_count", "999"),
            (4.021, "bytes_per_triangle.disk", "4.02"),
            (0.00012, "rmse", "1.20e-4"),
            (0.25, "error_at_ms.33.median", "0.250"),
            (0.0634, "flip", "0.0634"),
            (0.9996, "coverage", "1.00"),
            (0.0, "holes", "0"),
        ] {
            assert_eq!(with_unit(number, key), expected, "{key}");
        }
    }

    #[test]
    fn a_unit_that_is_common_is_said_once() {
        let join =
            |texts: &[&str]| with_common_unit(&texts.iter().map(|text| text.to_string()).collect::<Vec<_>>());
        assert_eq!(join(&["42.0 ms", "65.1 ms"]), "42.0, 65.1 ms");
        assert_eq!(join(&["712 ms", "2.02 s"]), "712 ms, 2.02 s");
        assert_eq!(join(&["1.18", "1.20"]), "1.18, 1.20");
        assert_eq!(join(&["-"]), "-");
    }
}
