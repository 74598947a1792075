//! `Camera`: a pinhole, and the rays through it.
//!
//! ```text
//!        up  forward          pixel (0, 0) is the top left one; its centre is film position (0.5, 0.5)
//!         | /                 right = forward x up
//!         |/____ right
//! ```
//!
//! Invariants: 1. a [`Projection`] exists only for a camera that has one: finite, with a direction, an up that is
//! not along it and an angle in [0.001, 179] degrees; 2. rays are unit, set up in f64, and start at the position.

use crate::math::unit;
use crate::trace::Ray;
use glam::DVec3;
use trex_film::{CAMERA_NUMBERS, Lens, Reprojection};
use trex_store::{Code, Error, Result};

/// Smallest angle of view, degrees.
pub const FOV_MIN_DEGREES: f64 = 0.001;
/// Greatest angle of view, degrees.
pub const FOV_MAX_DEGREES: f64 = 179.0;
/// Most pixels on a side: what PNG and EXR readers take, and what keeps `width * height` in 32 bits.
pub const SIDE_MAX_PIXELS: u32 = 1 << 16;

/// The angle of view, across the picture or from top to bottom, degrees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fov {
    /// Across the width.
    X(f64),
    /// Across the height.
    Y(f64),
}

/// Squared sine of the angle between view and up below which the two count as parallel: their cross product is noise.
const PARALLEL: f64 = 1e-18;

/// A pinhole camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// The pinhole, model units.
    pub position: [f64; 3],
    /// A point in the middle of the picture, model units.
    pub target: [f64; 3],
    /// Upward direction of the picture; any length, not along the view.
    pub up: [f64; 3],
    /// Angle of view.
    pub fov: Fov,
}

/// A camera with a film behind it: what makes rays.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    pub(super) position: DVec3,
    pub(super) forward: DVec3,
    /// Way from the middle of the picture to its right edge, at distance 1 along `forward`.
    pub(super) right: DVec3,
    /// Way from the middle of the picture to its lower edge, at distance 1 along `forward`.
    pub(super) down: DVec3,
    resolution: [u32; 2],
}

impl Camera {
    /// The rays of this camera for a picture of `resolution` (width, height; pixels).
    ///
    /// # Errors
    /// [`Code::SceneFormat`], with the key of the scene file: numbers that are not finite, an angle out of range,
    /// a target at the position, an up along the view, a side of 0 or more than [`SIDE_MAX_PIXELS`].
    pub fn project(&self, resolution: [u32; 2]) -> Result<Projection> {
        let Camera { position, target, up, fov } = *self;
        // Before all that is framed by it.
        let (key, Fov::X(degrees) | Fov::Y(degrees)) =
            (if matches!(fov, Fov::X(_)) { "camera.fov_x" } else { "camera.fov_y" }, fov);
        if !(FOV_MIN_DEGREES..=FOV_MAX_DEGREES).contains(&degrees) {
            let next = format!("give an angle in [{FOV_MIN_DEGREES}, {FOV_MAX_DEGREES}] degrees");
            return Err(bad(key, "an angle of view out of range", format!("{degrees} degrees"), &next));
        }
        for (key, vector) in [("camera.position", position), ("camera.target", target), ("camera.up", up)] {
            if vector.iter().any(|x| !x.is_finite()) {
                return Err(bad(
                    key,
                    "a number that is not finite",
                    format!("{vector:?}"),
                    "give three finite numbers",
                ));
            }
        }
        if resolution.iter().any(|side| !(1..=SIDE_MAX_PIXELS).contains(side)) {
            let [width, height] = resolution;
            let next = format!("give a width and a height in 1..={SIDE_MAX_PIXELS}");
            return Err(bad(
                "render.resolution",
                "a picture of no usable size",
                format!("{width} x {height}"),
                &next,
            ));
        }
        let Some(forward) = unit(DVec3::from(target) - DVec3::from(position)) else {
            let numbers = format!("both are {position:?}");
            return Err(bad(
                "camera.target",
                "the camera looks at where it stands",
                numbers,
                "move the target",
            ));
        };
        let side =
            unit(up.into()).map(|up| forward.cross(up)).filter(|side| side.length_squared() > PARALLEL);
        let Some(side) = side.and_then(unit) else {
            let numbers = format!("up {up:?}, view {:?}", forward.to_array());
            return Err(bad("camera.up", "up points along the view or nowhere", numbers, "give another up"));
        };
        let [half_x, half_y] = half_sides(fov, resolution);
        Ok(Projection {
            position: position.into(),
            forward,
            right: half_x * side,
            down: half_y * forward.cross(side),
            resolution,
        })
    }
}

