//! Inputs of `build` and `info`: files and generators, opened as one stream of triangles.

use crate::args::AttributeArgs;
use crate::context::Context;
use crate::size;
use crate::values::Input;
use datasets_gen::{GenOptions, Spec};
use std::path::Path;
use trex_store::build::{self, InputSizes};
use trex_store::import::{self, Format, ImportOptions, MaterialNaming, TextureUse, VolumeOptions};
use trex_store::{
    AttributeSet, Budget, Chain, Code, CreasedSource, Error, RESERVE_BYTES, Result, TriangleSource,
};

/// Bytes of the vertex caches of inputs that are only counted.
const COUNTING_CACHE_BYTES: u64 = 1 << 20;
/// Most bytes of a vertex in a cache, with its share of the cache's lists.
const VERTEX_BYTES: u64 = 32;

/// What is read, in order, and how the volumes among it are.
#[derive(Clone, Copy)]
pub struct InputList<'a> {
    pub inputs: &'a [Input],
    pub volumes: &'a VolumeOptions,
    /// What corners lose.
    pub dropped: AttributeSet,
    /// Degrees up to which planes that meet are one smooth surface, where normals are made of the mesh.
    pub crease_deg: Option<f64>,
}

impl<'a> InputList<'a> {
    /// Inputs of which all is kept.
    pub fn whole(inputs: &'a [Input], volumes: &'a VolumeOptions) -> InputList<'a> {
        InputList { inputs, volumes, dropped: AttributeSet::default(), crease_deg: None }
    }

    /// Inputs of which as much is kept as is asked for.
    pub fn new(inputs: &'a [Input], volumes: &'a VolumeOptions, attributes: &AttributeArgs) -> InputList<'a> {
        let (dropped, crease_deg) = (attributes.dropped(), attributes.crease_deg());
        InputList { inputs, volumes, dropped, crease_deg }
    }

    /// What becomes of the attributes of corners, as facts of the input.
    pub fn attribute_facts(&self) -> impl Iterator<Item = (String, String)> {
        let dropped = [("colours", self.dropped.colours), ("normals", self.dropped.normals)];
        let dropped = dropped.into_iter().filter(|(_, is)| *is).map(|(name, _)| (name, "dropped".to_owned()));
        let creased = self.crease_deg.map(|degrees| ("normals", format!("from creases of {degrees}")));
        dropped.chain(creased).map(|(name, value)| (name.to_owned(), value))
    }

    /// Memory of making normals.
    pub fn crease_bytes(&self) -> u64 {
        self.crease_deg.map_or(0, |_| CreasedSource::smallest_bytes())
    }

    /// Refuses what is said of volumes where there are none.
    ///
    /// # Errors
    /// [`Code::Usage`].
    pub fn check(&self) -> Result<()> {
        let formats = || {
            self.inputs.iter().filter_map(|input| match input {
                Input::File(path) => Some(Format::of_path(path)),
                Input::Generated(_) => None,
            })
        };
        // The content decides where the ending says nothing.
        let has_volume = formats().any(|format| format.is_none_or(Format::is_volume));
        let refused = |flag: &str, endings: &str| {
            Err(Error::new(Code::Usage, format!("{flag} says nothing of these inputs"))
                .at_place(flag)
                .numbers(format!("{} inputs, none of them {endings}", self.inputs.len()))
                .next(format!("leave {flag} out, or name a volume")))
        };
        if !self.volumes.iso_values.is_empty() && !has_volume {
            return refused("--iso", "a volume: .nrrd, .nhdr, .mhd, .mha or .raw");
        }
        if self.volumes.raw.is_some() && !formats().any(|format| format == Some(Format::Raw)) {
            return refused("--size", "a .raw file");
        }
        Ok(())
    }
}

