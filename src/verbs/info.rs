//! `trex info`: what a mesh or a page file holds, without loading it.

use super::build::UnfinishedBuilds;
use super::input_summary::InputSummary;
use super::inputs::{self, InputList};
use super::part_info::{self, PartInfo};
use super::view::FIRST_RESOLUTION;
use crate::args::InfoArgs;
use crate::context::Context;
use crate::failure::Exit;
use crate::size;
use crate::values::Input;
use serde::{Serialize, Serializer};
use std::fmt;
use std::io::Read;
use std::path::Path;
use std::sync::Arc;
use trex_model::{Pace, SessionOptions, set_direct_without_voxels};
use trex_render::{MemoryPlan, PictureNeeds, Scene};
use trex_store::build::left_over;
use trex_store::import::{self, ImportOptions, VolumeOptions};
use trex_store::layout::{FRAME_BYTES, MAGIC, PageKind, Superblock};
use trex_store::printable::one_line;
use trex_store::{Aabb, MaterialNames, PageFile, is_url, open_regular};
use trex_view::view_bytes;

/// Materials named in the text.
const NAMED: usize = 16;

/// Runs `trex info`.
pub fn run(args: &InfoArgs, ctx: &Context) -> anyhow::Result<Exit> {
    let volumes = VolumeOptions { raw: args.raw.volume(), ..VolumeOptions::default() };
    InputList::whole(std::slice::from_ref(&args.input), &volumes).check()?;
    match &args.input {
        Input::Generated(text) => {
            let source = inputs::generate(&datasets_gen::Spec::parse(text)?, 0, ctx)?;
            let hint = source.hint().expect("generators know what they make");
            let bounds = hint.bounds;
            ctx.done(&GeneratorInfo {
                scene: source.name(),
                triangle_count: hint.triangle_count,
                median_edge: hint.median_edge,
                bounds,
            })
        }
        Input::File(path) if !path.is_file() && has_unfinished(path) => {
            let unfinished = left_over::find(path)?;
            ctx.done(&UnfinishedBuilds { is_cleaned: false, unfinished })
        }
        Input::File(path) if is_page_file(path) => {
            if has_unfinished(path) {
                ctx.console.note(
                    "note: a build of this output did not end; trex build --clean removes what it left",
                );
            }
            ctx.done(&FileInfo::new(&PageFile::open(path, &ctx.budget)?, ctx)?)
        }
        Input::File(path) if part_info::is_part(path) => ctx.done(&PartInfo::read(path)?),
        Input::File(path) => {
            let mut options = ImportOptions::new(ctx.budget.clone(), Path::new("."));
            options.volumes = volumes;
            let info = import::info(path, &options)?;
            ctx.done(&InputSummary { scene: path.display().to_string(), info })
        }
    }
}

/// Whether builds of this output, or of outputs in this folder, were begun and not ended.
fn has_unfinished(path: &Path) -> bool {
    left_over::find(path).is_ok_and(|found| !found.is_empty())
}

fn is_page_file(path: &Path) -> bool {
    let mut head = [0; MAGIC.len()];
    let is_read = open_regular(path).is_ok_and(|mut file| file.read_exact(&mut head).is_ok());
    is_url(path) || (is_read && head == MAGIC) || path.extension().is_some_and(|ending| ending == "trex")
}

/// The needs of the picture that `render` makes of `file` when nothing is said.
fn render_needs(file: &PageFile, ctx: &Context) -> trex_store::Result<PictureNeeds> {
    let mut scene = Scene::default();
    set_direct_without_voxels(&mut scene, file.superblock());
    SessionOptions::default().picture_needs(&scene, ctx.threads)
}

/// The smallest limit of the picture that `view` begins with.
fn smallest_view_bytes(file: &PageFile, ctx: &Context) -> trex_store::Result<u64> {
    let mut scene = Scene::default();
    scene.begin_live();
    set_direct_without_voxels(&mut scene, file.superblock());
    scene.render.resolution = FIRST_RESOLUTION;
    let copies_bytes = view_bytes(FIRST_RESOLUTION);
    let options = SessionOptions { pace: Pace::InFrames, copies_bytes, ..SessionOptions::default() };
    let needs = options.picture_needs(&scene, ctx.threads)?;
    MemoryPlan::smallest_limit_bytes(file, &needs)
}

#[derive(Serialize)]
struct GeneratorInfo {
    scene: String,
    triangle_count: u64,
    median_edge: f64,
    bounds: Aabb,
}

impl fmt::Display for GeneratorInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{}: {} triangles (within 1 %)",
            one_line(&self.scene),
            size::count(self.triangle_count)
        )?;
        write!(f, "box {:?} to {:?}, median edge {:.4e}", self.bounds.lo, self.bounds.hi, self.median_edge)
    }
}

#[derive(Serialize)]
struct BytesPerTriangle {
    disk: f64,
    /// Of their pages, on disk.
    colours: f64,
    normals: f64,
    resident: f64,
    file: f64,
}

