//! `InputSizes`: the counts of an input that the memory of a build follows from, and the source that counts them.
//!
//! Invariant: they depend on the input alone, so that a limit which follows from them is the same whatever was tried
//! before.

use crate::attributes::AttributeSet;
use crate::error::Result;
use crate::layout::MATERIALS;
use crate::material::Material;
use crate::material_list::MaterialList;
use crate::progress::Interrupt;
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};
use serde::{Deserialize, Serialize};

/// Counts of an input.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct InputSizes {
    /// Triangles delivered.
    pub triangle_count: u64,
    /// Those of them whose material emits.
    pub emissive_count: u64,
    /// Vertices declared; 0 for formats without an index.
    pub vertex_count: u64,
    /// Materials.
    pub material_count: u64,
    /// Bytes of all their names.
    pub name_bytes: u64,
    /// What corners have beside their places.
    pub attributes: AttributeSet,
}

impl InputSizes {
    /// Counts of `source`, all of which is read, but where it knows its triangles before and none of them emits.
    ///
    /// # Errors
    /// Those of the source; [`Code::Interrupted`](crate::Code::Interrupted).
    pub fn of(source: &mut dyn TriangleSource, interrupt: &Interrupt) -> Result<InputSizes> {
        if let Some(hint) = source.hint().filter(|_| !source.materials().iter().any(Material::emits)) {
            let ScanHint { triangle_count, attributes, .. } = hint;
            return Ok(InputSizes { triangle_count, attributes, ..InputSizes::default() });
        }
        let (mut counted, mut batch) = (CountingSource::new(source), TriangleBatch::default());
        while counted.next_batch(&mut batch)? {
            interrupt.check()?;
        }
        Ok(counted.sizes())
    }
}

/// A source that counts its triangles by material.
pub(super) struct CountingSource<'a> {
    source: &'a mut dyn TriangleSource,
    /// By index of the material.
    triangle_counts: Vec<u64>,
    attributes: AttributeSet,
}

impl<'a> CountingSource<'a> {
    pub(super) fn new(source: &'a mut dyn TriangleSource) -> CountingSource<'a> {
        CountingSource { source, triangle_counts: Vec::new(), attributes: AttributeSet::default() }
    }

    /// What came so far; emissive triangles are known once the stream has ended.
    pub(super) fn sizes(&self) -> InputSizes {
        let stats = self.source.stats();
        let by_material = self.source.materials().iter().zip(&self.triangle_counts);
        InputSizes {
            triangle_count: self.triangle_counts.iter().sum(),
            emissive_count: by_material
                .filter(|(material, _)| material.emits())
                .map(|(_, count)| count)
                .sum(),
            vertex_count: stats.vertex_count,
            material_count: self.source.materials().len() as u64,
            name_bytes: stats.material_name_bytes,
            attributes: self.attributes,
        }
    }
}

impl TriangleSource for CountingSource<'_> {
    fn name(&self) -> String {
        self.source.name()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        let more = self.source.next_batch(batch)?;
        self.attributes = self.attributes.union(batch.attributes.set());
        for &material in &batch.material {
            // One that no file can have is refused where it is stored.
            let index = (material as usize).min(MATERIALS - 1);
            if index >= self.triangle_counts.len() {
                self.triangle_counts.resize(index + 1, 0);
            }
            self.triangle_counts[index] += 1;
        }
        Ok(more)
    }

    fn rewind(&mut self) -> Result<()> {
        self.triangle_counts.clear();
        self.attributes = AttributeSet::default();
        self.source.rewind()
    }

    fn hint(&self) -> Option<ScanHint> {
        self.source.hint()
    }

    fn materials(&self) -> &MaterialList {
        self.source.materials()
    }

    fn stats(&self) -> SourceStats {
        self.source.stats()
    }
}
