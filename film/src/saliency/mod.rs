//! What catches the eye in a picture: a number per tile. Paper, section 5.2.
//!
//! ```text
//! picture -> means of 4 x 4 pixels -> Achanta: distance in Lab to the mean colour            -> mean per tile
//!                                  -> Itti: centre minus surround of intensity, colour pairs
//!                                     and orientation, over scales; what stands out alone    -> mean per tile
//! picture -> differences of neighbours in a tile                                            -> mean per tile
//! ```
//!
//! R. Achanta, S. Hemami, F. Estrada, S. Suesstrunk, "Frequency-tuned salient region detection" (2009); L. Itti, C.
//! Koch, E. Niebur, "A model of saliency-based visual attention for rapid scene analysis" (1998).
//!
//! Both begin at the reduced picture, because a tile gets one number, and whole pictures are dear at each event.
//! Achanta takes each pixel's distance after a blur by a binomial of five, whose variance is 1 pixel². The mean of four
//! has one of 1.25 pixels²: it is that blur, looked at once in 4 x 4 pixels. So the map per tile is that of all pixels
//! but for what differs within 4 x 4 of them: contrast whose mean is the mean colour counts for nothing, and means are
//! of light, not of Lab. Itti's scales begin at a quarter of the picture's size in the paper, too.
//!
//! Invariants: 1. a picture of one colour has one saliency everywhere; 2. every pixel counts.

mod achanta;
mod contrast;
mod itti;
mod plane;
mod reduced;

#[cfg(test)]
mod tests;

pub use reduced::ReducedPicture;
pub(crate) use reduced::SIDE_PIXELS;

/// A measure of saliency.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Saliency {
    /// Achanta et al. 2009.
    #[default]
    Achanta,
    /// Itti et al. 1998.
    Itti,
}

/// Bytes that a sample of the reduced picture takes while its saliency is found, of the metric that takes more: Itti's
/// angles at all scales, and one of these compared with its surround.
const WORK_BYTES_PER_SAMPLE: u64 = 50;

/// Bytes that the saliency of a picture of so many tiles takes while it is found.
pub(crate) fn work_bytes(tile_count: u32) -> u64 {
    let samples = (reduced::SAMPLES_PER_SIDE * reduced::SAMPLES_PER_SIDE) as u64;
    u64::from(tile_count) * samples * WORK_BYTES_PER_SAMPLE
}

impl Saliency {
    /// Saliency of each tile, in rows.
    pub(crate) fn tiles(self, picture: &ReducedPicture) -> Vec<f32> {
        match self {
            Saliency::Achanta => achanta::map(picture).means(reduced::SAMPLES_PER_SIDE).values,
            Saliency::Itti => itti::map(picture).values,
        }
    }

    /// How wrong each tile is likely to look, in rows: its contrast, and as much again where it is as salient as the
    /// mean.
    pub(crate) fn errors(self, picture: &ReducedPicture) -> Vec<f32> {
        let saliency = self.tiles(picture);
        let mean = saliency.iter().sum::<f32>() / saliency.len() as f32;
        let error =
            |(saliency, contrast): (&f32, &f32)| contrast * (1.0 + saliency / mean.max(f32::MIN_POSITIVE));
        saliency.iter().zip(&picture.contrast).map(error).collect()
    }
}
