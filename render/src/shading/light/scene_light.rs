//! `Light`: a light of the scene, and whether its numbers make sense.

use crate::math::unit;
use glam::DVec3;
use trex_store::{Code, Error, Result};

/// A light of the scene. Emissive triangles of the model are not among these: see [`super::Emitter`].
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(tag = "type", rename_all = "lowercase", deny_unknown_fields)]
pub enum Light {
    /// A point that shines alike in all directions.
    Point {
        /// Place, model units.
        position: [f64; 3],
        /// Radiant intensity, W/sr in linear RGB: irradiance = intensity * cos / distance^2.
        intensity: [f32; 3],
    },
    /// A sun: parallel rays from infinitely far.
    Directional {
        /// Direction in which the light travels; any length.
        direction: [f64; 3],
        /// Irradiance on a surface that faces it, W/m^2 in linear RGB.
        irradiance: [f32; 3],
    },
    /// A parallelogram that shines from the side of `edge_u x edge_v`.
    Rect {
        /// A corner, model units.
        corner: [f64; 3],
        /// Edge from the corner to the next one, model units.
        edge_u: [f64; 3],
        /// Edge from the corner to the one on the other side, model units.
        edge_v: [f64; 3],
        /// Radiance that leaves the front, W/(m^2 sr) in linear RGB.
        radiance: [f32; 3],
    },
    /// A sky: one radiance from every direction in which nothing is hit. Several add up.
    Sky {
        /// Radiance, W/(m^2 sr) in linear RGB.
        radiance: [f32; 3],
    },
}

impl Light {
    /// Checks that the numbers make sense.
    ///
    /// # Errors
    /// [`Code::SceneFormat`] at `place` (the name of the light): numbers that are not finite or, for light,
    /// negative; a direction of length 0; a rectangle without an area.
    pub fn check(&self, place: &str) -> Result<()> {
        let bad = |what: &str, numbers: String, next: &str| {
            Err(Error::new(Code::SceneFormat, what).at_place(place).numbers(numbers).next(next))
        };
        let (light, vectors): ([f32; 3], [[f64; 3]; 3]) = match *self {
            Light::Point { position, intensity } => (intensity, [position, [0.0; 3], [0.0; 3]]),
            Light::Directional { direction, irradiance } => (irradiance, [direction, [0.0; 3], [0.0; 3]]),
            Light::Rect { corner, edge_u, edge_v, radiance } => (radiance, [corner, edge_u, edge_v]),
            Light::Sky { radiance } => (radiance, [[0.0; 3]; 3]),
        };
        if light.iter().any(|x| !x.is_finite() || *x < 0.0) {
            return bad(
                "a light that gives no proper amount",
                format!("{light:?}"),
                "give finite numbers >= 0",
            );
        }
        if vectors.as_flattened().iter().any(|x| !x.is_finite()) {
            return bad("a light that is nowhere", format!("{vectors:?}"), "give finite numbers");
        }
        match *self {
            Light::Directional { direction, .. } if unit(direction.into()).is_none() => bad(
                "a light without a direction",
                format!("{direction:?}"),
                "give a direction that is not zero",
            ),
            Light::Rect { edge_u, edge_v, .. }
                if unit(DVec3::from(edge_u).cross(edge_v.into())).is_none() =>
            {
                let numbers = format!("edge_u {edge_u:?}, edge_v {edge_v:?}");
                bad("a rectangle without an area", numbers, "give two edges that are not parallel")
            }
            _ => Ok(()),
        }
    }
}
