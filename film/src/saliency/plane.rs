//! One channel of a picture, and what the metrics do with it. At the border its samples repeat.

/// Differences of less than this are of rounding: intensity is at most 1, and a colour pair about 3.
const ROUNDING: f32 = 1e-5;
/// Local maxima below this share of the greatest count for nothing.
const PEAK_SHARE: f32 = 0.1;

/// One channel of a picture.
#[derive(Clone, Debug)]
pub(super) struct Plane {
    /// Width and height, samples.
    pub(super) size: [usize; 2],
    /// By rows.
    pub(super) values: Vec<f32>,
}

impl Plane {
    /// Correlation with an odd count of taps along x.
    pub(super) fn across<const N: usize>(&self, taps: &[f32; N]) -> Plane {
        let width = self.size[0];
        let mut wider = vec![0.0; width + N - 1];
        let mut values = vec![0.0; self.values.len()];
        for (row, sums) in self.values.chunks_exact(width).zip(values.chunks_exact_mut(width)) {
            wider[..N / 2].fill(row[0]);
            wider[N / 2..][..width].copy_from_slice(row);
            wider[N / 2 + width..].fill(row[width - 1]);
            for (i, &tap) in taps.iter().enumerate() {
                add_times(sums, &wider[i..][..width], tap);
            }
        }
        Plane { size: self.size, values }
    }

    /// Correlation with an odd count of taps along y.
    pub(super) fn down<const N: usize>(&self, taps: &[f32; N]) -> Plane {
        let [width, height] = self.size;
        let mut values = vec![0.0; self.values.len()];
        for (y, sums) in values.chunks_exact_mut(width).enumerate() {
            for (i, &tap) in taps.iter().enumerate() {
                let from = (y + i).saturating_sub(N / 2).min(height - 1);
                add_times(sums, &self.values[from * width..][..width], tap);
            }
        }
        Plane { size: self.size, values }
    }

    /// The next scale: low-passed by the binomial (1 3 3 1) / 8 along each axis, every other sample. Sample x lies
    /// between samples 2 x and 2 x + 1 of this one. A side of one sample stays.
    pub(super) fn halved(&self) -> Plane {
        let [width, height] = self.size;
        let size = self.size.map(|side| side.div_ceil(2));
        let from = |i: usize, side: usize| -> [usize; 4] {
            std::array::from_fn(|tap| (2 * i + tap).saturating_sub(1).min(side - 1))
        };
        let mut values = Vec::with_capacity(size[0] * size[1]);
        let mut sums = vec![0.0; width];
        for y in 0..size[1] {
            let [a, b, c, d] = from(y, height).map(|y| &self.values[y * width..][..width]);
            for (x, sum) in sums.iter_mut().enumerate() {
                *sum = 0.125 * (a[x] + d[x]) + 0.375 * (b[x] + c[x]);
            }
            values.extend((0..size[0]).map(|x| {
                let [a, b, c, d] = from(x, width).map(|x| sums[x]);
                0.125 * (a + d) + 0.375 * (b + c)
            }));
        }
        Plane { size, values }
    }

    /// The plane at `size`, the one it had so many times of halving before; linear between samples.
    pub(super) fn enlarged(&self, halvings: u32, size: [usize; 2]) -> Plane {
        let per_sample = 1.0 / (1u32 << halvings) as f32;
        // The samples on both sides, and the share of the second.
        let place = |i: usize, side: usize| {
            let at = ((i as f32 + 0.5) * per_sample - 0.5).clamp(0.0, (side - 1) as f32);
            (at as usize, (at as usize + 1).min(side - 1), at.fract())
        };
        let columns: Vec<_> = (0..size[0]).map(|x| place(x, self.size[0])).collect();
        let mut wide = Vec::with_capacity(size[0] * self.size[1]);
        for row in self.values.chunks_exact(self.size[0]) {
            wide.extend(columns.iter().map(|&(a, b, share)| row[a] + (row[b] - row[a]) * share));
        }
        let mut values = Vec::with_capacity(size[0] * size[1]);
        for y in 0..size[1] {
            let (a, b, share) = place(y, self.size[1]);
            let [a, b] = [a, b].map(|y| &wide[y * size[0]..][..size[0]]);
            values.extend(a.iter().zip(b).map(|(a, b)| a + (b - a) * share));
        }
        Plane { size, values }
    }

