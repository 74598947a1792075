//! Accessors, views and buffers of the document as rows that lie where they should: the gate for every offset, count
//! and type of the file.
//!
//! Invariant: rows that come out of here lie in their view, the view in its buffer, and the buffer in what is there.

use super::buffers::{Buffers, wrong};
use super::bytes::{BufferPlace, Spool};
use super::draco::DracoStream;
use super::json::{JsonDocument, JsonMeshopt, JsonSparse};
use super::packed::{PackedFilter, PackedMode, PackedView};
use super::row_layout::RowLayout;
use super::rows::{ElementRows, SparseRows, ViewPlace};
use crate::error::{Code, Error, Result};
use crate::import::scalar::Scalar;
use std::path::Path;
use std::sync::Arc;

/// Most rows of an accessor that has no view, and so no bytes that its count could be compared with.
const MAX_ROWS_OF_NOTHING: u64 = 1 << 20;
/// Most bytes of a row of a compressed view.
const PACKED_ROW_BYTES_MAX: u64 = 256;

/// What an accessor is used for, and so what it may hold.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum AccessorUse {
    /// Positions, or places and scales of instances: three numbers.
    Vectors,
    /// Rotations: four numbers, shares where they are integers.
    Rotations,
    /// Indices: one unsigned integer.
    Indices,
    /// Colours: three numbers, and opacity or not; integers are shares.
    Colours,
    /// Coordinates in a picture: two numbers.
    Coordinates,
}

/// The gate.
pub(super) struct Accessors<'a, 'b> {
    pub(super) path: &'a Arc<Path>,
    pub(super) document: &'a JsonDocument<'a>,
    pub(super) buffers: &'b mut Buffers<'a>,
    pub(super) spool: &'b mut Spool,
    /// Of the primitive at hand: it has the rows of some accessors.
    pub(super) draco: Option<Arc<DracoStream>>,
}

impl Accessors<'_, '_> {
    /// How the rows of an accessor lie for this use, without its view.
    pub(super) fn layout(&self, index: u32, used: AccessorUse) -> Result<RowLayout> {
        let bad = |what: &str| wrong(self.path, "accessors", index, what);
        let Some(accessor) = self.document.accessors.get(index as usize) else {
            let count = self.document.accessors.len();
            return Err(bad("the glTF file refers to an accessor that is not there")
                .numbers(format!("there are {count} accessors")));
        };
        let Some(scalar) = scalar_of(accessor.component_type) else {
            return Err(bad("an accessor of the glTF file has an unknown type of numbers")
                .numbers(format!("componentType {}", accessor.component_type)));
        };
        let is_fit = match used {
            AccessorUse::Vectors => &*accessor.kind == "VEC3" && scalar != Scalar::U32,
            AccessorUse::Rotations => &*accessor.kind == "VEC4" && scalar != Scalar::U32,
            AccessorUse::Colours => {
                matches!(&*accessor.kind, "VEC3" | "VEC4")
                    && matches!(scalar, Scalar::U8 | Scalar::U16 | Scalar::F32)
            }
            AccessorUse::Coordinates => &*accessor.kind == "VEC2" && scalar != Scalar::U32,
            AccessorUse::Indices => {
                &*accessor.kind == "SCALAR" && matches!(scalar, Scalar::U8 | Scalar::U16 | Scalar::U32)
            }
        };
        if !is_fit {
            let kind: String = accessor.kind.chars().take(16).collect();
            return Err(bad("an accessor of the glTF file does not hold what it is used for").numbers(
                format!("{used:?} wanted, found type {kind} of componentType {}", accessor.component_type),
            ));
        }
        Ok(RowLayout {
            offset: accessor.byte_offset,
            stride: 0,
            count: accessor.count,
            scalar,
            components: match used {
                AccessorUse::Vectors => 3,
                AccessorUse::Rotations => 4,
                AccessorUse::Indices => 1,
                AccessorUse::Coordinates => 2,
                AccessorUse::Colours if &*accessor.kind == "VEC3" => 3,
                AccessorUse::Colours => 4,
            },
            is_normalized: scalar.is_integer()
                && (accessor.normalized || matches!(used, AccessorUse::Rotations | AccessorUse::Colours))
                && used != AccessorUse::Indices,
        })
    }

