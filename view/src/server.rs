//! The server: takes connections, each on a thread of its own, until it is told to end.
//!
//! Invariants: 1. connections and clients are bounded: who comes beyond is sent away at once; 2. a connection answers
//! one request; 3. the server ends within [`GOODBYE`] and what an encoder takes for its present bytes, whatever its
//! connections do: none is added from then on, and each that is left is shut down; its threads end with it.

use crate::connections::Connection;
use crate::outbox::close;
use crate::reception::{self, Grant};
use crate::shared::SharedState;
use crate::socket;
use rustix::net::{Shutdown, shutdown};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, TcpListener, TcpStream};
use std::thread::{self, Scope};
use std::time::{Duration, Instant};

/// How long to wait when the system has no descriptor for another connection.
const ACCEPT_AGAIN: Duration = Duration::from_millis(50);
/// Time for clients to hear that the server ends.
const GOODBYE: Duration = Duration::from_millis(200);
/// Stack of a connection's thread.
const STACK_BYTES: usize = 512 << 10;

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
    let received = reception::receive(connection.stream.clone(), &shared.admission, &shared.places);
    if let Some(Grant { incoming, rest, .. }) = received {
        socket::serve(shared, incoming, rest);
    }
}
