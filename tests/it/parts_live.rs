//! Parts on show that change under a live session: the picture in the end, in bits, is that of a session which was
//! opened on these parts, whatever was on show before, and wherever in a picture the change came.

use crate::command::folder;
use crate::fixtures::built_in;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::time::Duration;
use trex_model::{LiveSession, Model, OpenOptions, Pace, SessionOptions, ThreadSource};
use trex_render::{
    Event, FetchBlock, FrameOptions, FrameProgress, Method, PartKeys, Parts, RenderKeys, Scene, Section,
    TileOrder,
};
use trex_store::Budget;

const RESOLUTION: [u32; 2] = [96, 72];
const CONCRETE: usize = 0;
const WALL: usize = 1;
const ROOF: usize = 2;

/// A plant with walls and a roof, whose pages are all on the disk at first.
struct Plant {
    model: Model,
    _folder: tempfile::TempDir,
}

/// Parts, as keys of a scene and as what an event says.
struct PartsCase {
    keys: PartKeys,
    parts: Arc<Parts>,
}

impl Plant {
    fn new(what: &str) -> Plant {
        let inside = folder();
        built_in(inside.path(), what, "plant.trex");
        let options = OpenOptions {
            budget: Budget::unlimited(),
            threads: ThreadSource::Start(2.try_into().unwrap()),
            ..OpenOptions::with_limit(0)
        };
        let model = Model::open(&inside.path().join("plant.trex"), &options).unwrap();
        Plant { model, _folder: inside }
    }

    fn scene(method: Method, keys: &PartKeys) -> Scene {
        let render = RenderKeys {
            integrator: method,
            resolution: RESOLUTION,
            photons: 30_000,
            spp: 1,
            ..RenderKeys::default()
        };
        Scene { render, parts: keys.clone(), ..Scene::default() }
    }

    fn live(&self, method: Method, keys: &PartKeys) -> LiveSession {
        let options = SessionOptions { pace: Pace::InFrames, ..SessionOptions::default() };
        let session = self.model.session_with(&Plant::scene(method, keys), &options).unwrap();
        let frames = FrameOptions {
            t_max: Duration::from_secs(60),
            fetch_block: FetchBlock::Tiles(16),
            order: TileOrder::Row,
            ..FrameOptions::default()
        };
        session.go_live(frames).unwrap()
    }

    /// The picture of a session that was opened on these parts, without frames.
    fn at_leisure(&self, method: Method, keys: &PartKeys) -> Vec<[u32; 3]> {
        let options = SessionOptions { pace: Pace::InFrames, ..SessionOptions::default() };
        let mut session = self.model.session_with(&Plant::scene(method, keys), &options).unwrap();
        session.illuminate(&|| false, &mut |_, _| {}).unwrap();
        session.render(1, &|| false, &mut |_, _| ControlFlow::Continue(()));
        pixels().map(|at| session.film().radiance(at).map(f32::to_bits)).collect()
    }

    /// A section through the middle, of which the normal points away from the opening view's side, and hidden parts.
    fn shown(&self, normal: Option<[f64; 3]>, hidden: &[usize]) -> PartsCase {
        let bounds = self.model.file().superblock().bounds;
        let middle: [f64; 3] = std::array::from_fn(|axis| 0.5 * (bounds.lo[axis] + bounds.hi[axis]));
        let names = self.model.file().material_names();
        let numbers = |[nx, ny, nz]: [f64; 3]| [middle[0], middle[1], middle[2], nx, ny, nz];
        let keys = PartKeys {
            section: normal.map(numbers).into_iter().collect(),
            hide: hidden.iter().map(|&material| names.get(material).unwrap().to_owned()).collect(),
            only: vec![],
        };
        let sections = normal.map(|normal| Section::new(middle, normal).unwrap()).into_iter().collect();
        PartsCase { keys, parts: Arc::new(Parts::new(sections, hidden)) }
    }
}

fn pixels() -> impl Iterator<Item = [u32; 2]> {
    let [width, height] = RESOLUTION;
    (0..height).flat_map(move |y| (0..width).map(move |x| [x, y]))
}

fn end(session: &mut LiveSession) -> Vec<[u32; 3]> {
    frame_until(session, FrameProgress::Done);
    pixels().map(|at| session.shown(at).map(f32::to_bits)).collect()
}

fn frame_until(session: &mut LiveSession, progress: FrameProgress) {
    let mut frames = (0..10_000).map(|_| session.frame(1, &|| false).progress);
    assert!(frames.any(|reached| reached >= progress), "it gets there");
}

/// Each picture differs from the others, or the comparison says nothing.
#[test]
fn parts_that_change_end_in_the_picture_of_a_session_opened_on_them() {
    let plant = Plant::new("gen:pipes:30k --voxels 64");
    let cases = [
        plant.shown(Some([0.0, -1.0, 0.2]), &[]),
        plant.shown(None, &[ROOF, WALL]),
        plant.shown(Some([-1.0, 0.0, 0.0]), &[ROOF]),
        // The hidden materials stay, the plane moves: the octree is kept.
        plant.shown(Some([0.0, 0.0, 1.0]), &[ROOF]),
        plant.shown(None, &[]),
    ];
    for method in [Method::Direct, Method::Photon, Method::Ao] {
        let mut session = plant.live(method, &PartKeys::default());
        let mut before = end(&mut session);
        for PartsCase { keys, parts } in &cases {
            session.apply(Event::Parts(parts.clone())).unwrap();
            let found = end(&mut session);
            assert!(found == plant.at_leisure(method, keys), "{method:?} {keys:?}");
            assert!(found != before, "{method:?}: nothing has changed by {keys:?}");
            assert_eq!(session.view().parts, *parts);
            before = found;
        }
        let last = &cases[4];
        session.apply(Event::Parts(last.parts.clone())).unwrap();
        assert_eq!(session.frame(1, &|| false).progress, FrameProgress::Done, "nothing is begun again");
    }
}

/// Exact tiles of the parts before must not stay: neither those on the film nor those of a preview.
#[test]
fn parts_that_change_in_the_middle_of_a_picture_leave_nothing_behind() {
    let plant = Plant::new("gen:pipes:30k --voxels 64/256");
    let (cut, bare) = (plant.shown(Some([0.3, -1.0, 0.2]), &[CONCRETE]), plant.shown(None, &[ROOF, WALL]));
    for method in [Method::Direct, Method::Photon] {
        for reached in [FrameProgress::Preview, FrameProgress::Part, FrameProgress::Block] {
            let mut session = plant.live(method, &cut.keys);
            frame_until(&mut session, reached);
            session.apply(Event::Parts(bare.parts.clone())).unwrap();
            frame_until(&mut session, reached);
            session.apply(Event::Parts(cut.parts.clone())).unwrap();
            session.frame(1, &|| false);
            session.apply(Event::Parts(bare.parts.clone())).unwrap();
            assert!(end(&mut session) == plant.at_leisure(method, &bare.keys), "{method:?} at {reached:?}");
        }
    }
}
