//! `VolumeSource`: the surfaces of a volume as a stream of triangles, slab by slab.
//!
//! ```text
//! slice z     ##########   read, swapped, compared with each value: a bit a sample
//!             \ slab z /   cells between two slices, for each value, row by row
//! slice z + 1 ##########   the next slab takes it over; the one above is filled anew
//! ```
//!
//! Invariants: 1. two slices are held, leased when the source is opened and taken with the first triangle; 2. triangles
//! come by slab, value, row, and then along x; 3. a sample that is NaN is outside of every surface.

use super::cells::{CellRow, RowSamples};
use super::layout::VolumeLayout;
use super::masks::{FaceSides, SliceMask};
use super::reader::{DECODER_BYTES, SampleReader};
use super::samples::Sample;
use crate::budget::Lease;
use crate::error::Result;
use crate::import::warn;
use crate::material_list::MaterialList;
use crate::source::{ScanHint, SourceStats, TriangleBatch, TriangleSource};
use std::path::PathBuf;

/// The faces of a volume, as messages call them, in the order of `SurfaceState::faces`.
const FACES: [&str; 6] =
    ["the first x", "the last x", "the first y", "the last y", "the first z", "the last z"];

/// What a volume was found to be.
pub(super) struct VolumeParts {
    pub(super) path: PathBuf,
    pub(super) size: [usize; 3],
    pub(super) is_foreign: bool,
    pub(super) reader: SampleReader,
    pub(super) cells: CellRow,
    /// Of each surface.
    pub(super) values: Vec<f64>,
    /// One for each value.
    pub(super) materials: MaterialList,
    pub(super) stats: SourceStats,
    pub(super) lease: Lease,
}

/// The surfaces of a volume.
pub(super) struct VolumeSource<T> {
    path: PathBuf,
    size: [usize; 3],
    is_foreign: bool,
    reader: SampleReader,
    cells: CellRow,
    materials: MaterialList,
    stats: SourceStats,
    /// Slice z is in place z & 1.
    slices: [Vec<T>; 2],
    surfaces: Vec<SurfaceState<T>>,
    at: CellCursor,
    /// Samples that are no numbers.
    odd_count: u64,
    _lease: Lease,
}

/// One surface of a volume.
struct SurfaceState<T> {
    value: f64,
    least: Option<T>,
    /// Of the slices.
    masks: [SliceMask; 2],
    /// Of the volume.
    faces: [FaceSides; 6],
}

/// The next cells.
#[derive(Clone, Copy, Debug, Default)]
struct CellCursor {
    /// Slices that were read.
    slices: usize,
    surface: usize,
    row: usize,
    word: usize,
    is_done: bool,
}

/// Bytes that a source of such a volume takes.
pub(super) fn source_bytes(layout: &VolumeLayout, value_count: usize) -> u64 {
    let [x, y, _] = layout.size;
    let masks = 2 * value_count as u64 * SliceMask::bytes([x, y]);
    2 * layout.slice_bytes() + masks + CellRow::bytes(x) + DECODER_BYTES
}

impl<T: Sample> VolumeSource<T> {
    /// Stands before the first triangle.
    pub(super) fn new(parts: VolumeParts) -> VolumeSource<T> {
        let VolumeParts { path, size, is_foreign, reader, cells, values, materials, stats, lease } = parts;
        let surface = |value: f64| SurfaceState {
            value,
            least: T::least_from(value),
            masks: Default::default(),
            faces: Default::default(),
        };
        VolumeSource {
            path,
            size,
            is_foreign,
            reader,
            cells,
            materials,
            stats,
            slices: Default::default(),
            surfaces: values.into_iter().map(surface).collect(),
            at: CellCursor::default(),
            odd_count: 0,
            _lease: lease,
        }
    }

