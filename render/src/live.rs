//! Frames with a deadline: what a viewer shows while the user moves. Paper, section 5.2.
//!
//! ```text
//! event -> frame: a preview, one voxel ray a tile                       first picture
//!       -> frame: tiles in order until a fetch block is done            response
//!       -> frame: half the time photons, where light has changed; tiles until a block is done, the picture is complete or t_max
//!                 has passed
//!       -> ...    every pixel has a sample                              complete picture
//! ```
//!
//! The fetch block is what the user asks for, or as many tiles as take half of `t_max` at the speed of late, whichever is
//! less: it shrinks at once, also when `t_max` has passed, and grows by a quarter. The first one counts from the event. On the CPU a tile goes through C-rays and G-rays in one go, so the
//! job queue between them is the worker's own; the block is what is shown together.
//!
//! Where the pages in demand approach the frames there are, the governor raises the error of the footprint rule, until every
//! pixel has a sample; then it lets go, and the picture goes on at the error that was asked for.
//!
//! Invariants: 1. no pixel shows nothing after the first frame; 2. what is not of the state, a preview or a stand-in, is
//! never on the film; 3. once the view stands still, the film goes to the same bytes as
//! [`crate::session::Session::render`]'s.

use crate::camera::Projection;
use crate::film::Film;
use crate::frame::{PagedTracer, Pass, PassStats};
use crate::tile::{TILE_SIDE_PIXELS, Tile, TileOrder, Tiles, tile_count};
use crate::voxel::{Irradiance, PhotonMap, PhotonWork, PhotonWorld};
use std::time::{Duration, Instant};
use trex_store::{Budget, Lease, Result};

/// Fewest tiles of a fetch block: what a picture needs to be seen to change.
pub const BLOCK_TILES_MIN: u32 = 16;
/// A block is made to take this part of `t_max`: the rest is for what varies.
pub(crate) const BLOCK_PART: u32 = 2;
/// Part of `t_max` after which the first block is what there is: a tile and the end of the frame come on top.
pub(crate) const RESPONSE_SHARE: f64 = 0.75;
/// Part of `t_max` that the first block gets at least, whatever the event and the preview took.
pub(crate) const BLOCK_PART_LEAST: u32 = 8;
/// A block grows by this much a frame.
const BLOCK_GROWTH: f64 = 1.25;
/// Share of the frames in demand above which the governor raises the error, and below which it lowers it and pages are
/// guessed ahead.
pub(crate) const DEMAND: std::ops::Range<f64> = 0.70..0.85;
/// Step of the governor.
const ERROR_GROWTH: f64 = 1.25;
/// Responses ahead that the camera is guessed.
const RESPONSES_AHEAD: f64 = 2.0;
/// Greatest error the governor goes to, pixels; where none was asked for it begins at 1.
const ERROR_MAX_PIXELS: f64 = 16.0;

/// How frames with a deadline are made.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameOptions {
    /// Longest time of a frame.
    pub t_max: Duration,
    /// Most tiles of a fetch block, at least [`BLOCK_TILES_MIN`].
    pub fetch_block: u32,
    /// The order of tiles.
    pub order: TileOrder,
    /// Whether pages are guessed ahead.
    pub prefetch: Prefetch,
}

/// Whether pages are guessed ahead.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Prefetch {
    /// Only what rays ask for is read.
    Off,
    /// The predictors of [`crate::frame::Predictor`] ask, too.
    #[default]
    On,
}

impl Default for FrameOptions {
    fn default() -> FrameOptions {
        FrameOptions {
            t_max: Duration::from_millis(100),
            fetch_block: 512,
            order: TileOrder::default(),
            prefetch: Prefetch::default(),
        }
    }
}

/// What the picture has come to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Progress {
    /// Voxels at one ray a tile.
    Preview,
    /// Some tiles are done, less than a fetch block.
    Part,
    /// At least a fetch block is done: the response.
    Block,
    /// Every pixel has a sample.
    Complete,
    /// All samples that were asked for.
    Done,
}

/// What a frame did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FrameReport {
    /// What the picture shows now.
    pub progress: Progress,
    /// Tiles of the first fetch block since the event; until it is done, of the block that is made.
    pub block_tiles: u32,
    /// Tiles that show a stand-in for pages on their way.
    pub stand_in_tiles: u32,
    /// Tiles that show nothing of this state nor of the last.
    pub hole_tiles: u32,
    /// Error of the footprint rule in force, pixels.
    pub error_pixels: f64,
    /// What the pass did in this frame.
    pub pass: PassStats,
    /// Rays of photons.
    pub photon_rays: u64,
}

