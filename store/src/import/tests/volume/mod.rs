//! Volumes: surfaces against what a naive walk over all edges says of them, headers of each kind, and what is refused.

mod headers;
mod refusals;
mod surfaces;

use super::{Fixture, SourceMesh, SourceTriangle, read};
use crate::error::Result;
use crate::import::{ImportOptions, VolumeOptions};
use std::collections::HashMap;

/// Samples of a function of their place, those along x side by side.
pub(super) fn sampled([x, y, z]: [usize; 3], value: impl Fn([f64; 3]) -> f64) -> Vec<f64> {
    let mut samples = Vec::with_capacity(x * y * z);
    for k in 0..z {
        for j in 0..y {
            samples.extend((0..x).map(|i| value([i as f64, j as f64, k as f64])));
        }
    }
    samples
}

/// An NRRD file of doubles, with more fields.
pub(super) fn nrrd([x, y, z]: [usize; 3], samples: &[f64], more: &str) -> Vec<u8> {
    let head = format!(
        "NRRD0004\ntype: double\ndimension: 3\nsizes: {x} {y} {z}\nendian: little\nencoding: raw\n{more}\n"
    );
    let mut file = head.into_bytes();
    file.extend(samples.iter().flat_map(|sample| sample.to_le_bytes()));
    file
}

/// Options of a fixture, with the values of surfaces.
pub(super) fn with_values(fixture: &Fixture, values: &[f64]) -> ImportOptions {
    let volumes = VolumeOptions { iso_values: values.to_vec(), raw: None };
    ImportOptions { volumes, ..fixture.options() }
}

/// The surfaces in a file.
pub(super) fn surfaces(name: &str, file: &[u8], values: &[f64]) -> Result<SourceMesh> {
    let fixture = Fixture::new(name, file);
    read(&fixture.path, &with_values(&fixture, values))
}

/// The surface of samples at a value.
pub(super) fn surface(size: [usize; 3], samples: &[f64], value: f64) -> SourceMesh {
    surfaces("a.nrrd", &nrrd(size, samples, ""), &[value]).unwrap()
}

/// How often each side of a triangle is there: along it, and against it.
pub(super) fn sides(triangles: &[SourceTriangle]) -> HashMap<[[u64; 3]; 2], [u32; 2]> {
    let mut sides: HashMap<[[u64; 3]; 2], [u32; 2]> = HashMap::new();
    for corners in triangles {
        // + 0: both zeros are one place.
        let [a, b, c] = corners.map(|corner| corner.map(|value| (value + 0.0).to_bits()));
        for [from, to] in [[a, b], [b, c], [c, a]] {
            assert_ne!(from, to, "a triangle without area");
            let side = if from < to { [from, to] } else { [to, from] };
            sides.entry(side).or_default()[usize::from(from > to)] += 1;
        }
    }
    sides
}

/// Fails unless each side of a triangle is there as often in one direction as in the other.
#[track_caller]
pub(super) fn check_closed(triangles: &[SourceTriangle]) {
    assert!(!triangles.is_empty());
    let open = sides(triangles).values().filter(|&&[forth, back]| forth != back).count();
    assert_eq!(open, 0, "open sides of {} triangles", triangles.len());
}

/// Numbers that are the same each time, from 0 to 1.
pub(super) struct Noise(pub(super) u64);

impl Noise {
    pub(super) fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / (1u64 << 31) as f64
    }
}
