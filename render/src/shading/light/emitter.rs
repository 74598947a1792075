//! `Emitters`: the triangles of the model that give light, drawn in proportion to their power; for a point that is lit,
//! to their power over squared distance.
//!
//! The store keeps them in a section of their own, since nobody can search a mesh on disk for lamps.
//! Invariants: 1. every kept triangle has a positive power; 2. the cumulated shares rise and end at 1;
//! 3. light leaves the counter-clockwise side only.

use super::box_tree::{BoxTree, falloff};
use crate::math::brightness;
use crate::trace::Ray;
use glam::{DVec3, Vec3};
use trex_store::{Aabb, Material};

/// A triangle of the model whose material gives light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Emitter {
    /// Corners, model units; light leaves the side from which they run counter-clockwise.
    pub corners: [[f64; 3]; 3],
    /// Index of the material, whose `ke` is the radiance that leaves.
    pub material: u32,
}

/// The triangles that give light, ready to draw from.
#[derive(Clone, Debug)]
pub struct Emitters {
    kept: Vec<EmitterTriangle>,
    /// Share of the power in the triangles up to and with this one.
    cumulated: Vec<f64>,
    /// Sum of radiance * area, linear RGB.
    radiance_area: Vec3,
    /// Sum of brightness * area.
    power: f64,
    bounds: Aabb,
    /// Over `kept`.
    tree: BoxTree,
}

#[derive(Clone, Copy, Debug)]
struct EmitterTriangle {
    corner: DVec3,
    /// Edges from there to the other two corners.
    edges: [DVec3; 2],
    normal: DVec3,
    radiance: Vec3,
}

/// A point on an emitter.
#[derive(Clone, Copy, Debug)]
pub(crate) struct EmitterSample {
    /// Place, model units.
    pub(crate) point: DVec3,
    /// Unit normal of the side that gives light.
    pub(crate) normal: DVec3,
    /// Radiance that leaves.
    pub(crate) radiance: Vec3,
    /// Density of this point, per area in square model units.
    pub(crate) pdf: f64,
    /// Two edges of its triangle, model units.
    edges: [DVec3; 2],
}

impl EmitterSample {
    /// Longest edge of the point's triangle, model units.
    pub(crate) fn size(&self) -> f64 {
        let [ab, ac] = self.edges;
        [ab, ac, ac - ab].map(DVec3::length).into_iter().fold(0.0, f64::max)
    }
}

impl Emitters {
    /// The ones of `emitters` that give light with these `materials`.
    ///
    /// # Panics
    /// When an emitter names a material that is not there.
    pub fn new(emitters: &[Emitter], materials: &[Material]) -> Emitters {
        let mut all = Emitters {
            kept: Vec::with_capacity(emitters.len()),
            cumulated: Vec::with_capacity(emitters.len()),
            radiance_area: Vec3::ZERO,
            power: 0.0,
            bounds: Aabb::EMPTY,
            tree: BoxTree::default(),
        };
        let (mut boxes, mut powers) =
            (Vec::with_capacity(emitters.len()), Vec::with_capacity(emitters.len()));
        let mut total = 0.0;
        for emitter in emitters {
            let radiance = Vec3::from(materials[emitter.material as usize].ke);
            let [corner, b, c] = emitter.corners.map(DVec3::from);
            let edges = [b - corner, c - corner];
            let doubled = edges[0].cross(edges[1]);
            let area = 0.5 * doubled.length();
            let power = area * brightness(radiance);
            if power > 0.0 && power.is_finite() {
                total += power;
                all.kept.push(EmitterTriangle { corner, edges, normal: 0.5 / area * doubled, radiance });
                all.cumulated.push(total);
                all.radiance_area += area as f32 * radiance;
                let mut bounds = Aabb::EMPTY;
                emitter.corners.iter().for_each(|&corner| bounds.add(corner));
                all.bounds.join(&bounds);
                boxes.push(bounds);
                powers.push(power);
            }
        }
        all.power = total;
        all.tree = BoxTree::new(&boxes, &powers);
        all.cumulated.iter_mut().for_each(|sum| *sum /= total);
        all
    }

    /// True when nothing gives light.
    pub fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// Bytes on the heap for `emitter_count` triangles.
    pub fn bytes(emitter_count: usize) -> u64 {
        let boxes = emitter_count * (size_of::<Aabb>() + size_of::<f64>());
        (boxes + emitter_count * (size_of::<EmitterTriangle>() + size_of::<f64>())) as u64
            + BoxTree::bytes(emitter_count)
    }

    /// Sum of radiance * area over all triangles.
    pub(crate) fn radiance_area(&self) -> Vec3 {
        self.radiance_area
    }

    /// The box around all of them.
    pub(crate) fn bounds(&self) -> &Aabb {
        &self.bounds
    }

