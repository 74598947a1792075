//! trex-render: rays to picture.
//!
//! Life of a sample: the [`scene`] text and the model make a [`world`]; the [`frame`] loop hands out tiles
//! ([`tile`]); for each pixel and sample index the [`integrator`] draws numbers ([`sampler`]), asks the
//! [`camera`] for a ray and a [`trace::Tracer`] for what it meets, sums [`light`] over the [`material`], and
//! adds the radiance to the [`film`], which [`picture`] encodes. A [`session`] holds all of it while the user
//! edits.
//!
//! This crate does no I/O: it parses scenes from `&str`, encodes pictures to `Write`, and names pages by id.

mod ao;
pub mod camera;
mod debug;
mod direct;
pub mod emitter;
pub mod film;
pub mod filter;
mod footprint;
pub mod frame;
mod frames;
mod full_gi;
mod g_batch;
pub mod indirect;
pub mod integrator;
pub mod light;
pub mod live;
pub mod material;
mod math;
mod path;
mod photon;
mod photon_flight;
pub mod photon_tree;
pub mod picture;
pub mod saliency;
pub mod sampler;
pub mod scene;
pub mod session;
mod surface;
pub mod tile;
pub mod trace;
pub mod voxel;
pub mod world;
