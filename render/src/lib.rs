//! trex-render: rays to picture.
//!
//! Life of a sample: the [`Scene`] text and the [`Model`] make a [`World`]; a [`Session`] hands out tiles of the
//! picture to its workers; for each pixel and sample index an integrator draws numbers, asks the [`Projection`] for a
//! ray and a [`Tracer`] for what it meets, sums light over the material, and adds the radiance to the [`Film`], which
//! [`write_png`] or [`write_exr`] encodes. A session takes [`Event`]s while the user edits.
//!
//! Floors: each folder imports those above it alone.
//!
//! ```text
//! math sampler sampling stats threads
//! trace       C-rays on clusters
//! voxel       G-rays on the voxel octree
//! g_stage     the seam for what answers them in batches
//! shading     BSDF, surfaces, light
//! scene       text, views, camera, settings, world
//! photon      photons through mesh and voxels, and the light that they bring
//! integrate   one module an integrator behind one trait
//! schedule    tiles over workers, out of core
//! session     events to pictures
//! ```
//!
//! What a picture is kept and shown in, the film and the display, is a crate of its own below this one: `trex_film`,
//! whose names are given again here.
//!
//! This crate does no I/O: it parses scenes from `&str`, encodes pictures to `Write`, and names pages by id.

mod g_stage;
mod integrate;
mod math;
mod photon;
mod sampler;
mod sampling;
mod scene;
mod schedule;
mod session;
mod shading;
mod stats;
#[cfg(test)]
mod testing;
mod threads;
mod trace;
mod voxel;

pub use g_stage::{CpuStage, GCall, GEnd, GNeeds, GRays, GStage, GTurn, GUnits, GView};
pub use photon::irradiance::{MapForm, PhotonMap};
pub use scene::camera::{Camera, FOV_MAX_DEGREES, FOV_MIN_DEGREES, Fov, Projection, SIDE_MAX_PIXELS};
pub use scene::edit::{Quality, RenderEdit};
pub use scene::exposure::Exposure;
pub use scene::framing::{FramedView, up_axis};
pub use scene::key::{Choice, Elsewhere, Key, KeyKind, KeyValue};
pub use scene::keys;
pub use scene::method::{Filter, LightRig, Method, Near, Shadows, UpAxis};
pub use scene::parse_views;
pub use scene::part_keys::PartKeys;
pub use scene::settings::{RenderKeys, RenderSettings};
pub use scene::text::{CameraKeys, Scene};
pub use scene::world::{MaterialEdit, Model, View, World};
pub use session::{
    BLOCK_TILES_MIN, Event, FetchBlock, FrameOptions, FrameProgress, FrameReport, LiveSession, MemoryPlan,
    Pick, PictureNeeds, RenderStats, Session, SessionSetup, TileStamp,
};
pub use shading::{Emitter, Emitters, Light};
pub use stats::{GStats, PassStats, PhotonStats, RayCounts};
pub use threads::WorkerThreads;
pub use trace::{
    AllResident, Answer, Arithmetic, HITS_PER_RAY, Hit, MeshTracer, MeshTriangle, NaiveMesh, NaiveTriangle,
    OpenParts, Page, PagedMesh, PagedTracer, Pages, PartNeeds, Parts, PooledPages, Ray, SECTIONS_MAX,
    Section, ShadedHit, Tracer, crossings_all, intersect_all, intersect_shaded_all, occluded_all,
    pooled_tracers, read_triangles, seated_tracers,
};
pub use trex_film::{
    Brightness, CAMERA_NUMBERS, Display, Film, Image, LayerPixel, Layers, MergeSetup, MergedStrips, Misfit,
    NO_ID, PART_MAGIC, PartDifference, PartFile, PartHead, Portion, STEPS, Saliency, Strips,
    TILE_SIDE_PIXELS, Tile, TileOrder, Tiles, digest, encoder_bytes, film_bytes, filter_bytes, merge_bytes,
    misfit, tile_count, write_exr, write_exr_strips, write_part, write_png, write_png_strips,
};
pub use voxel::{
    GAnswer, GKind, GRay, LowerHit, LowerLeaf, LowerScene, MissingUnits, Occluders, PacketWidth, VoxelHit,
    VoxelScene, Voxels,
};
