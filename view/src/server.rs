//! The server: takes connections, each on a thread of its own, until it is told to end.
//!
//! ```text
//! accept -> head in time -> host ours? 421 -> path known? 404 -> the file
//!                                          -> /socket: origin ours? 403, room? 503 -> socket.rs
//! ```
//!
//! Invariants: 1. connections and clients are bounded: who comes beyond is sent away at once; 2. a connection answers
//! one request; 3. the server ends within [`GOODBYE`] and what an encoder takes for its present bytes, whatever its
//! connections do: none is added from then on, and each that is left is shut down; its threads end with it.

use crate::connections::Connection;
use crate::http::{self, DeadlineStream, HEAD_TIME_MAX, Head, Status};
use crate::outbox::close;
use crate::page;
use crate::shared::{CLIENTS_MAX, SharedState};
use crate::socket::{self, WRITE_TIME_MAX};
use rustix::net::{Shutdown, shutdown, sockopt};
use std::io::{self, Write};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread::{self, Scope};
use std::time::{Duration, Instant};

/// Where sockets are asked for.
const SOCKET_PATH: &str = "/socket";
/// How long to wait when the system has no descriptor for another connection.
const ACCEPT_AGAIN: Duration = Duration::from_millis(50);
/// Time for clients to hear that the server ends.
const GOODBYE: Duration = Duration::from_millis(200);
/// A page whose machine has gone without a word is asked after so long, so often, and so many times: it has lost its
/// place after a minute. Whoever has been sent something and does not confirm it, after as long.
const KEEP_ALIVE_IDLE: Duration = Duration::from_secs(30);
const KEEP_ALIVE_EVERY: Duration = Duration::from_secs(10);
const KEEP_ALIVE_TIMES: u32 = 3;
const UNCONFIRMED_MS_MAX: u32 = 60_000;
/// Stack of a connection's thread.
const STACK_BYTES: usize = 512 << 10;

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

/// Takes connections until [`end`] is called.
pub(crate) fn accept<'scope>(
    scope: &'scope Scope<'scope, '_>,
    listener: &TcpListener,
    shared: &'scope SharedState,
) {
    for stream in listener.incoming() {
        if shared.connections.are_refused() {
            return;
        }
        let Ok(stream) = stream else {
            thread::sleep(ACCEPT_AGAIN);
            continue;
        };
        let Some(connection) = shared.connections.add(stream) else { continue };
        let thread = thread::Builder::new().name("view-read".into()).stack_size(STACK_BYTES);
        // Where the system has no thread left the connection closes.
        let _ = thread.spawn_scoped(scope, move || serve(shared, &connection));
    }
}

/// Ends the server that listens at `listener`, and all connections.
pub(crate) fn end(shared: &SharedState, listener: &TcpListener) {
    shared.connections.refuse();
    let clients = shared.clients();
    clients.iter().for_each(|client| client.close(close::GOING_AWAY));
    let begin = Instant::now();
    while !shared.clients().is_empty() && begin.elapsed() < GOODBYE {
        thread::sleep(GOODBYE / 20);
    }
    shared.clients().iter().for_each(|client| client.hang_up());
    shared.connections.shut_down();
    // Ends the wait for a connection; systems that do not end it so give it one.
    let ended = shutdown(listener, Shutdown::Both);
    if let Ok(address) = listener.local_addr() {
        let ip = match address.ip() {
            IpAddr::V4(ip) if ip.is_unspecified() => Ipv4Addr::LOCALHOST.into(),
            IpAddr::V6(ip) if ip.is_unspecified() => Ipv6Addr::LOCALHOST.into(),
            ip => ip,
        };
        let is_needed = ended.is_err() || cfg!(not(target_os = "linux"));
        let connect = || TcpStream::connect_timeout(&SocketAddr::new(ip, address.port()), GOODBYE);
        let _ = is_needed.then(connect);
    }
}

/// Answers a connection.
fn serve(shared: &SharedState, connection: &Connection<'_>) {
    let stream = connection.stream.clone();
    if prepare(&stream).is_err() {
        return;
    }
    let mut incoming = DeadlineStream { stream, deadline: Some(Instant::now() + HEAD_TIME_MAX) };
    let Some(read) = http::read_head(&mut incoming) else { return };
    let answer = match &read {
        Err(status) => http::refusal(*status),
        Ok((head, _)) if !shared.hosts.has(&head.host) => http::refusal(Status::MisdirectedRequest),
        Ok((head, rest)) if head.path == SOCKET_PATH => match grant(shared, head) {
            Err(status) => http::refusal(status),
            Ok((key, _place)) => {
                if (&*incoming.stream).write_all(&http::upgrade(key)).is_ok() {
                    socket::serve(shared, incoming, rest.clone());
                }
                return;
            }
        },
        Ok((head, _)) => match page::find(&head.path) {
            Some(file) => {
                let body = (file.media_type, &*file.bytes);
                http::answer(Status::Ok, body, head.is_bodiless, &shared.embedders)
            }
            None => http::refusal(Status::NotFound),
        },
    };
    // Who has gone needs no answer.
    let _ = (&*incoming.stream).write_all(&answer);
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

/// The key of a request to become a socket, and its place among the clients; else why not.
fn grant<'a>(shared: &'a SharedState, head: &'a Head) -> Result<(&'a str, Place<'a>), Status> {
    if head.origin.as_ref().is_some_and(|origin| !shared.hosts.has_origin(origin, &head.host)) {
        return Err(Status::Forbidden);
    }
    let key = head.socket_key.as_deref().ok_or(Status::UpgradeRequired)?;
    let place = Place::take(&shared.places, CLIENTS_MAX).ok_or(Status::Full)?;
    Ok((key, place))
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
