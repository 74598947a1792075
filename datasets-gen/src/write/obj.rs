//! OBJ as text, with `usemtl`, and a sibling `.mtl` of the same stem (`Kd Ks Ns Ke d illum`).
//!
//! Numbers are the shortest text that reads back as the same value: in single precision where they are of that, but in
//! double where vertices lie on a lattice, since a reader of doubles would find others beside it. The `.mtl` gets its
//! name first, so that an `.obj` never stands without its materials.

use super::window::{Window, WindowEntry, WindowVertex};
use super::{Draft, Job, WriteReport, push};
use std::collections::HashSet;
use std::hash::{DefaultHasher, Hash, Hasher};
use trex_store::cluster::{Colour, Normal, WHITE};
use trex_store::stated_lattice::comment;
use trex_store::{Lease, MaterialList, Result, TriangleSource};

/// What the list of words is called in messages.
const MATERIAL_WORDS: &str = "the names of materials as words";

pub(super) fn write(source: &mut dyn TriangleSource, job: &Job) -> Result<WriteReport> {
    let library = job.path.with_extension("mtl");
    let mut draft = Draft::create(job.path, job.options.existing)?;
    let mut materials = Draft::create(&library, job.options.existing)?;
    let _lease = job.options.budget.lease("the writer's vertex window", Window::BYTES + NORMALS_BYTES)?;
    let library_name = library.file_name().unwrap_or_default().to_string_lossy();
    draft.write(format!("# {}\n", one_word(&source.name())).as_bytes())?;
    if let Some(lattice) = source.lattice() {
        draft.write(format!("# {}\n", comment(&lattice)).as_bytes())?;
    }
    draft.write(format!("mtllib {library_name}\n").as_bytes())?;
    let triangle_count = write_triangles(source, job, &mut draft)?;
    write_materials(source.materials(), job, &mut materials)?;
    let (draft, materials) = (draft.finish()?, materials.finish()?);
    let bytes = materials.publish()? + draft.publish()?;
    Ok(WriteReport { triangle_count, bytes })
}

fn write_triangles(source: &mut dyn TriangleSource, job: &Job, draft: &mut Draft) -> Result<u64> {
    let (mut window, mut normals) = (Window::new(), NormalWindow::new());
    let (mut count, mut current) = (0, None);
    let mut text = String::new();
    let precision = if source.lattice().is_some() { TextPrecision::Double } else { TextPrecision::Shortest };
    let mut words = MaterialWords::new(job)?;
    job.for_each_batch(source, "triangles", |materials, batch| {
        // A source knows the materials of a batch when it hands it out.
        words.extend(materials)?;
        for (at, (corners, &material)) in batch.corners.iter().zip(&batch.material).enumerate() {
            let vertices = WindowVertex::of_triangle(corners, &batch.attributes.of(at));
            text.clear();
            if current != Some(material) {
                current = Some(material);
                push(&mut text, format_args!("usemtl {}\n", words.name(materials, material as usize)));
            }
            let words = vertices.map(|vertex| {
                let place = window.place(vertex);
                if let WindowEntry::New(_) = place {
                    push_vertex(&mut text, vertex.position, precision);
                    push_colour(&mut text, vertex.colour);
                }
                (place.index() + 1, normals.place(vertex.normal, &mut text))
            });
            text.push('f');
            for (vertex, normal) in words {
                match normal {
                    Some(normal) => push(&mut text, format_args!(" {vertex}//{normal}")),
                    None => push(&mut text, format_args!(" {vertex}")),
                }
            }
            text.push('\n');
            draft.write(text.as_bytes())?;
        }
        count += batch.len() as u64;
        Ok(())
    })?;
    Ok(count)
}

/// Slots for normals, each overwritten by the next that falls there.
const NORMAL_SLOTS: usize = 1 << 12;
/// Bytes of the slots.
pub(super) const NORMALS_BYTES: u64 = (NORMAL_SLOTS * size_of::<(Normal, u64)>()) as u64;

/// The `vn` rows of the normals met of late: finds the number of one.
struct NormalWindow {
    slots: Vec<(Normal, u64)>,
    count: u64,
}

impl NormalWindow {
    fn new() -> NormalWindow {
        NormalWindow { slots: vec![(Normal::NONE, 0); NORMAL_SLOTS], count: 0 }
    }

    /// The number of the row of a normal, which is added to `text` where it is not there; `None` for no normal.
    fn place(&mut self, normal: Normal, text: &mut String) -> Option<u64> {
        let [x, y, z] = normal.vector()?;
        let mut hasher = DefaultHasher::new();
        normal.hash(&mut hasher);
        let slot = &mut self.slots[hasher.finish() as usize % NORMAL_SLOTS];
        if slot.0 != normal {
            self.count += 1;
            *slot = (normal, self.count);
            push(text, format_args!("vn {x:.5} {y:.5} {z:.5}\n"));
        }
        Some(slot.1)
    }
}

