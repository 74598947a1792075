//! The flags of a picture's keys, made from the library's table: one a key, and nothing of them is written here but how
//! a value is typed.
//!
//! ```text
//! n_shadow, a count from 0 to 4096  ->  --n-shadow <N>  Shadow rays per surface point (0 to 4096; default: 2)
//! ```
//!
//! Invariant: [`words`] of any picture are read back by [`PictureKeys`] and [`ResearchKeys`] as that picture.

use crate::values;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser, ValueParser};
use clap::{Arg, ArgMatches, Args, Command, FromArgMatches};
use trex_render::keys::{
    BAKE, EXPOSURE, K_NEAREST, KEYS, LIGHT, LOD_ERROR, OCCLUDERS, RESOLUTION, SEED, SPP, UP,
};
use trex_render::{Choice, Key, KeyKind, KeyValue, RenderEdit, RenderKeys};

/// Heading of what a picture is of. A group of flags stands where its first flag is declared, so verbs declare
/// [`PictureKeys`] early, and [`ResearchKeys`] last.
pub const PICTURE: &str = "Picture options (default: the scene's)";
/// Heading of what is turned to compare methods, not to make pictures.
pub const RESEARCH: &str = "Research options";
/// Size of the pictures of `trex stress` where no other is asked for.
pub const STRESS_RESOLUTION: [u32; 2] = [512, 512];

/// What leaves an exposure to be decided.
const AUTO: &str = "auto";
/// Keys that are turned to compare methods, not to make pictures.
const RESEARCH_KEYS: [&Key; 3] = [&K_NEAREST, &BAKE, &OCCLUDERS];

/// The flags by which pictures are made.
pub type PictureKeys = KeyArgs<false>;
/// The flags that are turned to compare methods: verbs declare them last, so that help explains them last.
pub type ResearchKeys = KeyArgs<true>;

/// What the flags say of a picture.
#[derive(Clone, Copy, Debug, Default)]
pub struct KeyArgs<const IS_RESEARCH: bool> {
    edit: RenderEdit,
}

impl<const IS_RESEARCH: bool> KeyArgs<IS_RESEARCH> {
    /// The keys whose flags these are.
    fn keys() -> impl Iterator<Item = &'static Key> {
        KEYS.into_iter().filter(|key| is_research(key) == IS_RESEARCH)
    }

    /// The changes to what a scene says.
    pub fn edit(&self) -> &RenderEdit {
        &self.edit
    }
}

