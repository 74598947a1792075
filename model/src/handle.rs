//! `Model`: the handle. Opens the file, hands out sessions, and keeps the memory of all that it has handed out below
//! the limit.
//!
//! Invariants: 1. all that is leased is leased from one ledger; 2. the octree is read once, by the first session that
//! asks for it; 3. a session that is refused leaves those there are as they were.

use crate::device::{DeviceReport, StageSource};
use crate::info::ModelInfo;
use crate::options::{DamagePolicy, OpenOptions, SessionOptions, ThreadSource};
use crate::outline::outline;
use crate::shared_pool::{PoolSource, SharedPool};
use std::path::Path;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use trex_render::{
    Emitter, FrameOptions, GStage, MemoryPlan, MeshTracer, PictureNeeds, Scene, SessionSetup, Voxels,
    WorkerThreads,
};
use trex_store::io::IoOptions;
use trex_store::pool::PagePool;
use trex_store::{Budget, Code, Error, FileSizes, PageFile, Result};

/// A session on a model: events in, pictures out, at leisure.
pub type Session = trex_render::Session<MeshTracer>;
/// A session whose pictures come in frames with a deadline.
pub type LiveSession = trex_render::LiveSession<MeshTracer>;

/// An open model. Clones are handles to one; it is closed when the last of them, and the last session, is dropped.
///
/// ```no_run
/// use trex_model::{Model, OpenOptions};
/// use trex_render::{Ray, Scene};
/// use trex_store::Interrupt;
///
/// let model = Model::open("iso.trex".as_ref(), &OpenOptions::with_limit(256 << 20))?;
/// let [x, _, z] = model.info()?.bounds.center();
/// let y = model.info()?.bounds.hi[1];
/// let ray = Ray { origin: [x, y + 10.0, z], direction: [0.0, -1.0, 0.0], t_max: f64::INFINITY };
/// let hit = model.intersect(&[ray], &Interrupt::default())?[0].expect("it is above the model");
/// assert!(hit.t < 10.0 + y && model.occluded(&[ray], &Interrupt::default())?[0]);
///
/// let mut scene = Scene::default();
/// (scene.render.resolution, scene.render.spp) = ([32, 32], 1);
/// let picture = model.render(&scene, &Interrupt::default(), &|_| {})?;
/// let mut png = vec![];
/// picture.write_png(&mut png).unwrap();
/// # Ok::<(), trex_store::Error>(())
/// ```
#[derive(Clone)]
pub struct Model(Arc<ModelState>);

struct ModelState {
    file: Arc<PageFile>,
    pool: SharedPool,
    voxels: Mutex<Option<Arc<Voxels>>>,
    /// Of the latest session; locked while room is made and leased, by whoever makes it.
    plan: Mutex<Option<MemoryPlan>>,
    threads: WorkerThreads,
    device: StageSource,
    budget: Budget,
    /// The limit that it was opened with.
    limit_bytes: u64,
    io: IoOptions,
    damage: DamagePolicy,
}

impl std::fmt::Debug for Model {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Model").field("path", &self.0.file.path()).finish_non_exhaustive()
    }
}

const _: () = {
    const fn is_shared<T: Send + Sync + 'static>() {}
    is_shared::<Model>();
    const fn is_sent<T: Send + 'static>() {}
    is_sent::<Session>();
    is_sent::<LiveSession>();
};

impl Model {
    /// Opens the page file at `path`, of any size: its tables are read and checked, no page is.
    ///
    /// # Errors
    /// Those of [`PageFile::open`]; [`Code::Io`] when the system refuses a thread; [`Code::NoAdapter`] when a device
    /// that is asked for by name cannot be used.
    pub fn open(path: &Path, options: &OpenOptions) -> Result<Model> {
        let OpenOptions { budget, threads, io, damage, device, picture } = options;
        let file = match PageFile::open(path, budget) {
            // The limit that is named must do for all of the picture.
            Err(error) if error.code() == Code::MemoryLimit => {
                let smallest = |picture: &PictureNeeds| {
                    MemoryPlan::for_sizes(&FileSizes::of(path)?, picture, budget.limit_bytes()).map(drop)
                };
                return Err(picture.as_ref().map_or(Ok(()), smallest).err().unwrap_or(error));
            }
            file => Arc::new(file?),
        };
        Ok(Model(Arc::new(ModelState {
            device: StageSource::open(device, budget)?,
            file,
            pool: SharedPool::default(),
            voxels: Mutex::default(),
            plan: Mutex::default(),
            threads: match threads {
                ThreadSource::Start(count) => WorkerThreads::start(count.get())?,
                ThreadSource::Shared(pool) => pool.clone().into(),
            },
            limit_bytes: budget.limit_bytes(),
            budget: budget.clone(),
            io: io.clone(),
            damage: *damage,
        })))
    }

    /// What the tables of the file say.
    ///
    /// # Errors
    /// [`Code::Damaged`], [`Code::Io`].
    pub fn info(&self) -> Result<ModelInfo> {
        ModelInfo::new(&self.0.file)
    }

