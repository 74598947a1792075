//! `trex image diff`: how far a picture is from its reference; 0 done, 1 beyond the threshold.
//!
//! Invariant: both heads are read, compared and paid for before a pixel is.

use super::picture_file::PictureFile;
use crate::args::{ImageDiffArgs, Metric};
use crate::context::Context;
use crate::failure::Exit;
use crate::memory::Memory;
use crate::size;
use serde::Serialize;
use std::fmt;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;
use std::time::Instant;
use trex_image::{
    Comparison, Constants, Figures, Head, Origin, Picture, compare, false_colour, flip, flip_bytes,
    read_head, read_picture,
};
use trex_store::{Code, Error, Lease, RESERVE_BYTES, Result, open_regular};

/// Runs `trex image diff`.
pub fn run(args: &ImageDiffArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let start = Instant::now();
    let overwrite = args.overwrite.overwrite;
    let check = |path| PictureFile::check_png(path, overwrite, &[&args.a, &args.b]);
    let target = args.output.as_deref().map(check).transpose()?;
    let (mut a, mut b) = (PictureInput::open(&args.a, ctx)?, PictureInput::open(&args.b, ctx)?);
    check_sizes(&a, &b)?;
    let asks_flip = args.flip || args.metric == Some(Metric::Flip);
    let drawn_bytes =
        if target.is_some() { false_colour::work_bytes(a.head.width, a.head.height) } else { 0 };
    let flip_bytes = if asks_flip { flip_bytes(a.head.width) } else { 0 };
    let _lease = lease(&a, &b, drawn_bytes.max(flip_bytes), ctx)?;
    tell_what_to_know(&a, &b, ctx);
    let (picture, reference) = (a.read(ctx)?, b.read(ctx)?);
    let constants = Constants { epsilon: args.epsilon, peak: args.peak };
    let comparison = compare(&picture, &reference, constants);
    ctx.interrupt.check()?;
    let flip = asks_flip.then(|| flip(&picture, &reference, 1.0));
    ctx.interrupt.check()?;
    let threshold = args.threshold.map(|limit| Threshold::hold(limit, args.metric, (&comparison, flip)));
    let false_colour = match (&target, &args.output) {
        (Some(target), Some(path)) => {
            let scale_max = args.scale_max.unwrap_or_else(|| false_colour::scale_of(&picture, &reference));
            target.write_with(|writer| false_colour::write(&picture, &reference, scale_max, writer))?;
            Some(FalseColour::new(path, scale_max, args.scale_max.is_some()))
        }
        _ => None,
    };
    let answer = Diff {
        scene: args.b.display().to_string(),
        a: Side::new(&a),
        b: Side::new(&b),
        image: Size { width: a.head.width, height: a.head.height },
        unit: "linear radiance",
        relmse_epsilon: args.epsilon,
        psnr_peak: args.peak,
        verdict: verdict(&comparison, threshold.as_ref()),
        comparison,
        flip,
        threshold,
        false_colour,
        time_ms: start.elapsed().as_millis() as u64,
        memory: Memory::new(&ctx.budget),
    };
    if answer.verdict != "beyond" {
        return ctx.done(&answer);
    }
    ctx.console.finish();
    ctx.output.result("image-diff", &answer)?;
    Ok(Exit::No)
}

/// One of the two pictures.
struct PictureInput<'a> {
    path: &'a Path,
    reader: BufReader<File>,
    file_bytes: u64,
    head: Head,
}

impl<'a> PictureInput<'a> {
    fn open(path: &'a Path, ctx: &Context) -> Result<PictureInput<'a>> {
        let file = open_regular(path)?;
        let about = file.metadata().map_err(|error| Error::io("open the picture", path, &error))?;
        let (mut reader, file_bytes) = (BufReader::new(file), about.len());
        let head = read_head(&mut reader, Origin { path, file_bytes, interrupt: &ctx.interrupt })?;
        Ok(PictureInput { path, reader, file_bytes, head })
    }

    fn read(&mut self, ctx: &Context) -> Result<Picture> {
        let origin = Origin { path: self.path, file_bytes: self.file_bytes, interrupt: &ctx.interrupt };
        read_picture(&mut self.reader, origin, &self.head)
    }
}

fn check_sizes(a: &PictureInput<'_>, b: &PictureInput<'_>) -> Result<()> {
    let size = |input: &PictureInput<'_>| (input.head.width, input.head.height);
    if size(a) == size(b) {
        return Ok(());
    }
    let said = |input: &PictureInput<'_>| {
        format!("{} is {}x{} pixels", input.path.display(), input.head.width, input.head.height)
    };
    Err(Error::new(Code::InputMismatch, "the pictures differ in size")
        .at_place(format!("{} and {}", a.path.display(), b.path.display()))
        .numbers(format!("{}, {}", said(a), said(b)))
        .next("compare pictures of one size: render again with the same --resolution"))
}

