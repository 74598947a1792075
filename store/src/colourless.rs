//! `Colourless`: a source whose colours are dropped on the way.

use crate::error::Result;
use crate::geom::Lattice;
use crate::material_list::MaterialList;
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};

/// The triangles of a source, all of them white.
pub struct Colourless(pub Box<dyn TriangleSource>);

impl TriangleSource for Colourless {
    fn name(&self) -> String {
        self.0.name()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        let more = self.0.next_batch(batch);
        batch.colours.clear();
        more
    }

    fn rewind(&mut self) -> Result<()> {
        self.0.rewind()
    }

    fn hint(&self) -> Option<ScanHint> {
        self.0.hint()
    }

    fn lattice(&self) -> Option<Lattice> {
        self.0.lattice()
    }

    fn materials(&self) -> &MaterialList {
        self.0.materials()
    }

    fn stats(&self) -> SourceStats {
        self.0.stats()
    }
}
