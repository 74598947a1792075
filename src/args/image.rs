//! The flags of `trex image`.

use super::{CommonArgs, OverwriteArgs};
use crate::values;
use clap::{Args, Subcommand, ValueEnum};
use std::path::PathBuf;
use trex_image::{DEFAULT_EPSILON, DEFAULT_PEAK};

/// `trex image`
#[derive(Debug, Args)]
pub struct ImageArgs {
    /// What to do with them.
    #[command(subcommand)]
    pub verb: ImageVerb,
}

/// What is done with pictures.
#[derive(Debug, Subcommand)]
pub enum ImageVerb {
    /// Say how far a picture is from its reference: RMSE, relMSE, PSNR, largest error
    Diff(ImageDiffArgs),
    /// Put the parts of a picture together, which many machines rendered
    Merge(ImageMergeArgs),
}

/// `trex image merge`
#[derive(Debug, Args)]
#[command(after_help = AFTER_IMAGE_MERGE)]
pub struct ImageMergeArgs {
    /// All parts of the picture, in any order
    #[arg(value_name = "PART.trexpart", required = true)]
    pub parts: Vec<PathBuf>,
    /// The picture: .png, or .exr for linear values and layers
    #[arg(short, long, value_name = "PICTURE")]
    pub output: PathBuf,
    /// Exit with 0 also when parts were rendered without damaged pages
    #[arg(long)]
    pub allow_damage: bool,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

const AFTER_IMAGE_MERGE: &str = "\
Parts by --tiles give the bytes of one render. Those by --samples give its radiance but for the rounding of the sums, \
and always the same for the same cut. Parts of another file, device, version, view or setting are refused, and so are \
parts that are missing or there twice. The light is filtered here, row by row: the picture need not fit in memory.

Exit status 1 when parts were rendered without damaged pages: the picture is written all the same.

Examples:
  trex image merge 1.trexpart 2.trexpart 3.trexpart -o ship.png
  trex image merge parts/*.trexpart -o ship.exr --memory-limit 256MiB";

/// `trex image diff`
#[derive(Debug, Args)]
#[command(after_help = AFTER_IMAGE_DIFF)]
pub struct ImageDiffArgs {
    /// The picture: EXR or PNG
    #[arg(value_name = "A")]
    pub a: PathBuf,
    /// The reference, of the same size: EXR or PNG
    #[arg(value_name = "B")]
    pub b: PathBuf,
    /// Write the error of each pixel as false colours, a .png
    #[arg(short, long, value_name = "DIFF.png")]
    pub output: Option<PathBuf>,
    /// End of the false colours' scale, radiance (default: what 99 % of the pixels do not exceed)
    #[arg(long, value_name = "RADIANCE", value_parser = values::positive, requires = "output")]
    pub scale_max: Option<f64>,
    /// Say also how different they look, by LDR-FLIP: 0 alike, 1 as different as can be
    #[arg(long)]
    pub flip: bool,
    /// What the metric of all channels must keep to, else exit status 1: at most this RMSE, relMSE or FLIP, at least
    /// this PSNR in dB
    #[arg(long, value_name = "X", value_parser = values::number, allow_hyphen_values = true)]
    pub threshold: Option<f64>,
    /// What the threshold is held against (default: rmse)
    #[arg(long, value_enum, value_name = "METRIC", requires = "threshold")]
    pub metric: Option<Metric>,
    /// eps of relMSE, squared radiance
    #[arg(long, value_name = "EPS", default_value_t = DEFAULT_EPSILON, value_parser = values::positive)]
    pub epsilon: f64,
    /// Peak of PSNR, radiance
    #[arg(long, value_name = "PEAK", default_value_t = DEFAULT_PEAK, value_parser = values::positive)]
    pub peak: f64,
    #[command(flatten)]
    pub overwrite: OverwriteArgs,
    #[command(flatten)]
    pub common: CommonArgs,
}

/// `--metric`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Metric {
    /// Root of the mean squared error, radiance
    Rmse,
    /// Mean of (a-b)^2 / (b^2 + eps)
    Relmse,
    /// 10 log10(peak^2 / mean squared error), dB
    Psnr,
    /// Mean difference of looks, as --flip says it
    Flip,
}

impl Metric {
    /// The name as typed.
    pub fn as_str(self) -> &'static str {
        match self {
            Metric::Rmse => "rmse",
            Metric::Relmse => "relmse",
            Metric::Psnr => "psnr",
            Metric::Flip => "flip",
        }
    }
}

const AFTER_IMAGE_DIFF: &str = "\
Figures are in linear radiance, per channel and for all together: a PNG is decoded from sRGB, an EXR taken as it is \
(channels R G B, else the first layer with NAME.R NAME.G NAME.B, else Y as grey). Alpha is left out; so are pixels \
that are not finite in one of the pictures, and counted. Equal pictures have an infinite PSNR, null in JSON. \
FLIP compares what is shown: radiance clamped to 0..1, on a screen 3840 pixels and 0.7 m wide, seen from 0.7 m.

Examples:
  trex image diff photon.exr path.exr
  trex image diff photon.exr path.exr -o error.png
  trex image diff draft.png normal.png --flip
  trex image diff new.exr old.exr --threshold 0.01 --metric relmse --json";