/// Opens all inputs as one source, and leaves `work_bytes` of the limit to what comes after; vertices that do not
/// fit go to scratch in `temp_dir`.
pub fn open(
    inputs: InputList<'_>,
    temp_dir: &Path,
    work_bytes: u64,
    ctx: &Context,
) -> Result<Box<dyn TriangleSource>> {
    inputs.check()?;
    let open_all = |budget: &Budget, caches_bytes: u64| {
        let reading = ReadOptions { budget, caches_bytes, naming: MaterialNaming::Names };
        open_all(inputs, temp_dir, &reading, ctx)
    };
    // Vertex caches fill while the files are read. All of them together take a quarter of the limit, and nothing of
    // what the sources' fixed parts and the work need.
    let mut caches_bytes = 0;
    if inputs.inputs.iter().any(|input| matches!(input, Input::File(_))) {
        let (ledger, free_bytes) = (Budget::unlimited(), ctx.budget.free_bytes());
        let _sources = open_all(&ledger, 0).map_err(|error| error.with_room(work_bytes))?;
        caches_bytes = (free_bytes / 4).min(free_bytes.saturating_sub(work_bytes + ledger.used_bytes()));
    }
    leaving(work_bytes, ctx, |budget| open_all(budget, caches_bytes))
}

/// How inputs are read.
struct ReadOptions<'a> {
    budget: &'a Budget,
    /// Most bytes of all vertex caches.
    caches_bytes: u64,
    naming: MaterialNaming,
}

fn open_all(
    inputs: InputList<'_>,
    temp_dir: &Path,
    reading: &ReadOptions<'_>,
    ctx: &Context,
) -> Result<Box<dyn TriangleSource>> {
    let ReadOptions { budget, caches_bytes, naming } = *reading;
    let InputList { inputs, volumes, dropped, .. } = inputs;
    let open_one = |input: &Input| match input {
        Input::Generated(text) => generate_in(&Spec::parse(text)?, budget, ctx),
        Input::File(path) => {
            let mut options = ImportOptions::new(budget.clone(), temp_dir);
            options.interrupt = ctx.interrupt.clone();
            options.vertex_cache_bytes = caches_bytes / inputs.len() as u64;
            options.naming = naming;
            options.volumes = volumes.clone();
            options.textures = if dropped.colours { TextureUse::Mean } else { TextureUse::Sampled };
            // Where the ledger only counts, the process still has its limit, of which other inputs have taken their
            // part.
            let is_counting = budget.limit_bytes() > ctx.budget.limit_bytes();
            let counted_bytes = if is_counting { budget.used_bytes() } else { 0 };
            options.held_bytes = ctx.budget.free_bytes().saturating_sub(counted_bytes);
            import::open(path, &options)
        }
    };
    let sources: Result<Vec<_>> = inputs.iter().map(open_one).collect();
    Chain::from_sources(sources?, budget)
}

/// The error of a build of these inputs. Where the limit has no room for it, the inputs are read once more, to name the
/// limit that has room for all of the build: each lease alone knows only of those before it, and what materials,
/// emitters and tables take is known at the end of the stream.
pub fn with_smallest_limit(error: Error, inputs: InputList<'_>, temp_dir: &Path, ctx: &Context) -> Error {
    if error.code() != Code::MemoryLimit {
        return error;
    }
    match smallest_limit(inputs, temp_dir, ctx) {
        Ok((name, smallest)) if smallest > ctx.budget.limit_bytes() => {
            // The build may know of more.
            let smallest = smallest.max(error.smallest_limit_bytes().unwrap_or(0));
            let made = Error::new(Code::MemoryLimit, "the memory limit has no room for this build")
                .at_place(name)
                .numbers(format!(
                    "limit {}, {} needed: {} reserved for the process, {} to read and to work",
                    size::bytes(ctx.budget.limit_bytes()),
                    size::bytes(smallest),
                    size::bytes(RESERVE_BYTES),
                    size::bytes(smallest - RESERVE_BYTES)
                ))
                .next(format!("--memory-limit {}MiB or more, or fewer --threads", smallest.div_ceil(1 << 20)))
                .smallest_limit(smallest);
            match error.kept_bytes() {
                Some(bytes) => made.keeping(bytes),
                None => made,
            }
        }
        _ => error,
    }
}

