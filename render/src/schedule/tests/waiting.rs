//! How many tiles of a worker wait for pages at a time: few where these are near, many where they come from afar, as
//! room and frames allow.

use super::*;

const SIDE: u32 = 128;

/// Answers nothing before it was waited for once, and counts who asked until then.
struct Afar {
    mesh: NaiveMesh,
    frames: Option<usize>,
    waiting: usize,
    has_waited: bool,
}

impl Tracer for Afar {
    fn intersect(&mut self, ray: &Ray) -> Answer<Option<Hit>> {
        if self.has_waited { self.mesh.intersect(ray) } else { Answer::Blocked }
    }

    fn occluded(&mut self, ray: &Ray) -> Answer<bool> {
        self.mesh.occluded(ray)
    }
}

impl PagedTracer for Afar {
    fn begin_tile(&mut self) {}

    fn request_missing(&mut self) -> usize {
        self.waiting += usize::from(!self.has_waited);
        1
    }

    fn frames_from_afar(&self) -> Option<usize> {
        self.frames
    }

    fn wait(&mut self, _longest: Duration) {
        self.has_waited = true;
    }
}

/// Tiles that have asked for pages before the first of them is waited for, in a pass of so many samples a pixel.
fn waiting(frames: Option<usize>, samples: u32) -> usize {
    let world = world(Method::Direct);
    let tiles = Tiles::z_curve([SIDE; 2]);
    let work = TileWork {
        samples: SampleWork { integrator: integrator(&world), g_stage: &CpuStage::default() },
        tiles: &tiles,
    };
    let mut film = Film::new([SIDE; 2], LAYERS, &Budget::unlimited()).unwrap();
    let mut tracers = [Afar { mesh: NaiveMesh::new(soup()), frames, waiting: 0, has_waited: false }];
    let stats = render_pass(&work, &mut film, &mut tracers, samples, &|| false);
    assert_eq!(stats.samples, u64::from(samples * SIDE * SIDE));
    let [Afar { waiting, .. }] = tracers;
    // The round that finds nothing there asks for all of them once more.
    waiting / 2
}

#[test]
fn as_many_tiles_wait_as_the_way_to_the_pages_takes() {
    assert_eq!([1, 4].map(|samples| waiting(None, samples)), [8, 8]);
    assert_eq!([4096, 128, 16, 0].map(|frames| waiting(Some(frames), 1)), [64, 32, 8, 8]);
    // In the room of 64 tiles of one sample.
    let most = waiting(Some(4096), 4);
    assert!((9..64).contains(&most), "{most}");
    assert!(most as u64 * Job::bytes() <= parked_bytes(true));
}
