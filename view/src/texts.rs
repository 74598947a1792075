//! The view as a scene file.
//!
//! Invariant: numbers are written so that they are read back bit by bit.

use std::fmt::{Display, Write};
use trex_render::{Camera, Fov, Light, MaterialEdit, Model, RenderKeys};
use trex_store::Material;

/// What texts are made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Viewed<'a> {
    /// Path of the model.
    pub(crate) model: &'a str,
    pub(crate) camera: &'a Camera,
    pub(crate) lights: &'a [Light],
    /// Edits of materials, by name; those of the scene that was opened are among them.
    pub(crate) materials: &'a [(String, MaterialEdit)],
    pub(crate) keys: &'a RenderKeys,
}

/// What has been edited of materials: `then` are those of the file, `model` has what they have become.
pub(crate) fn edits(then: &[Material], model: &Model) -> Vec<(String, MaterialEdit)> {
    let edit = |(index, (then, now)): (usize, (&Material, &Material))| {
        let reflects_alike = (then.kd, then.ks) == (now.kd, now.ks);
        let edit = MaterialEdit {
            kd: (!reflects_alike).then_some(now.kd),
            ks: (!reflects_alike).then_some(now.ks),
            ns: (then.ns != now.ns).then_some(now.ns),
            ke: (then.ke != now.ke).then_some(now.ke),
            mirror: (then.mirror != now.mirror).then_some(now.mirror),
        };
        let name = || model.names.get(index).unwrap_or_default().to_owned();
        (edit != MaterialEdit::default()).then(|| (name(), edit))
    };
    then.iter().zip(&model.materials).enumerate().filter_map(edit).collect()
}

/// The scene file.
pub(crate) fn scene(viewed: &Viewed<'_>) -> String {
    let Camera { position, target, up, fov } = viewed.camera;
    let mut text = format!("model = {}\n\n[camera]\n", string(viewed.model));
    let mut line = |key: &str, value: &dyn Display| {
        let _ = writeln!(text, "{key} = {value}");
    };
    line("position", &format_args!("{position:?}"));
    line("target", &format_args!("{target:?}"));
    line("up", &format_args!("{up:?}"));
    match fov {
        Fov::X(degrees) => line("fov_x", &format_args!("{degrees:?}")),
        Fov::Y(degrees) => line("fov_y", &format_args!("{degrees:?}")),
    }
    for light in viewed.lights {
        write_light(light, &mut text);
    }
    for (name, edit) in viewed.materials {
        write_material(name, edit, &mut text);
    }
    text.push_str("\n[render]\n");
    for (key, value) in viewed.keys.values() {
        let _ = writeln!(text, "{} = {value}", key.name);
    }
    text
}

fn write_light(light: &Light, text: &mut String) {
    let _ = match light {
        Light::Point { position, intensity } => writeln!(
            text,
            "\n[[light]]\ntype = \"point\"\nposition = {position:?}\nintensity = {intensity:?}"
        ),
        Light::Directional { direction, irradiance } => writeln!(
            text,
            "\n[[light]]\ntype = \"directional\"\ndirection = {direction:?}\nirradiance = {irradiance:?}"
        ),
        Light::Rect { corner, edge_u, edge_v, radiance } => writeln!(
            text,
            "\n[[light]]\ntype = \"rect\"\ncorner = {corner:?}\nedge_u = {edge_u:?}\nedge_v = {edge_v:?}\n\
             radiance = {radiance:?}"
        ),
        Light::Sky { radiance } => writeln!(text, "\n[[light]]\ntype = \"sky\"\nradiance = {radiance:?}"),
    };
}

fn write_material(name: &str, edit: &MaterialEdit, text: &mut String) {
    let MaterialEdit { kd, ks, ns, ke, mirror } = *edit;
    let _ = writeln!(text, "\n[material.{}]", string(name));
    for (key, rgb) in [("kd", kd), ("ks", ks), ("ke", ke)] {
        if let Some(rgb) = rgb {
            let _ = writeln!(text, "{key} = {rgb:?}");
        }
    }
    if let Some(ns) = ns {
        let _ = writeln!(text, "ns = {ns:?}");
    }
    if let Some(mirror) = mirror {
        let _ = writeln!(text, "mirror = {mirror}");
    }
}

