//! What `trex stress` asks of a session, and how it says how far it is.

use super::stage::read_views;
use crate::args::StressArgs;
use crate::context::Context;
use crate::values::Milliseconds;
use std::time::Duration;
use trex_bench::stress::{Requirement, StressOptions};
use trex_render::{PagedTracer, Scene, Session};
use trex_store::{Progress, Result};

/// Longest frame when no other is asked for: what the paper takes for the longest that users bear.
pub const T_MAX: Milliseconds = Milliseconds(100.0);

/// What is asked of `session`.
pub fn stress_options<T: PagedTracer + Send>(
    args: &StressArgs,
    scene: &Scene,
    session: &Session<T>,
) -> Result<StressOptions> {
    let views = args.views.as_ref().map(|path| read_views(path, &session.view().camera)).transpose()?;
    let t_max = Duration::from_secs_f64(args.deadline.t_max.as_ref().unwrap_or(&T_MAX).0 / 1e3);
    let mut requirements = args.require.clone();
    if requirements.is_empty() {
        requirements.push(Requirement::default_for(t_max));
    }
    Ok(StressOptions {
        scenario: args.scenario,
        switches: args.switches,
        hold: Duration::from_secs_f64(args.hold.0 / 1e3),
        seed: scene.render.seed,
        views: views.unwrap_or_default(),
        fills: scene.camera.position.is_none() && scene.camera.target.is_none(),
        requirements,
    })
}

/// Says how far it is.
pub fn tell(ctx: &Context, phase: &'static str, [done, total]: [u64; 2], unit: &'static str) {
    let show = ctx.report();
    show(Progress { phase, done, total, unit, memory_bytes: ctx.budget.used_bytes() });
}