    /// The rows of an accessor.
    pub(super) fn rows(&mut self, index: u32, used: AccessorUse) -> Result<ElementRows> {
        let of_stream = self.draco.as_ref().and_then(|stream| Some((stream, stream.layout_of(index)?)));
        if let Some((stream, layout)) = of_stream {
            let view = Some(ViewPlace::Draco(stream.clone(), index));
            return Ok(ElementRows { accessor: index, view, layout, sparse: None });
        }
        let layout = self.layout(index, used)?;
        let accessor = &self.document.accessors[index as usize];
        let sparse =
            accessor.sparse.as_deref().map(|sparse| self.sparse(index, sparse, layout)).transpose()?;
        let (view, layout) = match accessor.buffer_view {
            Some(view) => {
                let (view, layout) = self.in_view(view, layout, ("accessors", index))?;
                (Some(view), layout)
            }
            None if accessor.count > MAX_ROWS_OF_NOTHING => {
                return Err(Error::new(
                    Code::InputRange,
                    "an accessor of the glTF file has no bytes for its count",
                )
                .at_place(format!("{}: accessors[{index}]", self.path.display()))
                .numbers(format!("{} rows, {MAX_ROWS_OF_NOTHING} at most without a view", accessor.count))
                .next("export the file again"));
            }
            None => (None, layout.packed()),
        };
        Ok(ElementRows { accessor: index, view, layout, sparse: sparse.map(Arc::new) })
    }

    fn sparse(&mut self, index: u32, sparse: &JsonSparse, layout: RowLayout) -> Result<SparseRows> {
        let scalar = sparse.indices.component_type.and_then(scalar_of);
        let Some(scalar @ (Scalar::U8 | Scalar::U16 | Scalar::U32)) = scalar else {
            return Err(wrong(
                self.path,
                "accessors",
                index,
                "the indices of a sparse accessor are no indices",
            )
            .numbers(format!("componentType {:?}", sparse.indices.component_type)));
        };
        if sparse.count > layout.count {
            return Err(wrong(self.path, "accessors", index, "a sparse accessor replaces more than it has")
                .numbers(format!("{} of {} rows", sparse.count, layout.count)));
        }
        let item = ("accessors", index);
        let values = RowLayout { offset: sparse.values.byte_offset, count: sparse.count, ..layout };
        let indices = RowLayout { scalar, components: 1, is_normalized: false, ..values };
        let indices = RowLayout { offset: sparse.indices.byte_offset, ..indices };
        Ok(SparseRows {
            indices: self.in_view(sparse.indices.buffer_view, indices, item)?,
            values: self.in_view(sparse.values.buffer_view, values, item)?,
        })
    }

    /// The layout with the view's stride, checked against its length.
    fn in_view(&mut self, view: u32, layout: RowLayout, of: (&str, u32)) -> Result<(ViewPlace, RowLayout)> {
        let (place, bytes, stride) = self.view(view)?;
        let row_bytes = layout.row_bytes() as u64;
        let stride = stride.filter(|&stride| stride > 0).unwrap_or(row_bytes);
        if stride < row_bytes {
            return Err(wrong(self.path, "bufferViews", view, "the rows of a view lie on top of each other")
                .numbers(format!(
                    "byteStride {stride}, and a row of {}[{}] has {row_bytes} bytes",
                    of.0, of.1
                )));
        }
        let needed = match layout.count {
            0 => Some(0),
            count => (count - 1)
                .checked_mul(stride)
                .and_then(|bytes| bytes.checked_add(row_bytes)?.checked_add(layout.offset)),
        };
        if needed.is_none_or(|needed| needed > bytes) {
            return Err(Error::new(Code::InputRange, "an accessor of the glTF file reaches outside of its view")
                .at_place(format!("{}: {}[{}]", self.path.display(), of.0, of.1))
                .numbers(format!(
                    "{} rows of {row_bytes} bytes, {stride} apart, from {} on; bufferViews[{view}] has {bytes} bytes",
                    layout.count, layout.offset
                ))
                .next("check the file with a glTF validator, or export it again"));
        }
        Ok((place, RowLayout { stride, ..layout }))
    }

