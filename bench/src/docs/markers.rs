//! Markers in a page: where they begin and end, and the words inside.

use anyhow::{Context, bail};

/// Closes a marker.
pub(super) const CLOSE: &str = "-->";
/// Closes what a marker of a block shows.
pub(super) const END: &str = "<!-- end -->";
/// Opens a figure in a line.
const FIGURE: &str = "<!-- figure:";
/// Closes it.
const FIGURE_END: &str = "<!-- -->";

/// The kinds of blocks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BlockKind {
    /// A row per record.
    Table,
    /// A row per pattern.
    Comparison,
    /// A plot.
    Plot,
    /// How to get records again.
    Commands,
    /// The renderer's table of a picture's keys.
    Keys,
}

impl BlockKind {
    /// The kind of the block whose marker begins with `line`.
    pub(super) fn of(line: &str) -> Option<(BlockKind, &str)> {
        let kinds = [
            ("<!-- record:", BlockKind::Table),
            ("<!-- compare:", BlockKind::Comparison),
            ("<!-- plot:", BlockKind::Plot),
            ("<!-- commands:", BlockKind::Commands),
            ("<!-- keys", BlockKind::Keys),
        ];
        kinds.into_iter().find_map(|(prefix, kind)| Some((kind, line.strip_prefix(prefix)?)))
    }
}

/// A line with each figure in it replaced by what `value` gives for the words of its marker.
pub(super) fn fill_line(
    line: &str,
    mut value: impl FnMut(&[&str]) -> anyhow::Result<String>,
) -> anyhow::Result<String> {
    let (mut filled, mut rest) = (String::new(), line);
    while let Some((before, marker)) = rest.split_once(FIGURE) {
        let (inside, behind) = marker.split_once(CLOSE).context("the marker of a figure is not closed")?;
        let Some((_, after)) = behind.split_once(FIGURE_END) else {
            bail!("{FIGURE_END} is missing behind a figure")
        };
        let text = value(&words(inside))?;
        filled += &format!("{before}{FIGURE}{inside}{CLOSE}{text}{FIGURE_END}");
        rest = after;
    }
    Ok(filled + rest)
}

/// What blanks part, those between quotes aside.
pub(super) fn words(marker: &str) -> Vec<&str> {
    let mut is_quoted = false;
    let is_gap = |letter: char| {
        is_quoted ^= letter == '"';
        letter.is_whitespace() && !is_quoted
    };
    marker.split(is_gap).filter(|word| !word.is_empty()).collect()
}

/// `NAME="TEXT"` as its two parts; `None` for anything else.
pub(super) fn quoted(word: &str) -> Option<(&str, &str)> {
    let (name, text) = word.split_once("=\"")?;
    let text = text.strip_suffix('"').filter(|text| !text.is_empty() && !text.contains('"'))?;
    Some((name, text))
}