/// What a tile shows while it has no samples.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shows {
    Nothing,
    /// What one voxel ray saw, linear RGB.
    Preview([f32; 3]),
    /// The picture of the last state.
    Before,
    StandIn,
}

/// The picture where the film has none.
#[derive(Debug)]
pub struct Shown {
    resolution: [u32; 2],
    radiance: Vec<[f32; 3]>,
    tiles: Vec<Shows>,
    _lease: Lease,
}

impl Shown {
    /// Bytes that it takes at `resolution` (width, height; pixels).
    pub fn bytes(resolution: [u32; 2]) -> u64 {
        let pixels = u64::from(resolution[0]) * u64::from(resolution[1]);
        pixels * size_of::<[f32; 3]>() as u64 + u64::from(tile_count(resolution)) * size_of::<Shows>() as u64
    }

    pub(crate) fn new(resolution: [u32; 2], budget: &Budget) -> Result<Shown> {
        let lease = budget.lease("the picture on show", Shown::bytes(resolution))?;
        let pixels = resolution[0] as usize * resolution[1] as usize;
        let tiles = vec![Shows::Nothing; tile_count(resolution) as usize];
        Ok(Shown { resolution, radiance: vec![[0.0; 3]; pixels], tiles, _lease: lease })
    }

    /// What the pixel (x, y) of tile `tile` shows.
    pub(crate) fn radiance(&self, pixel: [u32; 2], tile: u32) -> [f32; 3] {
        match self.tiles[tile as usize] {
            Shows::Preview(radiance) => radiance,
            _ => self.radiance[self.place(pixel)],
        }
    }

    pub(crate) fn set(&mut self, pixel: [u32; 2], radiance: [f32; 3]) {
        let at = self.place(pixel);
        self.radiance[at] = radiance;
    }

    /// One colour for all of a tile.
    pub(crate) fn set_preview(&mut self, tile: &Tile, radiance: [f32; 3]) {
        self.tiles[tile.index as usize] = Shows::Preview(radiance);
    }

    pub(crate) fn has_stand_in(&self, tile: &Tile) -> bool {
        self.tiles[tile.index as usize] == Shows::StandIn
    }

    pub(crate) fn mark_stand_in(&mut self, tile: &Tile) {
        self.tiles[tile.index as usize] = Shows::StandIn;
    }

    /// Takes over what `film` shows, before it is cleared; it counts as a picture of the last state.
    pub(crate) fn keep(&mut self, film: &Film, tiles: &Tiles) {
        for index in 0..tiles.count() {
            if film.tile_samples(index) > 0 {
                let tile = tiles.tile(index);
                for pixel in (0..tile.pixel_count()).map(|pixel| tile.pixel(pixel)) {
                    self.set(pixel, film.radiance(pixel));
                }
                self.tiles[index as usize] = Shows::Before;
            }
        }
    }

    /// Tiles without samples on `film`: those that show a stand-in, and those that show nothing.
    pub(crate) fn count(&self, film: &Film) -> [u32; 2] {
        let mut counts = [0; 2];
        for (index, shows) in self.tiles.iter().enumerate() {
            if film.tile_samples(index as u32) == 0 {
                counts[0] += u32::from(*shows == Shows::StandIn);
                counts[1] += u32::from(*shows == Shows::Nothing);
            }
        }
        counts
    }

    fn place(&self, [x, y]: [u32; 2]) -> usize {
        y as usize * self.resolution[0] as usize + x as usize
    }
}

/// The size of the fetch block: of the first block after an event, and of those that follow. They differ, since an order
/// by saliency begins with what is hard.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Block {
    most: u32,
    tiles: [f64; 2],
}

/// Which block.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Nth {
    First,
    Later,
}

impl Block {
    pub(crate) fn new(most: u32) -> Block {
        let most = most.max(BLOCK_TILES_MIN);
        Block { most, tiles: [f64::from(most); 2] }
    }

    pub(crate) fn tiles(&self, nth: Nth) -> u32 {
        (self.tiles[nth as usize] as u32).clamp(BLOCK_TILES_MIN, self.most)
    }

