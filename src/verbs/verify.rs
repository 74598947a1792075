//! `trex verify`: a page file at one of three levels, every byte by default; 0 clean, 1 damaged.

use crate::args::VerifyArgs;
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use serde::Serialize;
use std::fmt;
use std::num::NonZeroU64;
use trex_store::Progress;
use trex_store::verify::{self, Level};

/// Damaged stretches named in the text; JSON has up to a thousand.
const NAMED: usize = 20;

/// Runs `trex verify`.
pub fn run(args: &VerifyArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let show = ctx.report();
    let report = |done, total| {
        let memory_bytes = ctx.budget.used_bytes();
        show(Progress { phase: "verify", done, total, unit: "bytes", memory_bytes });
        ctx.interrupt.check()
    };
    let bytes_per_s = args.rate.and_then(|rate| NonZeroU64::new(rate.0));
    let options = verify::Options { level: args.level(), bytes_per_s };
    let verdict = verify::check(&args.file, &options, &ctx.budget, &report)?;
    let clean = verdict.damage_count == 0;
    let answer = VerifyReport {
        scene: args.file.display().to_string(),
        verdict: if clean { "clean" } else { "damaged" },
        found: verdict,
        memory: Memory::new(&ctx.budget),
    };
    if clean {
        return ctx.done(&answer);
    }
    ctx.console.finish();
    ctx.output.result("verify", &answer)?;
    Ok(Exit::No)
}

#[derive(Debug, Serialize)]
struct VerifyReport {
    scene: String,
    verdict: &'static str,
    #[serde(flatten)]
    found: verify::Verdict,
    memory: Memory,
}

impl fmt::Display for VerifyReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let found = &self.found;
        for damage in found.damage.iter().take(NAMED) {
            writeln!(f, "damaged: {damage}")?;
        }
        if found.damage_count as usize > NAMED {
            writeln!(f, "and {} more (--json lists up to 1000)", found.damage_count as usize - NAMED)?;
        }
        write!(
            f,
            "{}{}{}: {} pages, {} triangles, {} read",
            self.verdict,
            match found.damage_count {
                0 => String::new(),
                1 => " in one place".to_owned(),
                count => format!(" in {count} places"),
            },
            match found.damaged_triangle_count {
                0 => String::new(),
                count => format!(", {count} triangles lost"),
            },
            found.page_count,
            size::count(found.triangle_count),
            size::bytes(found.bytes_read)
        )?;
        f.write_str(match found.level {
            Level::Quick => " (structure)",
            Level::Hashes => " (all hashes)",
            Level::Deep => " (hashes and content)",
        })
    }
}
