//! What a picture costs and how wrong it is, for each turn of each knob: `trex bench tradeoff`.
//!
//! ```text
//! knobs -> points -> Campaign: a process of `trex render` each -> time, memory, bytes
//!                        reference pictures -> regions -> errors of each point -> front -> table, plots
//! ```
//!
//! Each point is a command that a user can type; its time is that of the whole process, from its start to the file.
//! References are the mean of two pictures by `path` whose noise differs: how much they differ tells the noise that is
//! left in their mean, below which no error says anything.

mod figures;
mod front;
mod knobs;
mod regions;
mod specular;

pub use crate::campaign::Around;
use crate::campaign::{Campaign, Input, refusal};
use crate::median::median;
use datasets_gen::{Spec, views};
pub use figures::{Measurement, PointFigures, Summary, TradeoffFigures, Without};
pub use knobs::names;
use knobs::{KNOBS, Point};
use regions::ReferencePicture;
pub use regions::RegionError;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use specular::SeenView;
use std::fs;
use std::path::{Path, PathBuf};
use trex_render::CameraKeys;
use trex_store::{Code, Error};

/// Samples of the picture of direct light that regions are found by.
const DIRECT_SPP: u32 = 64;
/// Seeds of the two references; pictures have another.
const REFERENCE_SEEDS: [u32; 2] = [1001, 1002];
/// Memory limits that are tried, in hundredths of the smallest.
const LIMITS_PERCENT: [u64; 5] = [100, 125, 150, 200, 400];
const MIB: u64 = 1 << 20;

/// What is measured.
#[derive(Clone, Debug)]
pub struct TradeoffOptions {
    /// The command, which is run for each point.
    pub program: PathBuf,
    /// A page file, a scene, or what is built first: a mesh file or a generator's name.
    pub input: String,
    /// The folder of pictures, points and plots; a campaign that was stopped goes on in it.
    pub folder: PathBuf,
    /// Width and height, pixels.
    pub resolution: [u32; 2],
    /// Samples of each of the two references.
    pub reference_spp: u32,
    /// Names of knobs; empty: all.
    pub knobs: Vec<String>,
    /// Runs of each point; times are their medians.
    pub rounds: usize,
}

/// What a campaign is of.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Subject {
    version: String,
    input: Input,
    resolution: [u32; 2],
    reference_spp: u32,
    rounds: usize,
    memory_limit_bytes: u64,
}

/// What points are rendered of.
struct PointSubject<'a> {
    options: &'a TradeoffOptions,
    /// The page file or scene.
    model: String,
    /// The flags that every picture has.
    common: Vec<String>,
    /// The camera that they name.
    camera: Option<CameraKeys>,
    /// What the model was built of, where it was built here.
    source: Option<String>,
    limit_bytes: u64,
}

/// Runs what has not been run yet, and writes the plots.
///
/// # Errors
/// Those of the command, of the folder, and [`Code::InputMismatch`] for a folder of something else.
pub fn run(options: &TradeoffOptions, around: &Around<'_>) -> anyhow::Result<TradeoffFigures> {
    let lease = around.budget.lease("pictures to be compared", regions::bytes(options.resolution))?;
    let limit_bytes = around.left_bytes();
    let subject = Subject {
        version: env!("CARGO_PKG_VERSION").to_owned(),
        input: Input::named(&options.input)?,
        resolution: options.resolution,
        reference_spp: options.reference_spp,
        rounds: options.rounds,
        memory_limit_bytes: limit_bytes,
    };
    let mut campaign = Campaign::open(&options.program, &options.folder, &subject, around.interrupt)?;
    let stage = PointSubject::open(options, &subject, &campaign)?;
    let reference = stage.reference(&campaign)?;

    let is_asked = |name: &str| options.knobs.is_empty() || options.knobs.iter().any(|asked| asked == name);
    let (asked, left_out): (Vec<_>, Vec<_>) = KNOBS
        .iter()
        .filter(|knob| is_asked(knob.name))
        .partition(|knob| !knob.of_build || stage.source.is_some());
    let limits =
        if asked.iter().any(|knob| knob.name == "memory") { stage.limits(&mut campaign)? } else { vec![] };
    let points: Vec<Point> = asked.iter().flat_map(|knob| knob.points(&limits)).collect();
    let mut told = Vec::new();
    for (done, point) in (0..).zip(&points) {
        (around.tell)(done, points.len() as u64);
        told.push(stage.point(point, &reference, &mut campaign)?);
    }
    drop(lease);
    figures::mark(&mut told);
    let figures = TradeoffFigures {
        scene: options.input.clone(),
        resolution: options.resolution,
        reference_spp: options.reference_spp,
        reference_relmse: reference.floor,
        round_count: options.rounds,
        settings: figures::settings(&told),
        qualities: figures::qualities(&told),
        without: figures::without(&told),
        front: figures::by_time(&told),
        points: told,
        left_out: left_out.iter().map(|knob| knob.name).collect(),
    };
    figures.plot(&options.folder)?;
    Ok(figures)
}

