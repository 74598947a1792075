//! Marked viewpoints: where a camera shows what a shape is made for.

use crate::stream::y_up;
use crate::view::View;
use crate::{Kind, Spec, isosurface, pipes, scan, soup};

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
