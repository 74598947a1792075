//! `RenderSettings`: the numbers of a picture, in one place from the scene file or the flags to the integrator.
//!
//! Invariant: a [`RenderSettings`] has every key in its range, and no key beside an integrator that has no use for it.

use super::camera::SIDE_MAX_PIXELS;
use crate::voxel::Occluders;
use std::ops::{Deref, RangeInclusive};
use trex_store::{Code, Error, Result};

/// Most samples a pixel.
pub const SPP_MAX: u32 = 1_000_000_000;
/// Most shadow rays at one path vertex.
pub const N_SHADOW_MAX: u32 = 4096;
/// Most gather rays at one surface point.
pub const N_GATHER_MAX: u32 = 4096;
/// Greatest error of the footprint rule, pixels.
pub const LOD_ERROR_MAX_PIXELS: f64 = 1024.0;
/// Most photons of a picture.
pub const PHOTONS_MAX: u64 = 1 << 40;
/// Most photons of `full-gi`, which keeps each: their hits are numbered in 32 bits.
pub const TREE_PHOTONS_MAX: u64 = 1 << 30;
/// Fewest photons of a look-up: one gives the distance, the others the light.
pub const K_NEAREST_MIN: u32 = 2;
/// Most photons of a look-up.
pub const K_NEAREST_MAX: u32 = 1024;

/// The way in which light is computed: the integrator.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Direct light and perfect mirrors: see `integrate/direct.rs`.
    #[default]
    Direct,
    /// All light, unbiased: see `integrate/path.rs`.
    Path,
    /// Ambient occlusion: see `integrate/ao.rs`.
    Ao,
    /// Photon mapping on voxels: see `integrate/photon.rs`. Also called `cpu-gi`: all of it runs on the CPU.
    #[serde(alias = "cpu-gi")]
    Photon,
    /// Photon mapping on the exact mesh: see `integrate/final_gather.rs`.
    #[serde(rename = "full-gi")]
    FullGi,
    /// The leaves of the voxel octree: see `integrate/debug.rs`.
    #[serde(rename = "debug-upper")]
    DebugUpper,
    /// The finest voxels, through the units below it.
    #[serde(rename = "debug-lower")]
    DebugLower,
    /// The bitmaps of the resident octree.
    #[serde(rename = "debug-occluders")]
    DebugOccluders,
    /// The pages of the mesh.
    #[serde(rename = "debug-pages")]
    DebugPages,
}

impl Method {
    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            Method::Direct => "direct",
            Method::Path => "path",
            Method::Ao => "ao",
            Method::Photon => "photon",
            Method::FullGi => "full-gi",
            Method::DebugUpper => "debug-upper",
            Method::DebugLower => "debug-lower",
            Method::DebugOccluders => "debug-occluders",
            Method::DebugPages => "debug-pages",
        }
    }

    /// True when nothing can be drawn without voxels.
    pub fn needs_voxels(self) -> bool {
        self == Method::Photon || self.shows_voxels()
    }

    /// True when C-rays show voxels, not the mesh.
    pub(crate) fn shows_voxels(self) -> bool {
        matches!(self, Method::DebugUpper | Method::DebugLower | Method::DebugOccluders)
    }

    /// True when indirect light is gathered from photons.
    pub fn gathers(self) -> bool {
        matches!(self, Method::Photon | Method::FullGi)
    }

    /// True when the picture that frames show at once is of this method, too: what gathers on the mesh, or goes on by
    /// chance, is seen in direct light at first.
    pub(crate) fn has_own_preview(self) -> bool {
        !matches!(self, Method::Path | Method::FullGi)
    }

    /// True when voxels are asked where there are any.
    pub fn asks_voxels(self) -> bool {
        self.needs_voxels() || self == Method::Ao
    }
}

/// The way in which shadow and gather rays leave a surface.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Near {
    /// Rays begin off the surface by a voxel.
    #[default]
    Voxel,
    /// Rays begin on the exact mesh, for some leaves' length.
    Exact,
}

/// Smoothing of indirect light.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Filter {
    /// Light is shown as the samples come.
    #[default]
    Off,
    /// Light is smoothed where the pixels show the same surface.
    On,
}

