//! The file that `view` shows: a page file or a scene as it is; a mesh, or a volume at the values that are asked for,
//! is built first, beside itself, once.
//!
//! ```text
//! statue.ply -> statue.ply.trex, unless that is there and no older -> shown
//!            -> statue.ply.toml where the mesh has cameras or lights: that is shown
//! head.nrrd --iso 60 -> head.nrrd.iso-60.trex
//! ```
//!
//! Invariant: the only files that are replaced are one of that name which is older than its mesh, and what this process
//! has built.

use super::build::{Work, resume_of};
use super::inputs::{self, InputList};
use crate::args::ViewArgs;
use crate::context::Context;
use crate::values::Input;
use std::cell::Cell;
use std::ffi::OsString;
use std::iter;
use std::path::{Path, PathBuf};
use trex_model::open_scene;
use trex_store::build::{self, ExistingOutput, Precision, Voxels};
use trex_store::import::{self, ByteOrder, Format, ImportOptions, RawVolume, VolumeOptions};
use trex_store::output::{check_apart, draft};
use trex_store::printable::one_line;
use trex_store::{Code, Error, PageFile, Result, is_url};

/// Endings of files that are built first.
const MESHES: [&str; 5] = ["ply", "obj", "stl", "gltf", "glb"];

/// What `view` was asked for: a file that is shown as it is, or one that is built of a mesh.
pub struct ShownInput {
    /// The mesh, volume or generator; none for what is shown as it is.
    inputs: Vec<Input>,
    volumes: VolumeOptions,
    /// What is shown as it is, or what is built.
    file: PathBuf,
    /// This process has built it, and may replace it.
    is_ours: Cell<bool>,
    /// It is known to be of what the mesh was before.
    is_outdated: Cell<bool>,
}

impl ShownInput {
    /// What the command names.
    ///
    /// # Errors
    /// [`Code::Usage`] for an output beside what needs none, or a volume without a value.
    pub fn of(args: &ViewArgs) -> Result<ShownInput> {
        let volumes = args.volumes.options();
        if is_volume(&args.file) && volumes.iso_values.is_empty() {
            return Err(Error::new(Code::Usage, "a volume is shown at a value")
                .at(&args.file)
                .numbers("which value its surface has is for you to say")
                .next(format!("trex view {} --iso VALUE", args.file.display())));
        }
        let inputs = Vec::from_iter(mesh_input(&args.file));
        let list = InputList::whole(&inputs, &volumes);
        list.check()?;
        let file = match &args.output {
            Some(output) if inputs.is_empty() => {
                return Err(Error::new(Code::Usage, "there is nothing to build")
                    .at_place("-o")
                    .numbers(format!("{} is shown as it is", args.file.display()))
                    .next(format!("leave out -o {}, or name a mesh", output.display())));
            }
            _ if inputs.is_empty() => args.file.clone(),
            Some(output) => output.clone(),
            None => beside(list),
        };
        Ok(ShownInput { inputs, volumes, file, is_ours: Cell::new(false), is_outdated: Cell::new(false) })
    }

    /// True when there is a build to be waited for.
    pub fn needs_build(&self, ctx: &Context) -> bool {
        !self.inputs.is_empty() && (self.is_outdated.get() || !is_current(&self.file, &self.read_files(ctx)))
    }

    /// The files that a build reads: the mesh or volume, and what that names. What cannot be read now is left to the
    /// build, and to the next look.
    fn read_files(&self, ctx: &Context) -> Vec<PathBuf> {
        let Some(Input::File(mesh)) = self.inputs.first() else { return Vec::new() };
        let mut options = ImportOptions::new(ctx.budget.clone(), Path::new("."));
        options.volumes = self.volumes.clone();
        let named = import::info(mesh, &options).map(|info| info.named_files).unwrap_or_default();
        iter::once(mesh.clone()).chain(named.into_iter().filter(|file| file.exists())).collect()
    }

    /// The mesh has changed: what was built of it is not shown again.
    pub fn outdate(&self) {
        self.is_outdated.set(true);
    }

    /// The page file or scene to show, built if it has to be.
    ///
    /// # Errors
    /// [`Code::Io`] where the folder cannot be written; those of the build.
    pub fn ready(&self, args: &ViewArgs, ctx: &Context) -> Result<PathBuf> {
        if self.needs_build(ctx) {
            let list = InputList::whole(&self.inputs, &self.volumes);
            build_first(list, &self.file, args.output.is_none() || self.is_ours.get(), args, ctx)?;
            self.is_ours.set(true);
            self.is_outdated.set(false);
        }
        // A build writes a scene where its input has a camera or lights; beside what was named another may stand.
        let scene = self.file.with_extension("toml");
        let is_of_it = || args.output.is_none() || is_scene_of(&scene, &self.file);
        let has_scene = !self.inputs.is_empty() && scene.is_file() && is_of_it();
        Ok(if has_scene { scene } else { self.file.clone() })
    }

    /// The files whose change is another model: the mesh and what it names, or the scene and its model.
    ///
    /// # Errors
    /// [`Code::Usage`] for what does not change, or is not told of.
    pub fn watched(&self, ctx: &Context) -> Result<Vec<PathBuf>> {
        match self.inputs.first() {
            Some(Input::File(_)) => Ok(self.read_files(ctx)),
            None if !is_url(&self.file) => {
                // A scene with a mistake is waited for, too.
                let model = open_scene(&self.file).map_or_else(|_| self.file.clone(), |(_, model)| model);
                let with_scene =
                    if model == self.file { vec![model] } else { vec![self.file.clone(), model] };
                Ok(with_scene.into_iter().filter(|path| !is_url(path)).collect())
            }
            _ => Err(Error::new(Code::Usage, "--watch is for files of this machine")
                .at(&self.file)
                .numbers("a generator and an address have no time of change here")
                .next("leave out --watch, or name a file")),
        }
    }
}

