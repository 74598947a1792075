//! Inputs of `build` and `info`: files and generators, opened as one stream of triangles.

use crate::context::Context;
use crate::size;
use crate::values::Input;
use datasets_gen::{GenOptions, Spec};
use std::path::Path;
use trex_store::import::{self, ImportOptions};
use trex_store::{Budget, Chain, Code, Error, RESERVE_BYTES, Result, TriangleSource};

/// Opens all inputs as one source, and leaves `work_bytes` of the limit to what comes after; vertices that do not
/// fit go to scratch in `temp_dir`.
pub fn open(
    inputs: &[Input],
    temp_dir: &Path,
    work_bytes: u64,
    ctx: &Context,
) -> Result<Box<dyn TriangleSource>> {
    let open_all = |budget: &Budget, caches_bytes: u64| {
        let open_one = |input: &Input| match input {
            Input::Generated(text) => generate_in(&Spec::parse(text)?, budget, ctx),
            Input::File(path) => {
                let mut options = ImportOptions::new(budget.clone(), temp_dir);
                options.interrupt = ctx.interrupt.clone();
                options.vertex_cache_bytes = caches_bytes / inputs.len() as u64;
                import::open(path, &options)
            }
        };
        let sources: Result<Vec<_>> = inputs.iter().map(open_one).collect();
        Ok(Chain::from_sources(sources?))
    };
    // Vertex caches fill while the files are read. All of them together take a quarter of the limit, and nothing of
    // what the sources' fixed parts and the work need.
    let mut caches_bytes = 0;
    if inputs.iter().any(|input| matches!(input, Input::File(_))) {
        let (ledger, free_bytes) = (Budget::unlimited(), ctx.budget.free_bytes());
        let _sources = open_all(&ledger, 0)?;
        caches_bytes = (free_bytes / 4).min(free_bytes.saturating_sub(work_bytes + ledger.used_bytes()));
    }
    leaving(work_bytes, ctx, |budget| open_all(budget, caches_bytes))
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
    let source = open(&ledger)?;
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
