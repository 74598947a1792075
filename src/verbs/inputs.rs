//! Inputs of `build` and `info`: files and generators, opened as one stream of triangles.

use crate::context::Context;
use crate::values::Input;
use datasets_gen::{GenOptions, Spec};
use std::path::Path;
use trex_store::import::{self, ImportOptions};
use trex_store::{Chain, Result, TriangleSource};

/// Opens all inputs as one source; vertices that do not fit go to scratch in `temp_dir`.
pub fn open(inputs: &[Input], temp_dir: &Path, ctx: &Context) -> Result<Box<dyn TriangleSource>> {
    let sources: Result<Vec<_>> = inputs.iter().map(|input| open_one(input, temp_dir, ctx)).collect();
    Ok(Chain::of(sources?))
}

fn open_one(input: &Input, temp_dir: &Path, ctx: &Context) -> Result<Box<dyn TriangleSource>> {
    match input {
        Input::Generated(text) => generate(&Spec::parse(text)?, ctx),
        Input::File(path) => {
            let mut options = ImportOptions::new(ctx.budget.clone(), temp_dir);
            options.interrupt = ctx.interrupt.clone();
            import::open(path, &options)
        }
    }
}

/// Opens a generator.
pub fn generate(spec: &Spec, ctx: &Context) -> Result<Box<dyn TriangleSource>> {
    let options =
        GenOptions { threads: ctx.threads, budget: ctx.budget.clone(), interrupt: ctx.interrupt.clone() };
    datasets_gen::open(spec, &options)
}