impl<const IS_RESEARCH: bool> Args for KeyArgs<IS_RESEARCH> {
    fn augment_args(command: Command) -> Command {
        command.args(Self::keys().map(arg))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl<const IS_RESEARCH: bool> FromArgMatches for KeyArgs<IS_RESEARCH> {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let given = |key: &'static Key| Some((key, *matches.get_one::<KeyValue>(key.name)?));
        Ok(KeyArgs { edit: Self::keys().filter_map(given).collect() })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

fn is_research(key: &Key) -> bool {
    RESEARCH_KEYS.iter().any(|of| of.name == key.name)
}

/// The flags that say all of `keys`.
pub fn words(keys: &RenderKeys) -> String {
    let word = |(key, value): (&Key, KeyValue)| match value {
        KeyValue::Flag(_) => format!(" --{}={value}", flag(key)),
        _ => format!(" --{} {}", flag(key), typed(value)),
    };
    keys.values().into_iter().map(word).collect()
}

/// Parses a count of samples.
pub fn samples(text: &str) -> Result<u32, String> {
    match parse(&SPP, text)? {
        KeyValue::Count(count) => u32::try_from(count).map_err(|error| error.to_string()),
        value => unreachable!("{value} is no count"),
    }
}

/// Parses the seed of random numbers.
pub fn seed(text: &str) -> Result<u64, String> {
    match parse(&SEED, text)? {
        KeyValue::Count(count) => Ok(count),
        value => unreachable!("{value} is no count"),
    }
}

/// The name of a key's flag, without its dashes.
fn flag(key: &Key) -> String {
    key.name.replace('_', "-")
}

/// A value as it is typed.
fn typed(value: KeyValue) -> String {
    match value {
        KeyValue::Number(number) => number.to_string(),
        KeyValue::Pair([width, height]) => format!("{width}x{height}"),
        KeyValue::Choice(name) => name.into(),
        KeyValue::Count(_) | KeyValue::Flag(_) => value.to_string(),
    }
}

fn arg(key: &'static Key) -> Arg {
    let heading = if is_research(key) { RESEARCH } else { PICTURE };
    let arg = Arg::new(key.name).long(flag(key)).help(help(key)).help_heading(heading);
    let arg = arg.value_parser(parser(key));
    match key.kind {
        KeyKind::Count { .. } => arg.value_name("N"),
        KeyKind::Length { .. } => arg.value_name("PX"),
        KeyKind::Factor => arg.value_name("auto|FACTOR"),
        KeyKind::Pair { .. } => arg.value_name("WxH"),
        KeyKind::Choice(_) if key.name == UP.name => {
            arg.value_name("+Y|+Z|...").allow_hyphen_values(true).ignore_case(true)
        }
        KeyKind::Choice(_) => arg.value_name("NAME"),
        KeyKind::Flag => {
            arg.value_name("true|false").num_args(0..=1).require_equals(true).default_missing_value("true")
        }
    }
}

/// What is accepted: what the key's kind is typed as, in the key's range.
fn parser(key: &'static Key) -> ValueParser {
    let KeyKind::Choice(choices) = key.kind else {
        return ValueParser::new(move |text: &str| parse(key, text));
    };
    let names =
        choices.iter().map(|choice| PossibleValue::new(choice.name).help(choice.text).aliases(choice.alias));
    // As it was typed, where case says nothing.
    let is_meant = |choice: &&Choice, name: &str| {
        choice.name.eq_ignore_ascii_case(name)
            || choice.alias.is_some_and(|alias| alias.eq_ignore_ascii_case(name))
    };
    let chosen = move |name: String| {
        let choice = choices.iter().find(|choice| is_meant(choice, &name));
        KeyValue::Choice(choice.expect("it is one of them").name)
    };
    ValueParser::new(PossibleValuesParser::new(names).map(chosen))
}

fn parse(key: &Key, text: &str) -> Result<KeyValue, String> {
    let value = match key.kind {
        KeyKind::Count { .. } => KeyValue::Count(values::whole(text)?),
        KeyKind::Factor if text == AUTO => KeyValue::Choice(AUTO),
        KeyKind::Length { .. } | KeyKind::Factor => KeyValue::Number(values::number(text)?),
        KeyKind::Pair { .. } => {
            let resolution = values::resolution(text)?;
            KeyValue::Pair([resolution.width, resolution.height])
        }
        KeyKind::Choice(_) => {
            KeyValue::Choice(key.choice(text).ok_or_else(|| format!("accepted are {}", key.range()))?.name)
        }
        KeyKind::Flag => KeyValue::Flag(text.parse().map_err(|_| "accepted are true and false".to_owned())?),
    };
    key.check(value).map_err(|_| format!("accepted is {}", key.range()))?;
    Ok(value)
}

/// The sentence of a key, the methods that use it, its range and what holds without it.
fn help(key: &'static Key) -> String {
    let only_of = key.only_of();
    let of = if only_of.is_empty() { String::new() } else { format!("; for {} only", only_of.join(" and ")) };
    let range = match key.kind {
        // Listed with what they mean, or plain.
        KeyKind::Choice(_) | KeyKind::Flag => String::new(),
        _ => format!("{}; ", key.range()),
    };
    format!("{}{of} ({range}default: {}{})", key.text, typed(key.default_value()), live(key))
}

/// What holds without it where pictures change while they are looked at.
fn live(key: &'static Key) -> String {
    if key.name == RESOLUTION.name {
        return format!("; stress: {}; view: that of the page", typed(KeyValue::Pair(STRESS_RESOLUTION)));
    }
    if key.name == LIGHT.name {
        return "; files without a scene: auto".into();
    }
    if key.name == EXPOSURE.name {
        return "; view, files without a scene: auto".into();
    }
    if key.name == LOD_ERROR.name {
        return format!("; stress, view of a file without a scene: {}", typed(key.live_value()));
    }
    let value = key.live_value();
    if value == key.default_value() { String::new() } else { format!("; stress, view: {}", typed(value)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    use trex_render::keys;

    /// Photons were parsed as triangles are: never more than 4 * 10^9. An exposure that single precision takes for zero
    /// was accepted here, and refused later.
    #[test]
    fn values_are_typed_in_their_ranges() {
        let count = |number| Some(KeyValue::Count(number));
        let number = |number| Some(KeyValue::Number(number));
        let cases: [(&Key, &str, Option<KeyValue>); 20] = [
            (&keys::SPP, "1000000000", count(1_000_000_000)),
            (&keys::SPP, "1000000001", None),
            (&keys::SPP, "0", None),
            (&keys::PHOTONS, "1G", count(1_000_000_000)),
            (&keys::PHOTONS, "1099511627776", count(1 << 40)),
            (&keys::PHOTONS, "1099511627777", None),
            (&keys::N_SHADOW, "4_096", count(4096)),
            (&keys::SEED, "9223372036854775807", count((1 << 63) - 1)),
            (&keys::SEED, "9223372036854775808", None),
            (&keys::LOD_ERROR, "0.25", number(0.25)),
            (&keys::LOD_ERROR, "-1", None),
            (&keys::LOD_ERROR, "nan", None),
            (&keys::EXPOSURE, "1e-60", None),
            (&keys::EXPOSURE, "0.1", number(0.1)),
            (&keys::EXPOSURE, "auto", Some(KeyValue::Choice("auto"))),
            (&keys::EXPOSURE, "Auto", None),
            (&keys::RESOLUTION, "65536x1", Some(KeyValue::Pair([65_536, 1]))),
            (&keys::RESOLUTION, "65537x1", None),
            (&keys::BAKE, "false", Some(KeyValue::Flag(false))),
            (&keys::NEAR, "far", None),
        ];
        for (key, text, expected) in cases {
            assert_eq!(parse(key, text).ok(), expected, "{} {text}", key.name);
        }
        assert_eq!((samples("2k"), seed("0")), (Ok(2000), Ok(0)));
        assert!(samples("0").unwrap_err().contains("1 to 10^9"));
    }

    #[test]
    fn help_says_whose_a_flag_is_its_range_and_its_default() {
        for (key, ends) in [
            (&keys::N_GATHER, "; for photon and full-gi only (0 to 4096; default: 2)"),
            (&keys::FILTER, "; for photon and full-gi only (default: on; stress, view: off)"),
            (&keys::SPP, "Samples per pixel (1 to 10^9; default: 16)"),
            (
                &keys::LOD_ERROR,
                "everywhere (0 to 1024; default: 0; stress, view of a file without a scene: 1)",
            ),
        ] {
            let help = help(key);
            assert!(help.ends_with(ends), "{help}");
        }
    }
}
