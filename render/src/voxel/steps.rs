//! Steps of walks, counted where somebody measures.
//!
//! Invariant: a walk that nobody listens to has the code of one without counts.

/// What hears of the steps of a walk: nobody, or a count of them. A step leaves an empty cube.
pub(super) trait Steps {
    /// A step is made.
    fn step(&mut self);
}

impl Steps for () {
    #[inline(always)]
    fn step(&mut self) {}
}

impl Steps for u64 {
    fn step(&mut self) {
        *self += 1;
    }
}