/// A limit that does for a build of these inputs, and what they are called. Nothing is held of them but counts.
fn smallest_limit(inputs: InputList<'_>, temp_dir: &Path, ctx: &Context) -> Result<(String, u64)> {
    let opened_bytes = {
        let ledger = Budget::unlimited();
        let reading = ReadOptions { budget: &ledger, caches_bytes: 0, naming: MaterialNaming::Names };
        let _source = open_all(inputs, temp_dir, &reading, ctx)?;
        ledger.used_bytes()
    };
    let ledger = Budget::unlimited();
    let reading =
        ReadOptions { budget: &ledger, caches_bytes: COUNTING_CACHE_BYTES, naming: MaterialNaming::Hashes };
    let mut source = open_all(inputs, temp_dir, &reading, ctx)?;
    let sizes = InputSizes::of(&mut *source, &ctx.interrupt)?;
    let vertex_bytes = sizes.vertex_count * VERTEX_BYTES;
    // Several inputs have a list of all materials beside their own.
    let joined_bytes = if inputs.inputs.len() > 1 { sizes.name_bytes } else { 0 };
    let read_bytes =
        ledger.peak_bytes().saturating_sub(vertex_bytes.min(COUNTING_CACHE_BYTES)) + joined_bytes;
    let needed = read_bytes + inputs.crease_bytes() + build::smallest_bytes_for(&sizes);
    let least = opened_bytes + inputs.crease_bytes() + build::smallest_bytes();
    let smallest = if needed <= least {
        least
    } else {
        // Vertex caches take what is free when the inputs are opened: up to a quarter, and no more than there are
        // vertices.
        (needed + vertex_bytes).min(needed + needed.div_ceil(3))
    };
    Ok((source.name(), RESERVE_BYTES + smallest))
}

/// Opens a generator, and leaves `work_bytes` of the limit to what comes after.
pub fn generate(spec: &Spec, work_bytes: u64, ctx: &Context) -> Result<Box<dyn TriangleSource>> {
    leaving(work_bytes, ctx, |budget| generate_in(spec, budget, ctx))
}

fn generate_in(spec: &Spec, budget: &Budget, ctx: &Context) -> Result<Box<dyn TriangleSource>> {
    let options =
        GenOptions { threads: ctx.threads, budget: budget.clone(), interrupt: ctx.interrupt.clone() };
    datasets_gen::open(spec, &options)
}

/// Opens a source under the limit of `ctx`. Where the limit has no room for it and `work_bytes` more, the error
/// names the limit that has: each lease alone knows only of those before it.
fn leaving(
    work_bytes: u64,
    ctx: &Context,
    open: impl Fn(&Budget) -> Result<Box<dyn TriangleSource>>,
) -> Result<Box<dyn TriangleSource>> {
    match open(&ctx.budget) {
        Ok(source) if ctx.budget.free_bytes() >= work_bytes => return Ok(source),
        Ok(_) => {}
        Err(error) if error.code() == Code::MemoryLimit => {}
        Err(error) => return Err(error),
    }
    let ledger = Budget::unlimited();
    let source = open(&ledger).map_err(|error| error.with_room(work_bytes))?;
    let smallest = RESERVE_BYTES + ledger.used_bytes() + work_bytes;
    Err(Error::new(Code::MemoryLimit, "the memory limit has no room for this work")
        .at_place(source.name())
        .numbers(format!(
            "limit {}, {} needed: {} reserved for the process, {} to read, {} to work",
            size::bytes(ctx.budget.limit_bytes()),
            size::bytes(smallest),
            size::bytes(RESERVE_BYTES),
            size::bytes(ledger.used_bytes()),
            size::bytes(work_bytes)
        ))
        .next(format!("--memory-limit {}MiB or more, or fewer --threads", smallest.div_ceil(1 << 20)))
        .smallest_limit(smallest))
}
