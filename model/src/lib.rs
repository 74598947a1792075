//! trex-model: a model opened: file, pool of pages, memory limit, threads and session, put together.
//!
//! Life of a model: [`Model::open`] checks the tables of a page file and leases their memory. The first thing that asks
//! for pages, a session or rays, starts the pool, in the frames that the memory limit leaves beside it. What comes
//! later makes room for itself among these frames. Everything is owned: a [`Model`] is a handle that can be cloned,
//! sent and called from several threads, and a [`Session`] keeps what it needs of it alive.
//!
//! ```text
//! Model::open -> intersect, occluded          rays of the caller, exact
//!             -> render                       a picture
//!             -> session -> apply, render     pictures at leisure
//!             -> live    -> apply, frame      pictures in frames with a deadline
//!             -> show                         a live session in pages of a browser (feature `view`)
//! PictureParts::open -> strips                a picture out of parts that many machines rendered
//! ```
//!
//! Floors: each imports those before it alone: `device`, `options`, `info`, `scene_defaults`, `shared_pool`, `outline`,
//! `handle`, `opening`, `rays`, `picture`, `picture_parts`, `show`. Apart from these `times` and `ray_rates`: what a
//! caller makes of reports of frames and counts of rays.
//!
//! This crate knows no flags and no terminal: it never prints, exits or reads the environment.

mod device;
mod handle;
mod info;
mod opening;
mod options;
mod outline;
mod picture;
mod picture_parts;
mod ray_rates;
mod rays;
mod scene_defaults;
mod shared_pool;
#[cfg(feature = "view")]
mod show;
mod times;

/// The example of the README is compiled with the others.
#[cfg(doctest)]
#[doc = include_str!("../../README.md")]
struct Readme;

pub use device::{Device, DeviceOptions, DeviceReport, GpuFigures, StageSource};
pub use handle::{LiveSession, Model, Session};
pub use info::ModelInfo;
pub use options::{DamagePolicy, OpenOptions, Pace, SessionOptions, ThreadSource};
pub use picture::Picture;
pub use picture_parts::{MergedFiles, PictureParts, part_head, read_head};
pub use ray_rates::RayRates;
pub use rays::{AllHits, check_rays};
pub use scene_defaults::{open_scene, set_direct_without_voxels};
#[cfg(feature = "view")]
pub use show::ShownModel;
pub use times::Times;
