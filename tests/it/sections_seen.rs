//! Pictures of cut models: the light in a room without its ceiling against the same room modelled so; pages that are
//! read; flags, scenes, refusals, and what is told of open parts.

use crate::command::{document_in, folder, run_in, said};
use serde_json::Value;
use std::fmt::Write;
use std::fs;
use std::path::Path;

/// Half of a room's side, outside and inside, and where its walls end in the model without a ceiling.
const OUTER: f64 = 1.0;
const INNER: f64 = 0.85;
const TOP: f64 = 0.5;

const SCENE: &str = "[camera]\nposition = [0.8, -1.1, 3.2]\ntarget = [0, 0, 0]\nup = [0, 0, 1]\nfov_x = 40\n\
                     [render]\nresolution = [48, 48]\nseed = 3\n\
                     [[light]]\ntype = 'directional'\ndirection = [0.4, 0.3, -1]\nirradiance = [3, 3, 3]\n";

/// Quads of an OBJ.
struct Quads(String);

impl Quads {
    fn add(&mut self, corners: [[f64; 3]; 4]) {
        corners.iter().for_each(|[x, y, z]| writeln!(self.0, "v {x} {y} {z}").unwrap());
        self.0.push_str("f -4 -3 -2 -1\n");
    }

    /// Floor and walls of a box up to `top`, seen from outside or from within.
    fn open_box(&mut self, h: f64, top: f64, is_seen_within: bool) {
        let mut add = |mut corners: [[f64; 3]; 4]| {
            if is_seen_within {
                corners.reverse();
            }
            self.add(corners);
        };
        let around = [[-h, -h], [h, -h], [h, h], [-h, h]];
        for side in 0..4 {
            let ([ax, ay], [bx, by]) = (around[side], around[(side + 1) % 4]);
            add([[ax, ay, -h], [bx, by, -h], [bx, by, top], [ax, ay, top]]);
        }
        add([[-h, -h, -h], [-h, h, -h], [h, h, -h], [h, -h, -h]]);
    }

    fn ceiling(&mut self, h: f64, is_seen_within: bool) {
        let mut corners = [[-h, -h, h], [h, -h, h], [h, h, h], [-h, h, h]];
        if is_seen_within {
            corners.reverse();
        }
        self.add(corners);
    }
}

fn build(folder: &Path, name: &str, quads: &Quads) {
    fs::write(folder.join("m.mtl"), "newmtl wall\nKd 0.7 0.7 0.7\n").unwrap();
    let obj = folder.join(format!("{name}.obj"));
    fs::write(obj, format!("mtllib m.mtl\nusemtl wall\n{}", quads.0)).unwrap();
    document_in(folder, &format!("build {name}.obj -o {name}.trex --voxels 256"));
    fs::write(folder.join(format!("{name}.toml")), format!("model = '{name}.trex'\n{SCENE}")).unwrap();
}

/// A room with walls of some thickness: all of it, and what a section at [`TOP`] leaves, modelled by hand.
fn write_rooms(folder: &Path) {
    let mut whole = Quads(String::new());
    whole.open_box(OUTER, OUTER, false);
    whole.open_box(INNER, INNER, true);
    whole.ceiling(OUTER, false);
    whole.ceiling(INNER, true);
    build(folder, "whole", &whole);
    let mut open = Quads(String::new());
    open.open_box(OUTER, TOP, false);
    open.open_box(INNER, TOP, true);
    let (around, t) = ([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]], TOP);
    for side in 0..4 {
        let ([ax, ay], [bx, by]) = (around[side], around[(side + 1) % 4]);
        let at = |x: f64, y: f64, h: f64| [x * h, y * h, t];
        open.add([at(ax, ay, OUTER), at(bx, by, OUTER), at(bx, by, INNER), at(ax, ay, INNER)]);
    }
    build(folder, "open", &open);
}

fn mean(document: &Value) -> f64 {
    document["image"]["mean"][0].as_f64().unwrap()
}

fn render(folder: &Path, what: &str) -> Value {
    document_in(folder, &format!("render {what} -o p.exr --overwrite --filter off"))
}

/// The sun comes in where the ceiling was, and the walls that are cut are seen as a rim.
#[test]
fn a_cut_room_has_the_light_of_one_without_a_ceiling() {
    let folder = folder();
    write_rooms(folder.path());
    let modelled = mean(&render(folder.path(), "open.toml --integrator path --spp 256"));
    let photon = "photon --spp 32 --n-gather 4 --photons 1M";
    let bake = format!("{photon} --bake");
    let (exact, near) =
        (format!("{photon} --near exact"), "photon --spp 32 --n-gather 4 --photons 1M --lod-error 2");
    let cases = [
        ("path --spp 256", 0.01),
        ("full-gi --spp 32 --n-gather 4 --photons 300k", 0.02),
        (photon, 0.03),
        (&bake, 0.03),
        (&exact, 0.03),
        (near, 0.03),
    ];
    for (integrator, share) in cases {
        let line = format!("whole.toml --section 0,0,{TOP},0,0,-1 --integrator {integrator}");
        let document = render(folder.path(), &line);
        said(&format!("{integrator}: {:+.4} of {share}", mean(&document) / modelled - 1.0));
        assert!(
            (mean(&document) / modelled - 1.0).abs() < share,
            "{line}: {} for {modelled}",
            mean(&document)
        );
        assert_eq!(document["open_rays"], 0);
    }
}

