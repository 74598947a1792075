//! Inputs that are small where others are large, and the other way round: many materials, long names, emitters
//! everywhere, hardly any mesh. Whatever limit a verb names as the smallest works, by the kernel's count where groups
//! can be made.

use crate::cgroup::Cgroup;
use crate::command::{document_in, folder, run_in, said};
use crate::random::Random;
use std::fmt::Write;
use std::path::Path;

/// What is odd about an input.
#[derive(Clone, Copy, Debug)]
struct Odd {
    /// Materials, each with a face of its own.
    materials: usize,
    /// Bytes of each name.
    name_bytes: usize,
    /// The character that names are made of: some take six bytes in JSON.
    letter: char,
    /// Squares beside those of the materials.
    squares: usize,
    /// One material in so many emits; 0 for none.
    emits_every: usize,
}

impl Odd {
    /// Writes `NAME.obj`, and its materials where any are defined.
    fn write(&self, inside: &Path, name: &str) {
        let Odd { materials, name_bytes, letter, squares, emits_every } = *self;
        let long = |index: usize| {
            let number = format!("{index:06}");
            let fill = name_bytes.saturating_sub(number.len()) / letter.len_utf8();
            format!("{}{number}", letter.to_string().repeat(fill))
        };
        let (mut mesh, mut library) = (format!("mtllib {name}.mtl\n"), String::new());
        for index in 0..materials + squares {
            let (x, y) = ((index % 300) as f64, (index / 300) as f64);
            let corner =
                |dx: f64, dy: f64| format!("v {} {} {}\n", x + dx, y + dy, (0.1 * (x + dx) * (y + dy)).sin());
            mesh += &[corner(0.0, 0.0), corner(1.0, 0.0), corner(1.0, 1.0), corner(0.0, 1.0)].concat();
            if index < materials {
                writeln!(mesh, "usemtl {}", long(index)).unwrap();
            }
            mesh += "f -4 -3 -2 -1\n";
        }
        // The squares at the end have the last material, which emits where any does.
        for index in (0..materials).rev().filter(|_| emits_every > 0) {
            if (materials - 1 - index).is_multiple_of(emits_every) {
                writeln!(library, "newmtl {}\nKe 2 2 2", long(index)).unwrap();
            }
        }
        std::fs::write(inside.join(format!("{name}.obj")), mesh).unwrap();
        std::fs::write(inside.join(format!("{name}.mtl")), library).unwrap();
    }
}

/// Runs `trex LINE` under a hopeless limit, then under the smallest that it names, in a group of that size.
#[track_caller]
fn named_limit_works(inside: &Path, what: &str, line: &str) {
    let refused = run_in(inside, &format!("{line} --memory-limit 25MiB --json -q"));
    let named = refused.expect_error(4, "memory-limit")["smallest_limit_bytes"].as_u64().unwrap();
    said(&format!("{what}: {line}: {:.1} MiB", named as f64 / f64::from(1 << 20)));
    let line = format!("{line} --memory-limit {named}B --json -q");
    let ran = match Cgroup::new("odd", named) {
        None => run_in(inside, &line),
        Some(group) => {
            let ran = group.run_in(inside, &line);
            assert_eq!(group.oom_kill_count(), 0, "{what}: {}: killed\n{}", ran.line, ran.stderr);
            ran
        }
    };
    assert_eq!(ran.code, Some(0), "{what}: {}\n{}{}", ran.line, ran.stdout, ran.stderr);
    let peak = ran.document()["memory"]["peak_rss_bytes"].as_u64();
    assert!(peak.is_none_or(|peak| peak <= named), "{what}: {}: VmHWM {peak:?}", ran.line);
}

/// Builds of 65,000 names were killed at 256 MiB, after they had named 97 and 129 MiB as enough; pictures of them at 96
/// and 128 MiB, since no copy of a name was in the ledger.
#[test]
fn the_limit_that_is_named_for_an_odd_input_works() {
    let mut random = Random::seeded(8);
    let plain = Odd { materials: 1, name_bytes: 3, letter: 'n', squares: 3000, emits_every: 0 };
    let mut inputs = vec![
        ("one square", Odd { squares: 0, ..plain }),
        ("65,000 names of 200 bytes", Odd { materials: 65_000, name_bytes: 200, squares: 0, ..plain }),
        ("65,000 names of 1,000 bytes", Odd { materials: 65_000, name_bytes: 1000, squares: 0, ..plain }),
        ("names of escapes", Odd { materials: 30_000, name_bytes: 250, letter: '\u{1}', ..plain }),
        ("names of wide letters", Odd { materials: 9_000, name_bytes: 900, letter: '\u{1f600}', ..plain }),
        ("all of it emits", Odd { squares: 90_000, emits_every: 1, ..plain }),
        ("lamps of many names", Odd { materials: 40_000, name_bytes: 100, emits_every: 1, ..plain }),
    ];
    for _ in 0..3 {
        let mut below = |most: i64| random.below(most) as usize;
        let odd = Odd {
            materials: 1 + below(50_000),
            name_bytes: below(600),
            letter: ['n', '\u{20ac}', '"'][below(3)],
            squares: below(20_000),
            emits_every: below(4),
        };
        inputs.push(("a random one", odd));
    }
    let inside = folder();
    for (number, (what, odd)) in inputs.into_iter().enumerate() {
        let (what, name) = (format!("{what}, {odd:?}"), format!("odd{number}"));
        odd.write(inside.path(), &name);
        let flags = ["--threads 1", "--no-asvo --threads 2", "--voxels 64 --threads 3"][number % 3];
        named_limit_works(inside.path(), &what, &format!("build {name}.obj -o {name}.trex {flags}"));
        let info = document_in(inside.path(), &format!("info {name}.trex"));
        assert!(info["material_count"].as_u64().unwrap() >= odd.materials as u64, "{what}");
        let longest =
            info["materials"].as_array().unwrap().iter().map(|name| name.as_str().unwrap().len()).max();
        assert!(longest.unwrap() <= 255, "{what}: {longest:?}");
        let picture = "--resolution 64x64 --spp 1 --overwrite -o out.png --threads 2 --integrator";
        let integrator = if info["asvo"].is_null() { "path" } else { "photon --photons 1k" };
        for line in [
            format!("render {name}.trex {picture} direct"),
            format!("render {name}.trex {picture} {integrator}"),
            format!("verify {name}.trex --deep"),
        ] {
            // Verbs that need less than the reserve and a megabyte are not refused.
            if run_in(inside.path(), &format!("{line} --memory-limit 25MiB --json -q")).code != Some(0) {
                named_limit_works(inside.path(), &what, &line);
            }
        }
        let line = format!("info {name}.trex");
        if run_in(inside.path(), &format!("{line} --memory-limit 25MiB --json -q")).code != Some(0) {
            named_limit_works(inside.path(), &what, &line);
        }
    }
}