/// The numbers of a picture as a scene file or flags give them, by the names of the scene's keys; unchecked.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderKeys {
    /// The way in which light is computed: the integrator.
    pub integrator: Method,
    /// Width and height, pixels, 1 to [`SIDE_MAX_PIXELS`] each.
    pub resolution: [u32; 2],
    /// Samples a pixel, 1 to [`SPP_MAX`].
    pub spp: u32,
    /// Shadow rays at a path vertex, 0 (no direct light) to [`N_SHADOW_MAX`].
    pub n_shadow: u32,
    /// Gather rays at a surface point, 0 (no indirect light) to [`N_GATHER_MAX`]; of `photon` and `full-gi`.
    pub n_gather: u32,
    /// Photons in all, 1 to [`PHOTONS_MAX`]; of `full-gi` to [`TREE_PHOTONS_MAX`].
    pub photons: u64,
    /// Photons of a look-up of `full-gi`, [`K_NEAREST_MIN`] to [`K_NEAREST_MAX`].
    pub k_nearest: u32,
    /// True when the photons of `photon` go through the exact mesh; of that integrator alone.
    pub bake: bool,
    /// The way in which shadow and gather rays leave a surface.
    pub near: Near,
    /// Voxels as their bitmaps say, or as cubes.
    pub occluders: Occluders,
    /// The footprint rule: pixels that a leaf voxel may cover where it stands for the mesh; 0 for the exact mesh, to
    /// [`LOD_ERROR_MAX_PIXELS`].
    pub lod_error: f64,
    /// Smoothing of indirect light; of `photon` and `full-gi`.
    pub filter: Filter,
    /// Factor before clamping to PNG.
    pub exposure: f32,
    /// Seed of the random numbers.
    pub seed: u64,
}

impl Default for RenderKeys {
    fn default() -> RenderKeys {
        RenderKeys {
            integrator: Method::Direct,
            resolution: [1024, 1024],
            spp: 16,
            n_shadow: 2,
            n_gather: 2,
            photons: 1 << 21,
            // H. W. Jensen's own number for pictures with final gathering.
            k_nearest: 50,
            bake: false,
            near: Near::Voxel,
            occluders: Occluders::On,
            lod_error: 0.0,
            filter: Filter::Off,
            exposure: 1.0,
            seed: 1,
        }
    }
}

impl RenderKeys {
    /// Checks that each key is in its range.
    ///
    /// # Errors
    /// [`Code::SceneFormat`] at `render.KEY`.
    pub fn check_ranges(&self) -> Result<()> {
        let check = |key: &str, is_good: bool, numbers: String, range: String| match is_good {
            true => Ok(()),
            false => Err(out_of_range(&format!("render.{key}"), numbers, &range)),
        };
        let within = |key: &str, value: u64, range: RangeInclusive<u64>| {
            let next = format!("give a number in {}..={}", range.start(), range.end());
            check(key, range.contains(&value), value.to_string(), next)
        };
        let sides = 1..=SIDE_MAX_PIXELS;
        let next = format!("give a width and a height in 1..={SIDE_MAX_PIXELS}");
        let resolution = format!("{:?}", self.resolution);
        check("resolution", self.resolution.iter().all(|side| sides.contains(side)), resolution, next)?;
        within("spp", self.spp.into(), 1..=SPP_MAX.into())?;
        within("n_shadow", self.n_shadow.into(), 0..=N_SHADOW_MAX.into())?;
        within("n_gather", self.n_gather.into(), 0..=N_GATHER_MAX.into())?;
        within("photons", self.photons, 1..=PHOTONS_MAX)?;
        let is_good = (0.0..=LOD_ERROR_MAX_PIXELS).contains(&self.lod_error);
        let next = format!("give a number of pixels in 0..={LOD_ERROR_MAX_PIXELS}");
        check("lod_error", is_good, self.lod_error.to_string(), next)?;
        within("k_nearest", self.k_nearest.into(), K_NEAREST_MIN.into()..=K_NEAREST_MAX.into())?;
        let is_good = self.exposure > 0.0 && self.exposure.is_finite();
        check("exposure", is_good, self.exposure.to_string(), "give a finite number > 0".into())
    }
}

/// The numbers of a picture, checked: each in its range, and all of them together.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderSettings(RenderKeys);