/// What is cut away is not read, and the cut costs few pages: lines through it stay in its plane.
#[test]
fn a_section_reads_hardly_more_pages() {
    let folder = folder();
    document_in(folder.path(), "build gen:isosurface:1M -o iso.trex");
    let pages = |flags: &str| {
        let line = format!(
            "render iso.trex -o p.png --overwrite --integrator direct --spp 1 --resolution 256x256 {flags}"
        );
        let document = document_in(folder.path(), &line);
        (document["pool"]["pages_read"].as_u64().unwrap(), document["open_rays"].as_u64().unwrap())
    };
    let info = document_in(folder.path(), "info iso.trex");
    let middle = |axis: usize| {
        let side = |end: &str| info["bounds"][end][axis].as_f64().unwrap();
        0.5 * (side("lo") + side("hi"))
    };
    let point = format!("{},{},{}", middle(0), middle(1), middle(2));
    let (whole, _) = pages("");
    let (cut, open) = pages(&format!("--section {point},0,0,-1"));
    let (back, _) = pages(&format!("--section {point},0,-1,-0.2"));
    said(&format!("{whole} pages uncut, {cut} and {back} cut, {open} rays at open parts"));
    assert!(cut as f64 <= 1.2 * whole as f64 && back as f64 <= 1.2 * whole as f64, "{whole}, {cut}, {back}");
}

/// Flags take the place of what the scene says; what makes no sense is refused with what there is.
#[test]
fn parts_are_named_in_scenes_and_flags() {
    let folder = folder();
    write_rooms(folder.path());
    let scene = |name: &str, parts: &str| {
        let text = format!("model = 'whole.trex'\n{SCENE}[parts]\n{parts}\n");
        fs::write(folder.path().join(format!("{name}.toml")), text).unwrap();
    };
    let direct = |what: &str| mean(&render(folder.path(), &format!("{what} --integrator direct --spp 4")));
    scene("cut", &format!("section = [[0, 0, {TOP}, 0, 0, -2]]"));
    let (whole, cut) = (direct("whole.toml"), direct("cut.toml"));
    assert!((direct(&format!("whole.toml --section 0,0,{TOP},0,0,-1")) - cut).abs() < 1e-9 && cut != whole);
    assert_eq!(direct("cut.toml --section 0,0,9,0,0,-1"), whole);
    scene("hidden", "hide = ['wall']");
    assert_eq!(direct("hidden.toml"), 0.0);
    assert_eq!(direct("hidden.toml --only wall"), whole);
    assert_eq!(direct("whole.toml --only default --only wall"), whole);
    for (name, parts, says) in [
        ("none", "section = [[0, 0, 0, 0, 0, 0]]", "parts.section"),
        ("four", "section = [[0,0,0,0,0,1],[0,0,0,0,0,1],[0,0,0,0,0,1],[0,0,0,0,0,1]]", "at most 3"),
        ("who", "hide = ['walls']", "walls"),
        ("what", "hidden = ['wall']", "hidden"),
    ] {
        scene(name, parts);
        let ran = run_in(folder.path(), &format!("render {name}.toml -o p.png --overwrite"));
        ran.expect(3);
        assert!(ran.stderr.contains(says), "{}", ran.stderr);
    }
    let four = "--section 0,0,0,0,0,1 ".repeat(4);
    assert_ne!(
        run_in(folder.path(), &format!("render whole.toml -o p.png --overwrite {four}")).code,
        Some(0)
    );
    run_in(folder.path(), "render whole.toml -o p.png --section 0,0,0,0,0,0").expect(2);
}

/// An open part is not filled, and that is told, with its material.
#[test]
fn open_parts_are_told() {
    let folder = folder();
    let mut quads = Quads(String::new());
    quads.open_box(1.0, 1.0, false);
    build(folder.path(), "bowl", &quads);
    let line = "render bowl.toml -o p.png --integrator direct --spp 1 --section 0,0,0,0.1,0,-1";
    let ran = run_in(folder.path(), line);
    ran.expect(0);
    assert!(!ran.stderr.contains("open"), "the plane crosses closed rings alone: {}", ran.stderr);
    let line = "render bowl.toml -o p.png --overwrite --integrator direct --spp 1 --section 0,0,0,0,1,0";
    let ran = run_in(folder.path(), line);
    ran.expect(0);
    assert!(ran.stderr.contains("wall") && ran.stderr.contains("section"), "{}", ran.stderr);
}
