//! `PhotonMap`: the light that photons brought to the surface, per side of the octree's facets. Paper, sections 4.2 and
//! 5.1.
//!
//! ```text
//! pass of 2^18 photons -> sums (u32 fixed point per side and channel)
//!                      -> folded into the mean irradiance (13 bits a channel) -> next pass
//! irradiance = flux / area of the side            side = 2 * facet, 1 more for its back
//! place      = side; of its caustics alone, where they are kept (`--caustics`), as many places on as there are sides
//! ```
//!
//! Why fixed point: its sums do not depend on the order in which threads add, nor do saturated ones. The sums are there
//! only while a pass runs. What is kept is packed, so that two sides take what one would, right to 2^-13 of the
//! greatest channel; it is rounded up or down by a number drawn by side and pass, since what a late pass of many
//! changes is less than a step.
//!
//! Invariants: 1. the same photons give the same map, whatever the threads; 2. a pass counts whole or not at all.

use super::trace::Cargo;
use glam::Vec3;
use std::sync::atomic::{AtomicU32, Ordering};
use trex_film::{PackedLight, chances};
use trex_store::octree::Facets;
use trex_store::{Budget, Lease, Result};

/// Units of a sum that an average photon brings: its rounding is below a thousandth. All photons of a pass on one side
/// fill a sum to a quarter.
const UNITS_PER_PHOTON: f32 = 1024.0;

/// What a map keeps of the light of an octree.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MapForm {
    /// Facets of the octree, of two sides each.
    pub facets: usize,
    /// Whether caustics of points and suns are kept by themselves, too.
    pub caustics: bool,
}

impl MapForm {
    /// Sides that all light is kept by.
    fn sides(self) -> usize {
        2 * self.facets
    }

    /// Places of light: all of each side, then the caustics of each.
    fn places(self) -> usize {
        self.sides() * (1 + usize::from(self.caustics))
    }

    /// Bytes of a map.
    pub fn bytes(self) -> u64 {
        (self.places() * size_of::<PackedLight>()) as u64
    }

    /// Bytes of the sums while a pass runs.
    pub fn pass_bytes(self) -> u64 {
        (self.places() * size_of::<[AtomicU32; 3]>()) as u64
    }
}

/// Irradiance of the sides of the facets of an octree.
#[derive(Debug)]
pub struct PhotonMap {
    form: MapForm,
    /// Irradiance per place, W/m^2 in linear RGB.
    irradiance: Vec<PackedLight>,
    photons: u64,
    lease: Lease,
}

/// The light that gather rays find: of one map, or of two while light changes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Irradiance<'a> {
    shown: &'a [PackedLight],
    /// The light that comes, and its share, 0 to 1.
    next: Option<(&'a [PackedLight], f32)>,
    /// The place of the first side's caustics, if they are kept.
    caustics: Option<u32>,
}

impl<'a> Irradiance<'a> {
    /// No light; what does not gather asks for none.
    pub(crate) const NONE: Irradiance<'static> = Irradiance { shown: &[], next: None, caustics: None };

    /// The light of `shown` alone, or blended with `next` by its share, 0 to 1.
    pub(crate) fn new(shown: &'a PhotonMap, next: Option<(&'a PhotonMap, f32)>) -> Irradiance<'a> {
        let next = next.filter(|(_, share)| *share > 0.0);
        let next = next.map(|(map, share)| (map.irradiance.as_slice(), share));
        let caustics = shown.form.caustics.then_some(shown.form.sides() as u32);
        Irradiance { shown: &shown.irradiance, next, caustics }
    }

    /// True when there is no map.
    pub(crate) fn is_none(&self) -> bool {
        self.shown.is_empty()
    }

    /// Irradiance of a side, W/m^2 in linear RGB.
    #[inline]
    pub(crate) fn at(&self, side: u32) -> Vec3 {
        let light = |map: &[PackedLight]| Vec3::from(map[side as usize].rgb());
        let shown = light(self.shown);
        match self.next {
            None => shown,
            Some((next, share)) => shown + share * (light(next) - shown),
        }
    }

    /// True when caustics of points and suns are kept.
    pub(crate) fn has_caustics(&self) -> bool {
        self.caustics.is_some()
    }

    /// The part of the irradiance of a side that came from points and suns over mirrors alone; none where it is not
    /// kept.
    pub(crate) fn caustics_at(&self, side: u32) -> Vec3 {
        self.caustics.map_or(Vec3::ZERO, |first| self.at(first + side))
    }
}

/// The sums of a pass.
#[derive(Debug)]
pub(crate) struct PhotonPass {
    form: MapForm,
    sums: Vec<AtomicU32>,
    /// Flux of a unit, per channel.
    unit: Vec3,
    /// Units of a flux, per channel; 0 for a channel without light.
    per_flux: Vec3,
    lease: Lease,
}