    /// Place, bytes and stride of a view.
    fn view(&mut self, index: u32) -> Result<(ViewPlace, u64, Option<u64>)> {
        let Some(view) = self.document.buffer_views.get(index as usize) else {
            let count = self.document.buffer_views.len();
            return Err(wrong(
                self.path,
                "bufferViews",
                index,
                "the glTF file refers to a view that is not there",
            )
            .numbers(format!("there are {count} views")));
        };
        match view.extensions.as_deref().and_then(|extensions| extensions.meshopt()) {
            Some(meshopt) => {
                let packed = self.packed(index, meshopt)?;
                let (bytes, stride) = (packed.bytes(), packed.stride as u64);
                let stride = (packed.mode == PackedMode::Attributes).then_some(stride);
                Ok((ViewPlace::Packed(Arc::new(packed)), bytes, stride))
            }
            None => {
                let place = self.within_buffer(index, view.buffer, view.byte_offset, view.byte_length)?;
                Ok((ViewPlace::Plain(place), view.byte_length, view.byte_stride))
            }
        }
    }

    /// The place of a view that is not compressed, of a `used` of the file.
    pub(super) fn plain_view(&mut self, index: u32, used: &str) -> Result<BufferPlace> {
        match self.view(index)? {
            (ViewPlace::Plain(place), ..) => Ok(place),
            _ => {
                let what = format!("a {used} of the glTF file is a compressed view");
                Err(wrong(self.path, "bufferViews", index, &what))
            }
        }
    }

    fn packed(&mut self, index: u32, meshopt: &JsonMeshopt<'_>) -> Result<PackedView> {
        let bad = |what: &str| wrong(self.path, "bufferViews", index, what);
        let filter = meshopt.filter.as_deref().unwrap_or("NONE");
        let mode = match &*meshopt.mode {
            "ATTRIBUTES" => PackedMode::Attributes,
            "TRIANGLES" => PackedMode::Triangles,
            "INDICES" => PackedMode::Indices,
            other => {
                let other: String = other.chars().take(32).collect();
                return Err(bad("a compressed view of the glTF file is of an unknown kind")
                    .numbers(format!("mode {other}")));
            }
        };
        let filter = match (mode, filter) {
            (_, "NONE") => PackedFilter::None,
            (PackedMode::Attributes, "QUATERNION") if meshopt.byte_stride == 8 => PackedFilter::Quaternion,
            (PackedMode::Attributes, "EXPONENTIAL") => PackedFilter::Exponential,
            _ => {
                let filter: String = filter.chars().take(32).collect();
                return Err(bad("a compressed view has a filter that positions and indices do not have")
                    .numbers(format!("filter {filter}, rows of {} bytes", meshopt.byte_stride)));
            }
        };
        let stride = meshopt.byte_stride;
        let is_fit = match mode {
            PackedMode::Attributes => {
                stride.is_multiple_of(4) && (4..=PACKED_ROW_BYTES_MAX).contains(&stride)
            }
            _ => matches!(stride, 2 | 4),
        };
        if !is_fit || meshopt.count > u64::from(u32::MAX) {
            return Err(bad("a compressed view has rows of a size that there is not")
                .numbers(format!("mode {}, byteStride {stride}, count {}", &*meshopt.mode, meshopt.count)));
        }
        let place = self.within_buffer(index, meshopt.buffer, meshopt.byte_offset, meshopt.byte_length)?;
        let path = self.path.clone();
        Ok(PackedView {
            view: index,
            path,
            place,
            stride: stride as usize,
            count: meshopt.count,
            mode,
            filter,
        })
    }

    fn within_buffer(&mut self, view: u32, buffer: u32, offset: u64, bytes: u64) -> Result<BufferPlace> {
        let whole = self.buffers.place(buffer, self.spool)?;
        if offset.checked_add(bytes).is_none_or(|end| end > whole.bytes()) {
            return Err(Error::new(
                Code::InputRange,
                "a view of the glTF file reaches outside of its buffer",
            )
            .at_place(format!("{}: bufferViews[{view}]", self.path.display()))
            .numbers(format!("{bytes} bytes from {offset} on; buffers[{buffer}] has {}", whole.bytes()))
            .next("check the file with a glTF validator, or export it again"));
        }
        Ok(whole.part(offset, bytes))
    }
}

/// The type that `componentType` names.
fn scalar_of(component_type: u32) -> Option<Scalar> {
    Some(match component_type {
        5120 => Scalar::I8,
        5121 => Scalar::U8,
        5122 => Scalar::I16,
        5123 => Scalar::U16,
        5125 => Scalar::U32,
        5126 => Scalar::F32,
        5130 => Scalar::F64,
        _ => return None,
    })
}
