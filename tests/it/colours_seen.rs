//! Colours of the mesh in pictures: weighed by corners where the exact mesh is seen, the mean of a material in voxels.

use crate::colours::{ply, sheet};
use crate::command::{document_in, folder};
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use trex_model::{Model, OpenOptions, Pace, SessionOptions};
use trex_render::{
    AllResident, Answer, FrameOptions, FrameProgress, Method, Page, PagedMesh, Pages, Ray, RenderKeys, Scene,
    Tracer,
};
use trex_store::layout::PageKind;
use trex_store::{Budget, PageFile};

/// The mean of a picture of one triangle whose corners have these colours, by channel.
fn triangle_mean(inside: &Path, colours: [[f64; 3]; 3]) -> [f64; 3] {
    let [a, b, c] = colours.map(|[r, g, b]| format!("{r} {g} {b}"));
    let text = format!("v 0 0 0 {a}\nv 4 0 0 {b}\nv 0 4 0 {c}\nf 1 2 3\n");
    std::fs::write(inside.join("t.obj"), text).unwrap();
    document_in(inside, "build t.obj -o t.trex --no-asvo --overwrite");
    let camera = "--camera-position 1.5,1.5,9 --camera-target 1.5,1.5,0 --camera-up 0,1,0 --fov-y 40";
    let line =
        format!("render t.trex -o t.png --integrator direct --resolution 128x128 --overwrite {camera}");
    let mean = &document_in(inside, &line)["image"]["mean"];
    [0, 1, 2].map(|channel| mean[channel].as_f64().unwrap())
}

/// Over a triangle that the camera faces, each corner counts a third; grey of 188 reflects as much as half of white.
#[test]
fn pictures_have_colours_weighed_by_corners() {
    let inside = folder();
    let mean = |colours| triangle_mean(inside.path(), colours);
    let (black, white) = (mean([[0.0; 3]; 3]), mean([[1.0; 3]; 3]));
    let share = |of: [f64; 3]| [0, 1, 2].map(|c| (of[c] - black[c]) / (white[c] - black[c]));
    let close = |found: [f64; 3], wanted: [f64; 3]| {
        let is_close = found.iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 0.01);
        assert!(is_close, "{found:?}, not {wanted:?}");
    };
    close(share(mean([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])), [1.0 / 3.0; 3]);
    close(share(mean([[1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])), [1.0, 1.0 / 3.0, 0.0]);
    let grey = ((188.0 / 255.0 + 0.055) / 1.055f64).powf(2.4);
    close(share(mean([[188.0 / 255.0; 3]; 3])), [grey; 3]);
}

/// The pages of a file but for those of colours.
struct WithoutColours<'a> {
    all: &'a AllResident,
    file: Arc<PageFile>,
    wanted: Vec<u32>,
}

impl Pages for WithoutColours<'_> {
    fn page(&mut self, page: u32) -> Page<'_> {
        if self.file.has_mesh(page) { Page::Ready(self.all.frame(page).into()) } else { Page::Missing }
    }

    fn want(&mut self, page: u32) {
        self.wanted.push(page);
    }
}

/// A ray that is shaded waits for the colour of its triangle, and asks for that page alone; what it meets it knows.
#[test]
fn only_what_is_shaded_waits_for_colours() {
    let inside = folder();
    let (vertices, triangles) = sheet(60);
    std::fs::write(inside.path().join("a.ply"), ply(&vertices, &triangles, "uchar", false)).unwrap();
    document_in(inside.path(), "build a.ply -o m.trex --no-asvo");
    let file = Arc::new(PageFile::open(&inside.path().join("m.trex"), &Budget::unlimited()).unwrap());
    let all = AllResident::load(&file);
    let mut without =
        PagedMesh::new(&file, WithoutColours { all: &all, file: file.clone(), wanted: Vec::new() });
    let mut with = PagedMesh::new(&file, &all);
    for at in 0..40 {
        let origin = [0.7 + f64::from(at), 1.3 + 1.1 * f64::from(at), 60.0];
        let ray = Ray { origin, direction: [0.0, 0.0, -1.0], t_max: f64::INFINITY };
        let Answer::Exact(Some(shaded)) = with.intersect_shaded(&ray) else { panic!("it meets the sheet") };
        let hit = shaded.hit;
        assert!(without.occluded(&ray) == Answer::Exact(true));
        assert!(without.intersect(&ray) == Answer::Exact(Some(hit)) && without.pages().wanted.is_empty());
        assert!(without.intersect_shaded(&ray) == Answer::Blocked);
        let wanted = std::mem::take(&mut without.pages_mut().wanted);
        assert_eq!(wanted, [file.value_page(PageKind::Colours, hit.page, hit.triangle).unwrap()]);
        // What the sheet says of the place: its colours are linear in x and y but for the hole and rounding.
        let in_hole = |v: f64| v > 19.0 && v < 31.0;
        if !(in_hole(origin[0]) && in_hole(origin[1])) {
            let wanted = [origin[0] * 200.0 / 60.0, origin[1] * 255.0 / 60.0, 90.0];
            for (found, wanted) in shaded.colour.into_iter().zip(wanted) {
                let linear = ((wanted / 255.0 + 0.055) / 1.055).powf(2.4);
                assert!((f64::from(found) - linear).abs() < 0.01, "{origin:?}: {found}, not {linear}");
            }
        }
    }
}

/// A sheet of one colour, whose mean that is, and a model of it with voxels.
fn one_colour(inside: &Path, colour: [u8; 3]) -> Model {
    let (mut vertices, triangles) = sheet(60);
    vertices.iter_mut().for_each(|(_, of)| *of = colour);
    std::fs::write(inside.join("a.ply"), ply(&vertices, &triangles, "uchar", false)).unwrap();
    document_in(inside, "build a.ply -o one.trex --voxels 64 --overwrite");
    Model::open(&inside.join("one.trex"), &OpenOptions::with_limit(1 << 30)).unwrap()
}

