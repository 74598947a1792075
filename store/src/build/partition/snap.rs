//! Snap: from model space to the lattice, with all that is counted on the way.
//!
//! Invariant: what is counted, and the hash of what was read, follow from the stream alone.

use super::cells::CellSink;
use super::collapsed::CollapsedSizes;
use super::colour_means::ColourMeans;
use super::surface::Surface;
use crate::build::scan::{Grid, Scan};
use crate::build::scratch::LatticeTriangle;
use crate::cluster::{Colour, LatticeBox};
use crate::error::{Code, Error, Result};
use crate::layout::{MATERIALS, TRIANGLES};
use crate::source::TriangleBatch;
use xxhash_rust::xxh3::Xxh3;

/// The first triangles of a stream: how many, and their hash.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) struct Prefix {
    pub(crate) triangle_count: u64,
    pub(crate) hash: u64,
}

/// What is known of the triangles that were snapped.
pub(crate) struct SnapSummary {
    pub(crate) rejected_degenerate: u64,
    /// Those of them that had area.
    pub(crate) collapsed: CollapsedSizes,
    pub(crate) rejected_non_finite: u64,
    pub(crate) exact: bool,
    pub(crate) bounds: LatticeBox,
    pub(crate) surface: Surface,
    /// Of the materials of a model with colours.
    pub(crate) means: Option<ColourMeans>,
}

impl SnapSummary {
    /// Of none.
    pub(crate) fn new(scan: &Scan, grid: &Grid) -> SnapSummary {
        SnapSummary {
            rejected_degenerate: 0,
            collapsed: CollapsedSizes::default(),
            rejected_non_finite: 0,
            exact: true,
            bounds: LatticeBox::EMPTY,
            surface: Surface::new(scan, grid),
            means: scan.attributes.colours.then(ColourMeans::new),
        }
    }

    /// Of each material, once; none where the input has no colours.
    pub(crate) fn mean_colours(&self) -> Vec<Colour> {
        self.means.iter().flat_map(ColourMeans::colours).collect()
    }
}

/// From model space to the lattice.
pub(crate) struct Snapper {
    grid: Grid,
    name: String,
    hasher: Xxh3,
    /// Triangles that were read.
    pub(crate) read: u64,
}

impl Snapper {
    /// Before the first triangle of the source of this name.
    pub(crate) fn new(grid: Grid, name: String) -> Snapper {
        Snapper { grid, name, hasher: Xxh3::new(), read: 0 }
    }

    pub(crate) fn grid(&self) -> Grid {
        self.grid
    }

    /// Name of the source.
    pub(crate) fn name(&self) -> &str {
        &self.name
    }

    /// What was read so far.
    pub(crate) fn prefix(&self) -> Prefix {
        Prefix { triangle_count: self.read, hash: self.hasher.digest() }
    }

    /// Counts and hashes what was read.
    pub(crate) fn hash(&mut self, batch: &TriangleBatch) -> Result<()> {
        self.hasher.update(bytemuck::cast_slice(&batch.corners));
        self.hasher.update(bytemuck::cast_slice(&batch.material));
        self.hasher.update(batch.attributes.colours.as_flattened().as_flattened());
        self.hasher.update(bytemuck::cast_slice(&batch.attributes.normals));
        self.read += batch.len() as u64;
        if self.read > TRIANGLES {
            return Err(self.too_many("triangles", TRIANGLES));
        }
        Ok(())
    }

