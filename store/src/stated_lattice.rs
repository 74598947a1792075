//! What a mesh file says of the lattice that its vertices lie on: a comment, which an export writes and the readers of
//! PLY and OBJ find.
//!
//! ```text
//! trex lattice 2^-17 1.5e0 -2e0 0e0           step, then the origin x, y, z
//! ```
//!
//! Invariants: 1. what is read back from a comment is the lattice to the bit; 2. a comment that says anything else is a
//! comment; 3. no file is believed: a build takes such a lattice only where every vertex lies on it (`LatticeCheck`).

use crate::geom::Lattice;

/// The first words of the comment.
pub(crate) const WORDS: &str = "trex lattice ";
/// Exponents of steps that a model may have: far beyond them neither a step nor its inverse is a number.
const EXPONENTS: std::ops::RangeInclusive<i32> = -700..=700;
/// Origins end here, as the coordinates of models do.
const ORIGIN_MOST: f64 = 1e200;

/// The comment that states `lattice`.
pub fn comment(lattice: &Lattice) -> String {
    let [x, y, z] = lattice.origin;
    format!("{WORDS}2^{} {x:e} {y:e} {z:e}", lattice.exponent)
}

/// The lattice that a comment states.
pub(crate) fn parse(comment: &str) -> Option<Lattice> {
    let mut words = comment.trim_start().strip_prefix(WORDS)?.split_whitespace();
    let exponent = words.next()?.strip_prefix("2^")?.parse().ok()?;
    let origin = [words.next()?, words.next()?, words.next()?].map(|word| word.parse::<f64>().ok());
    let [Some(x), Some(y), Some(z)] = origin else { return None };
    words.next().is_none().then(|| checked(Lattice { origin: [x, y, z], exponent })).flatten()
}

/// A lattice in the range that models may have.
pub(crate) fn checked(lattice: Lattice) -> Option<Lattice> {
    let is_origin = lattice.origin.iter().all(|v| v.abs() <= ORIGIN_MOST);
    (is_origin && EXPONENTS.contains(&lattice.exponent)).then_some(lattice)
}

/// Whether all triangles of a stream lie on the one lattice that their source states.
#[derive(Default)]
pub(crate) struct LatticeCheck {
    /// What the source has said with its first triangle; `None` again once a vertex is elsewhere.
    lattice: Option<Lattice>,
    is_begun: bool,
}

impl LatticeCheck {
    /// Looks at the next triangles of a source that states `lattice` now. Those with a coordinate that is no finite
    /// number do not count.
    pub(crate) fn add(&mut self, lattice: Option<Lattice>, triangles: &[[[f64; 3]; 3]]) {
        if triangles.is_empty() {
            return;
        }
        if !std::mem::replace(&mut self.is_begun, true) {
            self.lattice = lattice;
        }
        self.lattice = self.lattice.filter(|stated| {
            let is_on = |corner: &[f64; 3]| {
                let q = stated.snap(*corner);
                q.iter().all(|v| (0..1 << Lattice::MAX_BITS).contains(v)) && stated.position(q) == *corner
            };
            let is_finite = |corners: &&[[f64; 3]; 3]| corners.as_flattened().iter().all(|v| v.is_finite());
            Some(*stated) == lattice && triangles.iter().filter(is_finite).flatten().all(is_on)
        });
    }

    /// The lattice of the whole stream.
    pub(crate) fn lattice(&self) -> Option<Lattice> {
        self.lattice
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// What a source states, and the triangles that it hands out then.
    type StatedTriangles<'a> = (Option<Lattice>, &'a [[[f64; 3]; 3]]);

    #[test]
    fn a_comment_that_says_anything_else_is_a_comment() {
        for words in [
            "",
            "trex lattice",
            "trex lattice 2^-3 0 0",
            "trex lattice 2^-3 0 0 0 0",
            "trex lattice 3^-3 0 0 0",
            "trex lattice 2^-3 0 nan 0",
            "trex lattice 2^-3 0 inf 0",
            "trex lattice 2^-1000 0 0 0",
            "trex lattice 2^99999999999 0 0 0",
            "a trex lattice 2^-3 0 0 0",
        ] {
            assert_eq!(parse(words), None, "{words}");
        }
        assert_eq!(
            parse(" trex lattice 2^-3 1 -2.5 0e0\r"),
            Some(Lattice { origin: [1.0, -2.5, 0.0], exponent: -3 })
        );
    }

    #[test]
    fn a_lattice_holds_where_every_vertex_lies_on_it() {
        let stated = Lattice { origin: [1.0, 0.0, -4.0], exponent: -2 };
        let on = [[1.0, 0.0, -4.0], [1.25, 0.5, 0.0], [9.0, 0.75, 0.0]];
        let far = [[1e15, 0.0, 0.0], on[1], on[2]];
        let between = [[1.1, 0.0, 0.0], on[1], on[2]];
        let before = [[0.75, 0.0, 0.0], on[1], on[2]];
        let none = [[f64::NAN, 0.1, 0.0], on[1], on[2]];
        let check = |batches: &[StatedTriangles<'_>]| {
            let mut check = LatticeCheck::default();
            batches.iter().for_each(|&(lattice, triangles)| check.add(lattice, triangles));
            check.lattice()
        };
        assert_eq!(check(&[(None, &[]), (Some(stated), &[on, none]), (Some(stated), &[on])]), Some(stated));
        for bad in [far, between, before] {
            assert_eq!(check(&[(Some(stated), &[on]), (Some(stated), &[bad]), (Some(stated), &[on])]), None);
        }
        let other = Lattice { exponent: -3, ..stated };
        assert_eq!(check(&[(Some(stated), &[on]), (Some(other), &[on])]), None);
        assert_eq!(check(&[(None, &[on]), (Some(stated), &[on])]), None);
        assert_eq!(check(&[]), None);
    }

    proptest! {
        #[test]
        fn a_lattice_comes_back_to_the_bit(
            origin in prop::array::uniform3(-1e200f64..1e200), small in prop::array::uniform3(-1.0f64..1.0),
            exponent in EXPONENTS,
        ) {
            for origin in [origin, small] {
                let lattice = Lattice { origin, exponent };
                prop_assert_eq!(parse(&comment(&lattice)), Some(lattice));
            }
        }
    }
}
