//! What the viewer gets from the command: all that it would have to know of files, processes and flags for.

use crate::guard::{Embedders, Token};
use crate::reception::Admission;
use crate::reports::{DeviceFigures, MemoryFigures, ModelFigures, PoolFigures};
use crate::shared::view_bytes;
use serde::Serialize;
use std::net::TcpListener;
use std::time::Duration;
use trex_render::{Camera, CameraKeys, FrameOptions, PartNeeds, RenderKeys, RenderSettings};
use trex_store::DamageList;
use trex_store::{Budget, Material, Result};

/// The surroundings of a session on show.
pub struct Surroundings<'a> {
    /// Name of the model, for the page's title.
    pub name: &'a str,
    /// Words the command line that makes a picture, for the page to copy.
    pub command_line: &'a dyn Fn(&Recipe<'_>) -> String,
    /// Path of the model, for scene files.
    pub model_path: &'a str,
    /// What is constant of the model.
    pub model: ModelFigures,
    /// Materials of the model as the file has them, before the edits of a scene.
    pub file_materials: &'a [Material],
    /// Cameras that the page offers.
    pub views: Vec<Camera>,
    /// What the scene says of the camera: where that is nothing the model is framed, in a page of any shape.
    pub camera: CameraKeys,
    /// The ledger.
    pub budget: &'a Budget,
    /// Memory now.
    pub memory: &'a dyn Fn() -> MemoryFigures,
    /// The pool of pages now.
    pub pool: &'a dyn Fn() -> PoolFigures,
    /// Name of the device that answers rays through the voxels.
    pub device_name: &'a str,
    /// That device now; `None` where it is the processor.
    pub device: &'a dyn Fn() -> Option<DeviceFigures>,
    /// Damaged pages that were met; asked for when their count has changed.
    pub damage: &'a dyn Fn() -> DamageList,
    /// Most bytes of the light of before that are planned beside each of these, under a limit or the present one.
    pub kept_light: &'a KeptLightBytes<'a>,
    /// Sets the memory for frames of pages, bytes.
    pub set_limit: &'a dyn Fn(u64) -> Result<()>,
    /// Has a picture put in the place of the one on show: frames that it needs go before, those that it leaves come
    /// after. What memory is for is planned once.
    pub exchange: &'a Exchange<'a>,
    /// Sets the memory for frames of pages to what each of these leaves: one takes the place of the other.
    pub make_room: &'a dyn Fn(&[Room]) -> Result<()>,
    /// True once the viewer is to end.
    pub stop: &'a (dyn Fn() -> bool + Sync),
}

/// What makes the picture on show.
#[derive(Clone, Copy, Debug)]
pub enum Recipe<'a> {
    /// The file that was opened, seen so.
    Opened {
        /// The camera.
        camera: &'a Camera,
        /// All numbers of the picture.
        keys: &'a RenderKeys,
    },
    /// The scene file that the page offers, once it is saved: lights, materials or parts are not those of the file.
    Saved,
}

/// See [`Surroundings::kept_light`].
pub type KeptLightBytes<'a> = dyn Fn(&[Room], Option<u64>) -> Result<u64> + 'a;

/// See [`Surroundings::exchange`].
pub type Exchange<'a> = dyn Fn(Room, &mut dyn FnMut() -> Result<()>) -> Result<()> + 'a;

/// What memory is wanted for.
#[derive(Clone, Copy, Debug)]
pub struct Room {
    /// The picture in the making.
    pub settings: RenderSettings,
    /// Bytes beside its session: what the viewer shows, and files in the making.
    pub copies_bytes: u64,
    /// What is left out of the model.
    pub parts: PartNeeds,
}

impl Room {
    /// For a picture of these parts on show, while files of so many bytes are made or wait to be sent.
    pub fn of(settings: RenderSettings, parts: PartNeeds, file_bytes: u64) -> Room {
        Room { settings, copies_bytes: view_bytes(settings.resolution) + file_bytes, parts }
    }
}

/// A page may be silent for so long, unless it is to be otherwise: a minute, as a machine that has gone without a word.
pub const SILENCE_MAX: Duration = Duration::from_secs(60);

/// How a session is served.
#[derive(Clone, Debug)]
pub struct ServeOptions {
    /// What pages have to say.
    pub token: Token,
    /// Host names by which the server may be asked, beside those of this machine and the address it listens on.
    pub hosts: Vec<String>,
    /// How the session makes its frames.
    pub frames: FrameOptions,
    /// True when the picture takes the size of the driver's page.
    pub follows_page: bool,
    /// Who may have the page in a frame.
    pub embedders: Embedders,
    /// A page that something was sent to, and that gives no sign of life for so long (it neither acknowledges nor
    /// answers a ping), loses its place.
    pub silence_max: Duration,
}

impl ServeOptions {
    /// Who is let in at `listener`.
    ///
    /// # Errors
    /// The socket has no address.
    pub(crate) fn admission(&self, listener: &TcpListener) -> Result<Admission> {
        Admission::new(listener, self.token.clone(), &self.hosts, self.embedders.clone())
    }
}

/// What was served.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ServeReport {
    /// Pages that were connected.
    pub clients: u64,
    /// Events that were applied.
    pub events: u64,
    /// Frames of the session.
    pub frames: u64,
    /// Frames that pages have drawn.
    pub frames_drawn: u64,
    /// Bytes that went to pages.
    pub sent_bytes: u64,
    /// Screenshots that were made.
    pub screenshots: u64,
    /// What was on show at the end, as a scene file; `None` before.
    #[serde(skip)]
    pub scene: Option<String>,
    /// Its lights and materials are those of what was opened.
    #[serde(skip)]
    pub is_as_opened: bool,
    /// Its sections or hidden materials were changed since it was opened.
    #[serde(skip)]
    pub are_parts_edited: bool,
}
