//! `Connections`: those that are open, so that the end of the server ends each of them, whatever it waits for.
//!
//! Invariants: 1. there are never more than [`CONNECTIONS_MAX`]; 2. once they are refused none is added; 3. a
//! connection leaves the list with its owner.

use std::net::{Shutdown, TcpStream};
use std::sync::{Arc, Mutex, MutexGuard};

/// Most pages that are connected.
pub(crate) const CLIENTS_MAX: usize = 8;
/// Most connections of any kind.
pub(crate) const CONNECTIONS_MAX: usize = 32;

/// See the module's description.
#[derive(Debug, Default)]
pub(crate) struct Connections {
    inner: Mutex<OpenConnections>,
}

#[derive(Debug, Default)]
struct OpenConnections {
    open: Vec<(u64, Arc<TcpStream>)>,
    /// Number of the last one.
    last: u64,
    is_closing: bool,
}

/// One of them.
#[derive(Debug)]
pub(crate) struct Connection<'a> {
    connections: &'a Connections,
    number: u64,
    pub(crate) stream: Arc<TcpStream>,
}

impl Connections {
    fn lock(&self) -> MutexGuard<'_, OpenConnections> {
        self.inner.lock().expect("a thread of the viewer panicked")
    }

    /// Adds a connection; `None` when there are too many, or the server ends.
    pub(crate) fn add(&self, stream: TcpStream) -> Option<Connection<'_>> {
        let mut inner = self.lock();
        if inner.is_closing || inner.open.len() >= CONNECTIONS_MAX {
            return None;
        }
        inner.last += 1;
        let (number, stream) = (inner.last, Arc::new(stream));
        inner.open.push((number, stream.clone()));
        Some(Connection { connections: self, number, stream })
    }

    /// Adds none from now on.
    pub(crate) fn refuse(&self) {
        self.lock().is_closing = true;
    }

    /// True once none is added.
    pub(crate) fn are_refused(&self) -> bool {
        self.lock().is_closing
    }

    /// True when none is open.
    pub(crate) fn is_empty(&self) -> bool {
        self.lock().open.is_empty()
    }

    /// Shuts all of them down: reads and writes that wait end at once.
    pub(crate) fn shut_down(&self) {
        // One that has ended by itself is as good.
        self.lock().open.iter().for_each(|(_, stream)| drop(stream.shutdown(Shutdown::Both)));
    }
}

impl Drop for Connection<'_> {
    fn drop(&mut self) {
        self.connections.lock().open.retain(|(number, _)| *number != self.number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;
    use std::net::TcpListener;

    #[test]
    fn they_are_bounded_and_end_together() {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let connections = Connections::default();
        let connect = || connections.add(TcpStream::connect(address).unwrap());
        let mut open: Vec<_> = (0..CONNECTIONS_MAX).map(|_| connect().unwrap()).collect();
        assert!(connect().is_none());
        open.pop();
        open.push(connect().unwrap());
        connections.refuse();
        open.pop();
        assert!(connect().is_none() && connections.are_refused());
        // A read that would wait for ever.
        std::thread::scope(|scope| {
            let reads = scope.spawn(|| (&*open[0].stream).read(&mut [0]));
            connections.shut_down();
            assert_eq!(reads.join().unwrap().unwrap(), 0);
        });
    }
}