impl RenderSettings {
    /// Checked settings.
    ///
    /// # Errors
    /// [`Code::SceneFormat`] at `render.KEY`: a key out of its range; a filter, a bake or a count of photons that the
    /// integrator has no use for.
    pub fn new(keys: RenderKeys) -> Result<RenderSettings> {
        keys.check_ranges()?;
        let RenderKeys { integrator, photons, .. } = keys;
        if keys.filter == Filter::On && !integrator.gathers() {
            return Err(Error::new(Code::SceneFormat, "there is no indirect light to be filtered")
                .at_place("render.filter")
                .numbers(format!("\"on\" beside the integrator {:?}", integrator.as_str()))
                .next("use photon or full-gi, whose gather rays the filter smooths"));
        }
        if keys.bake && integrator != Method::Photon {
            return Err(Error::new(Code::SceneFormat, "there are no facets to bake light into")
                .at_place("render.bake")
                .numbers(format!("true beside the integrator {:?}", integrator.as_str()))
                .next("use photon; photons of full-gi go through the mesh anyway"));
        }
        if integrator == Method::FullGi && photons > TREE_PHOTONS_MAX {
            return Err(Error::new(Code::SceneFormat, "too many photons to keep each by itself")
                .at_place("render.photons")
                .numbers(format!("{photons} asked, {TREE_PHOTONS_MAX} at most"))
                .next("send fewer, or use photon, which sums them up"));
        }
        Ok(RenderSettings(keys))
    }
}

impl Default for RenderSettings {
    fn default() -> RenderSettings {
        RenderSettings::new(RenderKeys::default()).expect("the defaults go together")
    }
}

impl Deref for RenderSettings {
    type Target = RenderKeys;

    fn deref(&self) -> &RenderKeys {
        &self.0
    }
}

/// The error of a key that is out of range.
pub(super) fn out_of_range(key: &str, numbers: String, next: &str) -> Error {
    Error::new(Code::SceneFormat, format!("`{key}` is out of range"))
        .at_place(key)
        .numbers(numbers)
        .next(next)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[track_caller]
    fn check(keys: RenderKeys, place: &str) {
        let error = RenderSettings::new(keys).unwrap_err();
        assert_eq!((error.code(), error.place()), (Code::SceneFormat, place), "{error}");
        assert!(!error.numbers_text().is_empty() && !error.next_step().is_empty());
    }

    #[test]
    fn keys_that_do_not_go_together_are_refused() {
        let keys = RenderKeys::default();
        check(RenderKeys { filter: Filter::On, integrator: Method::Path, ..keys }, "render.filter");
        check(RenderKeys { bake: true, integrator: Method::FullGi, ..keys }, "render.bake");
        let many = TREE_PHOTONS_MAX + 1;
        check(RenderKeys { photons: many, integrator: Method::FullGi, ..keys }, "render.photons");
        assert!(
            RenderSettings::new(RenderKeys { photons: many, integrator: Method::Photon, ..keys }).is_ok()
        );
    }

    #[test]
    fn both_ends_of_each_range_are_in_it() {
        let keys = RenderKeys::default();
        for (place, inside, outside) in [
            ("render.spp", vec![1, SPP_MAX], vec![0, SPP_MAX + 1]),
            ("render.n_shadow", vec![0, N_SHADOW_MAX], vec![N_SHADOW_MAX + 1]),
            ("render.n_gather", vec![0, N_GATHER_MAX], vec![N_GATHER_MAX + 1]),
            (
                "render.k_nearest",
                vec![K_NEAREST_MIN, K_NEAREST_MAX],
                vec![K_NEAREST_MIN - 1, K_NEAREST_MAX + 1],
            ),
        ] {
            let with = |value| match place {
                "render.spp" => RenderKeys { spp: value, ..keys },
                "render.n_shadow" => RenderKeys { n_shadow: value, ..keys },
                "render.n_gather" => RenderKeys { n_gather: value, ..keys },
                _ => RenderKeys { k_nearest: value, ..keys },
            };
            inside
                .into_iter()
                .for_each(|value| assert!(RenderSettings::new(with(value)).is_ok(), "{place} {value}"));
            outside.into_iter().for_each(|value| check(with(value), place));
        }
        for lod_error in [-1.0, f64::NAN, LOD_ERROR_MAX_PIXELS * 1.01] {
            check(RenderKeys { lod_error, ..keys }, "render.lod_error");
        }
        for exposure in [0.0, f32::NAN, f32::INFINITY] {
            check(RenderKeys { exposure, ..keys }, "render.exposure");
        }
        for resolution in [[0, 5], [5, SIDE_MAX_PIXELS + 1]] {
            check(RenderKeys { resolution, ..keys }, "render.resolution");
        }
        check(RenderKeys { photons: 0, ..keys }, "render.photons");
    }
}
