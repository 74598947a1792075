//! `Address`: where a file on the web is, and the address that a request for it goes to: signed by the moment, where it
//! is in S3.
//!
//! ```text
//! https://host/x.trex     -> as it is
//! s3://bucket/x.trex      -> https://bucket.s3.REGION.amazonaws.com/x.trex?X-Amz-Signature=..
//!                            ENDPOINT/bucket/x.trex?..       where another endpoint is named
//! ```
//!
//! Invariants
//! 1. What is told of an address is what the user wrote, never a signed one.
//! 2. Without credentials requests are not signed, as open buckets allow.
//! 3. An address that holds a name or a password is refused.

use crate::error::{Code, Error, Result};
use crate::io::network::S3Options;
use rusty_s3::{Bucket, Credentials, S3Action, UrlStyle};
use std::borrow::Cow;
use std::path::Path;
use std::time::Duration;

/// How long a signature holds: a request begins at once.
const SIGNED_FOR: Duration = Duration::from_secs(300);

/// Where a file is.
pub(super) enum Address {
    /// `http://` or `https://`.
    Plain(String),
    /// An object of a bucket.
    S3 { bucket: Box<Bucket>, key: String, credentials: Option<Credentials> },
}

impl Address {
    /// What `path` says, which is an address.
    ///
    /// # Errors
    /// [`Code::Usage`] for one that cannot be asked.
    pub(super) fn new(path: &Path, options: &S3Options) -> Result<Address> {
        let text = path.to_str().ok_or_else(|| {
            Error::new(Code::Usage, "this address is no text")
                .at(path)
                .next("write it in letters that the web knows")
        })?;
        let (scheme, rest) = text.split_once("//").unwrap_or_default();
        let host = rest.split(['/', '?', '#']).next().unwrap_or_default();
        if host.is_empty() || host.contains('@') {
            return Err(Error::new(Code::Usage, "this address cannot be used")
                .at_place(text.split('@').next_back().unwrap_or_default())
                .next("write https://HOST/PATH or s3://BUCKET/KEY: no name and no password stand in it"));
        }
        if !scheme.eq_ignore_ascii_case("s3:") {
            return Ok(Address::Plain(text.to_owned()));
        }
        let key = rest.get(host.len() + 1..).unwrap_or_default();
        if key.is_empty() {
            return Err(Error::new(Code::Usage, "this address names a bucket and no file in it")
                .at(path)
                .next("write s3://BUCKET/KEY"));
        }
        let bucket = bucket(host, options)?;
        let credentials = options.keys.as_ref().map(|keys| match &keys.token {
            Some(token) => Credentials::new_with_token(&keys.id, &keys.secret, token),
            None => Credentials::new(&keys.id, &keys.secret),
        });
        Ok(Address::S3 { bucket: Box::new(bucket), key: key.to_owned(), credentials })
    }

    /// Where the next request goes to.
    pub(super) fn request_url(&self) -> Cow<'_, str> {
        match self {
            Address::Plain(url) => Cow::Borrowed(url),
            Address::S3 { bucket, key, credentials } => {
                bucket.get_object(credentials.as_ref(), key).sign(SIGNED_FOR).to_string().into()
            }
        }
    }

    /// The same for all requests, of this file alone: the name of what is kept of it.
    pub(super) fn name(&self) -> Cow<'_, str> {
        match self {
            Address::Plain(url) => Cow::Borrowed(url),
            Address::S3 { bucket, key, .. } => bucket.object_url(key).to_string().into(),
        }
    }

    /// True where a request carries credentials, which go to nobody else.
    pub(super) fn is_signed(&self) -> bool {
        matches!(self, Address::S3 { credentials: Some(_), .. })
    }

    /// True for one of `https`.
    pub(super) fn is_tls(&self) -> bool {
        match self {
            Address::Plain(url) => url.get(..6).is_some_and(|head| head.eq_ignore_ascii_case("https:")),
            Address::S3 { bucket, .. } => bucket.base_url().scheme() == "https",
        }
    }

    /// What reads are called in messages.
    pub(super) fn backend_name(&self) -> &'static str {
        match self {
            Address::Plain(_) => "http",
            Address::S3 { .. } => "s3",
        }
    }
}

/// The bucket `name` where the options say that buckets are.
fn bucket(name: &str, options: &S3Options) -> Result<Bucket> {
    let region = options.region.clone().unwrap_or("us-east-1".to_owned());
    let endpoint = options.endpoint.clone();
    // Names with a dot match no certificate of the bucket's own host.
    let style = if endpoint.is_some() || name.contains('.') { UrlStyle::Path } else { UrlStyle::VirtualHost };
    let endpoint = endpoint.unwrap_or_else(|| format!("https://s3.{region}.amazonaws.com"));
    let refused = |why: String| {
        Error::new(Code::Usage, "the place of S3 cannot be used")
            .at_place(&endpoint)
            .numbers(why)
            .next("name an endpoint like https://HOST:PORT, and a bucket by its plain name")
    };
    let url = endpoint.parse().map_err(|error| refused(format!("{error}")))?;
    Bucket::new(url, style, name.to_owned(), region).map_err(|error| refused(error.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn address(text: &str, endpoint: Option<&str>) -> Result<Address> {
        let options = S3Options { endpoint: endpoint.map(str::to_owned), ..S3Options::default() };
        Address::new(Path::new(text), &options)
    }

    #[test]
    fn addresses_are_read_or_refused() {
        let name = |text, endpoint| address(text, endpoint).map(|found| found.name().into_owned());
        assert_eq!(name("https://host/a?b=c", None).unwrap(), "https://host/a?b=c");
        let local = Some("http://127.0.0.1:9000");
        assert_eq!(
            name("s3://models/a b/x.trex", local).unwrap(),
            "http://127.0.0.1:9000/models/a%20b/x.trex"
        );
        assert_eq!(name("S3://models//x", local).unwrap(), "http://127.0.0.1:9000/models//x");
        for bad in [
            "https://",
            "https:///x",
            "https://me:secret@host/x",
            "s3://",
            "s3://models",
            "s3://models/",
            "s3:///x",
        ] {
            let told = name(bad, local).unwrap_err();
            assert_eq!(told.code(), Code::Usage, "{bad}");
            assert!(!told.to_string().contains("secret"), "{told}");
        }
        for bad in ["", "host:9000", "ftp://host", "https://"] {
            assert_eq!(name("s3://models/x", Some(bad)).unwrap_err().code(), Code::Usage, "{bad}");
        }
    }

    /// The signature of AWS's own example (Authenticating Requests: Using Query Parameters).
    #[test]
    fn requests_are_signed_as_the_example_of_aws_is() {
        let endpoint = "https://s3.amazonaws.com".parse().unwrap();
        let bucket = Bucket::new(endpoint, UrlStyle::VirtualHost, "examplebucket", "us-east-1").unwrap();
        let keys = Credentials::new("AKIAIOSFODNN7EXAMPLE", "wJalrXUtnFEMI/K7MDENG/bPxRfiCYEXAMPLEKEY");
        let time = "2013-05-24T00:00:00Z".parse().unwrap();
        let url =
            bucket.get_object(Some(&keys), "test.txt").sign_with_time(Duration::from_secs(86_400), &time);
        let expected = "aeeed9bbccd4d02ee5c0109b86d86835f995330da4c265957d157751f604d404";
        assert!(url.as_str().contains(expected), "{url}");
    }
}
