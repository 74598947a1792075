//! The points of the sweep: one knob at a time beside `--quality normal`, the qualities, and diagonals on which several
//! knobs go together.

/// A knob, or a way through several.
#[derive(Debug)]
pub(super) struct Knob {
    pub(super) name: &'static str,
    /// Flags of every point of it.
    base: &'static str,
    /// The flag that is turned; empty: values are flags.
    flag: &'static str,
    values: &'static [&'static str],
    /// True for flags of `trex build`.
    pub(super) of_build: bool,
}

/// What is rendered.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Point {
    pub(super) knob: &'static str,
    pub(super) value: String,
    /// Flags of `trex build`, where the model is built for it.
    pub(super) build: Option<Vec<String>>,
    /// Flags of `trex render`.
    pub(super) flags: Vec<String>,
}

const fn knob(name: &'static str, flag: &'static str, values: &'static [&'static str]) -> Knob {
    Knob { name, base: "--quality normal", flag, values, of_build: false }
}

/// All of them.
pub(super) const KNOBS: [Knob; 23] = [
    Knob { base: "", ..knob("quality", "--quality", &["draft", "normal", "reference"]) },
    knob("spp", "--spp", &["1", "2", "4", "8", "16", "32", "64", "128", "256"]),
    knob("n-gather", "--n-gather", &["0", "1", "2", "4", "8", "32"]),
    knob("n-shadow", "--n-shadow", &["1", "2", "4", "8", "32"]),
    knob("photons", "--photons", &["10k", "100k", "1M", "10M"]),
    knob("near", "--near", &["voxel", "contact", "exact"]),
    knob("shadows", "--shadows", &["voxel", "mesh"]),
    knob("occluders", "--occluders", &["on", "off"]),
    knob("filter", "--filter", &["on", "off"]),
    knob("lod-error", "--lod-error", &["0", "0.5", "1", "2", "4", "8"]),
    knob("bake", "", &["", "--bake"]),
    knob("caustics", "", &["", "--caustics"]),
    Knob { base: "", ..knob("integrator", "--integrator", &["direct", "ao", "photon", "full-gi", "path"]) },
    knob("time-limit", "--time-limit", &["300ms", "1s", "3s"]),
    knob("time", "--t-max 33 --time-limit", &["33ms", "100ms", "300ms", "1s", "3s"]),
    knob("memory", "--memory-limit", &[]),
    Knob {
        base: "--quality normal --filter on",
        ..knob(
            "photon",
            "",
            &[
                "--spp 1 --n-shadow 1 --n-gather 1 --photons 64k",
                "--spp 1 --n-shadow 1 --n-gather 1 --photons 256k",
                "--spp 2 --n-shadow 1 --n-gather 1 --photons 256k",
                "--spp 4 --n-shadow 1 --n-gather 1 --photons 512k",
                "--spp 8 --n-shadow 1 --n-gather 2 --photons 1M",
                "--spp 32 --photons 4M --near exact",
                "--spp 64 --n-gather 4 --photons 8M --near exact",
                "--spp 256 --n-gather 4 --photons 16M --near exact --bake",
            ],
        )
    },
    Knob { base: "--integrator path --lod-error 0", ..knob("path", "--spp", &["1", "4", "16", "64", "256"]) },
    Knob {
        base: "--integrator full-gi --filter on --lod-error 0",
        ..knob("full-gi", "--spp", &["1", "4", "16", "64"])
    },
    build("grid-bits", "--grid-bits", &["10", "12", "14", "16", "18", "20", "22", "24"]),
    build("upper", "--voxels", &["64", "256", "512", "1024"]),
    build("finest", "--voxels", &["64/256", "256/1024", "512/2048", "1024/4096", "256/4096"]),
    build("no-asvo", "--no-asvo", &[""]),
];

const fn build(name: &'static str, flag: &'static str, values: &'static [&'static str]) -> Knob {
    Knob { of_build: true, ..knob(name, flag, values) }
}

/// The names, for the command line.
pub fn names() -> [&'static str; KNOBS.len()] {
    KNOBS.each_ref().map(|knob| knob.name)
}

/// A point in a word: the knob and what it is turned to, joined by dashes.
pub(super) fn setting(knob: &str, value: &str) -> String {
    let told = format!("{knob} {value}");
    let is_apart = |c: char| !c.is_ascii_alphanumeric() && c != '.';
    told.split(is_apart).filter(|word| !word.is_empty()).collect::<Vec<_>>().join("-")
}

fn words(text: &str) -> impl Iterator<Item = String> {
    text.split_whitespace().map(str::to_owned)
}

impl Knob {
    /// Its points; `limits` are the memory limits that are tried, bytes.
    pub(super) fn points(&self, limits: &[u64]) -> Vec<Point> {
        let limits: Vec<String> = limits.iter().map(|bytes| format!("{bytes}B")).collect();
        let limits: Vec<&str> = limits.iter().map(String::as_str).collect();
        let values = if self.name == "memory" { &limits[..] } else { self.values };
        let point = |value: &&str| {
            let turned = words(self.flag).chain(words(value));
            let (build, flags) = match self.of_build {
                // Without an octree there are no voxels to light.
                true if self.name == "no-asvo" => {
                    (Some(turned.collect()), words("--integrator path").collect())
                }
                true => (Some(turned.collect()), words(self.base).collect()),
                false => (None, words(self.base).chain(turned).collect()),
            };
            let value = if value.is_empty() { "plain" } else { value };
            Point { knob: self.name, value: value.to_owned(), build, flags }
        };
        values.iter().map(point).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_point_is_one_alone() {
        let points: Vec<Point> = KNOBS.iter().flat_map(|knob| knob.points(&[1 << 27, 1 << 28])).collect();
        let mut told: Vec<String> = points.iter().map(|point| setting(point.knob, &point.value)).collect();
        told.sort();
        told.dedup();
        assert_eq!(told.len(), points.len());
        let memory: Vec<_> = points.iter().filter(|point| point.knob == "memory").collect();
        assert_eq!(memory[1].flags, ["--quality", "normal", "--memory-limit", "268435456B"]);
        let bits = points.iter().find(|point| point.knob == "grid-bits").unwrap();
        assert_eq!(bits.build.as_deref().unwrap(), ["--grid-bits", "10"]);
    }
}
