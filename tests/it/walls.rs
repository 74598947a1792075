//! Every verb inside control groups of exactly its `--memory-limit`, from the smallest that anybody would give to a
//! roomy one, on honest files, odd ones and hostile ones: it works, or says what is wrong or how much it needs; the
//! kernel never has to end it. `TREX_FAULTS=full` takes all sizes and all files, in parts that resume where that is
//! asked for (`campaign.rs`).

mod models;

use crate::calls::look;
use crate::campaign::Campaign;
use crate::cgroup::Cgroup;
use crate::command::{Ran, document_in, folder, said};
use crate::lies::Forger;
use crate::view::ViewProcess;
use models::{MODELS, real_files};
use std::fs;
use std::path::Path;
use std::time::{Duration, Instant};

const MIB: u64 = 1 << 20;
/// Sizes of groups, in MiB.
const ALL: [u64; 5] = [64, 80, 96, 128, 256];
const SOME: [u64; 2] = [64, 128];
/// The viewer is looked at until its picture is whole, and told to end.
const VIEW: &str = "view m.trex --no-open --resolution 320x240 --spp 1 --photons 10k";

/// What each verb is asked for of `m.trex`, and whether it writes.
const LINES: [&str; 10] = [
    "info m.trex",
    VIEW,
    "verify m.trex --quick",
    "verify m.trex",
    "verify m.trex --deep",
    "export m.trex -o out.ply --overwrite",
    "build m.ply -o built.trex --voxels 64 --threads 2 --overwrite",
    "render m.trex -o out.png --resolution 320x240 --spp 1 --integrator photon --photons 10k --overwrite",
    "render m.trex -o out.png --integrator direct --resolution 320x240 --spp 1 --overwrite --allow-damage",
    "stress m.trex --scenario flip --switches 4 --hold 300 --resolution 320x240",
];

/// Statuses that say what is wrong with a file or a limit; a panic would be 70, a kill none.
fn is_reported(code: Option<i32>, line: &str, is_honest: bool) -> bool {
    match code {
        Some(0 | 4) => true,
        // Stress judges its times: on a busy machine they are missed. An honest file is not damaged.
        Some(1) => !is_honest || line.starts_with("stress"),
        Some(3) => !is_honest,
        _ => false,
    }
}

/// An honest file that is called damaged, and a missed verdict on one, were one and the same status here.
#[test]
fn an_honest_file_is_never_damaged() {
    assert!(is_reported(Some(1), "stress m.trex", true) && is_reported(Some(1), "verify m.trex", false));
    for line in LINES.iter().filter(|line| !line.starts_with("stress")) {
        assert!(!is_reported(Some(1), line, true) && !is_reported(Some(3), line, true), "{line}");
    }
}

/// What became of the runs of a campaign.
struct Walls {
    /// Of the campaign and of its control groups, which stand beside those of others.
    name: &'static str,
    campaign: Campaign,
    is_full: bool,
    /// The longest that a run took which refused its file or its limit.
    longest_refusal: Duration,
}

impl Walls {
    fn begin(name: &'static str) -> Walls {
        let is_full = std::env::var_os("TREX_FAULTS").is_some_and(|value| value == "full");
        Walls { name, campaign: Campaign::named(name), is_full, longest_refusal: Duration::ZERO }
    }

    /// Runs that came to their end, and those that refused their file or their limit.
    fn counts(&self) -> (usize, usize) {
        (self.campaign.count("done"), self.campaign.count("refused"))
    }

    /// Says what became of all runs.
    fn say(&self) {
        let (done, refused) = self.counts();
        said(&format!(
            "{}: {} runs in control groups of exactly their limit, {refused} of them refused, none killed; the longest \
             refusal took {} ms",
            self.name,
            done + refused,
            self.longest_refusal.as_millis()
        ));
    }

    /// Runs `trex LINE` in a group of so many MiB, unless it has been; false where no group can be made.
    fn run(&mut self, inside: &Path, what: &str, line: &str, size: u64, is_honest: bool) -> bool {
        let place = format!("{what}, {size} MiB: {line}");
        if !self.campaign.is_due(&place) {
            return true;
        }
        let Some(group) = Cgroup::new(self.name, size * MIB) else { return false };
        let whole = format!("{line} --memory-limit {size}MiB --json");
        let begin = Instant::now();
        let ran = if line == VIEW {
            let viewing = ViewProcess::start_as(group.command_in(inside, &whole), whole);
            look(viewing.address());
            viewing.end()
        } else {
            group.run_in(inside, &format!("{whole} -q"))
        };
        let took = begin.elapsed();
        let place = format!("{place}: {:?} after {took:?}\n{}", ran.code, ran.stderr);
        assert_eq!(group.oom_kill_count(), 0, "{place}");
        assert!(is_reported(ran.code, line, is_honest), "{place}");
        let is_refused = check_document(&ran, size, &place);
        if is_refused {
            self.longest_refusal = self.longest_refusal.max(took);
        }
        let place = format!("{what}, {size} MiB: {line}");
        self.campaign.passed(&place, if is_refused { "refused" } else { "done" });
        true
    }

