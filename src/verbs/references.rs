//! References of `trex stress`: pictures at leisure, in a file without a name, or in one that is kept between runs.
//!
//! ```text
//! kept file of the same pictures -> used as it is
//! else -> draft beside it, or a file without a name -> a picture of each state -> renamed
//! ```

use super::stage::{Play, Stage, io_options};
use super::stress_options::{stress_options, tell};
use crate::args::StressArgs;
use crate::context::Context;
use crate::memory::resident_bytes;
use std::fs::File;
use std::path::{Path, PathBuf};
use std::time::Duration;
use trex_bench::stress::{
    self, References, ReferencesKey, Scenario, Snapshots, Stand, StressOptions, other_seed,
};
use trex_model::{DeviceOptions, Model, SessionOptions};
use trex_render::{Filter, Scene};
use trex_store::output::{ExistingOutput, check_apart, draft};
use trex_store::{Code, Error, Result, StopSignal};

/// Checks the name of the file of references, which must be none of `inputs`, before any work.
pub fn check(path: &Path, inputs: &[&Path]) -> Result<()> {
    let apart = |_| inputs.iter().try_for_each(|input| check_apart(path, input));
    let next = "name a file of its own with --references, in a folder that is there";
    ExistingOutput::Replace.check(path).and_then(apart).map_err(|error| error.next(next))
}

/// The pictures of the scenario's states on the exact mesh, `spp` samples a pixel, of other samples than those of the
/// run. `scene` is lit as they are from then on.
pub fn references(
    args: &StressArgs,
    ctx: &Context,
    scene: &mut Scene,
    path: &Path,
    spp: u32,
) -> anyhow::Result<References> {
    let mut exact = scene.clone();
    (exact.render.lod_error, exact.render.filter) = (0.0, Filter::Off);
    exact.render.seed = other_seed(scene.render.seed);
    let io = io_options(&args.disk);
    let (options, device) = (SessionOptions::default(), DeviceOptions::default());
    let stop = StopSignal::new(&ctx.interrupt, None);
    let play = Play { scene: &exact, file: path, options, io: &io, device: &device, stop: &stop };
    let (stage, mut session) = Stage::open(&play, ctx)?;
    scene.render.light = session.view().settings.light;
    let options = stress_options(args, scene, &session)?;
    let states = stress::state_count(&session, &options);
    if states == 0 {
        return Err(without_states(options.scenario).into());
    }
    let resolution = exact.render.resolution;
    let key = ReferencesKey::new(&decides(&exact, &stage.model, &options, spp), states);
    if let Some(kept) = args.references.as_deref().filter(|kept| kept.exists()) {
        let file = File::open(kept).map_err(|error| Error::io("open the references", kept, &error))?;
        if let Some(references) = References::kept(file, kept.into(), resolution, key)? {
            return Ok(references);
        }
    }
    let stand = Stand {
        pool: &stage.pool,
        resident_bytes: &resident_bytes,
        interrupt: &ctx.interrupt,
        tell: &|done| tell(ctx, "references", [done, states.into()], "views"),
        t_max: Duration::ZERO,
    };
    let mut render = |file, place| {
        let references = References::new(file, place, resolution, key);
        stress::render_references(&mut session, &options, spp, &references, &stand)?;
        Ok::<_, Error>(references)
    };
    let Some(kept) = &args.references else {
        let (file, place) = file_without_name(args)?;
        return Ok(render(file, place)?);
    };
    let fails = |error: std::io::Error| Error::writing("write the references", kept, &error);
    let draft = draft(kept).map_err(fails)?;
    let references = render(draft.as_file().try_clone().map_err(fails)?, kept.clone())?;
    draft.as_file().sync_all().map_err(fails)?;
    draft.persist(kept).map_err(|error| fails(error.error))?;
    Ok(references)
}

/// Room for pictures that are compared with `references`.
pub fn snapshots(args: &StressArgs, ctx: &Context, references: References) -> Result<Snapshots> {
    let (file, place) = file_without_name(args)?;
    Snapshots::new(references, file, place, &ctx.budget)
}

/// A file in the folder for temporary files, and that folder.
fn file_without_name(args: &StressArgs) -> Result<(File, PathBuf)> {
    let place = args.scratch.temp_dir.clone().unwrap_or_else(|| ".".into());
    let file = tempfile::tempfile_in(&place);
    let file = file.map_err(|error| Error::io("make a file for pictures to compare", &place, &error))?;
    Ok((file, place))
}

/// All that decides the references, in words.
fn decides(exact: &Scene, model: &Model, options: &StressOptions, spp: u32) -> String {
    let StressOptions { scenario, seed, views, .. } = options;
    let version = env!("CARGO_PKG_VERSION");
    let id = model.file().superblock().file_id;
    format!("{version} {id:016x} {scenario:?} {seed} {views:?} {spp} {exact:?}")
}

fn without_states(scenario: Scenario) -> Error {
    Error::new(Code::SceneFormat, "the states of this scenario have no references")
        .at_place("--reference-spp")
        .numbers(format!("{} never comes to one twice", scenario.name()))
        .next(
            "leave it out, or use flip, inside, pingpong, teleport, light-edit, squeeze, still, drag or fly",
        )
}
