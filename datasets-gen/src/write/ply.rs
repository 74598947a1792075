//! PLY, binary little endian: `vertex` (x y z, also nx ny nz, red green blue) and `face` (uchar 3, three uint).
//!
//! All vertices stand before all faces, and the header tells their counts. The stream runs three times
//! (count, vertices, faces), which needs neither memory nor scratch space, and a generator is several times
//! faster than a disk.

use super::window::{Window, WindowEntry, WindowVertex};
use super::{Draft, Job, WriteReport};
use trex_store::cluster::{Normal, WHITE};
use trex_store::stated_lattice::comment;
use trex_store::{Result, TriangleSource};

/// What the first pass finds.
struct Survey {
    vertex_count: u64,
    triangle_count: u64,
    /// Every coordinate is an f32.
    single: bool,
    /// A corner is not white.
    is_coloured: bool,
    /// A corner has a normal.
    has_normals: bool,
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
        let numbers = format!("{} triangles, then {written}", survey.triangle_count);
        return Err(job.changed(&numbers));
    }
    let bytes = draft.finish()?.publish()?;
    Ok(WriteReport { triangle_count: written, bytes })
}

fn survey(source: &mut dyn TriangleSource, job: &Job) -> Result<Survey> {
    let (mut window, mut corner_count) = (Window::new(), 0);
    let (mut single, mut is_coloured, mut has_normals) = (true, false, false);
    job.for_each_corner(source, "survey", |vertex| {
        corner_count += 1;
        if let WindowEntry::New(_) = window.place(vertex) {
            let is_single = |value: &f64| f64::from(*value as f32).to_bits() == value.to_bits();
            single &= vertex.position.iter().all(is_single);
            is_coloured |= vertex.colour != WHITE;
            has_normals |= vertex.normal != Normal::NONE;
        }
        Ok(())
    })?;
    let (vertex_count, triangle_count) = (window.vertex_count(), corner_count / 3);
    Ok(Survey { vertex_count, triangle_count, single, is_coloured, has_normals })
}

fn header(source: &dyn TriangleSource, survey: &Survey) -> String {
    let real = if survey.single { "float" } else { "double" };
    // A comment is one line of ASCII.
    let name: String = source.name().chars().map(|c| if c.is_ascii_graphic() { c } else { '_' }).collect();
    let lattice = source.lattice().map(|lattice| format!("comment {}\n", comment(&lattice)));
    let lattice = lattice.unwrap_or_default();
    let colour = "property uchar red\nproperty uchar green\nproperty uchar blue\n";
    let colour = if survey.is_coloured { colour } else { "" };
    let normal = "property float nx\nproperty float ny\nproperty float nz\n";
    let normal = if survey.has_normals { normal } else { "" };
    format!(
        "ply\nformat binary_little_endian 1.0\ncomment {name}\n{lattice}element vertex {}\nproperty {real} x\n\
         property {real} y\nproperty {real} z\n{normal}{colour}element face {}\n\
         property list uchar uint vertex_indices\nend_header\n",
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
    job.for_each_corner(source, "vertices", |vertex| {
        if let WindowEntry::New(_) = window.place(vertex) {
            if survey.single {
                draft.write(vertex.position.map(|value| (value as f32).to_le_bytes()).as_flattened())?;
            } else {
                draft.write(vertex.position.map(f64::to_le_bytes).as_flattened())?;
            }
            if survey.has_normals {
                // A vertex without one has zeros, which have no direction.
                let normal = vertex.normal.vector().unwrap_or_default();
                draft.write(normal.map(f32::to_le_bytes).as_flattened())?;
            }
            if survey.is_coloured {
                draft.write(&vertex.colour)?;
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
            let vertices = WindowVertex::of_triangle(corners, &batch.attributes.of(index));
            for (slot, vertex) in vertices.into_iter().enumerate() {
                let index = window.place(vertex).index() as u32;
                face[1 + 4 * slot..5 + 4 * slot].copy_from_slice(&index.to_le_bytes());
            }
            draft.write(&face)?;
        }
        written += batch.len() as u64;
        Ok(())
    })?;
    Ok(written)
}
