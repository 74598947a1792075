//! The error of an input of which no triangle is left.

use crate::error::{Code, Error};
use crate::next_step::NextStep;

/// Triangles of an input of which none is left, counted by what was wrong with them.
#[derive(Clone, Copy)]
pub(crate) struct RejectedCounts {
    pub(crate) read: u64,
    pub(crate) degenerate: u64,
    /// Those of them that had area.
    pub(crate) collapsed: u64,
    pub(crate) non_finite: u64,
}

/// The error of an input of this name.
pub(crate) fn no_triangles(
    name: &str,
    RejectedCounts { read, degenerate, collapsed, non_finite }: RejectedCounts,
) -> Error {
    let what = match read {
        0 => "there are no triangles in the input",
        _ => "the input holds no triangle that can be drawn",
    };
    let next = match collapsed {
        0 => NextStep::from("check the input in the program that wrote it"),
        _ => NextStep::FinerLattice,
    };
    Error::new(Code::InputEmpty, what)
        .at_place(name)
        .numbers(format!(
            "{read} triangles read, {degenerate} degenerate, {non_finite} with coordinates that are no finite numbers"
        ))
        .next(next)
}