/// Pays for both pictures and, one after the other, for their decoders and what is made of them, `made_bytes`.
fn lease(a: &PictureInput<'_>, b: &PictureInput<'_>, made_bytes: u64, ctx: &Context) -> Result<Lease> {
    let pictures = a.head.picture_bytes() + b.head.picture_bytes();
    let work = a.head.decoder_bytes.max(b.head.decoder_bytes).max(made_bytes);
    ctx.budget.lease("two pictures", pictures + work).map_err(|_| {
        let smallest = RESERVE_BYTES + pictures + work;
        Error::new(Code::MemoryLimit, "the memory limit has no room for these pictures")
            .at_place(format!("{} and {}", a.path.display(), b.path.display()))
            .numbers(format!(
                "limit {}, {} needed: {} reserved for the process, {} for {}x{} pixels twice, {} to work",
                size::bytes(ctx.budget.limit_bytes()),
                size::bytes(smallest),
                size::bytes(RESERVE_BYTES),
                size::bytes(pictures),
                a.head.width,
                a.head.height,
                size::bytes(work)
            ))
            .next(format!("--memory-limit {}MiB or more", smallest.div_ceil(1 << 20)))
            .smallest_limit(smallest)
    })
}

fn tell_what_to_know(a: &PictureInput<'_>, b: &PictureInput<'_>, ctx: &Context) {
    if a.head.format != b.head.format {
        ctx.console
            .note("note: a PNG holds steps up to white; what an EXR holds between and beyond is error here");
    }
}

/// The two outcomes that need no threshold, and the two that do.
fn verdict(comparison: &Comparison, threshold: Option<&Threshold>) -> &'static str {
    match threshold {
        _ if comparison.is_equal => "equal",
        Some(threshold) if threshold.is_kept => "within",
        Some(_) => "beyond",
        None => "different",
    }
}

#[derive(Debug, Serialize)]
struct Diff {
    scene: String,
    a: Side,
    b: Side,
    image: Size,
    unit: &'static str,
    relmse_epsilon: f64,
    psnr_peak: f64,
    #[serde(flatten)]
    comparison: Comparison,
    /// `None` where it was not asked for.
    flip: Option<f64>,
    threshold: Option<Threshold>,
    verdict: &'static str,
    false_colour: Option<FalseColour>,
    time_ms: u64,
    memory: Memory,
}

#[derive(Debug, Serialize)]
struct Side {
    path: String,
    format: &'static str,
    channels: String,
}

#[derive(Debug, Serialize)]
struct Size {
    width: u32,
    height: u32,
}

impl Side {
    fn new(input: &PictureInput<'_>) -> Side {
        Side {
            path: input.path.display().to_string(),
            format: input.head.format.as_str(),
            channels: input.head.channels.clone(),
        }
    }
}

/// What was asked of a metric, and what it is.
#[derive(Debug, Serialize)]
struct Threshold {
    metric: &'static str,
    limit: f64,
    /// `None` for an infinite PSNR, and where no pixel could be compared.
    value: Option<f64>,
    is_kept: bool,
}

impl Threshold {
    fn hold(limit: f64, metric: Option<Metric>, (comparison, flip): (&Comparison, Option<f64>)) -> Threshold {
        let (metric, figures) = (metric.unwrap_or(Metric::Rmse), &comparison.all);
        let at_most = |value: Option<f64>| value.is_some_and(|value| value <= limit);
        let (value, is_kept) = match metric {
            Metric::Rmse => (figures.rmse, at_most(figures.rmse)),
            Metric::Relmse => (figures.relmse, at_most(figures.relmse)),
            Metric::Flip => (flip, at_most(flip)),
            // Without an error it is infinite; without a pixel there is none.
            Metric::Psnr => {
                (figures.psnr_db, figures.psnr_db.map_or(figures.rmse.is_some(), |psnr| psnr >= limit))
            }
        };
        let is_kept = is_kept || comparison.is_equal;
        Threshold { metric: metric.as_str(), limit, value, is_kept }
    }
}

