//! `SourceScene`: what an input says of cameras and lights. None of it goes into a page file: who builds may write it
//! beside one, as a scene.
//!
//! Invariants: 1. all numbers are finite; 2. there are at most [`SourceScene::LIGHTS_MAX`] lights.

use serde::{Deserialize, Serialize};

/// Camera and lights of an input, in its space.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SourceScene {
    /// The first camera with a perspective.
    pub camera: Option<SourceCamera>,
    /// Lights, in the order of the input.
    pub lights: Vec<SourceLight>,
}

/// A camera with a perspective.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SourceCamera {
    /// Where it is.
    pub position: [f64; 3],
    /// Where it looks, of length 1.
    pub direction: [f64; 3],
    /// What is above, of length 1.
    pub up: [f64; 3],
    /// Angle from the lower to the upper edge of the picture, degrees.
    pub fov_y_degrees: f64,
}

/// A light without an extent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum SourceLight {
    /// Shines from a point to all sides.
    Point {
        /// Where it is.
        position: [f64; 3],
        /// W/sr, linear RGB.
        intensity: [f64; 3],
        /// The input has it shine into a cone only.
        is_spot: bool,
    },
    /// Shines from far away.
    Directional {
        /// Which way the light travels, of length 1.
        direction: [f64; 3],
        /// W/m^2 on a surface that faces it, linear RGB.
        irradiance: [f64; 3],
    },
}

impl SourceScene {
    /// Most lights that are kept of an input.
    pub const LIGHTS_MAX: usize = 1024;

    /// True where there is nothing to write.
    pub fn is_empty(&self) -> bool {
        self.camera.is_none() && self.lights.is_empty()
    }

    /// Adds what another input says: its camera where there is none, and its lights while there is room.
    pub fn join(&mut self, other: SourceScene) {
        self.camera = self.camera.or(other.camera);
        let room = SourceScene::LIGHTS_MAX - self.lights.len();
        self.lights.extend(other.lights.into_iter().take(room));
    }
}
