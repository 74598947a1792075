//! The view as texts: a command line that makes the same picture, and a scene file.
//!
//! Invariants: 1. numbers are written so that they are read back bit by bit; 2. a command line names the scene file
//! where flags cannot say what has been edited.

use std::fmt::{Display, Write};
use trex_render::{Camera, Filter, Fov, Light, MaterialEdit, Model, Near, Occluders, RenderKeys};
use trex_store::Material;

/// Name of the scene file in a command line, where one has to be saved first.
const SCENE_NAME: &str = "view.toml";

/// What texts are made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Viewed<'a> {
    /// The file that was opened, as typed.
    pub(crate) input: &'a str,
    /// Path of the model.
    pub(crate) model: &'a str,
    pub(crate) camera: &'a Camera,
    pub(crate) lights: &'a [Light],
    /// Edits of materials, by name; those of the scene that was opened are among them.
    pub(crate) materials: &'a [(String, MaterialEdit)],
    pub(crate) keys: &'a RenderKeys,
    /// Flags can say it: lights and materials are those of `input`.
    pub(crate) is_by_flags: bool,
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

/// The command line.
pub(crate) fn command(viewed: &Viewed<'_>) -> String {
    if !viewed.is_by_flags {
        return format!("trex render {SCENE_NAME} -o picture.png");
    }
    let Camera { position, target, up, fov } = viewed.camera;
    let keys = viewed.keys;
    let mut text = format!("trex render {} -o picture.png", quoted(viewed.input));
    let mut flag = |name: &str, value: &dyn Display| {
        let _ = write!(text, " --{name} {value}");
    };
    let joined = |v: &[f64; 3]| format!("{},{},{}", v[0], v[1], v[2]);
    flag("resolution", &format_args!("{}x{}", keys.resolution[0], keys.resolution[1]));
    flag("spp", &keys.spp);
    flag("integrator", &keys.integrator.as_str());
    flag("n-shadow", &keys.n_shadow);
    flag("n-gather", &keys.n_gather);
    flag("photons", &keys.photons);
    flag("k-nearest", &keys.k_nearest);
    flag("near", &near(keys.near));
    flag("occluders", &occluders(keys.occluders));
    flag("lod-error", &keys.lod_error);
    flag("filter", &filter(keys.filter));
    flag("exposure", &keys.exposure);
    flag("seed", &keys.seed);
    flag("camera-position", &joined(position));
    flag("camera-target", &joined(target));
    flag("camera-up", &joined(up));
    match fov {
        Fov::X(degrees) => flag("fov-x", degrees),
        Fov::Y(degrees) => flag("fov-y", degrees),
    }
    if keys.bake {
        text.push_str(" --bake");
    }
    text
}

/// The scene file.
pub(crate) fn scene(viewed: &Viewed<'_>) -> String {
    let Camera { position, target, up, fov } = viewed.camera;
    let keys = viewed.keys;
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
    let mut line = |key: &str, value: &dyn Display| {
        let _ = writeln!(text, "{key} = {value}");
    };
    line("integrator", &string(keys.integrator.as_str()));
    line("resolution", &format_args!("{:?}", keys.resolution));
    line("spp", &keys.spp);
    line("n_shadow", &keys.n_shadow);
    line("n_gather", &keys.n_gather);
    line("photons", &keys.photons);
    line("k_nearest", &keys.k_nearest);
    line("near", &string(near(keys.near)));
    line("occluders", &string(occluders(keys.occluders)));
    line("lod_error", &format_args!("{:?}", keys.lod_error));
    line("bake", &keys.bake);
    line("filter", &string(filter(keys.filter)));
    line("exposure", &format_args!("{:?}", keys.exposure));
    line("seed", &keys.seed);
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

fn near(near: Near) -> &'static str {
    match near {
        Near::Voxel => "voxel",
        Near::Exact => "exact",
    }
}

fn occluders(occluders: Occluders) -> &'static str {
    match occluders {
        Occluders::On => "on",
        Occluders::Off => "off",
    }
}

fn filter(filter: Filter) -> &'static str {
    match filter {
        Filter::On => "on",
        Filter::Off => "off",
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

/// A word of a command line, quoted where a shell would need it.
fn quoted(text: &str) -> String {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./:,=%+".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        return text.to_owned();
    }
    format!("'{}'", text.replace('\'', "'\\''"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;
    use trex_render::{Method, Scene};

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
            input: "a b.toml",
            model: "it's.trex",
            camera: &camera,
            lights: &lights,
            materials: &materials,
            keys: &keys,
            is_by_flags: false,
        };
        let read = Scene::parse(&scene(&viewed), Path::new("view.toml")).unwrap();
        assert_eq!(
            (read.model.as_str(), read.lights.as_slice(), read.render),
            ("it's.trex", &lights[..], keys)
        );
        assert_eq!(read.materials.into_iter().collect::<Vec<_>>(), materials);
        let keys_of_camera = (read.camera.position, read.camera.target, read.camera.fov_y);
        assert_eq!(keys_of_camera, (Some(camera.position), Some(camera.target), Some(39.999_999_999_999_99)));
        assert_eq!(command(&viewed), "trex render view.toml -o picture.png");
        let by_flags = command(&Viewed { is_by_flags: true, ..viewed });
        assert!(
            by_flags.starts_with("trex render 'a b.toml' -o picture.png --resolution 1024x1024"),
            "{by_flags}"
        );
        assert!(
            by_flags.contains("--exposure 0.1 ") && by_flags.contains("--camera-position 0.1,-0.000000001,")
        );
    }
}
