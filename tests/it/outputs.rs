//! Where results go: outputs that exist, disks that are full, folders that refuse, and Ctrl-C. Whatever happens, the
//! old file or the whole new one stands there, and nothing beside it.

use crate::command::{TREX, cannot_run, document_in, folder, hash_of, listing, ran, run_in, trex_in};
use crate::oracle::pictures::{exr, noise};
use std::os::unix::fs::PermissionsExt;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

#[test]
fn an_output_that_exists_is_kept_without_overwrite() {
    let inside = folder();
    document_in(inside.path(), "build gen:soup:10k --no-asvo -o model.trex");
    document_in(inside.path(), "render model.trex --integrator direct --resolution 8x8 -o view.png");
    document_in(inside.path(), "render model.trex --resolution 8x8 --tiles 1/1 -o view.trexpart");
    for (line, output) in [
        ("render model.trex --resolution 8x8 --tiles 1/1 -o kept.trexpart", "kept.trexpart"),
        ("image merge view.trexpart -o kept.png", "kept.png"),
        ("build gen:soup:20k --no-asvo -o kept.trex", "kept.trex"),
        ("render model.trex --integrator direct --resolution 8x8 -o kept.png", "kept.png"),
        ("render model.trex --integrator direct --resolution 8x8 -o kept.exr", "kept.exr"),
        ("gen soup --triangles 10k -o kept.ply", "kept.ply"),
        ("demo --triangles 10k --resolution 8x8 -o kept.png", "kept.png"),
        ("image diff view.png view.png -o kept.png", "kept.png"),
    ] {
        let path = inside.path().join(output);
        std::fs::write(&path, "mine").unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o640)).unwrap();
        let before = listing(inside.path());
        run_in(inside.path(), &format!("{line} --json -q")).expect_error(2, "usage");
        assert_eq!(listing(inside.path()), before, "{line}");
        run_in(inside.path(), &format!("{line} --overwrite -q")).expect(0);
        assert_ne!(std::fs::read(&path).unwrap(), b"mine", "{line}");
        assert_eq!(path.metadata().unwrap().permissions().mode() & 0o7777, 0o640, "{line}");
    }
}

/// File systems take names of 255 bytes; files beside an output had longer ones.
#[test]
fn outputs_may_have_the_longest_names() {
    let inside = folder();
    let name = |ending: &str| format!("{}{ending}", "n".repeat(255 - ending.len()));
    document_in(inside.path(), &format!("build gen:soup:10k --no-asvo -o {}", name(".trex")));
    document_in(inside.path(), &format!("gen soup --triangles 10k -o {}", name(".stl")));
    for picture in [name(".png"), name(".exr")] {
        document_in(
            inside.path(),
            &format!("render {} --resolution 8x8 --integrator direct -o {picture}", name(".trex")),
        );
    }
    assert_eq!(listing(inside.path()).len(), 4);
}

/// Past the size that the user may write the system sends a signal, which ended the process without a word.
#[test]
fn a_file_that_may_not_grow_is_a_disk_error() {
    let inside = folder();
    document_in(inside.path(), "build gen:soup:10k --no-asvo -o model.trex");
    let before = listing(inside.path());
    for line in [
        "build gen:soup:100k --no-asvo -o out.trex",
        "gen soup --triangles 100k -o out.ply",
        "render model.trex --integrator direct --resolution 400x400 -o out.exr",
    ] {
        let mut limited = Command::new("sh");
        // Blocks of 512 bytes.
        limited.args(["-c", &format!("ulimit -f 400; exec \"$0\" {line} --json -q"), TREX]);
        let ended = ran(line, limited.current_dir(inside.path()).output().unwrap());
        ended.expect_error(5, "disk-full");
        assert_eq!(listing(inside.path()), before, "{line} left something behind");
    }
}

