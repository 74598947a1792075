//! The picture as the metrics see it: means of a few pixels, a whole number a tile.

use super::contrast::ContrastSums;
use super::plane::Plane;
use std::ops::Range;

/// Pixels of a tile along a side.
pub(crate) const SIDE_PIXELS: u32 = SAMPLE_PIXELS * SAMPLES_PER_SIDE;
/// Samples of a tile along a side.
pub(super) const SAMPLES_PER_SIDE: u32 = 2;
/// Pixels of a sample along a side.
pub(super) const SAMPLE_PIXELS: u32 = 4;

/// A picture at two samples a tile along each side: each the mean of its pixels, each of those at most 1.
#[derive(Clone, Debug, Default)]
pub struct ReducedPicture {
    /// Width and height, samples.
    pub(super) size: [usize; 2],
    pub(super) rgb: Vec<[f32; 3]>,
    /// How much neighbours differ, by tiles.
    pub(super) contrast: Vec<f32>,
}

impl ReducedPicture {
    /// The reduction of a picture of `resolution` (width, height; pixels). `fill` is given a pixel (x, y), and writes
    /// linear RGB of as many pixels of its row, all in one tile, as there are places. It is asked for every pixel.
    /// Where the picture's edge cuts a tile, samples without pixels are as the picture's last.
    pub fn new(resolution: [u32; 2], mut fill: impl FnMut([u32; 2], &mut [[f32; 3]])) -> ReducedPicture {
        let [width, height] = resolution;
        let size = resolution.map(|side| side.div_ceil(SIDE_PIXELS) * SAMPLES_PER_SIDE);
        let mut contrast = ContrastSums::new(resolution, SIDE_PIXELS);
        let mut rgb = Vec::with_capacity(size[0] as usize * size[1] as usize);
        let mut tile = [[0.0; 3]; SIDE_PIXELS as usize];
        // In f64 the mean of one colour is that colour, of however many pixels.
        let mut sums = vec![[0.0f64; 3]; size[0] as usize];
        for (rows, is_there) in (0..size[1]).map(|y| (pixels(y, height), y * SAMPLE_PIXELS < height)) {
            sums.fill([0.0; 3]);
            for y in rows.clone() {
                for (x, sums) in
                    (0..).step_by(tile.len()).zip(sums.chunks_exact_mut(SAMPLES_PER_SIDE as usize))
                {
                    let tile = &mut tile[..SIDE_PIXELS.min(width - x) as usize];
                    fill([x, y], tile);
                    if is_there {
                        contrast.add([x, y], tile);
                    }
                    for (sample, sum) in (0..).zip(sums) {
                        let pixels = pixels(sample, tile.len() as u32);
                        for rgb in &tile[pixels.start as usize..pixels.end as usize] {
                            *sum = std::array::from_fn(|c| sum[c] + f64::from(rgb[c].clamp(0.0, 1.0)));
                        }
                    }
                }
            }
            rgb.extend((0..).zip(&sums).map(|(x, sum)| {
                let count = (rows.len() * pixels(x, width).len()) as f64;
                sum.map(|sum| (sum / count) as f32)
            }));
        }
        ReducedPicture { size: size.map(|side| side as usize), rgb, contrast: contrast.means() }
    }

    /// As [`ReducedPicture::new`], pixel by pixel.
    #[cfg(test)]
    pub fn of(resolution: [u32; 2], mut radiance: impl FnMut([u32; 2]) -> [f32; 3]) -> ReducedPicture {
        ReducedPicture::new(resolution, |[x, y], row| {
            (x..).zip(row).for_each(|(x, place)| *place = radiance([x, y]));
        })
    }

    /// A channel: `value` of each sample.
    pub(super) fn plane(&self, value: impl Fn([f32; 3]) -> f32) -> Plane {
        Plane { size: self.size, values: self.rgb.iter().map(|&rgb| value(rgb)).collect() }
    }
}

/// The pixels of a sample along an axis of `side` pixels; the last one where the edge cuts off all.
fn pixels(sample: u32, side: u32) -> Range<u32> {
    let first = (sample * SAMPLE_PIXELS).min(side - 1);
    first..side.min((sample + 1) * SAMPLE_PIXELS)
}
