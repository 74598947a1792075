//! How addresses of the web are read.

use pyo3::prelude::*;
use std::path::PathBuf;
use trex_store::io::{CacheOptions, NetworkOptions, S3Options, set_network_options};

/// Sets how addresses are read that are opened from now on; what the environment says of S3 now counts, too.
#[pyfunction]
pub(crate) fn set_network(
    ca_file: Option<PathBuf>,
    s3_endpoint: Option<String>,
    cache_dir: Option<PathBuf>,
    cache_limit: u64,
) {
    let s3 = S3Options::from_variables(|name| std::env::var(name).ok());
    let endpoint = s3_endpoint.or(s3.endpoint);
    set_network_options(NetworkOptions {
        ca_file,
        s3: S3Options { endpoint, ..s3 },
        cache: cache_dir.map(|folder| CacheOptions { folder, limit_bytes: cache_limit }),
    });
}
