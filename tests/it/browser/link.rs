//! A slow line between page and server: so many ms each way, so many bits a second towards the page.
//!
//! ```text
//! reader -> (when it is due, bytes) -> writer
//! ```
//! It stands before the whole server, so the page comes through it, too. An instrument: its threads end with their
//! connections, the one that listens with the process.

use std::io::{Read, Write};
use std::net::{Shutdown, TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::{Duration, Instant};

/// What is read at once; at 2.5 Mbit/s it takes 13 ms.
const PIECE_BYTES: usize = 4096;
/// Pieces under way in one direction.
const PIECES_MAX: usize = 64;
/// What leaves the server no earlier than this before the line has room for it.
const AHEAD: Duration = Duration::from_millis(20);

/// How slow the line is.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Line {
    /// Each way.
    pub(crate) delay: Duration,
    /// Towards the page.
    pub(crate) bytes_per_s: f64,
}

/// Listens on a port of its own for connections to `server` over a line; gives the port.
pub(crate) fn slow_port(server: u16, line: Line) -> u16 {
    let listener = TcpListener::bind(("127.0.0.1", 0)).unwrap();
    let port = listener.local_addr().unwrap().port();
    thread::spawn(move || {
        for page in listener.incoming().flatten() {
            let Ok(server) = TcpStream::connect(("127.0.0.1", server)) else { continue };
            for stream in [&page, &server] {
                let _ = stream.set_nodelay(true);
            }
            let up = Line { bytes_per_s: f64::INFINITY, ..line };
            carry(page.try_clone().unwrap(), server.try_clone().unwrap(), up);
            carry(server, page, line);
        }
    });
    port
}

/// Carries what comes from one end to the other.
fn carry(from: TcpStream, to: TcpStream, line: Line) {
    let (pieces, due) = sync_channel(PIECES_MAX);
    thread::spawn(move || read(from, &pieces, line));
    thread::spawn(move || write(to, &due));
}

fn read(mut from: TcpStream, pieces: &SyncSender<(Instant, Vec<u8>)>, line: Line) {
    let mut buffer = [0; PIECE_BYTES];
    let mut free = Instant::now();
    while let Ok(bytes @ 1..) = from.read(&mut buffer) {
        let now = Instant::now();
        free = free.max(now) + Duration::from_secs_f64(bytes as f64 / line.bytes_per_s);
        if pieces.send((free + line.delay, buffer[..bytes].to_vec())).is_err() {
            break;
        }
        thread::sleep(free.saturating_duration_since(now + AHEAD));
    }
}

fn write(mut to: TcpStream, pieces: &Receiver<(Instant, Vec<u8>)>) {
    while let Ok((due, bytes)) = pieces.recv() {
        thread::sleep(due.saturating_duration_since(Instant::now()));
        if to.write_all(&bytes).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Both);
}
