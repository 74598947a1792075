//! The figures of `rays`, as its JSON shows them.

use super::compare::Agreement;
use super::device::DeviceFigures;
use super::falsehood::AgainstMesh;
use super::visits::VisitFigures;
use serde::Serialize;
use std::collections::BTreeMap;

/// Figures of a run.
#[derive(Clone, Debug, Serialize)]
pub struct RayFigures {
    /// The model.
    pub scene: String,
    /// Seed of the gather rays.
    pub seed: u64,
    /// Hash of our answers: who is hit by every ray of every set.
    pub result_hash: String,
    /// Triangles of the model.
    pub triangle_count: u64,
    /// Worker threads.
    pub thread_count: usize,
    /// Measured rounds.
    pub round_count: usize,
    /// Width and height.
    pub resolution: [u32; 2],
    /// Our kernel.
    pub arithmetic: String,
    /// `resident` or `pooled`.
    pub pages: String,
    /// Frames and tables that the model takes, or may take, in memory.
    pub resident_bytes: u64,
    /// The same per triangle.
    pub resident_bytes_per_triangle: f64,
    /// From the camera, closest hit; in packets where all pages are in memory.
    pub primary: SetFigures,
    /// Towards a light, any hit; in packets like these.
    pub shadow: SetFigures,
    /// Cosine-distributed, closest hit.
    pub incoherent: SetFigures,
    /// As `primary`, each hit with its colour and its shading normal; `None` for a mesh without.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub primary_shaded: Option<SetFigures>,
    /// As `incoherent`, each hit with these.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub incoherent_shaded: Option<SetFigures>,
    /// Leaves of the voxels along the model's longest side; `None` for a file without, or where they did not fit.
    pub voxel_resolution: Option<u32>,
    /// The same through the voxels, in batches, against the peer's rays on the mesh; `None` for a file without voxels.
    pub gray: Option<SetFigures>,
    /// Shadow rays through the voxels.
    pub gray_shadow: Option<SetFigures>,
    /// Finest leaves along the model's longest side; `None` for a file without units, or where they did not fit.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub finest_resolution: Option<u32>,
    /// As `gray`, through units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gray_finest: Option<SetFigures>,
    /// As `gray_shadow`, through units.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gray_finest_shadow: Option<SetFigures>,
    /// A device on the same rays through the voxels, where one was asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub device: Option<DeviceFigures>,
    /// Visits per ray, where they were asked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub visits: Option<VisitFigures>,
    /// The peer, where one was asked for.
    pub peer: Option<PeerFigures>,
}

/// Figures of a set.
#[derive(Clone, Debug, Serialize)]
pub struct SetFigures {
    /// Rays.
    pub ray_count: usize,
    /// Of these, with a hit.
    pub hit_count: usize,
    /// Rays per second of wall time, median.
    pub per_s: f64,
    /// Rays per second of processor time, median: what one core does when it is not shared.
    pub per_core_s: f64,
    /// Ours over the peer's reference mode, by processor time.
    pub ratio: Option<f64>,
    /// Of rays that go in packets or batches: the same rays one by one.
    pub single: Option<SingleFigures>,
    /// How often voxels answered falsely; `None` for sets that ask the mesh.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub against_mesh: Option<AgainstMesh>,
}

/// Rays one by one.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct SingleFigures {
    /// Rays per second of wall time, median.
    pub per_s: f64,
    /// Rays per second of processor time, median.
    pub per_core_s: f64,
}

/// Figures of a peer.
#[derive(Clone, Debug, Serialize)]
pub struct PeerFigures {
    /// Name.
    pub name: String,
    /// Version.
    pub version: String,
    /// Primary rays, ours (in packets where they go so) over its reference mode.
    pub ratio: f64,
    /// The mode that `ratio` and the sets' ratios refer to.
    pub reference: String,
    /// Its mesh: positions and indices, bytes.
    pub mesh_bytes: u64,
    /// Every mode: key is the mode's name.
    pub mode: BTreeMap<String, ModeFigures>,
    /// Closest hits against the reference mode, primary and incoherent together.
    pub closest: Agreement,
    /// Shadow rays whose answers differ.
    pub shadow_difference_count: usize,
}

/// Figures of one mode of a peer.
#[derive(Clone, Debug, Default, Serialize)]
pub struct ModeFigures {
    /// Its tree as its own memory monitor counts it.
    pub tree_bytes: u64,
    /// Tree per triangle.
    pub tree_bytes_per_triangle: f64,
    /// Tree and mesh over our resident bytes.
    pub memory_ratio: f64,
    /// Time of its build.
    pub build_ms: f64,
    /// Per set: rays per second, and ours over it.
    #[serde(flatten)]
    pub sets: BTreeMap<&'static str, ModeSet>,
}

/// A mode's speed on a set.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct ModeSet {
    /// Rays per second of wall time, median.
    pub per_s: f64,
    /// Rays per second of processor time, median.
    pub per_core_s: f64,
    /// Ours over it by processor time, median of the rounds' own ratios.
    pub ratio: f64,
    /// The same of our rays one by one, where `ratio` is of packets or batches.
    pub single_ratio: Option<f64>,
    /// `ratio` by wall time.
    pub wall_ratio: f64,
}
