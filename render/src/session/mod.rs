//! A session: a model on show. Takes events, yields pictures; headless.
//!
//! ```text
//! Session::new(setup, budget) -> illuminate -> render(stop, after_pass) -> film() -> write_png
//!                             <- apply(Event)
//!         .go_live(options) -> LiveSession -> frame(stop) -> frame(stop) ... -> write_png
//!                                          <- apply(Event)
//! ```
//!
//! Two ways to a picture: [`Session::render`] takes what it takes; [`LiveSession::frame`] goes on for as long as a
//! deadline allows and tells what there is.
//!
//! Invariants: 1. an event that is refused changes nothing; 2. an accepted one clears the film of a session at leisure,
//! so all of its samples are of one state; 3. film and passes are leased from the budget for the life of the session.

mod brightness;
mod carried_light;
mod change_parts;
mod event;
mod event_state;
mod fetch_block;
mod foresight;
mod frame;
mod frame_report;
mod ladder;
mod light;
mod live;
mod look_ahead;
mod memory;
mod parts;
mod resettle;
mod shares;
mod tile_run;

pub use event::Event;
pub use fetch_block::{BLOCK_TILES_MIN, FetchBlock};
pub use frame_report::{FrameProgress, FrameReport};
pub use live::{FrameOptions, LiveSession, TileStamp};
pub use memory::{MemoryPlan, PictureNeeds};

use self::parts::{ShownModel, show};
use light::{IndirectLight, LightRoom, LightWork};
use shares::{SessionFacts, SessionShares, facts};

use crate::g_stage::GStage;
use crate::integrate::RenderContext;
use crate::photon::irradiance::PhotonMap;
use crate::scene::settings::RenderSettings;
use crate::scene::world::{Model, View, World};
use crate::schedule::{Canvas, PASS_SAMPLES_MAX, Pass, SampleWork, TileWork, Until, WhenFull, Workers};
use crate::stats::{PassStats, PhotonStats};
use crate::threads::WorkerThreads;
use crate::trace::{Advance, Answer, PagedTracer, Retry, ShadedHit, WAIT};
use rayon::ThreadPool;
use std::ops::ControlFlow;
use trex_film::{Film, Layers, Portion, Tiles, filter_bytes, smooth};
use trex_store::{Budget, Lease, Result, StopSignal};

/// What is seen at a pixel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pick {
    /// The triangle; its parameter is the distance from the camera, model units.
    pub shaded: ShadedHit,
    /// The place on it, model units.
    pub position: [f64; 3],
}

/// The parts that a [`Session`] is made of.
#[derive(Debug)]
pub struct SessionSetup<T> {
    /// The model on show.
    pub model: Model,
    /// Camera, lights and the numbers of the picture.
    pub view: View,
    /// Layers that the film keeps beside radiance.
    pub layers: Layers,
    /// The part of the picture that is made; `None` for all of it. A session of a portion makes this one picture, at
    /// leisure: it takes no other settings, and is not smoothed.
    pub portion: Option<Portion>,
    /// Tracers, one for each worker.
    pub tracers: Vec<T>,
    /// The threads of the workers, at least one a tracer.
    pub pool: WorkerThreads,
    /// The device that answers rays through the voxels; [`crate::CpuStage`] is the processor.
    pub g_stage: Box<dyn GStage>,
}

/// A model, a view of it, and the film that collects its samples. `T` answers rays, one per worker thread.
///
/// ```
/// use std::ops::ControlFlow;
/// use std::sync::Arc;
/// use trex_render::{CpuStage, Layers, Model, NaiveMesh, NaiveTriangle, Scene, Session, SessionSetup, write_png};
/// use trex_store::{Aabb, Budget, Material};
///
/// let corners = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
/// let mesh = NaiveMesh::new(vec![NaiveTriangle { corners, material: 0 }]);
/// let bounds = Aabb { lo: [0.0; 3], hi: [1.0, 1.0, 0.0] };
/// let (materials, names) = (vec![Material::default()], Arc::new(["default"].into_iter().collect()));
/// let mut model = Model { bounds, outline: Default::default(), materials, names, emitters: vec![], voxels: None };
///
/// let text = "model = 'one.ply'\n[render]\nintegrator = 'direct'\nresolution = [32, 32]";
/// let scene = Scene::parse(text, "scene.toml".as_ref())?;
/// let view = scene.view(&mut model)?;
/// let pool = trex_render::WorkerThreads::start(1)?;
/// let g_stage = Box::new(CpuStage::default());
/// let layers = Layers::default();
/// let setup = SessionSetup { model, view, layers, portion: None, tracers: vec![mesh], pool, g_stage };
/// let mut session = Session::new(setup, &Budget::unlimited())?;
/// let stats = session.render(scene.render.spp, &|| false, &mut |_, _| ControlFlow::Continue(()));
/// assert!(stats.complete && stats.total.rays.primary == 32 * 32 * 16);
///
/// let mut png = vec![];
/// write_png(session.film(), scene.render.exposure.factor(), session.thread_pool(), &mut png).unwrap();
/// # Ok::<(), trex_store::Error>(())
/// ```
#[derive(Debug)]
pub struct Session<T> {
    pub(super) model: Model,
    pub(super) view: View,
    pub(super) world: World,
    pub(super) tracers: Vec<T>,
    pub(super) tiles: Tiles,
    pub(super) film: Film,
    pub(super) light: Box<dyn IndirectLight>,
    pub(super) pool: WorkerThreads,
    /// Has the octree of the model, where there is one.
    pub(super) g_stage: Box<dyn GStage>,
    pub(super) budget: Budget,
    /// Room of the passes.
    lease: Lease,
    /// Room of the materials and emitters.
    _model_lease: Lease,
    shown: ShownModel,
}

