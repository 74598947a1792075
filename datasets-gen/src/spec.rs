//! `Spec`: which mesh, `gen:KIND:COUNT[:SEED][:colors=low|high]` in text.
//!
//! Invariants: 1. `parse` of what `to_string` prints gives the same spec; 2. the count is within
//! [`Spec::MIN_TRIANGLES`] and [`Spec::MAX_TRIANGLES`] after `parse`.

use crate::paint::ColourFrequency;
use std::fmt;
use trex_store::{Budget, Code, Error, Interrupt, Result};

/// The four shapes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// A turbulent mixing layer with detail at all scales, in small even triangles.
    Isosurface,
    /// A plant: building, racks, pipes, flanges, bolts, tanks; triangle sizes over four orders of magnitude.
    Pipes,
    /// A dense, closed, statue-like surface.
    Scan,
    /// Slivers, needles, duplicates, degenerates, tiny next to huge, far from the origin.
    Soup,
}

impl Kind {
    /// All kinds, in the order of their documentation.
    pub const ALL: [Kind; 4] = [Kind::Isosurface, Kind::Pipes, Kind::Scan, Kind::Soup];

    /// The name in a spec.
    pub fn as_str(self) -> &'static str {
        match self {
            Kind::Isosurface => "isosurface",
            Kind::Pipes => "pipes",
            Kind::Scan => "scan",
            Kind::Soup => "soup",
        }
    }
}

/// Which mesh to make.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Spec {
    /// The shape.
    pub kind: Kind,
    /// Count of triangles asked for; the stream is within 1 % of it.
    pub triangles: u64,
    /// Seed of everything random in it.
    pub seed: u64,
    /// Its colours, if it has any.
    pub colours: Option<ColourFrequency>,
}

/// How to run a generator.
#[derive(Clone, Debug)]
pub struct GenOptions {
    /// Threads that make triangles; at least 1 is used, at most 16.
    pub threads: usize,
    /// Where the memory of the stream is leased.
    pub budget: Budget,
    /// Stops the stream with `Code::Interrupted`.
    pub interrupt: Interrupt,
}

impl Default for GenOptions {
    /// One thread, no limit.
    fn default() -> GenOptions {
        GenOptions { threads: 1, budget: Budget::unlimited(), interrupt: Interrupt::default() }
    }
}

impl Spec {
    /// Fewer cannot show what the shapes are.
    pub const MIN_TRIANGLES: u64 = 10_000;
    /// Beyond it f32 positions lose the shapes.
    pub const MAX_TRIANGLES: u64 = 1_000_000_000;
    /// The seed of a spec that names none.
    pub const DEFAULT_SEED: u64 = 1;

    /// True when `text` is meant to be a spec and not a path.
    pub fn is_spec(text: &str) -> bool {
        text.starts_with("gen:")
    }

    /// Reads `gen:KIND:COUNT[:SEED][:colors=low|high]`; COUNT is a number, with `k`, `M` or `G` for 10^3, 10^6, 10^9.
    ///
    /// # Errors
    /// `Code::Usage`, naming the part that is wrong.
    pub fn parse(text: &str) -> Result<Spec> {
        let wrong = |what: String| {
            Err(Error::new(Code::Usage, what)
                .at_place(text)
                .numbers(format!("counts from {} to {}", Spec::MIN_TRIANGLES, Spec::MAX_TRIANGLES))
                .next("write gen:KIND:COUNT[:SEED][:colors=low|high], as in gen:isosurface:5M or gen:pipes:100k:7"))
        };
        let mut parts: Vec<&str> = text.split(':').collect();
        let colours = match parts.last().and_then(|part| part.strip_prefix("colors=")) {
            Some(name) => {
                parts.pop();
                let known = ColourFrequency::ALL.into_iter().find(|known| known.as_str() == name);
                let Some(known) = known else { return wrong(format!("no colours are called `{name}`")) };
                Some(known)
            }
            None => None,
        };
        let (kind, count, seed) = match parts[..] {
            ["gen", kind, count] => (kind, count, None),
            ["gen", kind, count, seed] => (kind, count, Some(seed)),
            _ => return wrong(format!("`{text}` does not name a generator")),
        };
        let Some(kind) = Kind::ALL.into_iter().find(|known| known.as_str() == kind) else {
            let known = Kind::ALL.map(Kind::as_str).join(", ");
            return wrong(format!("no generator is called `{kind}` (there are {known})"));
        };
        let triangles = match parse_count(count) {
            Some(triangles) if (Spec::MIN_TRIANGLES..=Spec::MAX_TRIANGLES).contains(&triangles) => triangles,
            Some(triangles) => return wrong(format!("{triangles} triangles are out of range")),
            None => return wrong(format!("`{count}` is no count of triangles")),
        };
        let Some(seed) = seed.map_or(Some(Spec::DEFAULT_SEED), |seed| seed.parse().ok()) else {
            return wrong(format!("`{}` is no seed", seed.unwrap_or_default()));
        };
        Ok(Spec { kind, triangles, seed, colours })
    }
}

