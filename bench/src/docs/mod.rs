//! Writes the figures of `docs/*.md` from the records.
//!
//! A page is written by hand; what stands between two markers is replaced:
//!
//! ```text
//! <!-- record:PATTERN KEY KEY="NAME".. -->       a table: a row per record name, a column per key
//! <!-- end -->
//! <!-- plot:FILE PATTERN,PATTERN x=KEY y=KEY --> a plot in docs/plots/FILE.svg: a line per pattern
//! <!-- plot:FILE PATTERN x=STEM.* y=KEY -->      the same, of what each figure tells as STEM.X.KEY: a line per figure
//! <!-- end -->
//! <!-- keys -->                                  the renderer's table of a picture's keys: a row per key
//! <!-- end -->
//! ```
//!
//! A pattern is a record's name; a `*` at its end stands for anything. Runs of one name that agree in command,
//! machine and commit are one figure, their median; of several such groups the latest counts.
//!
//! Invariants: 1. the same records and pages give the same bytes; 2. running twice changes nothing; 3. a marker
//! that cannot be understood is an error with path and line, never passed over.

mod figure;
mod keys;
mod table;

use crate::plot::{self, Line};
use crate::record;
use anyhow::{Context, bail, ensure};
use figure::Figure;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use table::Column;

const TABLE: &str = "<!-- record:";
const PLOT: &str = "<!-- plot:";
const KEYS: &str = "<!-- keys -->";
const CLOSE: &str = " -->";
const END: &str = "<!-- end -->";
/// Stands where figures will stand.
const EMPTY: &str = "*No record yet.*\n";

/// Every generated file below `root` with its content: pages that hold markers, and plots.
///
/// # Errors
/// A page or a record cannot be read or understood.
pub fn render(root: &Path) -> anyhow::Result<BTreeMap<PathBuf, String>> {
    let figures = figure::group(record::read_all(root)?);
    let folder = root.join("docs");
    let mut files = BTreeMap::new();
    for entry in fs::read_dir(&folder).with_context(|| format!("cannot read {}", folder.display()))? {
        let path = entry?.path();
        if path.extension().is_none_or(|extension| extension != "md") {
            continue;
        }
        let text = fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))?;
        let mut page = Page { figures: &figures, plots: BTreeMap::new() };
        let text = page.fill(&text).with_context(|| path.display().to_string())?;
        files.insert(path, text);
        files.extend(page.plots.into_iter().map(|(name, svg)| (plot_path(&folder, &name), svg)));
    }
    Ok(files)
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

/// One page under way.
struct Page<'a> {
    figures: &'a [Figure],
    plots: BTreeMap<String, String>,
}

