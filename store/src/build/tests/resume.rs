//! Builds that are stopped again and again and resumed: the bytes of one that was never stopped, whatever was left of
//! them; and which build may resume which.

use super::*;
use crate::next_step::NextStep;
use crate::octree::Refinement;
use std::collections::BTreeSet;
use std::sync::atomic::{AtomicUsize, Ordering};

/// A build in a folder of its own.
struct Stage {
    folder: tempfile::TempDir,
    mesh: MemoryMesh,
    options: BuildOptions,
    whole: Vec<u8>,
}

impl Stage {
    /// A sheet of `2 n^2` triangles and some more, in several chunks with pages that they share, and lamps.
    fn new(n: usize, voxels: Voxels) -> Stage {
        Stage::of(mesh(n, 9_000, 7), voxels)
    }

    fn of(mut mesh: MemoryMesh, voxels: Voxels) -> Stage {
        let plain = BuildOptions { voxels, ..options(2, 1 << 30) };
        let (whole, report) = build_bytes(&mut mesh, &plain);
        assert!(report.page_count > 10 && report.emitter_count > 0, "{report:?}");
        let input = vec![("input".to_owned(), "a mesh".to_owned())];
        let resume = Some(Resume { input, every: Duration::ZERO });
        let options = BuildOptions { resume, ..plain };
        Stage { folder: tempfile::tempdir().unwrap(), mesh, options, whole }
    }

    fn output(&self) -> PathBuf {
        self.folder.path().join("out.trex")
    }

    /// Builds until so many reports have come since the input was read; a build that comes to its end gives its report.
    fn build_for(&mut self, reports: usize) -> Result<BuildReport> {
        self.build_until(reports, |phase| !["scan", "partition"].contains(&phase))
    }

    /// Builds until so many reports of certain phases have come.
    fn build_until(&mut self, reports: usize, counts: impl Fn(&str) -> bool + Sync) -> Result<BuildReport> {
        self.mesh.rewind().unwrap();
        self.options.interrupt = Interrupt::default();
        let (seen, interrupt) = (AtomicUsize::new(0), self.options.interrupt.clone());
        let report = |progress: Progress| {
            if counts(progress.phase) && seen.fetch_add(1, Ordering::Relaxed) + 1 >= reports {
                interrupt.raise();
            }
        };
        build(&mut self.mesh, &self.folder.path().join("out.trex"), &self.options, &|_| {}, &report)
    }

    /// Stops a build once chunks are done.
    fn stop_among_chunks(&mut self) {
        for reports in 1.. {
            let error = self.build_for(reports).unwrap_err();
            assert_eq!(error.code(), Code::Interrupted);
            if self.left("done").exists() {
                return;
            }
        }
    }

    /// The left file of an ending.
    fn left(&self, ending: &str) -> PathBuf {
        let names = self.names();
        let name = names.iter().find(|name| name.ends_with(&format!(".{ending}")));
        self.folder.path().join(name.map_or("none", String::as_str))
    }

    fn names(&self) -> BTreeSet<String> {
        let entries = std::fs::read_dir(self.folder.path()).unwrap();
        entries.map(|entry| entry.unwrap().file_name().into_string().unwrap()).collect()
    }

    /// Resumes to the end, whose bytes must be those of a build that was never stopped, with nothing beside them.
    #[track_caller]
    fn finish(&mut self) -> BuildReport {
        let report = self.build_for(usize::MAX).unwrap();
        assert!(std::fs::read(self.output()).unwrap() == self.whole, "other bytes");
        assert_eq!(self.names(), BTreeSet::from(["out.trex".to_owned()]));
        std::fs::remove_file(self.output()).unwrap();
        report
    }
}

