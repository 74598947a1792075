//! The view as a scene file.
//!
//! Invariants: 1. numbers are written so that they are read back bit by bit; 2. a scene is written as it is made: its
//! length is known before it is kept, with 65,536 edited materials as with none.

use crate::materials::name_of;
use std::fmt::{self, Write};
use trex_render::{Camera, Fov, Light, MaterialEdit, Model, Parts, RenderKeys, Section};
use trex_store::Material;

/// What texts are made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TextSources<'a> {
    /// Path of the model.
    pub(crate) model: &'a str,
    pub(crate) camera: &'a Camera,
    pub(crate) lights: &'a [Light],
    /// Materials of the file; edits of the scene that was opened are among those of pages.
    pub(crate) materials: &'a [Material],
    /// The model, with the materials as they are now, and their names.
    pub(crate) edited: &'a Model,
    pub(crate) keys: &'a RenderKeys,
    /// What is shown of the model.
    pub(crate) parts: &'a Parts,
}

/// What has been edited of materials, by index: `then` are those of the file, `now` what they have become.
fn edits(then: &[Material], now: &[Material]) -> impl Iterator<Item = (usize, MaterialEdit)> {
    let edit = |(index, (then, now)): (usize, (&Material, &Material))| {
        let reflects_alike = (then.kd, then.ks) == (now.kd, now.ks);
        let edit = MaterialEdit {
            kd: (!reflects_alike).then_some(now.kd),
            ks: (!reflects_alike).then_some(now.ks),
            ns: (then.ns != now.ns).then_some(now.ns),
            ke: (then.ke != now.ke).then_some(now.ke),
            mirror: (then.mirror != now.mirror).then_some(now.mirror),
        };
        (edit != MaterialEdit::default()).then_some((index, edit))
    };
    then.iter().zip(now).enumerate().filter_map(edit)
}

/// Counts bytes of what is written.
struct ByteCounter(usize);

impl Write for ByteCounter {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0 += text.len();
        Ok(())
    }
}

/// Bytes of the scene file.
pub(crate) fn scene_bytes(sources: &TextSources<'_>) -> usize {
    let mut counting = ByteCounter(0);
    write_scene(sources, &mut counting).expect("counting does not fail");
    counting.0
}

/// The scene file, of so many bytes.
pub(crate) fn scene(sources: &TextSources<'_>, bytes: usize) -> String {
    let mut text = String::with_capacity(bytes);
    write_scene(sources, &mut text).expect("a string takes what is written");
    text
}

fn write_scene(sources: &TextSources<'_>, text: &mut dyn Write) -> fmt::Result {
    let Camera { position, target, up, fov } = sources.camera;
    write!(text, "model = {}\n\n[camera]\n", string(sources.model))?;
    writeln!(text, "position = {position:?}\ntarget = {target:?}\nup = {up:?}")?;
    match fov {
        Fov::X(degrees) => writeln!(text, "fov_x = {degrees:?}")?,
        Fov::Y(degrees) => writeln!(text, "fov_y = {degrees:?}")?,
    }
    for light in sources.lights {
        write_light(light, text)?;
    }
    for (index, edit) in edits(sources.materials, &sources.edited.materials) {
        write_material(name_of(sources.edited, index), &edit, text)?;
    }
    write_parts(sources, text)?;
    text.write_str("\n[render]\n")?;
    for (key, value) in sources.keys.values() {
        writeln!(text, "{} = {value}", key.name)?;
    }
    Ok(())
}

fn write_parts(sources: &TextSources<'_>, text: &mut dyn Write) -> fmt::Result {
    let TextSources { parts, edited, .. } = sources;
    if parts.is_whole() {
        return Ok(());
    }
    text.write_str("\n[parts]\nsection = [")?;
    for Section { point: [px, py, pz], normal: [nx, ny, nz] } in parts.sections() {
        write!(text, "[{px:?}, {py:?}, {pz:?}, {nx:?}, {ny:?}, {nz:?}], ")?;
    }
    text.write_str("]\nhide = [")?;
    for index in (0..edited.materials.len()).filter(|&index| parts.hides(index)) {
        write!(text, "{}, ", string(name_of(edited, index)))?;
    }
    text.write_str("]\n")
}

fn write_light(light: &Light, text: &mut dyn Write) -> fmt::Result {
    match light {
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
    }
}

