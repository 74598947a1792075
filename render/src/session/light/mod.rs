//! The indirect light of a session. `LightKind`, chosen from the settings, says what memory it takes and makes it: the
//! one place of a session that asks for the method.
//!
//! ```text
//! settings -> LightKind -> bytes             -> shares of the session, plan of a limit
//!                       -> IndirectLight     map    `photon`: irradiance of facets, through voxels or baked
//!                                            tree   `full-gi`: photons each by itself, through the mesh
//!                                            none   all others
//! ```

mod indirect;
mod map;
mod none;
mod tree;

pub(super) use indirect::{Arrival, IndirectLight, LightBytes, LightRoom, LightWork};

use crate::g_stage::GNeeds;
use crate::photon::irradiance::MapForm;
use crate::scene::method::Method;
use crate::scene::settings::RenderSettings;
use map::MapLight;
use none::NoLight;
use tree::TreeLight;

/// The way in which a session keeps its indirect light.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum LightKind {
    /// Nothing is kept.
    None,
    /// Irradiance of facets.
    Map(MapForm),
    /// Photons, each by itself.
    Tree,
}

impl LightKind {
    /// The kind that `settings` ask for on a model whose octree has so many facets; `None` for a model without.
    pub(super) fn new(settings: &RenderSettings, facets: Option<usize>) -> LightKind {
        match (settings.integrator, facets) {
            (Method::Photon, Some(facets)) => LightKind::Map(MapForm { facets, caustics: settings.caustics }),
            (Method::FullGi, _) => LightKind::Tree,
            _ => LightKind::None,
        }
    }

    /// Bytes that light of this kind takes by `settings`, with so many workers and a stage with these needs.
    pub(super) fn bytes(self, settings: &RenderSettings, workers: usize, g_needs: &GNeeds) -> LightBytes {
        match self {
            LightKind::None => LightBytes::default(),
            LightKind::Map(form) => MapLight::bytes(form, settings, (workers, g_needs)),
            LightKind::Tree => TreeLight::bytes(settings, workers),
        }
    }

    /// Light of this kind, of which nothing is there yet, in its `room`.
    pub(super) fn light(self, room: LightRoom) -> Box<dyn IndirectLight> {
        match self {
            LightKind::None => Box::new(NoLight),
            LightKind::Map(form) => Box::new(MapLight::new(form, room)),
            LightKind::Tree => Box::new(TreeLight::default()),
        }
    }
}
