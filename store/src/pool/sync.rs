//! The atomics of the page word: std's, or loom's when the model checker runs (`--cfg loom`).
//!
//! Invariant: `word.rs` names atomics through this module only, so that loom sees every access to a word.

#[cfg(loom)]
pub(super) use loom::sync::atomic::{AtomicU64, Ordering};
#[cfg(not(loom))]
pub(super) use std::sync::atomic::{AtomicU64, Ordering};