#[derive(Debug, Serialize)]
struct FalseColour {
    path: String,
    map: &'static str,
    /// Error per pixel (RMS of its channels, radiance) of the first and the last colour.
    scale_min: f64,
    scale_max: f64,
    /// Share of the pixels that the scale was made to hold; `None` where it was given.
    scale_percentile: Option<f64>,
}

impl FalseColour {
    fn new(path: &Path, scale_max: f64, is_given: bool) -> FalseColour {
        FalseColour {
            path: path.display().to_string(),
            map: "viridis",
            scale_min: 0.0,
            scale_max,
            scale_percentile: (!is_given).then_some(false_colour::SCALE_PERCENTILE),
        }
    }
}

impl fmt::Display for Diff {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} ({}, {}) against {} ({}, {}): {}x{}, {}",
            self.a.path,
            self.a.format,
            self.a.channels,
            self.b.path,
            self.b.format,
            self.b.channels,
            self.image.width,
            self.image.height,
            self.unit
        )?;
        writeln!(
            f,
            "     {:>11} {:>11} {:>9} {:>11} {:>13} {:>11} {:>11}",
            "RMSE", "relMSE", "PSNR dB", "max error", "at x,y", "mean A", "mean B"
        )?;
        let [red, green, blue] = &self.comparison.channels;
        for (name, figures) in [("all", &self.comparison.all), ("R", red), ("G", green), ("B", blue)] {
            writeln!(f, "{name:<4} {}", row(figures))?;
        }
        writeln!(
            f,
            "relMSE = mean (a-b)^2 / (b^2 + {}), PSNR for a peak of {}",
            self.relmse_epsilon, self.psnr_peak
        )?;
        if let Some(flip) = self.flip {
            writeln!(f, "FLIP {flip:.4}: 0 looks alike, 1 as different as can be")?;
        }
        let (comparison, odd) = (&self.comparison, self.comparison.non_finite_pixel_count);
        if comparison.compared_pixel_count < comparison.pixel_count {
            writeln!(
                f,
                "left out: {} of {} pixels, not finite ({} in A, {} in B)",
                comparison.pixel_count - comparison.compared_pixel_count,
                comparison.pixel_count,
                odd.a,
                odd.b
            )?;
        }
        if let Some(drawn) = &self.false_colour {
            let how = match drawn.scale_percentile {
                Some(percentile) => format!(" ({percentile} % of the pixels)"),
                None => String::new(),
            };
            writeln!(
                f,
                "{}: error per pixel (RMS of its channels), {} from 0 to {}{how}",
                drawn.path,
                drawn.map,
                number(Some(drawn.scale_max))
            )?;
        }
        match &self.threshold {
            Some(Threshold { metric, limit, value, .. }) => {
                let value = match value {
                    None if self.comparison.all.rmse.is_some() => "inf".to_owned(),
                    value => number(*value),
                };
                write!(f, "{}: {metric} {value}, threshold {limit}", self.verdict)
            }
            None => write!(f, "{}", self.verdict),
        }
    }
}

/// Five digits, which pictures of 32 bits deserve.
fn number(value: Option<f64>) -> String {
    match value {
        None => "-".to_owned(),
        Some(0.0) => "0".to_owned(),
        Some(value) => format!("{value:.4e}"),
    }
}

/// A line of the table.
fn row(figures: &Figures) -> String {
    let psnr = match (figures.psnr_db, figures.rmse) {
        (Some(psnr), _) => format!("{psnr:.2}"),
        (None, Some(_)) => "inf".to_owned(),
        (None, None) => "-".to_owned(),
    };
    let place = figures.max_error_pixel.map_or_else(|| "-".to_owned(), |[x, y]| format!("{x},{y}"));
    format!(
        "{:>11} {:>11} {psnr:>9} {:>11} {place:>13} {:>11} {:>11}",
        number(figures.rmse),
        number(figures.relmse),
        number(figures.max_error),
        number(figures.mean_a),
        number(figures.mean_b)
    )
}
