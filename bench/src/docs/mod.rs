//! Writes the figures of `README.md` and `docs/*.md` from the records.
//!
//! A page is written by hand; what stands between two markers is replaced. A marker may go over several lines:
//!
//! ```text
//! <!-- figure:NAME KEY -->VALUE<!-- -->               a value in a sentence or in a cell; of several names their range
//! <!-- record:PATTERN [say="TEXT"] KEY KEY="TITLE".. -->        a table: a row per record, a column per key
//! <!-- end -->
//! <!-- compare:STEM="MODEL".. [beside="TITLE"] PATTERN:KEY,KEY="TITLE" [beside="TEXT"].. -->
//! <!-- end -->                                        a table: a row per PATTERN, in which `*` is each column's STEM
//! <!-- plot:FILE PATTERN,PATTERN x=KEY y=KEY -->      docs/plots/FILE.svg: a line per pattern
//! <!-- plot:FILE PATTERN x=STEM.* y=KEY -->           of what each figure has as STEM.X.KEY: a line per figure
//! <!-- end -->
//! <!-- commands:PATTERN,PATTERN -->                   folded: how to get these records again
//! <!-- end -->
//! <!-- keys -->                                  the renderer's table of a picture's keys: a row per key
//! <!-- end -->
//! ```
//!
//! A pattern is a record's name; one `*` in it stands for anything. A key may be a quotient, `KEY/KEY`, or a sum,
//! `KEY+KEY`. Runs of one name that agree in command, machine and commit are one figure, their median; of several such
//! groups the latest counts. `KEY.spread` is the greatest less the least of these runs, over their median. A table, a
//! plot or a list of commands that no record fits is absent, with what `say` has to say of it.
//!
//! Invariants: 1. the same records and pages give the same bytes; 2. running twice changes nothing; 3. a marker
//! that cannot be understood is an error with path and line, never passed over, and so is a figure without a record;
//! 4. no table holds figures of two machines; 5. each record that a page shows has its command on a page.

mod commands;
mod comparison;
mod figure;
mod keys;
mod markers;
mod names;
mod page;
mod table;
#[cfg(test)]
mod tests;

use crate::record;
use anyhow::{Context, ensure};
use page::Page;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The page of the root that has figures, too.
const README: &str = "README.md";

/// Every generated file below `root` with its content: pages that hold markers, and plots.
///
/// # Errors
/// A page or a record cannot be read or understood, or a record is shown whose command no page has.
pub fn render(root: &Path) -> anyhow::Result<BTreeMap<PathBuf, String>> {
    let figures = figure::group(record::read_all(root)?);
    let folder = root.join("docs");
    let mut files = BTreeMap::new();
    let (mut shown, mut told) = (BTreeSet::new(), BTreeSet::new());
    for path in pages(root, &folder)? {
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let mut page = Page::new(&figures);
        let text = page.fill(&text).with_context(|| path.display().to_string())?;
        files.insert(path, text);
        files.extend(page.plots.into_iter().map(|(name, svg)| (plot_path(&folder, &name), svg)));
        shown.extend(page.shown);
        told.extend(page.told);
    }
    let untold: Vec<&String> = shown.difference(&told).collect();
    ensure!(
        untold.is_empty(),
        "no page says by <!-- commands:.. --> how to get these records again: {untold:?}"
    );
    Ok(files)
}

/// The README, where there is one, and the pages of `folder`.
fn pages(root: &Path, folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let mut pages: Vec<PathBuf> = [root.join(README)].into_iter().filter(|path| path.exists()).collect();
    for entry in fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))? {
        let path = entry?.path();
        if path.extension().is_some_and(|extension| extension == "md") {
            pages.push(path);
        }
    }
    pages.sort();
    Ok(pages)
}

/// The generated files that are missing or differ from what [`render`] gives.
///
/// # Errors
/// As [`render`].
pub fn stale(root: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let is_stale = |path: &Path, text: &str| fs::read_to_string(path).ok().as_deref() != Some(text);
    let files = render(root)?;
    Ok(files.into_iter().filter(|(path, text)| is_stale(path, text)).map(|(path, _)| path).collect())
}

/// Writes all generated files that are stale; gives their paths.
///
/// # Errors
/// As [`render`], or a file cannot be written.
pub fn write(root: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let stale = stale(root)?;
    let files = render(root)?;
    for path in &stale {
        if let Some(folder) = path.parent() {
            fs::create_dir_all(folder)?;
        }
        fs::write(path, &files[path]).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(stale)
}

fn plot_path(folder: &Path, name: &str) -> PathBuf {
    folder.join("plots").join(format!("{name}.svg"))
}
