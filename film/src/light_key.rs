//! `LightKey`: where light is kept in the world.
//!
//! ```text
//! place, by cells whose side is a power of two, some pixels wide where they are seen  -+
//! normal of the side that is seen, mesh or voxels, direction that it is seen from     -+-> 63 bits
//! ```
//!
//! Near surfaces have small cells. Light that depends on where it is seen from, as that of glossy surfaces does, is of
//! a direction, too.
//!
//! N. Binder, S. Fricke, A. Keller, "Massively parallel path space filtering" (2019): cells by hash, and their size.

use crate::hash::mix;

/// Least side of a cell, pixels where it is seen.
const CELL_PIXELS: f64 = 4.0;
/// Parts of 1 that the numbers of a normal, and of a direction, are told apart by.
const NORMAL_PARTS: f64 = 3.0;
const DIRECTION_PARTS: f64 = 12.0;

/// Where light is kept in the world; of no place for what has none.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LightKey(u64);

/// What light is kept of.
#[derive(Clone, Copy, Debug)]
pub struct LightPlace {
    /// Where it is, model units.
    pub place: [f64; 3],
    /// Unit normal.
    pub normal: [f64; 3],
    /// The width of a pixel there, model units.
    pub pixel_width: f64,
    /// Voxels stand in for the mesh.
    pub is_voxel: bool,
    /// Unit direction that it is seen from, where its light depends on that.
    pub seen_from: Option<[f64; 3]>,
}

impl LightKey {
    /// Light is not kept.
    pub const NONE: LightKey = LightKey(0);

    /// The key of light at a place; [`LightKey::NONE`] where numbers are no finite ones.
    pub fn new(of: &LightPlace) -> LightKey {
        let level = (CELL_PIXELS * of.pixel_width).log2().ceil();
        if !level.is_finite() || !of.place.iter().all(|v| v.is_finite()) {
            return LightKey::NONE;
        }
        let scale = (-level).exp2();
        // To the nearest part: what is turned along an axis is not between two.
        let part = |v: f64, parts: f64| (v * parts).round_ties_even() as i8 as u8;
        let turned = of.normal.map(|v| part(v, NORMAL_PARTS));
        let from = of.seen_from.unwrap_or_default().map(|v| part(v, DIRECTION_PARTS));
        // A level takes 12 bits.
        let kind =
            (level as i64 as u64) << 2 | u64::from(of.is_voxel) << 1 | u64::from(of.seen_from.is_some());
        let parts = turned.into_iter().chain(from).fold(kind, |parts, part| parts << 8 | u64::from(part));
        let cell = of.place.map(|v| (v * scale).floor() as i64 as u64);
        LightKey(cell.into_iter().fold(mix(parts), |key, number| mix(key ^ number)) >> 1 | 1 << 62)
    }

    /// Its number, of 63 bits.
    pub(crate) fn bits(self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLACE: LightPlace = LightPlace {
        place: [0.5, 0.5, 0.5],
        normal: [0.0, 0.0, 1.0],
        pixel_width: 0.25,
        is_voxel: false,
        seen_from: None,
    };

    /// Light at a place whose cells have sides of one unit, and at others; in any unit, and far from the origin.
    #[test]
    fn a_key_is_of_one_cell_and_of_what_is_seen_there() {
        for (unit, far) in
            [(1.0, 0.0), (1.0 / 1024.0, 0.0), (1024.0, 0.0), (1.0 / 16.0, 1e7), (2f64.powi(-100), 0.0)]
        {
            let key = |of: LightPlace| {
                let place = of.place.map(|v| v * unit + far);
                LightKey::new(&LightPlace { place, pixel_width: of.pixel_width * unit, ..of })
            };
            let own = key(PLACE);
            for same in [
                LightPlace { place: [0.9, 0.1, 0.6], ..PLACE },
                LightPlace { pixel_width: 0.2, ..PLACE },
                LightPlace { normal: [0.1, 0.1, 0.99], ..PLACE },
            ] {
                assert!(own != LightKey::NONE && key(same) == own, "{unit} {far} {same:?}");
            }
            let glossy = LightPlace { seen_from: Some([0.0, 0.6, 0.8]), ..PLACE };
            let others = [
                LightPlace { place: [1.1, 0.5, 0.5], ..PLACE },
                LightPlace { place: [0.5, -0.5, 0.5], ..PLACE },
                LightPlace { place: [0.5, 0.5, -0.1], ..PLACE },
                LightPlace { pixel_width: 0.5, ..PLACE },
                LightPlace { normal: [0.0, 0.0, -1.0], ..PLACE },
                LightPlace { normal: [0.8, 0.0, 0.6], ..PLACE },
                LightPlace { is_voxel: true, ..PLACE },
                glossy,
                LightPlace { seen_from: Some([0.0, 0.8, 0.6]), ..glossy },
            ];
            let mut keys: Vec<_> = others.into_iter().map(|other| key(other).0).chain([own.0]).collect();
            keys.sort_unstable();
            keys.dedup();
            assert_eq!(keys.len(), others.len() + 1, "{unit} {far}");
        }
    }

    #[test]
    fn places_of_no_number_have_no_key() {
        for none in [f64::NAN, f64::INFINITY] {
            assert_eq!(LightKey::new(&LightPlace { place: [0.0, none, 0.0], ..PLACE }), LightKey::NONE);
            assert_eq!(LightKey::new(&LightPlace { pixel_width: none, ..PLACE }), LightKey::NONE);
            // A key, whichever it is.
            LightKey::new(&LightPlace { normal: [none; 3], seen_from: Some([none; 3]), ..PLACE });
        }
        assert_eq!(LightKey::new(&LightPlace { pixel_width: 0.0, ..PLACE }), LightKey::NONE);
    }
}
