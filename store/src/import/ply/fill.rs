//! The rows of faces and strips as triangles: what `PlySource` fills a batch with.
//!
//! Invariants: those of `section.rs`.

use super::super::polygon::{FaceCorner, MAX_POLYGON_SIDES};
use super::super::scalar::Scalar;
use super::header::Property;
use super::rows::{Rows, TriangleRows};
use super::section::{Kind, OpenStrip};
use super::{PlyMesh, PlySource, PlyVertices, colour_of};
use crate::error::{Code, Error, Result};
use crate::source::TriangleBatch;

impl<R: Rows> PlySource<R> {
    /// Adds triangles to `batch` until it is full or the last section has ended.
    pub(super) fn fill(&mut self, mesh: &mut PlyMesh<R>, batch: &mut TriangleBatch) -> Result<()> {
        while batch.len() < TriangleBatch::TARGET_TRIANGLES && mesh.at < mesh.sections.len() {
            if mesh.progress.rows_left > 0 {
                self.some_rows(mesh, batch)?;
                continue;
            }
            mesh.at += 1;
            match mesh.sections.get(mesh.at) {
                Some((section, place)) => {
                    mesh.progress = section.start();
                    self.rows.seek(*place);
                }
                None => self.warn_of_rest(),
            }
        }
        Ok(())
    }

    fn some_rows(&mut self, mesh: &mut PlyMesh<R>, batch: &mut TriangleBatch) -> Result<()> {
        let section = &mesh.sections[mesh.at].0;
        let kind = section.kind;
        if let Some(rows) = section.triangle_rows {
            self.run_of_triangles(mesh, rows, batch)?;
            if mesh.progress.rows_left == 0 || batch.len() >= TriangleBatch::TARGET_TRIANGLES {
                return Ok(());
            }
        }
        match kind {
            Kind::Faces => self.face(mesh, batch),
            Kind::Strips => self.strip(mesh, batch),
        }
    }

    fn run_of_triangles(
        &mut self,
        mesh: &mut PlyMesh<R>,
        rows: TriangleRows,
        batch: &mut TriangleBatch,
    ) -> Result<()> {
        let room = (TriangleBatch::TARGET_TRIANGLES - batch.len()) as u64;
        self.rows.triangles(rows, room.min(mesh.progress.rows_left), &mut self.run)?;
        let signed = mesh.sections[mesh.at].0.item == Scalar::I32;
        let count = mesh.vertices.positions.count();
        let bound = if signed { count.min(1 << 31) } else { count };
        for (row, triangle) in self.run.indices.iter().enumerate() {
            if let Some(&index) = triangle.iter().find(|&&index| u64::from(index) >= bound) {
                let index = if signed { i64::from(index as i32) } else { i64::from(index) };
                let offset = self.run.offset + row as u64 * self.run.row_bytes;
                return Err(no_vertex(index, count, |what, numbers| {
                    Error::new(Code::InputRange, what)
                        .at_byte(self.rows.input().path(), offset)
                        .numbers(numbers)
                        .next("export the mesh again")
                }));
            }
            let [a, b, c] = triangle.map(u64::from);
            let vertices = &mut mesh.vertices;
            let corners = [vertices.corner(a)?, vertices.corner(b)?, vertices.corner(c)?];
            FaceCorner::push_triangle(corners, 0, batch);
        }
        mesh.progress.rows_left -= self.run.indices.len() as u64;
        Ok(())
    }

