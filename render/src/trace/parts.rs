//! `Parts`: what is shown of a model: sections cut half spaces away, materials are hidden.
//!
//! ```text
//! section = point + normal: what lies behind it, against its normal, is cut away      (as clipping planes of OpenGL)
//! several: what is in front of all of them is kept, so a ray keeps one piece of itself
//!
//! ray ----| section ........ kept ........ section |---->
//!         from: a cap, where a solid begins        to: a cap, seen from within
//! ```
//!
//! Invariants: 1. normals are unit vectors, points are finite; 2. there are at most [`SECTIONS_MAX`] sections.

use super::Ray;
use crate::math::unit;
use glam::DVec3;

/// Most sections.
pub const SECTIONS_MAX: usize = 3;

/// A plane that cuts away what lies behind it: all points `p` with `(p - point) . normal < 0`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Section {
    /// A point on the plane, model units.
    pub point: [f64; 3],
    /// Unit normal, which points into what is kept.
    pub normal: [f64; 3],
}

/// What is shown of a model.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parts {
    sections: Vec<Section>,
    /// A bit a material; those beyond are shown.
    hidden: Vec<u64>,
    /// Mean colour of the mesh on each material, which caps have; none where all are white.
    colours: Vec<[f32; 3]>,
}

/// The piece of a ray that sections keep.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct KeptSpan {
    pub(crate) from: f64,
    pub(crate) to: f64,
    /// The section through which the ray comes, and the one through which it goes; `None` where it starts or ends.
    pub(crate) entered: Option<usize>,
    pub(crate) left: Option<usize>,
}

impl Section {
    /// The section at `point` whose kept side `normal` points into, of any length; `None` where one of them is not
    /// finite, or the normal is none.
    pub fn new(point: [f64; 3], normal: [f64; 3]) -> Option<Section> {
        let given = DVec3::from(normal);
        // One that is unit as it is stays in all bits, so that what is written of a section reads back as itself.
        let is_unit = (given.length_squared() - 1.0).abs() <= 8.0 * f64::EPSILON;
        let normal = if is_unit { Some(given) } else { unit(given) }.filter(|normal| normal.is_finite())?;
        let is_finite = point.iter().all(|part| part.is_finite());
        is_finite.then(|| Section { point, normal: normal.to_array() })
    }

    /// Distance of `point` from the plane, model units; below 0 where it is cut away.
    pub(crate) fn distance(&self, point: DVec3) -> f64 {
        (point - DVec3::from(self.point)).dot(self.normal.into())
    }

    /// The section moved by `distance` into what it keeps.
    pub(super) fn moved(&self, distance: f64) -> Section {
        let point = DVec3::from(self.point) + distance * DVec3::from(self.normal);
        Section { point: point.to_array(), ..*self }
    }
}

/// The piece of `ray` that `sections` keep; `None` where that is nothing.
pub(crate) fn kept_span(sections: &[Section], ray: &Ray) -> Option<KeptSpan> {
    let mut kept = KeptSpan { from: 0.0, to: ray.t_max, entered: None, left: None };
    for (index, section) in sections.iter().enumerate() {
        let height = section.distance(ray.origin.into());
        let climb = DVec3::from(section.normal).dot(ray.direction.into());
        let t = -height / climb;
        if climb > 0.0 && t > kept.from {
            (kept.from, kept.entered) = (t, Some(index));
        } else if climb < 0.0 && t < kept.to {
            (kept.to, kept.left) = (t, Some(index));
        } else if climb == 0.0 && height < 0.0 {
            return None;
        }
    }
    (kept.from <= kept.to).then_some(kept)
}

impl KeptSpan {
    /// The piece as a ray of its own; one that starts within it starts where it did.
    pub(crate) fn part(&self, ray: &Ray) -> Ray {
        let origin = if self.from > 0.0 { ray.at(self.from).to_array() } else { ray.origin };
        Ray { origin, t_max: self.to - self.from, ..*ray }
    }
}