    /// A session on what `scene` describes, of which nothing is left to be decided; its G-rays are answered by `stage`,
    /// or by the model's device.
    pub(crate) fn begin_session(
        &self,
        scene: &Scene,
        options: &SessionOptions,
        stage: Option<Box<dyn GStage>>,
    ) -> Result<Session> {
        let needs = self.0.device.with_needs(&options.picture_needs(scene, self.worker_count())?);
        let mut latest = self.lock_room();
        let plan = self.make_room_for(&needs)?;
        let voxels = if needs.asks_voxels() { self.voxels()? } else { None };
        let mut model = self.scene_model(voxels);
        let view = scene.view(&mut model)?;
        let tracers = self.0.pool.tracers(&self.0.file, self.worker_count())?;
        let g_stage = stage.map_or_else(|| self.0.device.stage(), Ok)?;
        let setup = SessionSetup {
            model,
            view,
            layers: needs.layers,
            portion: needs.portion,
            tracers,
            pool: self.0.threads.clone(),
            g_stage,
        };
        let session = Session::new(setup, &self.0.budget)?;
        *latest = Some(plan);
        Ok(session)
    }

    /// Sets the frames of pages to what each of `pictures` leaves of the limit: one takes the place of the other. What
    /// else is leased is not counted: pictures say what is beside them.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] with the smallest limit that works; nothing is changed then.
    pub fn make_room(&self, pictures: &[PictureNeeds]) -> Result<()> {
        let _room = self.lock_room();
        let plans = self.plans(pictures, self.0.budget.limit_bytes())?;
        let tightest = plans.iter().min_by_key(|plan| plan.frames_bytes + plan.staging_bytes);
        tightest.map_or(Ok(()), |plan| self.0.pool.fit(plan, &self.pool_source()))
    }

    /// Most bytes of the light of before that are planned beside the tightest of `pictures`, under this limit or the
    /// present one.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] with the smallest limit that works.
    pub fn kept_light_bytes(&self, pictures: &[PictureNeeds], limit_bytes: Option<u64>) -> Result<u64> {
        let plans = self.plans(pictures, limit_bytes.unwrap_or_else(|| self.0.budget.limit_bytes()))?;
        Ok(plans.iter().map(|plan| plan.kept_light_bytes).min().unwrap_or(0))
    }

    /// How this limit is shared out for each of `pictures`.
    fn plans(&self, pictures: &[PictureNeeds], limit_bytes: u64) -> Result<Vec<MemoryPlan>> {
        let plan = |picture| MemoryPlan::new(&self.0.file, &self.0.device.with_needs(picture), limit_bytes);
        pictures.iter().map(plan).collect()
    }

    /// These options of frames, with the light of before that was planned for the session that was made last.
    pub fn planned_frames(&self, options: FrameOptions) -> FrameOptions {
        let kept_light_bytes = self.memory_plan().map_or(0, |plan| plan.kept_light_bytes);
        FrameOptions { kept_light_bytes, ..options }
    }

    /// Has `apply` put `picture` in the place of the one on show: frames of pages that it needs go before, those that
    /// it leaves come after. How the limit is shared out is planned once. Nobody else makes room meanwhile, so `apply`
    /// asks this model for no session, no rays and no room: it would wait for itself.
    ///
    /// # Errors
    /// [`Code::MemoryLimit`] with the smallest limit that works; those of `apply`. Frames are as they were then.
    pub fn exchange(&self, picture: &PictureNeeds, apply: impl FnOnce() -> Result<()>) -> Result<()> {
        let _room = self.lock_room();
        let picture = self.0.device.with_needs(picture);
        let plan = MemoryPlan::new(&self.0.file, &picture, self.0.budget.limit_bytes())?;
        let source = self.pool_source();
        let before = self.0.pool.shrink_to(&plan)?;
        match apply() {
            Ok(()) => {
                // Frames that find no room yet, since others are still to go, come with what is planned next.
                let _ = self.0.pool.fit(&plan, &source);
                Ok(())
            }
            Err(error) => {
                // As it was: there was room for it.
                let _ = self.0.pool.set_frames(before);
                Err(error)
            }
        }
    }

    /// Sets the memory limit while `picture` is on show: below the one that the model was opened with, or that one
    /// again.
    ///
    /// # Errors
    /// [`Code::Usage`] for a greater one; those of [`Model::make_room`].
    pub fn set_limit(&self, limit_bytes: u64, picture: &PictureNeeds) -> Result<()> {
        let ModelState { budget, limit_bytes: most, .. } = &*self.0;
        if limit_bytes > *most {
            return Err(Error::new(
                Code::Usage,
                "the limit cannot pass the one that the model was opened with",
            )
            .at_place("the memory limit")
            .numbers(format!("{} MiB asked, {} MiB at most", limit_bytes >> 20, most >> 20))
            .next("open the model again with a greater limit"));
        }
        let _room = self.lock_room();
        let plan = MemoryPlan::new(&self.0.file, &self.0.device.with_needs(picture), limit_bytes)?;
        // Frames that go are leased until they have gone, those that come need the room first.
        budget.set_limit(limit_bytes.max(budget.limit_bytes()));
        self.0.pool.fit(&plan, &self.pool_source())?;
        budget.set_limit(limit_bytes);
        Ok(())
    }

