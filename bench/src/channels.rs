//! `Channels`: all channels of an EXR of ours, by name.
//!
//! Invariants: 1. what the file lacks is an error that names it, never zeros; 2. a plane has `width * height` numbers.

use exr::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use trex_image::Picture;

/// The channels of an EXR of ours, by name.
pub(crate) struct Channels {
    pub(crate) width: usize,
    pub(crate) height: usize,
    planes: BTreeMap<String, Vec<f32>>,
}

impl Channels {
    pub(crate) fn read(path: &Path) -> anyhow::Result<Channels> {
        let image = read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .from_file(path)
            .map_err(|error| anyhow::anyhow!("{}: {error}", path.display()))?;
        let Vec2(width, height) = image.layer_data.size;
        let channels = image.layer_data.channel_data.list;
        let plane = |channel: &AnyChannel<FlatSamples>| {
            let values = channel.sample_data.values_as_f32().collect();
            (channel.name.to_string(), values)
        };
        Ok(Channels { width, height, planes: channels.iter().map(plane).collect() })
    }

    pub(crate) fn plane(&self, name: &str) -> anyhow::Result<&[f32]> {
        self.planes.get(name).map(Vec::as_slice).ok_or_else(|| anyhow::anyhow!("no channel {name}"))
    }

    pub(crate) fn colours(&self, names: [&str; 3]) -> anyhow::Result<Vec<[f32; 3]>> {
        let [a, b, c] = [self.plane(names[0])?, self.plane(names[1])?, self.plane(names[2])?];
        Ok((0..a.len()).map(|i| [a[i], b[i], c[i]]).collect())
    }

    pub(crate) fn picture(&self) -> anyhow::Result<Picture> {
        let pixels = self.colours(["R", "G", "B"])?;
        Ok(Picture { width: self.width as u32, height: self.height as u32, pixels })
    }
}
