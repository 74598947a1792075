//! `Session`: a model on show. Takes events, yields pictures; headless.
//!
//! ```text
//! Session::new(model, setup, budget, tracers) -> illuminate -> render(stop, after_pass) -> film() -> picture::write_png
//!                                             -> go_live(options) -> frame(stop) -> frame(stop) ... -> picture()
//!                                             <- apply(Event)
//! ```
//!
//! Two ways to a picture: [`Session::render`] takes what it takes; [`Session::frame`] goes on for as long as a deadline
//! allows and tells what there is ([`crate::live`]).
//!
//! Invariants: 1. an event that is refused changes nothing; 2. an accepted one clears the film, so all samples of a
//! film are of one state; 3. film and frame loop are leased from the budget for the life of the session.

use crate::camera::Camera;
use crate::film::{Film, Layers};
use crate::filter;
use crate::frame::{PASS_SAMPLES_MAX, PagedTracer, Pass, PassStats, Until, frame_bytes};
use crate::frames::Changes;
use crate::integrator::{Integrator, Method};
use crate::light::Light;
use crate::live::Live;
use crate::photon_tree::PhotonTree;
use crate::tile::Tiles;
use crate::voxel::{GScene, Irradiance, Occluders, PhotonMap, PhotonStats, PhotonWork, PhotonWorld};
use crate::world::{GRays, MaterialEdit, Model, View, World};
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
/// let mut model = Model { bounds, materials: vec![Material::default()], emitters: vec![], voxels: None };
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
    pub(crate) model: Model,
    pub(crate) view: View,
    pub(crate) world: World,
    pub(crate) tracers: Vec<T>,
    pub(crate) tiles: Tiles,
    pub(crate) film: Film,
    /// Light in the voxels; of `photon` alone.
    pub(crate) photons: Option<PhotonMap>,
    /// Photons one by one; of `full-gi` alone, once they were sent.
    pub(crate) tree: Option<PhotonTree>,
    /// Frames with a deadline.
    pub(crate) live: Option<Live>,
    pub(crate) budget: Budget,
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
        let photons = match &model.voxels {
            Some(voxels) if view.method == Method::Photon => {
                Some(PhotonMap::new(voxels.facet_count(), budget)?)
            }
            _ => None,
        };
        let budget = budget.clone();
        let (tree, live) = (None, None);
        Ok(Session { model, view, world, tracers, tiles, film, photons, tree, live, budget, _lease: lease })
    }

    /// Changes camera, lights or a material.
    ///
    /// # Errors
    /// Those of [`World::new`] and [`Model::edit`]; nothing has changed then.
    pub fn apply(&mut self, event: Event) -> Result<()> {
        let (mut model, mut view) = (None, self.view.clone());
        let changes_light = !matches!(event, Event::Camera(_));
        match event {
            Event::Camera(camera) => view.camera = camera,
            Event::Lights(lights) => view.lights = lights,
            Event::Material { index, edit } => model.insert(self.model.clone()).edit(index, &edit)?,
        }
        let world = World::new(model.as_ref().unwrap_or(&self.model), &view)?;
        let before = std::mem::replace(&mut self.world, world).projection;
        self.view = view;
        if let Some(model) = model {
            self.model = model;
        }
        if self.live.is_some() {
            self.begin_state(&before, if changes_light { Changes::Light } else { Changes::Camera });
        } else if let Some(photons) = self.photons.as_mut().filter(|_| changes_light) {
            photons.clear();
        }
        if changes_light {
            self.tree = None;
        }
        self.film.clear();
        Ok(())
    }

    /// Sends the photons that are still to be sent, of those the view asks for; does nothing for methods without. `stop` is
    /// asked in between; `tell` hears how many are done, and of how many.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for a pass of photons, or for all of `full-gi`.
    pub fn illuminate(
        &mut self,
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u64, u64),
    ) -> Result<PhotonStats> {
        if self.view.method == Method::FullGi && self.tree.is_none() {
            return self.grow_tree(stop, tell);
        }
        if self.view.g_rays.bake {
            return self.bake(stop, tell);
        }
        let Some(mut map) = self.photons.take() else { return Ok(PhotonStats::default()) };
        let target = self.view.g_rays.photons;
        let stats = self.photon_world().map_or(Ok(None), |all| all.begin()).map(|work| {
            let mut work: PhotonWork = work?;
            let all = self.photon_world()?;
            Some(all.trace((&mut work, &mut map), target, stop, &mut |done| tell(done, target)))
        });
        self.photons = Some(map);
        Ok(stats?.unwrap_or_default())
    }

    /// What photons go through; `None` for a model without voxels.
    pub(crate) fn photon_world(&self) -> Option<PhotonWorld<'_>> {
        let voxels = self.model.voxels.as_ref()?;
        Some(PhotonWorld {
            world: &self.world,
            bounds: &self.model.bounds,
            voxels: voxels.scene(self.view.g_rays.occluders),
            threads: self.tracers.len(),
            budget: &self.budget,
        })
    }

    /// Takes every pixel to `spp` samples, pass by pass: 1, 2, 4, then 4 more each. `photon` and `full-gi` have the indirect light that
    /// [`Session::illuminate`] brought up to then. `stop` is asked between tiles,
    /// `after_pass` looks at the film and may end the work; what is on the film stays, and a later call goes on.
    pub fn render(
        &mut self,
        spp: u32,
        stop: &(dyn Fn() -> bool + Sync),
        after_pass: &mut dyn FnMut(&Film, &RenderStats) -> ControlFlow<()>,
    ) -> RenderStats {
        let irradiance = self.photons.as_ref().map_or(Irradiance::NONE, |map| Irradiance::new(map, None));
        let integrator = integrator(&self.world, (&self.model, &self.view), self.film.layers(), irradiance)
            .with_photons(self.tree.as_ref());
        let mut stats = RenderStats { spp: self.film.samples(), ..RenderStats::default() };
        while stats.spp < spp && !stop() {
            let target = spp.min(stats.spp + stats.spp.clamp(1, PASS_SAMPLES_MAX));
            let until = Until { stop, deadline: None, tiles: u32::MAX };
            let mut pass = Pass::new(target, self.tracers.len());
            let film = (&mut self.film, None);
            stats.total.add(&pass.run((&integrator, &self.tiles), film, &mut self.tracers, &until));
            stats.passes += 1;
            stats.spp = self.film.samples();
            if after_pass(&self.film, &stats).is_break() {
                break;
            }
        }
        stats.complete = stats.spp >= spp;
        stats
    }

    /// Smooths the indirect light on a film that keeps it apart, until samples are added: see [`crate::filter`]. Does
    /// nothing for others.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for the filter's work.
    pub fn smooth(&mut self) -> Result<()> {
        if !self.film.layers().filter {
            return Ok(());
        }
        filter::smooth(&mut self.film, &self.world.projection, self.tracers.len(), &self.budget)
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

/// The integrator of a view, with the voxels where it asks them.
pub(crate) fn integrator<'a>(
    world: &'a World,
    (model, view): (&'a Model, &View),
    layers: Layers,
    irradiance: Irradiance<'a>,
) -> Integrator<'a> {
    let GRays { occluders, near, .. } = view.g_rays;
    let is_cubes = matches!(view.method, Method::DebugUpper | Method::DebugLower);
    let occluders = if is_cubes { Occluders::Off } else { occluders };
    let voxels = model.voxels.as_ref();
    // What stands in for pages needs none itself.
    let scene =
        voxels.map(|voxels| GScene { voxels: voxels.scene(occluders), lower: None, irradiance, near });
    let lower = voxels.and_then(|voxels| voxels.lower_scene(occluders));
    let for_g_rays = scene.filter(|_| view.method.asks_voxels()).map(|scene| GScene { lower, ..scene });
    Integrator::new(world, layers.kept().any()).with_voxels(for_g_rays).with_stand_in(scene)
}

#[cfg(test)]
#[path = "session_tests.rs"]
mod tests;
