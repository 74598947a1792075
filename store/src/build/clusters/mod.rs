//! Clusters and pages of one chunk.
//!
//! ```text
//! chunk -> `workspace`: its triangles, read from scratch -> `clusterer`, by `sah`: clusters of 128 and a binary tree
//!       -> `pages`: 8-wide nodes, packed with their clusters
//! ```

pub(super) mod clusterer;
pub(super) mod pages;
pub(super) mod sah;
pub(super) mod workspace;