    /// Snaps it, counts all that is known of it, and hands what can be drawn to `cells`.
    pub(crate) fn snap_all(
        &self,
        batch: &TriangleBatch,
        snapped: &mut SnapSummary,
        cells: &mut impl CellSink,
    ) -> Result<()> {
        let lattice = self.grid.lattice;
        for (index, (corners, &material)) in batch.corners.iter().zip(&batch.material).enumerate() {
            let Some(q) = self.snap(corners)? else {
                snapped.rejected_non_finite += 1;
                continue;
            };
            snapped.exact &= !snapped.exact || (0..3).all(|c| lattice.position(q[c]) == corners[c]);
            if is_degenerate(&q) {
                snapped.rejected_degenerate += 1;
                if has_area(corners) {
                    snapped.collapsed.add(corners, lattice.step());
                }
                continue;
            }
            let material = self.stored_material(material)?;
            q.iter().for_each(|&q| snapped.bounds.add(q));
            snapped.surface.add(&q);
            let attributes = batch.attributes.of(index);
            if let Some(means) = &mut snapped.means {
                means.add(&q, material, &attributes.colours);
            }
            cells.push(LatticeTriangle { q, material }, &attributes)?;
        }
        Ok(())
    }

    /// Snaps it, and hands what can be drawn to `cells`: all that is counted of it is known.
    pub(crate) fn snap_known(&self, batch: &TriangleBatch, cells: &mut impl CellSink) -> Result<()> {
        for (index, (corners, &material)) in batch.corners.iter().zip(&batch.material).enumerate() {
            if let Some(q) = self.snap(corners)?.filter(|q| !is_degenerate(q)) {
                let material = self.stored_material(material)?;
                cells.push(LatticeTriangle { q, material }, &batch.attributes.of(index))?;
            }
        }
        Ok(())
    }

    /// The corners on the lattice; `None` where one is no finite number.
    #[inline]
    fn snap(&self, corners: &[[f64; 3]; 3]) -> Result<Option<[[i64; 3]; 3]>> {
        let Grid { lattice, bits } = self.grid;
        let q = corners.map(|corner| lattice.snap(corner));
        if q.as_flattened().iter().fold(0, |all, v| all | v) as u64 >> bits == 0 {
            return Ok(Some(q));
        }
        if !corners.as_flattened().iter().all(|v| v.is_finite()) {
            return Ok(None);
        }
        Err(Error::new(Code::InputFormat, "the input changed while it was read")
            .at_place(&self.name)
            .numbers(format!("a vertex at {corners:?} lies outside of the bounds of the first pass"))
            .next("build again when nothing writes to the input"))
    }

    fn stored_material(&self, material: u32) -> Result<u16> {
        u16::try_from(material).map_err(|_| self.too_many("materials", MATERIALS as u64))
    }

    fn too_many(&self, what: &str, most: u64) -> Error {
        Error::new(Code::InputRange, format!("the input holds more {what} than a trex file can"))
            .at_place(&self.name)
            .numbers(format!("at most {most}"))
            .next("cut the input in parts and build each")
    }
}

/// Whether two corners fall on one point of the lattice.
fn is_degenerate(q: &[[i64; 3]; 3]) -> bool {
    q[0] == q[1] || q[1] == q[2] || q[2] == q[0]
}

/// True when a triangle has area, by more than the rounding of its coordinates' differences and products.
fn has_area([a, b, c]: &[[f64; 3]; 3]) -> bool {
    let edge = |to: &[f64; 3]| -> [f64; 3] { std::array::from_fn(|axis| to[axis] - a[axis]) };
    let (e, f) = (edge(b), edge(c));
    [(0, 1), (1, 2), (2, 0)].into_iter().any(|(x, y)| {
        let (p, q) = (e[x] * f[y], e[y] * f[x]);
        (p - q).abs() > 4.0 * f64::EPSILON * (p.abs() + q.abs())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_spans_a_plane_has_area() {
        let a = [0.1, 0.2, 0.3];
        let along = |t: f64| a.map(|x| x + t);
        assert!(!has_area(&[a, a, [5.0, 1.0, 2.0]]));
        assert!(!has_area(&[a, [5.0, 1.0, 2.0], a]));
        assert!(!has_area(&[a, along(1.0), along(3.0)]));
        assert!(has_area(&[a, along(1.0), [1.1, 1.2, 1.3 + 1e-9]]));
        assert!(has_area(&[[0.0; 3], [1e-30, 0.0, 0.0], [0.0, 1e-30, 0.0]]));
    }
}
