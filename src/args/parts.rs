//! Flags that say what is shown of a model: of `render`, `view` and `stress`.

use super::keys::PICTURE;
use crate::values::{self, SectionPlane};
use clap::Args;
use trex_render::PartKeys;

/// What is shown of a model. What is given takes the place of what the scene says.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = PICTURE)]
pub struct PartArgs {
    /// Cut the model by a plane through a point with a normal: what the normal points into stays, the other side is
    /// cut away. Solids are filled where they are cut. Up to three times
    #[arg(long, value_name = "PX,PY,PZ,NX,NY,NZ", value_parser = values::section, allow_hyphen_values = true)]
    pub section: Vec<SectionPlane>,
    /// Hide what is of this material (`info` lists them); may be given more than once
    #[arg(long, value_name = "MATERIAL")]
    pub hide: Vec<String>,
    /// Show what is of this material alone; may be given more than once
    #[arg(long, value_name = "MATERIAL")]
    pub only: Vec<String>,
}

impl PartArgs {
    /// What is given goes before what the scene says.
    pub fn override_parts(&self, parts: &mut PartKeys) {
        if !self.section.is_empty() {
            parts.section = self.section.iter().map(|plane| plane.0).collect();
        }
        if !self.hide.is_empty() || !self.only.is_empty() {
            (parts.hide, parts.only) = (self.hide.clone(), self.only.clone());
        }
    }
}