    /// Runs lines in groups of all sizes, or of those of a normal run; false where no group can be made.
    fn run_all(&mut self, inside: &Path, what: &str, lines: &[String], is_honest: bool) -> bool {
        let sizes: &[u64] = if self.is_full { &ALL } else { &SOME };
        let runs = sizes.iter().flat_map(|&size| lines.iter().map(move |line| (line, size)));
        runs.into_iter().all(|(line, size)| self.run(inside, what, line, size, is_honest))
    }
}

/// One document, whatever came of the run; true where it says that the file or the limit is refused, in four parts.
fn check_document(ran: &Ran, size: u64, place: &str) -> bool {
    let document = ran.document();
    if ran.code == Some(4) {
        let least = document["smallest_limit_bytes"].as_u64();
        assert!(least.is_none_or(|least| least > size * MIB), "{place}: {least:?} would do");
    }
    let is_refused = [Some(3), Some(4)].contains(&ran.code);
    if is_refused {
        let parts = ["what", "where", "next_step"].map(|part| document[part].as_str().unwrap_or_default());
        assert!(parts.iter().all(|part| !part.is_empty()), "{place}: {document:#}");
    }
    is_refused
}

fn lines() -> Vec<String> {
    LINES.map(str::to_owned).to_vec()
}

#[test]
fn no_verb_is_killed_at_any_size_on_an_honest_file() {
    let inside = folder();
    let inside = inside.path();
    let mut walls = Walls::begin("walls-honest");
    for (at, honest) in MODELS.iter().enumerate() {
        let _ = fs::remove_file(inside.join("m.trex"));
        honest.make(inside);
        let ran = match at == 0 || walls.is_full {
            true => walls.run_all(inside, honest.what, &lines(), true),
            // One line each, in turn, where room is least.
            false => walls.run(inside, honest.what, LINES[at % LINES.len()], SOME[0], true),
        };
        if !ran {
            return;
        }
    }
    let (done, refused) = walls.counts();
    assert!(refused < done, "{refused} of {} had too little room", done + refused);
    if walls.is_full {
        real_models(&mut walls, inside);
    }
    walls.say();
}

/// A header that says more than there is, and more than there can be.
#[test]
fn no_verb_is_killed_at_any_size_on_a_hostile_file() {
    let inside = folder();
    let inside = inside.path();
    let (model, ply) = (inside.join("m.trex"), inside.join("m.ply"));
    let mut walls = Walls::begin("walls-hostile");
    MODELS[0].make(inside);
    let text = String::from_utf8_lossy(&fs::read(&ply).unwrap()[..200]).into_owned();
    let face_count = text.lines().find_map(|line| line.strip_prefix("element face ")).unwrap().to_owned();
    let mut bytes = fs::read(&ply).unwrap();
    let at = text.find(&face_count).unwrap();
    bytes[at..at + face_count.len()].fill(b'9');
    fs::write(&ply, bytes).unwrap();
    let mut hostile = |what: &str, forger: &Forger| {
        let _ = fs::remove_file(&model);
        fs::copy(forger.folder().join("lie.trex"), &model).unwrap();
        walls.run_all(inside, what, &lines(), false);
    };
    hostile("a page that is a bomb", &Forger::new().seal_page_bomb());
    let forger = Forger::new();
    forger.seal_octree(|upper| upper.node_count = 1 << 40);
    hostile("an octree that is huge", &forger);
    for (at, octree) in forger.octree_bombs().take(2) {
        forger.seal_octree_bytes(&octree, 1 << 20);
        hostile(&format!("an octree with a bomb at {at}"), &forger);
    }
    walls.say();
}

/// Real models, and files that others found nasty, where there are any.
fn real_models(walls: &mut Walls, inside: &Path) {
    let (honest, nasty) = real_files();
    let name_of = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
    for path in &honest {
        document_in(inside, &format!("build {} -o m.trex --overwrite", path.display()));
        let lines: Vec<String> =
            LINES.iter().map(|line| line.replace("m.ply", &path.display().to_string())).collect();
        walls.run_all(inside, &name_of(path), &lines, true);
    }
    for path in &nasty {
        let lines = ["info INPUT", "build INPUT -o built.trex --voxels 64 --threads 2 --overwrite"]
            .map(|line| line.replace("INPUT", &path.display().to_string()));
        walls.run_all(inside, &name_of(path), &lines, false);
    }
}
