//! Scenarios: which viewpoint, light or limit comes next.
//!
//! ```text
//! flip       two views from opposite sides          light-edit  the light goes round, a material with it
//! inside     overview and interior                  squeeze     flip, with half of the frames every other time
//! pingpong   overview and close-up                  soak        flip, inside and poses in turn; memory is watched
//! teleport   one of twelve poses, by chance         sweep       an orbit, a step a response
//! still      one view, again and again: what the table 2 of the paper shows
//! drag       an orbit, a pan and a zoom of 30 events a second; a step an event
//! ```
//!
//! Invariants: 1. step `n` of a script is a function of the model, the options and `n`; 2. after a switch with a state
//! the scene is always the same, once the script has begun.

use super::options::{Scenario, StressOptions};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use trex_render::{
    Camera, Event, Light, MaterialEdit, Model, Occluders, PagedTracer, Ray, Session, VoxelScene, up_axis,
};
use trex_store::layout::FRAME_BYTES;
use trex_store::pool::FRAMES_MIN;

/// Places that are tried for an interior, and rays from each.
const INTERIORS: u32 = 64;
const INTERIOR_RAYS: u32 = 32;
/// Steps of an orbit.
const ORBIT_STEPS: u32 = 48;
/// Distance of the close-up from the surface, as a share of the model's diagonal.
const CLOSE_SHARE: f64 = 0.01;
/// Poses of `teleport`, and states of `light-edit`.
const POSES: u32 = 12;
const LIGHT_STATES: u32 = 8;
/// Events of a drag, those of its orbit and its pan, and the views of its way that have references.
pub(super) const DRAG_EVENTS: u32 = 150;
const DRAG_ORBIT_EVENTS: u32 = 90;
const DRAG_PAN_EVENTS: u32 = 30;
pub(super) const DRAG_VIEWS: u32 = 12;
/// Turns of its orbit; how far it pans, and how near it comes, as shares of the way to the target.
const DRAG_TURNS: f64 = 0.25;
const DRAG_PAN: f64 = 0.15;
const DRAG_ZOOM: f64 = 0.4;
/// Irradiance of the light that goes round, as strong as the default sun.
const SUN: f32 = 3.0;

/// One thing that is done.
pub(super) enum Step {
    Event(Box<Event>),
    FrameBytes(u64),
}

/// The steps of a run.
pub(super) struct Script {
    scenario: Scenario,
    seed: u64,
    model: Model,
    /// Overview first.
    views: Vec<Camera>,
    frames: u64,
}

impl Script {
    /// The script of `options` on the model and the view of `session`, whose pool has so many `frames`.
    pub(super) fn new<T: PagedTracer + Send>(
        session: &Session<T>,
        options: &StressOptions,
        frames: u64,
    ) -> Script {
        let model = session.model().clone();
        let overview = session.view().camera;
        let mut views = options.views.clone();
        if views.is_empty() {
            let voxels = model.voxels.as_ref().map(|voxels| voxels.scene(Occluders::On));
            let other = match (options.scenario, &voxels) {
                (Scenario::Inside | Scenario::Soak, Some(voxels)) => interior(&model, &overview, voxels),
                (Scenario::Pingpong, Some(voxels)) => close_up(&model, &overview, voxels),
                _ => around(&model, &overview, 0.5),
            };
            views = vec![overview, other];
        }
        Script { scenario: options.scenario, seed: options.seed, model, views, frames }
    }

    /// Count of states that the scene comes to; 0 for a script whose states do not come again.
    pub(super) fn state_count(&self) -> u32 {
        match self.scenario {
            Scenario::Flip | Scenario::Inside | Scenario::Pingpong | Scenario::Squeeze => {
                self.views.len() as u32
            }
            Scenario::Still => 1,
            Scenario::Teleport => POSES,
            Scenario::LightEdit => LIGHT_STATES,
            Scenario::Drag => DRAG_VIEWS,
            Scenario::Sweep | Scenario::Soak => 0,
        }
    }

