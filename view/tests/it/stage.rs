//! A small model, and the server that shows it, on a thread of its own.

use rayon::{ThreadPool, ThreadPoolBuilder};
use std::fmt::Write;
use std::net::{SocketAddr, TcpListener};
use std::ops::ControlFlow;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use trex_render::{
    CameraKeys, CpuStage, FrameOptions, Layers, Method, Model, PagedMesh, PooledPages, RenderKeys, Scene,
    Session, SessionSetup, Voxels, pooled_tracers, write_png,
};
use trex_store::DamageList;
use trex_store::build::{BuildOptions, ExistingOutput, Precision, build};
use trex_store::import::{ImportOptions, open};
use trex_store::pool::{PagePool, PoolOptions};
use trex_store::{Budget, Interrupt, Material, MaterialNames, PageFile, Result};
use trex_view::{
    Embedders, MemoryFigures, ModelFigures, PoolFigures, ServeOptions, ServeReport, Surroundings, Token,
    serve,
};

/// Squares along a side of the model.
const SIDE: usize = 60;
/// Size of its pictures, unless a test says another.
pub(crate) const SIZE: [u32; 2] = [160, 120];

/// A page file, and the folder that goes with it.
type BuiltFile = (tempfile::TempDir, PathBuf);

/// The page file of a wave, which is open, built once.
fn wave() -> &'static PathBuf {
    static MODEL: OnceLock<BuiltFile> = OnceLock::new();
    let kept = MODEL.get_or_init(|| {
        let mut text = String::new();
        for at in 0..(SIDE + 1) * (SIDE + 1) {
            let [x, y] = [at % (SIDE + 1), at / (SIDE + 1)].map(|i| i as f64 / SIDE as f64);
            writeln!(text, "v {x} {} {y}", 0.1 * (9.0 * x).sin() * (7.0 * y).cos()).unwrap();
        }
        for at in 0..SIDE * SIDE {
            let a = at + at / SIDE + 1;
            writeln!(text, "f {a} {} {} {}", a + SIDE + 1, a + SIDE + 2, a + 1).unwrap();
        }
        built(&text)
    });
    &kept.1
}

/// The page file of a block, which is solid, built once.
fn block() -> &'static PathBuf {
    static MODEL: OnceLock<BuiltFile> = OnceLock::new();
    let kept = MODEL.get_or_init(|| {
        let mut text = String::new();
        for at in 0..8 {
            let [x, y, z] = [0, 1, 2].map(|axis| f64::from(at >> axis & 1) - 0.5);
            writeln!(text, "v {} {y} {}", x + 0.5, z + 0.5).unwrap();
        }
        built(&(text + "f 1 3 4 2\nf 5 6 8 7\nf 1 2 6 5\nf 3 7 8 4\nf 1 5 7 3\nf 2 4 8 6\n"))
    });
    &kept.1
}

/// The page file of a mesh, from its OBJ text.
fn built(text: &str) -> BuiltFile {
    let folder = tempfile::tempdir().unwrap();
    let (input, path) = (folder.path().join("mesh.obj"), folder.path().join("mesh.trex"));
    std::fs::write(&input, text).unwrap();
    let options = BuildOptions {
        precision: Precision::Default,
        voxels: trex_store::build::Voxels::Resolution(64),
        pool: threads(),
        budget: Budget::unlimited(),
        temp_dir: None,
        existing: ExistingOutput::Keep,
        resume: None,
        interrupt: Interrupt::default(),
    };
    let mut source = open(&input, &ImportOptions::unlimited(folder.path())).unwrap();
    build(&mut *source, &path, &options, &|_| {}, &|_| {}).unwrap();
    (folder, path)
}

fn threads() -> Arc<ThreadPool> {
    Arc::new(ThreadPoolBuilder::new().num_threads(2).build().unwrap())
}

/// The numbers of pictures.
pub(crate) fn keys() -> RenderKeys {
    RenderKeys {
        integrator: Method::Photon,
        resolution: SIZE,
        photons: 20_000,
        spp: 4,
        ..RenderKeys::default()
    }
}

