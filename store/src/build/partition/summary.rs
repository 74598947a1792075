//! `PartitionSummary`: all that a partition finds of a model but its chunks, and the form in which records hold it.
//!
//! Invariant: it follows from the input and the options alone, not from who sorts which of the triangles.

use super::cells::is_on_lattice;
use super::collapsed::CollapsedSizes;
use crate::build::scan::Grid;
use crate::geom::{Aabb, Lattice};
use crate::layout::{SECTIONS, Section, Superblock, node_shift};
use crate::octree::{Refinement, is_upper};
use serde::{Deserialize, Serialize};

/// One in so many triangles with area may be lost without a word on which lattice would keep it.
const LOST_SHARE: u64 = 10_000;

/// What is known of a model whose triangles are in cells.
#[derive(Clone, Debug)]
pub(crate) struct PartitionSummary {
    pub(crate) grid: Grid,
    pub(crate) input_triangle_count: u64,
    pub(crate) triangle_count: u64,
    pub(crate) rejected_degenerate: u64,
    /// Those of them that had area.
    pub(crate) collapsed: CollapsedSizes,
    pub(crate) rejected_non_finite: u64,
    pub(crate) error_bound: f64,
    /// Box of the triangles on the lattice: least corner, greatest corner.
    pub(crate) lattice_bounds: [[i64; 3]; 2],
    /// At most the median edge length, model units.
    pub(crate) median_edge: f64,
    /// Leaves of the resident octree along an axis, and how much finer the finest are; `None` for no octree.
    pub(crate) octree: Option<(u32, Refinement)>,
    pub(crate) content_hash: u64,
}

/// A summary as records hold it. Numbers that are not whole stand by their bits.
#[derive(Clone, Serialize, Deserialize)]
pub(crate) struct StoredSummary {
    origin: [u64; 3],
    exponent: i32,
    bits: u32,
    input_triangle_count: u64,
    triangle_count: u64,
    rejected_degenerate: u64,
    collapsed: CollapsedSizes,
    rejected_non_finite: u64,
    error_bound: u64,
    median_edge: u64,
    lattice_bounds: [[i64; 3]; 2],
    /// Leaves of the resident octree, and how much finer the finest are.
    octree: Option<(u32, u32)>,
    content_hash: u64,
}

impl PartitionSummary {
    /// The greatest error bound, model units, at which at most one in [`LOST_SHARE`] triangles with area is lost;
    /// `None` where no more are, and where no lattice keeps them.
    pub(crate) fn keeping_error(&self) -> Option<f64> {
        let flat = self.rejected_degenerate.saturating_sub(self.collapsed.count());
        let with_area = self.input_triangle_count.saturating_sub(flat + self.rejected_non_finite);
        let halvings = self.collapsed.halvings(with_area / LOST_SHARE).filter(|&halvings| halvings > 0)?;
        let is_held = self.grid.bits + halvings < Lattice::MAX_BITS;
        is_held.then(|| self.grid.lattice.step() / 2.0 * 0.5f64.powi(halvings as i32))
    }

    /// The superblock of a file in which nothing is yet.
    pub(crate) fn superblock(&self) -> Superblock {
        Superblock {
            file_bytes: 0,
            file_id: 0,
            lattice: self.grid.lattice,
            lattice_bits: self.grid.bits,
            node_shift: node_shift(self.grid.bits),
            error_bound: self.error_bound,
            bounds: Aabb { lo: [0.0; 3], hi: [0.0; 3] },
            lattice_bounds: [[i64::MAX; 3], [i64::MIN; 3]],
            median_edge: self.median_edge,
            input_triangle_count: self.input_triangle_count,
            triangle_count: 0,
            vertex_count: 0,
            cluster_count: 0,
            wide_cluster_count: 0,
            rejected_degenerate: self.rejected_degenerate,
            rejected_collapsed: self.collapsed.count(),
            rejected_non_finite: self.rejected_non_finite,
            resident_bytes: 0,
            page_tree_bytes: 0,
            colour_page_count: 0,
            normal_page_count: 0,
            root: 0,
            sections: [Section::default(); SECTIONS],
        }
    }

    /// As records hold it.
    pub(crate) fn stored(&self) -> StoredSummary {
        StoredSummary {
            origin: self.grid.lattice.origin.map(f64::to_bits),
            exponent: self.grid.lattice.exponent,
            bits: self.grid.bits,
            input_triangle_count: self.input_triangle_count,
            triangle_count: self.triangle_count,
            rejected_degenerate: self.rejected_degenerate,
            collapsed: self.collapsed,
            rejected_non_finite: self.rejected_non_finite,
            error_bound: self.error_bound.to_bits(),
            median_edge: self.median_edge.to_bits(),
            lattice_bounds: self.lattice_bounds,
            octree: self.octree.map(|(resolution, refinement)| (resolution, refinement.factor())),
            content_hash: self.content_hash,
        }
    }

    /// Whether its numbers can be true together.
    fn is_sound(&self) -> bool {
        let PartitionSummary { lattice_bounds, grid, triangle_count, .. } = self;
        let block = Superblock {
            triangle_count: *triangle_count,
            lattice_bounds: *lattice_bounds,
            ..self.superblock()
        };
        block.has_sound_numbers()
            && is_on_lattice(lattice_bounds, grid.bits)
            && (0..3).all(|axis| lattice_bounds[0][axis] <= lattice_bounds[1][axis])
    }
}

impl StoredSummary {
    /// The summary; `None` for numbers that cannot be true together.
    pub(crate) fn summary(&self) -> Option<PartitionSummary> {
        let octree = self.octree.map(|(resolution, factor)| {
            Some((resolution, Refinement::from_factor(factor)?)).filter(|_| is_upper(resolution))
        });
        let lattice = Lattice { origin: self.origin.map(f64::from_bits), exponent: self.exponent };
        let summary = PartitionSummary {
            grid: Grid { lattice, bits: self.bits },
            input_triangle_count: self.input_triangle_count,
            triangle_count: self.triangle_count,
            rejected_degenerate: self.rejected_degenerate,
            collapsed: self.collapsed,
            rejected_non_finite: self.rejected_non_finite,
            error_bound: f64::from_bits(self.error_bound),
            lattice_bounds: self.lattice_bounds,
            median_edge: f64::from_bits(self.median_edge),
            octree: octree.flatten(),
            content_hash: self.content_hash,
        };
        (octree != Some(None) && summary.is_sound()).then_some(summary)
    }
}