#[test]
fn however_often_it_is_stopped_the_bytes_are_the_same() {
    let refined = Voxels::Refined { upper: 64, refinement: Refinement::By4 };
    let stages =
        [(Voxels::None, false), (Voxels::None, true), (Voxels::Resolution(256), false), (refined, true)];
    for (voxels, has_attributes) in stages {
        let mut stage = Stage::of(MemoryMesh { has_attributes, ..mesh(400, 9_000, 7) }, voxels);
        // Stopped at each report in turn, most of which are of chunks; each build resumes the one before it.
        let (mut stops, mut resumed) = (0, BTreeSet::new());
        let report = loop {
            match stage.build_for(1 + stops) {
                Ok(report) => break report,
                Err(error) => assert_eq!(error.code(), Code::Interrupted, "{error}"),
            }
            stops += 1;
            resumed.insert(stage.left("done").exists());
            assert!(stops < 1000, "no end");
        };
        assert!(stops > 2 && resumed.contains(&true), "{voxels:?}: {stops} stops");
        assert!(report.resumed_triangle_count > 0);
        assert!(std::fs::read(stage.output()).unwrap() == stage.whole, "{voxels:?}: other bytes");
        assert_eq!(stage.names(), BTreeSet::from(["out.trex".to_owned()]));
    }
}

/// Stops a build after so many batches are in cells.
fn stop_among_batches(stage: &mut Stage, batches: usize) {
    let error = stage.build_until(batches + 1, |phase| phase == "partition").unwrap_err();
    assert_eq!(error.code(), Code::Interrupted, "{error}");
    assert!(stage.left("sorted").exists() && !stage.left("chunks").exists());
    assert!(error.numbers_text().contains("kept"), "{error}");
}

/// It cost all that was sorted, and what was done of the chunks.
#[test]
fn a_limit_that_is_too_small_costs_nothing_that_was_done() {
    let mut stage = Stage::new(400, Voxels::Resolution(64));
    stage.stop_among_chunks();
    let enough = std::mem::replace(&mut stage.options.budget, Budget::new(crate::RESERVE_BYTES + (3 << 20)));
    let error = stage.build_for(usize::MAX).unwrap_err();
    assert_eq!(error.code(), Code::MemoryLimit, "{error}");
    assert!(error.numbers_text().contains("are kept beside the output"), "{error}");
    assert!(matches!(error.next_step_kind(), NextStep::RaiseLimit { .. }), "{error}");
    assert!(stage.left("done").exists());
    stage.options.budget = enough;
    assert!(stage.finish().resumed_triangle_count > 0);
}

/// A header of more than a megabyte was none when it was read again: nothing was resumed, nobody found what was left.
#[test]
fn what_thousands_of_inputs_left_is_found() {
    let mut stage = Stage::new(280, Voxels::None);
    let input = (0..6000).map(|index| (format!("input {index}"), "a".repeat(300))).collect();
    stage.options.resume = Some(Resume { input, every: Duration::ZERO });
    stage.stop_among_chunks();
    assert_eq!(left_over::find(&stage.output()).unwrap().len(), 1);
    assert!(stage.finish().resumed_triangle_count > 0);
}

/// A sheet in one corner of what it lies in: its cell holds more than a chunk, and is cut.
fn crowded() -> MemoryMesh {
    let mut mesh = mesh(300, 2_000, 7);
    let far = [[0.0, 1500.0, 0.0], [3.0, 1500.0, 0.0], [0.0, 1500.0, 3.0]];
    mesh.triangles.insert(90_500, (far, 0));
    mesh
}

#[test]
fn what_is_in_cells_is_not_sorted_again() {
    for mesh in [mesh(280, 9_000, 7), crowded()] {
        let batches = mesh.triangles.len().div_ceil(1000);
        let mut stage = Stage::of(mesh, Voxels::Within { upper_bytes: 1 << 20 });
        // From nothing; after some; after some more of the same build; after the last.
        for stops in [&[0][..], &[1, 2], &[40, 91, 92, 150], &[batches - 1, batches]] {
            stops.iter().for_each(|&batches| stop_among_batches(&mut stage, batches));
            let report = stage.finish();
            let sorted = 1000 * *stops.last().unwrap() as u64;
            let expected = sorted.min(stage.mesh.triangles.len() as u64);
            // What an interrupt stops is the batch after the last that was recorded.
            assert_eq!(report.resumed_sorted_count, expected, "{stops:?}");
            assert_eq!(report.resumed_triangle_count, 0);
        }
        // Then among chunks.
        stop_among_batches(&mut stage, 70);
        stage.stop_among_chunks();
        assert!(!stage.left("sorted").exists());
        let report = stage.finish();
        assert!(report.resumed_triangle_count > 0 && report.resumed_sorted_count == 0, "{report:?}");
    }
}