/// A name is cut to what a file holds, and the `usemtl` of an input still finds its `newmtl`; a scene finds it by
/// either.
#[test]
fn long_names_keep_their_materials() {
    let inside = folder();
    let long = |end: &str| format!("{}{end}", "\u{20ac}".repeat(400));
    let square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
    let mesh =
        format!("mtllib m.mtl\n{square}usemtl {}\nf 1 2 3\nusemtl {}\nf 1 3 4\n", long("a"), long("b"));
    let library = format!("newmtl {}\nKd 1 0 0\nnewmtl {}\nKd 0 1 0\n", long("b"), long("a"));
    std::fs::write(inside.path().join("m.obj"), mesh).unwrap();
    std::fs::write(inside.path().join("m.mtl"), library).unwrap();
    document_in(inside.path(), "build m.obj -o m.trex");
    let file =
        trex_store::PageFile::open(&inside.path().join("m.trex"), &trex_store::Budget::unlimited()).unwrap();
    let kd = |name: &str| file.materials()[file.material_names().index_of(name).unwrap()].kd;
    assert_eq!((kd(&long("a")), kd(&long("b"))), ([0.0, 1.0, 0.0], [1.0, 0.0, 0.0]));
    let info = document_in(inside.path(), "info m.trex");
    let stored = info["materials"][1].as_str().unwrap();
    assert!(stored.len() <= 255 && stored.starts_with('\u{20ac}'), "{stored}");
    for name in [stored, &long("b")] {
        let scene = format!("model = 'm.trex'\n[material.'{name}']\nkd = [0, 0, 1]\n");
        std::fs::write(inside.path().join("scene.toml"), scene).unwrap();
        let line = "render scene.toml -o m.png --integrator direct --resolution 8x8 --spp 1 --overwrite";
        document_in(inside.path(), line);
    }
}

/// A sheet of which some triangles are a millionth as long as the others: the lattice loses them, the build says which
/// keeps them, and that one does.
#[test]
fn the_error_that_is_named_keeps_what_the_lattice_lost() {
    let inside = folder();
    let mut mesh = String::new();
    let mut face = |[x, y]: [f64; 2], side: f64| {
        for (dx, dy) in [(0.0, 0.0), (side, 0.0), (side, side)] {
            writeln!(mesh, "v {:e} {:e} 0", x + dx, y + dy).unwrap();
        }
        mesh += "f -3 -2 -1\n";
    };
    for index in 0..20_000 {
        let at = [f64::from(index % 200), f64::from(index / 200)];
        face(at, if index % 100 == 0 { 1e-6 * f64::from(1 + index / 100) } else { 1.0 });
    }
    std::fs::write(inside.path().join("mesh.obj"), mesh).unwrap();
    let built = document_in(inside.path(), "build mesh.obj -o lost.trex");
    let lost = built["rejected_collapsed"].as_u64().unwrap();
    assert!((100..=200).contains(&lost) && built["rejected_degenerate"] == lost, "{built:#}");
    let error = built["keeping_error"].as_f64().unwrap();
    assert!(error < built["error_bound"].as_f64().unwrap(), "{built:#}");
    let again = document_in(inside.path(), &format!("build mesh.obj -o kept.trex --error {error:e}"));
    // One in 10,000, and not much finer than that takes: rounding may keep what is half a step apart.
    assert!(
        again["rejected_collapsed"].as_u64().unwrap() <= 2 && again["keeping_error"].is_null(),
        "{again:#}"
    );
    let coarser = format!("build mesh.obj -o coarser.trex --error {:e}", 8.0 * error);
    assert!(document_in(inside.path(), &coarser)["rejected_collapsed"].as_u64().unwrap() > 2);
    let said = run_in(inside.path(), "build mesh.obj -o again.trex");
    assert!(said.stdout.contains(&format!("--error {error:e} would keep")), "{}", said.stdout);
}
