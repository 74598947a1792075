//! `trex export`: the mesh of a page file back to a PLY, OBJ or STL file.

use crate::args::ExportArgs;
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use datasets_gen::write::{ExistingOutput, WriteOptions, write};
use serde::Serialize;
use std::fmt;
use std::sync::Arc;
use std::time::Instant;
use trex_store::output::check_apart;
use trex_store::printable::one_line;
use trex_store::{Aabb, ExportOptions, Lattice, NextStep, PageFile, PageTriangles, TriangleSource};

/// Runs `trex export`.
pub fn run(args: &ExportArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let start = Instant::now();
    check_apart(&args.output, &args.file)?;
    check_apart(&args.output.with_extension("mtl"), &args.file)?;
    let file = Arc::new(PageFile::open(&args.file, &ctx.budget)?);
    let chosen = ExportOptions {
        bounds: args.bounds.map(|bounds| Aabb { lo: bounds.lo, hi: bounds.hi }),
        materials: args.material.clone(),
    };
    let lattice = file.superblock().lattice;
    let mut source = PageTriangles::open(file, &chosen, &ctx.budget)?;
    let show = ctx.report();
    let options = WriteOptions {
        existing: ExistingOutput::replace_if(args.overwrite.overwrite),
        budget: ctx.budget.clone(),
        interrupt: ctx.interrupt.clone(),
        too_large: NextStep::from("export it in parts, with --box"),
        report: Some(&show),
    };
    let written = write(&mut source, &args.output, &options)?;
    let time_ms = start.elapsed().as_millis() as u64;
    ctx.done(&ExportReport {
        scene: source.name(),
        output: args.output.display().to_string(),
        triangle_count: written.triangle_count,
        output_bytes: written.bytes,
        lattice,
        time_ms,
        triangles_per_s: written.triangle_count as f64 * 1e3 / time_ms.max(1) as f64,
        memory: Memory::new(&ctx.budget),
    })
}

#[derive(Serialize)]
struct ExportReport {
    scene: String,
    output: String,
    triangle_count: u64,
    output_bytes: u64,
    lattice: Lattice,
    time_ms: u64,
    triangles_per_s: f64,
    memory: Memory,
}

impl fmt::Display for ExportReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {} triangles, {}, {}",
            one_line(&self.output),
            size::count(self.triangle_count),
            size::bytes(self.output_bytes),
            size::rate(self.triangles_per_s, "triangles")
        )
    }
}
