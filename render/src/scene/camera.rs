//! `Camera`: a pinhole, and the rays through it.
//!
//! ```text
//!        up  forward          pixel (0, 0) is the top left one; its centre is film position (0.5, 0.5)
//!         | /                 right = forward x up
//!         |/____ right
//! ```
//!
//! Invariants: 1. a [`Projection`] exists only for a camera that has one: finite, with a direction, an up that is
//! not along it and an angle in [0.001, 179] degrees; 2. rays are unit, set up in f64, and start at the position;
//! 3. a framed camera sees the whole box.

use crate::math::{ground_axes, unit};
use crate::trace::Ray;
use glam::DVec3;
use trex_film::Lens;
use trex_store::{Aabb, Code, Error, Result};

/// Smallest angle of view, degrees.
pub const FOV_MIN_DEGREES: f64 = 0.001;
/// Greatest angle of view, degrees.
pub const FOV_MAX_DEGREES: f64 = 179.0;
/// Most pixels on a side: what PNG and EXR readers take, and what keeps `width * height` in 32 bits.
pub const SIDE_MAX_PIXELS: u32 = 1 << 16;

/// Angle of view of a framed camera (of its greater side), degrees: a normal lens.
const FRAMED_FOV_DEGREES: f64 = 40.0;
/// Share of the picture's half side that a framed box may take.
const FRAMED_SHARE: f64 = 0.94;
/// A box is seen from this far beside its front, degrees: a three-quarter view that shows most of the long side.
const FRAMED_AZIMUTH_DEGREES: f64 = 30.0;
/// A box is seen from this far above, degrees; a flat one (terrain) from higher up.
const FRAMED_ELEVATION_DEGREES: [f64; 2] = [20.0, 35.0];
/// A box is seen from its side, not its front, when that is longer than the front by this factor; below it the
/// front wins, since scans look towards it.
const SIDE_ON_RATIO: f64 = 1.5;
/// A box is flat along an axis where it is thinner than this share of both other sides.
const FLAT_SHARE: f64 = 0.5;

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
    position: DVec3,
    forward: DVec3,
    /// Way from the middle of the picture to its right edge, at distance 1 along `forward`.
    right: DVec3,
    /// Way from the middle of the picture to its lower edge, at distance 1 along `forward`.
    down: DVec3,
    resolution: [u32; 2],
}

impl Camera {
    /// A camera that sees the whole of `bounds` at `resolution` (width, height; pixels), three-quarter from above the
    /// front (the left side, where that is much longer). `up`: [`up_axis`] of the box when `None`; `fov`: 40 degrees.
    ///
    /// # Panics
    /// When a side of the picture is 0.
    pub fn framing(bounds: &Aabb, resolution: [u32; 2], up: Option<[f64; 3]>, fov: Option<Fov>) -> Camera {
        assert!(resolution.iter().all(|&side| side > 0));
        let up = up.and_then(|up| unit(up.into())).unwrap_or_else(|| up_axis(bounds).into());
        let (bounds, size) = solid(bounds);
        let (right, front) = ground_axes(up);
        let extent_along = |direction: DVec3| size.dot(direction.abs());
        let (across, towards) = if extent_along(front) <= SIDE_ON_RATIO * extent_along(right) {
            (right, front)
        } else {
            (front, -right)
        };
        let flat = extent_along(up) < FLAT_SHARE * extent_along(across).min(extent_along(towards));
        let elevation = FRAMED_ELEVATION_DEGREES[usize::from(flat)].to_radians();
        let azimuth = FRAMED_AZIMUTH_DEGREES.to_radians();
        let level = azimuth.cos() * towards + azimuth.sin() * across;
        let backward = elevation.cos() * level + elevation.sin() * up;

        let center = bounds.center();
        let wide = resolution[0] >= resolution[1];
        let fov = fov.unwrap_or(if wide { Fov::X(FRAMED_FOV_DEGREES) } else { Fov::Y(FRAMED_FOV_DEGREES) });
        let half = half_sides(fov, resolution).map(|side| side * FRAMED_SHARE);
        let picture_right = unit(up.cross(backward)).expect("a framed view is not along up");
        let picture_up = backward.cross(picture_right);
        let mut distance = 0.0f64;
        for corner in 0..8 {
            let sign = |axis: u32| if corner >> axis & 1 == 0 { -0.5 } else { 0.5 };
            let corner = DVec3::new(sign(0), sign(1), sign(2)) * size;
            let nearer = corner.dot(backward);
            let x = corner.dot(picture_right).abs() / half[0];
            let y = corner.dot(picture_up).abs() / half[1];
            distance = distance.max(nearer + x.max(y));
        }
        let position = DVec3::from(center) + distance * backward;
        Camera { position: position.to_array(), target: center, up: up.to_array(), fov }
    }

