//! HTTP as far as a page needs it: a head is read and checked, and answered once; then the connection is closed, or is
//! a socket from there on.
//!
//! Invariants: 1. a head is bounded in bytes, headers and time; 2. what is asked for is looked up, never put together
//! into a name; 3. each answer carries the headers that keep the page to itself.

use crate::guard::Embedders;
use std::io::{self, Read, Write};
use std::net::TcpStream;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Longest head.
pub(crate) const HEAD_BYTES_MAX: usize = 8 << 10;
/// Longest time from the connection to the end of its head.
pub(crate) const HEAD_TIME_MAX: Duration = Duration::from_secs(5);
/// Most headers of a head.
const HEADERS_MAX: usize = 64;

/// What every answer carries: nothing from elsewhere, nothing kept. Who may have it in a frame comes before them.
const HEADERS: &str = "X-Content-Type-Options: nosniff\r\n\
                       Referrer-Policy: no-referrer\r\n\
                       Cache-Control: no-store\r\n\
                       Cross-Origin-Opener-Policy: same-origin\r\n\
                       Connection: close\r\n";

/// A request, as far as it matters.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Head {
    /// `HEAD`: the answer has no body.
    pub(crate) is_bodiless: bool,
    /// What is asked for, without its query.
    pub(crate) path: String,
    pub(crate) host: String,
    pub(crate) origin: Option<String>,
    /// The key of a request to become a socket.
    pub(crate) socket_key: Option<String>,
}

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Status {
    Ok,
    BadRequest,
    Forbidden,
    NotFound,
    MethodNotAllowed,
    MisdirectedRequest,
    UpgradeRequired,
    HeadTooLarge,
    Full,
}

impl Status {
    fn line(self) -> &'static str {
        match self {
            Status::Ok => "200 OK",
            Status::BadRequest => "400 Bad Request",
            Status::Forbidden => "403 Forbidden",
            Status::NotFound => "404 Not Found",
            Status::MethodNotAllowed => "405 Method Not Allowed",
            Status::MisdirectedRequest => "421 Misdirected Request",
            Status::UpgradeRequired => "426 Upgrade Required",
            Status::HeadTooLarge => "431 Request Header Fields Too Large",
            Status::Full => "503 Service Unavailable",
        }
    }
}

/// A stream that is read up to a time, if there is one, and not written to.
#[derive(Debug)]
pub(crate) struct DeadlineStream {
    pub(crate) stream: Arc<TcpStream>,
    pub(crate) deadline: Option<Instant>,
}

impl Read for DeadlineStream {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        loop {
            if let Some(deadline) = self.deadline {
                let left = deadline.saturating_duration_since(Instant::now());
                if left.is_zero() {
                    return Err(io::ErrorKind::TimedOut.into());
                }
                self.stream.set_read_timeout(Some(left))?;
            }
            match (&*self.stream).read(bytes) {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                read => return read,
            }
        }
    }
}

/// What reads answers to pings by itself; they are sent by who writes, or frames would be torn.
impl Write for DeadlineStream {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Reads a head, and what came after it. `None` when the connection gave none in time.
pub(crate) fn read_head(incoming: &mut impl Read) -> Option<Result<(Head, Vec<u8>), Status>> {
    let mut bytes = Vec::with_capacity(HEAD_BYTES_MAX);
    let mut part = [0; 1024];
    loop {
        let count = match incoming.read(&mut part) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
            read => read.ok().filter(|&count| count > 0)?,
        };
        bytes.extend_from_slice(&part[..count]);
        match parse_head(&bytes) {
            Ok(Some((head, end))) => return Some(Ok((head, bytes.split_off(end)))),
            Ok(None) if bytes.len() >= HEAD_BYTES_MAX => return Some(Err(Status::HeadTooLarge)),
            Ok(None) => {}
            Err(status) => return Some(Err(status)),
        }
    }
}

