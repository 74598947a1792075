//! `trex image merge`: the parts of a picture, added, filtered and written.
//!
//! Invariant: the heads of all parts are read, compared and counted before a pixel is, and before the output is begun.

use super::picture_file::PictureFile;
use super::render_report::Image;
use crate::args::ImageMergeArgs;
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use serde::Serialize;
use std::fmt;
use std::path::Path;
use std::time::{Duration, Instant};
use trex_model::PictureParts;
use trex_render::Layers;
use trex_store::printable::one_line;

/// Runs `trex image merge`.
pub fn run(args: &ImageMergeArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let start = Instant::now();
    let inputs: Vec<&Path> = args.parts.iter().map(|part| &**part).collect();
    // A PNG of parts that have layers shows what they show.
    let target = PictureFile::check(&args.output, args.overwrite.overwrite, Layers::default(), &inputs)?;
    let parts = PictureParts::open(&args.parts)?;
    let (head, pool) = (parts.head(), ctx.thread_pool()?);
    let mut strips = parts.strips(&pool, &ctx.interrupt, &ctx.budget)?;
    let written = target.write_strips(&mut strips, head.exposure, &pool);
    // What a part says of itself goes before what the writer says of it.
    written.map_err(|error| strips.take_failure().unwrap_or(error))?;
    let [width, height] = head.resolution;
    let damaged_page_count = parts.damaged_page_count();
    if damaged_page_count > 0 {
        ctx.console.note(&format!("note: parts were made without damaged pages, up to {damaged_page_count}"));
    }
    let answer = Merge {
        scene: args.parts[0].display().to_string(),
        output: args.output.display().to_string(),
        part_count: parts.part_count(),
        spp: head.spp,
        exposure: head.exposure,
        layers: head.layers.to_string(),
        damaged_page_count,
        image: Image { mean: strips.mean(), width, height },
        time_ms: start.elapsed().as_millis() as u64,
        memory: Memory::new(&ctx.budget),
    };
    ctx.done(&answer)?;
    Ok(if damaged_page_count == 0 || args.allow_damage { Exit::Done } else { Exit::No })
}

/// The result of a merge.
#[derive(Debug, Serialize)]
struct Merge {
    scene: String,
    output: String,
    part_count: usize,
    spp: u32,
    exposure: f32,
    layers: String,
    /// Most that one of the parts was made without.
    damaged_page_count: u32,
    image: Image,
    time_ms: u64,
    memory: Memory,
}

impl fmt::Display for Merge {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: {}x{}, {} samples a pixel, from {} parts, {}; memory limit {}, peak {}",
            one_line(&self.output),
            self.image.width,
            self.image.height,
            self.spp,
            self.part_count,
            size::duration(Duration::from_millis(self.time_ms)),
            size::bytes(self.memory.limit_bytes),
            self.memory.peak_rss_bytes.map_or_else(|| "unknown".into(), size::bytes)
        )
    }
}
