//! `Lens`: where the pixels of a film look. `Eye`: where what is seen stands, and where a place is seen.

use glam::DVec3;

/// What the filter has to know of a camera.
pub trait Lens: Sync {
    /// Unit direction in which place (x, y) of the film looks, pixels from its upper left corner.
    fn direction(&self, x: f64, y: f64) -> [f64; 3];

    /// Angle that a pixel takes in the middle of the film, radians.
    fn pixel_angle(&self) -> f64;
}

/// A pinhole with a film, as plain numbers: of a picture that is gone, too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Eye {
    /// The pinhole, model units.
    pub position: [f64; 3],
    /// Unit direction of the middle of the film.
    pub forward: [f64; 3],
    /// Way from the middle of the film to its right edge, at distance 1 along `forward`, across it.
    pub right: [f64; 3],
    /// Way from the middle of the film to its lower edge, at distance 1 along `forward`, across both.
    pub down: [f64; 3],
    /// Width and height of the film, pixels.
    pub resolution: [u32; 2],
}

impl Eye {
    /// The place that is seen at (x, y) of the film, pixels from its upper left corner, so far from the eye.
    pub(crate) fn place(&self, x: f64, y: f64, distance: f64) -> DVec3 {
        let [width, height] = self.resolution.map(f64::from);
        let across = (2.0 * x / width - 1.0) * DVec3::from(self.right);
        let down = (2.0 * y / height - 1.0) * DVec3::from(self.down);
        DVec3::from(self.position) + distance * (DVec3::from(self.forward) + across + down).normalize()
    }

    /// Where (x, y) of the film a place is seen, pixels from its upper left corner; `None` for one behind the eye or beside
    /// the film.
    pub(crate) fn film(&self, place: DVec3) -> Option<[f64; 2]> {
        let way = place - DVec3::from(self.position);
        let depth = way.dot(DVec3::from(self.forward));
        if depth <= 0.0 {
            return None;
        }
        let at = |axis: [f64; 3], side: u32| {
            let axis = DVec3::from(axis);
            0.5 * f64::from(side) * (way.dot(axis) / axis.length_squared() / depth + 1.0)
        };
        let at = [at(self.right, self.resolution[0]), at(self.down, self.resolution[1])];
        let is_on_film = (0..2).all(|a| at[a] >= 0.0 && at[a] < f64::from(self.resolution[a]));
        is_on_film.then_some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Pinhole;

    /// Against a pinhole that is written another way.
    #[test]
    fn a_place_is_seen_where_it_stands() {
        let resolution = [40, 30];
        let lens = Pinhole { position: DVec3::new(3.0, 1.0, 2.0), target: DVec3::new(0.0, 0.5, -4.0), fov_x: 50.0, resolution };
        let eye = lens.eye();
        for [x, y] in [[0.5, 0.5], [20.0, 15.0], [39.9, 7.3], [11.0, 29.5]] {
            let place = lens.position + 7.0 * DVec3::from(lens.direction(x, y));
            assert!((eye.place(x, y, 7.0) - place).length() < 1e-12);
            let found = eye.film(place).unwrap();
            assert!((found[0] - x).abs() < 1e-9 && (found[1] - y).abs() < 1e-9, "{found:?}");
        }
        assert_eq!(eye.film(lens.position - (lens.target - lens.position)), None, "behind");
        assert_eq!(eye.film(lens.position + DVec3::from(lens.direction(41.0, 5.0))), None, "beside");
    }
}
