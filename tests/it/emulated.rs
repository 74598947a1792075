//! Machines that lack what fast arithmetic needs, as an emulator shows them: the same page file and the same pictures,
//! byte for byte.

use crate::command::{Ran, TREX, cannot_run_without, document_in, folder, hash_of, ran};
use std::path::Path;
use std::process::{Command, Stdio};

const EMULATOR: &str = "qemu-x86_64";
/// A processor of 2008: without AVX, AVX2 and FMA.
const PROCESSOR: &str = "Nehalem";

/// Runs `trex LINE` on that processor.
fn emulated(inside: &Path, line: &str) -> Ran {
    let mut command = Command::new(EMULATOR);
    command.args(["-cpu", PROCESSOR, TREX]).args(line.split_whitespace()).current_dir(inside);
    ran(line, command.stdin(Stdio::null()).output().unwrap())
}

/// The bytes of files and pictures do not tell which arithmetic made them.
#[test]
#[cfg(target_arch = "x86_64")]
fn a_processor_without_avx2_makes_the_same_bytes() {
    let known = Command::new(EMULATOR).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    if !known.is_ok_and(|status| status.success()) {
        return cannot_run_without(EMULATOR);
    }
    let inside = folder();
    let hash = |name: &str| hash_of(&inside.path().join(name));
    let build = "build gen:pipes:10k:3 --voxels 64/256 --threads 2 -o";
    let picture = "--resolution 48x32 --spp 1 --photons 5k --threads 2 -o";
    document_in(inside.path(), &format!("{build} here.trex"));
    emulated(inside.path(), &format!("{build} there.trex -q")).expect(0);
    assert_eq!(hash("here.trex"), hash("there.trex"), "the page file");
    for integrator in ["photon", "path", "full-gi", "direct --lod-error 1", "debug-lower"] {
        let line = |out: &str| {
            format!("render here.trex --integrator {integrator} {picture} {out}.exr --overwrite --json -q")
        };
        let here = document_in(inside.path(), line("here").trim_end_matches(" --json -q"));
        let ran = emulated(inside.path(), &line("there"));
        ran.expect(0);
        let there = ran.document();
        assert_eq!(there["arithmetic"], "scalar", "{integrator}: {there:#}");
        for kind in ["primary", "shadow", "gather"] {
            assert_eq!(there["rays"][kind], here["rays"][kind], "{integrator}: {kind}");
        }
        assert_eq!(hash("here.exr"), hash("there.exr"), "{integrator}: the picture");
    }
}