/// The effect of an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Change {
    /// The samples are what they were.
    Nothing,
    /// Another camera.
    View,
    /// Other lights or another material.
    Light,
}

/// Counts of what [`Session::render`] did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct RenderStats {
    /// Counts of all passes together.
    pub total: PassStats,
    /// Passes begun.
    pub passes: u32,
    /// Samples that every pixel has now.
    pub spp: u32,
    /// True when every pixel has the samples that were asked for.
    pub complete: bool,
}

impl<T: PagedTracer + Send> Session<T> {
    /// A session with an empty film.
    ///
    /// # Errors
    /// Those of [`World::new`] and [`GStage::set_octree`]; [`trex_store::Code::MemoryLimit`] when the budget has no
    /// room for the film, or for the batches that the G-stage wants.
    ///
    /// # Panics
    /// When there is no tracer, or not a thread for each.
    pub fn new(setup: SessionSetup<T>, budget: &Budget) -> Result<Session<T>> {
        let SessionSetup { mut model, view, layers, portion, mut tracers, pool, mut g_stage } = setup;
        assert!(!tracers.is_empty(), "a session needs a tracer");
        assert!(pool.current_num_threads() >= tracers.len(), "a tracer needs a thread");
        let world = World::new(&model, &view)?;
        let facts = SessionFacts { portion, ..facts((&model, layers), (&tracers, &*g_stage), false) };
        let shares = SessionShares::new(&view.settings, &facts);
        let leases = shares.lease(budget)?;
        let resolution = view.settings.resolution;
        let portion = portion.unwrap_or(Portion::whole(resolution, 0));
        let shown = ShownModel::new(&mut model, &view.parts, tracers.len(), budget)?;
        show(&mut tracers, &world.parts);
        if let Some(voxels) = &model.voxels {
            g_stage.set_octree(voxels)?;
        }
        Ok(Session {
            model,
            view,
            world,
            tracers,
            tiles: Tiles::z_curve_of(resolution, portion.tiles),
            film: Film::of_portion(resolution, layers, portion, leases.film),
            light: shares.light.light(LightRoom { lasting: leases.light, in_frames: None }),
            pool,
            g_stage,
            budget: budget.clone(),
            lease: leases.passes,
            _model_lease: leases.model,
            shown,
        })
    }

    /// What this session leases while its settings are these, in frames or at leisure.
    fn shares(&self, settings: &RenderSettings, layers: Layers, is_live: bool) -> SessionShares {
        let at_work = (&self.tracers[..], &*self.g_stage);
        SessionShares::new(settings, &facts((&self.model, layers), at_work, is_live))
    }

    /// Changes camera, lights or a material.
    ///
    /// # Errors
    /// Those of [`World::new`] and [`Model::edit`]; nothing has changed then.
    pub fn apply(&mut self, event: Event) -> Result<()> {
        match self.change(event)? {
            Change::Nothing => return Ok(()),
            Change::View => {}
            Change::Light => self.light.forget(),
        }
        self.film.clear();
        Ok(())
    }

    /// Changes camera, lights or a material; film and photons are still those of the state before.
    fn change(&mut self, event: Event) -> Result<Change> {
        let (mut model, mut view) = (None, self.view.clone());
        let change = if matches!(event, Event::Camera(_)) { Change::View } else { Change::Light };
        match event {
            Event::Settings(settings) => return self.resettle(None, settings),
            Event::Parts(parts) => return self.change_parts(parts),
            Event::Camera(camera) => view.camera = camera,
            Event::Lights(lights) => view.lights = lights,
            Event::Material { index, edit } => model.insert(self.model.clone()).edit(index, &edit)?,
        }
        let world = World::new(model.as_ref().unwrap_or(&self.model), &view)?;
        self.world = world;
        self.view = view;
        if let Some(model) = model {
            self.model = model;
        }
        Ok(change)
    }

    /// From now on, work also ends within a tile, or a batch of photons, once `stop` is due: those who are asked
    /// between tiles (`stop` of [`Session::render`] and the like) have to say so then, too.
    pub fn stop_by(&mut self, stop: &StopSignal) {
        self.tracers.iter_mut().for_each(|tracer| tracer.stop_by(stop));
    }

