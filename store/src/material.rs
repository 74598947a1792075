//! `Material`: modified Phong as MTL files state it.
//!
//! Invariants: 1. all numbers are finite and >= 0; 2. kd + ks <= 1 per channel; both hold after [`Material::checked`].

use crate::cluster::{Colour, WHITE};

/// A surface: diffuse and glossy reflection, emission, and whether it is a perfect mirror. Its name stands in a
/// [`MaterialNames`](crate::MaterialNames).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Diffuse reflectance, linear RGB.
    pub kd: [f32; 3],
    /// Specular reflectance, linear RGB.
    pub ks: [f32; 3],
    /// Phong exponent.
    pub ns: f32,
    /// Radiance that leaves the counter-clockwise side, linear RGB.
    pub ke: [f32; 3],
    /// Opacity in the input; drawn opaque whatever it says.
    pub d: f32,
    /// `illum` 3 or 5 with `ks` > 0: a perfect mirror.
    pub mirror: bool,
    /// Mean by area of the mesh's colours on it, sRGB, by which voxels multiply `kd`; white where it has none.
    pub mean_colour: Colour,
}

impl Default for Material {
    /// Diffuse grey 0.7, the surface of inputs without materials.
    fn default() -> Material {
        Material {
            kd: [0.7; 3],
            ks: [0.0; 3],
            ns: 1.0,
            ke: [0.0; 3],
            d: 1.0,
            mirror: false,
            mean_colour: WHITE,
        }
    }
}

impl Material {
    /// This material with non-finite and negative numbers set to zero, and `kd`, `ks` scaled together
    /// so that no channel reflects more than 1.
    pub fn checked(mut self) -> Material {
        let clean = |value: f32| if value.is_finite() && value > 0.0 { value } else { 0.0 };
        self.kd = self.kd.map(clean);
        self.ks = self.ks.map(clean);
        self.ke = self.ke.map(clean);
        self.ns = clean(self.ns).min(1e6);
        self.d = clean(self.d).min(1.0);
        let most = (0..3).map(|c| self.kd[c] + self.ks[c]).fold(0.0, f32::max);
        if most > 1.0 {
            self.kd = self.kd.map(|value| value / most);
            self.ks = self.ks.map(|value| value / most);
        }
        self.mirror &= self.ks.iter().any(|&value| value > 0.0);
        self
    }

    /// True when light that leaves it depends on where it is seen from.
    pub fn is_glossy(&self) -> bool {
        self.ks.iter().any(|&value| value > 0.0)
    }

    /// True when the counter-clockwise side gives light.
    pub fn emits(&self) -> bool {
        self.ke.iter().any(|&value| value > 0.0)
    }
}
