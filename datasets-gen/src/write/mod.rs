//! Writes any `TriangleSource` to a mesh file, as a stream: `.ply` (binary, little endian), `.stl` (binary),
//! `.obj` with its `.mtl`, `.glb` (glTF 2.0).
//!
//! ```text
//!   temporary file beside the output -> write -> fsync -> rename -> fsync of the folder
//! ```
//!
//! Invariants: 1. the output appears whole or not at all; on an error or an interrupt nothing is left behind;
//! 2. an existing output is refused unless [`ExistingOutput::Replace`]; 3. memory is bounded and leased: buffers and
//! one window of recent vertices, or the parts of a batch; 4. coordinates are written without loss, except to `.stl`,
//! which has f32 only, and to `.glb` where they lie on no lattice; 5. materials go to `.obj` and `.glb`, colours and
//! normals to all but `.stl`; 6. the lattice of a source that knows it stands in a comment of `.ply` and `.obj`, and in
//! the generator of `.glb`.

mod glb;
mod obj;
mod ply;
mod stl;
mod window;

pub use trex_store::output::ExistingOutput;

use window::WindowVertex;

use std::fmt::{self, Write as _};
use std::fs::File;
use std::io::{BufWriter, Seek, SeekFrom, Write};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use tempfile::NamedTempFile;
use trex_store::output::{draft, folder_of};
use trex_store::{
    AttributeSet, Budget, Code, Error, Interrupt, MaterialList, NextStep, Progress, Report, Result,
    TriangleBatch, TriangleSource,
};

/// How to write.
#[derive(Clone)]
pub struct WriteOptions<'a> {
    /// What to do when the output exists.
    pub existing: ExistingOutput,
    /// Where the writer's memory is leased.
    pub budget: Budget,
    /// Stops the work.
    pub interrupt: Interrupt,
    /// What to do where the format cannot hold the mesh.
    pub too_large: NextStep,
    /// Receives progress.
    pub report: Option<Report<'a>>,
}

impl Default for WriteOptions<'_> {
    /// Refuse, no limit, no report.
    fn default() -> Self {
        WriteOptions {
            existing: ExistingOutput::Keep,
            budget: Budget::unlimited(),
            interrupt: Interrupt::default(),
            too_large: NextStep::BuildFromGenerator,
            report: None,
        }
    }
}

/// What has been written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriteReport {
    /// Triangles in the file.
    pub triangle_count: u64,
    /// Bytes of all files written.
    pub bytes: u64,
}

/// How far a mesh of singles reaches, model units: below, vertices of a lattice of 24 bits would be rounded.
const SINGLES: RangeInclusive<f64> = f32::MIN_POSITIVE as f64 * (1 << 24) as f64..=f32::MAX as f64;
/// A buffer large enough that writes are sequential for any disk.
const BUFFER_BYTES: usize = 1 << 20;
/// Time between reports.
const REPORT_EVERY: Duration = Duration::from_millis(100);

/// Writes `source`, from its first triangle, to `path`; the ending of the name chooses the format.
///
/// # Errors
/// `Code::Usage` for an unknown ending, an existing output, or more than the format can hold;
/// `Code::DiskFull`, `Code::Io`; what the source says; `Code::Interrupted`; `Code::MemoryLimit`.
pub fn write(source: &mut dyn TriangleSource, path: &Path, options: &WriteOptions) -> Result<WriteReport> {
    let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
    let job = Job { path, options };
    match ending.as_deref() {
        Some("ply") => ply::write(source, &job),
        Some("stl") => stl::write(source, &job),
        Some("obj") => obj::write(source, &job),
        Some("glb") => glb::write(source, &job),
        _ => Err(Error::new(Code::Usage, "the output's name does not say which mesh format to write")
            .at(path)
            .next("end the name in .ply, .obj, .glb or .stl")),
    }
}

/// Bytes that [`write()`] leases for a file of this name of a generated mesh, beside what its source has leased.
pub fn smallest_bytes(path: &Path) -> u64 {
    let is = |format: &str| path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case(format));
    let window = match () {
        () if is("stl") => 0,
        () if is("glb") => glb::BYTES,
        () => window::Window::BYTES,
    };
    let words = if is("obj") { obj::words_bytes(crate::MATERIALS_MAX) + obj::NORMALS_BYTES } else { 0 };
    TriangleBatch::bytes(AttributeSet::default()) + window + words
}

/// What every format needs.
struct Job<'a> {
    path: &'a Path,
    options: &'a WriteOptions<'a>,
}

