//! `Comparison`: a table with a column per model and a row per thing that was measured of each.
//!
//! ```text
//! | | Iso-surface | Plant |            compare:isosurface="Iso-surface" pipes="Plant"
//! | A whole picture | 42 ms | 103 ms |  stress-*-inside:whole_ms.p50="A whole picture"
//! ```

use super::figure::{self, Figure};
use super::markers::{quoted, words};
use anyhow::{Context, bail, ensure};
use std::collections::BTreeSet;

/// What stands above the column of other people's figures, or in it.
const BESIDE: &str = "beside";
/// A cell of a model of which nothing is recorded.
const NOTHING: &str = "-";

/// What a marker asks for.
#[derive(Debug)]
pub(super) struct Comparison<'a> {
    /// Stem and title of each column.
    columns: Vec<(&'a str, &'a str)>,
    /// Title of the column of other people's figures, if there is one.
    beside: Option<&'a str>,
    rows: Vec<Row<'a>>,
}

#[derive(Debug)]
struct Row<'a> {
    /// A record's name, with `*` for the stem of the column.
    pattern: &'a str,
    keys: &'a str,
    title: &'a str,
    beside: &'a str,
}

impl<'a> Comparison<'a> {
    /// Of `STEM="TITLE".. beside="TITLE" PATTERN:KEY,KEY="TITLE" beside="TEXT"..`.
    pub(super) fn parse(marker: &'a str) -> anyhow::Result<Comparison<'a>> {
        let mut comparison = Comparison { columns: vec![], beside: None, rows: vec![] };
        for word in words(marker) {
            let Some((name, text)) = quoted(word) else { bail!("{word}: accepted is NAME=\"TEXT\"") };
            match (name, name.split_once(':'), comparison.rows.last_mut()) {
                (BESIDE, _, None) => comparison.beside = Some(text),
                (BESIDE, _, Some(row)) => row.beside = text,
                (_, Some((pattern, keys)), _) => {
                    comparison.rows.push(Row { pattern, keys, title: text, beside: "" });
                }
                (stem, None, None) => comparison.columns.push((stem, text)),
                (_, None, Some(_)) => bail!("{word}: a row is PATTERN:KEY=\"TITLE\""),
            }
        }
        ensure!(!comparison.columns.is_empty() && !comparison.rows.is_empty(), "no column, or no row");
        Ok(comparison)
    }

    /// Names of the records that it shows.
    pub(super) fn names(&self) -> impl Iterator<Item = String> {
        let names = self.rows.iter().flat_map(|row| self.columns.iter().map(|(stem, _)| row.name(stem)));
        names.collect::<BTreeSet<String>>().into_iter()
    }

    /// The table, with the machine below it.
    pub(super) fn render(&self, figures: &[Figure]) -> anyhow::Result<String> {
        let find = |name: &str| figures.iter().find(|figure| figure.record.name == name);
        let (mut head, mut rule) = ("| |".to_owned(), "|---|".to_owned());
        for title in self.columns.iter().map(|(_, title)| title).chain(self.beside.iter()) {
            head += &format!(" {title} |");
            rule += "---:|";
        }
        let mut text = format!("{head}\n{rule}\n");
        let mut machines = BTreeSet::new();
        for row in &self.rows {
            text += &format!("| {} |", row.title);
            let mut is_shown = false;
            for (stem, _) in &self.columns {
                let found = find(&row.name(stem));
                is_shown |= found.is_some();
                machines.extend(found.map(|figure| &figure.record.machine));
                text += &format!(" {} |", found.map_or(NOTHING.to_owned(), |figure| row.cell(figure)));
            }
            ensure!(is_shown, "{}: no record of any column", row.pattern);
            text += &if self.beside.is_some() { format!(" {} |\n", row.beside) } else { "\n".to_owned() };
        }
        ensure!(machines.len() == 1, "figures of {} machines in one table", machines.len());
        let machine = machines.first().context("no figure")?;
        Ok(text + &format!("\n{}.\n", machine.summary()))
    }
}

impl Row<'_> {
    fn name(&self, stem: &str) -> String {
        self.pattern.replace('*', stem)
    }

    /// The values of the keys; one unit for all where it is the same.
    fn cell(&self, figure: &Figure) -> String {
        let texts: Vec<String> = self.keys.split(',').map(|key| figure.text(key)).collect();
        figure::with_common_unit(&texts)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_marker_is_columns_and_rows() {
        let comparison = Comparison::parse(
            "a=\"Model A\" b=\"Model B\" beside=\"Peer\"\n x-*-y:k.p50,k.p99=\"It takes\" beside=\"1 ms\" \
             z-*:l=\"Size\" ",
        );
        let comparison = comparison.unwrap();
        assert_eq!(comparison.columns, [("a", "Model A"), ("b", "Model B")]);
        assert_eq!(comparison.names().collect::<Vec<_>>(), ["x-a-y", "x-b-y", "z-a", "z-b"]);
        let rows: Vec<_> = comparison.rows.iter().map(|row| (row.keys, row.title, row.beside)).collect();
        assert_eq!(rows, [("k.p50,k.p99", "It takes", "1 ms"), ("l", "Size", "")]);
        for (wrong, why) in [("a=b", "accepted is"), ("a=\"A\"", "no row"), ("x:y=\"Z\" a=\"A\"", "a row is")]
        {
            let error = Comparison::parse(wrong).unwrap_err().to_string();
            assert!(error.contains(why), "{wrong}: {error}");
        }
    }
}
