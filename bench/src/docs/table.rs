//! A table of figures in Markdown, and below it how to get each again.

use super::figure::{Figure, title};
use std::fmt::Write;

/// A row per figure, a column per key, then the count of runs; then a line per figure with command, seed,
/// machine, commit, date and hash.
pub(super) fn render(rows: &[&Figure], keys: &[&str]) -> String {
    let mut text = String::from("| run |");
    keys.iter().for_each(|key| push(&mut text, format_args!(" {} |", title(key))));
    text.push_str(" runs |\n|---|");
    keys.iter().for_each(|_| text.push_str("---:|"));
    text.push_str("---:|\n");
    for row in rows {
        push(&mut text, format_args!("| `{}` |", row.record.name));
        keys.iter().for_each(|key| push(&mut text, format_args!(" {} |", row.text(key))));
        push(&mut text, format_args!(" {} |\n", row.run_count));
    }
    text.push('\n');
    rows.iter().for_each(|row| provenance(&mut text, row));
    text
}

/// `- name: command; scene; seed; machine; commit, date; hash`.
fn provenance(text: &mut String, row: &Figure) {
    let record = &row.record;
    push(text, format_args!("- `{}`: `{}`", record.name, record.command));
    if !record.scene.is_empty() {
        push(text, format_args!("; {}", record.scene));
    }
    if let Some(seed) = record.seed {
        push(text, format_args!("; seed {seed}"));
    }
    push(text, format_args!("; {}; commit {}, {}", record.machine.summary(), record.commit, record.date));
    if let Some(hash) = &record.result_hash {
        push(text, format_args!("; result {hash}"));
    }
    text.push('\n');
}

fn push(text: &mut String, part: std::fmt::Arguments<'_>) {
    text.write_fmt(part).expect("a string takes what is written to it");
}
