//! A table of figures in Markdown: a row per record.

use super::figure::Figure;
use super::markers::quoted;
use super::names::{label, title};
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

fn push(text: &mut String, part: std::fmt::Arguments<'_>) {
    text.write_fmt(part).expect("a string takes what is written to it");
}

#[cfg(test)]
mod tests {
    use super::*;

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
