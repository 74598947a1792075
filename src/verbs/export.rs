//! `trex export`: the mesh of a page file back to a PLY, OBJ, GLB or STL file.

use super::generate::MeshReport;
use crate::args::ExportArgs;
use crate::context::Context;
use crate::failure::Exit;
use datasets_gen::write::{ExistingOutput, WriteOptions, write};
use serde::Serialize;
use std::fmt;
use std::sync::Arc;
use std::time::Instant;
use trex_store::output::check_apart;
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
    let mesh = MeshReport::new((source.name(), &args.output), written, start, ctx);
    ctx.done(&ExportReport { mesh, lattice })
}

#[derive(Serialize)]
struct ExportReport {
    #[serde(flatten)]
    mesh: MeshReport,
    lattice: Lattice,
}

impl fmt::Display for ExportReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.mesh.fmt(f)
    }
}
