//! What the tests of several floors share.

use crate::scene::camera::{Camera, Fov};
use crate::scene::settings::{RenderKeys, RenderSettings};
use crate::scene::world::View;
use crate::shading::light::Light;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::sync::Arc;

/// A pool of so many threads.
pub(crate) fn pool(threads: usize) -> Arc<ThreadPool> {
    Arc::new(ThreadPoolBuilder::new().num_threads(threads).build().unwrap())
}

/// Settings of these keys, which go together.
pub(crate) fn settings(keys: RenderKeys) -> RenderSettings {
    RenderSettings::new(keys).unwrap()
}

/// A view from `position` to the origin, with +y up and an angle of `fov_x` degrees across.
pub(crate) fn view(position: [f64; 3], fov_x: f64, lights: Vec<Light>, keys: RenderKeys) -> View {
    let camera = Camera { position, target: [0.0; 3], up: [0.0, 1.0, 0.0], fov: Fov::X(fov_x) };
    View { camera, lights, settings: settings(keys), parts: Arc::default() }
}