impl fmt::Display for Spec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "gen:{}:{}:{}", self.kind.as_str(), self.triangles, self.seed)?;
        self.colours.map_or(Ok(()), |colours| write!(f, ":colors={colours}"))
    }
}

/// `12345`, `100k`, `2.5M`, `1G`.
fn parse_count(text: &str) -> Option<u64> {
    let (digits, unit) = match text.chars().last()? {
        'k' | 'K' => (&text[..text.len() - 1], 1_000u64),
        'm' | 'M' => (&text[..text.len() - 1], 1_000_000),
        'g' | 'G' => (&text[..text.len() - 1], 1_000_000_000),
        _ => (text, 1),
    };
    let plain = digits.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.');
    if !plain {
        return None;
    }
    match digits.parse::<u64>() {
        Ok(number) => number.checked_mul(unit),
        // A fraction makes sense with a unit only.
        Err(_) if unit > 1 => digits.parse::<f64>().ok().map(|number| (number * unit as f64).round() as u64),
        Err(_) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_specs_and_prints_them_back() {
        for (text, kind, triangles, seed) in [
            ("gen:isosurface:5M", Kind::Isosurface, 5_000_000, 1),
            ("gen:pipes:100k:7", Kind::Pipes, 100_000, 7),
            ("gen:scan:1G:0", Kind::Scan, 1_000_000_000, 0),
            ("gen:soup:12345", Kind::Soup, 12_345, 1),
            ("gen:soup:2.5M", Kind::Soup, 2_500_000, 1),
        ] {
            let spec = Spec::parse(text).unwrap();
            assert_eq!(spec, Spec { kind, triangles, seed, colours: None });
            assert_eq!(Spec::parse(&spec.to_string()).unwrap(), spec);
            for colours in ColourFrequency::ALL {
                let painted = Spec { colours: Some(colours), ..spec };
                assert_eq!(Spec::parse(&format!("{text}:colors={colours}")).unwrap(), painted);
                assert_eq!(Spec::parse(&painted.to_string()).unwrap(), painted);
            }
        }
    }

    #[test]
    fn refuses_nonsense_with_four_parts() {
        for text in [
            "gen",
            "gen:pipes",
            "pipes:5M",
            "gen:cube:5M",
            "gen:soup:9",
            "gen:soup:-5M",
            "gen:soup:1e6",
            "gen:soup:2G",
            "gen:soup:5M:x",
            "gen:soup:5M:1:2",
            "gen:soup:",
            "gen:soup:.M",
            "gen:soup:1.5",
            "gen:soup:5M:colors=",
            "gen:soup:5M:colors=low:1",
            "gen:soup:colors=low",
        ] {
            let error = Spec::parse(text).unwrap_err();
            assert_eq!(error.code(), Code::Usage, "{text}");
            assert!(!error.what().is_empty() && error.place() == text, "{text}");
            assert!(!error.numbers_text().is_empty() && !error.next_step().is_empty(), "{text}");
        }
    }
}
