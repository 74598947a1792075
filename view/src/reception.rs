//! The reception of a connection: its head is read in time and answered; a request to become a socket is granted to a
//! page of ours.
//!
//! ```text
//! head in time -> host ours? 421 -> path known? 404 -> the file
//!                                -> /socket: origin ours? 403, room? 503 -> Grant
//! ```
//!
//! Invariants: 1. a connection has one answer; 2. a page has its place among the others as long as its [`Grant`] lives.

use crate::connections::CLIENTS_MAX;
use crate::guard::{Embedders, Hosts, Token};
use crate::http::{self, DeadlineStream, HEAD_TIME_MAX, Head, Status};
use crate::page;
use rustix::net::sockopt;
use std::io::{self, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use trex_store::{Code, Error, Result};

/// The place of errors.
pub(crate) const SERVER: &str = "the server of the viewer";
/// Longest time in which a page takes nothing of what is written to it.
pub(crate) const WRITE_TIME_MAX: Duration = Duration::from_secs(10);
/// Where sockets are asked for.
const SOCKET_PATH: &str = "/socket";
/// A page whose machine has gone without a word is asked after so long, so often, and so many times: it has lost its
/// place after a minute. Whoever has been sent something and does not confirm it, after as long.
const KEEP_ALIVE_IDLE: Duration = Duration::from_secs(30);
const KEEP_ALIVE_EVERY: Duration = Duration::from_secs(10);
const KEEP_ALIVE_TIMES: u32 = 3;
const UNCONFIRMED_MS_MAX: u32 = 60_000;

/// Who is let in.
#[derive(Debug)]
pub(crate) struct Admission {
    pub(crate) token: Token,
    hosts: Hosts,
    embedders: Embedders,
}

impl Admission {
    /// Those who say `token` at `listener`, by names of this machine, the address that it listens on, or `hosts`.
    ///
    /// # Errors
    /// The socket has no address.
    pub(crate) fn new(
        listener: &TcpListener,
        token: Token,
        hosts: &[String],
        embedders: Embedders,
    ) -> Result<Admission> {
        let address = listener.local_addr().map_err(|error| {
            Error::new(Code::Io, "the socket has no address")
                .at_place(SERVER)
                .numbers(error.to_string())
                .next("try again; listen on another port if it stays")
        })?;
        Ok(Admission { token, hosts: Hosts::new(address.ip(), hosts), embedders })
    }

    /// The key of a request to become a socket, and its place among the pages; else why not.
    fn grant<'a, 'b>(
        &self,
        head: &'b Head,
        places: &'a AtomicUsize,
    ) -> std::result::Result<(&'b str, Place<'a>), Status> {
        if head.origin.as_ref().is_some_and(|origin| !self.hosts.has_origin(origin, &head.host)) {
            return Err(Status::Forbidden);
        }
        let key = head.socket_key.as_deref().ok_or(Status::UpgradeRequired)?;
        let place = Place::take(places, CLIENTS_MAX).ok_or(Status::Full)?;
        Ok((key, place))
    }
}

/// A number that counts what is there now, and no more than so many.
struct Place<'a>(&'a AtomicUsize);

impl Place<'_> {
    fn take(count: &AtomicUsize, most: usize) -> Option<Place<'_>> {
        let more = |now| (now < most).then_some(now + 1);
        count.fetch_update(Ordering::Relaxed, Ordering::Relaxed, more).ok().map(|_| Place(count))
    }
}

impl Drop for Place<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::Relaxed);
    }
}

/// A request to become a socket, which has been told that it is one.
pub(crate) struct Grant<'a> {
    pub(crate) incoming: DeadlineStream,
    /// What came after the head.
    pub(crate) rest: Vec<u8>,
    _place: Place<'a>,
}

/// Answers the request that comes by `stream`; it is given where it became a socket.
pub(crate) fn receive<'a>(
    stream: Arc<TcpStream>,
    admission: &Admission,
    places: &'a AtomicUsize,
) -> Option<Grant<'a>> {
    prepare(&stream).ok()?;
    let mut incoming = DeadlineStream { stream, deadline: Some(Instant::now() + HEAD_TIME_MAX) };
    let answer = match &http::read_head(&mut incoming)? {
        Err(status) => http::refusal(*status),
        Ok((head, _)) if !admission.hosts.has(&head.host) => http::refusal(Status::MisdirectedRequest),
        Ok((head, rest)) if head.path == SOCKET_PATH => match admission.grant(head, places) {
            Err(status) => http::refusal(status),
            Ok((key, place)) => {
                let rest = rest.clone();
                (&*incoming.stream).write_all(&http::upgrade(key)).ok()?;
                return Some(Grant { incoming, rest, _place: place });
            }
        },
        Ok((head, _)) => match page::find(&head.path) {
            Some(file) => {
                let body = (file.media_type, &*file.bytes);
                http::answer(Status::Ok, body, head.is_bodiless, &admission.embedders)
            }
            None => http::refusal(Status::NotFound),
        },
    };
    // Who has gone needs no answer.
    let _ = (&*incoming.stream).write_all(&answer);
    None
}

/// Has the system send at once, give up writes, and find out whether the peer is still there: nothing is sent to a page
/// of a settled picture, so nothing else would.
fn prepare(stream: &TcpStream) -> io::Result<()> {
    stream.set_nodelay(true)?;
    stream.set_write_timeout(Some(WRITE_TIME_MAX))?;
    sockopt::set_socket_keepalive(stream, true)?;
    sockopt::set_tcp_keepidle(stream, KEEP_ALIVE_IDLE)?;
    sockopt::set_tcp_keepintvl(stream, KEEP_ALIVE_EVERY)?;
    sockopt::set_tcp_keepcnt(stream, KEEP_ALIVE_TIMES)?;
    #[cfg(target_os = "linux")]
    sockopt::set_tcp_user_timeout(stream, UNCONFIRMED_MS_MAX)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The kernel's own numbers, in its units, by the names of tcp(7).
    #[test]
    fn connections_are_asked_whether_they_are_still_there() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let _page = TcpStream::connect(listener.local_addr().unwrap()).unwrap();
        let (stream, _) = listener.accept().unwrap();
        assert!(!sockopt::socket_keepalive(&stream).unwrap());
        prepare(&stream).unwrap();
        assert!(sockopt::socket_keepalive(&stream).unwrap() && stream.nodelay().unwrap());
        let times = [sockopt::tcp_keepidle(&stream).unwrap(), sockopt::tcp_keepintvl(&stream).unwrap()];
        assert_eq!(times.map(|time| time.as_secs()), [30, 10]);
        assert_eq!(sockopt::tcp_keepcnt(&stream).unwrap(), 3);
    }
}
