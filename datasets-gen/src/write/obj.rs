//! OBJ as text, with `usemtl`, and a sibling `.mtl` of the same stem (`Kd Ks Ns Ke d illum`).
//!
//! Numbers are the shortest text that reads back as the same value. The `.mtl` gets its name first, so that an
//! `.obj` never stands without its materials.

use super::window::{Window, WindowEntry};
use super::{Draft, Job, WriteReport};
use std::fmt::Write;
use trex_store::{MaterialList, Result, TriangleSource};

pub(super) fn write(source: &mut dyn TriangleSource, job: &Job) -> Result<WriteReport> {
    let library = job.path.with_extension("mtl");
    let mut draft = Draft::create(job.path, job.options.existing)?;
    let mut materials = Draft::create(&library, job.options.existing)?;
    let _lease = job.options.budget.lease("the writer's vertex window", Window::BYTES)?;
    let library_name = library.file_name().unwrap_or_default().to_string_lossy();
    draft.write(format!("# {}\nmtllib {library_name}\n", one_word(&source.name())).as_bytes())?;
    let triangle_count = write_triangles(source, job, &mut draft)?;
    materials.write(materials_text(source.materials()).as_bytes())?;
    let (draft, materials) = (draft.finish()?, materials.finish()?);
    let bytes = materials.publish()? + draft.publish()?;
    Ok(WriteReport { triangle_count, bytes })
}

fn write_triangles(source: &mut dyn TriangleSource, job: &Job, draft: &mut Draft) -> Result<u64> {
    let (mut window, mut count, mut current) = (Window::new(), 0, None);
    let mut text = String::new();
    let mut names = Vec::new();
    job.for_each_batch(source, "triangles", |materials, batch| {
        // A source knows the materials of a batch when it hands it out.
        for index in names.len()..materials.len() {
            names.push(material_name(materials, index));
        }
        for (corners, &material) in batch.corners.iter().zip(&batch.material) {
            text.clear();
            if current != Some(material) {
                current = Some(material);
                push(&mut text, format_args!("usemtl {}\n", names[material as usize]));
            }
            let indices = corners.map(|corner| {
                let place = window.place(corner);
                if let WindowEntry::New(_) = place {
                    push_vertex(&mut text, corner);
                }
                place.index() + 1
            });
            push(&mut text, format_args!("f {} {} {}\n", indices[0], indices[1], indices[2]));
            draft.write(text.as_bytes())?;
        }
        count += batch.len() as u64;
        Ok(())
    })?;
    Ok(count)
}

fn push_vertex(text: &mut String, corner: [f64; 3]) {
    text.push('v');
    for value in corner {
        let single = value as f32;
        if f64::from(single) == value {
            push(text, format_args!(" {single}"));
        } else {
            push(text, format_args!(" {value}"));
        }
    }
    text.push('\n');
}

fn materials_text(materials: &MaterialList) -> String {
    let mut text = String::new();
    for (index, material) in materials.iter().enumerate() {
        let rgb = |[r, g, b]: [f32; 3]| format!("{r} {g} {b}");
        // 3: mirror; 2: diffuse and glossy; 1: diffuse.
        let illum = match material {
            material if material.mirror => 3,
            material if material.ks.iter().any(|&value| value > 0.0) => 2,
            _ => 1,
        };
        push(
            &mut text,
            format_args!(
                "newmtl {}\nKd {}\nKs {}\nNs {}\nKe {}\nd {}\nillum {illum}\n\n",
                material_name(materials, index),
                rgb(material.kd),
                rgb(material.ks),
                material.ns,
                rgb(material.ke),
                material.d,
            ),
        );
    }
    text
}

/// The name as one word; of two materials with the same word the later one gets its index too.
fn material_name(materials: &MaterialList, index: usize) -> String {
    let word = one_word(materials.name(index));
    let taken = materials.names().iter().take(index).any(|earlier| one_word(earlier) == word);
    if taken || word.is_empty() { format!("{word}.{index}") } else { word }
}

/// Without blanks and control characters, which would end a line or a word.
fn one_word(name: &str) -> String {
    name.chars().map(|c| if c.is_whitespace() || c.is_control() { '_' } else { c }).collect()
}

fn push(text: &mut String, arguments: std::fmt::Arguments) {
    text.write_fmt(arguments).expect("a String takes all text");
}
