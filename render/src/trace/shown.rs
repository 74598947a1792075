//! Rays through what is shown of a model: the piece of a ray that sections keep, caps at its ends, hidden materials
//! passed by.
//!
//! ```text
//! ray -> piece that is kept -> it comes through a section, within a solid  -> the cap there
//!                           -> the mesh, materials that are hidden left out -> the hit there
//!                           -> it goes through a section, within a solid    -> the cap, from behind
//! ```
//!
//! Sections stand a share of a lattice step within what they keep ([`INWARD`]), where no vertex of the model is: a wall
//! that lies in the plane is either there or not, all of it.
//!
//! Invariants: 1. a ray reads no page whose box is cut away as a whole; 2. a tracer that shows all is asked as if this
//! file were not there; 3. invariants of `paged_mesh` hold.

use super::bvh::{AnyHit, AnyShownHit, ClosestHit, ClosestShownHit, Found, LatticeScene};
use super::caps::{CROSSED_MAX, Caps, CrossedSurface, OpenParts};
use super::crossings::{Side, trace_crossings};
use super::lattice_ray::Span;
use super::paged_mesh::{MODEL_ERROR, PagedMesh, any, closest, want};
use super::pages::Pages;
use super::parts::{KeptSpan, Parts, Section, is_hidden, kept_span};
use super::shown_parts::ShownParts;
use super::{Answer, Hit, Ray, ShadedHit};
use glam::DVec3;
use std::sync::Arc;

/// Way of a section into what it keeps, lattice steps: half of one is the error of a vertex.
const INWARD: f64 = 0.371;
/// Share of the coordinates of a cap that its points may be off: more than what `MODEL_ERROR` says, since it is a
/// section that rays leave, not a triangle.
const CAP_ERROR: f64 = 1024.0 * MODEL_ERROR;

impl<P: Pages> PagedMesh<P> {
    /// From now on, rays meet these parts of the model alone, and the caps of solids that its sections cut.
    pub fn show(&mut self, parts: &Arc<Parts>) {
        let frame = &self.scene.frame;
        let bounds = [frame.lo, frame.hi].map(|q| frame.origin + frame.step() * q);
        let inward = INWARD * frame.step();
        let sections: Vec<Section> = parts.sections().iter().map(|section| section.moved(inward)).collect();
        let caps = (!sections.is_empty()).then(|| Caps::new(&sections, bounds));
        self.scene.hidden = parts.hidden().to_vec();
        self.shown = (!parts.is_whole())
            .then(|| Box::new(ShownParts { parts: parts.clone(), sections, caps, bounds }));
    }

    /// The open parts that rays have met on sections since [`PagedMesh::show`].
    pub fn open_parts(&self) -> OpenParts {
        let caps = self.shown.as_ref().and_then(|shown| shown.caps.as_ref());
        caps.map_or_else(OpenParts::default, |caps| caps.open.clone())
    }

    /// The closest hit on what is shown.
    pub(super) fn intersect_shown(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
        let mut shown = self.shown.take().expect("there is something to leave out");
        let answer = self.closest_of(&mut shown, ray);
        self.shown = Some(shown);
        answer
    }

    /// A cap with the mean colour of its material.
    pub(super) fn shaded_cap(&self, hit: Hit) -> ShadedHit {
        let colour =
            self.shown.as_ref().map_or([1.0; 3], |shown| shown.parts.cap_colour(hit.material as u16));
        ShadedHit { colour, ..hit.into() }
    }

    /// Whether anything that is shown is met.
    pub(super) fn occluded_shown(&mut self, ray: &Ray) -> Answer<bool> {
        let mut shown = self.shown.take().expect("there is something to leave out");
        let answer = self.any_of(&mut shown, ray);
        self.shown = Some(shown);
        answer
    }