    fn face(&mut self, mesh: &mut PlyMesh<R>, batch: &mut TriangleBatch) -> Result<()> {
        let section = &mesh.sections[mesh.at].0;
        let mut colour = section.colour.map(|columns| (columns, [0.0; 3], [Scalar::U8; 3]));
        self.rows.begin_row()?;
        self.face_values(&section.before, 0, &mut colour)?;
        let sides = self.list_length(section.list_count)?;
        if sides > MAX_POLYGON_SIDES as u64 {
            let numbers = format!("{sides}, and {MAX_POLYGON_SIDES} are allowed");
            return Err(self.rows.error(Code::InputRange, "a face has too many sides", numbers));
        }
        self.polygon.clear();
        for _ in 0..sides {
            let index = self.rows.integer(section.item)?;
            let corner = self.corner(index, &mut mesh.vertices)?;
            self.polygon.push(corner);
        }
        self.face_values(&section.after, section.before.len(), &mut colour)?;
        self.end_row()?;
        if let Some((_, values, types)) = colour {
            self.polygon.paint(colour_of(values, types));
        }
        self.polygon.emit(0, batch, &mut self.stats);
        mesh.progress.rows_left -= 1;
        Ok(())
    }

    /// Goes on with a strip until it ends or the batch is full.
    fn strip(&mut self, mesh: &mut PlyMesh<R>, batch: &mut TriangleBatch) -> Result<()> {
        let section = &mesh.sections[mesh.at].0;
        let mut strip = match mesh.progress.strip {
            Some(strip) => strip,
            None => {
                self.rows.begin_row()?;
                self.skip_values(&section.before)?;
                OpenStrip {
                    items_left: self.list_length(section.list_count)?,
                    last: [FaceCorner::default(); 2],
                    length: 0,
                }
            }
        };
        while strip.items_left > 0 && batch.len() < TriangleBatch::TARGET_TRIANGLES {
            strip.items_left -= 1;
            let index = self.rows.integer(section.item)?;
            if index == -1 {
                strip.length = 0;
                continue;
            }
            let corner = self.corner(index, &mut mesh.vertices)?;
            let [a, b] = strip.last;
            match strip.length {
                0 | 1 => {}
                // Every second triangle of a strip turns the other way: its first two corners change places.
                length if length % 2 == 0 => FaceCorner::push_triangle([a, b, corner], 0, batch),
                _ => FaceCorner::push_triangle([b, a, corner], 0, batch),
            }
            strip.last = [b, corner];
            strip.length += 1;
        }
        if strip.items_left > 0 {
            mesh.progress.strip = Some(strip);
            return Ok(());
        }
        self.skip_values(&section.after)?;
        self.end_row()?;
        mesh.progress.strip = None;
        mesh.progress.rows_left -= 1;
        Ok(())
    }

    fn corner(&self, index: i64, vertices: &mut PlyVertices) -> Result<FaceCorner> {
        match u64::try_from(index) {
            Ok(index) if index < vertices.positions.count() => vertices.corner(index),
            _ => Err(no_vertex(index, vertices.positions.count(), |what, numbers| {
                self.rows.error(Code::InputRange, what, numbers)
            })),
        }
    }

    /// Passes over values of a face, `first` of which stand before these, and takes those of its colour.
    fn face_values(
        &mut self,
        properties: &[Property],
        first: usize,
        colour: &mut Option<([usize; 3], [f64; 3], [Scalar; 3])>,
    ) -> Result<()> {
        let Some((columns, values, types)) = colour else { return self.skip_values(properties) };
        for (at, property) in properties.iter().enumerate() {
            let channel = columns.iter().position(|&column| column == first + at);
            match (property.list_count, channel) {
                (Some(count), _) => self.skip_list(count, property.scalar)?,
                (None, Some(channel)) => {
                    values[channel] = self.rows.number(property.scalar)?;
                    types[channel] = property.scalar;
                }
                (None, None) => self.rows.skip(property.scalar, 1)?,
            }
        }
        Ok(())
    }

    fn skip_values(&mut self, properties: &[Property]) -> Result<()> {
        properties.iter().try_for_each(|property| match property.list_count {
            Some(count) => self.skip_list(count, property.scalar),
            None => self.rows.skip(property.scalar, 1),
        })
    }
}

fn no_vertex(index: i64, count: u64, error: impl FnOnce(&str, String) -> Error) -> Error {
    error(
        "a face refers to a vertex that is not there",
        format!("index {index}, and there are {count} vertices"),
    )
}
