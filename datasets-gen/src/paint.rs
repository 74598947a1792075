//! `PaintedSource`: a generated mesh whose corners have colours, waves over the place: what colours cost is measured on
//! them.
//!
//! ```text
//! channel = 128 + sum of waves, each of a length and along a direction of its own, + noise
//! low     lengths: parts of the model's longest side
//! high    and some edges; noise of four steps each way, as cameras have it
//! ```
//!
//! Invariants: 1. a colour is a function of place and seed, so corners of one place have one; 2. waves are polynomials,
//! so machines agree to the bit; 3. a batch takes the memory that [`TriangleBatch::bytes`] says.

use crate::dice::{Dice, mix};
use glam::DVec3;
use std::fmt;
use trex_store::cluster::Colour;
use trex_store::{
    AttributeSet, Lattice, MaterialList, Result, ScanHint, SourceStats, TriangleBatch, TriangleSource,
};

/// How fast colours of a generated mesh change from place to place.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum ColourFrequency {
    /// Over a tenth of the model and more.
    Low,
    /// Also from edge to edge, with noise.
    High,
}

impl ColourFrequency {
    /// All of them.
    pub const ALL: [ColourFrequency; 2] = [ColourFrequency::Low, ColourFrequency::High];

    /// The name in a spec.
    pub fn as_str(self) -> &'static str {
        match self {
            ColourFrequency::Low => "low",
            ColourFrequency::High => "high",
        }
    }
}

impl fmt::Display for ColourFrequency {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}

/// Lengths of waves: parts of the longest side, and of the median edge; and what a channel changes by, each way.
const PARTS: [f64; 3] = [0.5, 0.23, 0.11];
const PART_STRENGTH: f64 = 26.0;
const EDGES: [f64; 3] = [40.0, 17.0, 8.0];
const EDGE_STRENGTH: f64 = 12.0;
/// Steps of noise, each way.
const NOISE: u64 = 4;
/// Place of the dice of colours, beside those of shapes.
const PLACE: u64 = 0xc010;

/// A wave of one channel.
struct Wave {
    /// Along its way, a wave a unit.
    way: DVec3,
    phase: f64,
    strength: f64,
}

/// What colours are made of.
struct Paint {
    waves: [Vec<Wave>; 3],
    noise: u64,
    seed: u64,
}

impl Paint {
    fn new(frequency: ColourFrequency, hint: &ScanHint, seed: u64) -> Paint {
        let side = (DVec3::from(hint.bounds.hi) - DVec3::from(hint.bounds.lo)).max_element();
        let parts = PARTS.map(|part| (part * side, PART_STRENGTH));
        let edges = EDGES.map(|edges| (edges * hint.median_edge, EDGE_STRENGTH));
        let (edges, noise) = match frequency {
            ColourFrequency::Low => (&edges[..0], 0),
            ColourFrequency::High => (&edges[..], NOISE),
        };
        let mut dice = Dice::new(seed, PLACE);
        let waves = [(); 3].map(|()| {
            let wave = |&(length, strength): &(f64, f64)| {
                let way = DVec3::from([(); 3].map(|()| dice.range(-1.0, 1.0))).normalize_or(DVec3::X);
                Wave { way: way / length, phase: dice.range(0.0, 2.0), strength }
            };
            parts.iter().chain(edges).map(wave).collect()
        });
        Paint { waves, noise, seed }
    }

    fn colour(&self, place: [f64; 3]) -> Colour {
        // Not a sum of 0 and -0 of one place.
        let bits = place.map(|v| (v + 0.0).to_bits());
        let mut noise = bits.iter().fold(self.seed, |hash, &bits| mix(hash ^ bits));
        self.waves.each_ref().map(|waves| {
            let sum: f64 = waves.iter().map(|wave| wave.at(place.into())).sum();
            let steps = noise % (2 * self.noise + 1);
            noise = mix(noise);
            // What is no number is 0.
            (128.0 + sum + steps as f64 - self.noise as f64).round() as u8
        })
    }
}