/// The head that `bytes` begin with, and its length; `None` while more is to come.
pub(crate) fn parse_head(bytes: &[u8]) -> Result<Option<(Head, usize)>, Status> {
    let mut headers = [httparse::EMPTY_HEADER; HEADERS_MAX];
    let mut request = httparse::Request::new(&mut headers);
    let end = match request.parse(&bytes[..bytes.len().min(HEAD_BYTES_MAX)]) {
        Ok(httparse::Status::Complete(end)) => end,
        Ok(httparse::Status::Partial) => return Ok(None),
        Err(httparse::Error::TooManyHeaders) => return Err(Status::HeadTooLarge),
        Err(_) => return Err(Status::BadRequest),
    };
    let is_bodiless = match request.method {
        Some("GET") => false,
        Some("HEAD") => true,
        _ => return Err(Status::MethodNotAllowed),
    };
    let path = request.path.unwrap_or_default();
    let path = path.split(['?', '#']).next().unwrap_or_default().to_owned();
    let mut head = Head { is_bodiless, path, ..Head::default() };
    let (mut hosts, mut asks_socket) = (0, false);
    for header in request.headers.iter() {
        let value = || std::str::from_utf8(header.value).map(str::to_owned).map_err(|_| Status::BadRequest);
        if header.name.eq_ignore_ascii_case("host") {
            (head.host, hosts) = (value()?, hosts + 1);
        } else if header.name.eq_ignore_ascii_case("origin") {
            // Of two, one may be a guest's.
            if head.origin.replace(value()?).is_some() {
                return Err(Status::BadRequest);
            }
        } else if header.name.eq_ignore_ascii_case("upgrade") {
            asks_socket |= value()?.eq_ignore_ascii_case("websocket");
        } else if header.name.eq_ignore_ascii_case("sec-websocket-key") {
            head.socket_key = Some(value()?);
        }
    }
    if !asks_socket {
        head.socket_key = None;
    }
    if hosts == 1 { Ok(Some((head, end))) } else { Err(Status::BadRequest) }
}

/// An answer with a body.
pub(crate) fn answer(
    status: Status,
    (media_type, body): (&str, &[u8]),
    is_bodiless: bool,
    embedders: &Embedders,
) -> Vec<u8> {
    let mut bytes = format!(
        "HTTP/1.1 {}\r\nContent-Type: {media_type}\r\nContent-Length: {}\r\n\
         Content-Security-Policy: default-src 'self'; img-src 'self' blob: data:; style-src 'self'; \
         frame-ancestors {}; base-uri 'none'; form-action 'none'\r\n{HEADERS}\r\n",
        status.line(),
        body.len(),
        embedders.sources()
    )
    .into_bytes();
    if !is_bodiless {
        bytes.extend_from_slice(body);
    }
    bytes
}

/// An answer that says no.
pub(crate) fn refusal(status: Status) -> Vec<u8> {
    let body = format!("{}\n", status.line());
    answer(status, ("text/plain; charset=utf-8", body.as_bytes()), false, &Embedders::default())
}

