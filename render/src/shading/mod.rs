//! Shading: how surfaces scatter, where rays meet them, and what gives light.

pub(crate) mod bsdf;
pub(crate) mod light;
pub(crate) mod surface;

pub use light::{Emitter, Emitters, Light};
