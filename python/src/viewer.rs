//! `NativeViewer`: a model in pages of a browser, served by a thread of its own until it is closed.

use crate::detached;
use crate::errors::{exception, raised};
use pyo3::prelude::*;
use std::net::{IpAddr, SocketAddr, TcpListener};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use trex_model::{LiveSession, Model, SessionOptions, ShownModel};
use trex_render::{Camera, Exposure, Fov, FrameOptions, KeyValue, LightRig, Scene};
use trex_store::{Code, Error, Interrupt, Result, StopSignal};
use trex_view::{Embedders, Recipe, SIDE_MAX, SILENCE_MAX, ServeOptions, Token};

/// Size of the picture until the page says its own.
const FIRST_RESOLUTION: [u32; 2] = [1280, 720];
/// Smallest side of a picture that is tried where memory is short, pixels.
const SIDE_LEAST: u32 = 80;
/// Longest time of a frame.
const T_MAX: Duration = Duration::from_millis(100);

/// Where pages find the viewer, and who may have them.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct ViewerPlace {
    bind: IpAddr,
    port: u16,
    hosts: Vec<String>,
    embedders: Vec<String>,
}

/// A viewer, until it is closed.
#[pyclass(frozen, module = "trex._trex")]
pub(crate) struct NativeViewer {
    address: SocketAddr,
    token: Token,
    stop: Arc<AtomicBool>,
    thread: Mutex<Option<JoinHandle<Result<()>>>>,
}

impl NativeViewer {
    /// Begins to show `scene`; where it says no resolution the picture follows the page.
    pub(crate) fn new(
        py: Python<'_>,
        model: Model,
        mut scene: Scene,
        place: ViewerPlace,
    ) -> PyResult<NativeViewer> {
        let follows_page = scene.given.resolution.is_none();
        if follows_page {
            scene.render.resolution = FIRST_RESOLUTION;
        }
        suit_pages(&mut scene);
        raised(py, check_resolution(scene.render.resolution))?;
        let embedders = raised(py, Embedders::new(&place.embedders))?;
        let listener = raised(py, listen(&place))?;
        let address = raised(py, listener.local_addr().map_err(|error| refused(&place, &error)))?;
        let frames = FrameOptions { t_max: T_MAX, fills_while_moving: false, ..FrameOptions::default() };
        let session = detached::run(py, None, |work| {
            let session = open_session(&model, &mut scene, follows_page, &work.interrupt)?;
            session.go_live(model.planned_frames(frames))
        })?;
        let token = raised(py, Token::random())?;
        let hosts = place.hosts;
        let options = ServeOptions {
            token: token.clone(),
            hosts,
            frames,
            follows_page,
            embedders,
            silence_max: SILENCE_MAX,
        };
        let stop = Arc::new(AtomicBool::new(false));
        let work = ViewerWork { model, scene, session, listener, options, stop: stop.clone() };
        let thread = std::thread::Builder::new().name("trex-viewer".into()).spawn(move || work.run());
        let thread = thread.map_err(|error| Error::thread_refused("the thread of the viewer", &error));
        Ok(NativeViewer { address, token, stop, thread: Mutex::new(Some(raised(py, thread)?)) })
    }

    fn thread(&self) -> MutexGuard<'_, Option<JoinHandle<Result<()>>>> {
        self.thread.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[pymethods]
impl NativeViewer {
    /// The port that it listens on.
    #[getter]
    fn port(&self) -> u16 {
        self.address.port()
    }

    /// The secret that a page has to say.
    #[getter]
    fn token(&self) -> String {
        self.token.digits().to_owned()
    }

    /// True once it shows nothing more: closed, or ended by an error that `close` raises.
    #[getter]
    fn closed(&self) -> bool {
        self.thread().as_ref().is_none_or(JoinHandle::is_finished)
    }

