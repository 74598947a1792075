//! `Client`: requests for ranges of one address, and what answers are worth.
//!
//! Invariants: those of the module above, 1 to 3.

use std::io::{self, ErrorKind, Read};
use std::time::Duration;
use ureq::http::{HeaderMap, Response, StatusCode, header};
use ureq::{Agent, Body};

/// Longest time until there is a connection.
const CONNECT_TIME: Duration = Duration::from_secs(10);
/// Longest time until an answer begins.
const ANSWER_TIME: Duration = Duration::from_secs(15);
/// Longest time until a range is there: 512 KiB at 17 KiB/s.
const BODY_TIME: Duration = Duration::from_secs(30);
/// Most addresses that a server may send a request on to.
const REDIRECTS_MAX: u32 = 4;
/// Bytes of the buffers of a connection.
const BUFFER_BYTES: usize = 16 << 10;
/// Asks for ranges of one address.
pub(super) struct Client {
    agent: Agent,
    url: String,
}

/// Which version of a file all ranges are of.
pub(super) struct Version {
    pub(super) length: u64,
    /// A strong ETag.
    tag: Option<String>,
    /// Date of its last change.
    changed: Option<String>,
}

/// The range of an answer.
struct ContentRange {
    first: u64,
    last: u64,
    length: u64,
}

impl Client {
    /// Keeps up to so many connections.
    pub(super) fn new(url: &str, connections: usize) -> Client {
        let is_tls = url.get(..6).is_some_and(|head| head.eq_ignore_ascii_case("https:"));
        let config = Agent::config_builder()
            .https_only(is_tls)
            .http_status_as_error(false)
            .max_redirects(REDIRECTS_MAX)
            .user_agent(concat!("trex/", env!("CARGO_PKG_VERSION")))
            .input_buffer_size(BUFFER_BYTES)
            .output_buffer_size(BUFFER_BYTES)
            .max_idle_connections(connections)
            .max_idle_connections_per_host(connections)
            .timeout_resolve(Some(CONNECT_TIME))
            .timeout_connect(Some(CONNECT_TIME))
            .timeout_recv_response(Some(ANSWER_TIME))
            .timeout_recv_body(Some(BODY_TIME));
        Client { agent: config.build().into(), url: url.to_owned() }
    }

    /// The last bytes of the file, and which version that is.
    pub(super) fn tail(&self, bytes: u64) -> io::Result<(Version, Vec<u8>)> {
        let request = self.agent.get(&self.url).header(header::RANGE, format!("bytes=-{bytes}"));
        let mut answer = request.call().map_err(told)?;
        let range = judged(&answer)?;
        let length = range.last - range.first + 1;
        if range.last + 1 != range.length || length > bytes {
            return Err(other_range(&format!("the last {bytes} bytes"), &range));
        }
        let text = |name| answer.headers().get(name)?.to_str().ok().map(str::to_owned);
        // Weak tags do not tell bytes apart.
        let tag = text(header::ETAG).filter(|tag| tag.starts_with('"'));
        let version = Version { length: range.length, tag, changed: text(header::LAST_MODIFIED) };
        let mut tail = vec![0; length as usize];
        read_body(&mut answer, &mut tail)?;
        Ok((version, tail))
    }

    /// Fills `out` with the bytes of `version` from `offset` on; `out` is not empty, and all of it is in the file.
    pub(super) fn range(&self, version: &Version, offset: u64, out: &mut [u8]) -> io::Result<()> {
        let last = offset + out.len() as u64 - 1;
        let mut request = self.agent.get(&self.url).header(header::RANGE, format!("bytes={offset}-{last}"));
        match (&version.tag, &version.changed) {
            (Some(tag), _) => request = request.header(header::IF_MATCH, tag),
            (None, Some(date)) => request = request.header(header::IF_UNMODIFIED_SINCE, date),
            (None, None) => {}
        }
        let mut answer = request.call().map_err(told)?;
        let range = judged(&answer)?;
        if range.length != version.length || !version.is_of(answer.headers()) {
            return Err(changed());
        }
        if (range.first, range.last) != (offset, last) {
            return Err(other_range(&format!("bytes {offset} to {last}"), &range));
        }
        read_body(&mut answer, out)
    }
}

impl Version {
    /// False when an answer names another version.
    fn is_of(&self, headers: &HeaderMap) -> bool {
        let is_same = |name, known: &Option<String>| {
            let found = headers.get(name).map(|value| value.as_bytes());
            known.as_ref().zip(found).is_none_or(|(known, found)| known.as_bytes() == found)
        };
        is_same(header::ETAG, &self.tag)
            && (self.tag.is_some() || is_same(header::LAST_MODIFIED, &self.changed))
    }
}