    /// The event of a drag after which the scene is in state `view`.
    pub(super) fn drag_event(&self, view: u32) -> u32 {
        (view + 1) * DRAG_EVENTS / DRAG_VIEWS - 1
    }

    /// The camera after event `index` of a drag: it orbits what it looks at.
    pub(super) fn drag(&self, index: u32) -> Camera {
        let part = |first: u32, count: u32| {
            (f64::from((index + 1).saturating_sub(first)) / f64::from(count)).min(1.0)
        };
        let orbited = part(0, DRAG_ORBIT_EVENTS);
        let panned = part(DRAG_ORBIT_EVENTS, DRAG_PAN_EVENTS);
        let zoom_first = DRAG_ORBIT_EVENTS + DRAG_PAN_EVENTS;
        let zoomed = part(zoom_first, DRAG_EVENTS - zoom_first);
        let from = &self.views[0];
        let camera = turned_about(from.target, up_axis(&self.model.bounds), from, DRAG_TURNS * orbited);
        let way: [f64; 3] = std::array::from_fn(|a| camera.target[a] - camera.position[a]);
        let side = unit(cross(way, up_axis(&self.model.bounds)));
        let aside = DRAG_PAN * panned * length(way);
        let target = along(camera.target, aside, side);
        let position = along(along(camera.position, aside, side), DRAG_ZOOM * zoomed, way);
        Camera { position, target, ..camera }
    }

    /// The state of the scene after switch `index`; below [`Script::state_count`], where that is not 0.
    pub(super) fn state(&self, index: u32) -> u32 {
        match self.scenario {
            Scenario::Drag => {
                (1..DRAG_VIEWS).take_while(|view| self.drag_event(*view) <= index).last().unwrap_or(0)
            }
            Scenario::Teleport => (Numbers::new(self.seed, index).next() * f64::from(POSES)) as u32,
            _ => index % self.state_count().max(1),
        }
    }

    /// Switches before the first that is measured: what a state is made of has been done once.
    pub(super) fn first(&self) -> u32 {
        if self.scenario == Scenario::LightEdit { LIGHT_STATES } else { 0 }
    }

    /// What takes the scene to state `state`, after those before it.
    pub(super) fn steps_to(&self, state: u32) -> Vec<Step> {
        match self.scenario {
            Scenario::Teleport => vec![look(self.pose(state))],
            Scenario::Drag => vec![look(self.drag(self.drag_event(state)))],
            _ => self.steps(state),
        }
    }

    /// What is done at switch `index`.
    pub(super) fn steps(&self, index: u32) -> Vec<Step> {
        let view = self.views[index as usize % self.views.len()];
        match self.scenario {
            Scenario::Flip | Scenario::Inside | Scenario::Pingpong => vec![look(view)],
            Scenario::Still => vec![look(self.views[0])],
            Scenario::Drag => vec![look(self.drag(index))],
            Scenario::Teleport => vec![look(self.pose(self.state(index)))],
            Scenario::Sweep => {
                vec![look(around(&self.model, &self.views[0], f64::from(index) / f64::from(ORBIT_STEPS)))]
            }
            Scenario::LightEdit => vec![self.light(index % LIGHT_STATES)],
            Scenario::Squeeze => {
                let frames =
                    if index % 4 < 2 { self.frames } else { (self.frames / 2).max(FRAMES_MIN as u64) };
                vec![Step::FrameBytes(frames * FRAME_BYTES as u64), look(view)]
            }
            Scenario::Soak => vec![look(if index % 3 == 2 { self.pose(index) } else { view })],
        }
    }

    /// Bytes of frames that the run began with, where it changes them.
    pub(super) fn frame_bytes_at_rest(&self) -> Option<u64> {
        (self.scenario == Scenario::Squeeze).then(|| self.frames * FRAME_BYTES as u64)
    }

    /// A pose by chance: in the model's box, looking anywhere.
    fn pose(&self, index: u32) -> Camera {
        let mut numbers = Numbers::new(self.seed, index);
        let bounds = &self.model.bounds;
        let position: [f64; 3] =
            std::array::from_fn(|a| bounds.lo[a] + numbers.next() * (bounds.hi[a] - bounds.lo[a]));
        let target = along(position, 1.0, numbers.direction());
        Camera { position, target, ..self.views[0] }
    }