#[derive(Serialize)]
struct SectionBytes {
    mesh: u64,
    tree: u64,
    colours: u64,
    normals: u64,
    asvo_upper: u64,
    asvo_lower: u64,
    tables: u64,
}

#[derive(Serialize)]
struct Grid {
    step: f64,
    bits: u32,
    origin: [f64; 3],
    error_bound: f64,
}

#[derive(Serialize)]
struct Asvo {
    r_u: u32,
    r_finest: u32,
    leaf_count_upper: u32,
    leaf_count_lower: u64,
    /// Pages that hold the finer leaves.
    unit_page_count: usize,
    facet_count: u32,
    /// Side of a leaf, model units.
    leaf_side: f64,
    bytes_per_leaf_disk: f64,
    bytes_per_leaf_resident: f64,
}

#[derive(Serialize)]
struct RejectedCounts {
    degenerate: u64,
    collapsed: u64,
    non_finite: u64,
}

#[derive(Serialize)]
struct FileInfo {
    scene: String,
    file_id: String,
    input_triangle_count: u64,
    triangle_count: u64,
    vertex_count: u64,
    cluster_count: u64,
    wide_cluster_count: u64,
    page_count: usize,
    /// Pages among these that hold colours, which shading alone reads.
    colour_page_count: usize,
    /// And those that hold normals.
    normal_page_count: usize,
    material_count: usize,
    /// Their names, in order.
    #[serde(serialize_with = "names")]
    materials: Arc<MaterialNames>,
    emitter_count: usize,
    file_bytes: u64,
    bytes_per_triangle: BytesPerTriangle,
    section_bytes: SectionBytes,
    grid: Grid,
    asvo: Option<Asvo>,
    bounds: Aabb,
    rejected: RejectedCounts,
    /// Of `render` with nothing said.
    smallest_limit_bytes: u64,
    /// Of `view` with nothing said.
    smallest_limit_view_bytes: u64,
    /// Of this run's limit, or the smallest, for `render` with nothing said.
    shares: MemoryPlan,
}

/// Names one by one: there may be as many as the limit has room for.
fn names<S: Serializer>(names: &MaterialNames, to: S) -> Result<S::Ok, S::Error> {
    to.collect_seq(names.iter())
}

impl RejectedCounts {
    fn of(block: &Superblock) -> RejectedCounts {
        RejectedCounts {
            degenerate: block.rejected_degenerate,
            collapsed: block.rejected_collapsed,
            non_finite: block.rejected_non_finite,
        }
    }
}

impl Grid {
    fn of(block: &Superblock) -> Grid {
        Grid {
            step: block.lattice.step(),
            bits: block.lattice_bits,
            origin: block.lattice.origin,
            error_bound: block.error_bound,
        }
    }
}

impl FileInfo {
    fn new(file: &PageFile, ctx: &Context) -> trex_store::Result<FileInfo> {
        let block = file.superblock();
        let picture = render_needs(file, ctx)?;
        let smallest_limit_bytes = MemoryPlan::smallest_limit_bytes(file, &picture)?;
        let limit_bytes = ctx.budget.limit_bytes().max(smallest_limit_bytes);
        let stored_pages = |kind| -> (usize, u64) {
            let pages = file.pages().iter().filter(|page| page.kind == kind);
            (pages.clone().count(), pages.map(|page| u64::from(page.stored_bytes)).sum())
        };
        let (mesh_page_count, mesh_and_tree) = stored_pages(PageKind::Mesh);
        let (unit_page_count, unit_bytes) = stored_pages(PageKind::Units);
        let (colour_page_count, colour_bytes) = stored_pages(PageKind::Colours);
        let (normal_page_count, normal_bytes) = stored_pages(PageKind::Normals);
        let top = size_of_val(file.top()) as u64;
        let (upper, lower) = (file.upper_size()?, file.lower_size()?);
        let upper_bytes = upper.map_or(0, |upper| upper.stored_bytes);
        let lower_bytes = unit_bytes + lower.map_or(0, |lower| lower.stored_bytes);
        let beside_bytes = colour_bytes + normal_bytes + upper_bytes + lower_bytes;
        let tables = block.file_bytes - mesh_and_tree - top - beside_bytes;
        let resident = (mesh_page_count * FRAME_BYTES) as u64 + file.resident_table_bytes();
        let per = |bytes: u64| bytes as f64 / block.triangle_count.max(1) as f64;
        Ok(FileInfo {
            scene: file.path().display().to_string(),
            file_id: format!("{:016x}", block.file_id),
            input_triangle_count: block.input_triangle_count,
            triangle_count: block.triangle_count,
            vertex_count: block.vertex_count,
            cluster_count: block.cluster_count,
            wide_cluster_count: block.wide_cluster_count,
            page_count: file.pages().len(),
            colour_page_count,
            normal_page_count,
            material_count: file.materials().len(),
            materials: file.material_names().clone(),
            emitter_count: file.emitters().len(),
            file_bytes: block.file_bytes,
            bytes_per_triangle: BytesPerTriangle {
                disk: per(block.file_bytes - beside_bytes),
                colours: per(colour_bytes),
                normals: per(normal_bytes),
                resident: per(resident),
                file: per(block.file_bytes),
            },
            section_bytes: SectionBytes {
                mesh: mesh_and_tree - block.page_tree_bytes.min(mesh_and_tree),
                tree: block.page_tree_bytes.min(mesh_and_tree) + top,
                colours: colour_bytes,
                normals: normal_bytes,
                asvo_upper: upper_bytes,
                asvo_lower: lower_bytes,
                tables,
            },
            grid: Grid::of(block),
            asvo: upper.map(|upper| {
                let leaf_count_lower = lower.map_or(0, |lower| lower.leaf_count);
                let unit_frames = (unit_page_count * FRAME_BYTES) as u64;
                let resident =
                    upper.resident_bytes + lower.map_or(0, |lower| lower.resident_bytes) + unit_frames;
                let per_leaf =
                    |bytes: u64| bytes as f64 / (f64::from(upper.leaf_count) + leaf_count_lower as f64);
                Asvo {
                    r_u: upper.resolution,
                    r_finest: upper.resolution * lower.map_or(1, |lower| lower.refinement.factor()),
                    leaf_count_upper: upper.leaf_count,
                    leaf_count_lower,
                    unit_page_count,
                    facet_count: upper.facet_count,
                    leaf_side: upper.leaf_steps as f64 * block.lattice.step(),
                    bytes_per_leaf_disk: per_leaf(upper_bytes + lower_bytes),
                    bytes_per_leaf_resident: per_leaf(resident),
                }
            }),
            bounds: block.bounds,
            rejected: RejectedCounts::of(block),
            smallest_limit_bytes,
            smallest_limit_view_bytes: smallest_view_bytes(file, ctx)?,
            shares: MemoryPlan::new(file, &picture, limit_bytes)?,
        })
    }
}

