//! `trex gen`: a generated mesh to a PLY, OBJ, GLB or STL file. (`gen` is a keyword of Rust.)

use super::inputs;
use crate::args::{GenArgs, GeneratedColors};
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use datasets_gen::Spec;
use datasets_gen::write::{ExistingOutput, WriteOptions, WriteReport, smallest_bytes, write};
use serde::Serialize;
use std::fmt;
use std::path::Path;
use std::time::Instant;
use trex_store::NextStep;
use trex_store::printable::one_line;

/// Runs `trex gen`.
pub fn run(args: &GenArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let start = Instant::now();
    let spec = Spec::parse(&format!("gen:{}:{}:{}", args.kind.as_str(), args.triangles, args.seed))?;
    let spec = Spec { colours: args.colors.map(GeneratedColors::frequency), ..spec };
    let mut source = inputs::generate(&spec, smallest_bytes(&args.output), ctx)?;
    let show = ctx.report();
    let options = WriteOptions {
        existing: ExistingOutput::replace_if(args.overwrite.overwrite),
        budget: ctx.budget.clone(),
        interrupt: ctx.interrupt.clone(),
        too_large: NextStep::BuildFromGenerator,
        report: Some(&show),
    };
    let written = write(&mut *source, &args.output, &options)?;
    ctx.done(&MeshReport::new((source.name(), &args.output), written, start, ctx))
}

/// A mesh that was written.
#[derive(Serialize)]
pub(super) struct MeshReport {
    scene: String,
    output: String,
    triangle_count: u64,
    output_bytes: u64,
    time_ms: u64,
    triangles_per_s: f64,
    memory: Memory,
}

impl MeshReport {
    /// What `written` is, of work that began at `start`.
    pub(super) fn new(
        (scene, output): (String, &Path),
        written: WriteReport,
        start: Instant,
        ctx: &Context,
    ) -> MeshReport {
        let time_ms = start.elapsed().as_millis() as u64;
        MeshReport {
            scene,
            output: output.display().to_string(),
            triangle_count: written.triangle_count,
            output_bytes: written.bytes,
            time_ms,
            triangles_per_s: written.triangle_count as f64 * 1e3 / time_ms.max(1) as f64,
            memory: Memory::new(&ctx.budget),
        }
    }
}

impl fmt::Display for MeshReport {
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
