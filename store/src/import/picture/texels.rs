//! `Picture` and what makes it of rows: squares of texels averaged, and the colour at a place between them.
//!
//! Invariants: those of the module.

use crate::error::{Error, Result};
use crate::import::ImportOptions;
use crate::import::vertices::VertexCache;
use crate::srgb;

/// Texels beyond which a triangle is told of: it has a colour at its corners alone.
const COARSE_TEXELS: f64 = 64.0;
/// Longest side that is kept.
const TEXELS_MAX: u32 = 1024;

/// Why a file gave no picture.
#[derive(Debug)]
pub(in crate::import) enum PictureFault {
    /// It is none that is read, for this reason.
    Unread(String),
    /// The reading failed, for a reason that ends the build: no memory, no scratch, an interrupt.
    Failed(Error),
}

impl From<Error> for PictureFault {
    fn from(error: Error) -> PictureFault {
        PictureFault::Failed(error)
    }
}

/// What is seen beside a picture, along an axis.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::import) enum Wrap {
    /// The picture again.
    #[default]
    Repeat,
    /// Its edge.
    Clamp,
    /// The picture turned about.
    Mirror,
}

impl Wrap {
    /// The two texels of `count` between whose centres a coordinate is, and how far it is from the first to the second.
    fn texels(self, at: f64, count: u64) -> ([u64; 2], f64) {
        let at = if at.is_finite() { at } else { 0.0 };
        let within = match self {
            Wrap::Repeat => at.rem_euclid(1.0),
            Wrap::Clamp => at.clamp(0.0, 1.0),
            Wrap::Mirror => 1.0 - (at.rem_euclid(2.0) - 1.0).abs(),
        };
        let centre = within * count as f64 - 0.5;
        let (first, last) = (centre.floor(), count as i64 - 1);
        let index = |index: i64| match self {
            Wrap::Repeat => index.rem_euclid(count as i64) as u64,
            Wrap::Clamp | Wrap::Mirror => index.clamp(0, last) as u64,
        };
        ([index(first as i64), index(first as i64 + 1)], centre - first)
    }
}

/// A picture that is read.
pub(in crate::import) struct Picture {
    texels: VertexCache,
    /// Texels that are kept, across and down.
    pub(super) size: [u64; 2],
    /// Those of the file.
    pub(in crate::import) file_size: [u32; 2],
    /// Linear.
    pub(in crate::import) mean: [f64; 3],
}

impl Picture {
    /// The linear colour at `(u, v)`, from the upper left corner of the picture to the lower right one at (1, 1);
    /// between the centres of texels it changes linearly.
    pub(in crate::import) fn colour(&mut self, uv: [f64; 2], wraps: [Wrap; 2]) -> Result<[f64; 3]> {
        let [(columns, right), (rows, down)] =
            [0, 1].map(|axis| wraps[axis].texels(uv[axis], self.size[axis]));
        let mut colour = [0.0; 3];
        for (row, row_share) in rows.into_iter().zip([1.0 - down, down]) {
            for (column, column_share) in columns.into_iter().zip([1.0 - right, right]) {
                let texel = self.texels.get(row * self.size[0] + column)?;
                (0..3).for_each(|channel| colour[channel] += row_share * column_share * texel[channel]);
            }
        }
        Ok(colour)
    }
}

/// Triangles with a picture, and those of them that are larger than [`COARSE_TEXELS`].
#[derive(Clone, Copy, Debug, Default)]
pub(in crate::import) struct CoarseCount {
    all: u64,
    coarse: u64,
}

impl CoarseCount {
    /// Counts a triangle with these corners in a picture of so many pixels.
    pub(in crate::import) fn add(&mut self, corners: [[f64; 2]; 3], size: [u32; 2]) {
        let [a, b, c] = corners;
        let [ab, ac] = [b, c].map(|to| [to[0] - a[0], to[1] - a[1]]);
        let share = (ab[0] * ac[1] - ab[1] * ac[0]).abs() / 2.0;
        self.all += 1;
        self.coarse += u64::from(share * f64::from(size[0]) * f64::from(size[1]) > COARSE_TEXELS);
    }

    /// What is to be told of the large ones, where there are some.
    pub(in crate::import) fn warning(&self) -> Option<String> {
        let CoarseCount { all, coarse } = self;
        (*coarse > 0).then(|| {
            format!(
                "{coarse} of {all} triangles with a picture are larger than {COARSE_TEXELS} of its pixels: they show \
                 the colours of their corners alone"
            )
        })
    }
}

/// Takes the rows of a picture from the top, and averages boxes of texels.
pub(super) struct Shrinker<'a> {
    picture: Picture,
    options: &'a ImportOptions,
    /// Sides of a box.
    factor: usize,
    /// Sums of the boxes of the row at hand, and the rows in them.
    sums: Vec<[f64; 3]>,
    row_count: usize,
    linear: [f64; 256],
}

impl<'a> Shrinker<'a> {
    pub(super) fn new(file_size: [u32; 2], options: &'a ImportOptions) -> Result<Shrinker<'a>> {
        let factor = file_size[0].max(file_size[1]).div_ceil(TEXELS_MAX);
        let size = file_size.map(|side| u64::from(side.div_ceil(factor)));
        let texels = VertexCache::growing(options)?;
        Ok(Shrinker {
            picture: Picture { texels, size, file_size, mean: [0.0; 3] },
            options,
            factor: factor as usize,
            sums: vec![[0.0; 3]; size[0] as usize],
            row_count: 0,
            linear: std::array::from_fn(|byte| srgb::linear_of(byte as u8)),
        })
    }

    /// A row of pixels of so many bytes: grey, grey and alpha, RGB, or RGB and alpha.
    pub(super) fn row(&mut self, row: &[u8], pixel_bytes: usize) -> Result<()> {
        self.options.interrupt.check()?;
        let boxes = row.chunks_exact(pixel_bytes).take(self.picture.file_size[0] as usize).enumerate();
        for (x, pixel) in boxes {
            let rgb = if pixel_bytes < 3 { [pixel[0]; 3] } else { [pixel[0], pixel[1], pixel[2]] };
            let sum = &mut self.sums[x / self.factor];
            (0..3).for_each(|channel| sum[channel] += self.linear[usize::from(rgb[channel])]);
        }
        self.row_count += 1;
        if self.row_count == self.factor { self.end_row() } else { Ok(()) }
    }

    fn end_row(&mut self) -> Result<()> {
        let width = self.picture.file_size[0] as usize;
        for (x, sum) in self.sums.iter_mut().enumerate() {
            let count = self.row_count * self.factor.min(width - x * self.factor);
            self.picture.texels.push(sum.map(|part| part / count as f64))?;
            (0..3).for_each(|channel| self.picture.mean[channel] += sum[channel]);
            *sum = [0.0; 3];
        }
        self.row_count = 0;
        Ok(())
    }

    /// The picture, where all of its rows came.
    pub(super) fn finish(mut self) -> Result<Picture, PictureFault> {
        if self.row_count > 0 {
            self.end_row()?;
        }
        let mut picture = self.picture;
        if picture.texels.count() != picture.size[0] * picture.size[1] {
            return Err(PictureFault::Unread("it has fewer rows than its header says".to_owned()));
        }
        let pixels = f64::from(picture.file_size[0]) * f64::from(picture.file_size[1]);
        picture.mean = picture.mean.map(|sum| sum / pixels);
        Ok(picture)
    }
}
