//! What photons share, whatever they fly through: their numbers, how they bounce, and the passes that they come in.
//! Paper, section 5.1; H. W. Jensen, "Realistic image synthesis using photon mapping" (2001).
//!
//! Invariants: 1. a photon is a function of (seed, index); 2. its flux times its chance is what the lights send; 3.
//! it ends by roulette alone; 4. a pass counts whole or not at all.

use crate::sampler::{Decision, Sampler};
use crate::shading::bsdf::Bsdf;
use crate::shading::light::Emission;
use crate::stats::PhotonStats;
use glam::{DVec3, Vec3};
use std::ops::{ControlFlow, Range};
use trex_store::Material;

/// Photons of a pass: few enough for changed light to be seen within a second, enough for the fold to cost little.
pub(crate) const PASS_PHOTONS: u64 = 1 << 18;
/// Chance to go on after a hit, at most: three hits of a photon on average, as the paper has it.
pub(crate) const CHANCE_MAX: f32 = 2.0 / 3.0;
/// In the voxels, where nothing is kept of a hit but its sum, photons of white rooms go on more often: by a chance
/// below the square of what a surface reflects few would get far, and these would carry most of the light.
pub(crate) const VOXEL_CHANCE: f32 = 0.95;
/// Chance over that square, at least, below [`VOXEL_CHANCE`].
const CHANCE_A_SQUARE: f32 = 1.04;
/// Keeps photons apart from the pixels that use the same seed.
const SEED_OF_PHOTONS: u64 = 0x7068_6f74_6f6e_7331;

/// The numbers of photon `index`.
pub(crate) fn photon_sampler(seed: u64, index: u64) -> Sampler {
    let block = [(index >> 16) as u32, (index >> 48) as u32];
    Sampler::new(seed ^ SEED_OF_PHOTONS, block, index as u32 & 0xffff)
}

/// True when light stays on a surface: on a pure mirror none does.
pub(crate) fn keeps_light(material: &Material) -> bool {
    !material.mirror || material.kd != [0.0; 3]
}

/// What a photon carries from hit to hit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cargo {
    /// Flux over the photon's chance, W in linear RGB.
    pub(crate) flux: Vec3,
    /// How it came here.
    pub(crate) way: Way,
}

/// The way of a photon so far, by what other rays find of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Way {
    /// Straight from a point or a sun: shadow rays find it.
    Straight,
    /// From a point or a sun over mirrors alone: neither shadow rays nor gather rays find it.
    Mirrored,
    /// Any other: gather rays find it.
    Gathered,
}

impl Cargo {
    /// A photon as it leaves its light.
    pub(crate) fn new(start: &Emission) -> Cargo {
        Cargo { flux: start.flux, way: if start.is_delta { Way::Straight } else { Way::Gathered } }
    }

    /// True for light that only the photons themselves bring to a surface that is seen.
    pub(crate) fn is_caustic(&self) -> bool {
        self.way == Way::Mirrored
    }
}

/// The direction and the cargo with which a photon goes on from its hit `vertex`, at most by a chance; `None` at its
/// end. `bsdf` is seen from where the photon came.
pub(crate) fn bounce(
    bsdf: &Bsdf<'_>,
    sampler: &Sampler,
    (vertex, chance_max): (u32, f32),
    cargo: Cargo,
) -> Option<(DVec3, Cargo)> {
    let u = sampler.draw(Decision::Gather { vertex, index: 0, count: 1 });
    let bounce = bsdf.sample(u)?;
    let weight = bounce.weight.max_element();
    let chance = weight.min((CHANCE_A_SQUARE * weight * weight).clamp(CHANCE_MAX, chance_max));
    if sampler.draw(Decision::Roulette(vertex))[0] >= chance {
        return None;
    }
    let is_mirror = bounce.pdf.is_none();
    let way = if is_mirror && cargo.way != Way::Gathered { Way::Mirrored } else { Way::Gathered };
    Some((bounce.wi, Cargo { flux: 1.0 / chance * (cargo.flux * bounce.weight), way }))
}

/// Sends the photons of `indices` pass by pass, until `send` breaks: it sends those of one pass and says what came of
/// it, Continue when the pass is in, Break when it was stopped. `tell` hears after each pass how many photons are in.
pub(crate) fn send_in_passes(
    indices: Range<u64>,
    mut send: impl FnMut(Range<u64>) -> ControlFlow<PhotonStats, PhotonStats>,
    tell: &mut dyn FnMut(u64),
) -> PhotonStats {
    let mut stats = PhotonStats::default();
    let mut first = indices.start;
    while first < indices.end {
        let end = indices.end.min(first + PASS_PHOTONS);
        match send(first..end) {
            ControlFlow::Continue(pass) => stats.add(&pass),
            ControlFlow::Break(part) => {
                stats.add(&part);
                break;
            }
        }
        first = end;
        tell(end);
    }
    stats
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn passes_follow_each_other_until_one_is_stopped() {
        let sent = |stop_at: u64| {
            let (mut told, mut passes) = (vec![], vec![]);
            let stats = send_in_passes(
                5..2 * PASS_PHOTONS + 7,
                |pass| {
                    let photons = pass.end - pass.start;
                    let is_stopped = passes.len() as u64 == stop_at;
                    passes.push(pass);
                    let count = |photons| PhotonStats { photons, ..PhotonStats::default() };
                    if is_stopped {
                        ControlFlow::Break(count(1))
                    } else {
                        ControlFlow::Continue(count(photons))
                    }
                },
                &mut |photons| told.push(photons),
            );
            (stats.photons, told)
        };
        let end = 2 * PASS_PHOTONS + 7;
        assert_eq!(sent(9), (end - 5, vec![5 + PASS_PHOTONS, 5 + 2 * PASS_PHOTONS, end]));
        assert_eq!(sent(1), (PASS_PHOTONS + 1, vec![5 + PASS_PHOTONS]));
        assert_eq!(sent(0), (1, vec![]));
    }
}
