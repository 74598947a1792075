//! PLY, binary little endian: `vertex` (x y z, also red green blue) and `face` (uchar 3, three uint).
//!
//! All vertices stand before all faces, and the header tells their counts. The stream runs three times
//! (count, vertices, faces), which needs neither memory nor scratch space, and a generator is several times
//! faster than a disk.

use super::window::{Window, WindowEntry};
use super::{Draft, Job, WriteReport};
use trex_store::cluster::WHITE;
use trex_store::stated_lattice::comment;
use trex_store::{Code, Error, Result, TriangleSource};

/// What the first pass finds.
struct Survey {
    vertex_count: u64,
    triangle_count: u64,
    /// Every coordinate is an f32.
    single: bool,
    /// A corner is not white.
    is_coloured: bool,
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
    let (mut window, mut corner_count, mut single, mut is_coloured) = (Window::new(), 0, true, false);
    job.for_each_corner(source, "survey", |corner, colour| {
        corner_count += 1;
        if let WindowEntry::New(_) = window.place(corner, colour) {
            single &= corner.iter().all(|&value| f64::from(value as f32).to_bits() == value.to_bits());
            is_coloured |= colour != WHITE;
        }
        Ok(())
    })?;
    let (vertex_count, triangle_count) = (window.vertex_count(), corner_count / 3);
    Ok(Survey { vertex_count, triangle_count, single, is_coloured })
}

fn header(source: &dyn TriangleSource, survey: &Survey) -> String {
    let real = if survey.single { "float" } else { "double" };
    // A comment is one line of ASCII.
    let name: String = source.name().chars().map(|c| if c.is_ascii_graphic() { c } else { '_' }).collect();
    let lattice = source.lattice().map(|lattice| format!("comment {}\n", comment(&lattice)));
    let lattice = lattice.unwrap_or_default();
    let colour = "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    let colour = if survey.is_coloured { colour } else { "" };
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment {name}\n{lattice}element vertex {}\nproperty {real} x\n\
         property {real} y\nproperty {real} z\n{colour}element face {}\nproperty list uchar uint vertex_indices\n\
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
    job.for_each_corner(source, "vertices", |corner, colour| {
        if let WindowEntry::New(_) = window.place(corner, colour) {
            if survey.single {
                draft.write(corner.map(|value| (value as f32).to_le_bytes()).as_flattened())?;
            } else {
                draft.write(corner.map(f64::to_le_bytes).as_flattened())?;
            }
            if survey.is_coloured {
                draft.write(&colour)?;
            }
        }
        Ok(())
    })
}

fn write_faces(source: &mut dyn TriangleSource, job: &Job, draft: &mut Draft) -> Result<u64> {
    let (mut window, mut written) = (Window::new(), 0);
    job.for_each_batch(source, "faces", |_, batch| {
        for (index, corners) in batch.corners.iter().enumerate() {
            let mut face = [3u8; 13];
            for (slot, (&corner, colour)) in corners.iter().zip(batch.colours_of(index)).enumerate() {
                let index = window.place(corner, colour).index() as u32;
                face[1 + 4 * slot..5 + 4 * slot].copy_from_slice(&index.to_le_bytes());
            }
            draft.write(&face)?;
        }
        written += batch.len() as u64;
        Ok(())
    })?;
    Ok(written)
}
