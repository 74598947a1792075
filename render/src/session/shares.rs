//! `SessionShares`: what a session leases for as long as its settings stay. The one law of its memory: a session is
//! made of what it says, goes live and takes other settings by the difference of two, and [`super::MemoryPlan`] counts
//! it.
//!
//! ```text
//! Session::new      shares at leisure -> lease
//! go_live           shares in frames, less those at leisure -> lease
//!                   the picture before, where there is room for it -> lease
//! other settings    what differs of the old is exchanged for what differs of the new, in one step of the ledger
//! ```
//!
//! Not in here, since it is leased while it is used alone: the octree and the tables, which the session borrows; sums
//! of a pass of photons at leisure; photons of `full-gi`; filter and encoder.

use super::light::{LightBytes, LightKind};
use crate::g_stage::{GNeeds, GStage};
use crate::integrate::rays_asked;
use crate::scene::settings::RenderSettings;
use crate::scene::world::Model;
use crate::schedule::pass_bytes;
use crate::shading::light::{Emitter, Emitters};
use crate::trace::PagedTracer;
use trex_film::{Display, Layers, Portion, portion_bytes};
use trex_store::{Budget, Lease, Material, Result};

/// Copies of materials: of the caller, of the viewer, of the session and its world, and of both while an edit replaces
/// them.
const MATERIAL_COPIES: usize = 6;
/// Copies of emitters: of the caller, of the session and of an edit.
const EMITTER_COPIES: usize = 3;

/// What decides the shares of a session, beside its settings.
#[derive(Clone, Copy, Debug)]
pub(super) struct SessionFacts {
    /// Layers that the film keeps.
    pub(super) layers: Layers,
    /// The part of the picture that the film is of; `None` for all of it.
    pub(super) portion: Option<Portion>,
    /// Worker threads.
    pub(super) workers: usize,
    /// What the G-stage needs.
    pub(super) g_needs: GNeeds,
    /// True where pages come from afar.
    pub(super) is_far: bool,
    /// True when pictures come in frames with a deadline.
    pub(super) is_live: bool,
    /// Facets of the octree; `None` for a model without.
    pub(super) facets: Option<usize>,
    pub(super) materials: usize,
    pub(super) emitters: usize,
}

/// What decides the shares of a session on `model`, beside its settings: who works for it, and on what.
pub(super) fn facts<T: PagedTracer>(
    (model, layers): (&Model, Layers),
    (tracers, g_stage): (&[T], &dyn GStage),
    is_live: bool,
) -> SessionFacts {
    SessionFacts {
        layers,
        portion: None,
        workers: tracers.len(),
        g_needs: g_stage.needs(),
        is_far: tracers.iter().any(|tracer| tracer.frames_from_afar().is_some()),
        is_live,
        facets: model.voxels.as_ref().map(|voxels| voxels.facet_count()),
        materials: model.materials.len(),
        emitters: model.emitters.len(),
    }
}

/// The shares of a session.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SessionShares {
    resolution: [u32; 2],
    pub(super) layers: Layers,
    /// Copies of materials and emitters.
    pub(super) model_bytes: u64,
    pub(super) film_bytes: u64,
    /// The picture on show; 0 at leisure.
    pub(super) display_bytes: u64,
    /// Room of the passes over tiles, and of photons side by side.
    pub(super) pass_bytes: u64,
    /// How the indirect light is kept.
    pub(super) light: LightKind,
    /// What that takes, in frames or at leisure.
    pub(super) light_bytes: LightBytes,
}

/// The leases that a session is made of.
pub(super) struct SessionLeases {
    pub(super) model: Lease,
    pub(super) film: Lease,
    pub(super) passes: Lease,
    /// Of the light; of no bytes where nothing of it lasts.
    pub(super) light: Lease,
}

/// The leases by which a session goes live.
pub(super) struct LiveLeases {
    pub(super) display: Lease,
    /// Of what light takes in frames.
    pub(super) light: Lease,
}

impl SessionShares {
    /// The shares of a session with these settings.
    pub(super) fn new(settings: &RenderSettings, facts: &SessionFacts) -> SessionShares {
        let SessionFacts {
            layers,
            portion,
            workers,
            ref g_needs,
            is_far,
            is_live,
            facets,
            materials,
            emitters,
        } = *facts;
        let resolution = settings.resolution;
        let portion = portion.unwrap_or(Portion::whole(resolution, 0));
        let light = LightKind::new(settings, facets);
        let light_bytes = light.bytes(settings, workers, g_needs);
        // Which hold no names. What lights are drawn from is there twice while a state replaces the one before.
        let copies = MATERIAL_COPIES * materials * size_of::<Material>()
            + EMITTER_COPIES * emitters * size_of::<Emitter>();
        SessionShares {
            resolution,
            layers,
            model_bytes: copies as u64 + 2 * Emitters::bytes(emitters),
            film_bytes: portion_bytes(resolution, layers, &portion),
            display_bytes: if is_live { Display::bytes(resolution) } else { 0 },
            pass_bytes: pass_bytes(resolution, (workers, is_far), rays_asked(settings), g_needs)
                + light_bytes.flocks,
            light,
            light_bytes: if is_live { light_bytes.live() } else { light_bytes.at_leisure() },
        }
    }

    /// Bytes of light that are leased for as long as the session lasts.
    pub(super) fn lit_bytes(&self) -> u64 {
        self.light_bytes.lasting + self.light_bytes.in_frames
    }

    /// True when the film of one is not that of the other.
    pub(super) fn has_other_film(&self, other: &SessionShares) -> bool {
        (self.resolution, self.layers) != (other.resolution, other.layers)
    }

    /// True when the light of one is kept otherwise than that of the other.
    pub(super) fn has_other_light(&self, other: &SessionShares) -> bool {
        self.light != other.light
    }

    /// Bytes of what is to be made anew where these take the place of `before`.
    pub(super) fn bytes_after(&self, before: &SessionShares) -> u64 {
        let film = if self.has_other_film(before) { self.film_bytes + self.display_bytes } else { 0 };
        let light = if self.has_other_light(before) { self.lit_bytes() } else { 0 };
        self.pass_bytes + film + light
    }

    /// Leases what a session at leisure is made of, in one step.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when `budget` has no room for all of it.
    pub(super) fn lease(&self, budget: &Budget) -> Result<SessionLeases> {
        let bytes = self.model_bytes + self.film_bytes + self.pass_bytes + self.light_bytes.lasting;
        let mut room = budget.lease("the film, the light and the passes of a picture", bytes)?;
        Ok(SessionLeases {
            model: room.split(self.model_bytes),
            film: room.split(self.film_bytes),
            passes: room.split(self.pass_bytes),
            light: room,
        })
    }

    /// Leases what a session in frames has beside one at leisure, in one step.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when `budget` has no room for all of it.
    pub(super) fn lease_live(&self, budget: &Budget) -> Result<LiveLeases> {
        let bytes = self.display_bytes + self.light_bytes.in_frames;
        let mut room = budget.lease("the picture on show", bytes)?;
        Ok(LiveLeases { display: room.split(self.display_bytes), light: room })
    }
}