/// True for what no second request mends.
pub(super) fn is_final(error: &io::Error) -> bool {
    use ErrorKind::{InvalidInput, NotFound, PermissionDenied, StaleNetworkFileHandle, Unsupported};
    matches!(error.kind(), InvalidInput | NotFound | PermissionDenied | StaleNetworkFileHandle | Unsupported)
}

/// The range that an answer says it has.
fn judged(answer: &Response<Body>) -> io::Result<ContentRange> {
    let status = answer.status();
    let failed = |kind, what: &str| Err(io::Error::new(kind, format!("{what} (status {})", status.as_u16())));
    match status {
        StatusCode::PARTIAL_CONTENT => {}
        StatusCode::PRECONDITION_FAILED => return Err(changed()),
        StatusCode::NOT_FOUND | StatusCode::GONE => {
            return failed(ErrorKind::NotFound, "the server has nothing there");
        }
        StatusCode::UNAUTHORIZED | StatusCode::FORBIDDEN | StatusCode::PROXY_AUTHENTICATION_REQUIRED => {
            return failed(ErrorKind::PermissionDenied, "the server does not give it to everybody");
        }
        StatusCode::OK => {
            return failed(ErrorKind::Unsupported, "the server gives whole files alone, no ranges of them");
        }
        StatusCode::RANGE_NOT_SATISFIABLE => {
            return failed(ErrorKind::Unsupported, "the server has no such range, or an empty file");
        }
        status
            if status.is_client_error()
                && status != StatusCode::TOO_MANY_REQUESTS
                && status != StatusCode::REQUEST_TIMEOUT =>
        {
            return failed(ErrorKind::Unsupported, "the server refuses the request");
        }
        _ => return failed(ErrorKind::Other, "the server has trouble"),
    }
    let range = answer.headers().get(header::CONTENT_RANGE).and_then(|value| value.to_str().ok());
    range.and_then(content_range).ok_or_else(|| {
        let what =
            format!("the server does not say which range it gives: {}", range.unwrap_or("no Content-Range"));
        io::Error::new(ErrorKind::Unsupported, what)
    })
}

/// `bytes FIRST-LAST/LENGTH` (RFC 9110, section 14.4).
fn content_range(text: &str) -> Option<ContentRange> {
    let (range, length) = text.strip_prefix("bytes ")?.split_once('/')?;
    let (first, last) = range.split_once('-')?;
    let number = |digits: &str| digits.trim().parse::<u64>().ok();
    let range = ContentRange { first: number(first)?, last: number(last)?, length: number(length)? };
    (range.first <= range.last && range.last < range.length).then_some(range)
}

/// Fills `out` with the body, which must be just as long.
fn read_body(answer: &mut Response<Body>, out: &mut [u8]) -> io::Result<()> {
    let mut body = answer.body_mut().as_reader();
    body.read_exact(out).map_err(|error| match error.kind() {
        ErrorKind::UnexpectedEof => io::Error::new(error.kind(), "the server's answer ends early"),
        _ => error,
    })?;
    // Its end is read, too: the connection is free then.
    if body.read(&mut [0])? > 0 {
        return Err(io::Error::other("the server's answer is longer than it says"));
    }
    Ok(())
}

fn other_range(asked: &str, found: &ContentRange) -> io::Error {
    let ContentRange { first, last, length } = found;
    io::Error::other(format!("the server was asked for {asked} and gives {first} to {last} of {length}"))
}

fn changed() -> io::Error {
    let what = "what the server has is not what it had when it was opened";
    io::Error::new(ErrorKind::StaleNetworkFileHandle, what)
}

/// An error of the client, with the kind that says whether it is worth another try.
fn told(error: ureq::Error) -> io::Error {
    let kind = match &error {
        ureq::Error::Io(error) => error.kind(),
        ureq::Error::Timeout(_) => ErrorKind::TimedOut,
        ureq::Error::HostNotFound => ErrorKind::HostUnreachable,
        ureq::Error::BadUri(_) | ureq::Error::Http(_) | ureq::Error::RequireHttpsOnly(_) => {
            ErrorKind::InvalidInput
        }
        ureq::Error::Tls(_) | ureq::Error::Rustls(_) | ureq::Error::TooManyRedirects => {
            ErrorKind::Unsupported
        }
        _ => ErrorKind::Other,
    };
    io::Error::new(kind, error.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_or_refused() {
        let read = |text| content_range(text).map(|range| (range.first, range.last, range.length));
        assert_eq!(read("bytes 0-9/10"), Some((0, 9, 10)));
        assert_eq!(read("bytes 5-5/10"), Some((5, 5, 10)));
        for bad in
            ["bytes 0-9/*", "bytes */10", "bytes 9-0/10", "bytes 0-10/10", "items 0-9/10", "bytes 0-9", ""]
        {
            assert_eq!(read(bad), None, "{bad}");
        }
    }
}
