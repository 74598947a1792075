//! What `trex info` tells of a part of a picture.

use super::render_part::PartReport;
use crate::size;
use serde::{Serialize, Serializer};
use std::fmt;
use std::io::Read;
use std::path::Path;
use trex_model::read_head;
use trex_render::{PART_MAGIC, PartHead};
use trex_store::printable::one_line;
use trex_store::{Result, open_regular};

/// A part file, as its head describes it.
#[derive(Serialize)]
pub struct PartInfo {
    scene: String,
    /// What the file is.
    kind: &'static str,
    part: PartReport,
    width: u32,
    height: u32,
    layers: String,
    exposure: f32,
    damaged_page_count: u32,
    file_bytes: u64,
    /// What decides the picture: parts that differ in one of them make none.
    #[serde(serialize_with = "as_map")]
    facts: Vec<(String, String)>,
}

/// Whether a file begins as parts of pictures do.
pub fn is_part(path: &Path) -> bool {
    let mut head = [0; PART_MAGIC.len()];
    open_regular(path).is_ok_and(|mut file| file.read_exact(&mut head).is_ok()) && head == PART_MAGIC
}

fn as_map<S: Serializer>(facts: &[(String, String)], to: S) -> std::result::Result<S::Ok, S::Error> {
    to.collect_map(facts.iter().map(|(name, value)| (name, value)))
}

impl PartInfo {
    /// Reads and checks the head of the part at `path`.
    ///
    /// # Errors
    /// Those of [`read_head`].
    pub fn read(path: &Path) -> Result<PartInfo> {
        let (head, _) = read_head(path)?;
        let [width, height] = head.resolution;
        let PartHead { portion, spp, exposure, damaged_page_count, .. } = head;
        Ok(PartInfo {
            scene: path.display().to_string(),
            kind: "a part of a picture",
            part: PartReport::of(portion, head.resolution, spp),
            width,
            height,
            layers: head.layers.to_string(),
            exposure,
            damaged_page_count,
            file_bytes: head.file_bytes(),
            facts: head.facts,
        })
    }
}

impl fmt::Display for PartInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let PartReport { tiles: [first, end], tile_count, samples: [from, to], spp } = &self.part;
        writeln!(
            f,
            "{}: {} of {}x{}, {}",
            one_line(&self.scene),
            self.kind,
            self.width,
            self.height,
            size::bytes(self.file_bytes)
        )?;
        writeln!(f, "tiles {first}..{end} of {tile_count}, samples {from}..{to} of {spp}")?;
        writeln!(f, "layers: {}; exposure {}", self.layers, self.exposure)?;
        if self.damaged_page_count > 0 {
            writeln!(f, "rendered without damaged pages: {}", self.damaged_page_count)?;
        }
        let facts = self.facts.iter().map(|(name, value)| one_line(&format!("{name} {value}")).into_owned());
        write!(f, "of {}", facts.collect::<Vec<_>>().join(", "))
    }
}
