//! PLY, binary little endian: `vertex` (x y z) and `face` (uchar 3, three uint).
//!
//! All vertices stand before all faces, and the header tells their counts. The stream runs three times
//! (count, vertices, faces), which needs neither memory nor scratch space, and a generator is several times
//! faster than a disk.

use super::window::{Window, WindowEntry};
use super::{Draft, Job, WriteReport};
use trex_store::stated_lattice::comment;
use trex_store::{Code, Error, Result, TriangleSource};

/// What the first pass finds.
struct Survey {
    vertex_count: u64,
    triangle_count: u64,
    /// Every coordinate is an f32.
    single: bool,
}

pub(super) fn write(source: &mut dyn TriangleSource, job: &Job) -> Result<WriteReport> {
    let mut draft = Draft::create(job.path, job.options.existing)?;
    let _lease = job.options.budget.lease("the writer's vertex window", Window::BYTES)?;
    let survey = survey(source, job)?;
    let most = u64::from(u32::MAX);
    if survey.vertex_count > most {
        return Err(job.too_many("vertices", survey.vertex_count, most));
    }
    draft.write(header(source, &survey).as_bytes())?;
    write_vertices(source, job, &survey, &mut draft)?;
    let written = write_faces(source, job, &mut draft)?;
    if written != survey.triangle_count {
        return Err(Error::new(Code::InputFormat, "the source gave other triangles when read again")
            .at(job.path)
            .numbers(format!("{} triangles, then {written}", survey.triangle_count))
            .next("do not change the input while it is read"));
    }
    let bytes = draft.finish()?.publish()?;
    Ok(WriteReport { triangle_count: written, bytes })
}

fn survey(source: &mut dyn TriangleSource, job: &Job) -> Result<Survey> {
    let (mut window, mut triangle_count, mut single) = (Window::new(), 0, true);
    job.for_each_batch(source, "survey", |_, batch| {
        triangle_count += batch.len() as u64;
        for &corner in batch.corners.as_flattened() {
            if let WindowEntry::New(_) = window.place(corner) {
                single &= corner.iter().all(|&value| f64::from(value as f32).to_bits() == value.to_bits());
            }
        }
        Ok(())
    })?;
    Ok(Survey { vertex_count: window.vertex_count(), triangle_count, single })
}

fn header(source: &dyn TriangleSource, survey: &Survey) -> String {
    let real = if survey.single { "float" } else { "double" };
    // A comment is one line of ASCII.
    let name: String = source.name().chars().map(|c| if c.is_ascii_graphic() { c } else { '_' }).collect();
    let lattice = source.lattice().map(|lattice| format!("comment {}\n", comment(&lattice)));
    let lattice = lattice.unwrap_or_default();
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment {name}\n{lattice}element vertex {}\nproperty {real} x\n\
         property {real} y\nproperty {real} z\nelement face {}\nproperty list uchar uint vertex_indices\n\
         end_header\n",
        survey.vertex_count, survey.triangle_count
    )
}

fn write_vertices(
    source: &mut dyn TriangleSource,
    job: &Job,
    survey: &Survey,
    draft: &mut Draft,
) -> Result<()> {
    let mut window = Window::new();
    job.for_each_batch(source, "vertices", |_, batch| {
        for &corner in batch.corners.as_flattened() {
            if let WindowEntry::New(_) = window.place(corner) {
                if survey.single {
                    draft.write(corner.map(|value| (value as f32).to_le_bytes()).as_flattened())?;
                } else {
                    draft.write(corner.map(f64::to_le_bytes).as_flattened())?;
                }
            }
        }
        Ok(())
    })
}

fn write_faces(source: &mut dyn TriangleSource, job: &Job, draft: &mut Draft) -> Result<u64> {
    let (mut window, mut written) = (Window::new(), 0);
    job.for_each_batch(source, "faces", |_, batch| {
        for corners in &batch.corners {
            let mut face = [3u8; 13];
            for (slot, &corner) in corners.iter().enumerate() {
                let index = window.place(corner).index() as u32;
                face[1 + 4 * slot..5 + 4 * slot].copy_from_slice(&index.to_le_bytes());
            }
            draft.write(&face)?;
        }
        written += batch.len() as u64;
        Ok(())
    })?;
    Ok(written)
}