    /// The sun goes round; every fourth time a material changes instead.
    fn light(&self, index: u32) -> Step {
        if index % 4 == 3 {
            let shade = if index % 8 == 3 { 0.2 } else { 0.7 };
            let edit = MaterialEdit { kd: Some([shade; 3]), ..MaterialEdit::default() };
            return Step::Event(Box::new(Event::Material { index: 0, edit }));
        }
        let up = up_axis(&self.model.bounds);
        let angle = f64::from(index) * 0.7;
        let side =
            if up[1] > 0.5 { [angle.cos(), 0.0, angle.sin()] } else { [angle.cos(), angle.sin(), 0.0] };
        let direction = std::array::from_fn(|a| -up[a] + 0.6 * side[a]);
        let sun = Light::Directional { direction, irradiance: [SUN; 3] };
        Step::Event(Box::new(Event::Lights(vec![sun, Light::Sky { radiance: [0.3; 3] }])))
    }
}

fn look(camera: Camera) -> Step {
    Step::Event(Box::new(Event::Camera(camera)))
}

/// The camera after `turns` of the way round the model.
fn around(model: &Model, camera: &Camera, turns: f64) -> Camera {
    turned_about(model.bounds.center(), up_axis(&model.bounds), camera, turns)
}

/// The camera after `turns` about the axis `up` through `center`.
fn turned_about(center: [f64; 3], up: [f64; 3], camera: &Camera, turns: f64) -> Camera {
    let (sin, cos) = (turns * std::f64::consts::TAU).sin_cos();
    // Rodrigues.
    let turn = |point: [f64; 3]| {
        let v: [f64; 3] = std::array::from_fn(|a| point[a] - center[a]);
        let lift: f64 = (0..3).map(|a| v[a] * up[a]).sum();
        let across = cross(up, v);
        std::array::from_fn(|a| center[a] + cos * v[a] + sin * across[a] + (1.0 - cos) * lift * up[a])
    };
    Camera { position: turn(camera.position), target: turn(camera.target), ..*camera }
}

/// Near the surface that the overview has in its middle.
fn close_up(model: &Model, overview: &Camera, voxels: &VoxelScene<'_>) -> Camera {
    let way: [f64; 3] = std::array::from_fn(|a| overview.target[a] - overview.position[a]);
    let direction = unit(way);
    let ray = Ray { origin: overview.position, direction, t_max: f64::INFINITY };
    let distance = voxels.intersect(&ray).map_or(length(way), |hit| hit.t);
    let position = along(overview.position, distance - CLOSE_SHARE * model.bounds.diagonal(), direction);
    Camera { position, target: along(overview.position, distance, direction), ..*overview }
}

/// Of some places about the middle the one with most of the model around it at a good distance, looking where it is
/// far.
fn interior(model: &Model, overview: &Camera, voxels: &VoxelScene<'_>) -> Camera {
    let bounds = &model.bounds;
    let best = (0..INTERIORS).map(|place| {
        let mut numbers = Numbers::new(0x1d5, place);
        let position: [f64; 3] = std::array::from_fn(|a| {
            bounds.lo[a] + (0.25 + 0.5 * numbers.next()) * (bounds.hi[a] - bounds.lo[a])
        });
        // Rays that leave the model count for nothing.
        let (mut sum, mut farthest) = (0.0, (0.0, [1.0, 0.0, 0.0]));
        for _ in 0..INTERIOR_RAYS {
            let direction = numbers.direction();
            let ray = Ray { origin: position, direction, t_max: f64::INFINITY };
            if let Some(hit) = voxels.intersect(&ray) {
                sum += hit.t.sqrt();
                if hit.t > farthest.0 {
                    farthest = (hit.t, direction);
                }
            }
        }
        (sum, position, farthest.1)
    });
    let (_, position, direction) = best.max_by(|a, b| a.0.total_cmp(&b.0)).expect("some places are tried");
    Camera { position, target: along(position, 1.0, direction), ..*overview }
}

