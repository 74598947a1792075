//! A camera that frames a model: how it is seen where nothing is said of it.
//!
//! Invariant: a framed camera sees the whole box, or all of the boxes that are in it.

use super::camera::{Camera, Fov, half_sides};
use crate::math::{ground_axes, unit};
use glam::DVec3;
use trex_store::Aabb;

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

/// Squared sine of the angle between view and up below which a framed view has another up.
const NEARLY_PARALLEL: f64 = 1e-8;

/// What is asked of a framed view; what is `None` is chosen by the box.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FramedView {
    /// Upward direction, any length.
    pub up: Option<[f64; 3]>,
    /// The direction in which the camera looks, any length.
    pub direction: Option<[f64; 3]>,
    /// Angle of view.
    pub fov: Option<Fov>,
}

impl Camera {
    /// A camera that sees the whole of `bounds` at `resolution` (width, height; pixels), three-quarter from above the
    /// front (the left side, where that is much longer). `up`: [`up_axis`] of the box when `None`; `fov`: 40 degrees.
    ///
    /// # Panics
    /// When a side of the picture is 0.
    pub fn framing(bounds: &Aabb, resolution: [u32; 2], up: Option<[f64; 3]>, fov: Option<Fov>) -> Camera {
        Camera::framing_along(bounds, &[], resolution, FramedView { up, fov, direction: None })
    }

    /// As [`Camera::framing`], seen along a direction. Where `outline` has boxes around all triangles, the picture is
    /// filled by these, not by `bounds`: what a round thing leaves of its box is no part of it.
    ///
    /// # Panics
    /// When a side of the picture is 0.
    pub fn framing_along(
        bounds: &Aabb,
        outline: &[Aabb],
        resolution: [u32; 2],
        framing: FramedView,
    ) -> Camera {
        assert!(resolution.iter().all(|&side| side > 0));
        let FramedView { up, direction, fov } = framing;
        let mut up = up.and_then(|up| unit(up.into())).unwrap_or_else(|| up_axis(bounds).into());
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
        let backward = match direction.and_then(|direction| unit(direction.into())) {
            Some(direction) => -direction,
            None => elevation.cos() * level + elevation.sin() * up,
        };
        // Seen from above, what is behind is up in the picture; from below, what is in front.
        if up.cross(backward).length_squared() < NEARLY_PARALLEL {
            up = -front * backward.dot(up).signum();
        }

        let center = bounds.center();
        let wide = resolution[0] >= resolution[1];
        let fov = fov.unwrap_or(if wide { Fov::X(FRAMED_FOV_DEGREES) } else { Fov::Y(FRAMED_FOV_DEGREES) });
        let half = half_sides(fov, resolution).map(|side| side * FRAMED_SHARE);
        let picture_right = unit(up.cross(backward)).expect("a framed view is not along up");
        let picture_up = backward.cross(picture_right);
        if !outline.is_empty() {
            let axes = [picture_right, picture_up, backward];
            let [right, above, distance] = fit(outline, center.into(), axes, half);
            let target = DVec3::from(center) + right * picture_right + above * picture_up;
            let position = (target + distance * backward).to_array();
            return Camera { position, target: target.to_array(), up: up.to_array(), fov };
        }
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
}

/// Unit upward axis of a model with this box: +y, as OBJ and PLY scans have it, unless the box is flat along z alone
/// (terrain, maps), then +z.
pub fn up_axis(bounds: &Aabb) -> [f64; 3] {
    let (_, size) = solid(bounds);
    if size.z < FLAT_SHARE * size.x.min(size.y) { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] }
}

/// Where a camera stands that looks along the third of `axes`, backward, at a distance that is as small as can be for
/// its picture, of these half sides at distance 1, to hold all corners of `boxes`: along the axes, from `center`.
///
/// A corner (x, y, z) is in the picture of a camera at (s, t, d) where |x - s| <= half * (d - z), and the same of y: so
/// s is below all x + half * (d - z) and above all x - half * (d - z), and d is the least with room between them.
fn fit(boxes: &[Aabb], center: DVec3, axes: [DVec3; 3], half: [f64; 2]) -> [f64; 3] {
    let (mut most, mut least, mut nearest) = ([f64::NEG_INFINITY; 2], [f64::INFINITY; 2], f64::NEG_INFINITY);
    for bounds in boxes {
        for corner in 0..8 {
            let side = |axis: usize| if corner >> axis & 1 == 0 { bounds.lo[axis] } else { bounds.hi[axis] };
            let from = DVec3::new(side(0), side(1), side(2)) - center;
            let [x, y, z] = axes.map(|axis| from.dot(axis));
            nearest = nearest.max(z);
            for (axis, along) in [x, y].into_iter().enumerate() {
                most[axis] = most[axis].max(along + half[axis] * z);
                least[axis] = least[axis].min(along - half[axis] * z);
            }
        }
    }
    let distance_of = |axis: usize| 0.5 * (most[axis] - least[axis]) / half[axis];
    // A flat thing across the view is no nearer than it is wide.
    let distance = distance_of(0).max(distance_of(1));
    let distance = if distance > nearest { distance } else { nearest + nearest.abs().max(1.0) };
    [0.5 * (most[0] + least[0]), 0.5 * (most[1] + least[1]), distance]
}