/// As what numbers read back as they were.
#[derive(Clone, Copy, PartialEq)]
enum TextPrecision {
    /// As doubles.
    Double,
    /// As singles, where they are singles.
    Shortest,
}

fn push_vertex(text: &mut String, corner: [f64; 3], precision: TextPrecision) {
    text.push('v');
    for value in corner {
        let single = value as f32;
        if precision == TextPrecision::Shortest && f64::from(single) == value {
            push(text, format_args!(" {single}"));
        } else {
            push(text, format_args!(" {value}"));
        }
    }
}

/// The colour behind a vertex, which white does not need, and the end of the line.
fn push_colour(text: &mut String, colour: Colour) {
    if colour != WHITE {
        colour.iter().for_each(|&channel| push(text, format_args!(" {:.4}", f64::from(channel) / 255.0)));
    }
    text.push('\n');
}

fn write_materials(materials: &MaterialList, job: &Job, draft: &mut Draft) -> Result<()> {
    let mut words = MaterialWords::new(job)?;
    words.extend(materials)?;
    for (index, material) in materials.iter().enumerate() {
        let rgb = |[r, g, b]: [f32; 3]| format!("{r} {g} {b}");
        // 3: mirror; 2: diffuse and glossy; 1: diffuse.
        let illum = match material {
            material if material.mirror => 3,
            material if material.ks.iter().any(|&value| value > 0.0) => 2,
            _ => 1,
        };
        let text = format!(
            "newmtl {}\nKd {}\nKs {}\nNs {}\nKe {}\nd {}\nillum {illum}\n\n",
            words.name(materials, index),
            rgb(material.kd),
            rgb(material.ks),
            material.ns,
            rgb(material.ke),
            material.d,
        );
        draft.write(text.as_bytes())?;
    }
    Ok(())
}

/// The names of materials as words of the file, each of one material: of two with the same word the later one gets a
/// number too, its index or the next that makes it a new word.
struct MaterialWords {
    /// Hashes of the words so far.
    words: HashSet<u64>,
    /// What stands behind the word of each material, or [`NO_NUMBER`].
    numbers: Vec<u32>,
    lease: Lease,
}

const NO_NUMBER: u32 = u32::MAX;

/// Bytes of a material in [`MaterialWords`], whose set is half empty at worst, and is copied when it grows.
const WORD_BYTES: u64 = 50;

/// Bytes of the words of so many materials.
pub(super) fn words_bytes(materials: usize) -> u64 {
    materials as u64 * WORD_BYTES
}

impl MaterialWords {
    fn new(job: &Job) -> Result<MaterialWords> {
        let lease = job.options.budget.lease(MATERIAL_WORDS, 0)?;
        Ok(MaterialWords { words: HashSet::new(), numbers: Vec::new(), lease })
    }

    /// Takes in the materials that were not there before.
    fn extend(&mut self, materials: &MaterialList) -> Result<()> {
        let first = self.numbers.len();
        self.lease.grow(MATERIAL_WORDS, words_bytes(materials.len() - first))?;
        for index in first..materials.len() {
            let word = one_word(materials.name(index));
            let is_free = !word.is_empty() && self.is_new(&word);
            let number = if is_free { NO_NUMBER } else { self.new_number(&word, index as u32) };
            self.numbers.push(number);
        }
        Ok(())
    }

    /// The first number from `from` on that makes a new word of `word`, which is taken in.
    fn new_number(&mut self, word: &str, from: u32) -> u32 {
        let mut numbers = from..NO_NUMBER;
        numbers.find(|number| self.is_new(&format!("{word}.{number}"))).unwrap_or(NO_NUMBER)
    }

    /// Takes a word in; whether it was not there.
    fn is_new(&mut self, word: &str) -> bool {
        let mut hasher = DefaultHasher::new();
        word.hash(&mut hasher);
        self.words.insert(hasher.finish())
    }

    /// The name of a material as one word.
    fn name(&self, materials: &MaterialList, index: usize) -> String {
        let word = one_word(materials.name(index));
        match self.numbers[index] {
            NO_NUMBER => word,
            number => format!("{word}.{number}"),
        }
    }
}

/// Without blanks and control characters, which would end a line or a word.
fn one_word(name: &str) -> String {
    name.chars().map(|c| if c.is_whitespace() || c.is_control() { '_' } else { c }).collect()
}
