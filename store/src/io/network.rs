//! `NetworkOptions`: how this process reads addresses of the web. What is set holds for what is opened from then on.
//!
//! Invariant: an open file keeps the options that it was opened with.

use std::fmt::{self, Debug, Formatter};
use std::path::PathBuf;
use std::sync::{Arc, PoisonError, RwLock};

/// How addresses are read.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct NetworkOptions {
    /// A PEM file of the certificates that vouch for servers, in place of Mozilla's list.
    pub ca_file: Option<PathBuf>,
    /// Where `s3://` is, and who asks there.
    pub s3: S3Options,
    /// Where ranges that were read are kept; none for nowhere.
    pub cache: Option<CacheOptions>,
}

/// Where `s3://` is, and who asks there.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct S3Options {
    /// `https://HOST[:PORT]`; none for AWS.
    pub endpoint: Option<String>,
    /// Its region; none for `us-east-1`.
    pub region: Option<String>,
    /// Whom requests are signed by; none for open buckets, which take unsigned ones.
    pub keys: Option<S3Keys>,
}

/// Credentials of S3. `Debug` shows none of them.
#[derive(Clone, PartialEq, Eq)]
pub struct S3Keys {
    /// The name of the key.
    pub id: String,
    /// The key.
    pub secret: String,
    /// What makes a key hold for some time.
    pub token: Option<String>,
}

impl Debug for S3Keys {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.write_str("S3Keys(..)")
    }
}

impl S3Options {
    /// What the variables say that the tools of AWS read: `AWS_ENDPOINT_URL_S3`, `AWS_ENDPOINT_URL`, `AWS_REGION`,
    /// `AWS_DEFAULT_REGION`, `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_SESSION_TOKEN`. An empty one is none.
    pub fn from_variables(variable: impl Fn(&str) -> Option<String>) -> S3Options {
        let said = |name| variable(name).filter(|text| !text.trim().is_empty());
        let keys = said("AWS_ACCESS_KEY_ID").zip(said("AWS_SECRET_ACCESS_KEY"));
        S3Options {
            endpoint: said("AWS_ENDPOINT_URL_S3").or_else(|| said("AWS_ENDPOINT_URL")),
            region: said("AWS_REGION").or_else(|| said("AWS_DEFAULT_REGION")),
            keys: keys.map(|(id, secret)| S3Keys { id, secret, token: said("AWS_SESSION_TOKEN") }),
        }
    }
}

/// Where ranges of files behind an address are kept between runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CacheOptions {
    /// The folder, made where there is none. Several processes may share it.
    pub folder: PathBuf,
    /// Bytes of disk that all it holds takes, about: the ranges that were not used for longest go first.
    pub limit_bytes: u64,
}

impl CacheOptions {
    /// Disk that a cache takes unless another amount is named: 10 GiB.
    pub const LIMIT_BYTES: u64 = 10 << 30;
}

static OPTIONS: RwLock<Option<Arc<NetworkOptions>>> = RwLock::new(None);

/// Sets how files behind an address are read that this process opens from now on.
pub fn set_network_options(options: NetworkOptions) {
    *OPTIONS.write().unwrap_or_else(PoisonError::into_inner) = Some(Arc::new(options));
}

/// What was set last.
pub fn network_options() -> Arc<NetworkOptions> {
    OPTIONS.read().unwrap_or_else(PoisonError::into_inner).clone().unwrap_or_default()
}