/// A file as the wave's with a bit flipped in every page.
fn damaged_wave() -> &'static PathBuf {
    static MODEL: OnceLock<BuiltFile> = OnceLock::new();
    let (_, path) = MODEL.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("damaged.trex");
        let file = PageFile::open(wave(), &Budget::unlimited()).unwrap();
        let mut bytes = std::fs::read(wave()).unwrap();
        file.pages().iter().for_each(|page| bytes[page.offset as usize + 9] ^= 0x10);
        std::fs::write(&path, bytes).unwrap();
        (folder, path)
    });
    path
}

/// Models that there are to show.
#[derive(Clone, Copy)]
pub(crate) enum PlayModel {
    Wave,
    DamagedWave,
    Block,
}

/// What a server shows, and how.
#[derive(Clone, Copy)]
pub(crate) struct Play {
    pub(crate) keys: RenderKeys,
    pub(crate) limit_bytes: u64,
    pub(crate) shown: PlayModel,
    /// Materials that the model has beside its own, which nothing is made of.
    pub(crate) more_materials: usize,
    pub(crate) silence_max: Duration,
}

impl Default for Play {
    fn default() -> Play {
        let (limit_bytes, silence_max) = (1 << 30, Duration::from_secs(60));
        Play { keys: keys(), limit_bytes, shown: PlayModel::Wave, more_materials: 0, silence_max }
    }
}

impl Play {
    fn path(&self) -> &'static PathBuf {
        match self.shown {
            PlayModel::Wave => wave(),
            PlayModel::DamagedWave => damaged_wave(),
            PlayModel::Block => block(),
        }
    }
}

/// A name of a material as scenes of many have them: long, with a number.
fn numbered_name(index: usize) -> String {
    format!("{index:05} \u{1} {}", "Stahl".repeat(48))
}

/// A material of a colour of its own.
fn numbered(index: usize) -> Material {
    Material { kd: [0.1, 0.2, (index % 100) as f32 / 100.0], ..Material::default() }
}

type Tracer = PagedMesh<PooledPages>;

/// Gives a session on `play` to `then`, with its file and its pool.
///
/// Put together by hand, here and nowhere else: `trex_model::Model` stands beside this crate, not below it, and shows
/// the materials of its file, not those that a test adds.
fn with_session<R>(
    play: &Play,
    budget: &Budget,
    then: impl FnOnce(Session<Tracer>, &PageFile, &PagePool) -> R,
) -> R {
    let path = play.path();
    let file = Arc::new(PageFile::open(path, budget).unwrap());
    let options = PoolOptions { frames_bytes: 8 << 20, ..PoolOptions::default() };
    let pool = Arc::new(PagePool::open(file.clone(), path, budget, &options).unwrap());
    let voxels = Voxels::open(&file, budget).unwrap().map(Arc::new);
    let (bounds, mut materials) = (file.superblock().bounds, file.materials().to_vec());
    let mut names = MaterialNames::clone(file.material_names());
    materials.extend((0..play.more_materials).map(numbered));
    (0..play.more_materials).for_each(|index| names.push(&numbered_name(index)));
    let mut model = Model {
        bounds,
        outline: Default::default(),
        materials,
        names: Arc::new(names),
        emitters: vec![],
        voxels,
    };
    let camera = CameraKeys {
        position: Some([1.5, 1.0, 2.0]),
        target: Some([0.5, 0.0, 0.5]),
        ..CameraKeys::default()
    };
    let scene = Scene { render: play.keys, camera, ..Scene::default() };
    let view = scene.view(&mut model).unwrap();
    let tracers = pooled_tracers(&file, &pool, 2);
    let g_stage = Box::new(CpuStage::default());
    let pool_of_threads = threads().into();
    let setup = SessionSetup {
        model,
        view,
        layers: Layers::default(),
        portion: None,
        tracers,
        pool: pool_of_threads,
        g_stage,
    };
    then(Session::new(setup, budget).unwrap(), &file, &pool)
}

/// The picture that a session at leisure makes with `keys`, as PNG.
pub(crate) fn rendered(keys: RenderKeys) -> Vec<u8> {
    with_session(&Play { keys, ..Play::default() }, &Budget::unlimited(), |mut session, _, _| {
        session.illuminate(&|| false, &mut |_, _| {}).unwrap();
        session.render(keys.spp, &|| false, &mut |_, _| ControlFlow::Continue(()));
        let mut png = vec![];
        write_png(session.film(), keys.exposure.factor(), session.thread_pool(), &mut png).unwrap();
        png
    })
}

