//! `WaitingRoom`: pages that come before there is a session, or between two, are told how far the work on it is.
//!
//! ```text
//! accept -> reception -> the page's files
//!                     -> socket, hello with the token -> how far it is, again and again -> goodbye: it comes again
//! ```
//!
//! Invariants: 1. it is as bounded as the server proper, and what its connections take is leased; 2. the listener goes
//! on to listen: who comes after the end waits there for the server; 3. it ends with the work, within a second.

use crate::connections::{CONNECTIONS_MAX, Connections};
use crate::message::text_of;
use crate::outbox::close;
use crate::reception::{self, Admission, SERVER};
use crate::shared::CONNECTION_BYTES;
use crate::socket;
use crate::surroundings::ServeOptions;
use serde::Serialize;
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::AtomicUsize;
use std::sync::{Arc, Condvar, Mutex};
use std::thread::{self, Scope};
use std::time::{Duration, Instant};
use trex_store::{Budget, Error, Lease, Result};

/// Time between two looks for a connection.
const ACCEPT_EVERY: Duration = Duration::from_millis(50);
/// Time between two looks at how far it is.
const TELL_EVERY: Duration = Duration::from_millis(250);
/// What has not changed is told again after so long: a page that has gone is found by that.
const TELL_AGAIN: Duration = Duration::from_secs(2);
/// Stack of a thread.
const STACK_BYTES: usize = 512 << 10;

/// How far it is.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(tag = "type", rename = "waiting")]
pub struct WaitingText {
    /// What is being done, for people.
    pub text: String,
    /// Share of that which is done, 0 to 1; `None` where that is not known.
    pub share: Option<f32>,
}

/// See the module's description.
pub struct WaitingRoom<'a> {
    listener: &'a TcpListener,
    admission: Admission,
    places: AtomicUsize,
    connections: Connections,
    has_ended: Mutex<bool>,
    ended: Condvar,
    _lease: Lease,
}

impl<'a> WaitingRoom<'a> {
    /// A room for pages that come to `listener`, let in as `options` say.
    ///
    /// # Errors
    /// The listener has no address; [`trex_store::Code::MemoryLimit`] when the budget has no room for connections.
    pub fn new(
        listener: &'a TcpListener,
        options: &ServeOptions,
        budget: &Budget,
    ) -> Result<WaitingRoom<'a>> {
        Ok(WaitingRoom {
            listener,
            admission: options.admission(listener)?,
            places: AtomicUsize::new(0),
            connections: Connections::default(),
            has_ended: Mutex::new(false),
            ended: Condvar::new(),
            _lease: budget.lease("pages that wait", (CONNECTIONS_MAX * CONNECTION_BYTES) as u64)?,
        })
    }

    /// Does `work` on the calling thread; `tell` says how far it is meanwhile.
    ///
    /// # Errors
    /// The system refuses a thread, or a listener that does not wait; nothing has been done then.
    pub fn during<R>(&self, tell: &(dyn Fn() -> WaitingText + Sync), work: impl FnOnce() -> R) -> Result<R> {
        let refused = |error| Error::thread_refused(SERVER, &error);
        self.listener.set_nonblocking(true).map_err(refused)?;
        let done = thread::scope(|scope| {
            let accept = thread::Builder::new().name("wait-accept".into());
            accept.spawn_scoped(scope, move || self.accept(scope, tell)).map_err(refused)?;
            // Also when the work panics: who waits for its end would wait for ever.
            let _end = RoomEnd(self);
            Ok(work())
        });
        // Nobody looks for connections any more: the server waits for them. Where that cannot be, it tells.
        let _ = self.listener.set_nonblocking(false);
        done
    }

    fn accept<'scope>(
        &'scope self,
        scope: &'scope Scope<'scope, '_>,
        tell: &'scope (dyn Fn() -> WaitingText + Sync),
    ) {
        loop {
            match self.listener.accept() {
                Ok((stream, _)) => {
                    // Some systems give it the listener's way.
                    let waits = stream.set_nonblocking(false).is_ok();
                    let Some(connection) = waits.then(|| self.connections.add(stream)).flatten() else {
                        continue;
                    };
                    let thread = thread::Builder::new().name("wait-tell".into()).stack_size(STACK_BYTES);
                    // Where the system has no thread left the connection closes.
                    let _ = thread.spawn_scoped(scope, move || self.receive(&connection.stream, tell));
                }
                Err(_) if self.ends_within(ACCEPT_EVERY) => return,
                Err(_) => {}
            }
        }
    }

    fn receive(&self, stream: &Arc<TcpStream>, tell: &dyn Fn() -> WaitingText) {
        let Some(granted) = reception::receive(stream.clone(), &self.admission, &self.places) else { return };
        let Some((_socket, _)) = socket::open(&self.admission.token, granted.incoming, granted.rest) else {
            return;
        };
        let (mut told, mut told_at) = (None, Instant::now());
        loop {
            let now = tell();
            if told.as_ref() != Some(&now) || told_at.elapsed() >= TELL_AGAIN {
                if socket::send_text(stream, &text_of(&now)).is_err() {
                    return;
                }
                (told, told_at) = (Some(now), Instant::now());
            }
            if self.ends_within(TELL_EVERY) {
                return socket::say_goodbye(stream, close::GOING_AWAY);
            }
        }
    }

    /// Waits for the end, at most so long; true when it has come.
    fn ends_within(&self, time: Duration) -> bool {
        let has_ended = self.has_ended.lock().expect("a thread of the waiting room panicked");
        let waited = self.ended.wait_timeout_while(has_ended, time, |has_ended| !*has_ended);
        *waited.expect("a thread of the waiting room panicked").0
    }

    fn end(&self) {
        self.connections.refuse();
        if let Ok(mut has_ended) = self.has_ended.lock() {
            *has_ended = true;
        }
        self.ended.notify_all();
        // Time to say goodbye; heads that are still being read are not waited for.
        let begin = Instant::now();
        while !self.connections.is_empty() && begin.elapsed() < TELL_EVERY {
            thread::sleep(TELL_EVERY / 20);
        }
        self.connections.shut_down();
    }
}

/// Ends the room when it goes.
struct RoomEnd<'a>(&'a WaitingRoom<'a>);

impl Drop for RoomEnd<'_> {
    fn drop(&mut self) {
        self.0.end();
    }
}