impl<'a> PointSubject<'a> {
    fn open(
        options: &'a TradeoffOptions,
        subject: &Subject,
        campaign: &Campaign<'_>,
    ) -> anyhow::Result<PointSubject<'a>> {
        let [width, height] = options.resolution;
        let mut common = vec!["--resolution".to_owned(), format!("{width}x{height}")];
        let mut camera = None;
        if options.input.starts_with("gen:")
            && let Some(view) = views(&Spec::parse(&options.input)?).into_iter().next()
        {
            let joined = |v: [f64; 3]| format!("{},{},{}", v[0], v[1], v[2]);
            let flags = [
                ("--camera-position", joined(view.position)),
                ("--camera-target", joined(view.target)),
                ("--camera-up", joined(view.up)),
                ("--fov-x", view.fov_x_deg.to_string()),
            ];
            common.extend(flags.into_iter().flat_map(|(flag, value)| [flag.to_owned(), value]));
            camera = Some(CameraKeys {
                position: Some(view.position),
                target: Some(view.target),
                up: Some(view.up),
                fov_x: Some(view.fov_x_deg),
                ..CameraKeys::default()
            });
        }
        let source = subject.input.is_mesh().then(|| options.input.clone());
        let limit_bytes = subject.memory_limit_bytes;
        let mut stage =
            PointSubject { options, model: options.input.clone(), common, camera, source, limit_bytes };
        if stage.source.is_some() {
            stage.model = stage.built("model", &[], campaign)?;
        }
        Ok(stage)
    }

    /// The page file that these flags build, by its name in the folder.
    fn built(&self, name: &str, flags: &[String], campaign: &Campaign<'_>) -> anyhow::Result<String> {
        let path = campaign.folder.join(format!("{name}.trex"));
        let source = self.source.as_ref().expect("only what is built here is built in other ways");
        if !path.exists() {
            let words = ["build", source, "-o", &path.display().to_string()].map(str::to_owned);
            let limit = ["--memory-limit".to_owned(), format!("{}B", self.limit_bytes)];
            let ran = campaign.trex(&[&words, flags, &limit].concat())?;
            refusal(&ran.document).map_or(Ok(()), Err)?;
        }
        Ok(path.display().to_string())
    }

    /// The words of a render, without its output.
    fn words(&self, model: &str, flags: &[String]) -> Vec<String> {
        let begin = ["render".to_owned(), model.to_owned()];
        let words = [&begin, &self.common[..], flags].concat();
        if flags.iter().any(|flag| flag == "--memory-limit") {
            return words;
        }
        [words, vec!["--memory-limit".to_owned(), format!("{}B", self.limit_bytes)]].concat()
    }

    fn reference(&self, campaign: &Campaign<'_>) -> anyhow::Result<ReferencePicture> {
        let picture = |name: &str, flags: &str| {
            let flags: Vec<String> = flags.split_whitespace().map(str::to_owned).collect();
            campaign.picture(name, &self.words(&self.model, &flags))
        };
        let of_path =
            |seed: u32| format!("--quality reference --spp {} --seed {seed}", self.options.reference_spp);
        let a = picture("reference-a.exr", &(of_path(REFERENCE_SEEDS[0]) + " --layers depth,normal,albedo"))?;
        let b = picture("reference-b.exr", &of_path(REFERENCE_SEEDS[1]))?;
        let flags = format!("--integrator direct --spp {DIRECT_SPP} --n-shadow 4 --lod-error 0");
        let direct = picture("direct.exr", &flags)?;
        let view = SeenView {
            model: Path::new(&self.model),
            camera: self.camera,
            resolution: self.options.resolution,
            limit_bytes: self.limit_bytes,
        };
        ReferencePicture::read([&a, &b, &direct], specular::masks(&view, campaign.interrupt)?)
    }

    /// The memory limits that are tried: the smallest, and some above it.
    fn limits(&self, campaign: &mut Campaign<'_>) -> anyhow::Result<Vec<u64>> {
        let flags = ["--quality", "normal", "--memory-limit", "1MiB"].map(str::to_owned);
        let words = self.words(&self.model, &flags);
        let smallest: u64 = campaign.once(&words.join(" "), |campaign| {
            let output = ["-o".to_owned(), campaign.folder.join("small.exr").display().to_string()];
            let ran = campaign.trex(&[words.clone(), output.into()].concat())?;
            let told = ran.document["smallest_limit_bytes"].as_u64();
            told.ok_or_else(|| Error::new(Code::Bug, "a limit of 1 MiB was not refused").into())
        })?;
        let limit = |percent: u64| (smallest * percent / 100).div_ceil(MIB) * MIB;
        let limits = LIMITS_PERCENT.map(limit);
        Ok(limits.into_iter().filter(|&bytes| bytes <= self.limit_bytes).collect())
    }

    fn point(
        &self,
        point: &Point,
        reference: &ReferencePicture,
        campaign: &mut Campaign<'_>,
    ) -> anyhow::Result<PointFigures> {
        let variant = format!("{}-{}", point.knob, point.value.replace('/', "-"));
        let model = match &point.build {
            Some(_) => campaign.folder.join(format!("{variant}.trex")).display().to_string(),
            None => self.model.clone(),
        };
        let words = self.words(&model, &point.flags);
        let build = point.build.iter().flatten().map(|flag| format!(" {flag}")).collect::<String>();
        let key = format!(
            "trex {}{}",
            words.join(" "),
            if build.is_empty() { build } else { format!(" #{build}") }
        );
        let measured: Result<Measurement, String> = campaign.once(&key, |campaign| {
            let flags = point.build.as_deref();
            let built = flags.map_or(Ok(model.clone()), |flags| self.built(&variant, flags, campaign));
            let measured = built.and_then(|model| self.measure(&words, &model, reference, campaign));
            if point.build.is_some() {
                // A model for each turn of the knob would fill the disk.
                let _ = fs::remove_file(&model);
            }
            match measured {
                Ok(measured) => Ok(Ok(measured)),
                Err(error) => match error.downcast_ref::<Error>().map(|error| (error.code(), error.what())) {
                    Some((Code::MemoryLimit | Code::SceneFormat, what)) => Ok(Err(what.to_owned())),
                    _ => Err(error),
                },
            }
        })?;
        Ok(PointFigures {
            knob: point.knob.to_owned(),
            value: point.value.clone(),
            render_command: key,
            refused: measured.as_ref().err().cloned(),
            measured: measured.ok(),
            is_on_time_front: false,
            is_on_memory_front: false,
            front_distance: None,
        })
    }

    fn measure(
        &self,
        words: &[String],
        model: &str,
        reference: &ReferencePicture,
        campaign: &Campaign<'_>,
    ) -> anyhow::Result<Measurement> {
        let path = campaign.folder.join("point.exr");
        let output = ["-o".to_owned(), path.display().to_string(), "--overwrite".to_owned()];
        let words = [words, &output[..]].concat();
        let (mut walls, mut last) = (Vec::new(), Value::Null);
        for _ in 0..self.options.rounds {
            let ran = campaign.trex(&words)?;
            refusal(&ran.document).map_or(Ok(()), Err)?;
            walls.push(ran.wall.as_secs_f64() * 1e3);
            last = ran.document;
        }
        let errors = reference.errors(&regions::picture_of(&path)?);
        fs::remove_file(&path).map_err(|error| Error::io("remove", &path, &error))?;
        let rates = last["rays_per_s"].as_object().into_iter().flatten();
        let model = last["scene"].as_str().unwrap_or(model);
        Ok(Measurement {
            picture_ms: median(&walls),
            rays_per_s: rates.filter_map(|(kind, rate)| Some((kind.clone(), rate.as_f64()?))).collect(),
            peak_rss_bytes: last["memory"]["peak_rss_bytes"].as_u64().unwrap_or(0),
            bytes_read: last["pool"]["bytes_read"].as_u64().unwrap_or(0),
            file_bytes: fs::metadata(model).map_or(0, |about| about.len()),
            errors,
        })
    }
}