    /// Difference to a plane that was halved so many times, without its sign.
    pub(super) fn minus(&self, coarser: &Plane, halvings: u32) -> Plane {
        coarser.enlarged(halvings, self.size).with(self, |surround, centre| {
            let difference = (centre - surround).abs();
            if difference < ROUNDING { 0.0 } else { difference }
        })
    }

    /// `of` this and another plane of one size.
    pub(super) fn with(mut self, other: &Plane, of: impl Fn(f32, f32) -> f32) -> Plane {
        assert_eq!(self.size, other.size, "planes of one scale");
        self.values.iter_mut().zip(&other.values).for_each(|(value, &other)| *value = of(*value, other));
        self
    }

    /// The sum of planes of one size.
    pub(super) fn plus(self, other: &Plane) -> Plane {
        self.with(other, |a, b| a + b)
    }

    /// The mean of each square of `side` samples, of which there is a whole number.
    pub(super) fn means(&self, side: u32) -> Plane {
        let side = side as usize;
        let size = self.size.map(|samples| samples / side);
        let mut values = vec![0.0; size[0] * size[1]];
        for (y, row) in self.values.chunks_exact(self.size[0]).enumerate() {
            let means = &mut values[y / side * size[0]..][..size[0]];
            for (samples, mean) in row.chunks_exact(side).zip(means) {
                *mean += samples.iter().sum::<f32>() / (side * side) as f32;
            }
        }
        Plane { size, values }
    }

    /// Itti's N: scaled to 0 to M = 1, then times (M - m)², where m is the mean of all local maxima but the greatest. A
    /// map with one peak stays, one with many alike goes. Nothing of a map of one value.
    pub(super) fn promoted(mut self) -> Plane {
        let [least, greatest] = self.range();
        if greatest <= least {
            self.values.fill(0.0);
            return self;
        }
        let scale = 1.0 / (greatest - least);
        self.values.iter_mut().for_each(|value| *value = (*value - least) * scale);
        let (sum, count) = self.peaks();
        let mean = if count > 1 { (sum - 1.0) / (count - 1) as f32 } else { 0.0 };
        let weight = (1.0 - mean) * (1.0 - mean);
        self.values.iter_mut().for_each(|value| *value *= weight);
        self
    }

    /// Least and greatest value.
    fn range(&self) -> [f32; 2] {
        // Side by side, so that none waits for the one before.
        const LANES: usize = 8;
        let (mut least, mut greatest) = ([f32::INFINITY; LANES], [f32::NEG_INFINITY; LANES]);
        for values in self.values.chunks(LANES) {
            for (lane, &value) in values.iter().enumerate() {
                least[lane] = if value < least[lane] { value } else { least[lane] };
                greatest[lane] = greater(value, greatest[lane]);
            }
        }
        [
            least.into_iter().fold(f32::INFINITY, f32::min),
            greatest.into_iter().fold(f32::NEG_INFINITY, f32::max),
        ]
    }

    /// Sum and count of the local maxima among eight neighbours, of a plane of 0 to 1. No neighbour is greater than a
    /// maximum, and none before it as great: a plateau counts once.
    fn peaks(&self) -> (f32, u32) {
        let [width, height] = self.size;
        // Around the plane is less than anything in it.
        let pitch = width + 2;
        let mut framed = vec![-1.0; pitch * (height + 2)];
        for (row, values) in self.values.chunks_exact(width).enumerate() {
            framed[(row + 1) * pitch + 1..][..width].copy_from_slice(values);
        }
        let (mut sum, mut count, mut peaks) = (0.0, 0, vec![0.0; width]);
        for y in 0..height {
            let [above, row, below] = [0, 1, 2].map(|i| &framed[(y + i) * pitch..][..pitch]);
            for (x, peak) in peaks.iter_mut().enumerate() {
                let value = row[x + 1];
                let before = greater(greater(above[x], above[x + 1]), greater(above[x + 2], row[x]));
                let after = greater(greater(below[x], below[x + 1]), greater(below[x + 2], row[x + 2]));
                *peak = if value >= PEAK_SHARE && value > before && value >= after { value } else { 0.0 };
            }
            for &peak in peaks.iter().filter(|&&peak| peak > 0.0) {
                (sum, count) = (sum + peak, count + 1);
            }
        }
        (sum, count)
    }
}

/// The greater of two; what `f32::max` is but for values that are no number, and faster by rows.
fn greater(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

fn add_times(sums: &mut [f32], values: &[f32], tap: f32) {
    if tap != 0.0 {
        sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += tap * value);
    }
}