impl fmt::Display for FileInfo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{}: {} triangles, {} vertices, {} clusters ({} wide), {} pages, {}",
            one_line(&self.scene),
            size::count(self.triangle_count),
            size::count(self.vertex_count),
            size::count(self.cluster_count),
            self.wide_cluster_count,
            self.page_count,
            size::bytes(self.file_bytes)
        )?;
        writeln!(
            f,
            "input {} triangles, {} without area, {} smaller than the lattice tells, {} not finite; {} materials, {} \
             emitters",
            size::count(self.input_triangle_count),
            self.rejected.degenerate - self.rejected.collapsed,
            self.rejected.collapsed,
            self.rejected.non_finite,
            self.material_count,
            self.emitter_count
        )?;
        let named = self.materials.iter().take(NAMED).map(one_line).collect::<Vec<_>>().join(", ");
        let more = if self.material_count > NAMED { ", ... (--json lists all)" } else { "" };
        writeln!(f, "materials: {named}{more}")?;
        let per = &self.bytes_per_triangle;
        writeln!(
            f,
            "bytes per triangle: {:.2} on disk ({:.2} with voxels), {:.2} resident",
            per.disk, per.file, per.resident
        )?;
        writeln!(
            f,
            "lattice of {} bits, step {:e}, vertices within {:e} of the input",
            self.grid.bits, self.grid.step, self.grid.error_bound
        )?;
        if self.colour_page_count > 0 {
            writeln!(f, "colours: {} pages, {:.2} bytes per triangle", self.colour_page_count, per.colours)?;
        }
        if self.normal_page_count > 0 {
            writeln!(f, "normals: {} pages, {:.2} bytes per triangle", self.normal_page_count, per.normals)?;
        }
        match &self.asvo {
            Some(asvo) => writeln!(
                f,
                "voxels: {} leaves of {}^3, side {:.4}, {} in units up to {}^3; {:.1} bytes per leaf on disk, \
                 {:.1} resident",
                size::count(u64::from(asvo.leaf_count_upper)),
                asvo.r_u,
                asvo.leaf_side,
                size::count(asvo.leaf_count_lower),
                asvo.r_finest,
                asvo.bytes_per_leaf_disk,
                asvo.bytes_per_leaf_resident
            )?,
            None => writeln!(f, "no voxels")?,
        }
        writeln!(f, "box {:?} to {:?}", self.bounds.lo, self.bounds.hi)?;
        writeln!(f, "memory of `trex render`: {}", size::memory_plan(&self.shares))?;
        // Rounded up: a limit that is named works.
        let named = |bytes: u64| format!("{}MiB", bytes.div_ceil(1 << 20));
        let [render, view] = [self.smallest_limit_bytes, self.smallest_limit_view_bytes].map(named);
        let [width, height] = FIRST_RESOLUTION;
        write!(
            f,
            "smallest --memory-limit: {render} for `trex render`, {view} for `trex view` of {width}x{height}"
        )
    }
}