/// A string of TOML.
fn string(text: &str) -> String {
    let mut quoted = String::from('"');
    for c in text.chars() {
        match c {
            '"' | '\\' => quoted.extend(['\\', c]),
            c if c.is_control() => {
                let _ = write!(quoted, "\\u{:04X}", u32::from(c));
            }
            c => quoted.push(c),
        }
    }
    quoted.push('"');
    quoted
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_pcg::Pcg64Mcg;
    use rand_pcg::rand_core::{Rng, SeedableRng};
    use std::path::Path;
    use trex_render::{Filter, Method, Near, Occluders, RenderSettings, Scene};

    #[test]
    fn a_scene_comes_back_as_it_was() {
        let camera = Camera {
            position: [0.1, -1e-9, 1e21],
            target: [1.0 / 3.0, 0.0, -0.0],
            up: [0.0, 1.0, 0.0],
            fov: Fov::Y(39.999_999_999_999_99),
        };
        let lights = [
            Light::Point { position: [0.1, 2.0, 1e300], intensity: [1.0, 0.1, 1e-30] },
            Light::Directional { direction: [0.0, -1.0, 0.0], irradiance: [2.0; 3] },
            Light::Rect {
                corner: [0.0; 3],
                edge_u: [1.0, 0.0, 0.0],
                edge_v: [0.0, 1.0, 0.0],
                radiance: [3.5; 3],
            },
            Light::Sky { radiance: [0.3; 3] },
        ];
        let edit = MaterialEdit { kd: Some([0.1, 0.2, 0.3]), mirror: Some(true), ..MaterialEdit::default() };
        let materials = [("odd \"name\" \\ \n".to_owned(), edit)];
        let keys = RenderKeys {
            integrator: Method::FullGi,
            exposure: 0.1,
            lod_error: 1.0,
            filter: Filter::On,
            photons: 12345,
            ..RenderKeys::default()
        };
        let viewed = Viewed {
            model: "it's.trex",
            camera: &camera,
            lights: &lights,
            materials: &materials,
            keys: &keys,
        };
        let read = Scene::parse(&scene(&viewed), Path::new("view.toml")).unwrap();
        assert_eq!(
            (read.model.as_str(), read.lights.as_slice(), read.render),
            ("it's.trex", &lights[..], keys)
        );
        assert_eq!(read.materials.into_iter().collect::<Vec<_>>(), materials);
        let keys_of_camera = (read.camera.position, read.camera.target, read.camera.fov_y);
        assert_eq!(keys_of_camera, (Some(camera.position), Some(camera.target), Some(39.999_999_999_999_99)));
    }

    /// Settings that pass the gate; each key at either end of its range, or anywhere.
    fn random_keys(random: &mut Pcg64Mcg) -> RenderKeys {
        fn pick<T: Copy>(random: &mut Pcg64Mcg, all: &[T]) -> T {
            all[random.next_u32() as usize % all.len()]
        }
        let mut within = |least: u64, most: u64| match random.next_u32() % 4 {
            0 => least,
            1 => most,
            // Small numbers as often as great ones.
            _ => least + (random.next_u64() >> (random.next_u32() % 64)) % (most - least + 1),
        };
        let [width, height, spp, n_shadow, n_gather, k_nearest] =
            [(1, 65_536), (1, 65_536), (1, 1_000_000_000), (0, 4096), (0, 4096), (2, 1024)]
                .map(|(least, most)| within(least, most) as u32);
        let (photons, seed) = (within(1, 1 << 30), within(0, (1 << 63) - 1));
        let integrator = pick(random, &Method::ALL);
        let gathers = [Method::Photon, Method::FullGi].contains(&integrator);
        let exposure = f32::from_bits(random.next_u32() & 0x7fff_ffff);
        RenderKeys {
            integrator,
            resolution: [width, height],
            spp,
            n_shadow,
            n_gather,
            photons,
            k_nearest,
            bake: integrator == Method::Photon && random.next_u32().is_multiple_of(2),
            near: pick(random, &[Near::Voxel, Near::Exact]),
            occluders: pick(random, &[Occluders::On, Occluders::Off]),
            lod_error: 1024.0 * (random.next_u64() as f64 / u64::MAX as f64).powi(7),
            filter: if gathers { pick(random, &[Filter::On, Filter::Off]) } else { Filter::Off },
            exposure: if exposure > 0.0 && exposure.is_finite() { exposure } else { 1.0 },
            seed,
        }
    }

    /// Settings that the page could reach were written as scenes that no command accepted, or that made others.
    #[test]
    fn settings_come_back_from_the_scene_that_says_them() {
        let mut random = Pcg64Mcg::seed_from_u64(11);
        let camera = Camera { position: [1.0; 3], target: [0.0; 3], up: [0.0, 1.0, 0.0], fov: Fov::Y(40.0) };
        for _ in 0..3000 {
            let keys = random_keys(&mut random);
            RenderSettings::new(keys).unwrap_or_else(|error| panic!("{keys:?}: {error}"));
            let viewed =
                Viewed { model: "a.trex", camera: &camera, lights: &[], materials: &[], keys: &keys };
            let text = scene(&viewed);
            let read =
                Scene::parse(&text, Path::new("view.toml")).unwrap_or_else(|error| panic!("{error}: {text}"));
            assert_eq!(read.render, keys, "{text}");
        }
    }
}