fn pool_figures(pool: &PagePool) -> PoolFigures {
    let stats = pool.stats();
    PoolFigures { frames: stats.frames, damaged: stats.damaged, ..PoolFigures::default() }
}

/// A server that runs.
pub(crate) struct Server {
    pub(crate) address: SocketAddr,
    pub(crate) token: String,
    stop: Arc<AtomicBool>,
    /// Times that pictures took each other's place.
    exchanges: Arc<AtomicU64>,
    thread: Option<JoinHandle<Result<ServeReport>>>,
    /// One runs at a time: tests count threads.
    _turn: MutexGuard<'static, ()>,
}

impl Server {
    /// Times that pictures took each other's place: each is planned once.
    pub(crate) fn exchanges(&self) -> u64 {
        self.exchanges.load(Ordering::Relaxed)
    }

    /// A server of pictures with `keys`.
    pub(crate) fn new(keys: RenderKeys) -> Server {
        Server::start(Play { keys, ..Play::default() })
    }

    /// A server that shows `play`.
    pub(crate) fn start(play: Play) -> Server {
        static TURN: Mutex<()> = Mutex::new(());
        let turn = TURN.lock().unwrap_or_else(PoisonError::into_inner);
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let (address, token) = (listener.local_addr().unwrap(), Token::random().unwrap());
        let (stop, exchanges) = (Arc::new(AtomicBool::new(false)), Arc::<AtomicU64>::default());
        let exchanged = exchanges.clone();
        let (stops, said) = (stop.clone(), token.clone());
        let work = move || {
            let budget = Budget::new(play.limit_bytes);
            with_session(&play, &budget, |session, file, pool| {
                let frames = FrameOptions::default();
                let session = session.go_live(frames)?;
                let hosts = vec!["render.lan".to_owned()];
                let silence_max = play.silence_max;
                let (follows_page, embedders) = (true, Embedders::default());
                let options =
                    ServeOptions { token: said, hosts, frames, follows_page, embedders, silence_max };
                let materials = session.model().materials.clone();
                let around = Surroundings {
                    name: "wave",
                    command_line: &|recipe| format!("{recipe:?}"),
                    model_path: "/models/wave.trex",
                    model: ModelFigures { triangle_count: 7200, ..ModelFigures::default() },
                    file_materials: &materials,
                    views: vec![],
                    camera: CameraKeys::default(),
                    budget: &budget,
                    memory: &|| MemoryFigures { used_bytes: budget.used_bytes(), ..MemoryFigures::default() },
                    pool: &|| pool_figures(pool),
                    device_name: "processor",
                    device: &|| None,
                    damage: &|| DamageList::of(file, pool),
                    kept_light: &|_, _| Ok(u64::MAX),
                    set_limit: &|bytes| pool.set_limit(bytes).map(drop),
                    exchange: &|_, apply| {
                        exchanged.fetch_add(1, Ordering::Relaxed);
                        apply()
                    },
                    make_room: &|_| Ok(()),
                    stop: &|| stops.load(Ordering::Relaxed),
                };
                serve(session, &listener, &options, &around)
            })
        };
        let thread = std::thread::Builder::new().name("server".into()).spawn(work).unwrap();
        Server {
            address,
            token: token.digits().to_owned(),
            stop,
            exchanges,
            thread: Some(thread),
            _turn: turn,
        }
    }

    /// Ends the server; what it served.
    pub(crate) fn end(mut self) -> ServeReport {
        self.stop.store(true, Ordering::Relaxed);
        self.thread.take().unwrap().join().unwrap().unwrap()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A test that has failed says what it missed; this may say why.
            if let Ok(Err(error)) = thread.join() {
                assert!(std::thread::panicking(), "{error}");
                std::io::Write::write_all(&mut std::io::stderr(), format!("{error}\n").as_bytes()).unwrap();
            }
        }
    }
}

/// Threads of servers that there are now.
pub(crate) fn view_threads() -> usize {
    let tasks = std::fs::read_dir("/proc/self/task").unwrap();
    let name =
        |task: std::fs::DirEntry| std::fs::read_to_string(task.path().join("comm")).unwrap_or_default();
    tasks.filter_map(|task| task.ok()).map(name).filter(|name| name.starts_with("view-")).count()
}