/// A box that is not empty and no point, with its sides.
fn solid(bounds: &Aabb) -> (Aabb, DVec3) {
    let bounds = if bounds.is_empty() { Aabb { lo: [-1.0; 3], hi: [1.0; 3] } } else { *bounds };
    let size = DVec3::from(bounds.hi) - DVec3::from(bounds.lo);
    (bounds, if bounds.extent() == 0.0 { DVec3::ONE } else { size })
}

#[cfg(test)]
mod tests {
    use super::*;

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
    }

    #[test]
    fn a_box_is_seen_along_the_direction_that_is_asked_for() {
        let bounds = Aabb { lo: [-1.0, -2.0, -3.0], hi: [1.0, 2.0, 3.0] };
        let up = Some([0.0, 1.0, 0.0]);
        for direction in [[0.0, -2.0, 0.0], [0.0, 5.0, 0.0], [1.0, 0.0, 0.0], [-1.0, -1.0, 3.0]] {
            let framing = FramedView { up, direction: Some(direction), fov: None };
            let camera = Camera::framing_along(&bounds, &[], [64, 48], framing);
            let projection = camera.project([64, 48]).unwrap();
            assert!((projection.forward - unit(direction.into()).unwrap()).length() < 1e-12, "{direction:?}");
        }
        let above = FramedView { up, direction: Some([0.0, -1.0, 0.0]), fov: None };
        assert_eq!(Camera::framing_along(&bounds, &[], [64, 48], above).up, [0.0, 0.0, -1.0]);
    }

    /// A ball of boxes fills the picture from edge to edge, where its box left a third of it empty; a thing that lies
    /// in one half of its box is in the middle.
    #[test]
    fn a_picture_is_filled_by_what_is_in_the_box() {
        let mut ball = vec![];
        for at in 0..4096 {
            let lo = [at & 15, at >> 4 & 15, at >> 8].map(|x| f64::from(x) / 8.0 - 1.0);
            if lo.iter().map(|x| (x + 1.0 / 16.0).powi(2)).sum::<f64>() < 1.0 {
                ball.push(Aabb { lo, hi: lo.map(|x| x + 1.0 / 8.0) });
            }
        }
        let bounds = Aabb { lo: [-1.0; 3], hi: [1.0; 3] };
        let wall = vec![Aabb { lo: [-1.0; 3], hi: [-0.8, 1.0, 1.0] }];
        for (outline, resolution) in
            [(&ball, [64, 64]), (&ball, [160, 90]), (&wall, [90, 160]), (&wall, [64, 64])]
        {
            let camera = Camera::framing_along(&bounds, outline, resolution, FramedView::default());
            let projection = camera.project(resolution).unwrap();
            let mut ends = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
            for (of, corner) in outline.iter().flat_map(|of| (0..8).map(move |corner| (of, corner))) {
                let point: [f64; 3] =
                    std::array::from_fn(|a| if corner >> a & 1 == 0 { of.lo[a] } else { of.hi[a] });
                let from = DVec3::from(point) - projection.position;
                let z = from.dot(projection.forward);
                assert!(z > 0.0);
                for (ends, axis) in ends.iter_mut().zip([projection.right, projection.down]) {
                    let at = from.dot(axis) / axis.dot(axis) / z;
                    *ends = [ends[0].min(at), ends[1].max(at)];
                }
            }
            let widths = ends.map(|[least, most]| most - least);
            assert!(ends.as_flattened().iter().all(|end| end.abs() < 0.9401), "{ends:?}");
            assert!(widths.iter().any(|width| (width - 1.88).abs() < 1e-9), "{ends:?}");
            let distance =
                |camera: Camera| (DVec3::from(camera.position) - DVec3::from(camera.target)).length();
            assert!(distance(camera) < 0.95 * distance(Camera::framing(&bounds, resolution, None, None)));
        }
    }

    #[test]
    fn the_ground_has_axes() {
        assert_eq!(ground_axes(DVec3::Y), (DVec3::X, DVec3::Z));
        assert_eq!(ground_axes(DVec3::Z), (DVec3::X, DVec3::NEG_Y));
    }
}
