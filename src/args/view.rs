//! The command line of `trex view`.

use super::keys::ResearchKeys;
use super::{
    CachedNetworkArgs, CommonArgs, DeadlineArgs, DeviceArgs, DiskArgs, PictureArgs, ScratchArgs, VolumeArgs,
};
use clap::Args;
use std::net::IpAddr;
use std::path::PathBuf;

/// `trex view`
#[derive(Debug, Args)]
#[command(after_help = AFTER_VIEW)]
pub struct ViewArgs {
    /// A page file, also at an http(s):// or s3:// address, or a scene (.toml) that names one; or a mesh (.ply, .obj,
    /// .stl, .gltf, .glb), a volume with --iso (.nrrd, .nhdr, .mhd, .mha, .raw) or a generator (gen:KIND:COUNT), which
    /// is built first
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Where a mesh is built [default: FILE.trex, beside it]
    #[arg(short, long, value_name = "OUT.trex")]
    pub output: Option<PathBuf>,
    /// Address to listen on; any but this machine's own lets others see the model who know the token
    #[arg(long, value_name = "ADDRESS", default_value = "127.0.0.1")]
    pub bind: IpAddr,
    /// Port to listen on; 0 = any that is free
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub port: u16,
    /// A name by which browsers may ask for the page, beside localhost and the address; may be given more than once
    #[arg(long, value_name = "NAME")]
    pub host: Vec<String>,
    /// Do not open a browser
    #[arg(long)]
    pub no_open: bool,
    /// Show the model again when its file has changed, from where it is looked at
    #[arg(long)]
    pub watch: bool,
    /// Exit with 0 also when pages of the file were damaged and left out
    #[arg(long)]
    pub allow_damage: bool,
    #[command(flatten)]
    pub picture: PictureArgs,
    #[command(flatten)]
    pub volumes: VolumeArgs,
    #[command(flatten)]
    pub scratch: ScratchArgs,
    #[command(flatten)]
    pub device: DeviceArgs,
    #[command(flatten)]
    pub disk: DiskArgs,
    #[command(flatten)]
    pub network: CachedNetworkArgs,
    #[command(flatten)]
    pub common: CommonArgs,
    #[command(flatten)]
    pub deadline: DeadlineArgs,
    #[command(flatten)]
    pub research: ResearchKeys,
}

const AFTER_VIEW: &str = "\
The model in a browser page, live: turn it, change lights and materials, watch memory and times. The page \
is served by this process alone, to who knows the token in the address. Ctrl-C ends it.

Exit status 1 when pages of the file that the picture asked for are damaged: it is shown without them, and says so.

A page file without a scene is seen with photon, --lod-error 1, and as large as the page. A mesh is built as \
MESH.trex beside it, once: it is opened at once from then on, until the mesh, or a file that it names, is newer. \
The page can be opened meanwhile, and tells how far the build is. With --watch a file that changes is shown, or \
built and shown, again.

Examples:
  trex view statue.trex                                the browser opens by itself
  trex view statue.ply                                 builds statue.ply.trex first, once
  trex view part.stl --watch                           again whenever the modeller saves it
  trex view head.nrrd --iso 60                         builds head.nrrd.iso-60.trex first, once
  trex statue.trex                                     the same, on a terminal
  trex view ship.toml --memory-limit 128MiB
  trex view iso.trex --no-open --port 8000             over SSH: ssh -L 8000:127.0.0.1:8000 HOST";