    /// Reads the next slice.
    fn read_slice(&mut self) -> Result<()> {
        let ([side, rows, count], z) = (self.size, self.at.slices);
        let slice = &mut self.slices[z & 1];
        slice.resize(side * rows, T::zeroed());
        self.reader.read(bytemuck::cast_slice_mut(slice))?;
        if self.is_foreign {
            slice.iter_mut().for_each(|sample| *sample = sample.swapped());
        }
        self.odd_count += slice.iter().map(|sample| u64::from(!sample.is_number())).sum::<u64>();
        for surface in &mut self.surfaces {
            let mask = &mut surface.masks[z & 1];
            mask.fill(slice, side, surface.least);
            let (sides, ends) = surface.faces.split_at_mut(4);
            mask.add_to_sides(side, sides.try_into().expect("four sides and two ends"));
            if z == 0 {
                mask.add_to_face(side, &mut ends[0]);
            }
            if z + 1 == count {
                mask.add_to_face(side, &mut ends[1]);
            }
        }
        self.at.slices += 1;
        Ok(())
    }

    /// Adds the triangles of the cells at hand, and goes to the next row, surface or slab. False at the end.
    fn step(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        if self.at.is_done {
            return Ok(false);
        }
        while self.at.slices < 2 {
            self.read_slice()?;
        }
        self.march_row(batch);
        if self.at.row + 1 < self.size[1] {
            return Ok(true);
        }
        self.at = CellCursor { surface: self.at.surface + 1, row: 0, word: 0, ..self.at };
        if self.at.surface == self.surfaces.len() {
            self.at.surface = 0;
            if self.at.slices == self.size[2] {
                self.end()?;
            } else {
                self.read_slice()?;
            }
        }
        Ok(true)
    }

    /// Goes on in the row at hand; to the next one where it ends.
    fn march_row(&mut self, batch: &mut TriangleBatch) {
        let CellCursor { surface, row: y, word, .. } = self.at;
        let (z, side) = (self.at.slices - 2, self.size[0]);
        let SurfaceState { value, masks, .. } = &self.surfaces[surface];
        let (slices, places) = (&self.slices, [z & 1, (z + 1) & 1]);
        let row = RowSamples {
            samples: places.map(|place| [y, y + 1].map(|row| &slices[place][row * side..(row + 1) * side])),
            inside: places.map(|place| [y, y + 1].map(|row| masks[place].row(row))),
            y,
            z,
            value: *value,
        };
        if word == 0 {
            self.cells.place_vertices(&row);
        }
        let next = self.cells.march(&row, word, surface as u32, batch);
        if next == SliceMask::row_words(side) {
            (self.at.row, self.at.word) = (y + 1, 0);
        } else {
            self.at.word = next;
        }
    }

    /// All slabs are done: what is left to be told.
    fn end(&mut self) -> Result<()> {
        self.at.is_done = true;
        if self.reader.finish()? {
            warn(
                &mut self.stats,
                "the samples unpack to more than the size says: the rest is not read".to_owned(),
            );
        }
        if self.odd_count > 0 {
            let told = format!(
                "{} samples are NaN or infinite: NaN counts as outside, and the surface passes halfway between such a \
                 sample and its neighbour",
                self.odd_count
            );
            warn(&mut self.stats, told);
        }
        for (surface, name) in self.surfaces.iter().zip(self.materials.names().iter()) {
            let cut = surface.faces.iter().zip(FACES).filter(|(face, _)| face.is_cut());
            let cut: Vec<&str> = cut.map(|(_, name)| name).collect();
            if !cut.is_empty() {
                let told =
                    format!("{name} meets the border of the volume at {}: it is open there", cut.join(", "));
                warn(&mut self.stats, told);
            }
        }
        Ok(())
    }
}

impl<T: Sample> TriangleSource for VolumeSource<T> {
    fn name(&self) -> String {
        self.path.display().to_string()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        batch.clear();
        while batch.len() < TriangleBatch::TARGET_TRIANGLES && self.step(batch)? {}
        self.stats.triangle_count += batch.len() as u64;
        Ok(!batch.is_empty())
    }

    fn rewind(&mut self) -> Result<()> {
        self.reader.rewind();
        (self.at, self.odd_count) = (CellCursor::default(), 0);
        self.surfaces.iter_mut().for_each(|surface| surface.faces = Default::default());
        self.stats.triangle_count = 0;
        Ok(())
    }

    fn hint(&self) -> Option<ScanHint> {
        None
    }

    fn materials(&self) -> &MaterialList {
        &self.materials
    }

    fn stats(&self) -> SourceStats {
        SourceStats { bytes_read: self.reader.done(), ..self.stats.clone() }
    }
}
