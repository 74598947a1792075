//! Achanta et al. 2009: distance in Lab to the mean colour of the picture.

use super::ReducedPicture;
use super::plane::Plane;

/// D65, the white of sRGB.
const WHITE: [f32; 3] = [0.950_47, 1.0, 1.088_83];

/// Saliency of each sample. The blur of the paper is the mean that a sample is.
pub(super) fn map(picture: &ReducedPicture) -> Plane {
    let lab: Vec<[f32; 3]> = picture.rgb.iter().map(|&rgb| to_lab(rgb)).collect();
    let mut sum = [0.0; 3];
    for lab in &lab {
        sum = std::array::from_fn(|c| sum[c] + f64::from(lab[c]));
    }
    let mean = sum.map(|sum| (sum / lab.len() as f64) as f32);
    let values = lab.iter().map(|lab| distance(*lab, mean)).collect();
    Plane { size: picture.size, values }
}

pub(super) fn distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    (0..3).map(|c| (a[c] - b[c]) * (a[c] - b[c])).sum::<f32>().sqrt()
}

/// CIE Lab of linear sRGB.
pub(super) fn to_lab([r, g, b]: [f32; 3]) -> [f32; 3] {
    let xyz = [
        0.412_46 * r + 0.357_58 * g + 0.180_44 * b,
        0.212_67 * r + 0.715_15 * g + 0.072_18 * b,
        0.019_33 * r + 0.119_19 * g + 0.950_30 * b,
    ];
    let [x, y, z] = std::array::from_fn(|a| {
        let t = xyz[a] / WHITE[a];
        if t > 0.008_856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 }
    });
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}