impl Page<'_> {
    /// The page with everything between its markers replaced.
    fn fill(&mut self, text: &str) -> anyhow::Result<String> {
        let mut filled = String::with_capacity(text.len());
        let mut lines = text.lines().enumerate();
        while let Some((index, line)) = lines.next() {
            filled.push_str(line);
            filled.push('\n');
            let Some(block) = self.block(line).with_context(|| format!("line {}", index + 1))? else {
                continue;
            };
            ensure!(lines.any(|(_, line)| line == END), "line {}: {END} is missing", index + 1);
            filled.push('\n');
            filled.push_str(&block);
            filled.push('\n');
            filled.push_str(END);
            filled.push('\n');
        }
        Ok(filled)
    }

    /// What stands below `line`, when that is a marker.
    fn block(&mut self, line: &str) -> anyhow::Result<Option<String>> {
        if line == KEYS {
            return Ok(Some(keys::render()));
        }
        let inside = |prefix: &str| line.strip_prefix(prefix).map(|rest| rest.strip_suffix(CLOSE));
        match (inside(TABLE), inside(PLOT)) {
            (Some(Some(marker)), _) => self.table(marker).map(Some),
            (_, Some(Some(marker))) => self.plot(marker).map(Some),
            (None, None) => Ok(None),
            _ => bail!("the marker does not end in {CLOSE:?}"),
        }
    }

    fn table(&self, marker: &str) -> anyhow::Result<String> {
        let mut words = words(marker).into_iter();
        let pattern = words.next().context("the marker names no record")?;
        let column =
            |word| Column::parse(word).with_context(|| format!("{word}: accepted is KEY or KEY=\"NAME\""));
        let columns = words.map(column).collect::<anyhow::Result<Vec<_>>>()?;
        ensure!(!columns.is_empty(), "the marker names no key");
        let rows = select(self.figures, pattern);
        let stem = pattern.strip_suffix('*').unwrap_or_default();
        Ok(if rows.is_empty() { EMPTY.to_owned() } else { table::render(&rows, &columns, stem) })
    }

    fn plot(&mut self, marker: &str) -> anyhow::Result<String> {
        let [name, patterns, x, y] = words(marker)[..] else {
            bail!("accepted is plot:FILE PATTERN,.. x=KEY y=KEY")
        };
        let axes = x.strip_prefix("x=").zip(y.strip_prefix("y="));
        let axes = axes.and_then(|(x, y)| Column::parse(x).zip(Column::parse(y)));
        let (x, y) = axes.context("axes are x=KEY y=KEY, each with =\"NAME\" or not")?;
        let lines: Vec<Line> = patterns
            .split(',')
            .flat_map(|pattern| {
                let figures = select(self.figures, pattern);
                match x.key.strip_suffix(".*") {
                    Some(stem) => figures.iter().map(|figure| figure.line(stem, y.key)).collect(),
                    None => vec![figure::line_of(pattern, &figures, x.key, y.key)],
                }
            })
            .filter(|line| !line.points.is_empty())
            .collect();
        if lines.is_empty() {
            return Ok(EMPTY.to_owned());
        }
        let (x, y) = (x.title(), y.title());
        let svg = plot::render(&lines, &x, &y).with_context(|| format!("plot {name}"))?;
        self.plots.insert(name.to_owned(), svg);
        Ok(format!("![{y} over {x}](plots/{name}.svg)\n"))
    }
}

/// What blanks part, those between quotes aside.
fn words(marker: &str) -> Vec<&str> {
    let mut is_quoted = false;
    let is_gap = |letter: char| {
        is_quoted ^= letter == '"';
        letter.is_whitespace() && !is_quoted
    };
    marker.split(is_gap).filter(|word| !word.is_empty()).collect()
}

