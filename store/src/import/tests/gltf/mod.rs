//! glTF: what each encoding delivers, what is refused, and the codecs of compressed views. The files are made by a
//! writer of these tests (`glb.rs`), which shares nothing with the reader; real ones are read by the `gltf` crate as
//! well.

mod colours;
#[cfg(feature = "draco")]
mod draco;
mod encodings;
mod glb;
mod meshopt;
mod real;
mod refusals;
mod scene;
mod textures;

pub(super) use glb::{NormalsGlb, small_glb};
