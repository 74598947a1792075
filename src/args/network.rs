//! Flags of verbs that read page files at an address of the web.

use crate::values::{self, Bytes};
use clap::Args;
use std::path::PathBuf;
use trex_store::io::{CacheOptions, NetworkOptions, S3Options};

/// How servers are asked.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Network options")]
pub struct NetworkArgs {
    /// PEM file of the certificates that vouch for servers, in place of Mozilla's list
    #[arg(long, value_name = "PEM")]
    pub ca_file: Option<PathBuf>,
    /// Where s3:// addresses are, https://HOST:PORT (default: AWS_ENDPOINT_URL_S3, AWS_ENDPOINT_URL, or AWS)
    #[arg(long, value_name = "URL")]
    pub s3_endpoint: Option<String>,
}

/// The same, and what is kept of what servers gave.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Network options")]
pub struct CachedNetworkArgs {
    #[command(flatten)]
    pub network: NetworkArgs,
    /// Folder that keeps what is read at an address, for this run and others (default: nothing is kept)
    #[arg(long, value_name = "DIR")]
    pub cache_dir: Option<PathBuf>,
    /// Most disk that this folder takes, with its unit; what was not used for longest goes (default: 10GiB)
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, requires = "cache_dir")]
    pub cache_limit: Option<Bytes>,
}

impl NetworkArgs {
    /// The library's form, with what the environment says of S3.
    pub fn options(&self) -> NetworkOptions {
        let s3 = S3Options::from_variables(|name| std::env::var(name).ok());
        let endpoint = self.s3_endpoint.clone().or(s3.endpoint);
        NetworkOptions { ca_file: self.ca_file.clone(), s3: S3Options { endpoint, ..s3 }, cache: None }
    }
}

impl CachedNetworkArgs {
    /// The library's form.
    pub fn options(&self) -> NetworkOptions {
        let limit_bytes = self.cache_limit.map_or(CacheOptions::LIMIT_BYTES, |limit| limit.0);
        let cache = self.cache_dir.clone().map(|folder| CacheOptions { folder, limit_bytes });
        NetworkOptions { cache, ..self.network.options() }
    }
}
