//! Workload `rays`: how many rays per second, ours and a peer's, on the same mesh with the same rays and threads.
//!
//! ```text
//! file -> resident, or pooled where the limit has no room -> ray sets (`sets`)
//! for each set: one round unmeasured, then rounds in which the contenders (`contender`) take turns
//! figures: medians over the rounds; ratios, by processor time, are medians of the rounds' own ratios
//! a device (`device`): the sets through the voxels in calls, beside lanes and the scalar walk (`scalar_stage`)
//! closest hits of the peer are compared ray by ray, disagreements settled in f64 (`compare`)
//! ```
//!
//! Invariants: 1. `result_hash` depends on file, resolution and seed alone: not on threads, limit or pages; 2. every
//! round of ours gives the answers of the first.

mod compare;
mod contender;
mod device;
mod device_course;
mod falsehood;
mod figures;
mod gray;
mod mesh;
mod options;
mod peer;
mod run;
mod scalar_stage;
mod sets;
mod turns;
mod visits;

pub use compare::Agreement;
pub use device::{DeviceFigures, MixFigures};
pub use device_course::DeviceSetFigures;
pub use falsehood::AgainstMesh;
pub use figures::{ModeFigures, ModeSet, PeerFigures, RayFigures, SetFigures, SingleFigures};
pub use options::{Peer, RayOptions};
pub use run::run;
pub use visits::{SetVisits, TreeVisits, VisitFigures};
#[cfg(feature = "peer-embree")]
pub(crate) use {
    contender::{Contender, MISS, RayAnswer, spread},
    mesh::decode,
    peer::PeerSetup,
    sets::{BenchRay, Query, RaySet},
};
