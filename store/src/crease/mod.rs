//! Normals from the mesh: smooth where triangles meet at less than an angle, sharp where they do not.
//!
//! ```text
//! triangles -> corner: place, plane, angle -> buckets by place  -> all corners of a place -> normal of each
//!           -> buckets by triangle -> CreasedSource hands them out with the triangles, in order
//! ```
//!
//! A corner's normal is the sum of the unit normals of those triangles at its place whose planes are within the angle
//! of its own, each weighed by its angle there (Thürmer and Wüthrich, "Computing vertex normals from polygonal
//! facets", 1998). What comes out as the plane's own normal is none, and takes nothing.
//!
//! Invariants: 1. a normal depends on the triangles at its place alone, not on their order; 2. memory is bounded by
//! [`CreasedSource::smallest_bytes`], whatever the model's size, but for a bucket, which is leased before it is read;
//! 3. all that is kept between is in scratch files without a name.

mod bucket_file;
mod source;
#[cfg(test)]
mod tests;

pub use source::{CreaseOptions, CreasedSource};