    /// Radiance of the nearest emitter whose front `ray` meets, of those that `is_met` takes: it hears the parameter
    /// and the unit normal. Zero when there is none.
    pub(crate) fn seen(&self, ray: &Ray, is_met: impl Fn(f64, DVec3) -> bool) -> Vec3 {
        let mut nearest = (f64::INFINITY, Vec3::ZERO);
        self.tree.met(ray, |index| {
            let kept = &self.kept[index];
            if let Some(t) = kept.hit(ray)
                && t < nearest.0
                && is_met(t, kept.normal)
            {
                nearest = (t, kept.radiance);
            }
        });
        nearest.1
    }

    /// A point on an emitter: a triangle by its power with `pick`, a point on it by its area with `u`; all in [0, 1).
    ///
    /// # Panics
    /// When nothing gives light.
    pub(crate) fn sample(&self, pick: f32, u: [f32; 2]) -> EmitterSample {
        let pick = f64::from(pick);
        let index = self.cumulated.partition_point(|&sum| sum <= pick).min(self.kept.len() - 1);
        let kept = &self.kept[index];
        kept.sample(u, brightness(kept.radiance) / self.power)
    }

    /// As [`Emitters::sample`], for light at `place`: a triangle by about what it brings there. `None` where those that
    /// were looked at show their backs.
    pub(crate) fn sample_for(&self, place: DVec3, pick: f32, u: [f32; 2]) -> Option<EmitterSample> {
        let (index, chance) = self.tree.draw(place, pick.into(), |index| self.kept[index].brings(place))?;
        let kept = &self.kept[index];
        Some(kept.sample(u, chance / kept.area()))
    }

    /// Density, per area, with which [`Emitters::sample_for`] draws the point that `ray` meets at `t` for `place`; 0
    /// where no emitter is met there.
    pub(crate) fn pdf_for(&self, place: DVec3, ray: &Ray, t: f64) -> f64 {
        let mut nearest = (f64::INFINITY, 0);
        self.tree.met(ray, |index| {
            let apart = self.kept[index].hit(ray).map_or(f64::INFINITY, |own| (own - t).abs());
            if apart < nearest.0 {
                nearest = (apart, index);
            }
        });
        let (apart, index) = nearest;
        if apart == f64::INFINITY {
            return 0.0;
        }
        self.tree.chance(place, index, |index| self.kept[index].brings(place)) / self.kept[index].area()
    }
}

impl EmitterTriangle {
    fn area(&self) -> f64 {
        0.5 * self.edges[0].cross(self.edges[1]).length()
    }

    /// About what it brings to `place`; nothing behind it.
    fn brings(&self, place: DVec3) -> f64 {
        let to = self.corner - place;
        if to.dot(self.normal) >= 0.0 {
            return 0.0;
        }
        let [ab, ac] = self.edges;
        let to_centre = to + (ab + ac) / 3.0;
        falloff(self.area() * brightness(self.radiance), to_centre, 0.5 * ab.length().max(ac.length()))
    }

    /// The point at `u`, which is drawn with density `pdf`.
    fn sample(&self, u: [f32; 2], pdf: f64) -> EmitterSample {
        let EmitterTriangle { corner, edges, normal, radiance } = *self;
        // The square folded to the triangle keeps strata whole: P. Shirley and K. Chiu (1997).
        let root = f64::from(u[0]).sqrt();
        let (s, t) = (root * (1.0 - f64::from(u[1])), root * f64::from(u[1]));
        EmitterSample { point: corner + s * edges[0] + t * edges[1], normal, radiance, pdf, edges }
    }

