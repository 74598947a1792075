//! `StlTextSource`: ascii STL.
//!
//! ```text
//! solid NAME
//!   facet normal i j k  outer loop  vertex x y z (3 or more)  endloop  endfacet
//! endsolid NAME                                                     any number of solids; names may be missing
//! ```
//!
//! Invariants: 1. keywords count in any case and with any white space between them, only names end with their line;
//! 2. a file that ends inside of a solid is truncated, even between two facets.

use super::ImportOptions;
use super::input::Input;
use super::polygon::{FaceCorner, MAX_POLYGON_SIDES, Polygon};
use super::text::{Mark, Text, printable};
use crate::error::{Error, Result};
use crate::material::Material;
use crate::material_list::MaterialList;
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};

/// Triangles of an ascii STL file.
pub(super) struct StlTextSource {
    text: Text,
    start: Mark,
    inside: Inside,
    polygon: Polygon,
    materials: MaterialList,
    stats: SourceStats,
}

/// What has been opened and not closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Inside {
    Nothing,
    Solid,
    Facet,
    Loop,
}

impl StlTextSource {
    /// Reads from where `input` stands.
    pub(super) fn new(input: Input, options: &ImportOptions) -> Result<StlTextSource> {
        let text = Text::new(input, 1);
        Ok(StlTextSource {
            start: text.mark(),
            inside: Inside::Nothing,
            polygon: Polygon::new(&options.budget)?,
            materials: MaterialList::from(Material::default()),
            stats: SourceStats { bytes_total: text.input().length(), ..SourceStats::default() },
            text,
        })
    }

    /// One keyword with what belongs to it.
    fn statement(&mut self, batch: &mut TriangleBatch) -> Result<()> {
        let Some(word) = self.text.word()? else { return Ok(()) };
        let shown = printable(word);
        let mut keyword = [0; 8];
        let length = word.len().min(8);
        keyword[..length].copy_from_slice(&word[..length]);
        keyword.make_ascii_lowercase();
        self.inside = match (self.inside, &keyword[..length]) {
            (Inside::Nothing, b"solid") => self.text.skip_line().map(|_| Inside::Solid)?,
            (Inside::Solid, b"endsolid") => self.text.skip_line().map(|_| Inside::Nothing)?,
            (Inside::Solid, b"facet") => {
                self.expect("normal")?;
                // Not parsed: exporters write `nan` in many ways here, and the corners say all that matters.
                (0..3).try_for_each(|_| self.any_word())?;
                Inside::Facet
            }
            (Inside::Facet, b"outer") => {
                self.expect("loop")?;
                self.polygon.clear();
                Inside::Loop
            }
            (Inside::Loop, b"vertex") => {
                if self.polygon.len() == MAX_POLYGON_SIDES {
                    let numbers = format!("more than {MAX_POLYGON_SIDES}");
                    return Err(self.text.out_of_range("a facet has too many corners", numbers));
                }
                let position = [self.text.number()?, self.text.number()?, self.text.number()?];
                self.polygon.push(FaceCorner { position, ..FaceCorner::default() });
                Inside::Loop
            }
            (Inside::Loop, b"endloop") => {
                self.polygon.emit(0, batch, &mut self.stats);
                Inside::Facet
            }
            (Inside::Facet, b"endfacet") => Inside::Solid,
            (inside, _) => return Err(self.unexpected(inside.expects(), &shown)),
        };
        Ok(())
    }

    fn expect(&mut self, keyword: &str) -> Result<()> {
        let found = if self.text.next_row()? { self.text.word()?.unwrap_or_default() } else { b"" };
        if found.eq_ignore_ascii_case(keyword.as_bytes()) {
            return Ok(());
        }
        let found = printable(found);
        Err(if found.is_empty() { self.text.truncated(keyword) } else { self.unexpected(keyword, &found) })
    }

    fn any_word(&mut self) -> Result<()> {
        if self.text.word()?.is_none() {
            Err(self.text.wrong("the normal of a facet has three numbers"))
        } else {
            Ok(())
        }
    }

    fn unexpected(&self, expected: &str, found: &str) -> Error {
        self.text
            .wrong("a word that does not belong here")
            .numbers(format!("expected {expected}, found `{found}`"))
    }
}

impl Inside {
    /// The keywords that may come next.
    fn expects(self) -> &'static str {
        match self {
            Inside::Nothing => "solid",
            Inside::Solid => "facet or endsolid",
            Inside::Facet => "outer loop or endfacet",
            Inside::Loop => "vertex or endloop",
        }
    }
}

impl TriangleSource for StlTextSource {
    fn name(&self) -> String {
        self.text.input().path().display().to_string()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        batch.clear();
        while batch.len() < TriangleBatch::TARGET_TRIANGLES {
            if self.text.next_row()? {
                self.statement(batch)?;
            } else if self.inside == Inside::Nothing {
                break;
            } else {
                return Err(self.text.truncated(self.inside.expects()));
            }
        }
        self.stats.triangle_count += batch.len() as u64;
        Ok(!batch.is_empty())
    }

    fn rewind(&mut self) -> Result<()> {
        self.text.seek(self.start);
        self.inside = Inside::Nothing;
        self.stats = SourceStats { bytes_total: self.stats.bytes_total, ..SourceStats::default() };
        Ok(())
    }

    fn hint(&self) -> Option<ScanHint> {
        None
    }

    fn materials(&self) -> &MaterialList {
        &self.materials
    }

    fn stats(&self) -> SourceStats {
        SourceStats { bytes_read: self.text.input().offset(), ..self.stats.clone() }
    }
}
