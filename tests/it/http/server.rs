//! A server of one file, which answers ranges as RFC 9110 says, or as badly as a test wants.

use std::io::{BufRead, BufReader, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

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

/// A server, until it is dropped.
pub(crate) struct Server {
    /// Address of the file.
    pub(crate) url: String,
    state: Arc<ServerState>,
    thread: Option<JoinHandle<()>>,
}

struct ServerState {
    bytes: Vec<u8>,
    /// The manners towards a request for bytes from this place on.
    manners: Box<dyn Fn(usize) -> Manners + Send + Sync>,
    requests: AtomicUsize,
    sent: AtomicUsize,
    stop: AtomicBool,
    threads: Mutex<Vec<JoinHandle<()>>>,
}

impl Server {
    /// Serves the file at `path`; `manners` says what becomes of a request for bytes from a place on.
    pub(crate) fn of(path: &Path, manners: impl Fn(usize) -> Manners + Send + Sync + 'static) -> Server {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let url = format!("http://{}/model.trex", listener.local_addr().unwrap());
        let state = Arc::new(ServerState {
            bytes: std::fs::read(path).unwrap(),
            manners: Box::new(manners),
            requests: AtomicUsize::new(0),
            sent: AtomicUsize::new(0),
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
                    let _ = state.serve(&stream.unwrap());
                };
                shared.threads.lock().unwrap().push(std::thread::spawn(serve));
            }
        };
        Server { url, state, thread: Some(std::thread::spawn(accept)) }
    }

    /// Requests that came.
    pub(crate) fn requests(&self) -> usize {
        self.state.requests.load(Ordering::SeqCst)
    }

    /// Bytes of bodies that were sent.
    pub(crate) fn sent_bytes(&self) -> usize {
        self.state.sent.load(Ordering::SeqCst)
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.state.stop.store(true, Ordering::SeqCst);
        let address = self.url.split('/').nth(2).unwrap();
        let _ = TcpStream::connect(address);
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
    fn serve(&self, stream: &TcpStream) -> std::io::Result<()> {
        let mut lines = BufReader::new(stream);
        while let Some(request) = read_request(&mut lines)? {
            self.requests.fetch_add(1, Ordering::SeqCst);
            let manners = (self.manners)(self.range(request.range.as_deref().unwrap()).0);
            if !self.answer(&request, manners, stream)? {
                break;
            }
        }
        Ok(())
    }

    /// Answers; false where the connection ends with it.
    fn answer(&self, request: &Request, manners: Manners, mut stream: &TcpStream) -> std::io::Result<bool> {
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
        let length = self.bytes.len();
        if manners == Manners::Whole {
            let head = format!("HTTP/1.1 200 OK\r\nContent-Length: {length}\r\n\r\n");
            stream.write_all(head.as_bytes())?;
            return stream.write_all(&self.bytes).map(|()| false);
        }
        let (first, last) = self.range(request.range.as_deref().unwrap());
        let (first, last) = match manners {
            Manners::OtherRange if last + 1 < length => (first + 1, last + 1),
            Manners::OtherRange => (first - 1, last - 1),
            _ => (first, last),
        };
        let mut body = self.bytes[first..=last].to_vec();
        match manners {
            Manners::Long => body.push(0),
            Manners::Damaged => body[(last - first) / 2] ^= 4,
            _ => {}
        }
        let tag = if manners == Manners::Changed { "two" } else { "one" };
        let named = format!("Content-Range: bytes {first}-{last}/{length}\r\n");
        let named = if manners == Manners::NoRange { "" } else { &named };
        let count = body.len();
        let head = format!(
            "HTTP/1.1 206 Partial Content\r\nETag: \"{tag}\"\r\n{named}Content-Length: {count}\r\n\r\n"
        );
        body.truncate(if manners == Manners::Short { count / 2 } else { count });
        self.sent.fetch_add(body.len(), Ordering::SeqCst);
        stream.write_all(head.as_bytes())?;
        stream.write_all(&body)?;
        Ok(manners != Manners::Short)
    }

    /// `bytes=FIRST-LAST`, or `bytes=-COUNT` for the last ones.
    fn range(&self, text: &str) -> (usize, usize) {
        let (first, last) = text.strip_prefix("bytes=").unwrap().split_once('-').unwrap();
        let (length, last) = (self.bytes.len(), last.parse::<usize>().unwrap());
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