    /// Sets the memory limit to the one that the model was opened with; frames come with what is planned next.
    #[cfg(feature = "view")]
    pub(crate) fn restore_limit(&self) {
        let _room = self.lock_room();
        self.0.budget.set_limit(self.0.limit_bytes);
    }

    /// The page file.
    pub fn file(&self) -> &Arc<PageFile> {
        &self.0.file
    }

    /// The pool of pages; `None` before anything has asked for one.
    pub fn pool(&self) -> Option<Arc<PagePool>> {
        self.0.pool.get()
    }

    /// How the limit was shared out for the session that was made last; `None` before the first.
    pub fn memory_plan(&self) -> Option<MemoryPlan> {
        *self.lock_room()
    }

    /// The ledger of the memory limit.
    pub fn budget(&self) -> &Budget {
        &self.0.budget
    }

    /// The device that answers G-rays, and what it has done.
    pub fn device(&self) -> DeviceReport {
        self.0.device.report()
    }

    /// The threads that work on this model.
    pub fn threads(&self) -> &WorkerThreads {
        &self.0.threads
    }

    /// Damaged pages that were met, with their errors, at most the first 1024: what they hold is missing in pictures.
    pub fn damage(&self) -> Vec<(u32, Error)> {
        self.pool().map_or_else(Vec::new, |pool| pool.damage())
    }

    /// Whether what was read is all there, which is not asked of a model that leaves damaged pages out.
    ///
    /// # Errors
    /// That of the first damaged page that was met since the model was opened.
    pub fn check_damage(&self) -> Result<()> {
        match (self.0.damage, self.damage().into_iter().next()) {
            (DamagePolicy::Refuse, Some((_, error))) => Err(error),
            _ => Ok(()),
        }
    }

    pub(crate) fn worker_count(&self) -> usize {
        self.0.threads.current_num_threads()
    }

    pub(crate) fn shared_pool(&self) -> &SharedPool {
        &self.0.pool
    }

    pub(crate) fn pool_source(&self) -> PoolSource<'_> {
        let ModelState { file, budget, io, .. } = &*self.0;
        PoolSource { file, path: file.path(), budget, io }
    }

    /// Bytes that are leased for what no plan of this model counts: sessions and rays there are, and what the caller
    /// has leased from the ledger; not those of the device, which stand in the needs of pictures.
    pub(crate) fn foreign_bytes(&self) -> u64 {
        let voxels = self.0.voxels.lock().unwrap_or_else(PoisonError::into_inner);
        let ours = self.0.file.resident_table_bytes()
            + self.0.pool.leased_bytes()
            + self.0.device.leased_bytes()
            + voxels.as_ref().map_or(0, |voxels| voxels.leased_bytes());
        self.0.budget.used_bytes().saturating_sub(ours)
    }

    /// Held by who makes room until what it is for has been leased: two at a time would both count on it. Holds the
    /// plan of the latest session.
    pub(crate) fn lock_room(&self) -> MutexGuard<'_, Option<MemoryPlan>> {
        self.0.plan.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets the frames to what a new picture with these needs leaves beside all that is leased.
    pub(crate) fn fit_pool(&self, needs: &PictureNeeds) -> Result<()> {
        let _room = self.lock_room();
        self.make_room_for(&self.0.device.with_needs(needs)).map(drop)
    }

    /// Sets the frames to what a new picture leaves beside all that is leased.
    fn make_room_for(&self, needs: &PictureNeeds) -> Result<MemoryPlan> {
        let beside = PictureNeeds { copies_bytes: needs.copies_bytes + self.foreign_bytes(), ..*needs };
        let plan = MemoryPlan::new(&self.0.file, &beside, self.0.budget.limit_bytes())?;
        self.0.pool.fit(&plan, &self.pool_source())?;
        Ok(plan)
    }

    /// The octree with its links, read by the first that asks; `None` for a file without.
    fn voxels(&self) -> Result<Option<Arc<Voxels>>> {
        let mut voxels = self.0.voxels.lock().unwrap_or_else(PoisonError::into_inner);
        if voxels.is_none() {
            *voxels = Voxels::open(&self.0.file, &self.0.budget)?.map(Arc::new);
        }
        Ok(voxels.clone())
    }

    /// What the renderer is told of the file.
    fn scene_model(&self, voxels: Option<Arc<Voxels>>) -> trex_render::Model {
        let file = &self.0.file;
        let block = file.superblock();
        let emitter = |emitter: &trex_store::Emitter| Emitter {
            corners: emitter.corners.map(|q| block.lattice.position(q)),
            material: emitter.material,
        };
        trex_render::Model {
            bounds: block.bounds,
            outline: outline(file),
            materials: file.materials().to_vec(),
            names: file.material_names().clone(),
            emitters: file.emitters().iter().map(emitter).collect(),
            voxels,
        }
    }
}