impl PhotonMap {
    /// A dark map.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when `budget` has no room for [`MapForm::bytes`].
    pub fn new(form: MapForm, budget: &Budget) -> Result<PhotonMap> {
        let lease = budget.lease("the photon map", form.bytes())?;
        Ok(PhotonMap::in_lease(form, lease))
    }

    /// As [`PhotonMap::new`], in a lease of [`MapForm::bytes`].
    pub(crate) fn in_lease(form: MapForm, lease: Lease) -> PhotonMap {
        PhotonMap { form, irradiance: vec![PackedLight::default(); form.places()], photons: 0, lease }
    }

    /// The lease of its memory.
    pub(crate) fn lease_mut(&mut self) -> &mut Lease {
        &mut self.lease
    }

    /// Count of photons whose light is in.
    pub fn photons(&self) -> u64 {
        self.photons
    }

    /// What it keeps.
    pub(crate) fn form(&self) -> MapForm {
        self.form
    }

    /// Irradiance per side, W/m^2 in linear RGB.
    pub fn irradiance(&self) -> impl ExactSizeIterator<Item = [f32; 3]> {
        self.irradiance[..self.form.sides()].iter().map(|light| light.rgb())
    }

    /// Forgets all photons.
    pub(crate) fn clear(&mut self) {
        self.irradiance.fill(PackedLight::default());
        self.photons = 0;
    }

    /// Folds the sums of `photons` photons, whose mean flux is that of the lights, into the mean; they are zero after
    /// it.
    pub(crate) fn fold(&mut self, pass: &mut PhotonPass, photons: u64, facets: &Facets, leaf_side: f64) {
        self.photons += photons;
        let share = (photons as f64 / self.photons as f64) as f32;
        let sums = pass.sums.as_chunks_mut::<3>().0;
        for (place, (irradiance, sums)) in self.irradiance.iter_mut().zip(sums).enumerate() {
            let area = f64::from(facets.side_area(place % self.form.sides())) * leaf_side * leaf_side;
            let per_area = (1.0 / (area * photons as f64)) as f32;
            let found = |c: usize| std::mem::take(sums[c].get_mut()) as f32 * pass.unit[c] * per_area;
            let found = Vec3::from_array(std::array::from_fn(found));
            let before = Vec3::from(irradiance.rgb());
            // The same wherever they are drawn: by place and pass.
            let chances = chances(place as u64 ^ self.photons.rotate_left(32));
            *irradiance = PackedLight::rounded_by((before + share * (found - before)).into(), chances);
        }
    }
}

impl PhotonPass {
    /// Empty sums for photons whose flux is `flux` on average.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when `budget` has no room for [`MapForm::pass_bytes`].
    pub(crate) fn new(form: MapForm, flux: Vec3, budget: &Budget) -> Result<PhotonPass> {
        let lease = budget.lease("the sums of photons", form.pass_bytes())?;
        Ok(PhotonPass::in_lease(form, flux, lease))
    }

    /// As [`PhotonPass::new`], in a lease of [`MapForm::pass_bytes`].
    pub(crate) fn in_lease(form: MapForm, flux: Vec3, lease: Lease) -> PhotonPass {
        let sums = (0..3 * form.places()).map(|_| AtomicU32::new(0)).collect();
        let mut pass = PhotonPass { form, sums, unit: Vec3::ZERO, per_flux: Vec3::ZERO, lease };
        pass.set_flux(flux);
        pass
    }

    /// The lease of its memory.
    pub(crate) fn lease_mut(&mut self) -> &mut Lease {
        &mut self.lease
    }

    /// Empties the sums, for photons of another mean flux.
    pub(crate) fn reset(&mut self, flux: Vec3) {
        self.sums.iter_mut().for_each(|sum| *sum.get_mut() = 0);
        self.set_flux(flux);
    }

    fn set_flux(&mut self, flux: Vec3) {
        self.unit = flux / UNITS_PER_PHOTON;
        self.per_flux = flux.map(|flux| if flux > 0.0 { UNITS_PER_PHOTON / flux } else { 0.0 });
    }

    /// Adds what a photon brings to a side.
    pub(crate) fn add(&self, side: u32, cargo: &Cargo) {
        self.add_at(side as usize, cargo.flux);
        if self.form.caustics && cargo.is_caustic() {
            self.add_at(self.form.sides() + side as usize, cargo.flux);
        }
    }

    /// Adds flux to a place. Full sums stay full.
    fn add_at(&self, place: usize, flux: Vec3) {
        for (c, units) in (flux * self.per_flux).to_array().into_iter().enumerate() {
            let units = (units + 0.5) as u32;
            if units > 0 {
                let sum = &self.sums[3 * place + c];
                let add = |sum: u32| Some(sum.saturating_add(units));
                let _ = sum.fetch_update(Ordering::Relaxed, Ordering::Relaxed, add);
            }
        }
    }
}

#[cfg(test)]
mod tests;