impl Job<'_> {
    /// Hands every corner of the source to `visit`.
    fn for_each_corner(
        &self,
        source: &mut dyn TriangleSource,
        phase: &'static str,
        mut visit: impl FnMut(WindowVertex) -> Result<()>,
    ) -> Result<()> {
        self.for_each_batch(source, phase, |_, batch| {
            for (index, corners) in batch.corners.iter().enumerate() {
                WindowVertex::of_triangle(corners, &batch.attributes.of(index))
                    .into_iter()
                    .try_for_each(&mut visit)?;
            }
            Ok(())
        })
    }

    /// Hands every batch of the source to `visit`, with the materials met so far.
    fn for_each_batch(
        &self,
        source: &mut dyn TriangleSource,
        phase: &'static str,
        mut visit: impl FnMut(&MaterialList, &TriangleBatch) -> Result<()>,
    ) -> Result<()> {
        let _lease =
            self.options.budget.lease("the writer's batch", TriangleBatch::bytes(source.attributes()))?;
        source.rewind()?;
        // Files do not know their triangles before, but their bytes.
        let hint = source.hint();
        let (mut batch, mut done, mut reported) = (TriangleBatch::default(), 0, Instant::now());
        while source.next_batch(&mut batch)? {
            self.options.interrupt.check()?;
            visit(source.materials(), &batch)?;
            done += batch.len() as u64;
            if let Some(report) = self.options.report
                && reported.elapsed() > REPORT_EVERY
            {
                reported = Instant::now();
                let memory_bytes = self.options.budget.used_bytes();
                let (done, total, unit) = match hint {
                    Some(hint) => (done, hint.triangle_count, "triangles"),
                    None => (source.stats().bytes_read, source.stats().bytes_total, "bytes"),
                };
                report(Progress { phase, done, total, unit, memory_bytes });
            }
        }
        Ok(())
    }

    /// The error of a source that gives something else when it runs again.
    fn changed(&self, numbers: &str) -> Error {
        Error::new(Code::InputFormat, "the source gave other triangles when read again")
            .at(self.path)
            .numbers(numbers)
            .next("do not change the input while it is read")
    }

    /// The error of a format that cannot hold this many of something.
    fn too_many(&self, what: &str, count: u64, most: u64) -> Error {
        Error::new(Code::Usage, format!("too many {what} for this format"))
            .at(self.path)
            .numbers(format!("{count}, and {most} at most"))
            .next(self.options.too_large.clone())
    }

    /// Refuses what a format of single precision would write as infinite or round to nothing: a mesh, or a part of one,
    /// that reaches so far, model units.
    fn check_single(&self, reach: f64) -> Result<()> {
        if reach == 0.0 || SINGLES.contains(&reach) {
            return Ok(());
        }
        let [least, most] = [SINGLES.start(), SINGLES.end()];
        Err(Error::new(Code::Usage, "the single precision of this format cannot hold the mesh")
            .at(self.path)
            .numbers(format!("it reaches {reach:.3e} units far; from {least:.0e} to {most:.0e} can be held"))
            .next("end the name in .ply or .obj, which hold doubles"))
    }
}

fn push(text: &mut String, arguments: fmt::Arguments) {
    text.write_fmt(arguments).expect("a String takes all text");
}

/// A file that is not there yet.
struct Draft {
    out: BufWriter<NamedTempFile>,
    path: PathBuf,
    existing: ExistingOutput,
}

impl Draft {
    /// Opens the temporary file beside `path`.
    fn create(path: &Path, existing: ExistingOutput) -> Result<Draft> {
        existing.check(path)?;
        let file = draft(path).map_err(|error| Error::writing("create the output", path, &error))?;
        Ok(Draft { out: BufWriter::with_capacity(BUFFER_BYTES, file), path: path.to_path_buf(), existing })
    }

    fn write(&mut self, bytes: &[u8]) -> Result<()> {
        self.out.write_all(bytes).map_err(|error| Error::writing("write the output", &self.path, &error))
    }

    /// Overwrites bytes from `offset` on.
    fn patch(&mut self, offset: u64, bytes: &[u8]) -> Result<()> {
        let mut run = || {
            self.out.seek(SeekFrom::Start(offset))?;
            self.out.write_all(bytes)?;
            self.out.seek(SeekFrom::End(0))
        };
        run().map(drop).map_err(|error| Error::writing("write the output", &self.path, &error))
    }

    /// Everything to the disk, under the temporary name. The count of bytes.
    fn finish(self) -> Result<CompleteFile> {
        let Draft { out, path, existing } = self;
        let failed = |error: &std::io::Error| Error::writing("write the output", &path, error);
        let file = out.into_inner().map_err(|error| failed(error.error()))?;
        file.as_file().sync_all().map_err(|error| failed(&error))?;
        let bytes = file.as_file().metadata().map_err(|error| failed(&error))?.len();
        Ok(CompleteFile { file, path, existing, bytes })
    }
}

/// A complete file that waits for its name.
struct CompleteFile {
    file: NamedTempFile,
    path: PathBuf,
    existing: ExistingOutput,
    bytes: u64,
}

impl CompleteFile {
    /// Gives the file its name. Bytes of the file.
    fn publish(self) -> Result<u64> {
        let kept = match self.existing {
            ExistingOutput::Replace => self.file.persist(&self.path),
            ExistingOutput::Keep => self.file.persist_noclobber(&self.path),
        };
        kept.map_err(|error| match error.error.kind() {
            std::io::ErrorKind::AlreadyExists => ExistingOutput::exists(&self.path),
            _ => Error::writing("name the output", &self.path, &error.error),
        })?;
        File::open(folder_of(&self.path))
            .and_then(|folder| folder.sync_all())
            .map_err(|error| Error::writing("sync the output's folder", &self.path, &error))?;
        Ok(self.bytes)
    }
}