    /// The rays of this camera for a picture of `resolution` (width, height; pixels).
    ///
    /// # Errors
    /// [`Code::SceneFormat`], with the key of the scene file: numbers that are not finite, an angle out of range,
    /// a target at the position, an up along the view, a side of 0 or more than [`SIDE_MAX_PIXELS`].
    pub fn project(&self, resolution: [u32; 2]) -> Result<Projection> {
        let Camera { position, target, up, fov } = *self;
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
        let (key, Fov::X(degrees) | Fov::Y(degrees)) =
            (if matches!(fov, Fov::X(_)) { "camera.fov_x" } else { "camera.fov_y" }, fov);
        if !(FOV_MIN_DEGREES..=FOV_MAX_DEGREES).contains(&degrees) {
            let next = format!("give an angle in [{FOV_MIN_DEGREES}, {FOV_MAX_DEGREES}] degrees");
            return Err(bad(key, "an angle of view out of range", format!("{degrees} degrees"), &next));
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

impl Lens for Projection {
    fn direction(&self, x: f64, y: f64) -> [f64; 3] {
        self.ray(x, y).direction
    }

    fn pixel_angle(&self) -> f64 {
        Projection::pixel_angle(self)
    }
}

/// Unit upward axis of a model with this box: +y, as OBJ and PLY scans have it, unless the box is flat along z alone
/// (terrain, maps), then +z.
pub fn up_axis(bounds: &Aabb) -> [f64; 3] {
    let (_, size) = solid(bounds);
    if size.z < FLAT_SHARE * size.x.min(size.y) { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] }
}

/// Half width and half height of the picture at distance 1.
fn half_sides(fov: Fov, [width, height]: [u32; 2]) -> [f64; 2] {
    let aspect = f64::from(width) / f64::from(height);
    let half = |degrees: f64| (0.5 * degrees).to_radians().tan();
    match fov {
        Fov::X(degrees) => [half(degrees), half(degrees) / aspect],
        Fov::Y(degrees) => [half(degrees) * aspect, half(degrees)],
    }
}

/// A box that is not empty and no point, with its sides.
fn solid(bounds: &Aabb) -> (Aabb, DVec3) {
    let bounds = if bounds.is_empty() { Aabb { lo: [-1.0; 3], hi: [1.0; 3] } } else { *bounds };
    let size = DVec3::from(bounds.hi) - DVec3::from(bounds.lo);
    (bounds, if bounds.extent() == 0.0 { DVec3::ONE } else { size })
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

    #[test]
    fn a_framed_box_is_whole_and_fills_the_picture() {
        let boxes = [
            [[0.0; 3], [1.0; 3]],
            [[1e7, -5.0, 3.0], [1e7 + 4.0, -2.0, 3.5]],
            [[0.0; 3], [100.0, 80.0, 3.0]],
            [[0.0; 3], [1.0, 9.0, 30.0]],
            [[2.0; 3], [2.0; 3]],
            [[0.0; 3], [5.0, 0.0, 0.0]],
        ];
        for [lo, hi] in boxes {
            for resolution in [[64, 64], [160, 90], [50, 200]] {
                let bounds = Aabb { lo, hi };
                let camera = Camera::framing(&bounds, resolution, None, None);
                let projection = camera.project(resolution).unwrap();
                let mut most = 0.0f64;
                for corner in 0..8 {
                    let point: [f64; 3] =
                        std::array::from_fn(|a| if corner >> a & 1 == 0 { lo[a] } else { hi[a] });
                    let from = DVec3::from(point) - projection.position;
                    let z = from.dot(projection.forward);
                    assert!(z > 0.0);
                    for axis in [projection.right, projection.down] {
                        most = most.max((from.dot(axis) / axis.dot(axis) / z).abs());
                    }
                }
                assert!(most <= 0.9401, "{lo:?} {hi:?} {resolution:?}: {most}");
                assert!(most >= 0.7 || bounds.extent() == 0.0, "{lo:?} {hi:?} {resolution:?}: {most}");
            }
        }
        assert_eq!(up_axis(&Aabb { lo: [0.0; 3], hi: [100.0, 80.0, 3.0] }), [0.0, 0.0, 1.0]);
        assert_eq!(ground_axes(DVec3::Y), (DVec3::X, DVec3::Z));
        assert_eq!(ground_axes(DVec3::Z), (DVec3::X, DVec3::NEG_Y));
    }
}
