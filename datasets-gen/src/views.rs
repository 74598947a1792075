//! Marked viewpoints: where a camera shows what a shape is made for.

use crate::stream::y_up;
use crate::{Kind, Spec, isosurface, pipes, scan, soup};

/// A camera that frames something worth seeing.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// `overview`, `interior` or `close`.
    pub name: &'static str,
    /// Where the eye stands, model units.
    pub position: [f64; 3],
    /// What stands in the middle of the picture.
    pub target: [f64; 3],
    /// Direction that is up in the picture.
    pub up: [f64; 3],
    /// Horizontal angle of view.
    pub fov_x_deg: f64,
}

/// The views of `spec`; the first is `overview`. All look at geometry from its front.
pub fn views(spec: &Spec) -> Vec<View> {
    let mut views = match spec.kind {
        Kind::Isosurface => isosurface::views(),
        Kind::Pipes => pipes::views(spec),
        Kind::Scan => scan::views(),
        Kind::Soup => soup::views(),
    };
    for view in &mut views {
        for vector in [&mut view.position, &mut view.target, &mut view.up] {
            *vector = y_up(*vector);
        }
    }
    views
}
