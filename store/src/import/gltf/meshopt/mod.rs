//! The codecs of `EXT_meshopt_compression` and `KHR_meshopt_compression`: vertices (versions 0 and 1), triangles, index
//! sequences, and the filters of positions and rotations. After the extensions' text and `vertexcodec.cpp`,
//! `indexcodec.cpp` and `vertexfilter.cpp` of zeux/meshoptimizer, whose Rust port is the oracle of the tests.
//!
//! Invariants: 1. a decoder holds one block, and a window of what it decodes; 2. any bytes give rows or an error.

mod feed;
mod filters;
mod indices;
mod vertices;

pub(super) use feed::Feed;
pub(super) use filters::{exponentials, quaternions};
pub(super) use indices::{IndexDecoder, SequenceDecoder};
pub(super) use vertices::RowDecoder;
