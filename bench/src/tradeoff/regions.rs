//! The parts of a picture that are hard, found in its reference, and the error in each.
//!
//! | region | pixels |
//! |---|---|
//! | `shadow` | direct light of neighbours on one surface differs by more than a quarter |
//! | `contact` | within three pixels of where surfaces of other directions meet |
//! | `indirect` | more than half of the light has been reflected |
//! | `gloss`, `mirror` | what is seen first is glossy, or a mirror: [`super::specular`] |
//!
//! Two pixels are on one surface when their depths differ by less than 2 %, their normals by less than 18 degrees, and
//! their albedos by less than 0.02 a channel.

use crate::channels::Channels;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use trex_image::{Constants, DEFAULT_EPSILON, DEFAULT_PEAK, Picture, compare, flip_bytes, flip_each};

/// Most difference of depth, share.
const SAME_DEPTH: f32 = 0.02;
/// Least cosine between normals.
const SAME_NORMAL: f32 = 0.95;
/// Cosine between normals below which surfaces meet.
const OTHER_NORMAL: f32 = 0.8;
const SAME_ALBEDO: f32 = 0.02;
/// Share of direct light that neighbours differ by at a shadow's border.
const BORDER: f32 = 0.25;
/// Pixels beside a contact.
const REACH: i64 = 3;

/// How far a picture, or a part of it, is from its reference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RegionError {
    /// Share of the pixels that it has.
    pub share: f64,
    /// Mean of squared relative differences; `None`: it has no pixels.
    pub relmse: Option<f64>,
    /// For a peak of 1; `None`: it has no pixels, or no error.
    pub psnr_db: Option<f64>,
    /// Mean difference of looks, LDR-FLIP of the whole picture; `None`: it has no pixels.
    pub flip: Option<f64>,
}

/// The reference of a campaign.
pub(super) struct ReferencePicture {
    pub(super) picture: Picture,
    /// The relMSE that its own noise comes to.
    pub(super) floor: f64,
    masks: Vec<Mask>,
}

