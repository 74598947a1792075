//! What gives light: one list of sources, which light samples, rays and photons ask.

mod box_tree;
mod emit;
mod emitter;
mod lights;
mod sample;
mod scene_light;

pub(crate) use emit::{Emission, PhotonSources};
pub use emitter::{Emitter, Emitters};
pub(crate) use lights::{Lights, SkyBy};
pub(crate) use sample::LightSample;
pub use scene_light::Light;