    /// What is seen through the middle of a pixel (x, y) on the exact mesh; waits for its pages. `None` for nothing.
    pub fn pick(&mut self, pixel: [u32; 2]) -> Option<Pick> {
        self.pick_until(pixel, &|| false)
    }

    /// As [`Session::pick`], but `None` once `stop` says so, which is asked before each wait for pages.
    pub fn pick_until(&mut self, [x, y]: [u32; 2], stop: &dyn Fn() -> bool) -> Option<Pick> {
        let ray = self.world.projection.ray(f64::from(x) + 0.5, f64::from(y) + 0.5);
        let mut found = None;
        let ask = |tracer: &mut T| match tracer.intersect_shaded(&ray) {
            Answer::Exact(hit) => {
                found = hit;
                Advance::Done
            }
            Answer::Blocked => Advance::Blocked,
        };
        Retry::default().alone(&mut self.tracers[0], || (!stop()).then_some(WAIT), ask);
        found.map(|shaded| Pick { shaded, position: ray.at(shaded.hit.t).to_array() })
    }

    /// Sends the photons that are still to be sent, of those the view asks for; does nothing for methods without.
    /// `stop` is asked in between; `tell` hears how many are done, and of how many.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for a pass of photons, or for all of `full-gi`.
    pub fn illuminate(
        &mut self,
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u64, u64),
    ) -> Result<PhotonStats> {
        let (light, mut work) = self.light_parts(stop);
        light.illuminate(&mut work, tell)
    }

    /// The light that photons brought, by side of the octree's facets; `photon` alone keeps it so.
    pub fn photon_map(&self) -> Option<&PhotonMap> {
        self.light.photon_map()
    }

    /// The light, and what its photons fly through; `stop` is asked in between.
    pub(super) fn light_parts<'a>(
        &'a mut self,
        stop: &'a (dyn Fn() -> bool + Sync),
    ) -> (&'a mut dyn IndirectLight, LightWork<'a>) {
        let Session { model, world, tracers, light, pool, g_stage, budget, .. } = self;
        (&mut **light, LightWork { world, model, g_stage: &**g_stage, tracers, pool, budget, stop })
    }

    /// Takes every pixel to `spp` samples, pass by pass: 1, 2, 4, then 4 more each. `photon` and `full-gi` have the
    /// indirect light that [`Session::illuminate`] brought up to then. `stop` is asked between tiles, `after_pass`
    /// looks at the film and may end the work; what is on the film stays, and a later call goes on.
    pub fn render(
        &mut self,
        spp: u32,
        stop: &(dyn Fn() -> bool + Sync),
        after_pass: &mut dyn FnMut(&Film, &RenderStats) -> ControlFlow<()>,
    ) -> RenderStats {
        let ctx = RenderContext::new(&self.world, &self.model, self.light.irradiance())
            .with_layers(self.film.layers())
            .with_photon_tree(self.light.photon_tree());
        let work = TileWork { samples: SampleWork::new(ctx, &*self.g_stage), tiles: &self.tiles };
        let mut stats = RenderStats { spp: self.film.samples(), ..RenderStats::default() };
        while stats.spp < spp && !stop() {
            let target = spp.min(stats.spp + stats.spp.clamp(1, PASS_SAMPLES_MAX));
            let until = Until { stop, deadline: None, tiles: u32::MAX };
            let mut pass = Pass::new(target, self.tracers.len(), WhenFull::Wait);
            let workers = Workers { tracers: &mut self.tracers, pool: &self.pool };
            let canvas = Canvas { film: &mut self.film, display: None };
            stats.total.add(&pass.run(&work, canvas, workers, &until));
            stats.passes += 1;
            stats.spp = self.film.samples();
            if after_pass(&self.film, &stats).is_break() {
                break;
            }
        }
        stats.complete = stats.spp >= spp;
        stats
    }

    /// Smooths the indirect light on a film that keeps it apart, until samples are added: see `film/src/filter.rs`.
    /// Does nothing for others, nor for a portion: its neighbours are not there.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`] when the budget has no room for the filter's work.
    pub fn smooth(&mut self) -> Result<()> {
        self.smooth_until(&|| false)
    }

    /// As [`Session::smooth`], until `stop`, which is asked between rows: the film is as it was then.
    ///
    /// # Errors
    /// Those of [`Session::smooth`].
    pub fn smooth_until(&mut self, stop: &(dyn Fn() -> bool + Sync)) -> Result<()> {
        if !self.film.layers().filter || self.is_portion() {
            return Ok(());
        }
        let _lease = self.budget.lease("the filter", filter_bytes(self.film.resolution()))?;
        smooth(&mut self.film, &self.world.projection, &self.pool, stop);
        Ok(())
    }

    /// The film with the samples up to now.
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

    /// The threads of the workers.
    pub fn thread_pool(&self) -> &ThreadPool {
        &self.pool
    }

    /// The tracers, for their counters.
    pub fn tracers(&self) -> &[T] {
        &self.tracers
    }
}

#[cfg(test)]
mod tests;