/// The figures whose name fits, in order of name.
fn select<'a>(figures: &'a [Figure], pattern: &str) -> Vec<&'a Figure> {
    let fits = |name: &str| match pattern.strip_suffix('*') {
        Some(stem) => name.starts_with(stem),
        None => name == pattern,
    };
    figures.iter().filter(|figure| fits(&figure.record.name)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::machine::Machine;
    use crate::record::Record;
    use serde_json::json;

    fn record(name: &str, count: u64, speed: f64) -> Record {
        let machine = Machine {
            cpu: "Test CPU".into(),
            core_count: 2,
            memory_bytes: 4 << 30,
            kernel: "Linux 6".into(),
        };
        Record {
            name: name.into(),
            command: format!("trex build gen:soup:{count} -o a.trex"),
            scene: String::new(),
            seed: Some(1),
            machine,
            commit: "abc".into(),
            date: "2026-01-01".into(),
            result_hash: Some("00ff".into()),
            values: [("triangle_count", json!(count)), ("triangles_per_s", json!(speed))]
                .map(|(key, value)| (key.to_owned(), value))
                .into(),
        }
    }

    /// A checkout with one page and some records.
    fn checkout(page: &str, records: &[Record]) -> tempfile::TempDir {
        let root = tempfile::tempdir().unwrap();
        fs::create_dir_all(root.path().join("docs")).unwrap();
        fs::create_dir_all(record::folder(root.path())).unwrap();
        fs::write(root.path().join("docs/page.md"), page).unwrap();
        records.iter().for_each(|record| drop(record::append(root.path(), record).unwrap()));
        root
    }

    const PAGE: &str = "# Speed\n\n<!-- record:build-* triangle_count triangles_per_s=\"Speed of it\" -->\nold\n<!-- end -->\n\
        text\n<!-- plot:speed build-* x=triangle_count y=triangles_per_s -->\n<!-- end -->\nlast\n";

    #[test]
    fn tables_and_plots_stand_between_their_markers() {
        let runs =
            [record("build-a", 10_000, 1e6), record("build-a", 10_000, 3e6), record("build-b", 20_000, 2e6)];
        let root = checkout(PAGE, &runs);
        let changed = write(root.path()).unwrap();
        assert_eq!(changed.len(), 2);
        let page = fs::read_to_string(root.path().join("docs/page.md")).unwrap();
        assert!(page.starts_with("# Speed\n") && page.ends_with("<!-- end -->\nlast\n"), "{page}");
        assert!(!page.contains("old"), "{page}");
        assert!(page.contains("| | triangles | Speed of it | runs |\n"), "{page}");
        assert!(page.contains("| a | 10.0 k | 2.00 M/s | 2 |\n"), "{page}");
        assert!(page.contains("</summary>\n\n- `build-a`: `trex build"), "{page}");
        assert!(page.contains("Test CPU, 2 cores, 4.0 GiB, Linux 6"), "{page}");
        assert!(page.contains("](plots/speed.svg)"), "{page}");
        let svg = fs::read_to_string(root.path().join("docs/plots/speed.svg")).unwrap();
        assert!(svg.starts_with("<svg") && svg.contains("triangles per s"), "{svg}");
    }

    #[test]
    fn what_a_figure_tells_at_several_places_is_a_line() {
        let page = "<!-- plot:error err-* x=error_at_ms.* y=median -->\n<!-- end -->\n";
        let mut one = record("err-a", 1, 1.0);
        for (key, value) in [("33.median", 3.0), ("100.median", 2.0), ("100.max", 9.0), ("x.median", 7.0)] {
            one.values.insert(format!("error_at_ms.{key}"), json!(value));
        }
        let figures = figure::group(vec![one.clone()]);
        let line = figures[0].line("error_at_ms", "median");
        assert_eq!(line.points, [(33.0, 3.0), (100.0, 2.0)]);
        let root = checkout(page, &[one]);
        write(root.path()).unwrap();
        let page = fs::read_to_string(root.path().join("docs/page.md")).unwrap();
        assert!(page.contains("![median over error at](plots/error.svg)"), "{page}");
    }

    #[test]
    fn a_second_run_changes_nothing() {
        let root = checkout(PAGE, &[record("build-a", 10_000, 1e6)]);
        write(root.path()).unwrap();
        assert_eq!(stale(root.path()).unwrap(), Vec::<PathBuf>::new());
        fs::remove_file(root.path().join("docs/plots/speed.svg")).unwrap();
        assert_eq!(stale(root.path()).unwrap(), [root.path().join("docs/plots/speed.svg")]);
    }

    #[test]
    fn no_record_is_said() {
        let root = checkout(PAGE, &[]);
        write(root.path()).unwrap();
        let page = fs::read_to_string(root.path().join("docs/page.md")).unwrap();
        assert_eq!(page.matches(EMPTY.trim_end()).count(), 2);
    }

    #[test]
    fn bad_markers_are_named_with_their_line() {
        for (page, why) in [
            ("\n<!-- record:a b -->\n", "line 2: <!-- end --> is missing"),
            ("<!-- record:a -->\n<!-- end -->\n", "names no key"),
            ("<!-- record:a b=c -->\n<!-- end -->\n", "accepted is KEY"),
            ("<!-- record:a b\n<!-- end -->\n", "does not end in"),
            ("<!-- plot:a b x=c -->\n<!-- end -->\n", "accepted is"),
            ("<!-- plot:a b c d -->\n<!-- end -->\n", "axes are"),
        ] {
            let root = checkout(page, &[]);
            let error = format!("{:#}", render(root.path()).unwrap_err());
            assert!(error.contains(why) && error.contains("page.md"), "{error}");
        }
    }
}