const SIDE: u32 = 64;

fn pixels() -> impl Iterator<Item = [u32; 2]> {
    (0..SIDE * SIDE).map(|at| [at % SIDE, at / SIDE])
}

fn scene(integrator: Method) -> Scene {
    let keys = RenderKeys::default();
    Scene { render: RenderKeys { integrator, resolution: [SIDE; 2], ..keys }, ..Scene::default() }
}

/// Where no page is there, voxels stand in with the mean colour, and nothing of them is counted: in the end the picture
/// is that of exact samples alone.
#[test]
fn stand_ins_have_the_mean_colour_and_are_not_accumulated() {
    let inside = folder();
    let model = one_colour(inside.path(), [20, 230, 20]);
    let options = SessionOptions { pace: Pace::InFrames, ..SessionOptions::default() };
    let session = model.session_with(&scene(Method::Direct), &options).unwrap();
    // Long enough for a frame to end by its work.
    let options = FrameOptions { t_max: Duration::from_secs(60), ..FrameOptions::default() };
    let mut live = session.go_live(options).unwrap();
    let first = live.frame(1, &|| false);
    assert_eq!((first.progress, live.film().samples()), (FrameProgress::Preview, 0));
    let is_green = |[r, g, b]: [f32; 3]| g > 20.0 * r && g > 20.0 * b;
    let green = pixels().filter(|&at| is_green(live.shown(at))).count();
    assert!(green > 300, "{green} pixels are green");
    for _ in 0..10_000 {
        if live.frame(1, &|| false).progress == FrameProgress::Done {
            break;
        }
    }
    let shown: Vec<[f32; 3]> = pixels().map(|at| live.shown(at)).collect();
    let model = one_colour(inside.path(), [20, 230, 20]);
    let mut session = model.session(&scene(Method::Direct)).unwrap();
    session.render(1, &|| false, &mut |_, _| ControlFlow::Continue(()));
    let exact: Vec<[f32; 3]> = pixels().map(|at| session.film().radiance(at)).collect();
    assert_eq!(shown, exact);
}

/// The voxels of a sheet show its material's `kd` times the mean by area of its colours: of two halves, half of each.
#[test]
fn voxels_have_the_mean_colour_of_their_material() {
    let inside = folder();
    let quad = |x: i32, rgb: &str| {
        format!("v {x} 0 0 {rgb}\nv {} 0 0 {rgb}\nv {} 9 0 {rgb}\nv {x} 9 0 {rgb}\n", x + 4, x + 4)
    };
    let text = format!("{}{}f 1 2 3 4\nf 5 6 7 8\n", quad(0, "1 0 0"), quad(4, "0 0 1"));
    std::fs::write(inside.path().join("a.obj"), text).unwrap();
    document_in(inside.path(), "build a.obj -o m.trex --voxels 64");
    let model = Model::open(&inside.path().join("m.trex"), &OpenOptions::with_limit(1 << 30)).unwrap();
    // Half of the light of each: 188 of 255.
    assert_eq!(model.file().materials()[0].mean_colour, [188, 0, 188]);
    let mut session = model.session(&scene(Method::DebugUpper)).unwrap();
    session.render(1, &|| false, &mut |_, _| ControlFlow::Continue(()));
    let seen: Vec<[f32; 3]> =
        pixels().map(|at| session.film().radiance(at)).filter(|rgb| rgb[1] == 0.0).collect();
    assert!(seen.len() > 300, "{} pixels show the sheet", seen.len());
    for [r, _, b] in seen {
        assert!((r - b).abs() < 1e-6 && (0.1..0.71 * 0.51).contains(&r), "{r} {b}");
    }
}

/// Light that comes by way of voxels has the colour of the mesh: a red floor under a white ceiling.
#[test]
fn indirect_light_has_colour() {
    let inside = folder();
    let floor = |rgb: &str| {
        let quad = |z: i32, rgb: &str| {
            format!("v 0 0 {z} {rgb}\nv 9 0 {z} {rgb}\nv 9 9 {z} {rgb}\nv 0 9 {z} {rgb}\n")
        };
        format!("{}{}usemtl floor\nf 1 2 3 4\nusemtl ceiling\nf 8 7 6 5\n", quad(0, rgb), quad(6, "1 1 1"))
    };
    let mean = |rgb: &str| {
        std::fs::write(inside.path().join("a.obj"), floor(rgb)).unwrap();
        document_in(inside.path(), "build a.obj -o m.trex --voxels 64 --overwrite");
        std::fs::write(
            inside.path().join("s.toml"),
            "model = 'm.trex'\n[camera]\nposition = [4.5, 4.5, 1]\ntarget = [4.5, 4.5, 6]\nup = [0, 1, 0]\nfov_y = 60\n\
             [[light]]\ntype = 'point'\nposition = [4.5, 4.5, 2]\nintensity = [90, 90, 90]\n",
        )
        .unwrap();
        let line =
            "render s.toml -o s.png --overwrite --resolution 32x32 --spp 16 --n-shadow 0 --photons 200000";
        let mean = document_in(inside.path(), line)["image"]["mean"].clone();
        [0, 1].map(|channel| mean[channel].as_f64().unwrap())
    };
    let (red, white) = (mean("1 0 0"), mean("1 1 1"));
    // Red light is as it was; green is what the ceiling alone gives, by way of nothing.
    assert!((red[0] / white[0] - 1.0).abs() < 0.2, "{red:?} {white:?}");
    assert!(red[1] < 0.25 * white[1], "{red:?} {white:?}");
}