    /// Parameter at which `ray` meets the side that gives light.
    fn hit(&self, ray: &Ray) -> Option<f64> {
        let (direction, [ab, ac]) = (DVec3::from(ray.direction), self.edges);
        let volume = -direction.dot(ab.cross(ac));
        if volume <= 0.0 {
            return None;
        }
        let to = DVec3::from(ray.origin) - self.corner;
        let across = to.cross(direction);
        let (u, v) = (ac.dot(across) / volume, -ab.dot(across) / volume);
        let t = to.dot(ab.cross(ac)) / volume;
        (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sampler::{Decision, Sampler};

    #[test]
    fn draws_by_power_and_the_densities_invert_it() {
        let lamp = |ke: f32| Material { ke: [ke; 3], ..Material::default() };
        let triangle = |size: f64, material| Emitter {
            corners: [[0.0; 3], [size, 0.0, 0.0], [0.0, size, 0.0]],
            material,
        };
        let emitters = [triangle(1.0, 0), triangle(0.0, 0), triangle(2.0, 1), triangle(3.0, 2)];
        let emitters = Emitters::new(&emitters, &[lamp(4.0), lamp(3.0), lamp(0.0)]);
        // Powers: 0.5 * 4 = 2 and 2 * 3 = 6; the others give nothing.
        let count = 4000;
        let (mut strong, mut area) = (0, 0.0);
        for i in 0..count {
            let point = emitters.sample((i as f32 + 0.5) / count as f32, [0.3, 0.6]);
            assert_eq!(point.normal, DVec3::Z);
            strong += i32::from(point.radiance[0] == 3.0);
            area += 1.0 / point.pdf / f64::from(count);
        }
        assert_eq!(strong, 3000);
        assert!((area - 2.5).abs() < 1e-9, "{area}");
        assert!((f64::from(emitters.radiance_area()[0]) - 8.0).abs() < 1e-6);
    }

    /// For a place that is lit: the mean of one over the density is the area of all that shows its front, and the
    /// density of a point is told again from a ray that meets it.
    #[test]
    fn what_is_drawn_for_a_place_is_all_that_shows_its_front() {
        const DRAWS: u32 = 20_000;
        let numbers = |i: u32| Sampler::new(9, [i, 1], 0).draw(Decision::Pixel).map(f64::from);
        let lamp = |ke: f32| Material { ke: [ke; 3], ..Material::default() };
        let materials = [lamp(4.0), lamp(0.5)];
        let emitters: Vec<Emitter> = (0..60)
            .map(|i| {
                let at = DVec3::from_slice(&numbers(i)[..3]) * 10.0;
                let edge =
                    |k: u32| at + DVec3::from_slice(&numbers(100 + 2 * i + k)[..3]) - DVec3::splat(0.5);
                Emitter { corners: [at, edge(0), edge(1)].map(|corner| corner.to_array()), material: i % 2 }
            })
            .collect();
        let all = Emitters::new(&emitters, &materials);
        let place = DVec3::new(4.0, 5.0, -1.0);
        let fronts = all.kept.iter().filter(|kept| (place - kept.corner).dot(kept.normal) > 0.0);
        let expected: f64 = fronts.map(EmitterTriangle::area).sum();
        let (mut area, mut near) = (0.0, 0);
        for i in 0..DRAWS {
            let [u, v, ..] = numbers(1000 + i).map(|x| x as f32);
            let Some(on) = all.sample_for(place, (i as f32 + 0.5) / DRAWS as f32, [u, v]) else { continue };
            area += 1.0 / on.pdf / f64::from(DRAWS);
            near += u32::from(on.point.distance(place) < 5.0);
            let ray = Ray::new(place, (on.point - place).normalize(), f64::INFINITY);
            let again = all.pdf_for(place, &ray, on.point.distance(place));
            assert!((again / on.pdf - 1.0).abs() < 1e-6, "{again} {}", on.pdf);
        }
        assert!((area / expected - 1.0).abs() < 0.02, "{area} {expected}");
        let by_power = (0..DRAWS)
            .filter(|&i| all.sample((i as f32 + 0.5) / DRAWS as f32, [0.5, 0.5]).point.distance(place) < 5.0);
        assert!(f64::from(near) > 1.5 * by_power.count() as f64);
    }

    /// Light leaves where it is drawn: every ray to a point on a triangle sees that triangle from its front, and
    /// nothing from its back.
    #[test]
    fn what_is_drawn_is_seen_from_the_front() {
        let lamp = |ke: f32| Material { ke: [ke; 3], ..Material::default() };
        let [a, b, c] = [[0.0, 0.0, 1.0], [2.0, 0.5, 1.5], [0.3, 1.0, 0.7]];
        let [d, e, f] = [[0.0, 0.0, 3.0], [9.0, 0.0, 3.0], [0.0, 9.0, 3.0]];
        let emitters =
            [Emitter { corners: [a, c, b], material: 0 }, Emitter { corners: [d, f, e], material: 1 }];
        let emitters = Emitters::new(&emitters, &[lamp(4.0), lamp(3.0)]);
        for i in 0..100 {
            let u = [0.003 + 0.0097 * i as f32, 0.99 - 0.0095 * i as f32];
            let on = emitters.sample(0.001, u);
            assert_eq!(on.radiance, Vec3::splat(4.0));
            let front = DVec3::new(0.2, 0.1, -5.0);
            for (origin, expected) in [(front, 4.0), (2.0 * on.point - front, 0.0)] {
                let ray = Ray::new(origin, (on.point - origin).normalize(), f64::INFINITY);
                assert_eq!(emitters.seen(&ray, |_, _| true), Vec3::splat(expected));
            }
            // Without the first, the one behind it.
            let ray = Ray::new(front, (on.point - front).normalize(), f64::INFINITY);
            assert_eq!(emitters.seen(&ray, |t, _| t > 7.9), Vec3::splat(3.0));
        }
    }
}