/// A region's name, and a flag a pixel.
pub(super) type Mask = (&'static str, Vec<bool>);

/// The picture of an EXR of ours.
pub(super) fn picture_of(path: &Path) -> anyhow::Result<Picture> {
    Channels::read(path)?.picture()
}

/// Bytes that the pictures of a campaign take at `resolution`, all at once.
pub(super) fn bytes(resolution: [u32; 2]) -> u64 {
    // Two references with seven more channels, direct light, the mean, a picture and its copy with a mask, six masks,
    // differences of looks; the decoder holds a picture once more.
    let pixels = u64::from(resolution[0]) * u64::from(resolution[1]);
    pixels * (2 * 2 * (3 + 8) * 4 + 5 * 12 + 6 + 4) + flip_bytes(resolution[0])
}

impl ReferencePicture {
    /// The mean of two pictures with different noise, the first with its layers, and `direct` light alone; `specular`
    /// masks join those that are found in them.
    pub(super) fn read(
        [a, b, direct]: [&Path; 3],
        specular: impl IntoIterator<Item = Mask>,
    ) -> anyhow::Result<ReferencePicture> {
        let (layers, b, direct) = (Channels::read(a)?, picture_of(b)?, picture_of(direct)?);
        let a = layers.picture()?;
        let floor = compare(&a, &b, constants()).all.relmse.unwrap_or(0.0) / 4.0;
        let mean = |(a, b): (&[f32; 3], &[f32; 3])| [0, 1, 2].map(|i| 0.5 * (a[i] + b[i]));
        let pixels = a.pixels.iter().zip(&b.pixels).map(mean).collect();
        let picture = Picture { pixels, ..a };
        let mut masks = masks(&picture, &direct, &Surfaces::of(&layers)?);
        masks.extend(specular);
        Ok(ReferencePicture { picture, floor, masks })
    }

    /// The errors of `picture`: of the whole, by the name `whole`, and of each region.
    pub(super) fn errors(&self, picture: &Picture) -> BTreeMap<String, RegionError> {
        let mut looks = Vec::with_capacity(picture.pixels.len());
        flip_each(picture, &self.picture, 1.0, |difference| looks.push(difference));
        let everywhere = vec![true; looks.len()];
        let masks = self.masks.iter().map(|(name, mask)| (*name, mask));
        let error = |(name, mask): (&str, &Vec<bool>)| {
            // What is not finite is left out of every figure.
            let pixel = |(pixel, is_in): (&[f32; 3], &bool)| if *is_in { *pixel } else { [f32::NAN; 3] };
            let pixels = picture.pixels.iter().zip(mask).map(pixel).collect();
            let figures = compare(&Picture { pixels, ..*picture }, &self.picture, constants()).all;
            let count = mask.iter().filter(|is_in| **is_in).count() as f64;
            let sum = looks
                .iter()
                .zip(mask)
                .filter(|(_, is_in)| **is_in)
                .map(|(look, _)| f64::from(*look))
                .sum::<f64>();
            let error = RegionError {
                share: count / mask.len() as f64,
                relmse: figures.relmse,
                psnr_db: figures.psnr_db,
                flip: (count > 0.0).then(|| sum / count),
            };
            (name.to_owned(), error)
        };
        std::iter::once(("whole", &everywhere)).chain(masks).map(error).collect()
    }
}

fn constants() -> Constants {
    Constants { epsilon: DEFAULT_EPSILON, peak: DEFAULT_PEAK }
}

/// What rays through the centres of pixels meet.
struct Surfaces {
    width: i64,
    depth: Vec<f32>,
    normal: Vec<[f32; 3]>,
    albedo: Vec<[f32; 3]>,
}

impl Surfaces {
    fn of(channels: &Channels) -> anyhow::Result<Surfaces> {
        Ok(Surfaces {
            width: channels.width as i64,
            depth: channels.plane("Z")?.to_vec(),
            normal: channels.colours(["normal.X", "normal.Y", "normal.Z"])?,
            albedo: channels.colours(["albedo.R", "albedo.G", "albedo.B"])?,
        })
    }

    fn cosine(&self, a: usize, b: usize) -> f32 {
        (0..3).map(|i| self.normal[a][i] * self.normal[b][i]).sum()
    }

    /// Beside each other in space, not in the picture alone.
    fn touch(&self, a: usize, b: usize) -> bool {
        (self.depth[a] - self.depth[b]).abs() < SAME_DEPTH * self.depth[a].min(self.depth[b])
    }

    fn are_one(&self, a: usize, b: usize) -> bool {
        let is_near = |i: usize| (self.albedo[a][i] - self.albedo[b][i]).abs() < SAME_ALBEDO;
        self.touch(a, b) && self.cosine(a, b) > SAME_NORMAL && (0..3).all(is_near)
    }

    /// True where a pixel within `reach` of pixel `at` has what is asked of the two.
    fn any_near(&self, at: usize, reach: i64, is_so: impl Fn(usize) -> bool) -> bool {
        let (x, y) = (at as i64 % self.width, at as i64 / self.width);
        let height = self.depth.len() as i64 / self.width;
        let rows = (y - reach).max(0)..=(y + reach).min(height - 1);
        rows.flat_map(|row| {
            let columns = (x - reach).max(0)..=(x + reach).min(self.width - 1);
            columns.map(move |column| (row * self.width + column) as usize)
        })
        .any(is_so)
    }
}

fn luminance(pixel: &[f32; 3]) -> f32 {
    0.2126 * pixel[0] + 0.7152 * pixel[1] + 0.0722 * pixel[2]
}

fn masks(all: &Picture, direct: &Picture, surfaces: &Surfaces) -> Vec<Mask> {
    let [light, direct] =
        [all, direct].map(|picture| picture.pixels.iter().map(luminance).collect::<Vec<f32>>());
    let differs = |a: f32, b: f32| (a - b).abs() > BORDER * a.max(b);
    let is_surface = |at: usize| surfaces.depth[at].is_finite();
    let mask =
        |is_in: &dyn Fn(usize) -> bool| (0..light.len()).map(|at| is_surface(at) && is_in(at)).collect();
    let shadow = mask(&|at| {
        surfaces.any_near(at, 1, |other| surfaces.are_one(at, other) && differs(direct[at], direct[other]))
    });
    let contact = mask(&|at| {
        let meets = |other: usize| surfaces.touch(at, other) && surfaces.cosine(at, other) < OTHER_NORMAL;
        surfaces.any_near(at, REACH, meets)
    });
    let indirect = mask(&|at| light[at] > 2.0 * direct[at]);
    vec![("shadow", shadow), ("contact", contact), ("indirect", indirect)]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A floor left of column 4 and a wall right of it; a shadow from row 4 on, in which reflected light is all.
    #[test]
    fn each_part_is_where_it_is() {
        let side = 8;
        let at = |f: &dyn Fn(usize, usize) -> f32| -> Vec<f32> {
            (0..side * side).map(|i| f(i % side, i / side)).collect()
        };
        let grey = |values: &[f32]| values.iter().map(|&v| [v; 3]).collect::<Vec<_>>();
        let surfaces = Surfaces {
            width: side as i64,
            depth: at(&|x, _| 10.0 + 0.01 * x as f32),
            normal: (0..side * side)
                .map(|i| if i % side < 4 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] })
                .collect(),
            albedo: grey(&at(&|_, _| 0.5)),
        };
        let picture = |values: Vec<f32>| Picture { width: 8, height: 8, pixels: grey(&values) };
        let direct = picture(at(&|_, y| if y < 4 { 1.0 } else { 0.1 }));
        let all = picture(at(&|_, y| if y < 4 { 1.2 } else { 0.4 }));
        let masks = masks(&all, &direct, &surfaces);
        let told =
            |name: &str, x: usize, y: usize| masks.iter().find(|(n, _)| *n == name).unwrap().1[y * side + x];
        for (x, y) in (0..side).flat_map(|x| (0..side).map(move |y| (x, y))) {
            assert_eq!(told("shadow", x, y), y == 3 || y == 4, "{x} {y}");
            assert_eq!(told("contact", x, y), (1..=6).contains(&x), "{x} {y}");
            assert_eq!(told("indirect", x, y), y >= 4, "{x} {y}");
        }

        let reference = ReferencePicture { picture: all.clone(), floor: 0.0, masks };
        // An error in the lit half alone.
        let mut wrong = all;
        wrong.pixels[..32].iter_mut().for_each(|pixel| pixel.iter_mut().for_each(|value| *value += 0.12));
        let errors = reference.errors(&wrong);
        let relative = 0.0144 / (1.44 + DEFAULT_EPSILON);
        assert!((errors["whole"].relmse.unwrap() - relative / 2.0).abs() < 1e-6);
        assert_eq!((errors["indirect"].relmse, errors["indirect"].share), (Some(0.0), 0.5));
        assert!((errors["shadow"].relmse.unwrap() - relative / 2.0).abs() < 1e-6);
        // Brighter than what is shown as white: nobody sees it.
        assert_eq!((errors["whole"].flip, errors["indirect"].flip), (Some(0.0), Some(0.0)));
    }
}
