//! `NoLight`: the indirect light of methods that gather none from photons.

use super::indirect::IndirectLight;

/// No light, of no bytes, which is always whole.
#[derive(Debug)]
pub(super) struct NoLight;

impl IndirectLight for NoLight {}
