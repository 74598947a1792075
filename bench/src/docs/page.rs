//! `Page`: one page under way, its markers filled from the figures.

use super::commands;
use super::comparison::Comparison;
use super::figure::{self, Figure};
use super::keys;
use super::markers::{BlockKind, CLOSE, END, fill_line, quoted, words};
use super::table::{self, Column};
use crate::plot::{self, Line};
use anyhow::{Context, bail, ensure};
use std::collections::{BTreeMap, BTreeSet};

/// One page under way.
pub(super) struct Page<'a> {
    figures: &'a [Figure],
    /// The plots that it shows, by name.
    pub(super) plots: BTreeMap<String, String>,
    /// Names of the records that it shows.
    pub(super) shown: BTreeSet<String>,
    /// Names of the records whose commands it has.
    pub(super) told: BTreeSet<String>,
}

impl<'a> Page<'a> {
    /// A page whose figures are of these.
    pub(super) fn new(figures: &'a [Figure]) -> Page<'a> {
        Page { figures, plots: BTreeMap::new(), shown: BTreeSet::new(), told: BTreeSet::new() }
    }

    /// The page with everything between its markers replaced.
    pub(super) fn fill(&mut self, text: &str) -> anyhow::Result<String> {
        let mut filled = String::with_capacity(text.len());
        let mut lines = text.lines().enumerate();
        while let Some((index, line)) = lines.next() {
            let place = || format!("line {}", index + 1);
            let Some((kind, first)) = BlockKind::of(line) else {
                filled += &fill_line(line, |words| self.value(words)).with_context(place)?;
                filled.push('\n');
                continue;
            };
            let mut marker = format!("{first}\n");
            filled += &format!("{line}\n");
            while !marker.trim_end().ends_with(CLOSE) {
                let next = lines.next().map(|(_, line)| line).filter(|line| *line != END);
                let next =
                    next.with_context(|| format!("{}: the marker does not end in {CLOSE:?}", place()))?;
                marker += &format!("{next}\n");
                filled += &format!("{next}\n");
            }
            let block = self.block(kind, marker.trim_end().trim_end_matches(CLOSE)).with_context(place)?;
            ensure!(lines.any(|(_, line)| line == END), "{}: {END} is missing", place());
            if !block.is_empty() {
                filled += &format!("\n{block}\n");
            }
            filled += &format!("{END}\n");
        }
        Ok(filled)
    }

    /// The figure in a sentence: the value of `NAME KEY`, or the least and the greatest of `NAME,NAME KEY`.
    fn value(&mut self, words: &[&str]) -> anyhow::Result<String> {
        let [names, key] = words else { bail!("accepted is figure:NAME,.. KEY") };
        let rows = self.select(names);
        ensure!(!rows.is_empty(), "{names}: no such record");
        let missing = rows.iter().find(|row| !row.has(key)).map(|row| &row.record.name);
        ensure!(missing.is_none(), "{}: the record has no {key}", missing.expect("it is missing"));
        let order = |a: &&&Figure, b: &&&Figure| {
            a.number(key).unwrap_or(f64::NAN).total_cmp(&b.number(key).unwrap_or(f64::NAN))
        };
        let ends = rows.iter().min_by(order).zip(rows.iter().max_by(order)).expect("there is a row");
        let (least, most) = (ends.0.text(key), ends.1.text(key));
        Ok(if least == most { least } else { format!("{least} to {most}") })
    }

    /// The figures that any of these patterns fits; they are shown then.
    fn select(&mut self, patterns: &str) -> Vec<&'a Figure> {
        let figures = figure::select(self.figures, patterns);
        self.shown.extend(figures.iter().map(|figure| figure.record.name.clone()));
        figures
    }

    fn block(&mut self, kind: BlockKind, marker: &str) -> anyhow::Result<String> {
        match kind {
            BlockKind::Table => self.table(marker),
            BlockKind::Comparison => self.comparison(marker),
            BlockKind::Plot => self.plot(marker),
            BlockKind::Commands => self.commands(marker),
            BlockKind::Keys => Ok(keys::render()),
        }
    }

    fn table(&mut self, marker: &str) -> anyhow::Result<String> {
        let mut words = words(marker).into_iter().peekable();
        let pattern = words.next().context("the marker names no record")?;
        let said = words.next_if(|word| word.starts_with("say=")).map(|word| {
            quoted(word).map(|(_, text)| text).with_context(|| format!("{word}: accepted is say=\"TEXT\""))
        });
        let said = said.transpose()?;
        let column =
            |word| Column::parse(word).with_context(|| format!("{word}: accepted is KEY or KEY=\"NAME\""));
        let columns = words.map(column).collect::<anyhow::Result<Vec<_>>>()?;
        ensure!(!columns.is_empty(), "the marker names no key");
        let rows = self.select(pattern);
        if rows.is_empty() {
            return Ok(String::new());
        }
        let stem = pattern.strip_suffix('*').unwrap_or_default();
        let said = said.map(|text| format!("{}\n\n", text.split_whitespace().collect::<Vec<_>>().join(" ")));
        Ok(said.unwrap_or_default() + &table::render(&rows, &columns, stem))
    }

    fn comparison(&mut self, marker: &str) -> anyhow::Result<String> {
        let comparison = Comparison::parse(marker)?;
        let is_recorded = |name: &String| self.figures.iter().any(|figure| figure.record.name == *name);
        let recorded: Vec<String> = comparison.names().filter(is_recorded).collect();
        if recorded.is_empty() {
            return Ok(String::new());
        }
        self.shown.extend(recorded);
        comparison.render(self.figures)
    }

    fn commands(&mut self, marker: &str) -> anyhow::Result<String> {
        let [patterns] = words(marker)[..] else { bail!("accepted is commands:PATTERN,..") };
        let rows = figure::select(self.figures, patterns);
        self.told.extend(rows.iter().map(|row| row.record.name.clone()));
        Ok(if rows.is_empty() { String::new() } else { commands::render(&rows) })
    }

    fn plot(&mut self, marker: &str) -> anyhow::Result<String> {
        let [name, patterns, x, y] = words(marker)[..] else {
            bail!("accepted is plot:FILE PATTERN,.. x=KEY y=KEY")
        };
        let axes = x.strip_prefix("x=").zip(y.strip_prefix("y="));
        let axes = axes.and_then(|(x, y)| Column::parse(x).zip(Column::parse(y)));
        let (x, y) = axes.context("axes are x=KEY y=KEY, each with =\"NAME\" or not")?;
        let mut lines: Vec<Line> = vec![];
        for pattern in patterns.split(',') {
            let figures = self.select(pattern);
            match x.key.strip_suffix(".*") {
                Some(stem) => lines.extend(figures.iter().map(|figure| figure.line(stem, y.key))),
                None => lines.push(figure::line_of(pattern, &figures, x.key, y.key)),
            }
        }
        lines.retain(|line| !line.points.is_empty());
        if lines.is_empty() {
            return Ok(String::new());
        }
        let (x, y) = (x.title(), y.title());
        let svg = plot::render(&lines, &x, &y).with_context(|| format!("plot {name}"))?;
        self.plots.insert(name.to_owned(), svg);
        Ok(format!("![{y} over {x}](plots/{name}.svg)\n"))
    }
}
