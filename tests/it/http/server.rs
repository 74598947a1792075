//! A server of one file, which answers ranges as RFC 9110 says, or as badly as a test wants, after as long as it takes
//! over a wire of some length. `bench/examples/serve.rs` is the same by itself.

use std::fs::File;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::os::unix::fs::FileExt;
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{JoinHandle, sleep};
use std::time::{Duration, Instant};

/// What a server does to a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Manners {
    /// What was asked.
    Good,
    /// Status 503.
    Unavailable,
    /// It closes the connection, and says nothing.
    Closed,
    /// Half of the bytes that it announces, then the end.
    Short,
    /// More bytes than the range has, as it announces.
    Long,
    /// No length, and bytes for as long as somebody takes them.
    Endless,
    /// Half of the bytes that it announces, then nothing, with the connection open.
    Stalled,
    /// The range next to the one that was asked.
    OtherRange,
    /// No `Content-Range`.
    NoRange,
    /// Status 200 and the whole file.
    Whole,
    /// Status 404.
    Nothing,
    /// Status 403.
    Forbidden,
    /// The version after the one before: another ETag, and 412 for who asks for the old one.
    Changed,
    /// Status 302, to the same file under another name.
    Elsewhere,
    /// One bit of each answer is another one.
    Damaged,
}

/// The wire to a server.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Wire {
    /// From a request to its answer, and to open a connection.
    pub(crate) round_trip: Duration,
    /// Of all connections together; 0: as fast as it goes.
    pub(crate) bytes_per_second: u64,
}

/// A connection as a server has it.
pub(crate) trait Connection: Read + Write {}
impl<T: Read + Write> Connection for T {}

/// Makes a connection of one that came.
pub(crate) type Wrap = Box<dyn Fn(TcpStream) -> Box<dyn Connection> + Send + Sync>;

/// A server, until it is dropped.
pub(crate) struct Server {
    /// Address of the file.
    pub(crate) url: String,
    /// Host and port.
    pub(crate) host: String,
    state: Arc<ServerState>,
    thread: Option<JoinHandle<()>>,
}

struct ServerState {
    file: File,
    length: usize,
    /// The manners towards a request for bytes from this place on.
    manners: Box<dyn Fn(usize) -> Manners + Send + Sync>,
    wrap: Wrap,
    wire: Wire,
    /// When the wire is free again.
    busy_until: Mutex<Instant>,
    requests: AtomicUsize,
    sent: AtomicUsize,
    /// What the last request asked for, with its query.
    asked: Mutex<String>,
    stop: AtomicBool,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

impl Server {
    /// Serves the file at `path`; `manners` says what becomes of a request for bytes from a place on.
    pub(crate) fn of(path: &Path, manners: impl Fn(usize) -> Manners + Send + Sync + 'static) -> Server {
        Server::over(path, manners, Wire::default(), Box::new(|stream| Box::new(stream)))
    }

    /// The same, over `wire`, with what `wrap` makes of connections.
    pub(crate) fn over(
        path: &Path,
        manners: impl Fn(usize) -> Manners + Send + Sync + 'static,
        wire: Wire,
        wrap: Wrap,
    ) -> Server {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let host = listener.local_addr().unwrap().to_string();
        let url = format!("http://{host}/model.trex");
        let file = File::open(path).unwrap();
        let state = Arc::new(ServerState {
            length: file.metadata().unwrap().len() as usize,
            file,
            manners: Box::new(manners),
            wrap,
            wire,
            busy_until: Mutex::new(Instant::now()),
            requests: AtomicUsize::new(0),
            sent: AtomicUsize::new(0),
            asked: Mutex::default(),
            stop: AtomicBool::new(false),
            threads: Mutex::default(),
        });
        let shared = Arc::clone(&state);
        let accept = move || {
            for stream in listener.incoming() {
                if shared.stop.load(Ordering::SeqCst) {
                    return;
                }
                let state = Arc::clone(&shared);
                let serve = move || {
                    // A client that goes is no failure.
                    let _ = state.serve(stream.unwrap());
                };
                shared.threads.lock().unwrap().push(std::thread::spawn(serve));
            }
        };
        Server { url, host, state, thread: Some(std::thread::spawn(accept)) }
    }

    /// Requests that came.
    pub(crate) fn requests(&self) -> usize {
        self.state.requests.load(Ordering::SeqCst)
    }

    /// Bytes of bodies that were sent.
    pub(crate) fn sent_bytes(&self) -> usize {
        self.state.sent.load(Ordering::SeqCst)
    }

    /// Path and query of the last request.
    pub(crate) fn asked(&self) -> String {
        self.state.asked.lock().unwrap().clone()
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.state.stop.store(true, Ordering::SeqCst);
        let _ = TcpStream::connect(&self.host);
        let _ = self.thread.take().unwrap().join();
        for thread in self.state.threads.lock().unwrap().drain(..) {
            let _ = thread.join();
        }
    }
}

/// A request, as far as it matters.
#[derive(Default)]
struct Request {
    path: String,
    range: Option<String>,
    if_match: Option<String>,
}

impl ServerState {
    fn serve(&self, stream: TcpStream) -> std::io::Result<()> {
        sleep(self.wire.round_trip);
        stream.set_nodelay(true)?;
        let mut lines = BufReader::new((self.wrap)(stream));
        while let Some(request) = read_request(&mut lines)? {
            self.requests.fetch_add(1, Ordering::SeqCst);
            self.asked.lock().unwrap().clone_from(&request.path);
            let manners = (self.manners)(self.range(request.range.as_deref().unwrap()).0);
            sleep(self.wire.round_trip);
            let goes_on = self.answer(&request, manners, lines.get_mut().as_mut())?;
            lines.get_mut().flush()?;
            if !goes_on {
                break;
            }
        }
        Ok(())
    }

