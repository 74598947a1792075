//! The command line that makes a picture: what the viewer's page offers to be copied.
//!
//! Invariant: a shell and the parser of `trex render` read a line back as the picture that it was made of, whatever the
//! file that it names says.

use crate::args::key_words;
use trex_render::{Camera, Fov};
use trex_view::Recipe;

/// Name of the scene file in a line, where one has to be saved first.
const SCENE_NAME: &str = "view.toml";

/// The line for `recipe`; `input`: the file that was opened, as typed.
pub fn render_line(input: &str, recipe: &Recipe<'_>) -> String {
    match recipe {
        Recipe::Saved => format!("trex render {SCENE_NAME} -o picture.png"),
        Recipe::Opened { camera, keys } => {
            format!("trex render {} -o picture.png{}{}", quoted(input), key_words(keys), camera_words(camera))
        }
    }
}

fn camera_words(camera: &Camera) -> String {
    let Camera { position, target, up, fov } = camera;
    let joined = |[x, y, z]: &[f64; 3]| format!("{x},{y},{z}");
    let angle = match fov {
        Fov::X(degrees) => format!("--fov-x {degrees}"),
        Fov::Y(degrees) => format!("--fov-y {degrees}"),
    };
    format!(
        " --camera-position {} --camera-target {} --camera-up {} {angle}",
        joined(position),
        joined(target),
        joined(up)
    )
}

/// A word of a command line, quoted where a shell would need it, and never taken for a flag.
fn quoted(text: &str) -> String {
    let text = if text.starts_with('-') { format!("./{text}") } else { text.to_owned() };
    let is_plain = |c: char| c.is_ascii_alphanumeric() || "-_./:,=%+".contains(c);
    if !text.is_empty() && text.chars().all(is_plain) {
        return text;
    }
    format!("'{}'", text.replace('\'', "'\\''"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::args::{Cli, Verb};
    use clap::Parser;
    use rand_pcg::Pcg64Mcg;
    use rand_pcg::rand_core::{Rng, SeedableRng};
    use trex_render::keys::KEYS;
    use trex_render::{Key, KeyKind, KeyValue, RenderEdit, RenderKeys, RenderSettings, Scene};

    /// A value in the range of `key`: an end of it, or any.
    fn random_value(key: &Key, random: &mut Pcg64Mcg) -> KeyValue {
        let mut whole = |least: u64, most: u64| match random.next_u32() % 4 {
            0 => least,
            1 => most,
            // Small numbers as often as great ones.
            _ => least + (random.next_u64() >> (random.next_u32() % 64)) % (most - least + 1),
        };
        match key.kind {
            KeyKind::Count { least, most } => KeyValue::Count(whole(least, most)),
            KeyKind::Pair { most } => KeyValue::Pair([0; 2].map(|_| whole(1, most.into()) as u32)),
            KeyKind::Choice(choices) => {
                KeyValue::Choice(choices[whole(0, choices.len() as u64 - 1) as usize].name)
            }
            KeyKind::Flag => KeyValue::Flag(whole(0, 1) == 1),
            KeyKind::Length { most } => KeyValue::Number(most * (random.next_u64() as f64 / u64::MAX as f64)),
            KeyKind::Factor if random.next_u32().is_multiple_of(8) => KeyValue::Choice("auto"),
            // Any float of single precision that is one, by its bits.
            KeyKind::Factor => {
                let bits = 1 + random.next_u32() % (f32::INFINITY.to_bits() - 1);
                KeyValue::Number(f32::from_bits(bits).to_string().parse().unwrap())
            }
        }
    }

    /// Settings that pass the gate.
    fn random_settings(random: &mut Pcg64Mcg) -> RenderKeys {
        loop {
            let edit: RenderEdit = KEYS.map(|key| (key, random_value(key, random))).into_iter().collect();
            let keys = edit.apply(&RenderKeys::default());
            if RenderSettings::new(keys).is_ok() {
                return keys;
            }
        }
    }

    fn read(words: &[String], mut scene: Scene) -> Scene {
        let parsed = Cli::try_parse_from(words).unwrap_or_else(|error| panic!("{words:?}: {error}"));
        let Verb::Render(args) = parsed.verb else { panic!("{words:?} is no render") };
        args.picture.override_scene(&args.research, &mut scene);
        scene
    }

    /// Scenes had up to 2^40 photons and sides of 65536 pixels where flags took 4 * 10^9 and 32768, and no flag turned
    /// the `bake` of a scene off.
    #[test]
    fn a_picture_comes_back_from_its_command_line_whatever_the_file_says() {
        let mut random = Pcg64Mcg::seed_from_u64(7);
        for _ in 0..400 {
            let (keys, others) = (random_settings(&mut random), random_settings(&mut random));
            let mut part = || (random.next_u32() as i32 as f64) * 10f64.powi(random.next_u32() as i32 % 40);
            let mut vector = || [part(), part(), part()];
            let [position, target, up] = [vector(), vector(), vector()];
            let fov = if keys.seed.is_multiple_of(2) { Fov::X(0.001) } else { Fov::Y(100.0 / 3.0) };
            let camera = Camera { position, target, up, fov };
            let line = render_line("a.toml", &Recipe::Opened { camera: &camera, keys: &keys });
            let words: Vec<String> = line.split_whitespace().map(str::to_owned).collect();
            let mut file = Scene { render: others, ..Scene::default() };
            (file.camera.fov_x, file.camera.up) = (Some(3.0), Some([0.0, 0.0, 1.0]));
            let found = read(&words, file);
            assert_eq!(found.render, keys, "{line}");
            let angles = match fov {
                Fov::X(degrees) => (Some(degrees), None),
                Fov::Y(degrees) => (None, Some(degrees)),
            };
            let of_camera = (found.camera.position, found.camera.target, found.camera.up);
            assert_eq!(of_camera, (Some(position), Some(target), Some(up)), "{line}");
            assert_eq!((found.camera.fov_x, found.camera.fov_y), angles, "{line}");
        }
    }

    #[test]
    fn a_shell_reads_the_name_of_the_file_as_it_was_typed() {
        let keys = RenderKeys::default();
        let camera = Camera { position: [1.0; 3], target: [0.0; 3], up: [0.0, 1.0, 0.0], fov: Fov::Y(40.0) };
        for input in ["a b.toml", "it's $HOME/`x`.trex", "-q.trex", "ü\n\\.trex", "a.trex"] {
            let line = render_line(input, &Recipe::Opened { camera: &camera, keys: &keys });
            let script = format!("set -- {line}; printf '%s\\0' \"$@\"");
            let said = std::process::Command::new("sh").args(["-c", &script]).output().unwrap();
            let said = String::from_utf8(said.stdout).unwrap();
            let words: Vec<String> = said.split_terminator('\0').map(str::to_owned).collect();
            let parsed = Cli::try_parse_from(&words).unwrap_or_else(|error| panic!("{line}: {error}"));
            let Verb::Render(args) = parsed.verb else { panic!("{line}") };
            assert_eq!(args.file.strip_prefix(".").unwrap_or(&args.file), std::path::Path::new(input));
        }
        assert_eq!(render_line("a.trex", &Recipe::Saved), "trex render view.toml -o picture.png");
    }
}
