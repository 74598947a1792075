//! `Key`: what is known of a key of a picture: its kind, its range, who uses it, and how it is called where people see
//! it.
//!
//! Invariants: 1. a name is that of scene files; 2. [`Key::check`] alone judges a range, and [`Key::range`] alone words
//! it: for scene files, flags and pages alike.

use super::exposure::AUTO;
use super::method::Method;
use std::fmt;
use trex_store::{Code, Error, Result};

/// A key of a picture.
#[derive(Debug)]
pub struct Key {
    /// The name in scene files.
    pub name: &'static str,
    /// A label for screens.
    pub title: &'static str,
    /// The unit of its numbers; empty for what has none.
    pub unit: &'static str,
    /// What it holds, within which range.
    pub kind: KeyKind,
    /// Tells whether a method uses it.
    pub is_used_by: fn(Method) -> bool,
    /// What becomes of it beside other methods.
    pub elsewhere: Elsewhere,
    /// A method that takes fewer than the range says, and its most.
    pub narrower: Option<(Method, u64)>,
    /// One sentence, without its end.
    pub text: &'static str,
}

/// What a key holds.
#[derive(Clone, Copy, Debug)]
pub enum KeyKind {
    /// A whole number.
    Count {
        /// The least.
        least: u64,
        /// The most.
        most: u64,
    },
    /// A number from 0 on.
    Length {
        /// The most.
        most: f64,
    },
    /// A finite number above zero, of single precision; or `auto`.
    Factor,
    /// Two whole numbers.
    Pair {
        /// The most that each may be; the least is 1.
        most: u32,
    },
    /// One of these.
    Choice(&'static [Choice]),
    /// True or false.
    Flag,
}

/// A name that a key may have for its value.
#[derive(Debug)]
pub struct Choice {
    /// The name in scene files.
    pub name: &'static str,
    /// Another name of it.
    pub alias: Option<&'static str>,
    /// A label for screens.
    pub title: &'static str,
    /// What it means.
    pub text: &'static str,
}

/// What becomes of a key beside a method that does not use it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Elsewhere {
    /// It says nothing.
    Ignored,
    /// It has to be off.
    Refused,
}

/// The value of a key.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum KeyValue {
    /// Of [`KeyKind::Count`].
    Count(u64),
    /// Of [`KeyKind::Length`] and [`KeyKind::Factor`].
    Number(f64),
    /// Of [`KeyKind::Pair`].
    Pair([u32; 2]),
    /// Of [`KeyKind::Choice`]: its name. Of [`KeyKind::Factor`]: `auto`.
    Choice(&'static str),
    /// Of [`KeyKind::Flag`].
    Flag(bool),
}

