//! The view as texts: a command line that makes the same picture, and a scene file.
//!
//! Invariants: 1. numbers are written so that they are read back bit by bit; 2. a command line names the scene file
//! where flags cannot say what has been edited; 3. a scene is written as it is made: its length is known before it is
//! kept, with 65,536 edited materials as with none.

use crate::materials::name_of;
use std::fmt::{self, Display, Write};
use trex_render::{Camera, Filter, Fov, Light, MaterialEdit, Near, Occluders, RenderKeys};
use trex_store::Material;

/// Name of the scene file in a command line, where one has to be saved first.
const SCENE_NAME: &str = "view.toml";

/// What texts are made of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TextSources<'a> {
    /// The file that was opened, as typed.
    pub(crate) input: &'a str,
    /// Path of the model.
    pub(crate) model: &'a str,
    pub(crate) camera: &'a Camera,
    pub(crate) lights: &'a [Light],
    /// Materials of the file, and what they are now: edits of the scene that was opened are among those of pages.
    pub(crate) materials: [&'a [Material]; 2],
    pub(crate) keys: &'a RenderKeys,
    /// Flags can say it: lights and materials are those of `input`.
    pub(crate) is_by_flags: bool,
}

/// What has been edited of materials, by index: `then` are those of the file, `now` what they have become.
fn edits<'a>([then, now]: [&'a [Material]; 2]) -> impl Iterator<Item = (usize, MaterialEdit)> + 'a {
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

/// The command line.
pub(crate) fn command(sources: &TextSources<'_>) -> String {
    if !sources.is_by_flags {
        return format!("trex render {SCENE_NAME} -o picture.png");
    }
    let Camera { position, target, up, fov } = sources.camera;
    let keys = sources.keys;
    let mut text = format!("trex render {} -o picture.png", quoted(sources.input));
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

/// Counts bytes of what is written.
struct Counting(usize);

impl Write for Counting {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        self.0 += text.len();
        Ok(())
    }
}

/// Bytes of the scene file.
pub(crate) fn scene_bytes(sources: &TextSources<'_>) -> usize {
    let mut counting = Counting(0);
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
    let keys = sources.keys;
    write!(text, "model = {}\n\n[camera]\n", string(sources.model))?;
    writeln!(text, "position = {position:?}\ntarget = {target:?}\nup = {up:?}")?;
    match fov {
        Fov::X(degrees) => writeln!(text, "fov_x = {degrees:?}")?,
        Fov::Y(degrees) => writeln!(text, "fov_y = {degrees:?}")?,
    }
    for light in sources.lights {
        write_light(light, text)?;
    }
    for (index, edit) in edits(sources.materials) {
        write_material(name_of(sources.materials[1], index), &edit, text)?;
    }
    text.write_str("\n[render]\n")?;
    let mut line = |key: &str, value: &dyn Display| writeln!(text, "{key} = {value}");
    line("integrator", &string(keys.integrator.as_str()))?;
    line("resolution", &format_args!("{:?}", keys.resolution))?;
    line("spp", &keys.spp)?;
    line("n_shadow", &keys.n_shadow)?;
    line("n_gather", &keys.n_gather)?;
    line("photons", &keys.photons)?;
    line("k_nearest", &keys.k_nearest)?;
    line("near", &string(near(keys.near)))?;
    line("occluders", &string(occluders(keys.occluders)))?;
    line("lod_error", &format_args!("{:?}", keys.lod_error))?;
    line("bake", &keys.bake)?;
    line("filter", &string(filter(keys.filter)))?;
    line("exposure", &format_args!("{:?}", keys.exposure))?;
    line("seed", &keys.seed)
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
        let name = "odd \"name\" \\ \n";
        let then = [Material::default(), Material { name: name.into(), ..Material::default() }];
        let now = [then[0].clone(), Material { kd: [0.1, 0.2, 0.3], mirror: true, ..then[1].clone() }];
        let (kd, ks) = (Some([0.1, 0.2, 0.3]), Some([0.0; 3]));
        let edit = MaterialEdit { kd, ks, mirror: Some(true), ..MaterialEdit::default() };
        let keys = RenderKeys {
            integrator: Method::FullGi,
            exposure: 0.1,
            lod_error: 1.0,
            filter: Filter::On,
            photons: 12345,
            ..RenderKeys::default()
        };
        let sources = TextSources {
            input: "a b.toml",
            model: "it's.trex",
            camera: &camera,
            lights: &lights,
            materials: [&then, &now],
            keys: &keys,
            is_by_flags: false,
        };
        let text = scene(&sources, 0);
        assert_eq!(scene_bytes(&sources), text.len());
        let read = Scene::parse(&text, Path::new("view.toml")).unwrap();
        assert_eq!(
            (read.model.as_str(), read.lights.as_slice(), read.render),
            ("it's.trex", &lights[..], keys)
        );
        assert_eq!(read.materials.into_iter().collect::<Vec<_>>(), [(name.to_owned(), edit)]);
        let keys_of_camera = (read.camera.position, read.camera.target, read.camera.fov_y);
        assert_eq!(keys_of_camera, (Some(camera.position), Some(camera.target), Some(39.999_999_999_999_99)));
        assert_eq!(command(&sources), "trex render view.toml -o picture.png");
        let by_flags = command(&TextSources { is_by_flags: true, ..sources });
        assert!(
            by_flags.starts_with("trex render 'a b.toml' -o picture.png --resolution 1024x1024"),
            "{by_flags}"
        );
        assert!(
            by_flags.contains("--exposure 0.1 ") && by_flags.contains("--camera-position 0.1,-0.000000001,")
        );
    }
}
