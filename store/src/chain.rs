//! `Chain`: several sources, one after the other, as one model.
//!
//! Invariant: a source's materials follow those of the sources before it, whose lists are complete when its own
//! stream begins.

use crate::attributes::AttributeSet;
use crate::budget::{Budget, Lease};
use crate::error::{Code, Error, Result};
use crate::geom::{Aabb, Lattice};
use crate::layout::MATERIALS;
use crate::material_list::MaterialList;
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};

/// What the list of all materials is called in messages.
const MATERIALS_LEASED: &str = "the materials of all inputs";

/// Sources in a row. Build one with [`Chain::from_sources`].
pub struct Chain {
    sources: Vec<Box<dyn TriangleSource>>,
    at: usize,
    materials: MaterialList,
    /// Materials of the sources before `at`.
    first_material: u32,
    /// Of the list of all materials.
    lease: Lease,
}

impl Chain {
    /// The sources as one; a single one is returned as it is. The list of all materials is leased from `budget`.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`].
    ///
    /// # Panics
    /// When there is none.
    pub fn from_sources(
        mut sources: Vec<Box<dyn TriangleSource>>,
        budget: &Budget,
    ) -> Result<Box<dyn TriangleSource>> {
        assert!(!sources.is_empty(), "a model has at least one source");
        if sources.len() == 1 {
            return Ok(sources.remove(0));
        }
        let (materials, lease) = (sources[0].materials().clone(), budget.lease(MATERIALS_LEASED, 0)?);
        Ok(Box::new(Chain { sources, at: 0, materials, first_material: 0, lease }))
    }

    /// Makes the list of all materials, once all are known.
    fn join_materials(&mut self) -> Result<()> {
        let lists = || self.sources.iter().map(|source| source.materials());
        let count: usize = lists().map(|list| list.len()).sum();
        if count > MATERIALS {
            return Err(Error::new(Code::InputRange, "the inputs name too many materials")
                .at_place(self.name())
                .numbers(format!("{count}, and {MATERIALS} at most"))
                .next("build with fewer inputs, or export them with fewer materials"));
        }
        let text_bytes: usize = lists().map(|list| list.names().text_bytes()).sum();
        let bytes = MaterialList::bytes(count as u64, text_bytes as u64);
        self.lease.grow(MATERIALS_LEASED, bytes.saturating_sub(self.lease.bytes()))?;
        let mut all = MaterialList::with_capacity(count, text_bytes);
        lists().for_each(|list| all.extend(list));
        self.materials = all;
        Ok(())
    }
}

impl TriangleSource for Chain {
    fn name(&self) -> String {
        format!("{} and {} more", self.sources[0].name(), self.sources.len() - 1)
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        while let Some(source) = self.sources.get_mut(self.at) {
            if source.next_batch(batch)? {
                batch.material.iter_mut().for_each(|material| *material += self.first_material);
                return Ok(true);
            }
            self.first_material += source.materials().len() as u32;
            self.at += 1;
        }
        batch.clear();
        if self.materials.len() != self.first_material as usize {
            self.join_materials()?;
        }
        Ok(false)
    }

    fn rewind(&mut self) -> Result<()> {
        (self.at, self.first_material) = (0, 0);
        self.sources.iter_mut().try_for_each(|source| source.rewind())
    }

    fn hint(&self) -> Option<ScanHint> {
        let mut all = ScanHint {
            bounds: Aabb::EMPTY,
            median_edge: f64::INFINITY,
            triangle_count: 0,
            attributes: AttributeSet::default(),
        };
        for source in &self.sources {
            let hint = source.hint()?;
            all.bounds.join(&hint.bounds);
            all.median_edge = all.median_edge.min(hint.median_edge);
            all.triangle_count += hint.triangle_count;
            all.attributes = all.attributes.union(hint.attributes);
        }
        Some(all)
    }

    /// Of the source that the last batch is of: who relies on it asks with every batch.
    fn lattice(&self) -> Option<Lattice> {
        self.sources.get(self.at).and_then(|source| source.lattice())
    }

    fn materials(&self) -> &MaterialList {
        &self.materials
    }

    fn stats(&self) -> SourceStats {
        let mut all = SourceStats::default();
        for stats in self.sources.iter().map(|source| source.stats()) {
            all.bytes_read += stats.bytes_read;
            all.bytes_total += stats.bytes_total;
            all.triangle_count += stats.triangle_count;
            all.polygon_count += stats.polygon_count;
            all.skipped_face_count += stats.skipped_face_count;
            all.dropped_attribute_count += stats.dropped_attribute_count;
            all.vertex_count += stats.vertex_count;
            all.vertex_lookups += stats.vertex_lookups;
            all.vertex_cache_misses += stats.vertex_cache_misses;
            all.transparent_material_count += stats.transparent_material_count;
            all.material_name_bytes += stats.material_name_bytes;
            all.instanced_mesh_count += stats.instanced_mesh_count;
            all.instance_count += stats.instance_count;
            all.slab_count += stats.slab_count;
            all.slab_bytes += stats.slab_bytes;
            all.scene.join(stats.scene);
            all.warnings.extend(stats.warnings);
            all.named_files.extend(stats.named_files);
        }
        all
    }
}