fn write_material(name: &str, edit: &MaterialEdit, text: &mut dyn Write) -> fmt::Result {
    let MaterialEdit { kd, ks, ns, ke, mirror } = *edit;
    writeln!(text, "\n[material.{}]", string(name))?;
    for (key, rgb) in [("kd", kd), ("ks", ks), ("ke", ke)] {
        if let Some(rgb) = rgb {
            writeln!(text, "{key} = {rgb:?}")?;
        }
    }
    if let Some(ns) = ns {
        writeln!(text, "ns = {ns:?}")?;
    }
    if let Some(mirror) = mirror {
        writeln!(text, "mirror = {mirror}")?;
    }
    Ok(())
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
    use crate::materials::tests::model;
    use rand_pcg::Pcg64Mcg;
    use rand_pcg::rand_core::{Rng, SeedableRng};
    use std::path::Path;
    use trex_render::{
        Exposure, Filter, LightRig, Method, Near, Occluders, RenderSettings, Scene, Shadows, UpAxis,
    };

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
        let name = "odd \"name\" \\ \n";
        let then = [Material::default(); 2];
        let now = vec![then[0], Material { kd: [0.1, 0.2, 0.3], mirror: true, ..then[1] }];
        let edited = model(now, &["default", name]);
        let (kd, ks) = (Some([0.1, 0.2, 0.3]), Some([0.0; 3]));
        let edit = MaterialEdit { kd, ks, mirror: Some(true), ..MaterialEdit::default() };
        let keys = RenderKeys {
            integrator: Method::FullGi,
            exposure: Exposure::Factor(0.1),
            lod_error: 1.0,
            filter: Filter::On,
            photons: 12345,
            ..RenderKeys::default()
        };
        let plane = [0.1, 1e-9, -3.0, 0.0, 0.6, -0.8];
        let parts = Parts::new(vec![Section::new([0.1, 1e-9, -3.0], [0.0, 0.6, -0.8]).unwrap()], &[1]);
        let sources = TextSources {
            model: "it's.trex",
            camera: &camera,
            lights: &lights,
            materials: &then,
            edited: &edited,
            keys: &keys,
            parts: &parts,
        };
        let text = scene(&sources, 0);
        assert_eq!(scene_bytes(&sources), text.len());
        let read = Scene::parse(&text, Path::new("view.toml")).unwrap();
        assert_eq!(
            (read.model.as_str(), read.lights.as_slice(), read.render),
            ("it's.trex", &lights[..], keys)
        );
        assert_eq!((&read.parts.section[..], &read.parts.hide[..]), (&[plane][..], &[name.to_owned()][..]));
        assert_eq!(read.materials.into_iter().collect::<Vec<_>>(), [(name.to_owned(), edit)]);
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
            light: pick(random, &[LightRig::Scene, LightRig::Studio]),
            up: pick(random, &[UpAxis::Auto, UpAxis::YDown, UpAxis::ZUp]),
            resolution: [width, height],
            spp,
            n_shadow,
            n_gather,
            photons,
            k_nearest,
            bake: integrator == Method::Photon && random.next_u32().is_multiple_of(2),
            caustics: integrator == Method::Photon && random.next_u32().is_multiple_of(2),
            near: pick(random, &[Near::Voxel, Near::Contact, Near::Exact]),
            shadows: pick(random, &[Shadows::Voxel, Shadows::Mesh]),
            occluders: pick(random, &[Occluders::On, Occluders::Off]),
            lod_error: 1024.0 * (random.next_u64() as f64 / u64::MAX as f64).powi(7),
            filter: if gathers { pick(random, &[Filter::On, Filter::Off]) } else { Filter::Off },
            exposure: Exposure::Factor(if exposure > 0.0 && exposure.is_finite() { exposure } else { 1.0 }),
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
            let sources = TextSources {
                model: "a.trex",
                camera: &camera,
                lights: &[],
                materials: &[],
                edited: &model(vec![], &[]),
                keys: &keys,
                parts: &Parts::default(),
            };
            let text = scene(&sources, scene_bytes(&sources));
            let read =
                Scene::parse(&text, Path::new("view.toml")).unwrap_or_else(|error| panic!("{error}: {text}"));
            assert_eq!(read.render, keys, "{text}");
        }
    }
}
