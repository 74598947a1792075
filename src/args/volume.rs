//! The flags of volumes: which surfaces, and what files of plain samples hold.

use crate::values::{self, SampleFormat, Vec3, VolumeSize};
use clap::Args;
use trex_store::import::{RawVolume, VolumeOptions};

/// How volumes become triangles.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Volume options")]
pub struct VolumeArgs {
    /// Value of the surface of volumes: samples of this value or more are inside. Once for each surface; each is a
    /// material of its own, iso_VALUE
    #[arg(long, value_name = "VALUE", value_parser = values::number, allow_hyphen_values = true)]
    pub iso: Vec<f64>,
    #[command(flatten)]
    pub raw: RawArgs,
}

/// What `.raw` files hold.
#[derive(Clone, Debug, Args)]
#[command(next_help_heading = "Volume options")]
pub struct RawArgs {
    /// Samples along each axis of a .raw file, those that lie side by side first
    #[arg(long, value_name = "XxYxZ", value_parser = values::volume_size, requires = "sample_format")]
    pub size: Option<VolumeSize>,
    /// Type of the samples of a .raw file: int8 to int64, uint8 to uint64, float32, float64; with `be` behind it where
    /// the most significant byte comes first, as in uint16be
    #[arg(long = "type", value_name = "TYPE", value_parser = values::sample_format,
          requires = "size")]
    pub sample_format: Option<SampleFormat>,
    /// From a sample of a .raw file to the next one along each axis
    #[arg(long, value_name = "X,Y,Z", value_parser = values::spacing, requires = "size", default_value = "1,1,1")]
    pub spacing: Vec3,
}

impl RawArgs {
    /// The library's form.
    pub fn volume(&self) -> Option<RawVolume> {
        let (VolumeSize(size), SampleFormat { sample, order }) = (self.size?, self.sample_format?);
        Some(RawVolume { size, sample, order, spacing: self.spacing.0 })
    }
}

impl VolumeArgs {
    /// The library's form.
    pub fn options(&self) -> VolumeOptions {
        VolumeOptions { iso_values: self.iso.clone(), raw: self.raw.volume() }
    }
}
