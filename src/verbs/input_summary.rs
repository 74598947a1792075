//! What a mesh or a volume says of itself, as `trex info` tells it.

use crate::size;
use serde::Serialize;
use std::fmt;
use trex_store::import::{Encoding, Format, InputInfo, SamplePacking, VolumeInfo};
use trex_store::printable::one_line;

/// What the head of a file declares.
#[derive(Serialize)]
pub struct InputSummary {
    pub scene: String,
    #[serde(flatten)]
    pub info: InputInfo,
}

impl fmt::Display for InputSummary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let info = &self.info;
        let encoding = match info.encoding {
            Encoding::Ascii => "text",
            Encoding::BinaryLittleEndian => "binary, little-endian",
            Encoding::BinaryBigEndian => "binary, big-endian",
        };
        let format = match info.format {
            Format::Ply => "PLY",
            Format::Obj => "OBJ",
            Format::Stl => "STL",
            Format::Gltf | Format::Glb => "glTF",
            Format::Nrrd => "NRRD",
            Format::MetaImage => "MetaImage",
            Format::Raw => "samples",
        };
        write!(f, "{}: {format} ({encoding}), {}", one_line(&self.scene), size::bytes(info.file_bytes))?;
        for (what, count) in [("vertices", info.vertex_count), ("faces", info.face_count)] {
            if let Some(count) = count {
                write!(f, ", {} {what} declared", size::count(count))?;
            }
        }
        if let Some(VolumeInfo { size: [x, y, z], sample_type, packing, origin, steps, .. }) = &info.volume {
            let packed = if *packing == SamplePacking::None { "" } else { ", packed" };
            write!(
                f,
                ", {x} x {y} x {z} samples of {}{packed}, origin {origin:?}, steps {steps:?}",
                sample_type.name()
            )?;
        }
        Ok(())
    }
}
