//! Partition: triangles are snapped to the lattice and sorted into cells; runs of each cell go to scratch.
//!
//! A loose octree without pointers: a triangle goes to the finest level whose cells are at least as large as
//! the triangle, and there to the cell of its centroid; so plates do not widen the boxes of bolts. Cells are
//! then put in Hilbert order and joined into *chunks* of up to [`CHUNK_TRIANGLES`](super::cells::CHUNK_TRIANGLES); a
//! cell with more is cut again, finer.
//!
//! Invariants: 1. which triangles make a chunk, and in which order, follows from the stream alone: not from
//! threads, limits or the lengths of runs; 2. buffered triangles never exceed the leased bytes; 3. a chunk holds
//! at most `CHUNK_TRIANGLES`.

use super::cells::{By, Cells, Chunk, Sorted};
use super::lattice::{Grid, Scan, Tell};
use super::scratch::{LatticeTriangle, Scratch};
use super::surface::Surface;
use super::{BuildOptions, Rejected, no_triangles, voxels};
use crate::cluster::LatticeBox;
use crate::error::{Code, Error, Result};
use crate::layout::{MATERIALS, TRIANGLES};
use crate::octree::Refinement;
use crate::scratch::Place;
use crate::source::{TriangleBatch, TriangleSource};
use std::sync::mpsc::sync_channel;
use std::time::{Duration, Instant};
use xxhash_rust::xxh3::Xxh3;

/// Bytes of a buffered triangle.
const TRIANGLE_BYTES: u64 = size_of::<LatticeTriangle>() as u64;
/// Memory for buffered triangles: at least this, so that runs are worth a disk access.
const BUFFER_BYTES_LEAST: u64 = 16 << 20;
/// Batches on their way from the reader.
const BATCHES: u64 = 4;
/// Least that this phase leases.
pub(super) const SMALLEST_BYTES: u64 = BUFFER_BYTES_LEAST + BATCHES * TriangleBatch::BYTES;
/// Most memory for buffered triangles; more does not make runs longer.
const BUFFER_BYTES_MOST: u64 = 128 << 20;
/// Finest level of the first pass: 64^3 cells.
const LEVELS_FIRST: u32 = 6;

/// The whole input in chunks, in scratch.
pub(super) struct Partition {
    pub(super) scratch: Scratch,
    pub(super) chunks: Vec<Chunk>,
    pub(super) grid: Grid,
    pub(super) input_triangle_count: u64,
    pub(super) triangle_count: u64,
    pub(super) rejected_degenerate: u64,
    pub(super) rejected_collapsed: u64,
    pub(super) rejected_non_finite: u64,
    pub(super) error_bound: f64,
    /// Box of the triangles on the lattice: least corner, greatest corner.
    pub(super) lattice_bounds: [[i64; 3]; 2],
    /// At most the median edge length, model units.
    pub(super) median_edge: f64,
    /// Leaves of the resident octree along an axis, and how much finer the finest are; `None` for no octree.
    pub(super) octree: Option<(u32, Refinement)>,
    pub(super) content_hash: u64,
    pub(super) wait_ms: u64,
}

/// Runs the phase. The source is read once, on its own thread.
pub(super) fn partition(
    source: &mut dyn TriangleSource,
    scan: &Scan,
    grid: Grid,
    options: &BuildOptions,
    place: Place,
    tell: Tell<'_>,
) -> Result<Partition> {
    let _batches = options.budget.lease("batches of triangles", BATCHES * TriangleBatch::BYTES)?;
    let buffer_bytes = buffer_bytes(options.budget.free_bytes());
    let _buffers = options.budget.lease("the cells' buffers", buffer_bytes)?;
    let name = source.name();
    let sorted = Sorted {
        by: By::SizeAndPlace,
        levels: first_levels(scan.triangle_count).min(grid.bits),
        bits: grid.bits,
        buffered_most: buffer_bytes / TRIANGLE_BYTES,
    };
    let mut cells = Cells::new(Scratch::create(place)?, sorted);
    let mut snapper = Snapper::new(grid, Surface::new(scan, &grid), name.clone());
    let tell_count = |count| tell("partition", "triangles", count, scan.triangle_count);
    let waited = sort(source, &mut snapper, &mut cells, options, &tell_count)?;

    let (scratch, chunks) = cells.into_chunks(options)?;
    let lattice_bounds = [snapper.bounds.lo, snapper.bounds.hi];
    let triangle_count = chunks.iter().map(|c| c.triangle_count).sum();
    if triangle_count == 0 {
        let rejected = Rejected {
            read: snapper.input_triangle_count,
            degenerate: snapper.rejected_degenerate,
            collapsed: snapper.rejected_collapsed,
            non_finite: snapper.rejected_non_finite,
        };
        return Err(no_triangles(&name, rejected));
    }
    Ok(Partition {
        triangle_count,
        scratch,
        chunks,
        grid,
        input_triangle_count: snapper.input_triangle_count,
        rejected_degenerate: snapper.rejected_degenerate,
        rejected_collapsed: snapper.rejected_collapsed,
        rejected_non_finite: snapper.rejected_non_finite,
        error_bound: if snapper.exact { 0.0 } else { grid.lattice.step() / 2.0 },
        lattice_bounds,
        median_edge: scan.median_edge,
        octree: voxels::resolution(options.voxels, &snapper.surface, lattice_bounds, triangle_count),
        content_hash: snapper.hasher.digest(),
        wait_ms: waited.as_millis() as u64,
    })
}

