//! The scene: its text, camera and settings, and the world that integrators read.

pub(crate) mod camera;
pub(crate) mod edit;
pub(crate) mod exposure;
pub(crate) mod framing;
pub(crate) mod key;
pub mod keys;
pub(crate) mod method;
pub(crate) mod part_keys;
pub(crate) mod settings;
pub(crate) mod text;
mod views;
pub(crate) mod world;

pub use views::parse_views;
