//! `Session`: a model on show. Takes events, yields pictures; headless.
//!
//! ```text
//! Session::new(model, setup, budget, tracers) -> render(stop, after_pass) -> film() -> picture::write_png
//!                                             <- apply(Event)
//! ```
//!
//! Invariants: 1. an event that is refused changes nothing; 2. an accepted one clears the film, so all samples of a
//! film are of one state; 3. film and frame loop are leased from the budget for the life of the session.

use crate::camera::Camera;
use crate::film::{Film, Layers};
use crate::frame::{PASS_SAMPLES_MAX, PagedTracer, PassStats, frame_bytes, render_pass};
use crate::integrator::Integrator;
use crate::light::Light;
use crate::tile::Tiles;
use crate::world::{MaterialEdit, Model, View, World};
use std::ops::ControlFlow;
use trex_store::{Budget, Lease, Result};

/// Something the user did.
#[derive(Clone, Debug)]
pub enum Event {
    /// Another camera.
    Camera(Camera),
    /// Other lights; all of them.
    Lights(Vec<Light>),
    /// Changes to the material with this index.
    Material {
        /// Index into the model's materials.
        index: usize,
        /// What changes.
        edit: MaterialEdit,
    },
}

/// A model, a view of it, and the film that collects its samples. `T` answers rays, one per worker thread.
///
/// ```
/// use std::ops::ControlFlow;
/// use trex_render::trace::naive::{NaiveMesh, NaiveTriangle};
/// use trex_render::{film::Layers, picture::write_png, scene::Scene, session::Session, world::Model};
/// use trex_store::{Aabb, Budget, Material};
///
/// let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
/// let mesh = NaiveMesh::new(vec![NaiveTriangle { corners, material: 0 }]);
/// let bounds = Aabb { lo: [0.0; 3], hi: [1.0, 1.0, 0.0] };
/// let mut model = Model { bounds, materials: vec![Material::default()], emitters: vec![] };
///
/// let text = "model = 'one.ply'\n[render]\nresolution = [32, 32]";
/// let scene = Scene::parse(text, "scene.toml".as_ref())?;
/// let view = scene.view(&mut model)?;
/// let mut session = Session::new(model, view, Layers::default(), &Budget::unlimited(), vec![mesh])?;
/// let stats = session.render(scene.render.spp, &|| false, &mut |_, _| ControlFlow::Continue(()));
/// assert!(stats.complete && stats.total.rays.primary == 32 * 32 * 16);
///
/// let mut png = vec![];
/// write_png(session.film(), scene.render.exposure, &mut png).unwrap();
/// # Ok::<(), trex_store::Error>(())
/// ```
#[derive(Debug)]
pub struct Session<T> {
    model: Model,
    view: View,
    world: World,
    tracers: Vec<T>,
    tiles: Tiles,
    film: Film,
    _lease: Lease,
}

/// What [`Session::render`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct RenderStats {
    /// All passes together.
    pub total: PassStats,
    /// Passes begun.
    pub passes: u32,
    /// Samples that every pixel has now.
    pub spp: u32,
    /// Whether that is as many as were asked for.
    pub complete: bool,
}

impl<T: PagedTracer + Send> Session<T> {
    /// A session with an empty film. One worker thread per tracer.
    ///
    /// # Errors
    /// Those of [`World::new`]; [`trex_store::Code::MemoryLimit`] when the budget has no room for the film.
    ///
    /// # Panics
    /// When there is no tracer.
    pub fn new(
        model: Model,
        view: View,
        layers: Layers,
        budget: &Budget,
        tracers: Vec<T>,
    ) -> Result<Session<T>> {
        assert!(!tracers.is_empty(), "a session needs a tracer");
        let world = World::new(&model, &view)?;
        let lease = budget.lease("the frame loop", frame_bytes(view.resolution, tracers.len()))?;
        let film = Film::new(view.resolution, layers, budget)?;
        let tiles = Tiles::z_curve(view.resolution);
        Ok(Session { model, view, world, tracers, tiles, film, _lease: lease })
    }

    /// Changes camera, lights or a material.
    ///
    /// # Errors
    /// Those of [`World::new`] and [`Model::edit`]; nothing has changed then.
    pub fn apply(&mut self, event: Event) -> Result<()> {
        let (mut model, mut view) = (None, self.view.clone());
        match event {
            Event::Camera(camera) => view.camera = camera,
            Event::Lights(lights) => view.lights = lights,
            Event::Material { index, edit } => model.insert(self.model.clone()).edit(index, &edit)?,
        }
        self.world = World::new(model.as_ref().unwrap_or(&self.model), &view)?;
        self.view = view;
        if let Some(model) = model {
            self.model = model;
        }
        self.film.clear();
        Ok(())
    }

    /// Takes every pixel to `spp` samples, pass by pass: 1, 2, 4, then 4 more each. `stop` is asked between tiles,
    /// `after_pass` looks at the film and may end the work; what is on the film stays, and a later call goes on.
    pub fn render(
        &mut self,
        spp: u32,
        stop: &(dyn Fn() -> bool + Sync),
        after_pass: &mut dyn FnMut(&Film, &RenderStats) -> ControlFlow<()>,
    ) -> RenderStats {
        let integrator = Integrator::new(&self.world, self.film.layers().any());
        let mut stats = RenderStats { spp: self.film.samples(), ..RenderStats::default() };
        while stats.spp < spp && !stop() {
            let target = spp.min(stats.spp + stats.spp.clamp(1, PASS_SAMPLES_MAX));
            let pass = render_pass(&integrator, &mut self.film, &self.tiles, &mut self.tracers, target, stop);
            stats.total.add(&pass);
            stats.passes += 1;
            stats.spp = self.film.samples();
            if after_pass(&self.film, &stats).is_break() {
                break;
            }
        }
        stats.complete = stats.spp >= spp;
        stats
    }

    /// What has been collected.
    pub fn film(&self) -> &Film {
        &self.film
    }

    /// The model with all edits.
    pub fn model(&self) -> &Model {
        &self.model
    }

    /// The view with all edits.
    pub fn view(&self) -> &View {
        &self.view
    }

    /// The tracers, for their counters.
    pub fn tracers(&self) -> &[T] {
        &self.tracers
    }
}

#[cfg(test)]
#[path = "session_tests.rs"]
mod tests;
