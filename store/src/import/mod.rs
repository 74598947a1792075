//! Importers: triangle meshes in files, as streams of triangles. Start at [`open`].
//!
//! ```text
//! file -> Input (a window) -> Text (words) ----> ObjSource, StlTextSource, ascii PlySource
//!                        `-> records ----------> StlSource, binary PlySource
//!      `-> JSON, rows of accessors -----------> GltfSource
//!      `-> a header, slices of samples -------> VolumeSource
//! vertices by index: VertexCache                 faces to triangles: Polygon
//! ```
//!
//! Invariants: 1. no importer holds the mesh: memory is a window, the corners of a face, and a vertex cache, all
//! leased before they are taken; 2. no count, length or index of the file is believed before it was compared with
//! the file's length or with a constant here; 3. any bytes give triangles or an `Error`, never a panic.

mod gltf;
mod input;
mod material_pictures;
mod materials;
mod mtl;
mod obj;
mod options;
mod picture;
mod ply;
mod polygon;
mod scalar;
mod sniff;
mod stl;
mod stl_text;
#[cfg(test)]
mod tests;
mod text;
mod vertices;
mod volume;

use crate::error::Result;
use crate::source::{SourceStats, TriangleSource};
use input::Input;
use std::path::{Path, PathBuf};

pub use options::{ImportOptions, MaterialNaming, RawVolume, TextureUse, VolumeOptions};
pub use scalar::ByteOrder;
pub use sniff::{Encoding, Format};
pub use volume::{MAX_ISO_VALUES, SamplePacking, SampleType, VolumeInfo};

/// Most warnings that a source keeps.
const MAX_WARNINGS: usize = 16;

/// An input's own words about itself. Nothing of it has been checked beyond the file's length.
#[derive(Clone, Debug, serde::Serialize)]
pub struct InputInfo {
    /// The file format.
    pub format: Format,
    /// Text or numbers.
    pub encoding: Encoding,
    /// Length of the file.
    pub file_bytes: u64,
    /// Vertices that the header declares; `None` where only reading tells.
    pub vertex_count: Option<u64>,
    /// Faces (PLY: faces and strips) that the header declares; `None` where only reading tells.
    pub face_count: Option<u64>,
    /// What a volume is; `None` for meshes.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub volume: Option<VolumeInfo>,
    /// Other files that it names, there or not: buffers and pictures of a glTF file, the samples of a volume's header,
    /// the MTL files that an OBJ file names in front of its vertices.
    #[serde(skip)]
    pub named_files: Vec<PathBuf>,
}

/// Opens a mesh file, or a volume, as a stream of triangles. The format comes from the file's ending (`.ply`, `.obj`,
/// `.stl`, `.gltf`, `.glb`; `.nrrd`, `.nhdr`, `.mhd`, `.mha`, `.raw`; in any case), which its content must not
/// contradict; other endings are decided by content where that is unambiguous.
///
/// # Errors
/// `Code::Input*` with path and line or byte offset; [`crate::Code::MemoryLimit`] when the budget has no room for
/// the fixed parts (about 2 MiB). Errors in the body come from the stream.
///
/// ```
/// use trex_store::import::{ImportOptions, open};
/// use trex_store::{TriangleBatch, TriangleSource};
/// # let folder = tempfile::tempdir().unwrap();
/// # let path = folder.path().join("square.obj");
/// std::fs::write(&path, "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n").unwrap();
/// let mut source = open(&path, &ImportOptions::unlimited(folder.path()))?;
/// let mut batch = TriangleBatch::default();
/// while source.next_batch(&mut batch)? {
///     assert_eq!(batch.len(), 2);
/// }
/// # Ok::<(), trex_store::Error>(())
/// ```
pub fn open(path: &Path, options: &ImportOptions) -> Result<Box<dyn TriangleSource>> {
    let mut input = Input::open(path, options)?;
    Ok(match sniff::format(&mut input)? {
        format @ (Format::Gltf | Format::Glb) => Box::new(gltf::open(input, format, options)?),
        format @ (Format::Nrrd | Format::MetaImage | Format::Raw) => volume::open(input, format, options)?,
        Format::Ply => ply::open(input, options)?,
        Format::Obj => Box::new(obj::ObjSource::new(input, options)?),
        Format::Stl => match stl::form(&mut input)? {
            stl::StlForm::Ascii => Box::new(stl_text::StlTextSource::new(input, options)?),
            stl::StlForm::Binary { count } => Box::new(stl::StlSource::new(input, count)),
        },
    })
}

/// Reads what `path` declares, without loading it. No scratch file is made.
///
/// # Errors
/// Those of [`open`].
pub fn info(path: &Path, options: &ImportOptions) -> Result<InputInfo> {
    let mut input = Input::open(path, options)?;
    let format = sniff::format(&mut input)?;
    let file_bytes = input.length();
    let (mut volume, mut named_files) = (None, Vec::new());
    let (encoding, vertex_count, face_count) = match format {
        Format::Gltf | Format::Glb => {
            let source = gltf::counted(input, format, options)?;
            named_files = source.named_files();
            gltf::declared(&source, format)
        }
        Format::Nrrd | Format::MetaImage | Format::Raw => {
            let (encoding, declared) = volume::declared(input, format, options)?;
            named_files.extend(Some(PathBuf::from(&declared.sample_file)).filter(|file| file != path));
            volume = Some(declared);
            (encoding, None, None)
        }
        Format::Ply => ply::declared(&mut input)?,
        Format::Obj => {
            named_files = obj::named_files(input)?;
            (Encoding::Ascii, None, None)
        }
        Format::Stl => match stl::form(&mut input)? {
            stl::StlForm::Ascii => (Encoding::Ascii, None, None),
            stl::StlForm::Binary { count } => (Encoding::BinaryLittleEndian, None, Some(count)),
        },
    };
    Ok(InputInfo { format, encoding, file_bytes, vertex_count, face_count, volume, named_files })
}

/// Adds a warning once, and no more than there is room for.
fn warn(stats: &mut SourceStats, warning: String) {
    if stats.warnings.len() < MAX_WARNINGS && !stats.warnings.contains(&warning) {
        stats.warnings.push(warning);
    }
}