impl Parts {
    /// What these sections and hidden materials leave.
    ///
    /// # Panics
    /// For more than [`SECTIONS_MAX`] sections.
    pub fn new(sections: Vec<Section>, hidden: &[usize]) -> Parts {
        assert!(sections.len() <= SECTIONS_MAX, "{} sections", sections.len());
        let words = hidden.iter().max().map_or(0, |most| most / 64 + 1);
        let mut bits = vec![0; words];
        hidden.iter().for_each(|material| bits[material / 64] |= 1 << (material % 64));
        Parts { sections, hidden: bits, colours: Vec::new() }
    }

    /// The sections.
    pub fn sections(&self) -> &[Section] {
        &self.sections
    }

    /// True when nothing is left out.
    pub fn is_whole(&self) -> bool {
        self.sections.is_empty() && !self.hides_any()
    }

    /// True when some material is hidden.
    pub fn hides_any(&self) -> bool {
        self.hidden.iter().any(|word| *word != 0)
    }

    /// True when the material with this index is hidden.
    pub fn hides(&self, material: usize) -> bool {
        is_hidden(&self.hidden, material)
    }

    /// The hidden materials, a bit each.
    pub(crate) fn hidden(&self) -> &[u64] {
        &self.hidden
    }

    /// These parts, with the mean colours of materials on their caps.
    pub(crate) fn with_colours(&self, colours: &[glam::Vec3]) -> Parts {
        Parts { colours: colours.iter().map(|colour| colour.to_array()).collect(), ..self.clone() }
    }

    /// What the `kd` of `material` is multiplied by on a cap, linear.
    pub(super) fn cap_colour(&self, material: u16) -> [f32; 3] {
        self.colours.get(usize::from(material)).copied().unwrap_or([1.0; 3])
    }

    /// The piece of `ray` that is kept; `None` where that is nothing.
    pub(crate) fn kept(&self, ray: &Ray) -> Option<KeptSpan> {
        kept_span(&self.sections, ray)
    }

    /// The piece of `ray` that is kept as a ray of its own, and where on `ray` it begins; one that meets nothing where
    /// nothing is kept.
    pub(crate) fn piece(&self, ray: &Ray) -> (Ray, f64) {
        if self.sections.is_empty() {
            return (*ray, 0.0);
        }
        match self.kept(ray) {
            Some(kept) => (kept.part(ray), kept.from),
            None => (Ray { t_max: -1.0, ..*ray }, 0.0),
        }
    }

    /// What is left of a triangle, as triangles that turn the same way.
    pub(crate) fn kept_triangle(&self, corners: [[f64; 3]; 3]) -> Vec<[[f64; 3]; 3]> {
        let mut polygon: Vec<DVec3> = corners.map(DVec3::from).to_vec();
        for section in &self.sections {
            let heights: Vec<f64> = polygon.iter().map(|corner| section.distance(*corner)).collect();
            let mut kept = Vec::with_capacity(polygon.len() + 1);
            for at in 0..polygon.len() {
                let next = (at + 1) % polygon.len();
                if heights[at] >= 0.0 {
                    kept.push(polygon[at]);
                }
                if (heights[at] < 0.0) != (heights[next] < 0.0) {
                    let share = heights[at] / (heights[at] - heights[next]);
                    kept.push(polygon[at].lerp(polygon[next], share));
                }
            }
            polygon = kept;
        }
        let fan = |at: usize| [polygon[0], polygon[at], polygon[at + 1]].map(|corner| corner.to_array());
        (1..polygon.len().saturating_sub(1)).map(fan).collect()
    }
}