#[test]
fn outputs_without_a_place_are_usage_errors() {
    let inside = folder();
    document_in(inside.path(), "build gen:soup:10k --no-asvo -o model.trex");
    std::fs::create_dir(inside.path().join("folder.trex")).unwrap();
    let before = listing(inside.path());
    for line in [
        "build gen:soup:10k --no-asvo -o no/such/folder/out.trex",
        "build gen:soup:10k --no-asvo -o folder.trex --overwrite",
        "build gen:soup:10k --no-asvo -o out.trex --temp-dir no/such/folder",
        "render model.trex -o no/such/folder/out.png",
        "render model.trex -o picture.jpeg",
        "render model.trex -o picture.png --layers depth",
        "image diff a.png b.png -o no/such/folder/out.png",
        "image diff a.png b.png -o out.exr",
        "gen soup --triangles 10k -o no/such/folder/out.ply",
        "gen soup --triangles 10k -o out.gltf",
    ] {
        run_in(inside.path(), &format!("{line} --json -q")).expect_error(2, "usage");
        assert_eq!(listing(inside.path()), before, "{line}");
    }
}

#[test]
fn a_camera_path_gives_the_pictures_of_its_views() {
    let inside = folder();
    document_in(inside.path(), "build gen:pipes:10k --no-asvo -o model.trex");
    let views = [("1,2,3", "9,1,-5"), ("-4,9,2", "3,0,-3")];
    let table = |(position, target): &(&str, &str)| {
        format!("[[view]]\nposition = [{position}]\ntarget = [{target}]\n")
    };
    let path: String = views.iter().map(table).collect();
    std::fs::write(inside.path().join("path.toml"), &path).unwrap();
    // A path is lit and exposed by its first view, not by each by itself.
    let picture = "render model.trex --integrator direct --resolution 40x24 --spp 2 --fov-x 70 \
                   --exposure 1 --light scene";
    let document = document_in(inside.path(), &format!("{picture} --camera-path path.toml -o turn.png"));
    for (number, (position, target)) in (1..).zip(views) {
        let alone = format!("{picture} --camera-position={position} --camera-target={target} -o alone.png");
        document_in(inside.path(), &format!("{alone} --overwrite"));
        let name = format!("turn-{number:04}.png");
        let [turn, alone] = [&name, "alone.png"].map(|name| std::fs::read(inside.path().join(name)).unwrap());
        assert!(turn == alone, "{name}");
        assert_eq!(document["pictures"][number - 1]["output"], name.as_str());
    }
    assert_ne!(hash_of(&inside.path().join("turn-0001.png")), hash_of(&inside.path().join("turn-0002.png")));
    assert!(!inside.path().join("turn.png").exists());

    // What is left to be decided the first view decides.
    let decided = |views: &str| {
        let line =
            format!("render model.trex --integrator direct --resolution 40x24 --spp 2 --overwrite {views}");
        let document = document_in(inside.path(), &line);
        (document["light"].clone(), document["exposure"].clone())
    };
    let (position, target) = views[0];
    let first = decided(&format!("--camera-position={position} --camera-target={target} -o alone.png"));
    assert_eq!(decided("--camera-path path.toml -o turn.png"), first);
    assert_ne!(decided("-o alone.png"), first, "the path begins with the view that frames the model");

    // A view that sees nothing is told by its number, before any picture is made.
    std::fs::write(inside.path().join("path.toml"), path + &table(&("1,1,1", "1,1,1"))).unwrap();
    let before = listing(inside.path());
    let line = format!("{picture} --camera-path path.toml -o other.png --json -q");
    let error = run_in(inside.path(), &line).expect_error(3, "scene-format");
    assert!(error["where"].as_str().unwrap().ends_with("path.toml, view 3"), "{error}");
    assert_eq!(listing(inside.path()), before);
}

/// A file system of a few megabytes in memory, unmounted on drop.
struct SmallDisk(PathBuf);

impl SmallDisk {
    fn mount(at: &Path, bytes: u64) -> Option<SmallDisk> {
        std::fs::create_dir(at).unwrap();
        let mounted = Command::new("mount")
            .args(["-t", "tmpfs", "-o", &format!("size={bytes}"), "tmpfs"])
            .arg(at)
            .stderr(Stdio::null())
            .status();
        if !mounted.is_ok_and(|status| status.success()) {
            cannot_run("a small file system cannot be mounted here (needs root)");
            return None;
        }
        Some(SmallDisk(at.to_path_buf()))
    }
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _ = Command::new("umount").arg(&self.0).status();
    }
}

