//! `View`: a camera that a shape is worth seeing from.

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
