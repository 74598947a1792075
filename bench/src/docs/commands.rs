//! How to get records again, folded: a list a campaign, which is what one machine measured of one commit.

use super::figure::Figure;
use crate::machine::Machine;
use std::collections::BTreeMap;
use std::fmt::Write;

/// A folded block: per machine, commit and date a head line, then `- name: command; scene; seed; hash` a record.
pub(super) fn render(rows: &[&Figure]) -> String {
    let mut campaigns: BTreeMap<(&str, &str, &Machine), Vec<&Figure>> = BTreeMap::new();
    for row in rows {
        let record = &row.record;
        campaigns.entry((&record.date, &record.commit, &record.machine)).or_default().push(row);
    }
    let mut text = String::from("<details><summary>Commands</summary>\n");
    for ((date, commit, machine), rows) in campaigns {
        push(&mut text, format_args!("\nCommit {commit}, {date}; {}:\n\n", machine.summary()));
        rows.iter().for_each(|row| push_command(&mut text, row));
    }
    text + "\n</details>\n"
}

fn push_command(text: &mut String, row: &Figure) {
    let record = &row.record;
    push(text, format_args!("- `{}`: `{}`", record.name, record.command));
    if !record.scene.is_empty() && !record.command.contains(&record.scene) {
        push(text, format_args!("; {}", record.scene));
    }
    if let Some(seed) = record.seed {
        push(text, format_args!("; seed {seed}"));
    }
    if let Some(hash) = &record.result_hash {
        push(text, format_args!("; result {hash}"));
    }
    if row.run_count > 1 {
        push(text, format_args!("; median of {} runs", row.run_count));
    }
    text.push('\n');
}

fn push(text: &mut String, part: std::fmt::Arguments<'_>) {
    text.write_fmt(part).expect("a string takes what is written to it");
}