fn is_volume(file: &Path) -> bool {
    Format::of_path(file).is_some_and(Format::is_volume)
}

/// The mesh, volume or generator that `file` names, if it is one.
fn mesh_input(file: &Path) -> Option<Input> {
    match Input::from(OsString::from(file)) {
        Input::File(path) => {
            let ending = path.extension()?.to_str()?.to_ascii_lowercase();
            (MESHES.contains(&ending.as_str()) || is_volume(&path)).then_some(Input::File(path))
        }
        generated => Some(generated),
    }
}

/// Where the page file of a list of one is: `statue.ply.trex`, so that it is taken for no other mesh's, nor for the
/// same volume's at another value.
fn beside(list: InputList<'_>) -> PathBuf {
    let VolumeOptions { iso_values, raw } = list.volumes;
    let mut name = match &list.inputs[0] {
        Input::File(path) => path.clone().into_os_string(),
        Input::Generated(name) => name.trim_start_matches("gen:").replace(':', "-").into(),
    };
    if let Some(RawVolume { size: [x, y, z], sample, order, spacing }) = raw {
        let order = if *order == ByteOrder::Big { "be" } else { "" };
        name.push(format!(".{x}x{y}x{z}-{}{order}", sample.name()));
        if *spacing != [1.0; 3] {
            name.push(spacing.map(|step| format!("-{step}")).concat());
        }
    }
    if !iso_values.is_empty() {
        name.push(".iso");
        iso_values.iter().for_each(|value| name.push(format!("-{value}")));
    }
    name.push(".trex");
    name.into()
}

/// True when `output` is a page file, and no older than the files that a build of it reads.
fn is_current(output: &Path, read: &[PathBuf]) -> bool {
    let changed = |path: &Path| path.metadata().and_then(|found| found.modified());
    let is_newer =
        |file: &PathBuf| changed(output).is_ok_and(|built| changed(file).is_ok_and(|file| built >= file));
    read.iter().all(is_newer) && PageFile::superblock_of(output).is_ok()
}

/// True when `scene` is one of the page file `file`.
fn is_scene_of(scene: &Path, file: &Path) -> bool {
    let whole = |path: &Path| path.canonicalize().ok();
    open_scene(scene).is_ok_and(|(_, model)| whole(&model).is_some_and(|model| Some(model) == whole(file)))
}

fn build_first(
    list: InputList<'_>,
    output: &Path,
    may_replace: bool,
    args: &ViewArgs,
    ctx: &Context,
) -> Result<()> {
    if let Input::File(path) = &list.inputs[0] {
        // What is not there is said of the mesh.
        path.metadata().map_err(|error| Error::io("open the input", path, &error))?;
        check_apart(output, path)?;
    }
    if !may_replace && output.symlink_metadata().is_ok() {
        return Err(Error::new(
            Code::Usage,
            "the output exists, and is no page file of this mesh as it is now",
        )
        .at(output)
        .numbers("-o never replaces a file")
        .next("remove it, or name another -o"));
    }
    draft(output).map_err(|error| {
        Error::new(Code::Io, "the page file of this mesh cannot be written")
            .at(output)
            .numbers(error.to_string())
            .next("name a place for it: -o FILE.trex")
    })?;
    ctx.console.note(&format!("building {}, once", one_line(&output.display().to_string())));
    let work = Work {
        output,
        temp_dir: args.scratch.temp_dir.as_deref(),
        existing: ExistingOutput::replace_if(may_replace),
        precision: Precision::Default,
        voxels: Voxels::default(),
        resume: Some(resume_of(list)?),
    };
    let scratch = work.scratch_folder();
    let built = inputs::open(list, &scratch, build::smallest_bytes(), ctx)
        .and_then(|mut source| work.build(&mut *source, ctx))
        .map_err(|error| inputs::with_smallest_limit(error, list, &scratch, ctx))?;
    ctx.console.finish();
    built.to_string().lines().for_each(|line| ctx.console.note(line));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use trex_store::import::SampleType;

    #[test]
    fn meshes_are_built_under_names_of_their_own() {
        for (file, expected) in [
            ("a/statue.ply", Some("a/statue.ply.trex")),
            ("a/statue.OBJ", Some("a/statue.OBJ.trex")),
            ("gen:pipes:2M:3", Some("pipes-2M-3.trex")),
            ("statue.trex", None),
            ("view.toml", None),
            ("statue", None),
        ] {
            let found = mesh_input(Path::new(file)).map(|input| {
                let volumes = VolumeOptions::default();
                beside(InputList::whole(&[input], &volumes))
            });
            assert_eq!(found.as_deref(), expected.map(Path::new), "{file}");
        }
        let inputs = [Input::File("a/head.raw".into())];
        let raw = RawVolume {
            size: [4, 5, 6],
            sample: SampleType::from_name("uint16").unwrap(),
            order: ByteOrder::Big,
            spacing: [1.0, 1.0, 0.5],
        };
        let volumes = VolumeOptions { iso_values: vec![60.0, -1.5], raw: Some(raw) };
        let found = beside(InputList::whole(&inputs, &volumes));
        assert_eq!(found, Path::new("a/head.raw.4x5x6-uint16be-1-1-0.5.iso-60--1.5.trex"));
    }
}