impl Camera {
    /// Its numbers, as part files have them: position, target, up, the angle, and 0 for one across the picture.
    pub fn numbers(&self) -> [f64; CAMERA_NUMBERS] {
        let ([px, py, pz], [tx, ty, tz], [ux, uy, uz]) = (self.position, self.target, self.up);
        let (angle, axis) = match self.fov {
            Fov::X(degrees) => (degrees, 0.0),
            Fov::Y(degrees) => (degrees, 1.0),
        };
        [px, py, pz, tx, ty, tz, ux, uy, uz, angle, axis]
    }

    /// The camera of these numbers, which has rays only where [`Camera::project`] says so.
    pub fn from_numbers(numbers: [f64; CAMERA_NUMBERS]) -> Camera {
        let [px, py, pz, tx, ty, tz, ux, uy, uz, angle, axis] = numbers;
        let fov = if axis == 0.0 { Fov::X(angle) } else { Fov::Y(angle) };
        Camera { position: [px, py, pz], target: [tx, ty, tz], up: [ux, uy, uz], fov }
    }
}

impl Projection {
    /// Width and height, pixels.
    pub fn resolution(&self) -> [u32; 2] {
        self.resolution
    }

    /// Width of a pixel in the middle of the picture, radians: model units at distance 1.
    pub fn pixel_angle(&self) -> f64 {
        2.0 * self.right.length() / f64::from(self.resolution[0])
    }

    /// The ray through film position (`x`, `y`), pixels from the top left corner.
    pub fn ray(&self, x: f64, y: f64) -> Ray {
        let [width, height] = self.resolution.map(f64::from);
        let across = self.forward + (2.0 * x / width - 1.0) * self.right;
        let direction = across + (2.0 * y / height - 1.0) * self.down;
        let direction = unit(direction).expect("a view has a direction");
        Ray::new(self.position, direction, f64::INFINITY)
    }
}

/// Least cosine between the directions that a place is seen from, of two views that see the same light of it: what
/// shines does so in some directions alone. 14 degrees, as far as no hand turns between two pictures.
const ALIKE_COS: f64 = 0.97;

/// Two views of what does not move.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ViewChange {
    before: Projection,
    /// From the camera before to the one now.
    way: DVec3,
    /// Where film position (x, y) looks now, not of unit length: `across[0] + x across[1] + y across[2]`.
    across: [DVec3; 3],
    is_lit_anew: bool,
}

impl ViewChange {
    /// The change from a view `before` to that of `now`, and of light where it `is_lit_anew`.
    pub(crate) fn new(before: Projection, now: &Projection, is_lit_anew: bool) -> ViewChange {
        let [width, height] = now.resolution.map(f64::from);
        let across = [now.forward - now.right - now.down, 2.0 / width * now.right, 2.0 / height * now.down];
        ViewChange { before, way: now.position - before.position, across, is_lit_anew }
    }
}

impl Reprojection for ViewChange {
    fn before(&self, [x, y]: [f64; 2], depth: f64) -> Option<([f64; 2], f64)> {
        let Projection { forward, right, down, resolution, .. } = self.before;
        let [first, to_right, down_by] = self.across;
        let direction = first + x * to_right + y * down_by;
        let here = depth / direction.length() * direction;
        let way = self.way + here;
        let distance = way.length();
        if way.dot(here) < ALIKE_COS * distance * depth {
            return None;
        }
        let ahead = way.dot(forward);
        let place = |side: DVec3, pixels: u32| {
            (way.dot(side) / (ahead * side.length_squared()) + 1.0) / 2.0 * f64::from(pixels)
        };
        (ahead > 0.0).then(|| ([place(right, resolution[0]), place(down, resolution[1])], distance))
    }

    fn is_lit_anew(&self) -> bool {
        self.is_lit_anew
    }
}

impl Lens for Projection {
    fn direction(&self, x: f64, y: f64) -> [f64; 3] {
        self.ray(x, y).direction
    }

    fn pixel_angle(&self) -> f64 {
        Projection::pixel_angle(self)
    }
}

/// Half width and half height of the picture at distance 1.
pub(super) fn half_sides(fov: Fov, [width, height]: [u32; 2]) -> [f64; 2] {
    let aspect = f64::from(width) / f64::from(height);
    let half = |degrees: f64| (0.5 * degrees).to_radians().tan();
    match fov {
        Fov::X(degrees) => [half(degrees), half(degrees) / aspect],
        Fov::Y(degrees) => [half(degrees) * aspect, half(degrees)],
    }
}