#[test]
fn cells_are_gone_on_with_where_they_are_whole_and_of_this_input() {
    let mut stage = Stage::new(280, Voxels::None);
    stop_among_batches(&mut stage, 100);
    let left: Vec<(PathBuf, Vec<u8>)> = stage
        .names()
        .iter()
        .map(|name| stage.folder.path().join(name))
        .map(|path| (path.clone(), std::fs::read(&path).unwrap()))
        .collect();
    let again = || left.iter().for_each(|(path, bytes)| std::fs::write(path, bytes).unwrap());
    for ending in ["cells", "sorted"] {
        again();
        std::fs::remove_file(stage.left(ending)).unwrap();
        assert_eq!(stage.finish().resumed_sorted_count, 0, "{ending} was gone");
        again();
        std::fs::File::options().write(true).open(stage.left(ending)).unwrap().set_len(1000).unwrap();
        assert_eq!(stage.finish().resumed_sorted_count, 0, "{ending} was cut off");
    }
    again();
    let mut bytes = std::fs::read(stage.left("cells")).unwrap();
    bytes[20_000] ^= 8;
    std::fs::write(stage.left("cells"), bytes).unwrap();
    assert_eq!(stage.build_for(usize::MAX).unwrap_err().code(), Code::Io);
    assert_eq!(stage.names(), BTreeSet::new());

    // Another triangle among those that were read, and then a stream that ends before them.
    let changed = [(70_000, 5), (99_999, 6)];
    for (index, x) in changed {
        again();
        let before = std::mem::replace(&mut stage.mesh.triangles[index].0[0][0], f64::from(x));
        let error = stage.build_for(usize::MAX).unwrap_err();
        assert_eq!(error.code(), Code::Usage, "{error}");
        assert!(error.numbers_text().contains("the first 100000 triangles"), "{error}");
        assert!(
            stage.left("sorted").exists() && *error.next_step_kind() == NextStep::SameInputOrClean,
            "{error}"
        );
        stage.mesh.triangles[index].0[0][0] = before;
    }
    let all = stage.mesh.triangles.clone();
    stage.mesh.triangles.truncate(99_000);
    assert_eq!(stage.build_for(usize::MAX).unwrap_err().code(), Code::Usage);
    stage.mesh.triangles = all;
    assert_eq!(stage.finish().resumed_sorted_count, 100_000);
}

/// What is left may be gone in part, cut off, or changed: then less is resumed, or there is an error, and the
/// build after that one starts afresh. The bytes are never others.
#[test]
fn what_is_left_may_be_damaged() {
    let mut stage = Stage::new(280, Voxels::Resolution(64));
    stage.stop_among_chunks();
    let left: Vec<(PathBuf, Vec<u8>)> = stage
        .names()
        .iter()
        .map(|name| stage.folder.path().join(name))
        .map(|path| (path.clone(), std::fs::read(path).unwrap()))
        .collect();
    let again = || left.iter().for_each(|(path, bytes)| std::fs::write(path, bytes).unwrap());
    assert!(stage.finish().resumed_triangle_count > 0);
    for ending in ["part", "cells", "voxels", "chunks", "done"] {
        again();
        std::fs::remove_file(stage.left(ending)).unwrap();
        assert_eq!(stage.finish().resumed_triangle_count, 0, "{ending} was gone");
        again();
        std::fs::File::options().write(true).open(stage.left(ending)).unwrap().set_len(1000).unwrap();
        assert_eq!(stage.finish().resumed_triangle_count, 0, "{ending} was cut off");
        for part in [0.0, 0.6] {
            again();
            let mut bytes = std::fs::read(stage.left(ending)).unwrap();
            let at = (part * bytes.len() as f64) as usize;
            bytes[at] ^= 8;
            std::fs::write(stage.left(ending), bytes).unwrap();
            match stage.build_for(usize::MAX) {
                // What was changed is not needed, or was found and made again.
                Ok(_) => assert!(std::fs::read(stage.output()).unwrap() == stage.whole, "{ending} at {part}"),
                Err(error) => assert_eq!(error.code(), Code::Io, "{ending} at {part}: {error}"),
            }
            let _ = std::fs::remove_file(stage.output());
            assert_eq!(stage.names(), BTreeSet::new(), "{ending} at {part}");
        }
    }
    // Nothing is left of the last one.
    assert_eq!(stage.finish().resumed_triangle_count, 0);
}

