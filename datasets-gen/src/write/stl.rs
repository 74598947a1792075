//! STL, binary: 80 bytes of header, a u32 count (written last), 50 bytes a triangle. Coordinates are f32.

use super::{Draft, Job, WriteReport};
use trex_store::{Result, TriangleSource};

const HEADER_BYTES: usize = 80;
const TRIANGLE_BYTES: usize = 50;

pub(super) fn write(source: &mut dyn TriangleSource, job: &Job) -> Result<WriteReport> {
    let mut draft = Draft::create(job.path, job.options.existing)?;
    // Not `solid` at the start: readers take that for the text form.
    let title: Vec<u8> = format!("binary {}", source.name()).into_bytes();
    let mut header = [b' '; HEADER_BYTES + 4];
    let length = title.len().min(HEADER_BYTES);
    header[..length].copy_from_slice(&title[..length]);
    draft.write(&header)?;
    let (mut count, most, mut reach) = (0u64, u64::from(u32::MAX), 0.0f64);
    job.for_each_batch(source, "triangles", |_, batch| {
        count += batch.len() as u64;
        if count > most {
            return Err(job.too_many("triangles", count, most));
        }
        let coordinates = batch.corners.as_flattened().as_flattened();
        reach = coordinates.iter().fold(reach, |reach, coordinate| reach.max(coordinate.abs()));
        if reach > 1.0 {
            job.check_single(reach)?;
        }
        batch.corners.iter().try_for_each(|corners| draft.write(&record(corners)))
    })?;
    job.check_single(reach)?;
    draft.patch(HEADER_BYTES as u64, &(count as u32).to_le_bytes())?;
    let bytes = draft.finish()?.publish()?;
    Ok(WriteReport { triangle_count: count, bytes })
}

/// Normal, three corners, and a word of zero.
fn record(corners: &[[f64; 3]; 3]) -> [u8; TRIANGLE_BYTES] {
    let mut record = [0; TRIANGLE_BYTES];
    let [a, b, c] = corners;
    for (slot, vector) in [normal(corners), *a, *b, *c].iter().enumerate() {
        let bytes = vector.map(|value| (value as f32).to_le_bytes());
        record[12 * slot..12 * slot + 12].copy_from_slice(bytes.as_flattened());
    }
    record
}

/// Unit length, or zero where there is none.
fn normal([a, b, c]: &[[f64; 3]; 3]) -> [f64; 3] {
    let [u, v] = [b, c].map(|p| [0, 1, 2].map(|i| p[i] - a[i]));
    let cross = [1, 2, 0].map(|i| u[i] * v[(i + 1) % 3] - u[(i + 1) % 3] * v[i]);
    let length = cross.iter().map(|value| value * value).sum::<f64>().sqrt();
    if length > 0.0 && length.is_finite() { cross.map(|value| value / length) } else { [0.0; 3] }
}
