//! How a stream is decoded: by `draco-core`, under limits of what it may hold.

use super::super::bytes::{BufferPlace, ByteSource, Spool};
use super::super::row_layout::RowLayout;
use super::{DracoStream, StreamPart};
use crate::error::{Code, Error, Result};
use crate::import::scalar::Scalar;
use draco_core::{DataType, DecodeLimits, DecoderBuffer, Mesh, MeshDecoder, PointIndex};

/// What the decoder takes at most, by the count of an allocator (`import/tests/gltf/draco.rs`): for a triangle, for a
/// vertex, and for a byte of a vertex.
const TRIANGLE_BYTES: u64 = 128;
const VERTEX_BYTES: u64 = 48;
const PER_VALUE_BYTE: u64 = 5;

impl DracoStream {
    /// Decodes the stream into the spool: the rows of each accessor.
    ///
    /// # Errors
    /// [`Code::InputFormat`] where the bytes are no such stream; those of the budget where the primitive is larger than
    /// memory allows.
    pub(in super::super) fn decode(&self, spool: &mut Spool) -> Result<Vec<(u32, BufferPlace)>> {
        let value_bytes = self.vertex_count.saturating_mul(self.vertex_bytes);
        let parts = [
            self.place.bytes(),
            self.triangle_count.saturating_mul(TRIANGLE_BYTES),
            self.vertex_count.saturating_mul(VERTEX_BYTES),
            value_bytes.saturating_mul(PER_VALUE_BYTE),
        ];
        let most = parts.into_iter().fold(0, u64::saturating_add);
        let lease = spool.budget().lease("a primitive that is compressed with Draco", most);
        let _lease = lease.map_err(|error| error.at_place(self.named()))?;
        let mut packed = vec![0; self.place.bytes() as usize];
        ByteSource::open(&self.place, spool)?.read(0, &mut packed)?;
        let limits = DecodeLimits::default()
            .with_max_points(self.vertex_count)
            .with_max_faces(self.triangle_count)
            .with_max_decoded_bytes(value_bytes);
        let mut mesh = Mesh::new();
        MeshDecoder::new()
            .decode(&mut DecoderBuffer::new(&packed).with_limits(limits), &mut mesh)
            .map_err(|error| self.damaged(error.message()))?;
        let found = [mesh.num_points() as u64, mesh.num_faces() as u64];
        if found != [self.vertex_count, self.triangle_count] {
            return Err(self.damaged(&format!("it has {} vertices and {} triangles", found[0], found[1])));
        }
        let write = |part: &StreamPart| {
            let place = match part.attribute {
                Some(attribute) => self.write_values(&mesh, attribute, &part.layout, spool)?,
                None => write_indices(&mesh, spool)?,
            };
            Ok((part.accessor, place))
        };
        self.parts.iter().map(write).collect()
    }

    /// Writes the values of an attribute, vertex by vertex.
    fn write_values(
        &self,
        mesh: &Mesh,
        attribute: u32,
        layout: &RowLayout,
        spool: &mut Spool,
    ) -> Result<BufferPlace> {
        let values = mesh
            .attribute_by_unique_id(attribute)
            .ok_or_else(|| self.damaged(&format!("it has no attribute {attribute}")))?;
        let (kind, components) = (values.data_type(), usize::from(values.num_components()));
        if scalar_of(kind) != Some(layout.scalar) || components != layout.components {
            let (scalar, wanted) = (layout.scalar, layout.components);
            return Err(self.damaged(&format!(
                "its attribute {attribute} has {components} numbers of {kind:?}, its accessor {wanted} of {scalar:?}"
            )));
        }
        let (bytes, row_bytes) = (values.buffer().data(), layout.row_bytes());
        let mut writer = spool.writer()?;
        for point in 0..mesh.num_points() {
            let value = values.mapped_index(PointIndex(point as u32)).0 as usize;
            let from = value.saturating_mul(row_bytes);
            let row = bytes.get(from..from.saturating_add(row_bytes));
            writer.write(row.ok_or_else(|| self.damaged("a vertex has no value"))?)?;
        }
        writer.finish()
    }

    fn named(&self) -> String {
        format!("{}: bufferViews[{}]", self.path.display(), self.view)
    }

    fn damaged(&self, why: &str) -> Error {
        Error::new(
            Code::InputFormat,
            "a primitive of the glTF file that is compressed with Draco cannot be decoded",
        )
        .at_place(self.named())
        .numbers(format!(
            "{why}; {} bytes, and its accessors have {} vertices and {} triangles",
            self.place.bytes(),
            self.vertex_count,
            self.triangle_count
        ))
        .next("export the file again, or unpack it: gltf-transform copy IN OUT")
    }
}

fn write_indices(mesh: &Mesh, spool: &mut Spool) -> Result<BufferPlace> {
    let mut writer = spool.writer()?;
    for index in mesh.faces().as_flattened() {
        writer.write(&index.0.to_le_bytes())?;
    }
    writer.finish()
}

/// The type of numbers of an attribute, where accessors have it.
fn scalar_of(kind: DataType) -> Option<Scalar> {
    Some(match kind {
        DataType::Int8 => Scalar::I8,
        DataType::Uint8 => Scalar::U8,
        DataType::Int16 => Scalar::I16,
        DataType::Uint16 => Scalar::U16,
        DataType::Uint32 => Scalar::U32,
        DataType::Float32 => Scalar::F32,
        DataType::Float64 => Scalar::F64,
        _ => return None,
    })
}
