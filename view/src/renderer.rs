//! What the viewer asks of a live session beyond its frames, in one place.

use crate::picture::Shown;
use std::cell::Cell;
use trex_render::{Event, Hit, LiveSession, PagedTracer, RenderSettings};
use trex_store::{Code, Error, Result};

/// What `session` shows.
pub(crate) fn with_shown<T: PagedTracer + Send, R>(
    session: &LiveSession<T>,
    then: impl FnOnce(&Shown<'_>) -> R,
) -> R {
    let count = Cell::new(0);
    let stamp = |_: u32| {
        count.set(count.get() + 1);
        count.get() ^ std::time::UNIX_EPOCH.elapsed().map_or(0, |time| time.as_nanos() as u64) << 16
    };
    let show = |[x, y]: [u32; 2], radiances: &mut [[f32; 3]]| {
        for (pixel, radiance) in (x..).zip(radiances) {
            *radiance = session.shown([pixel, y]);
        }
    };
    then(&Shown { stamp: &stamp, show: &show })
}

/// Other numbers of the picture.
pub(crate) fn set_settings<T: PagedTracer + Send>(
    _session: &mut LiveSession<T>,
    _settings: RenderSettings,
) -> Result<()> {
    let _ = Event::Lights(vec![]);
    Err(Error::new(Code::Usage, "the renderer cannot change its settings yet")
        .at_place("render")
        .next("start the viewer with other flags"))
}

/// What is at a pixel, and where.
pub(crate) fn pick<T: PagedTracer + Send>(
    _session: &mut LiveSession<T>,
    _pixel: [u32; 2],
) -> Option<(Hit, [f64; 3])> {
    None
}
