//! Pictures written byte by byte, and their comparison as the formulas say it: nothing here is shared with the code
//! under test, nor with the crates below it.

use crate::random::Random;

/// Pixels by row from the top, R G B.
pub(crate) type Pixels = Vec<[f32; 3]>;

/// Seeded pixels of very different brightness.
pub(crate) fn noise(count: usize, seed: u64) -> Pixels {
    let mut random = Random::seeded(seed);
    let mut unit = || random.unit() as f32;
    (0..count).map(|_| [0; 3].map(|_| unit() * (unit() * 12.0 - 6.0).exp2())).collect()
}

/// An EXR of one part without compression: float channels B, G, R.
pub(crate) fn exr(width: usize, pixels: &Pixels) -> Vec<u8> {
    let height = pixels.len() / width;
    let mut channels = vec![];
    for name in [b'B', b'G', b'R'] {
        // Name, float, linear, reserved, sampling of 1 and 1.
        channels.extend([name, 0]);
        [2u32, 0, 1, 1].iter().for_each(|word| channels.extend(word.to_le_bytes()));
    }
    channels.push(0);
    let window: Vec<u8> =
        [0, 0, width as u32 - 1, height as u32 - 1].iter().flat_map(|v| v.to_le_bytes()).collect();
    let one = 1f32.to_le_bytes();
    let mut bytes = vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
    for (name, kind, value) in [
        ("channels", "chlist", &channels[..]),
        ("compression", "compression", &[0]),
        ("dataWindow", "box2i", &window),
        ("displayWindow", "box2i", &window),
        ("lineOrder", "lineOrder", &[0]),
        ("pixelAspectRatio", "float", &one),
        ("screenWindowCenter", "v2f", &[0; 8]),
        ("screenWindowWidth", "float", &one),
    ] {
        bytes.extend([name.as_bytes(), &[0], kind.as_bytes(), &[0]].concat());
        bytes.extend((value.len() as u32).to_le_bytes());
        bytes.extend(value);
    }
    bytes.push(0);
    let line_bytes = width * 12;
    let lines = bytes.len() + height * 8;
    (0..height).for_each(|y| bytes.extend(((lines + y * (8 + line_bytes)) as u64).to_le_bytes()));
    for (y, line) in pixels.chunks(width).enumerate() {
        bytes.extend((y as u32).to_le_bytes());
        bytes.extend((line_bytes as u32).to_le_bytes());
        for channel in [2, 1, 0] {
            line.iter().for_each(|pixel| bytes.extend(pixel[channel].to_le_bytes()));
        }
    }
    bytes
}

/// A PNG of 8 bits, stored without compression in one block.
pub(crate) fn png(width: usize, pixels: &[[u8; 3]]) -> Vec<u8> {
    let rows: Vec<u8> = pixels
        .chunks(width)
        .flat_map(|line| std::iter::once(0).chain(line.iter().copied().flatten()))
        .collect();
    let length = u16::try_from(rows.len()).unwrap();
    let (mut low, mut high) = (1u32, 0u32);
    for byte in &rows {
        low = (low + u32::from(*byte)) % 65_521;
        high = (high + low) % 65_521;
    }
    let mut data = vec![0x78, 0x01, 0x01];
    data.extend(length.to_le_bytes());
    data.extend((!length).to_le_bytes());
    data.extend(rows);
    data.extend((high << 16 | low).to_be_bytes());
    let mut head = vec![];
    [width as u32, (pixels.len() / width) as u32].iter().for_each(|side| head.extend(side.to_be_bytes()));
    head.extend([8, 2, 0, 0, 0]);
    let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
    for (kind, content) in [(b"IHDR", &head), (b"IDAT", &data), (b"IEND", &vec![])] {
        bytes.extend((content.len() as u32).to_be_bytes());
        let chunk = [&kind[..], content].concat();
        bytes.extend(&chunk);
        bytes.extend(crc(&chunk).to_be_bytes());
    }
    bytes
}

fn crc(bytes: &[u8]) -> u32 {
    let mut crc = u32::MAX;
    for byte in bytes {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xedb8_8320 } else { crc >> 1 };
        }
    }
    !crc
}

/// RMSE, relMSE and PSNR of values, as the formulas say; the list of errors is held as a whole.
pub(crate) fn figures(a: &[f32], b: &[f32], epsilon: f64, peak: f64) -> [f64; 3] {
    let mut squares: Vec<f64> =
        a.iter().zip(b).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).collect();
    let mut relative: Vec<f64> =
        squares.iter().zip(b).map(|(square, b)| square / (f64::from(*b).powi(2) + epsilon)).collect();
    // From small to large: the order that loses least.
    squares.sort_by(f64::total_cmp);
    relative.sort_by(f64::total_cmp);
    let mean = |list: &[f64]| list.iter().sum::<f64>() / list.len() as f64;
    let mse = mean(&squares);
    [mse.sqrt(), mean(&relative), 20.0 * peak.log10() - 10.0 * mse.log10()]
}