/// The answer that makes a socket of the connection.
pub(crate) fn upgrade(key: &str) -> Vec<u8> {
    let accept = tungstenite::handshake::derive_accept_key(key.as_bytes());
    format!(
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Accept: {accept}\r\n\r\n"
    )
    .into_bytes()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_pcg::Pcg64Mcg;
    use rand_pcg::rand_core::{Rng, SeedableRng};

    fn head(text: &str) -> Result<Option<(Head, usize)>, Status> {
        parse_head(text.as_bytes())
    }

    #[test]
    fn a_request_is_read_whatever_its_pieces() {
        let text =
            "GET /app.js?v=1 HTTP/1.1\r\nhOST: localhost:8000\r\nOrigin: http://localhost:8000\r\n\r\nrest";
        for end in 0..text.len() - 4 {
            assert_eq!(head(&text[..end]), Ok(None), "{end}");
        }
        let (found, end) = head(text).unwrap().unwrap();
        assert_eq!((found.path.as_str(), found.host.as_str()), ("/app.js", "localhost:8000"));
        assert_eq!(
            (found.origin.as_deref(), found.socket_key, found.is_bodiless),
            (Some("http://localhost:8000"), None, false)
        );
        assert_eq!(&text[end..], "rest");
        let (found, after) = read_head(&mut text.as_bytes()).unwrap().unwrap();
        assert_eq!((found.path.as_str(), after.as_slice()), ("/app.js", &b"rest"[..]));
    }

    #[test]
    fn sockets_are_asked_for_by_their_header() {
        let text = "GET /socket HTTP/1.1\r\nHost: x\r\nUpgrade: WebSocket\r\nSec-WebSocket-Key: abc\r\n\r\n";
        assert_eq!(head(text).unwrap().unwrap().0.socket_key.as_deref(), Some("abc"));
        let text = "GET /socket HTTP/1.1\r\nHost: x\r\nSec-WebSocket-Key: abc\r\n\r\n";
        assert_eq!(head(text).unwrap().unwrap().0.socket_key, None);
    }

    #[test]
    fn what_is_wrong_is_refused() {
        for (text, status) in [
            ("POST / HTTP/1.1\r\nHost: x\r\n\r\n", Status::MethodNotAllowed),
            ("GET / HTTP/1.1\r\n\r\n", Status::BadRequest),
            ("GET / HTTP/1.1\r\nHost: x\r\nHost: y\r\n\r\n", Status::BadRequest),
            ("GET / HTTP/1.1\r\nHost: x\r\nOrigin: a\r\nOrigin: b\r\n\r\n", Status::BadRequest),
            ("GET / HTTP/1.1\r\nHost: x\r\nbroken\r\n\r\n", Status::BadRequest),
            ("\u{16}\u{3}\u{1}", Status::BadRequest),
        ] {
            assert_eq!(head(text), Err(status), "{text:?}");
        }
        let many = format!("GET / HTTP/1.1\r\nHost: x\r\n{}\r\n", "a: b\r\n".repeat(HEADERS_MAX));
        assert_eq!(head(&many), Err(Status::HeadTooLarge));
        let long = format!("GET /{} HTTP/1.1\r\n", "a".repeat(HEAD_BYTES_MAX));
        assert_eq!(read_head(&mut long.as_bytes()), Some(Err(Status::HeadTooLarge)));
        assert_eq!(read_head(&mut &b"GET / HT"[..]), None);
    }

    #[test]
    fn bytes_of_any_kind_are_survived() {
        let mut random = Pcg64Mcg::seed_from_u64(7);
        let good = b"GET /socket HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nSec-WebSocket-Key: abc\r\n\r\n";
        for _ in 0..20_000 {
            let mut bytes = good.to_vec();
            for _ in 0..random.next_u32() % 8 {
                let at = random.next_u32() as usize % bytes.len();
                bytes[at] = random.next_u32() as u8;
            }
            bytes.truncate(random.next_u32() as usize % (bytes.len() + 1));
            if let Ok(Some((head, end))) = parse_head(&bytes) {
                assert!(end <= bytes.len() && head.path.len() < bytes.len());
            }
        }
    }

    #[test]
    fn answers_keep_the_page_to_itself() {
        let page = |is_bodiless, embedders: &Embedders| {
            String::from_utf8(answer(Status::Ok, ("text/html", b"hello"), is_bodiless, embedders)).unwrap()
        };
        let text = page(false, &Embedders::default());
        for part in [
            "200 OK",
            "frame-ancestors 'none'; ",
            "default-src 'self'",
            "nosniff",
            "no-referrer",
            "no-store",
            "same-origin",
        ] {
            assert!(text.contains(part), "{part}");
        }
        assert!(text.ends_with("\r\n\r\nhello") && text.contains("Content-Length: 5\r\n"));
        assert!(page(true, &Embedders::default()).ends_with("\r\n\r\n"));
        let notebooks = ["'self'".to_owned(), "http://localhost:*".to_owned()];
        let text = page(false, &Embedders::new(&notebooks).unwrap());
        assert!(text.contains("frame-ancestors 'self' http://localhost:*; base-uri"), "{text}");
    }
}
