//! Procedural triangle meshes, seeded and streamed: inputs of any size with no file between.
//!
//! ```text
//!   "gen:isosurface:100M:7" -> Spec::parse -> open -> TriangleSource -> the store's build, or write::write
//! ```
//!
//! Invariants: 1. the same `Spec` gives the same triangles in the same order at any thread count; 2. vertices
//! shared by triangles are equal to the bit; 3. the memory of a stream is leased from the caller's budget and
//! stays below 256 MiB; 4. count, bounds and edge length are known before the stream ([`ScanHint`]); 5. y is upwards.
//!
//! [`ScanHint`]: trex_store::ScanHint

mod dice;
mod isosurface;
mod paint;
mod pipes;
mod pool;
mod scan;
mod soup;
mod spec;
mod stream;
mod view;
mod views;
pub mod write;

pub use paint::ColourFrequency;
pub use soup::degenerate_count;
pub use spec::{GenOptions, Kind, Spec};
pub use view::View;
pub use views::views;
pub use write::write;

use glam::DVec3;
use paint::PaintedSource;
use trex_store::{Result, TriangleSource};

/// Most materials of a generated mesh: writers lease memory for so many.
pub(crate) const MATERIALS_MAX: usize = 64;

/// Opens the stream of `spec`.
///
/// # Errors
/// `Code::MemoryLimit` when the budget has no room, `Code::Interrupted` when interrupted meanwhile, `Code::Io` when the
/// system starts no more threads.
///
/// ```
/// use datasets_gen::{GenOptions, Spec};
/// let spec = Spec::parse("gen:soup:10k:7")?;
/// let mut source = datasets_gen::open(&spec, &GenOptions::default())?;
/// let mut batch = trex_store::TriangleBatch::default();
/// let mut count = 0;
/// while source.next_batch(&mut batch)? {
///     count += batch.len();
/// }
/// assert_eq!(count, 10_000);
/// # Ok::<(), trex_store::Error>(())
/// ```
pub fn open(spec: &Spec, options: &GenOptions) -> Result<Box<dyn TriangleSource>> {
    let source = match spec.kind {
        Kind::Isosurface => isosurface::open(spec, options),
        Kind::Pipes => pipes::open(spec, options),
        Kind::Scan => scan::open(spec, options),
        Kind::Soup => soup::open(spec, options),
    }?;
    assert!(source.materials().len() <= MATERIALS_MAX, "writers lease memory for fewer materials");
    Ok(match spec.colours {
        Some(frequency) => Box::new(PaintedSource::new(source, frequency, spec.seed)),
        None => source,
    })
}

/// The median length of the triangles' edges. Generators that have no formula for it ask a sample.
pub(crate) fn median_edge(corners: &[[[f64; 3]; 3]]) -> f64 {
    let squared = |corners: &[[f64; 3]; 3]| {
        let [a, b, c] = corners.map(DVec3::from);
        [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)]
    };
    let mut edges: Vec<f64> = corners.iter().flat_map(squared).collect();
    let middle = edges.len() / 2;
    edges.select_nth_unstable_by(middle, f64::total_cmp).1.sqrt()
}