    /// After `finished` tiles took `time`, which should be `allowed`: shrinks at once, grows slowly.
    pub(crate) fn learn(&mut self, nth: Nth, finished: u64, time: Duration, allowed: Duration) {
        let tiles = &mut self.tiles[nth as usize];
        let fit = finished as f64 * allowed.as_secs_f64() / time.as_secs_f64().max(1e-9);
        *tiles = fit.min(*tiles * BLOCK_GROWTH).clamp(f64::from(BLOCK_TILES_MIN), f64::from(self.most));
    }
}

/// Raises the error of the footprint rule where pages are too many for the frames.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Governor {
    asked: f64,
    error: f64,
    /// The state had its complete picture: no more raising.
    has_let_go: bool,
}

impl Governor {
    pub(crate) fn new(asked: f64) -> Governor {
        Governor { asked, error: asked, has_let_go: false }
    }

    /// The error in force, pixels.
    pub(crate) fn error(&self) -> f64 {
        self.error
    }

    /// Within a state: true when the error was raised. `demand`: pages in demand over frames.
    pub(crate) fn raise(&mut self, demand: f64) -> bool {
        let raised = if self.error == 0.0 { 1.0 } else { self.error * ERROR_GROWTH };
        let raises = demand > DEMAND.end && raised <= ERROR_MAX_PIXELS && !self.has_let_go;
        if raises {
            self.error = raised;
        }
        raises
    }

    /// The picture is complete: true when it was at a raised error.
    pub(crate) fn let_go(&mut self) -> bool {
        let was_raised = self.error > self.asked;
        (self.error, self.has_let_go) = (self.asked, true);
        was_raised
    }

    /// Between states.
    pub(crate) fn lower(&mut self, demand: f64) {
        self.has_let_go = false;
        if demand < DEMAND.start && self.error > self.asked {
            let lowered = self.error / ERROR_GROWTH;
            self.error = if lowered <= self.asked.max(1.0 / ERROR_GROWTH) { self.asked } else { lowered };
        }
    }
}

/// The light that comes after a change, in a map of its own: blended in while it grows, then swapped.
#[derive(Debug)]
pub(crate) struct NextLight {
    map: PhotonMap,
    work: PhotonWork,
    /// Share of its photons that are there; `None` when nothing comes.
    share: Option<f32>,
}

impl NextLight {
    /// The second buffer of `shown`; on its way at once where that is dark. `None` when nothing gives light.
    ///
    /// # Errors
    /// [`trex_store::Code::MemoryLimit`].
    pub(crate) fn new(
        world: &PhotonWorld<'_>,
        shown: &PhotonMap,
        budget: &Budget,
    ) -> Result<Option<NextLight>> {
        let Some(work) = world.begin()? else { return Ok(None) };
        let map = PhotonMap::new(shown.irradiance().len(), budget)?;
        let share = (shown.photons() == 0).then_some(0.0);
        Ok(Some(NextLight { map, work, share }))
    }

    /// Light has changed: what was on its way is out of date.
    pub(crate) fn begin(&mut self, world: &PhotonWorld<'_>) {
        self.map.clear();
        world.restart(&mut self.work);
        self.share = Some(0.0);
    }

    /// Nothing is on its way.
    pub(crate) fn is_idle(&self) -> bool {
        self.share.is_none()
    }

    /// Sends photons until `stop` says so, and swaps the maps when the `target` is reached. Gives the count of rays, and
    /// whether the light that gather rays find has changed.
    pub(crate) fn go_on(
        &mut self,
        world: &PhotonWorld<'_>,
        (shown, target): (&mut PhotonMap, u64),
        stop: &(dyn Fn() -> bool + Sync),
    ) -> (u64, bool) {
        if self.is_idle() {
            return (0, false);
        }
        let before = self.map.photons();
        let stats = world.trace((&mut self.work, &mut self.map), target, stop, &mut |_| {});
        self.share = Some((self.map.photons() as f64 / target as f64) as f32);
        // Without any light there is nothing to wait for.
        let is_done = self.map.photons() >= target || !world.is_lit();
        if is_done {
            std::mem::swap(&mut self.map, shown);
            self.share = None;
        }
        (stats.rays, is_done || self.map.photons() > before)
    }

