//! A table of figures in Markdown: a row per record.

use super::figure::{Figure, title};
use super::markers::quoted;
use crate::machine::Machine;
use std::collections::BTreeMap;
use std::fmt::Write;

/// A key, and what a page calls it.
pub(super) struct Column<'a> {
    pub(super) key: &'a str,
    name: Option<&'a str>,
}

impl<'a> Column<'a> {
    /// `KEY`, or `KEY="NAME"`; `None` for anything else.
    pub(super) fn parse(word: &'a str) -> Option<Column<'a>> {
        match quoted(word) {
            Some((key, name)) => Some(Column { key, name: Some(name) }),
            None => (!word.contains(['=', '"'])).then_some(Column { key: word, name: None }),
        }
    }

    /// What stands above it, or beside an axis.
    pub(super) fn title(&self) -> String {
        self.name.map_or_else(|| title(self.key.trim_end_matches(".*")), str::to_owned)
    }
}

/// A table a machine, its name below: a row per figure, a column per key. Rows are called by what their records' names
/// have after `stem`.
pub(super) fn render(rows: &[&Figure], columns: &[Column<'_>], stem: &str) -> String {
    let mut machines: BTreeMap<&Machine, Vec<&Figure>> = BTreeMap::new();
    for row in rows {
        machines.entry(&row.record.machine).or_default().push(row);
    }
    let tables = machines
        .into_iter()
        .map(|(machine, rows)| format!("{}\n{}.\n", of_one_machine(&rows, columns, stem), machine.summary()));
    tables.collect::<Vec<_>>().join("\n")
}

fn of_one_machine(rows: &[&Figure], columns: &[Column<'_>], stem: &str) -> String {
    let mut text = String::from("| |");
    columns.iter().for_each(|column| push(&mut text, format_args!(" {} |", column.title())));
    text.push_str("\n|---|");
    columns.iter().for_each(|_| text.push_str("---:|"));
    text.push('\n');
    for row in rows {
        let name = &row.record.name;
        push(&mut text, format_args!("| {} |", label(name.strip_prefix(stem).unwrap_or(name))));
        columns.iter().for_each(|column| push(&mut text, format_args!(" {} |", row.text(column.key))));
        text.push('\n');
    }
    text
}

/// A name as people say it: `isosurface-20m` reads `iso-surface 20M`.
pub(super) fn label(name: &str) -> String {
    let word = |word: &str| match word {
        "isosurface" => "iso-surface".to_owned(),
        "pipes" => "plant".to_owned(),
        "kicad" => "CAD".to_owned(),
        "gi" => "GI".to_owned(),
        "lod" => "LOD".to_owned(),
        count if count.strip_suffix('m').is_some_and(|digits| digits.parse::<u32>().is_ok()) => {
            count.to_uppercase()
        }
        other => other.to_owned(),
    };
    name.split('-').filter(|part| !part.is_empty()).map(word).collect::<Vec<_>>().join(" ")
}

fn push(text: &mut String, part: std::fmt::Arguments<'_>) {
    text.write_fmt(part).expect("a string takes what is written to it");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_read_as_people_say_them() {
        for (name, expected) in [
            ("isosurface-20m", "iso-surface 20M"),
            ("kicad-grid-flip", "CAD grid flip"),
            ("pipes-interior-full-gi", "plant interior full GI"),
            ("a", "a"),
            ("-", ""),
        ] {
            assert_eq!(label(name), expected);
        }
    }

    #[test]
    fn columns_are_keys_with_or_without_a_name() {
        let parse = |word| Column::parse(word).map(|column| (column.key, column.title()));
        assert_eq!(parse("a.b_count"), Some(("a.b_count", "a bs".to_owned())));
        assert_eq!(parse("a=\"Time to b\""), Some(("a", "Time to b".to_owned())));
        for wrong in ["a=b", "a=\"\"", "a=\"b", "a\"", "a=\"b\"c\""] {
            assert_eq!(parse(wrong), None, "{wrong}");
        }
    }
}