fn bad(key: &str, what: &str, numbers: String, next: &str) -> Error {
    Error::new(Code::SceneFormat, what).at_place(key).numbers(numbers).next(next)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(fov: Fov) -> Camera {
        Camera { position: [0.0; 3], target: [0.0, 0.0, -5.0], up: [0.0, 2.0, 0.1], fov }
    }

    fn check_ray(projection: &Projection, film: [f64; 2], expected: [f64; 3]) {
        let ray = projection.ray(film[0], film[1]);
        let off = DVec3::from(ray.direction) - unit(expected.into()).unwrap();
        assert!(off.length() < 1e-12, "{film:?}: {:?}", ray.direction);
    }

    #[test]
    fn centre_and_corners_go_where_the_angle_says() {
        let projection = camera(Fov::X(90.0)).project([200, 100]).unwrap();
        check_ray(&projection, [100.0, 50.0], [0.0, 0.0, -1.0]);
        check_ray(&projection, [0.0, 0.0], [-1.0, 0.5, -1.0]);
        check_ray(&projection, [200.0, 100.0], [1.0, -0.5, -1.0]);
        let tall = camera(Fov::Y(90.0)).project([200, 100]).unwrap();
        check_ray(&tall, [200.0, 0.0], [2.0, 1.0, -1.0]);
    }

    /// A place that a ray of one view meets lies on the ray of the other through where it was seen; or behind it.
    #[test]
    fn places_are_found_again_in_the_view_before() {
        let before = camera(Fov::X(70.0)).project([200, 100]).unwrap();
        let turned = Camera { position: [3.0, 1.0, -2.0], target: [-1.0, 0.5, -9.0], ..camera(Fov::Y(40.0)) };
        let now = turned.project([60, 90]).unwrap();
        let change = ViewChange::new(before, &now, false);
        let (mut found, mut elsewhere, mut behind) = (0, 0, 0);
        for [x, y, depth] in (0..400).map(|at| [at * 7 % 60, at * 13 % 90, 1 + at % 23].map(f64::from)) {
            let place = now.ray(x + 0.5, y + 0.5).at(depth);
            let ahead = place.dot(before.forward) > 0.0;
            let turned = place.angle_between(place - now.position).to_degrees();
            let Some(([u, v], distance)) = change.before([x + 0.5, y + 0.5], depth) else {
                assert!(!ahead || turned > 14.0, "{place} {turned}");
                (elsewhere, behind) = (elsewhere + u32::from(ahead), behind + u32::from(!ahead));
                continue;
            };
            assert!(ahead && (before.ray(u, v).at(distance) - place).length() < 1e-9, "{place}");
            assert!(turned < 14.1, "{place} {turned}");
            found += 1;
        }
        assert!(found > 50 && elsewhere > 50 && behind == 0, "{found} {elsewhere} {behind}");
        let back = Camera { target: [0.0, 0.0, 5.0], ..camera(Fov::X(70.0)) }.project([200, 100]).unwrap();
        assert!(ViewChange::new(before, &back, false).before([100.0, 50.0], 2.0).is_none());
    }

    #[test]
    fn a_camera_is_that_of_its_numbers() {
        for fov in [Fov::X(45.25), Fov::Y(0.1)] {
            let camera = Camera { position: [0.1, -3e7, 5.0], ..camera(fov) };
            assert_eq!(Camera::from_numbers(camera.numbers()), camera);
        }
    }

    #[test]
    fn the_ends_of_the_range_hold() {
        for degrees in [FOV_MIN_DEGREES, FOV_MAX_DEGREES] {
            let half = (0.5 * degrees).to_radians().tan();
            let projection = camera(Fov::X(degrees)).project([64, 64]).unwrap();
            check_ray(&projection, [64.0, 32.0], [half, 0.0, -1.0]);
        }
    }

    #[test]
    fn cameras_without_a_view_are_named() {
        let good = camera(Fov::X(45.0));
        let cases = [
            ("camera.fov_x", Camera { fov: Fov::X(0.0009), ..good }),
            ("camera.fov_y", Camera { fov: Fov::Y(f64::NAN), ..good }),
            ("camera.fov_y", Camera { fov: Fov::Y(179.5), ..good }),
            ("camera.target", Camera { target: [0.0; 3], ..good }),
            ("camera.up", Camera { up: [0.0, 0.0, 3.0], ..good }),
            ("camera.up", Camera { up: [0.0; 3], ..good }),
            ("camera.position", Camera { position: [f64::INFINITY, 0.0, 0.0], ..good }),
        ];
        for (place, camera) in cases {
            let error = camera.project([4, 4]).unwrap_err();
            assert_eq!((error.code(), error.place()), (Code::SceneFormat, place));
            assert!(!error.numbers_text().is_empty() && !error.next_step().is_empty());
        }
        assert_eq!(good.project([0, 4]).unwrap_err().place(), "render.resolution");
    }
}