    /// Answers; false where the connection ends with it.
    fn answer(
        &self,
        request: &Request,
        manners: Manners,
        stream: &mut dyn Connection,
    ) -> std::io::Result<bool> {
        let status = |line: &str, more: &str| format!("HTTP/1.1 {line}\r\n{more}Content-Length: 0\r\n\r\n");
        let refused = match manners {
            Manners::Unavailable => status("503 Service Unavailable", ""),
            Manners::Nothing => status("404 Not Found", ""),
            Manners::Forbidden => status("403 Forbidden", ""),
            Manners::Elsewhere if !request.path.contains("moved") => {
                status("302 Found", "Location: /moved.trex\r\n")
            }
            Manners::Changed if request.if_match.is_some() => status("412 Precondition Failed", ""),
            Manners::Closed => return Ok(false),
            _ => String::new(),
        };
        if !refused.is_empty() {
            return stream.write_all(refused.as_bytes()).map(|()| true);
        }
        let length = self.length;
        if manners == Manners::Whole {
            let head = format!("HTTP/1.1 200 OK\r\nContent-Length: {length}\r\n\r\n");
            stream.write_all(head.as_bytes())?;
            return self.send(stream, &self.bytes(0, length - 1)).map(|()| false);
        }
        let (first, last) = self.range(request.range.as_deref().unwrap());
        let (first, last) = match manners {
            Manners::OtherRange if last + 1 < length => (first + 1, last + 1),
            Manners::OtherRange => (first - 1, last - 1),
            _ => (first, last),
        };
        let mut body = self.bytes(first, last);
        match manners {
            Manners::Long => body.push(0),
            Manners::Damaged => body[(last - first) / 2] ^= 4,
            _ => {}
        }
        let tag = if manners == Manners::Changed { "two" } else { "one" };
        let named = format!("Content-Range: bytes {first}-{last}/{length}\r\n");
        let named = if manners == Manners::NoRange { "" } else { &named };
        let count = body.len();
        let ends = if manners == Manners::Endless {
            "Connection: close\r\n".to_owned()
        } else {
            format!("Content-Length: {count}\r\n")
        };
        let head = format!("HTTP/1.1 206 Partial Content\r\nETag: \"{tag}\"\r\n{named}{ends}\r\n");
        let is_cut = matches!(manners, Manners::Short | Manners::Stalled);
        body.truncate(if is_cut { count / 2 } else { count });
        stream.write_all(head.as_bytes())?;
        self.send(stream, &body)?;
        match manners {
            Manners::Endless => loop {
                stream.write_all(&body)?;
            },
            Manners::Stalled => {
                stream.flush()?;
                // Until the other side goes.
                stream.read(&mut [0]).map(|_| false)
            }
            Manners::Short => Ok(false),
            _ => Ok(true),
        }
    }

    fn bytes(&self, first: usize, last: usize) -> Vec<u8> {
        let mut bytes = vec![0; last + 1 - first];
        self.file.read_exact_at(&mut bytes, first as u64).unwrap();
        bytes
    }

    /// Sends a body as fast as the wire is.
    fn send(&self, stream: &mut dyn Connection, body: &[u8]) -> std::io::Result<()> {
        self.sent.fetch_add(body.len(), Ordering::SeqCst);
        for piece in body.chunks(64 << 10) {
            if self.wire.bytes_per_second > 0 {
                let takes = Duration::from_secs_f64(piece.len() as f64 / self.wire.bytes_per_second as f64);
                let until = {
                    let mut busy = self.busy_until.lock().unwrap();
                    *busy = (*busy).max(Instant::now()) + takes;
                    *busy
                };
                sleep(until.saturating_duration_since(Instant::now()));
            }
            stream.write_all(piece)?;
        }
        Ok(())
    }

    /// `bytes=FIRST-LAST`, or `bytes=-COUNT` for the last ones.
    fn range(&self, text: &str) -> (usize, usize) {
        let (first, last) = text.strip_prefix("bytes=").unwrap().split_once('-').unwrap();
        let (length, last) = (self.length, last.parse::<usize>().unwrap());
        if first.is_empty() {
            return (length.saturating_sub(last), length - 1);
        }
        (first.parse().unwrap(), last.min(length - 1))
    }
}

/// The next request of a connection; `None` at its end.
fn read_request(lines: &mut impl BufRead) -> std::io::Result<Option<Request>> {
    let mut request = Request::default();
    let mut line = String::new();
    while lines.read_line(&mut line)? > 0 {
        let text = line.trim();
        if text.is_empty() {
            return Ok(Some(request));
        }
        if let Some(rest) = text.strip_prefix("GET ") {
            request.path = rest.split(' ').next().unwrap_or_default().to_owned();
        } else if let Some((name, value)) = text.split_once(':') {
            match name.to_ascii_lowercase().as_str() {
                "range" => request.range = Some(value.trim().to_owned()),
                "if-match" => request.if_match = Some(value.trim().to_owned()),
                _ => {}
            }
        }
        line.clear();
    }
    Ok(None)
}