/// Reads the source on a thread of its own, and sorts what comes into cells; gives the time that it was waited for.
fn sort(
    source: &mut dyn TriangleSource,
    snapper: &mut Snapper,
    cells: &mut Cells,
    options: &BuildOptions,
    tell: &dyn Fn(u64),
) -> Result<Duration> {
    let mut waited = Duration::ZERO;
    std::thread::scope(|scope| -> Result<()> {
        let (full, batches) = sync_channel::<Result<TriangleBatch>>(1);
        let (back, empties) = sync_channel::<TriangleBatch>(BATCHES as usize);
        (0..BATCHES - 1).for_each(|_| back.send(TriangleBatch::default()).expect("the channel has room"));
        let reader = move || {
            while let Ok(mut batch) = empties.recv() {
                let message = match source.next_batch(&mut batch) {
                    Ok(true) => Ok(batch),
                    Ok(false) => return,
                    Err(error) => Err(error),
                };
                if full.send(message).is_err() {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().name("trex-read".into()).spawn_scoped(scope, reader);
        thread.map_err(|error| {
            Error::new(Code::Io, "the system refused a thread")
                .at_place("the reader of the input")
                .numbers(error.to_string())
                .next("raise the limit of processes, or end some")
        })?;
        tell(0);
        loop {
            let before = Instant::now();
            let Ok(message) = batches.recv() else { break };
            waited += before.elapsed();
            let batch = message?;
            options.interrupt.check()?;
            snapper.snap_all(&batch, cells)?;
            tell(snapper.input_triangle_count);
            let _ = back.send(batch);
        }
        Ok(())
    })?;
    Ok(waited)
}

/// Bytes for buffered triangles when so many are free.
fn buffer_bytes(free_bytes: u64) -> u64 {
    (free_bytes / 3).clamp(BUFFER_BYTES_LEAST, BUFFER_BYTES_MOST)
}

/// Bytes that this phase leases when so many are free.
pub(super) fn phase_bytes(free_bytes: u64) -> u64 {
    let batches = BATCHES * TriangleBatch::BYTES;
    batches + buffer_bytes(free_bytes.saturating_sub(batches))
}

/// Levels of the first pass: cells of some 2^15 triangles on a surface.
fn first_levels(triangle_count: u64) -> u32 {
    let across = (triangle_count as f64 / 131_072.0).sqrt();
    (across.max(1.0).log2().ceil() as u32).min(LEVELS_FIRST)
}

/// From model space to the lattice, with all that is counted on the way.
struct Snapper {
    grid: Grid,
    name: String,
    hasher: Xxh3,
    input_triangle_count: u64,
    rejected_degenerate: u64,
    /// Those of them that had area.
    rejected_collapsed: u64,
    rejected_non_finite: u64,
    exact: bool,
    bounds: LatticeBox,
    surface: Surface,
}

impl Snapper {
    fn new(grid: Grid, surface: Surface, name: String) -> Snapper {
        Snapper {
            grid,
            name,
            hasher: Xxh3::new(),
            input_triangle_count: 0,
            rejected_degenerate: 0,
            rejected_collapsed: 0,
            rejected_non_finite: 0,
            exact: true,
            bounds: LatticeBox::EMPTY,
            surface,
        }
    }

    fn snap_all(&mut self, batch: &TriangleBatch, cells: &mut Cells) -> Result<()> {
        self.hasher.update(bytemuck::cast_slice(&batch.corners));
        self.hasher.update(bytemuck::cast_slice(&batch.material));
        self.input_triangle_count += batch.len() as u64;
        if self.input_triangle_count > TRIANGLES {
            return Err(self.too_many("triangles", TRIANGLES));
        }
        let Grid { lattice, bits } = self.grid;
        for (corners, &material) in batch.corners.iter().zip(&batch.material) {
            let q = corners.map(|corner| lattice.snap(corner));
            if q.as_flattened().iter().fold(0, |all, v| all | v) as u64 >> bits != 0 {
                if !corners.as_flattened().iter().all(|v| v.is_finite()) {
                    self.rejected_non_finite += 1;
                    continue;
                }
                return Err(Error::new(Code::InputFormat, "the input changed while it was read")
                    .at_place(&self.name)
                    .numbers(format!("a vertex at {corners:?} lies outside of the bounds of the first pass"))
                    .next("build again when nothing writes to the input"));
            }
            self.exact &= !self.exact || (0..3).all(|c| lattice.position(q[c]) == corners[c]);
            if q[0] == q[1] || q[1] == q[2] || q[2] == q[0] {
                self.rejected_degenerate += 1;
                self.rejected_collapsed += u64::from(has_area(corners));
                continue;
            }
            let Ok(material) = u16::try_from(material) else {
                return Err(self.too_many("materials", MATERIALS as u64));
            };
            q.iter().for_each(|&q| self.bounds.add(q));
            self.surface.add(&q);
            cells.push(LatticeTriangle { q, material })?;
        }
        Ok(())
    }

    fn too_many(&self, what: &str, most: u64) -> Error {
        Error::new(Code::InputRange, format!("the input holds more {what} than a trex file can"))
            .at_place(&self.name)
            .numbers(format!("at most {most}"))
            .next("cut the input in parts and build each")
    }
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