#[test]
fn a_build_goes_on_with_the_same_input_and_options_alone() {
    let mut stage = Stage::new(280, Voxels::Resolution(64));
    let colours = tempfile::tempdir().unwrap();
    let colours = [colours.path().join("first.mtl"), colours.path().join("second.mtl")];
    std::fs::write(&colours[0], "newmtl a").unwrap();
    stage.mesh.named = colours.to_vec();
    stage.stop_among_chunks();
    let (names, resume) = (stage.names(), stage.options.resume.clone());
    let refused = |stage: &mut Stage, words: &[&str]| {
        let error = stage.build_for(usize::MAX).unwrap_err();
        assert_eq!(error.code(), Code::Usage, "{error}");
        assert!(words.iter().all(|word| error.numbers_text().contains(word)), "{error}");
        assert_eq!(error.numbers_text().matches(" then, ").count(), 1, "{error}");
        assert!(*error.next_step_kind() == NextStep::SameInputOrClean, "{error}");
        assert_eq!(stage.names(), names, "a refused build removed something");
    };
    stage.options.voxels = Voxels::None;
    refused(&mut stage, &["voxels", "Resolution(64) then", "None now"]);
    stage.options.voxels = Voxels::Resolution(64);
    stage.options.precision = Precision::GridBits(20);
    refused(&mut stage, &["precision", "Default then", "GridBits(20) now"]);
    stage.options.precision = Precision::Default;
    stage.options.resume.as_mut().unwrap().input[0].1 = "a longer mesh".into();
    refused(&mut stage, &["input", "a mesh then", "a longer mesh now"]);
    stage.options.resume = resume;
    // What the input names counts, too: a file that was missing, and one that is not what it was.
    std::fs::write(&colours[1], "newmtl b").unwrap();
    refused(&mut stage, &["second.mtl", "not there then", "8 bytes"]);
    std::fs::remove_file(&colours[1]).unwrap();
    let changed = colours[0].metadata().unwrap().modified().unwrap();
    std::fs::write(&colours[0], "newmtl a, and more").unwrap();
    refused(&mut stage, &["first.mtl", "8 bytes", "18 bytes"]);
    std::fs::write(&colours[0], "newmtl a").unwrap();
    std::fs::File::options().write(true).open(&colours[0]).unwrap().set_modified(changed).unwrap();
    // Threads and limits change no byte.
    let BuildOptions { pool, budget, .. } = options(1, 200 << 20);
    (stage.options.pool, stage.options.budget) = (pool, budget);
    assert!(stage.finish().resumed_triangle_count > 0);
}

#[test]
fn two_builders_of_one_output_are_kept_apart() {
    let mut stage = Stage::new(280, Voxels::None);
    stage.stop_among_chunks();
    let busy = AtomicUsize::new(0);
    let (other, output) = (stage.options.clone(), stage.output());
    let mut twin = mesh(10, 0, 1);
    let twin = std::sync::Mutex::new(&mut twin);
    let report = |progress: Progress| {
        if progress.phase != "clusters" {
            return;
        }
        for resume in [other.resume.clone(), None] {
            let options = BuildOptions { resume, ..other.clone() };
            let error = build(*twin.lock().unwrap(), &output, &options, &|_| {}, &|_| {}).unwrap_err();
            assert!(error.code() == Code::Usage && error.what().contains("at work"), "{error}");
        }
        assert_eq!(left_over::clean(&output).unwrap_err().code(), Code::Usage);
        let found = left_over::find(output.parent().unwrap()).unwrap();
        assert!(found.len() == 1 && found[0].is_running, "{found:?}");
        busy.fetch_add(1, Ordering::Relaxed);
    };
    stage.mesh.rewind().unwrap();
    stage.options.interrupt = Interrupt::default();
    build(&mut stage.mesh, &output, &stage.options, &|_| {}, &report).unwrap();
    assert!(busy.into_inner() > 0 && std::fs::read(&output).unwrap() == stage.whole);
}