#[test]
fn a_full_disk_is_said_and_leaves_nothing() {
    let inside = folder();
    let Some(_disk) = SmallDisk::mount(&inside.path().join("small"), 2 << 20) else { return };
    document_in(inside.path(), "build gen:scan:100k -o model.trex --no-asvo");
    // What is left of the disk is less than the page file of a million triangles, 1.8 MB.
    std::fs::write(inside.path().join("small/filler"), vec![1; 1 << 20]).unwrap();
    // Errors that no compression makes small enough.
    let noise = noise(1 << 21, 5);
    std::fs::write(inside.path().join("noise.exr"), exr(2048, &noise)).unwrap();
    std::fs::write(inside.path().join("black.exr"), exr(2048, &vec![[0.0; 3]; 1 << 21])).unwrap();
    let before = listing(inside.path());
    for line in [
        // The scratch does not fit; the scratch fits elsewhere but the output does not; only the scratch is there.
        "build gen:scan:1M -o small/out.trex",
        "build gen:scan:1M -o small/out.trex --temp-dir .",
        "build gen:scan:1M -o out.trex --temp-dir small",
        "gen scan --triangles 1M -o small/out.ply",
        "gen scan --triangles 1M -o small/out.obj",
        "gen scan --triangles 1M -o small/out.stl",
        "render model.trex --integrator direct --resolution 1024x1024 --spp 1 --layers depth,normal -o small/out.exr",
        "image diff noise.exr black.exr --scale-max 1 -o small/out.png",
    ] {
        let document = run_in(inside.path(), &format!("{line} --json -q")).expect_error(5, "disk-full");
        assert!(document["where"].as_str().unwrap().contains("small"), "{line}: {document}");
        assert_eq!(listing(inside.path()), before, "{line}");
    }
    // The old file survives a replacement that fails.
    std::fs::write(inside.path().join("small/out.trex"), "mine").unwrap();
    let line = "build gen:scan:1M -o small/out.trex --temp-dir . --overwrite --json -q";
    run_in(inside.path(), line).expect_error(5, "disk-full");
    assert_eq!(std::fs::read(inside.path().join("small/out.trex")).unwrap(), b"mine");
}

#[test]
fn a_folder_that_refuses_is_said() {
    const NOBODY: u32 = 65_534;
    let inside = folder();
    std::fs::create_dir(inside.path().join("closed")).unwrap();
    for (path, mode) in [("closed", 0o555), (".", 0o755)] {
        std::fs::set_permissions(inside.path().join(path), PermissionsExt::from_mode(mode)).unwrap();
    }
    for line in
        ["build gen:soup:10k --no-asvo -o closed/out.trex", "gen soup --triangles 10k -o closed/out.ply"]
    {
        let mut command = trex_in(inside.path(), &format!("{line} --json -q"));
        if std::fs::write(inside.path().join("closed/probe"), "").is_ok() {
            std::fs::remove_file(inside.path().join("closed/probe")).unwrap();
            command.uid(NOBODY).gid(NOBODY);
        }
        let Ok(output) = command.output() else {
            return cannot_run("this user writes everywhere, and nobody cannot run the command");
        };
        // Nothing is wrong with the input: writing failed.
        let document = ran(line, output).expect_error(7, "io");
        assert!(document["where"].as_str().unwrap().contains("closed"), "{line}: {document}");
        assert_eq!(listing(inside.path()).len(), 1, "{line}");
    }
}

/// The folder may be written to and not opened: the last sync is refused, when the file has its name. The message said
/// that an input could not be read.
#[test]
fn a_last_sync_that_is_refused_says_that_the_file_is_there() {
    const NOBODY: u32 = 65_534;
    let inside = folder();
    std::fs::create_dir(inside.path().join("dark")).unwrap();
    for (path, mode) in [("dark", 0o333), (".", 0o755)] {
        std::fs::set_permissions(inside.path().join(path), PermissionsExt::from_mode(mode)).unwrap();
    }
    let line = "build gen:soup:10k --no-asvo --no-resume -o dark/out.trex --json -q";
    let mut command = trex_in(inside.path(), line);
    if std::fs::read_dir(inside.path().join("dark")).is_ok() {
        command.uid(NOBODY).gid(NOBODY);
    }
    let Ok(output) = command.output() else {
        return cannot_run("this user opens every folder, and nobody cannot run the command");
    };
    let document = ran(line, output).expect_error(7, "io");
    assert!(document["next_step"].as_str().unwrap().contains("the file is there, and whole"), "{document}");
    std::fs::set_permissions(inside.path().join("dark"), PermissionsExt::from_mode(0o755)).unwrap();
    assert_eq!(listing(&inside.path().join("dark")).len(), 1);
    document_in(inside.path(), "verify dark/out.trex");
}