    fn closest_of(&mut self, shown: &mut ShownParts, ray: &Ray) -> Answer<Option<Hit>> {
        let Some(kept) = kept_span(&shown.sections, ray) else { return Answer::Exact(None) };
        match self.cap(shown, ray, (kept.entered, kept.from)) {
            Answer::Exact(None) => {}
            cap => return cap,
        }
        let part = kept.part(ray);
        let ended = match shown.parts.hides_any() {
            true => self.run::<ClosestShownHit>(&part),
            false => self.run::<ClosestHit>(&part),
        };
        let answer = |ended| closest(&mut self.pages, (&self.scene, &part), &ended, &self.missing);
        match ended.map_or(Answer::Exact(None), answer) {
            Answer::Exact(None) => self.cap(shown, ray, (kept.left, kept.to)),
            met => met.map(|hit| hit.map(|hit| on_whole(hit, &kept, ray))),
        }
    }

    fn any_of(&mut self, shown: &mut ShownParts, ray: &Ray) -> Answer<bool> {
        let Some(kept) = kept_span(&shown.sections, ray) else { return Answer::Exact(false) };
        let part = kept.part(ray);
        let ended = match shown.parts.hides_any() {
            true => self.run::<AnyShownHit>(&part),
            false => self.run::<AnyHit>(&part),
        };
        let met = ended.map_or(Answer::Exact(false), |ended| any(&mut self.pages, &ended, &self.missing));
        if met != Answer::Exact(false) {
            return met;
        }
        for end in [(kept.entered, kept.from), (kept.left, kept.to)] {
            match self.cap(shown, ray, end) {
                Answer::Exact(None) => {}
                Answer::Exact(Some(_)) => return Answer::Exact(true),
                Answer::Blocked => return Answer::Blocked,
            }
        }
        Answer::Exact(false)
    }

    /// The cap where `ray` goes through a section, if it does and is within a solid there.
    fn cap(
        &mut self,
        shown: &mut ShownParts,
        ray: &Ray,
        (section, t): (Option<usize>, f64),
    ) -> Answer<Option<Hit>> {
        let (Some(index), Some(caps)) = (section, &mut shown.caps) else { return Answer::Exact(None) };
        let (point, [lo, hi]) = (ray.at(t), shown.bounds);
        if !(point.cmpge(lo) & point.cmple(hi)).all() {
            return Answer::Exact(None);
        }
        let PagedMesh { scene, pages, stack, missing, .. } = self;
        let cross = |ray: &Ray, crossed: &mut Vec<CrossedSurface>| {
            missing.clear();
            let mut tell =
                |span: &Span, found: &Found, side| note_crossing(scene, (span, found, side), crossed);
            trace_crossings(scene, pages, stack, ray, missing, &mut tell);
            if missing.count > 0 {
                want(pages, missing, f64::INFINITY);
                return Answer::Blocked;
            }
            Answer::Exact(())
        };
        let material = match caps.fill(index, point, cross) {
            Answer::Exact(Some(material)) => material,
            Answer::Exact(None) => return Answer::Exact(None),
            Answer::Blocked => return Answer::Blocked,
        };
        let reach = DVec3::from(ray.origin).abs().max(point.abs()).max_element();
        let outward = (-DVec3::from(shown.sections[index].normal)).as_vec3().to_array();
        Answer::Exact(Some(Hit {
            t,
            triangle: Hit::OF_CAP,
            page: Hit::OF_CAP,
            material: material.into(),
            barycentric: [1.0, 0.0, 0.0],
            normal: outward,
            error: CAP_ERROR * reach,
        }))
    }
}

/// Adds what a line crosses, unless it is hidden.
fn note_crossing(
    scene: &LatticeScene,
    (span, found, side): (&Span, &Found, Side),
    crossed: &mut Vec<CrossedSurface>,
) {
    let material = found.material;
    if crossed.len() <= CROSSED_MAX && !is_hidden(&scene.hidden, material.into()) {
        let t = span.model_t(found.refined.t);
        crossed.push(CrossedSurface { t, material, begins: side == Side::Front });
    }
}

/// A hit on the piece of a ray, as a hit of the ray.
fn on_whole(hit: Hit, kept: &KeptSpan, ray: &Ray) -> Hit {
    if kept.from == 0.0 {
        return hit;
    }
    let moved = DVec3::from(ray.origin).abs().max(ray.at(kept.from).abs()).max_element();
    Hit { t: hit.t + kept.from, error: hit.error + MODEL_ERROR * moved, ..hit }
}
