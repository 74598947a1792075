//! `Lens`: where the pixels of a film look.

/// What the filter has to know of a camera.
pub trait Lens: Sync {
    /// Unit direction in which place (x, y) of the film looks, pixels from its upper left corner.
    fn direction(&self, x: f64, y: f64) -> [f64; 3];

    /// Angle that a pixel takes in the middle of the film, radians.
    fn pixel_angle(&self) -> f64;
}