/// Within this, interrupted work has ended. What has to end first (a batch, a chunk, a tile) takes a fraction of a
/// second; the rest is for a machine whose cores are all taken. Work that does not hear ends with another status.
const ENDED_WITHIN: Duration = Duration::from_secs(60);

/// Starts the command, waits until `begun`, interrupts it; expects a clean end long before that of the work.
fn interrupt(inside: &Path, line: &str, begun: impl Fn(&Path) -> bool) {
    let before = listing(inside);
    let mut command = trex_in(inside, &format!("{line} --json --progress plain"));
    let child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let (start, signal) = (Instant::now(), format!("kill -INT {}", child.id()));
    while !begun(inside) {
        assert!(start.elapsed() < Duration::from_secs(60), "{line} did not begin");
        std::thread::sleep(Duration::from_millis(5));
    }
    std::thread::sleep(Duration::from_millis(50));
    assert!(Command::new("sh").args(["-c", &signal]).status().unwrap().success());
    let asked = Instant::now();
    let ran = ran(line, child.wait_with_output().unwrap());
    assert!(asked.elapsed() < ENDED_WITHIN, "{line} ended only after {:?}", asked.elapsed());
    ran.expect(130);
    assert_eq!(ran.document()["code"], "interrupted", "{}", ran.stdout);
    assert_eq!(listing(inside), before, "{line} left something behind");
}

#[test]
fn ctrl_c_leaves_nothing_behind() {
    let inside = folder();
    document_in(inside.path(), "build gen:soup:10k --no-asvo -o model.trex");
    document_in(inside.path(), "gen scan --triangles 1M -o scan.ply");
    let begun = |ending: &'static str| {
        move |inside: &Path| {
            let names = std::fs::read_dir(inside).unwrap().map(|entry| entry.unwrap().file_name());
            names.into_iter().any(|name| name.to_string_lossy().ends_with(ending))
        }
    };
    let after = |wait: u64| {
        let start = Instant::now();
        move |_: &Path| start.elapsed() >= Duration::from_millis(wait)
    };
    // While it generates and sorts, while it reads a file, while it writes pages, and in the other verbs.
    interrupt(inside.path(), "build gen:isosurface:20M -o out.trex", after(700));
    interrupt(inside.path(), "build scan.ply scan.ply scan.ply scan.ply scan.ply -o out.trex", after(300));
    interrupt(inside.path(), "build gen:soup:1500k -o out.trex --threads 1 --no-resume", begun(".part"));
    interrupt(inside.path(), "gen isosurface --triangles 20M -o out.ply", after(700));
    interrupt(
        inside.path(),
        "render model.trex -o out.png --resolution 2048x2048 --integrator direct --spp 4096",
        after(700),
    );
}

