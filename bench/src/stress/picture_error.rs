//! How wrong a picture is.

use trex_image::{Constants, Picture, compare, flip};

/// Of a picture beside its reference.
#[derive(Clone, Copy, Debug)]
pub(super) struct PictureError {
    pub(super) relmse: f64,
    /// Of the picture as it is shown.
    pub(super) flip: f64,
}

impl PictureError {
    /// That of `picture`, shown with `exposure`; `None` where no pixel can be compared.
    pub(super) fn of(picture: &Picture, reference: &Picture, exposure: f32) -> Option<PictureError> {
        let relmse = compare(picture, reference, Constants::default()).all.relmse?;
        Some(PictureError { relmse, flip: flip(picture, reference, exposure) })
    }
}