/// True when the bit of `material` is set.
#[inline(always)]
pub(super) fn is_hidden(hidden: &[u64], material: usize) -> bool {
    hidden.get(material / 64).is_some_and(|word| word >> (material % 64) & 1 == 1)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn section(point: [f64; 3], normal: [f64; 3]) -> Section {
        Section::new(point, normal).unwrap()
    }

    #[test]
    fn a_ray_keeps_what_is_in_front_of_all_sections() {
        let sections =
            [section([1.0, 0.0, 0.0], [2.0, 0.0, 0.0]), section([4.0, 9.0, 9.0], [-1.0, 0.0, 0.0])];
        let ray =
            |x: f64, dx: f64, t_max: f64| Ray { origin: [x, 0.0, 0.0], direction: [dx, 0.0, 0.0], t_max };
        let span =
            |ray: Ray| kept_span(&sections, &ray).map(|kept| (kept.from, kept.to, kept.entered, kept.left));
        assert_eq!(span(ray(0.0, 1.0, f64::INFINITY)), Some((1.0, 4.0, Some(0), Some(1))));
        assert_eq!(span(ray(2.0, 1.0, 1.5)), Some((0.0, 1.5, None, None)));
        assert_eq!(span(ray(5.0, -0.5, 100.0)), Some((2.0, 8.0, Some(1), Some(0))));
        assert_eq!(span(ray(0.0, -1.0, 100.0)), None);
        assert_eq!(span(ray(0.0, 1.0, 0.5)), None, "it ends before");
        let along = Ray { origin: [0.5, 0.0, 0.0], direction: [0.0, 1.0, 0.0], t_max: 1.0 };
        assert_eq!(kept_span(&sections, &along), None);
        let inside = Ray { origin: [1.5, 0.0, 0.0], ..along };
        assert_eq!(kept_span(&sections, &inside).map(|kept| kept.to), Some(1.0));
    }

    #[test]
    fn what_is_kept_of_a_triangle_has_the_area_that_is_in_front() {
        let corners = [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 2.0, 0.0]];
        let area = |parts: Parts| -> f64 {
            let area = |[a, b, c]: [[f64; 3]; 3]| {
                let [a, b, c] = [a, b, c].map(DVec3::from);
                0.5 * (b - a).cross(c - a).z
            };
            parts.kept_triangle(corners).into_iter().map(area).sum()
        };
        let cut = |x: f64, sign: f64| section([x, 0.0, 0.0], [sign, 0.0, 0.0]);
        let kept = |sections: Vec<Section>| area(Parts::new(sections, &[]));
        assert_eq!(kept(vec![]), 2.0);
        assert!((kept(vec![cut(1.0, 1.0)]) - 0.5).abs() < 1e-12);
        assert!((kept(vec![cut(1.0, -1.0)]) - 1.5).abs() < 1e-12);
        assert!((kept(vec![cut(0.5, 1.0), cut(1.0, -1.0)]) - 0.625).abs() < 1e-12);
        assert_eq!(kept(vec![cut(3.0, 1.0)]), 0.0);
        assert!(
            Section::new([0.0; 3], [0.0; 3]).is_none() && Section::new([f64::NAN; 3], [1.0; 3]).is_none()
        );
    }

    /// Scenes that were copied from a page had other bits than the picture that the page showed.
    #[test]
    fn a_section_that_is_written_reads_back_as_itself() {
        let mut sum = 0_u32;
        for at in 1..5000 {
            let part = |step: f64| (f64::from(at) * step).sin();
            let once = section([part(0.1), 2.0, 3.0], [part(0.7), part(1.3) * 1e3, part(2.1) * 1e-3]);
            assert_eq!(section(once.point, once.normal), once, "{once:?}");
            sum +=
                u32::from((once.normal[0].hypot(once.normal[1]).hypot(once.normal[2]) - 1.0).abs() < 1e-14);
        }
        assert_eq!(sum, 4999, "all of them are unit");
    }

    #[test]
    fn materials_beyond_the_last_hidden_one_are_shown() {
        let parts = Parts::new(vec![], &[3, 70]);
        let hidden: Vec<usize> = (0..1000).filter(|&material| parts.hides(material)).collect();
        assert_eq!((hidden, parts.hides_any(), parts.is_whole()), (vec![3, 70], true, false));
        assert!(Parts::default().is_whole());
    }
}