/// Two builds of one output at once: one wins, the other is told; never a mixture.
#[test]
fn two_builds_of_one_output_do_not_mix() {
    let inside = folder();
    let spawn = |seed: u32| {
        let line = format!("build gen:soup:50k:{seed} --no-asvo -o out.trex --json -q");
        (
            line.clone(),
            trex_in(inside.path(), &line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap(),
        )
    };
    let ends: Vec<_> = [spawn(1), spawn(2)]
        .into_iter()
        .map(|(line, child)| ran(&line, child.wait_with_output().unwrap()))
        .collect();
    let won: Vec<_> = ends.iter().filter(|end| end.code == Some(0)).collect();
    assert_eq!(won.len(), 1, "{}{}", ends[0].stderr, ends[1].stderr);
    ends.iter().filter(|end| end.code != Some(0)).for_each(|end| {
        end.expect_error(2, "usage");
    });
    assert_eq!(listing(inside.path()).len(), 1);
    let alone = won[0].line.strip_prefix("trex ").unwrap().replace("out.trex", "alone.trex");
    run_in(inside.path(), &alone).expect(0);
    assert_eq!(hash_of(&inside.path().join("out.trex")), hash_of(&inside.path().join("alone.trex")));
}

#[test]
fn nothing_but_a_file_is_replaced_and_no_input() {
    let inside = folder();
    let at = |name: &str| inside.path().join(name);
    document_in(inside.path(), "gen soup --triangles 10k -o soup.ply");
    document_in(inside.path(), "build soup.ply -o soup.trex --no-asvo");
    document_in(inside.path(), "render soup.trex --integrator direct -o soup.png --resolution 8x8 --spp 1");
    for (link, target) in [("link.trex", "soup.trex"), ("link.png", "soup.png"), ("link.ply", "soup.ply")] {
        std::os::unix::fs::symlink(at(target), at(link)).unwrap();
    }
    let before = listing(inside.path());
    for line in [
        "build soup.ply -o soup.ply",
        "build soup.ply -o ./soup.ply",
        "build soup.ply -o /dev/null",
        "build soup.ply -o link.trex",
        "gen soup --triangles 10k -o link.ply",
        "render soup.trex --integrator direct -o link.png --resolution 8x8 --spp 1",
        "image diff soup.png soup.png -o soup.png",
    ] {
        run_in(inside.path(), &format!("{line} --overwrite --json -q")).expect_error(2, "usage");
        assert_eq!(listing(inside.path()), before, "{line}");
    }
    assert!(!std::fs::metadata("/dev/null").unwrap().is_file());
}

/// `build k.obj -o keep.mtl --overwrite` replaced the materials that `k.obj` names, and a picture the scene that it is
/// of.
#[test]
fn what_an_input_names_is_not_replaced() {
    let inside = folder();
    let at = |name: &str| inside.path().join(name);
    let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl red\nf 1 2 3\n";
    std::fs::write(at("k.obj"), format!("{triangle}mtllib ./keep.mtl\n")).unwrap();
    std::fs::write(at("linked.obj"), format!("mtllib soft.mtl\n{triangle}")).unwrap();
    std::fs::write(at("keep.mtl"), "newmtl red\nKd 1 0 0\n").unwrap();
    std::fs::hard_link(at("keep.mtl"), at("hard.trex")).unwrap();
    std::os::unix::fs::symlink("keep.mtl", at("soft.mtl")).unwrap();
    std::fs::create_dir(at("deep")).unwrap();
    document_in(inside.path(), "build k.obj -o model.trex");
    // Endings of pictures, on files that are something else.
    let view = "[[view]]\nposition = [0, -3, 5]\ntarget = [0, 0, 0]\n";
    std::fs::write(at("scene.toml"), "model = 'model.png'\n").unwrap();
    std::fs::copy(at("model.trex"), at("model.png")).unwrap();
    std::fs::hard_link(at("scene.toml"), at("scene.png")).unwrap();
    std::fs::write(at("views-0001.png"), view).unwrap();
    let before = listing(inside.path());
    let picture = "--integrator direct --resolution 8x8";
    for line in [
        "build k.obj -o keep.mtl".to_owned(),
        "build k.obj -o deep/../keep.mtl --no-resume".to_owned(),
        "build k.obj -o hard.trex".to_owned(),
        "build linked.obj -o keep.mtl".to_owned(),
        "build gen:soup:10k k.obj -o keep.mtl".to_owned(),
        format!("render scene.toml {picture} -o scene.png"),
        format!("render scene.toml {picture} -o model.png"),
        format!("render model.trex {picture} --camera-path views-0001.png -o views.png"),
        "stress scene.toml --scenario flip --switches 1 --hold 10 -o model.png".to_owned(),
    ] {
        let error = run_in(inside.path(), &format!("{line} --overwrite --json -q")).expect_error(2, "usage");
        assert!(error["what"].as_str().unwrap().contains("is an input"), "{line}: {error}");
        assert_eq!(listing(inside.path()), before, "{line}");
    }
    // What is merely beside them is.
    document_in(inside.path(), "build k.obj -o model.trex --overwrite");
}
