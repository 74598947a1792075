//! The file that `view` shows: a page file or a scene as it is; a mesh, or a volume at the values that are asked for,
//! is built first, beside itself, once.
//!
//! ```text
//! statue.ply -> statue.ply.trex, unless that is there and no older -> shown
//!            -> statue.ply.toml where the mesh has cameras or lights: that is shown
//! head.nrrd --iso 60 -> head.nrrd.iso-60.trex
//! ```
//!
//! Invariant: the only file that is replaced is one of that name which is older than its mesh.

use super::build::{Work, resume_of};
use super::inputs::{self, InputList};
use crate::args::ViewArgs;
use crate::context::Context;
use crate::values::Input;
use std::ffi::OsString;
use std::path::{Path, PathBuf};
use trex_store::build::{self, ExistingOutput, Precision, Voxels};
use trex_store::import::{ByteOrder, Format, RawVolume, VolumeOptions};
use trex_store::output::{check_apart, draft};
use trex_store::printable::one_line;
use trex_store::{Code, Error, PageFile, Result};

/// Endings of files that are built first.
const MESHES: [&str; 5] = ["ply", "obj", "stl", "gltf", "glb"];

/// The page file or scene to show; it is built where the command names a mesh or a generator, and has not been.
///
/// # Errors
/// [`Code::Usage`] for an output beside what needs none; [`Code::Io`] where the folder cannot be written; those of the
/// build.
pub fn shown_file(args: &ViewArgs, ctx: &Context) -> Result<PathBuf> {
    let volumes = args.volumes.options();
    if is_volume(&args.file) && volumes.iso_values.is_empty() {
        return Err(Error::new(Code::Usage, "a volume is shown at a value")
            .at(&args.file)
            .numbers("which value its surface has is for you to say")
            .next(format!("trex view {} --iso VALUE", args.file.display())));
    }
    let Some(input) = mesh_input(&args.file) else {
        InputList { inputs: &[], volumes: &volumes }.check()?;
        return match &args.output {
            None => Ok(args.file.clone()),
            Some(output) => Err(Error::new(Code::Usage, "there is nothing to build")
                .at_place("-o")
                .numbers(format!("{} is shown as it is", args.file.display()))
                .next(format!("leave out -o {}, or name a mesh", output.display()))),
        };
    };
    let inputs = [input];
    let list = InputList { inputs: &inputs, volumes: &volumes };
    list.check()?;
    let output = args.output.clone().unwrap_or_else(|| beside(list));
    if !is_current(&output, &inputs[0]) {
        build_first(list, &output, args, ctx)?;
    }
    // A build writes a scene where its input has a camera or lights.
    let scene = output.with_extension("toml");
    Ok(if args.output.is_none() && scene.is_file() { scene } else { output })
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

/// True when `output` is a page file, and no older than its mesh.
fn is_current(output: &Path, input: &Input) -> bool {
    let changed = |path: &Path| path.metadata().and_then(|found| found.modified());
    let is_newer = match input {
        Input::Generated(_) => true,
        Input::File(mesh) => changed(output).is_ok_and(|built| changed(mesh).is_ok_and(|mesh| built >= mesh)),
    };
    is_newer && PageFile::superblock_of(output).is_ok()
}

fn build_first(list: InputList<'_>, output: &Path, args: &ViewArgs, ctx: &Context) -> Result<()> {
    if let Input::File(path) = &list.inputs[0] {
        // What is not there is said of the mesh.
        path.metadata().map_err(|error| Error::io("open the input", path, &error))?;
        check_apart(output, path)?;
    }
    if args.output.is_some() && output.symlink_metadata().is_ok() {
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
        existing: ExistingOutput::replace_if(args.output.is_none()),
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
                beside(InputList { inputs: &[input], volumes: &volumes })
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
        let found = beside(InputList { inputs: &inputs, volumes: &volumes });
        assert_eq!(found, Path::new("a/head.raw.4x5x6-uint16be-1-1-0.5.iso-60--1.5.trex"));
    }
}