/// The checkpoint that a build would resume from, and the records that are there then.
fn checkpoint_of(stage: &Stage) -> (&'static str, Vec<&'static str>) {
    let journal = Journal::begin(&stage.output(), stage.folder.path(), &stage.options);
    let mut journal = journal.unwrap().expect("these builds can be resumed");
    let name = match Checkpoint::find(Some(&mut journal), &stage.options).unwrap() {
        Checkpoint::Fresh => "fresh",
        Checkpoint::Sorted(_) => "sorted",
        Checkpoint::Partitioned(_) => "partitioned",
        Checkpoint::Emitting(..) => "emitting",
    };
    journal.keep();
    (name, ["sorted", "chunks", "done"].into_iter().filter(|&ending| stage.left(ending).exists()).collect())
}

/// A file that is too short for what a record says leads to the checkpoint before; records of later ones go.
#[test]
fn each_checkpoint_keeps_its_own_records() {
    let mut stage = Stage::new(280, Voxels::Resolution(64));
    assert_eq!(checkpoint_of(&stage), ("fresh", vec![]));
    let cut = |stage: &Stage, ending: &str| {
        std::fs::OpenOptions::new().write(true).open(stage.left(ending)).unwrap().set_len(100).unwrap();
    };
    stop_among_batches(&mut stage, 40);
    assert_eq!(checkpoint_of(&stage), ("sorted", vec!["sorted"]));
    cut(&stage, "cells");
    assert_eq!(checkpoint_of(&stage), ("fresh", vec![]));
    for (ending, checkpoint) in [("part", ("partitioned", vec!["chunks"])), ("cells", ("fresh", vec![]))] {
        stage.stop_among_chunks();
        assert_eq!(checkpoint_of(&stage), ("emitting", vec!["chunks", "done"]));
        cut(&stage, ending);
        assert_eq!(checkpoint_of(&stage), checkpoint);
        stage.finish();
    }
}

#[test]
fn what_is_left_is_found_and_removed() {
    let mut stage = Stage::new(280, Voxels::Resolution(64));
    let scratch = tempfile::tempdir().unwrap();
    stage.options.temp_dir = Some(scratch.path().to_path_buf());
    let in_scratch = || std::fs::read_dir(scratch.path()).unwrap().count();
    let places = [stage.output(), stage.folder.path().to_path_buf()];
    for place in &places {
        assert!(left_over::find(place).unwrap().is_empty() && left_over::clean(place).unwrap().is_empty());
        stage.stop_among_chunks();
        std::fs::write(stage.folder.path().join("mine.journal"), "{}").unwrap();
        let found = left_over::find(place).unwrap();
        assert_eq!((found.len(), in_scratch()), (1, 2), "{found:?}");
        let there = stage.names().len() - 1 + in_scratch();
        assert_eq!((found[0].output.as_path(), found[0].file_count), (places[0].as_path(), there));
        assert!(found[0].bytes > 100_000 && !found[0].is_running, "{found:?}");
        assert_eq!(left_over::clean(place).unwrap(), found);
        assert_eq!((stage.names(), in_scratch()), (BTreeSet::from(["mine.journal".to_owned()]), 0));
        std::fs::remove_file(stage.folder.path().join("mine.journal")).unwrap();
    }
    // A build that leaves nothing removes what others have left, and is no worse for it.
    stage.stop_among_chunks();
    stage.options.resume = None;
    assert_eq!(stage.build_for(3).unwrap_err().code(), Code::Interrupted);
    assert_eq!((stage.names(), in_scratch()), (BTreeSet::new(), 0));
    assert_eq!(stage.finish().resumed_triangle_count, 0);
}
