//! A shaded picture of a generator, by a small z-buffer: `picture KIND COUNT OUT.png [VIEW] [SEED]`.

use datasets_gen::{GenOptions, Spec, View};

const SIZE: [usize; 2] = [960, 640];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let arg = |index: usize, default: &str| args.get(index).cloned().unwrap_or(default.to_string());
    let spec = Spec::parse(&format!("gen:{}:{}:{}", arg(0, "isosurface"), arg(1, "1M"), arg(4, "1")))?;
    let views = datasets_gen::views(&spec);
    let view = views.iter().find(|view| view.name == arg(3, "overview")).ok_or("no such view")?;
    let mut source = datasets_gen::open(&spec, &GenOptions { threads: 2, ..GenOptions::default() })?;
    let materials = source.materials().to_vec();
    let mut batch = trex_store::TriangleBatch::default();
    let (mut depth, mut pixels) = (vec![f64::MAX; SIZE[0] * SIZE[1]], vec![[24u8; 3]; SIZE[0] * SIZE[1]]);
    while source.next_batch(&mut batch)? {
        for (corners, &material) in batch.corners.iter().zip(&batch.material) {
            let surface = &materials[material as usize];
            let colour = if surface.emits() {
                [4.0; 3]
            } else {
                [0, 1, 2].map(|c| surface.kd[c] + 0.6 * surface.ks[c])
            };
            splat(view, corners, colour, &mut depth, &mut pixels);
        }
    }
    let mut encoder =
        png::Encoder::new(std::fs::File::create(arg(2, "picture.png"))?, SIZE[0] as u32, SIZE[1] as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header()?.write_image_data(pixels.as_flattened())?;
    Ok(())
}

/// Draws one triangle; faces seen from behind are drawn bluish.
fn splat(view: &View, corners: &[[f64; 3]; 3], colour: [f32; 3], depth: &mut [f64], pixels: &mut [[u8; 3]]) {
    let forward = unit(sub(view.target, view.position));
    let right = unit(cross(forward, view.up));
    let down = cross(forward, right);
    let scale = 0.5 * SIZE[0] as f64 / (0.5 * view.fov_x_deg.to_radians()).tan();
    let seen = corners.map(|corner| [right, down, forward].map(|axis| dot(axis, sub(corner, view.position))));
    if seen.iter().any(|point| point[2] < 1e-3) {
        return;
    }
    let [a, b, c] = seen.map(|p| [0, 1].map(|i| p[i] / p[2] * scale + 0.5 * SIZE[i] as f64));
    let area =
        |a: [f64; 2], b: [f64; 2], c: [f64; 2]| (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    let normal = unit(cross(sub(corners[1], corners[0]), sub(corners[2], corners[0])));
    let front = dot(normal, sub(view.position, corners[0])) >= 0.0;
    let light = 0.25 + 0.75 * dot(normal, unit([0.75, -0.3, 0.45])).max(0.0) * if front { 1.0 } else { 0.5 };
    let range = |i: usize| {
        let (lo, hi) =
            [a, b, c].iter().fold((f64::MAX, f64::MIN), |(lo, hi), p| (lo.min(p[i]), hi.max(p[i])));
        (lo - 0.5).ceil().max(0.0) as usize..((hi - 0.5).floor() + 1.0).clamp(0.0, SIZE[i] as f64) as usize
    };
    for (x, y) in range(1).flat_map(|y| range(0).map(move |x| (x, y))) {
        let at = [x as f64 + 0.5, y as f64 + 0.5];
        let w = [area(b, c, at), area(c, a, at), area(a, b, at)].map(|part| part / area(a, b, c));
        let z = 1.0 / (0..3).map(|i| w[i] / seen[i][2]).sum::<f64>();
        if w.iter().all(|&part| part >= 0.0) && z < depth[y * SIZE[0] + x] {
            depth[y * SIZE[0] + x] = z;
            let tint = if front { [1.0; 3] } else { [0.6, 0.7, 1.3] };
            let shade = |c: usize| {
                ((light * tint[c] * f64::from(colour[c])).clamp(0.0, 1.0).powf(0.45) * 255.0) as u8
            };
            pixels[y * SIZE[0] + x] = [0, 1, 2].map(shade);
        }
    }
}

fn sub(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [0, 1, 2].map(|i| a[i] - b[i])
}
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| a[i] * b[i]).sum()
}
fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [1, 2, 0].map(|i| a[i] * b[(i + 1) % 3] - a[(i + 1) % 3] * b[i])
}
fn unit(a: [f64; 3]) -> [f64; 3] {
    a.map(|value| value / dot(a, a).sqrt())
}
