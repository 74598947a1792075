//! Atomics, locks and conditions of the pool: std's, or loom's when the model checker runs (`--cfg loom`).
//!
//! Invariant: the files of the pool whose interleavings `loom_tests.rs` models name them through this module only, so
//! that loom sees every access.

#[cfg(loom)]
pub(super) use loom::sync::atomic::{AtomicBool, AtomicU64, Ordering, fence};
#[cfg(loom)]
pub(super) use loom::sync::{Condvar, Mutex, MutexGuard};
#[cfg(not(loom))]
pub(super) use std::sync::atomic::{AtomicBool, AtomicU64, Ordering, fence};
#[cfg(not(loom))]
pub(super) use std::sync::{Condvar, Mutex, MutexGuard};
