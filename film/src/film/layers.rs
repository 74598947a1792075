//! `LayerPlanes`: what the first ray of each pixel met, of those layers that are kept.
//!
//! Layers that are to be written are exact. What the filter alone takes is coarser (`packed.rs`), and the filter
//! sees the coarser numbers also where the exact ones are kept: a picture does not depend on the layers beside it.

use crate::light_key::LightKey;
use crate::packed::{PackedAlbedo, PackedNormal};
use std::ops::Range;

/// `id` of a pixel where no triangle is seen.
pub const NO_ID: u32 = u32::MAX;

/// The layers that a film keeps beside the radiance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Layers {
    /// Distance from the camera, model units; infinite where nothing is hit.
    pub depth: bool,
    /// Unit normal of the counter-clockwise side; zero where nothing is hit.
    pub normal: bool,
    /// Kd + Ks; zero where nothing is hit.
    pub albedo: bool,
    /// Store id of the triangle, [`NO_ID`] for none.
    pub id: bool,
    /// The input of the filter: depth, normal, albedo, and indirect light apart. None of it is written for that.
    pub filter: bool,
}

/// The layers of one pixel: what a ray through its centre meets.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LayerPixel {
    /// Distance, see [`Layers::depth`].
    pub depth: f32,
    /// Normal, see [`Layers::normal`].
    pub normal: [f32; 3],
    /// Albedo, see [`Layers::albedo`].
    pub albedo: [f32; 3],
    /// Triangle, see [`Layers::id`].
    pub id: u32,
    /// Where its light is kept in the world.
    pub light_key: LightKey,
}

/// A pixel's surface as the filter sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Guide {
    /// Distance from the camera, model units; infinite where nothing is hit.
    pub(crate) depth: f32,
    pub(crate) normal: PackedNormal,
    pub(crate) albedo: PackedAlbedo,
}

/// The layers of all pixels, by rows; those that are not kept have no pixels.
#[derive(Debug)]
pub(super) struct LayerPlanes {
    pub(super) depth: Vec<f32>,
    pub(super) normal: Vec<[f32; 3]>,
    pub(super) albedo: Vec<[f32; 3]>,
    pub(super) id: Vec<u32>,
    /// For the filter, where the exact ones are not kept.
    pub(super) guide_normal: Vec<PackedNormal>,
    pub(super) guide_albedo: Vec<PackedAlbedo>,
}

/// The planes that layers are kept in.
pub(super) struct KeptPlanes {
    pub(super) depth: bool,
    pub(super) guide_normal: bool,
    pub(super) guide_albedo: bool,
}

impl LayerPixel {
    /// Where no triangle is seen.
    pub const NOTHING: LayerPixel = LayerPixel {
        depth: f32::INFINITY,
        normal: [0.0; 3],
        albedo: [0.0; 3],
        id: NO_ID,
        light_key: LightKey::NONE,
    };

    /// True where voxels are seen: a surface of no triangle.
    pub fn is_voxel(&self) -> bool {
        self.id == NO_ID && self.depth < f32::INFINITY
    }
}

impl Layers {
    /// True when any layer is asked for, to be written.
    pub fn any(&self) -> bool {
        self.depth || self.normal || self.albedo || self.id
    }

    /// Planes that are kept beside those that are asked for.
    pub(super) fn kept(self) -> KeptPlanes {
        let Layers { depth, normal, albedo, filter, .. } = self;
        KeptPlanes {
            depth: depth || filter,
            guide_normal: filter && !normal,
            guide_albedo: filter && !albedo,
        }
    }

    /// Bytes that the layers of a pixel take.
    pub(super) fn pixel_bytes(self) -> usize {
        let KeptPlanes { depth, guide_normal, guide_albedo } = self.kept();
        let if_kept = |is_kept: bool, bytes: usize| if is_kept { bytes } else { 0 };
        if_kept(depth, size_of::<f32>())
            + if_kept(self.normal, size_of::<[f32; 3]>())
            + if_kept(self.albedo, size_of::<[f32; 3]>())
            + if_kept(self.id, size_of::<u32>())
            + if_kept(guide_normal, size_of::<PackedNormal>())
            + if_kept(guide_albedo, size_of::<PackedAlbedo>())
    }
}

impl LayerPlanes {
    /// The layers of so many pixels, which saw nothing.
    pub(super) fn new(layers: Layers, pixels: usize) -> LayerPlanes {
        let KeptPlanes { depth, guide_normal, guide_albedo } = layers.kept();
        let if_kept = |is_kept: bool| if is_kept { pixels } else { 0 };
        let LayerPixel { depth: no_depth, normal, albedo, id, .. } = LayerPixel::NOTHING;
        LayerPlanes {
            depth: vec![no_depth; if_kept(depth)],
            normal: vec![normal; if_kept(layers.normal)],
            albedo: vec![albedo; if_kept(layers.albedo)],
            id: vec![id; if_kept(layers.id)],
            guide_normal: vec![PackedNormal::NONE; if_kept(guide_normal)],
            guide_albedo: vec![PackedAlbedo::default(); if_kept(guide_albedo)],
        }
    }

    /// Sets the layers of the pixel at `at`.
    pub(super) fn set(&mut self, at: usize, seen: &LayerPixel) {
        fn put<T>(plane: &mut [T], at: usize, value: impl FnOnce() -> T) {
            // A layer that is not kept has no pixels.
            if let Some(place) = plane.get_mut(at) {
                *place = value();
            }
        }
        put(&mut self.depth, at, || seen.depth);
        put(&mut self.normal, at, || seen.normal);
        put(&mut self.albedo, at, || seen.albedo);
        put(&mut self.id, at, || seen.id);
        put(&mut self.guide_normal, at, || PackedNormal::new(seen.normal));
        put(&mut self.guide_albedo, at, || PackedAlbedo::new(seen.albedo));
    }

    /// Forgets what pixels in a row saw.
    pub(super) fn clear(&mut self, row: Range<usize>) {
        row.for_each(|at| self.set(at, &LayerPixel::NOTHING));
    }

    /// The filter's view of the pixel at `at`; only with [`Layers::filter`].
    pub(super) fn guide(&self, at: usize) -> Guide {
        let normal = match self.normal.get(at) {
            Some(&normal) => PackedNormal::new(normal),
            None => self.guide_normal[at],
        };
        let albedo = match self.albedo.get(at) {
            Some(&albedo) => PackedAlbedo::new(albedo),
            None => self.guide_albedo[at],
        };
        Guide { depth: self.depth[at], normal, albedo }
    }
}
