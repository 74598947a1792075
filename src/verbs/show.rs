//! `Show`: a session that makes pictures, at leisure or in frames with a deadline.

use serde::Serialize;
use std::ops::ControlFlow;
use std::time::Instant;
use trex_model::Times;
use trex_render::{
    Event, Film, FrameOptions, FrameProgress, Image, LiveSession, PagedTracer, RenderStats, Session,
};
use trex_store::Result;

/// A session that makes pictures.
#[expect(clippy::large_enum_variant, reason = "there is one")]
pub enum Show<T> {
    AtLeisure(Session<T>),
    InFrames(InFrames<T>),
}

/// A session in frames, since when, and how long they took.
pub struct InFrames<T> {
    session: LiveSession<T>,
    begin: Instant,
    frames: Frames,
}

/// Frames with a deadline: their times.
#[derive(Debug, Default, Serialize)]
pub struct Frames {
    /// From the start to the first whole fetch block.
    pub response_ms: Times,
    pub frame_ms: Times,
    pub block_tiles: u32,
}

impl<T: PagedTracer + Send> Show<T> {
    /// A show of `session`; in frames where their options are given.
    pub fn new(session: Session<T>, live: Option<FrameOptions>) -> Result<Show<T>> {
        let begin = Instant::now();
        Ok(match live {
            None => Show::AtLeisure(session),
            Some(options) => {
                let session = session.go_live(options)?;
                Show::InFrames(InFrames { session, begin, frames: Frames::default() })
            }
        })
    }

    /// What is on show.
    pub fn session(&self) -> &Session<T> {
        match self {
            Show::AtLeisure(session) => session,
            Show::InFrames(live) => &live.session,
        }
    }

    /// The times of frames, where there are any.
    pub fn frames(self) -> Option<Frames> {
        match self {
            Show::AtLeisure(_) => None,
            Show::InFrames(live) => Some(live.frames),
        }
    }

    pub fn apply(&mut self, event: Event) -> Result<()> {
        match self {
            Show::AtLeisure(session) => session.apply(event),
            Show::InFrames(live) => live.session.apply(event),
        }
    }

    /// Smooths the picture, until `stop`.
    pub fn smooth(&mut self, stop: &(dyn Fn() -> bool + Sync)) -> Result<()> {
        match self {
            Show::AtLeisure(session) => session.smooth_until(stop),
            Show::InFrames(live) => {
                live.session.smooth_shown(0, stop);
                Ok(())
            }
        }
    }

    /// A picture of `spp` samples a pixel, or less when `stop` says so. `tell` hears how many samples every pixel has.
    pub fn render(
        &mut self,
        spp: u32,
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u32),
    ) -> RenderStats {
        match self {
            Show::AtLeisure(session) => session.render(spp, stop, &mut |_, stats| {
                tell(stats.spp);
                ControlFlow::Continue(())
            }),
            Show::InFrames(live) => live.render(spp, stop, tell),
        }
    }
}

impl<T: PagedTracer + Send> Image for Show<T> {
    fn film(&self) -> &Film {
        self.session().film()
    }

    fn radiance(&self, pixel: [u32; 2]) -> [f32; 3] {
        match self {
            Show::AtLeisure(session) => session.film().radiance(pixel),
            Show::InFrames(live) => live.session.shown(pixel),
        }
    }
}

impl<T: PagedTracer + Send> InFrames<T> {
    /// Frames until every pixel has `spp` samples, or `stop`.
    fn render(
        &mut self,
        spp: u32,
        stop: &(dyn Fn() -> bool + Sync),
        tell: &mut dyn FnMut(u32),
    ) -> RenderStats {
        let InFrames { session, begin: start, frames } = self;
        let mut stats = RenderStats::default();
        while !stats.complete && !stop() {
            let begin = Instant::now();
            let report = session.frame(spp, stop);
            frames.frame_ms.add(begin.elapsed());
            if report.progress >= FrameProgress::Block && frames.response_ms.count() == 0 {
                frames.response_ms.add(start.elapsed());
                frames.block_tiles = report.block_tiles;
            }
            stats.total.add(&report.pass);
            stats.spp = session.film().samples();
            stats.complete = report.progress == FrameProgress::Done;
            tell(stats.spp);
        }
        stats
    }
}
