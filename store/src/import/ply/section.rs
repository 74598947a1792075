//! `PlySection`: the faces or strips of a PLY file, and how their rows become triangles.
//!
//! A strip `a b c d -1 e ...` is the triangles abc, cbd; -1 begins a new one.
//!
//! Invariants: 1. a strip of any length takes no memory: the stream may stop in the middle of it; 2. faces of more
//! sides than a polygon may have are refused before their indices are read.

use super::super::polygon::FaceCorner;
use super::super::scalar::Scalar;
use super::header::{Element, Property, colour_columns};
use super::rows::TriangleRows;
use crate::error::{Code, Error, Result};
use std::path::Path;

/// Names of the list of a face that holds its corners.
const INDEX_NAMES: [&str; 2] = ["vertex_indices", "vertex_index"];

/// An element that holds triangles.
#[derive(Clone, Debug)]
pub(super) struct PlySection {
    pub(super) kind: Kind,
    pub(super) count: u64,
    pub(super) before: Vec<Property>,
    pub(super) list_count: Scalar,
    pub(super) item: Scalar,
    pub(super) after: Vec<Property>,
    /// Columns of a face's colour, counted over `before` and `after`.
    pub(super) colour: Option<[usize; 3]>,
    /// Set when rows may be plain triangles of fixed size.
    pub(super) triangle_rows: Option<TriangleRows>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    Faces,
    Strips,
}

/// How far a section has come.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct SectionProgress {
    pub(super) rows_left: u64,
    pub(super) strip: Option<OpenStrip>,
}

/// A strip in the middle of which the stream stands.
#[derive(Clone, Copy, Debug)]
pub(super) struct OpenStrip {
    pub(super) items_left: u64,
    /// The last two corners.
    pub(super) last: [FaceCorner; 2],
    /// Corners since the start or the last -1.
    pub(super) length: u64,
}

impl PlySection {
    /// The section that `element` is; `None` for other elements and for those without rows.
    pub(super) fn new(element: &Element, path: &Path) -> Result<Option<PlySection>> {
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
        let around: Vec<Property> = before.iter().chain(after).cloned().collect();
        let colour = colour_columns(&around).filter(|_| kind == Kind::Faces);
        Ok(Some(PlySection {
            kind,
            count: element.count,
            triangle_rows: triangle_rows(kind, before, after, (list_count, item))
                .filter(|_| colour.is_none()),
            colour,
            before: before.to_vec(),
            list_count,
            item,
            after: after.to_vec(),
        }))
    }

    /// Progress at the first row.
    pub(super) fn start(&self) -> SectionProgress {
        SectionProgress { rows_left: self.count, strip: None }
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