/// Numbers by chance for one purpose.
struct Numbers(Pcg64);

impl Numbers {
    fn new(seed: u64, index: u32) -> Numbers {
        Numbers(Pcg64::seed_from_u64(seed << 32 ^ u64::from(index)))
    }

    /// In [0, 1).
    fn next(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Not quite up or down, where a camera has no side.
    fn direction(&mut self) -> [f64; 3] {
        loop {
            let v: [f64; 3] = std::array::from_fn(|_| 2.0 * self.next() - 1.0);
            let size = length(v);
            if size > 0.1 && size <= 1.0 && v.iter().all(|x| x.abs() < 0.95 * size) {
                return unit(v);
            }
        }
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn length(v: [f64; 3]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn unit(v: [f64; 3]) -> [f64; 3] {
    v.map(|x| x / length(v))
}

fn along(origin: [f64; 3], t: f64, direction: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|a| origin[a] + t * direction[a])
}

#[cfg(test)]
mod tests {
    use super::*;
    use trex_store::Aabb;

    fn model(bounds: Aabb) -> Model {
        Model {
            bounds,
            outline: Default::default(),
            materials: vec![],
            names: Default::default(),
            emitters: vec![],
            voxels: None,
        }
    }

    fn near(a: [f64; 3], b: [f64; 3]) -> bool {
        (0..3).all(|i| (a[i] - b[i]).abs() < 1e-9)
    }

    #[test]
    fn half_a_turn_is_the_other_side_and_a_whole_one_is_none() {
        let bounds = Aabb { lo: [0.0, 0.0, 0.0], hi: [2.0, 4.0, 2.0] };
        let model = model(bounds);
        let camera = Camera { position: [5.0, 6.0, 1.0], ..Camera::framing(&bounds, [64, 64], None, None) };
        assert!(near(around(&model, &camera, 0.5).position, [-3.0, 6.0, 1.0]));
        assert!(near(around(&model, &camera, 1.0).position, camera.position));
    }

    /// A quarter of an orbit about the target, then a way to the right, then nearer: each step alone.
    #[test]
    fn a_drag_orbits_pans_and_zooms_in_small_steps() {
        let bounds = Aabb { lo: [0.0; 3], hi: [8.0, 2.0, 8.0] };
        assert_eq!(up_axis(&bounds), [0.0, 1.0, 0.0]);
        let (target, position) = ([1.0, 1.0, 1.0], [5.0, 1.0, 1.0]);
        let view = Camera { position, target, ..Camera::framing(&bounds, [64, 64], None, None) };
        let script =
            Script { scenario: Scenario::Drag, seed: 1, model: model(bounds), views: vec![view], frames: 0 };
        let end = |event: u32| (script.drag(event - 1).position, script.drag(event - 1).target);
        let (orbited, from) = end(90);
        assert!(near(from, target) && near(orbited, [1.0, 1.0, -3.0]), "{orbited:?}");
        // It looks along +z there, with +y up: right is -x.
        let (panned, seen) = end(120);
        assert!(near(panned, [0.4, 1.0, -3.0]) && near(seen, [0.4, 1.0, 1.0]), "{panned:?} {seen:?}");
        let (zoomed, seen_nearer) = end(150);
        assert!(near(zoomed, [0.4, 1.0, -1.4]) && near(seen_nearer, seen), "{zoomed:?}");
        let places: Vec<_> = (0..DRAG_EVENTS).map(|event| script.drag(event).position).collect();
        let step = |pair: &[[f64; 3]]| length(std::array::from_fn(|a| pair[1][a] - pair[0][a]));
        assert!(places.windows(2).map(step).all(|step| step > 0.01 && step < 0.1));
        // Each state is that of one event, and the last is that of the rest.
        let events: Vec<u32> = (0..DRAG_VIEWS).map(|view| script.drag_event(view)).collect();
        assert!(events.windows(2).all(|pair| pair[0] < pair[1]) && events[11] == DRAG_EVENTS - 1);
        assert!((0..DRAG_VIEWS).all(|view| script.state(events[view as usize]) == view));
    }
}
