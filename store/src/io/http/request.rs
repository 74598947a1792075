//! `Client`: requests for ranges of one address, and what answers are worth.
//!
//! Invariants: those of the module above, 1 to 3.

use super::address::Address;
use crate::error::{Code, Error, Result};
use crate::io::network::NetworkOptions;
use std::fs::File;
use std::io::{self, ErrorKind, Read};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use ureq::http::{HeaderMap, Response, StatusCode, header};
use ureq::tls::{PemItem, RootCerts, TlsConfig, parse_pem};
use ureq::{Agent, Body};

/// How long a request may take.
#[derive(Clone, Copy)]
pub(super) struct TimeBounds {
    /// Until a name is found, and again until there is a connection.
    connect: Duration,
    /// Until an answer begins.
    answer: Duration,
    /// Until a range is there.
    body: Duration,
}

impl TimeBounds {
    /// Those of users: a range of 512 KiB at 17 KiB/s.
    pub(super) const USUAL: TimeBounds = TimeBounds {
        connect: Duration::from_secs(10),
        answer: Duration::from_secs(15),
        body: Duration::from_secs(30),
    };
}

/// Most addresses that a server may send a request on to.
const REDIRECTS_MAX: u32 = 4;
/// Bytes of the buffers of a connection.
const BUFFER_BYTES: usize = 16 << 10;
/// Most bytes of a file of certificates: Mozilla's list takes a fifth.
const PEM_BYTES_MAX: u64 = 1 << 20;

/// Asks for ranges of one address.
pub(super) struct Client {
    agent: Agent,
    address: Address,
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
    /// Keeps up to so many connections that are not in use.
    ///
    /// # Errors
    /// The file of certificates cannot be used.
    pub(super) fn new(
        address: Address,
        connections: usize,
        bounds: TimeBounds,
        options: &NetworkOptions,
    ) -> Result<Client> {
        let roots = options.ca_file.as_deref().map_or(Ok(RootCerts::WebPki), roots_of)?;
        let config = Agent::config_builder()
            .https_only(address.is_tls())
            .http_status_as_error(false)
            // Credentials go where they were meant to go.
            .max_redirects(if address.is_signed() { 0 } else { REDIRECTS_MAX })
            .tls_config(TlsConfig::builder().root_certs(roots).build())
            .user_agent(concat!("trex/", env!("CARGO_PKG_VERSION")))
            .input_buffer_size(BUFFER_BYTES)
            .output_buffer_size(BUFFER_BYTES)
            .max_idle_connections(connections)
            .max_idle_connections_per_host(connections)
            .timeout_resolve(Some(bounds.connect))
            .timeout_connect(Some(bounds.connect))
            .timeout_recv_response(Some(bounds.answer))
            .timeout_recv_body(Some(bounds.body));
        Ok(Client { agent: config.build().into(), address })
    }

    /// Where the file is.
    pub(super) fn address(&self) -> &Address {
        &self.address
    }

    /// The last bytes of the file, and which version that is.
    pub(super) fn tail(&self, bytes: u64) -> io::Result<(Version, Vec<u8>)> {
        let request =
            self.agent.get(&*self.address.request_url()).header(header::RANGE, format!("bytes=-{bytes}"));
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
        let url = self.address.request_url();
        let mut request = self.agent.get(&*url).header(header::RANGE, format!("bytes={offset}-{last}"));
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
    /// A text that other versions do not have; none where the server tells none.
    pub(super) fn text(&self) -> Option<String> {
        let told = self.tag.as_ref().or(self.changed.as_ref())?;
        Some(format!("{} {told}", self.length))
    }

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

/// The certificates of a PEM file.
fn roots_of(path: &Path) -> Result<RootCerts> {
    let failed = |error| Error::io("read the certificates", path, &error);
    // Asked before the open, which would wait for the writer of a pipe.
    if !std::fs::metadata(path).map_err(failed)?.is_file() {
        return Err(Error::new(Code::InputUnreadable, "this is no regular file")
            .at(path)
            .next("name a PEM file"));
    }
    let mut pem = Vec::new();
    File::open(path).and_then(|file| file.take(PEM_BYTES_MAX).read_to_end(&mut pem)).map_err(failed)?;
    let certificate = |item| match item {
        Ok(PemItem::Certificate(certificate)) => Some(certificate),
        _ => None,
    };
    let certificates: Vec<_> = parse_pem(&pem).filter_map(certificate).collect();
    if certificates.is_empty() {
        return Err(Error::new(Code::InputFormat, "there are no certificates in this file")
            .at(path)
            .numbers(format!("{} bytes were read", pem.len()))
            .next("name a PEM file: -----BEGIN CERTIFICATE----- and so on"));
    }
    Ok(RootCerts::Specific(Arc::new(certificates)))
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
        status if status.is_redirection() => {
            // S3 says where a bucket is that was looked for in another region.
            let region = answer.headers().get("x-amz-bucket-region").and_then(|value| value.to_str().ok());
            let what = match region {
                Some(region) => format!("the bucket is in the region {region}: set AWS_REGION"),
                None => "the server sends signed requests to another place".to_owned(),
            };
            return failed(ErrorKind::Unsupported, &what);
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
        // So TLS tells that a certificate does not hold.
        ureq::Error::Io(error) if error.kind() == ErrorKind::InvalidData => ErrorKind::Unsupported,
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
#[allow(dead_code, reason = "of the server of the tests of the command, two manners are of use here")]
#[path = "../../../../tests/it/http/server.rs"]
mod server;

#[cfg(test)]
mod tests {
    use super::server::{Manners, Server};
    use super::*;
    use crate::io::reader::is_final;
    use std::time::Instant;

    /// A server that stops in the middle, or never ends, is left after the bound; nothing waits for good.
    #[test]
    fn answers_that_do_not_end_are_left() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file");
        std::fs::write(&path, vec![7; 100_000]).unwrap();
        let short = Duration::from_millis(200);
        let bounds = TimeBounds { connect: short, answer: short, body: short };
        for (bad, told) in [(Manners::Stalled, "timeout"), (Manners::Endless, "longer than it says")] {
            let server = Server::of(&path, move |first| if first == 5 { bad } else { Manners::Good });
            let options = NetworkOptions::default();
            let address = Address::new(Path::new(&server.url), &options.s3).unwrap();
            let client = Client::new(address, 1, bounds, &options).unwrap();
            let (version, _) = client.tail(100).unwrap();
            let mut out = vec![0; 50_000];
            let begin = Instant::now();
            let error = client.range(&version, 5, &mut out).unwrap_err();
            assert!(error.to_string().contains(told), "{bad:?}: {error}");
            assert!(!is_final(&error) && begin.elapsed() < Duration::from_secs(10), "{bad:?}");
            client.range(&version, 6, &mut out).unwrap();
            drop(client);
        }
    }

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