impl Wave {
    /// Its share of a channel: nearly a sine, in two parabolas.
    fn at(&self, place: DVec3) -> f64 {
        let turns = 2.0 * self.way.dot(place) + self.phase;
        let within = turns - 2.0 * (0.5 * turns).floor() - 1.0;
        4.0 * self.strength * within * (1.0 - within.abs())
    }
}

/// A source with colours.
pub(crate) struct PaintedSource {
    inner: Box<dyn TriangleSource>,
    paint: Paint,
    hint: ScanHint,
}

impl PaintedSource {
    /// `inner`, a generator without attributes, in colours.
    ///
    /// # Panics
    /// When it does not know its bounds.
    pub(crate) fn new(
        inner: Box<dyn TriangleSource>,
        frequency: ColourFrequency,
        seed: u64,
    ) -> PaintedSource {
        let hint = inner.hint().expect("generators know their bounds");
        let attributes = AttributeSet { colours: true, ..hint.attributes };
        PaintedSource {
            paint: Paint::new(frequency, &hint, seed),
            hint: ScanHint { attributes, ..hint },
            inner,
        }
    }
}

impl TriangleSource for PaintedSource {
    fn name(&self) -> String {
        self.inner.name()
    }

    fn next_batch(&mut self, batch: &mut TriangleBatch) -> Result<bool> {
        // The generator hands its own batches over: they are to keep no colours.
        let columns = std::mem::take(&mut batch.attributes);
        let is_more = self.inner.next_batch(batch)?;
        batch.attributes = columns;
        batch.paint(|place| self.paint.colour(place));
        Ok(is_more)
    }

    fn rewind(&mut self) -> Result<()> {
        self.inner.rewind()
    }

    fn hint(&self) -> Option<ScanHint> {
        Some(self.hint)
    }

    fn lattice(&self) -> Option<Lattice> {
        self.inner.lattice()
    }

    fn attributes(&self) -> AttributeSet {
        self.hint.attributes
    }

    fn materials(&self) -> &MaterialList {
        self.inner.materials()
    }

    fn stats(&self) -> SourceStats {
        self.inner.stats()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{GenOptions, Spec};

    fn batches(text: &str) -> (AttributeSet, Vec<TriangleBatch>) {
        let mut source = crate::open(&Spec::parse(text).unwrap(), &GenOptions::default()).unwrap();
        assert_eq!(source.name(), Spec::parse(text).unwrap().to_string());
        let mut all = Vec::new();
        loop {
            let mut batch = TriangleBatch::default();
            if !source.next_batch(&mut batch).unwrap() {
                return (source.attributes(), all);
            }
            all.push(batch);
        }
    }

    /// Mean difference of colours along the first edge of triangles.
    fn step(batches: &[TriangleBatch]) -> f64 {
        let of_triangle = |(batch, at): (&TriangleBatch, usize)| {
            let [a, b, _] = batch.attributes.of(at).colours;
            a.iter().zip(b).map(|(a, b)| f64::from(a.abs_diff(b))).sum::<f64>() / 3.0
        };
        let all = batches.iter().flat_map(|batch| (0..batch.len()).map(move |at| (batch, at)));
        let steps: Vec<f64> = all.map(of_triangle).collect();
        steps.iter().sum::<f64>() / steps.len() as f64
    }

    #[test]
    fn triangles_are_those_without_colours_and_a_place_has_one() {
        let (none, plain) = batches("gen:scan:50k:3");
        let (set, low) = batches("gen:scan:50k:3:colors=low");
        let (_, high) = batches("gen:scan:50k:3:colors=high");
        assert_eq!((none, set), (AttributeSet::default(), AttributeSet { colours: true, normals: false }));
        let mut of_place = std::collections::HashMap::new();
        for (plain, painted) in plain.iter().zip(&high) {
            assert!(plain.corners == painted.corners && plain.material == painted.material);
            for (at, corners) in painted.corners.iter().enumerate() {
                for (place, colour) in corners.iter().zip(painted.attributes.of(at).colours) {
                    assert_eq!(*of_place.entry(place.map(f64::to_bits)).or_insert(colour), colour);
                }
            }
        }
        let (slow, fast) = (step(&low), step(&high));
        assert!(slow > 0.2 && slow < 6.0 && fast > slow + 2.0, "{slow} {fast}");
    }
}
