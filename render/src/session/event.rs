//! `Event`: what a session is told.

use crate::scene::camera::Camera;
use crate::scene::settings::RenderSettings;
use crate::scene::world::MaterialEdit;
use crate::shading::light::Light;
use crate::trace::Parts;
use std::sync::Arc;

/// A change by the user.
#[derive(Clone, Debug)]
pub enum Event {
    /// Another camera.
    Camera(Camera),
    /// Other lights; all of them.
    Lights(Vec<Light>),
    /// Changes to the material with this index.
    Material {
        /// Index into the model's materials.
        index: usize,
        /// Changes to it.
        edit: MaterialEdit,
    },
    /// Other parts of the model are shown.
    Parts(Arc<Parts>),
    /// Other numbers of the picture; photons stay where they are the same.
    Settings(RenderSettings),
}
