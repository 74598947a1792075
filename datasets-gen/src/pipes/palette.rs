//! The plant's materials: index is meaning, so parts name them by constant.

use trex_store::{Material, MaterialList};

pub(super) const CONCRETE: u32 = 0;
pub(super) const WALL: u32 = 1;
pub(super) const ROOF: u32 = 2;
pub(super) const STEEL: u32 = 3;
pub(super) const GRATING: u32 = 4;
pub(super) const BOLT: u32 = 5;
pub(super) const LAMP: u32 = 6;
pub(super) const CHROME: u32 = 7;
pub(super) const BRASS_MIRROR: u32 = 8;
pub(super) const RAIL: u32 = 9;
pub(super) const MOTOR: u32 = 10;
pub(super) const FLANGE: u32 = 11;
/// First of the glossy tank coats.
pub(super) const TANKS: u32 = 12;
pub(super) const TANK_COUNT: u32 = 4;
/// First of the pipe paints.
pub(super) const PAINTS: u32 = TANKS + TANK_COUNT;
pub(super) const PAINT_COUNT: u32 = 12;

/// Radiance of the lamps.
const LAMP_RADIANCE: [f32; 3] = [18.0, 16.5, 14.0];

/// All materials, by index.
pub(super) fn materials() -> MaterialList {
    let matt = |name: &str, kd| (name.to_owned(), Material { kd, ..Material::default() });
    let glossy =
        |name: &str, kd, ks, ns| (name.to_owned(), Material { kd, ks: [ks; 3], ns, ..Material::default() });
    let mirror = |name: &str, ks| {
        (name.to_owned(), Material { kd: [0.02; 3], ks, ns: 1000.0, mirror: true, ..Material::default() })
    };
    let lamp = Material { kd: [0.0; 3], ke: LAMP_RADIANCE, ..Material::default() };
    let mut all = vec![
        matt("concrete", [0.46, 0.45, 0.43]),
        matt("wall", [0.62, 0.64, 0.62]),
        matt("roof", [0.55, 0.56, 0.58]),
        glossy("steel", [0.32, 0.34, 0.37], 0.2, 30.0),
        matt("grating", [0.28, 0.28, 0.27]),
        glossy("bolt", [0.40, 0.40, 0.42], 0.35, 80.0),
        ("lamp".to_owned(), lamp),
        mirror("chrome", [0.9, 0.91, 0.93]),
        mirror("brass", [0.85, 0.68, 0.32]),
        glossy("rail", [0.85, 0.66, 0.06], 0.06, 20.0),
        glossy("motor", [0.10, 0.24, 0.42], 0.15, 40.0),
        glossy("flange", [0.48, 0.47, 0.44], 0.2, 50.0),
    ];
    for (name, kd) in [
        ("white", [0.80; 3]),
        ("cream", [0.78, 0.71, 0.52]),
        ("teal", [0.12, 0.42, 0.42]),
        ("rust", [0.48, 0.20, 0.10]),
    ] {
        all.push(glossy(&format!("tank-{name}"), kd, 0.12, 120.0));
    }
    let paints: [(&str, [f32; 3]); PAINT_COUNT as usize] = [
        ("water-green", [0.09, 0.42, 0.20]),
        ("steam-silver", [0.60, 0.61, 0.62]),
        ("oil-brown", [0.33, 0.20, 0.10]),
        ("gas-yellow", [0.82, 0.60, 0.07]),
        ("acid-violet", [0.36, 0.20, 0.48]),
        ("air-blue", [0.22, 0.45, 0.74]),
        ("fire-red", [0.64, 0.06, 0.05]),
        ("brine-orange", [0.80, 0.34, 0.05]),
        ("black", [0.05, 0.05, 0.05]),
        ("white", [0.78, 0.78, 0.76]),
        ("copper", [0.58, 0.32, 0.20]),
        ("primer-grey", [0.40, 0.41, 0.42]),
    ];
    all.extend(paints.map(|(name, kd)| glossy(&format!("pipe-{name}"), kd, 0.1, 60.0)));
    all.into_iter().collect()
}
