//! A peer as contenders on our mesh.

use super::contender::Contender;
use super::figures::ModeFigures;

/// A peer set up on our mesh: its modes as contenders.
pub(crate) struct PeerSetup {
    pub(crate) name: String,
    pub(crate) version: String,
    pub(crate) reference: String,
    pub(crate) mesh_bytes: u64,
    pub(crate) modes: Vec<(Box<dyn Contender>, ModeFigures)>,
}
