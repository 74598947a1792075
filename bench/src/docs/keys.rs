//! The table of a picture's keys, for `docs/scene.md`: what the renderer's own table says, as Markdown.

use std::fmt::Write;
use trex_render::keys::{EXPOSURE, KEYS, LIGHT, LOD_ERROR};
use trex_render::{Key, KeyKind};

/// A row per key: its sentence, the methods that use it, its unit, range and default.
pub(super) fn render() -> String {
    let mut text =
        "| key | meaning | methods | unit | range | default |\n|---|---|---|---|---|---|\n".to_owned();
    for key in KEYS {
        let methods = quoted(&key.only_of());
        let range = match key.kind {
            KeyKind::Choice(_) => String::new(),
            _ => key.range(),
        };
        let Key { name, text: meaning, unit, .. } = key;
        let _ = writeln!(
            text,
            "| `{name}` | {meaning}{} | {methods} | {unit} | {range} | {} |",
            choices(key),
            default(key)
        );
    }
    text
}

/// The names of a choice, with what they mean.
fn choices(key: &Key) -> String {
    let KeyKind::Choice(choices) = key.kind else { return String::new() };
    choices.iter().map(|choice| format!("<br>`{:?}`: {}", choice.name, choice.text)).collect()
}

/// The default, and that of what changes while it is looked at.
fn default(key: &Key) -> String {
    if key.name == LIGHT.name {
        return format!("`{}`; files without a scene: `\"auto\"`", key.default_value());
    }
    if key.name == EXPOSURE.name {
        return format!("`{}`; `view`, files without a scene: `\"auto\"`", key.default_value());
    }
    if key.name == LOD_ERROR.name {
        return format!(
            "`{}`; `view`, `stress` of a file without a scene: `{}`",
            key.default_value(),
            key.live_value()
        );
    }
    let (default, live) = (key.default_value(), key.live_value());
    if live == default { format!("`{default}`") } else { format!("`{default}`; `view`, `stress`: `{live}`") }
}

fn quoted(names: &[&str]) -> String {
    names.iter().map(|name| format!("`{name}`")).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_key_has_a_row_with_its_range() {
        let table = render();
        assert_eq!(table.lines().count(), 21);
        let photons = table.lines().find(|line| line.starts_with("| `photons` ")).unwrap();
        for word in
            ["`photon`, `full-gi`", "1 to 2^40; full-gi: 2^30", "`1048576`; `view`, `stress`: `2097152`"]
        {
            assert!(photons.contains(word), "{photons}");
        }
        assert!(table.contains("`\"draft\"`: A look"), "{table}");
    }
}
