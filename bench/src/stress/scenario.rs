//! Scenarios: which viewpoint, light or limit comes next.
//!
//! ```text
//! flip       two views from opposite sides          light-edit  the light goes round, a material with it
//! inside     overview and interior                  squeeze     flip, with half of the frames every other time
//! pingpong   overview and close-up                  soak        flip, inside and poses in turn; memory is watched
//! teleport   one of twelve poses, by chance         sweep       an orbit, a step a response
//! still      one view, again and again: what the table 2 of the paper shows
//! drag       an orbit, a pan and a zoom of 30 events a second; a step an event
//! fly        from the overview into the model and on through it, as drag
//! ```
//!
//! Views of flip, inside, squeeze and teleport are such as the model fills, unless they are given (`filling.rs`).
//!
//! Invariants: 1. step `n` of a script is a function of the model, the options and `n`; 2. after a switch with a state
//! the scene is always the same, once the script has begun.

use super::camera_way::{self, WAY_VIEWS};
use super::filling::{filled, is_filled};
use super::options::{Scenario, StressOptions};
use super::vector::{along, length, turned_about, unit};
use rand_pcg::Pcg64;
use rand_pcg::rand_core::{Rng, SeedableRng};
use trex_render::{
    Camera, Event, Light, MaterialEdit, Model, Occluders, PagedTracer, Ray, Session, View, VoxelScene,
    up_axis,
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
/// Part of the way to what it sees from the interior that a flight goes on.
const FLIGHT_SHARE: f64 = 0.8;
/// Poses that are tried for one of `teleport`.
const POSE_TRIES: u32 = 64;
/// Poses of `teleport`, and states of `light-edit`.
const POSES: u32 = 12;
const LIGHT_STATES: u32 = 8;
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
    /// Which way is up in it: a hand orbits about that axis.
    up: [f64; 3],
    /// Overview first.
    views: Vec<Camera>,
    /// Of `teleport`.
    poses: Vec<Camera>,
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
        let View { camera: overview, settings, .. } = session.view();
        let (overview, up) = (*overview, settings.up.direction().unwrap_or_else(|| up_axis(&model.bounds)));
        let mut views = options.views.clone();
        if views.is_empty() {
            let voxels = model.voxels.as_ref().map(|voxels| voxels.scene(Occluders::On));
            let other = match (options.scenario, &voxels) {
                (Scenario::Inside | Scenario::Soak | Scenario::Fly, Some(voxels)) => {
                    interior(&model, &overview, voxels)
                }
                // Nothing is known of what is inside: straight through the middle.
                (Scenario::Fly, None) => ahead(&overview, 1.0),
                (Scenario::Pingpong, Some(voxels)) => close_up(&model, &overview, voxels),
                _ => around(&model, up, &overview, 0.5),
            };
            views = vec![overview, other];
            if options.scenario == Scenario::Fly {
                views.push(ahead(&other, FLIGHT_SHARE));
            }
            if let Some(voxels) = voxels.filter(|_| options.fills && options.scenario.jumps()) {
                let resolution = session.film().resolution();
                for view in &mut views {
                    *view = filled(view, &voxels, resolution);
                }
            }
        }
        let mut script = Script {
            scenario: options.scenario,
            seed: options.seed,
            model,
            up,
            views,
            poses: Vec::new(),
            frames,
        };
        if options.scenario == Scenario::Teleport {
            script.poses = script.full_poses(session.film().resolution());
        }
        script
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
            Scenario::Drag | Scenario::Fly => WAY_VIEWS,
            Scenario::Sweep | Scenario::Soak => 0,
        }
    }

    /// The camera after event `index` of a way.
    pub(super) fn way(&self, index: u32) -> Camera {
        match self.scenario {
            Scenario::Fly => camera_way::fly(&self.views, index),
            _ => camera_way::drag(&self.views[0], self.up, index),
        }
    }

    /// The state of the scene after switch `index`; below [`Script::state_count`], where that is not 0.
    pub(super) fn state(&self, index: u32) -> u32 {
        match self.scenario {
            Scenario::Drag | Scenario::Fly => camera_way::view_of(index),
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
            Scenario::Teleport => vec![look(self.poses[state as usize])],
            Scenario::Drag | Scenario::Fly => vec![look(self.way(camera_way::event_of(state)))],
            _ => self.steps(state),
        }
    }

    /// What is done at switch `index`.
    pub(super) fn steps(&self, index: u32) -> Vec<Step> {
        let view = self.views[index as usize % self.views.len()];
        match self.scenario {
            Scenario::Flip | Scenario::Inside | Scenario::Pingpong => vec![look(view)],
            Scenario::Still => vec![look(self.views[0])],
            Scenario::Drag | Scenario::Fly => vec![look(self.way(index))],
            Scenario::Teleport => vec![look(self.poses[self.state(index) as usize])],
            Scenario::Sweep => {
                let turns = f64::from(index) / f64::from(ORBIT_STEPS);
                vec![look(around(&self.model, self.up, &self.views[0], turns))]
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

    /// Poses by chance, each the first of some that the model fills.
    fn full_poses(&self, resolution: [u32; 2]) -> Vec<Camera> {
        let voxels = self.model.voxels.as_ref().map(|voxels| voxels.scene(Occluders::On));
        let is_full =
            |pose: &Camera| voxels.as_ref().is_none_or(|voxels| is_filled(pose, voxels, resolution));
        let of = |index| {
            let mut tries = (0..POSE_TRIES).map(|at| self.pose(index + at * POSES));
            tries.find(is_full).unwrap_or_else(|| self.pose(index))
        };
        (0..POSES).map(of).collect()
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
        let (up, angle) = (self.up, f64::from(index) * 0.7);
        let (sin, cos) = angle.sin_cos();
        let side = match up.map(|x| x.abs() > 0.5) {
            [true, ..] => [0.0, cos, sin],
            [_, true, _] => [cos, 0.0, sin],
            _ => [cos, sin, 0.0],
        };
        let direction = std::array::from_fn(|a| -up[a] + 0.6 * side[a]);
        let sun = Light::Directional { direction, irradiance: [SUN; 3] };
        Step::Event(Box::new(Event::Lights(vec![sun, Light::Sky { radiance: [0.3; 3] }])))
    }
}

fn look(camera: Camera) -> Step {
    Step::Event(Box::new(Event::Camera(camera)))
}

/// The camera after `turns` of the way round the model.
fn around(model: &Model, up: [f64; 3], camera: &Camera, turns: f64) -> Camera {
    turned_about(model.bounds.center(), up, camera, turns)
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
        (sum, position, farthest)
    });
    let (_, position, (distance, direction)) =
        best.max_by(|a, b| a.0.total_cmp(&b.0)).expect("some places are tried");
    let distance = if distance > 0.0 { distance } else { 1.0 };
    Camera { position, target: along(position, distance, direction), ..*overview }
}

/// The camera after a share of the way to its target; it looks as far ahead as before.
fn ahead(camera: &Camera, share: f64) -> Camera {
    let way: [f64; 3] = std::array::from_fn(|a| camera.target[a] - camera.position[a]);
    let step = |point| along(point, share, way);
    Camera { position: step(camera.position), target: step(camera.target), ..*camera }
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
        assert!(near(around(&model, up_axis(&model.bounds), &camera, 0.5).position, [-3.0, 6.0, 1.0]));
        assert!(near(around(&model, up_axis(&model.bounds), &camera, 1.0).position, camera.position));
    }
}