    /// What gather rays find.
    pub(crate) fn irradiance<'a>(&'a self, shown: &'a PhotonMap) -> Irradiance<'a> {
        // The first light of all has nothing to be blended with.
        let is_first = shown.photons() == 0 && self.map.photons() > 0;
        let share = self.share.map(|share| if is_first { 1.0 } else { share });
        Irradiance::new(shown, share.map(|share| (&self.map, share)))
    }
}

/// What a session keeps between frames.
pub(crate) struct Live {
    pub(crate) options: FrameOptions,
    pub(crate) shown: Shown,
    pub(crate) next: Option<NextLight>,
    pub(crate) pass: Option<Pass>,
    pub(crate) block: Block,
    pub(crate) governor: Governor,
    /// Tiles done since the event.
    pub(crate) finished: u64,
    /// Tiles of the first block since the event, once it is done.
    pub(crate) first_block: Option<u32>,
    /// A preview is due.
    pub(crate) is_new: bool,
    motion: Motion,
    /// Pages in demand since the event, a bit each.
    demand: Vec<u64>,
    /// What [`Live::demand`] came to in the last state.
    pub(crate) last_demand: f64,
}

/// How the camera moves.
struct Motion {
    /// The last event.
    at: Instant,
    /// From the last event to its response.
    response: Option<Duration>,
    /// The cameras before and after the last event, and the time between the last two.
    step: Option<([Projection; 2], Duration)>,
}

impl Live {
    pub(crate) fn new(
        (options, error_pixels): (FrameOptions, f64),
        resolution: [u32; 2],
        next: Option<NextLight>,
        budget: &Budget,
    ) -> Result<Live> {
        Ok(Live {
            options,
            shown: Shown::new(resolution, budget)?,
            next,
            pass: None,
            block: Block::new(options.fetch_block),
            governor: Governor::new(error_pixels),
            finished: 0,
            first_block: None,
            is_new: true,
            motion: Motion { at: Instant::now(), response: None, step: None },
            demand: Vec::new(),
            last_demand: 0.0,
        })
    }

    /// Pages in demand since the event, over the frames there are; 0 where there are no pages.
    pub(crate) fn demand<T: PagedTracer>(&mut self, tracers: &[T]) -> f64 {
        self.demand.fill(0);
        let frames = tracers.iter().map(|tracer| tracer.demand(&mut self.demand)).max().unwrap_or(0);
        let pages: u32 = self.demand.iter().map(|bits| bits.count_ones()).sum();
        if frames == 0 { 0.0 } else { f64::from(pages) / frames as f64 }
    }

    /// An event has come.
    pub(crate) fn learn_event(&mut self, before: &Projection, after: &Projection) {
        let now = Instant::now();
        self.motion.step = Some(([*before, *after], now - self.motion.at));
        (self.motion.at, self.motion.response) = (now, None);
    }

    /// The picture holds a fetch block of so many tiles.
    pub(crate) fn learn_response(&mut self, tiles: u32) {
        self.first_block.get_or_insert(tiles);
        self.motion.response.get_or_insert(self.motion.at.elapsed());
    }

    /// Time since the last event.
    pub(crate) fn since_event(&self) -> Duration {
        self.motion.at.elapsed()
    }

    /// The camera two responses after the last event, should it go on as it went; `None` where it stands or jumps.
    pub(crate) fn guessed_camera(&self) -> Option<Projection> {
        let ([before, after], time) = self.motion.step?;
        let response = self.motion.response.unwrap_or(self.options.t_max);
        let steps = RESPONSES_AHEAD * response.as_secs_f64() / time.as_secs_f64().max(1e-9);
        before.is_near(&after).then(|| before.towards(&after, 1.0 + steps.min(RESPONSES_AHEAD)))
    }
}

impl std::fmt::Debug for Live {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Live").field("options", &self.options).finish_non_exhaustive()
    }
}

/// What gather rays find: the session's map `shown`, and what comes after it.
pub(crate) fn irradiance<'a>(shown: Option<&'a PhotonMap>, next: Option<&'a NextLight>) -> Irradiance<'a> {
    match (shown, next) {
        (None, _) => Irradiance::NONE,
        (Some(shown), None) => Irradiance::new(shown, None),
        (Some(shown), Some(next)) => next.irradiance(shown),
    }
}

/// Where the ray of a tile's preview goes.
pub(crate) fn middle(tile: &Tile) -> [u32; 2] {
    std::array::from_fn(|a| tile.first[a] + tile.size[a].min(TILE_SIDE_PIXELS) / 2)
}
