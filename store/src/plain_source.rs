//! `PlainSource`: a source whose attributes, or some of them, are dropped on the way.

use crate::attributes::AttributeSet;
use crate::error::Result;
use crate::geom::Lattice;
use crate::material_list::MaterialList;
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};

/// The triangles of a source without `dropped`.
pub struct PlainSource {
    /// Where they come from.
    pub source: Box<dyn TriangleSource>,
    /// What its corners lose.
    pub dropped: AttributeSet,
}

impl PlainSource {
    fn kept(&self, of: AttributeSet) -> AttributeSet {
        AttributeSet {
            colours: of.colours && !self.dropped.colours,
            normals: of.normals && !self.dropped.normals,
        }
    }
}

impl TriangleSource for PlainSource {
    fn name(&self) -> String {
        self.source.name()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        let more = self.source.next_batch(batch);
        batch.attributes.drop_columns(self.dropped);
        more
    }

    fn rewind(&mut self) -> Result<()> {
        self.source.rewind()
    }

    fn hint(&self) -> Option<ScanHint> {
        self.source.hint().map(|hint| ScanHint { attributes: self.kept(hint.attributes), ..hint })
    }

    fn lattice(&self) -> Option<Lattice> {
        self.source.lattice()
    }

    fn attributes(&self) -> AttributeSet {
        self.kept(self.source.attributes())
    }

    fn materials(&self) -> &MaterialList {
        self.source.materials()
    }

    fn stats(&self) -> SourceStats {
        self.source.stats()
    }
}