    /// Ends it, and gives its memory back.
    fn close(&self, py: Python<'_>) -> PyResult<()> {
        self.stop.store(true, Ordering::Relaxed);
        let Some(thread) = self.thread().take() else { return Ok(()) };
        let ended = py.detach(|| thread.join());
        let ended = ended.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
        ended.map_err(|error| exception(py, &error))
    }
}

impl Drop for NativeViewer {
    fn drop(&mut self) {
        // Its thread ends by itself within a second.
        self.stop.store(true, Ordering::Relaxed);
    }
}

/// What the thread works on.
struct ViewerWork {
    model: Model,
    scene: Scene,
    session: LiveSession,
    listener: TcpListener,
    options: ServeOptions,
    stop: Arc<AtomicBool>,
}

impl ViewerWork {
    fn run(self) -> Result<()> {
        let path = self.model.file().path().to_path_buf();
        let full = std::fs::canonicalize(&path).unwrap_or_else(|_| path.clone());
        // A call of camera and settings alone makes this picture.
        let is_said = self.scene.lights.is_empty() && self.scene.materials.is_empty();
        let shown = ShownModel {
            name: &path.file_stem().unwrap_or_default().to_string_lossy(),
            path: &full.display().to_string(),
            scene: &self.scene,
            words: &|recipe| {
                words(&path.display().to_string(), if is_said { recipe } else { &Recipe::Saved })
            },
            peak_rss_bytes: &|| None,
            stop: &|| self.stop.load(Ordering::Relaxed),
        };
        self.model.show(self.session, &self.listener, &self.options, &shown).map(drop)
    }
}

/// What nobody has said is as the command shows a file: lit and exposed so that all of it can be seen, in frames.
fn suit_pages(scene: &mut Scene) {
    scene.begin_live();
    if scene.given.exposure.is_none() {
        scene.render.exposure = Exposure::Auto;
    }
    if scene.given.light.is_none() {
        scene.render.light = LightRig::Auto;
    }
}

/// A session to be shown; where memory is short and the picture follows the page, at half of the sides, and again.
fn open_session(
    model: &Model,
    scene: &mut Scene,
    follows_page: bool,
    interrupt: &Interrupt,
) -> Result<trex_model::Session> {
    let stop = StopSignal::new(interrupt, None);
    loop {
        let options = SessionOptions::shown(scene.render.resolution);
        match model.session_until(scene, &options, &stop) {
            Err(error) if error.code() == Code::MemoryLimit && follows_page => {
                let halved = scene.render.resolution.map(|side| side / 2);
                if halved.iter().any(|&side| side < SIDE_LEAST) {
                    return Err(error);
                }
                scene.render.resolution = halved;
            }
            opened => return opened.and_then(|session| interrupt.check().map(|()| session)),
        }
    }
}

fn check_resolution([width, height]: [u32; 2]) -> Result<()> {
    if width <= SIDE_MAX && height <= SIDE_MAX {
        return Ok(());
    }
    Err(Error::new(Code::Usage, "this picture is too large to be shown")
        .at_place("resolution")
        .numbers(format!("{width}x{height}, at most {SIDE_MAX} on a side"))
        .next("give a smaller one, or render it"))
}

fn listen(place: &ViewerPlace) -> Result<TcpListener> {
    TcpListener::bind((place.bind, place.port)).map_err(|error| refused(place, &error))
}

fn refused(place: &ViewerPlace, error: &std::io::Error) -> Error {
    Error::new(Code::Io, "cannot listen for the browser")
        .at_place(SocketAddr::new(place.bind, place.port).to_string())
        .numbers(error.to_string())
        .next("give another port (0 takes any that is free) or another bind")
}

/// The call that makes a picture, for the page to copy.
fn words(path: &str, recipe: &Recipe<'_>) -> String {
    // A text of JSON is one of Python.
    let path = serde_json::Value::from(path);
    let Recipe::Opened { camera, keys } = recipe else {
        return format!(
            "trex.open({path}).render(camera=, lights=, materials=)  # as the saved scene has them"
        );
    };
    let Camera { position, target, up, fov } = camera;
    let (angle, degrees) = match fov {
        Fov::X(degrees) => ("fov_x", degrees),
        Fov::Y(degrees) => ("fov_y", degrees),
    };
    let camera = format!("dict(position={position:?}, target={target:?}, up={up:?}, {angle}={degrees})");
    let values = keys.values();
    let settings = values.iter().map(|(key, value)| format!(", {}={}", key.name, literal(*value)));
    format!("trex.open({path}).render(camera={camera}{})", settings.collect::<String>())
}

/// A value as Python writes it.
fn literal(value: KeyValue) -> String {
    match value {
        KeyValue::Count(count) => count.to_string(),
        KeyValue::Number(number) => number.to_string(),
        KeyValue::Pair([width, height]) => format!("({width}, {height})"),
        KeyValue::Choice(name) => format!("{name:?}"),
        KeyValue::Flag(flag) => if flag { "True" } else { "False" }.to_owned(),
    }
}
