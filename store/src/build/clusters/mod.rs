//! Clusters and pages of one chunk.
//!
//! ```text
//! chunk -> `workspace`: its triangles, read from scratch -> `clusterer`, by `sah`: clusters of 128 and a binary tree
//!       -> `pages`: 8-wide nodes, packed with their clusters; `open_page`: the last one; `packed_page`: all others
//! ```

pub(super) mod clusterer;
pub(super) mod open_page;
pub(super) mod packed_page;
pub(super) mod pages;
pub(super) mod sah;
pub(super) mod workspace;
