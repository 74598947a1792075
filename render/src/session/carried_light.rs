//! `CarriedLight`: the light of the pictures before, which the display carries to where the camera sees its surfaces
//! now.
//!
//! ```text
//! the camera moves             the picture on show is the one before, and its view is kept here
//! light, a material            the same; what is carried is worth less the more it differs from what is found now
//! parts, settings, photons      nothing is carried: no light of before is right
//! ```
//!
//! Invariant: the view is that of the picture that the display keeps as the one before.

use crate::scene::camera::{Projection, ViewChange};
use trex_film::Display;

/// The view of the picture whose light is carried on.
#[derive(Debug, Default)]
pub(super) struct CarriedLight {
    view: Option<Projection>,
    /// Light has changed since it.
    is_lit_anew: bool,
    /// Pictures that followed each other so.
    pictures: u32,
}

impl CarriedLight {
    /// Learns that the camera has moved since the picture on `display`, which was of `view`, or light has changed,
    /// where it `is_lit_anew`.
    pub(super) fn note_change(&mut self, display: &mut Display, view: Projection, is_lit_anew: bool) {
        if display.remember(is_lit_anew) {
            self.view = Some(view);
            self.is_lit_anew = is_lit_anew;
            self.pictures = self.pictures.wrapping_add(1);
        } else {
            self.is_lit_anew |= is_lit_anew;
        }
    }

    /// Carries nothing on.
    pub(super) fn forget(&mut self, display: &mut Display) {
        display.forget();
        *self = CarriedLight::default();
    }

    /// The change of view from the picture before to `now`.
    pub(super) fn change(&self, now: &Projection) -> Option<ViewChange> {
        self.view.map(|before| ViewChange::new(before, now, self.is_lit_anew))
    }

    /// How many pictures followed each other before this one: each takes other random numbers, so that their noise is
    /// not the same.
    pub(super) fn pictures(&self) -> u32 {
        self.pictures
    }
}
