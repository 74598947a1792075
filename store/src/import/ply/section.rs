//! `Section`: the faces or strips of a PLY file, and how their rows become triangles.
//!
//! A strip `a b c d -1 e ...` is the triangles abc, cbd; -1 begins a new one.
//!
//! Invariants: 1. a strip of any length takes no memory: the stream may stop in the middle of it; 2. faces of more
//! than [`MAX_POLYGON_SIDES`] sides are refused before their indices are read.

use super::super::polygon::MAX_POLYGON_SIDES;
use super::super::scalar::Scalar;
use super::header::{Element, Property};
use super::rows::{Rows, TriangleRows};
use super::{INDEX_NAMES, Mesh, PlySource};
use crate::error::{Code, Error, Result};
use crate::source::TriangleBatch;
use std::path::Path;

/// An element that holds triangles.
#[derive(Clone, Debug)]
pub(super) struct Section {
    kind: Kind,
    count: u64,
    before: Vec<Property>,
    list_count: Scalar,
    item: Scalar,
    after: Vec<Property>,
    /// Set when rows may be plain triangles of fixed size.
    triangle_rows: Option<TriangleRows>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Faces,
    Strips,
}

/// How far a section has come.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Progress {
    rows_left: u64,
    strip: Option<Strip>,
}

/// A strip in the middle of which the stream stands.
#[derive(Clone, Copy, Debug)]
struct Strip {
    items_left: u64,
    /// The last two corners.
    last: [[f64; 3]; 2],
    /// Corners since the start or the last -1.
    length: u64,
}

impl Section {
    /// The section that `element` is; `None` for other elements and for those without rows.
    pub(super) fn new(element: &Element, path: &Path) -> Result<Option<Section>> {
        let kind = match &*element.name {
            "face" => Kind::Faces,
            "tristrips" => Kind::Strips,
            _ => return Ok(None),
        };
        if element.count == 0 {
            return Ok(None);
        }
        let wrong = |what: String| Error::new(Code::InputFormat, what).at(path).next("export the mesh again");
        let column = element.column(&INDEX_NAMES).ok_or_else(|| {
            wrong(format!("the PLY element `{}` has no list `vertex_indices`", element.name))
        })?;
        let Property { scalar: item, list_count: Some(list_count), .. } = element.properties[column] else {
            return Err(wrong(format!("`vertex_indices` of the PLY element `{}` is no list", element.name)));
        };
        if !item.is_integer() {
            return Err(wrong(format!(
                "the vertex indices of the PLY element `{}` are not integers",
                element.name
            )));
        }
        let (before, after) = (&element.properties[..column], &element.properties[column + 1..]);
        Ok(Some(Section {
            kind,
            count: element.count,
            triangle_rows: triangle_rows(kind, before, after, (list_count, item)),
            before: before.to_vec(),
            list_count,
            item,
            after: after.to_vec(),
        }))
    }

    /// Progress at the first row.
    pub(super) fn start(&self) -> Progress {
        Progress { rows_left: self.count, strip: None }
    }
}

fn triangle_rows(
    kind: Kind,
    before: &[Property],
    after: &[Property],
    (list_count, item): (Scalar, Scalar),
) -> Option<TriangleRows> {
    let bytes = |around: &[Property]| -> Option<usize> {
        around.iter().map(|property| property.list_count.is_none().then(|| property.scalar.size())).sum()
    };
    let rows = TriangleRows { before: bytes(before)?, after: bytes(after)? };
    let usual = matches!((kind, list_count), (Kind::Faces, Scalar::U8 | Scalar::I8))
        && matches!(item, Scalar::I32 | Scalar::U32)
        && rows.before + rows.after <= TriangleRows::MAX_AROUND_BYTES;
    usual.then_some(rows)
}

impl<R: Rows> PlySource<R> {
    /// Adds triangles to `batch` until it is full or the last section has ended.
    pub(super) fn fill(&mut self, mesh: &mut Mesh<R>, batch: &mut TriangleBatch) -> Result<()> {
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

    fn some_rows(&mut self, mesh: &mut Mesh<R>, batch: &mut TriangleBatch) -> Result<()> {
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
        mesh: &mut Mesh<R>,
        rows: TriangleRows,
        batch: &mut TriangleBatch,
    ) -> Result<()> {
        let room = (TriangleBatch::TARGET_TRIANGLES - batch.len()) as u64;
        self.rows.triangles(rows, room.min(mesh.progress.rows_left), &mut self.run)?;
        let signed = mesh.sections[mesh.at].0.item == Scalar::I32;
        let count = mesh.vertices.count();
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
            batch.push([mesh.vertices.get(a)?, mesh.vertices.get(b)?, mesh.vertices.get(c)?], 0);
        }
        mesh.progress.rows_left -= self.run.indices.len() as u64;
        Ok(())
    }

    fn face(&mut self, mesh: &mut Mesh<R>, batch: &mut TriangleBatch) -> Result<()> {
        let section = &mesh.sections[mesh.at].0;
        self.rows.begin_row()?;
        self.skip_values(&section.before)?;
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
        self.skip_values(&section.after)?;
        self.end_row()?;
        self.polygon.emit(0, batch, &mut self.stats);
        mesh.progress.rows_left -= 1;
        Ok(())
    }

    /// Goes on with a strip until it ends or the batch is full.
    fn strip(&mut self, mesh: &mut Mesh<R>, batch: &mut TriangleBatch) -> Result<()> {
        let section = &mesh.sections[mesh.at].0;
        let mut strip = match mesh.progress.strip {
            Some(strip) => strip,
            None => {
                self.rows.begin_row()?;
                self.skip_values(&section.before)?;
                Strip { items_left: self.list_length(section.list_count)?, last: [[0.0; 3]; 2], length: 0 }
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
                length if length % 2 == 0 => batch.push([a, b, corner], 0),
                _ => batch.push([b, a, corner], 0),
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

    fn corner(&self, index: i64, vertices: &mut super::VertexCache) -> Result<[f64; 3]> {
        match u64::try_from(index) {
            Ok(index) if index < vertices.count() => vertices.get(index),
            _ => Err(no_vertex(index, vertices.count(), |what, numbers| {
                self.rows.error(Code::InputRange, what, numbers)
            })),
        }
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