impl Key {
    /// The methods that use it.
    pub fn methods(&self) -> impl Iterator<Item = Method> + '_ {
        Method::ALL.into_iter().filter(|&method| (self.is_used_by)(method))
    }

    /// The names of the methods that use it, where those are not all that compute light; else none.
    pub fn only_of(&self) -> Vec<&'static str> {
        let is_unused = |method: &Method| method.computes_light() && !(self.is_used_by)(*method);
        let names = self.methods().map(Method::as_str);
        if Method::ALL.iter().any(is_unused) { names.collect() } else { vec![] }
    }

    /// The choice called `name`.
    pub fn choice(&self, name: &str) -> Option<&'static Choice> {
        let KeyKind::Choice(choices) = self.kind else { return None };
        choices.iter().find(|choice| choice.name == name || choice.alias == Some(name))
    }

    /// The range, as people read it.
    pub fn range(&self) -> String {
        match self.kind {
            KeyKind::Count { least, most } => {
                let narrow =
                    |(method, most): (Method, u64)| format!("; {}: {}", method.as_str(), round(most));
                let narrower = self.narrower.map_or(String::new(), narrow);
                format!("{least} to {}{narrower}", round(most))
            }
            KeyKind::Length { most } => format!("0 to {most}"),
            KeyKind::Factor => format!("a finite number above 0, or {AUTO}"),
            KeyKind::Pair { most } => format!("1 to {most} each"),
            KeyKind::Choice(choices) => {
                choices.iter().map(|choice| choice.name).collect::<Vec<_>>().join(", ")
            }
            KeyKind::Flag => "true, false".into(),
        }
    }

    /// Checks that `value` is in the range.
    ///
    /// # Errors
    /// [`Code::SceneFormat`] at `render.KEY`.
    pub fn check(&self, value: KeyValue) -> Result<()> {
        let is_good = match (self.kind, value) {
            (KeyKind::Count { least, most }, KeyValue::Count(count)) => (least..=most).contains(&count),
            (KeyKind::Length { most }, KeyValue::Number(number)) => (0.0..=most).contains(&number),
            // What single precision takes for zero or for infinity is neither.
            (KeyKind::Factor, KeyValue::Number(number)) => number as f32 > 0.0 && (number as f32).is_finite(),
            (KeyKind::Factor, KeyValue::Choice(name)) => name == AUTO,
            (KeyKind::Pair { most }, KeyValue::Pair(pair)) => {
                pair.iter().all(|part| (1..=most).contains(part))
            }
            (KeyKind::Choice(_), KeyValue::Choice(name)) => self.choice(name).is_some(),
            (KeyKind::Flag, KeyValue::Flag(_)) => true,
            _ => false,
        };
        if is_good {
            return Ok(());
        }
        let unit = if self.unit.is_empty() { String::new() } else { format!(", {}", self.unit) };
        Err(out_of_range(&self.place(), value.to_string(), &format!("give {}{unit}", self.range())))
    }

    /// Checks that `value` stands beside `method`.
    ///
    /// # Errors
    /// [`Code::SceneFormat`] at `render.KEY`: it is on where nothing uses it; more than the method takes.
    pub fn check_beside(&self, method: Method, value: KeyValue) -> Result<()> {
        let beside = format!("{value} beside the integrator {:?}", method.as_str());
        let refused = |what: String, numbers: String| {
            Error::new(Code::SceneFormat, what).at_place(self.place()).numbers(numbers)
        };
        let names = || self.methods().map(Method::as_str).collect::<Vec<_>>().join(" or ");
        let is_on = !matches!(value, KeyValue::Flag(false) | KeyValue::Choice("off"));
        if self.elsewhere == Elsewhere::Refused && is_on && !(self.is_used_by)(method) {
            let what = format!("the integrator has no use for `{}`", self.name);
            return Err(refused(what, beside).next(format!("use {}, or turn it off", names())));
        }
        match (self.narrower, value) {
            (Some((narrow, most)), KeyValue::Count(count)) if narrow == method && count > most => {
                let what = format!("the integrator takes fewer {}", self.unit);
                Err(refused(what, format!("{beside}, {} at most", round(most)))
                    .next("give fewer, or use another integrator"))
            }
            _ => Ok(()),
        }
    }

    fn place(&self) -> String {
        format!("render.{}", self.name)
    }
}

/// As scene files write it.
impl fmt::Display for KeyValue {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            KeyValue::Count(count) => write!(f, "{count}"),
            KeyValue::Number(number) => write!(f, "{number:?}"),
            KeyValue::Pair(pair) => write!(f, "{pair:?}"),
            KeyValue::Choice(name) => write!(f, "{name:?}"),
            KeyValue::Flag(flag) => write!(f, "{flag}"),
        }
    }
}

/// A maximum as people read it: 2^40, 10^9, 65536.
fn round(count: u64) -> String {
    let (twos, tens) = (count.trailing_zeros(), count.max(1).ilog10());
    match count {
        0..1_000_000 => count.to_string(),
        _ if count.is_power_of_two() => format!("2^{twos}"),
        _ if (count + 1).is_power_of_two() => format!("2^{} - 1", (count + 1).trailing_zeros()),
        _ if count == 10u64.pow(tens) => format!("10^{tens}"),
        _ => count.to_string(),
    }
}

/// The error of a key that is out of range.
pub(super) fn out_of_range(key: &str, numbers: String, next: &str) -> Error {
    Error::new(Code::SceneFormat, format!("`{key}` is out of range"))
        .at_place(key)
        .numbers(numbers)
        .next(next)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn great_numbers_are_written_as_powers() {
        for (count, text) in [
            (0, "0"),
            (65_536, "65536"),
            (1 << 40, "2^40"),
            (1_000_000_000, "10^9"),
            (i64::MAX as u64, "2^63 - 1"),
            (4_000_000_001, "4000000001"),
        ] {
            assert_eq!(round(count), text);
        }
    }
}
