//! `Exposure`: the factor between light and the bytes of a PNG, or that it is still to be decided.
//!
//! Invariant: what is written is read back: `auto`, or the number.

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;

/// The name of [`Exposure::Auto`] in scene files and flags.
pub(super) const AUTO: &str = "auto";

/// A factor on the light before it becomes a PNG.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exposure {
    /// Decided once, by what the opening view shows ([`crate::Brightness`]). A session has it decided before its first
    /// picture: see `trex_model`.
    Auto,
    /// This one.
    Factor(f32),
}

impl Exposure {
    /// The factor; 1 where it is still to be decided.
    pub fn factor(self) -> f32 {
        match self {
            Exposure::Auto => 1.0,
            Exposure::Factor(factor) => factor,
        }
    }
}

impl Serialize for Exposure {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Exposure::Auto => serializer.serialize_str(AUTO),
            Exposure::Factor(factor) => serializer.serialize_f32(*factor),
        }
    }
}

impl<'de> Deserialize<'de> for Exposure {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Exposure, D::Error> {
        deserializer.deserialize_any(ExposureVisitor)
    }
}

struct ExposureVisitor;

impl Visitor<'_> for ExposureVisitor {
    type Value = Exposure;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "a number, or {AUTO:?}")
    }

    fn visit_f64<E: Error>(self, factor: f64) -> Result<Exposure, E> {
        Ok(Exposure::Factor(factor as f32))
    }

    fn visit_i64<E: Error>(self, factor: i64) -> Result<Exposure, E> {
        Ok(Exposure::Factor(factor as f32))
    }

    fn visit_u64<E: Error>(self, factor: u64) -> Result<Exposure, E> {
        Ok(Exposure::Factor(factor as f32))
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<Exposure, E> {
        if name == AUTO {
            Ok(Exposure::Auto)
        } else {
            Err(E::invalid_value(serde::de::Unexpected::Str(name), &self))
        }
    }
}
