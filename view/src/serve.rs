//! `serve`: a live session, shown until it is told to stop.

use crate::reception::SERVER;
use crate::server;
use crate::session_loop::SessionLoop;
use crate::shared::SharedState;
use crate::surroundings::{ServeOptions, ServeReport, Surroundings};
use std::net::TcpListener;
use std::sync::atomic::Ordering;
use std::thread;
use trex_render::{LiveSession, PagedTracer};
use trex_store::{Error, Result};

/// Ends the server when it goes.
struct EndOnDrop<'a> {
    shared: &'a SharedState,
    listener: &'a TcpListener,
}

impl Drop for EndOnDrop<'_> {
    fn drop(&mut self) {
        server::end(self.shared, self.listener);
    }
}

/// Shows `session` to the pages that connect to `listener`, until `around.stop` says so; then it ends within a second,
/// whatever pages do, and `listener` listens no more. The session is worked on by the calling thread and its pool.
///
/// # Errors
/// The address cannot be asked for or the system refuses a thread; [`trex_store::Code::MemoryLimit`] when the
/// budget has no room for [`crate::view_bytes`]; the session cannot go on.
pub fn serve<T: PagedTracer + Send>(
    session: LiveSession<T>,
    listener: &TcpListener,
    options: &ServeOptions,
    around: &Surroundings<'_>,
) -> Result<ServeReport> {
    let admission = options.admission(listener)?;
    let resolution = session.view().settings.resolution;
    let shared = SharedState::new(admission, options.silence_max, resolution, around.budget)?;
    let shared = &shared;
    let session_loop = SessionLoop::new(session, shared, options, around);
    let served = thread::scope(|scope| {
        let accept = thread::Builder::new().name("view-accept".into());
        let accepting = accept.spawn_scoped(scope, move || server::accept(scope, listener, shared));
        if let Err(error) = accepting {
            return Err(Error::thread_refused(SERVER, &error));
        }
        // Also when the session panics: who waits for a connection would wait for ever.
        let _end = EndOnDrop { shared, listener };
        session_loop.run()
    })?;
    Ok(ServeReport {
        clients: shared.admitted(),
        frames_drawn: shared.gone_frames.load(Ordering::Relaxed),
        sent_bytes: shared.gone_bytes.load(Ordering::Relaxed),
        ..served
    })
}
